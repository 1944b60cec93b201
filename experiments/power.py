"""Which undeclared effects are found, named rightly, and measured rightly, at a given strength.

Every data set lacks one effect, made by pymunk or by a second engine, as strong as makes its
signal-to-noise ratio the one asked for: SNR^2 = d' S^-1 d, d being the difference of positions
between the true motion and the best refitted declared model (constants and initial states free),
S the covariance of the noise, summed over the data set. `snr_rival` is the same against the
nearest wrong effect, refitted. Both come from the truth of the generator.
"""

from dataclasses import replace

import numpy as np
from causes import LAWS, PERIOD, Cause, Judge, causes_of, is_adopted, start_of
from common import of_share, options, run_jobs, take_share, write_study
from made_worlds import CLOSEST, FALL, MAT, NBODY, PUCKS, make_apart, world

from bsp_gp.data.noise import declare_noise
from bsp_gp.errors import BspError, MissingDependencyError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.loop.close import close_loop
from bsp_gp.simulate.effects import Effect, ExtraBody, effect
from bsp_gp.simulate.engine import run_pymunk
from bsp_gp.simulate.forces import MatFriction, PointSpring
from bsp_gp.simulate.synth import make
from bsp_gp.simulate.world import point

ALPHA = 0.01
SNRS = (10.0,)
NOISES = ("declared", "estimated")
N_SEEDS = 100
MORE_SEEDS = 50
"""Further sets of thrown balls, which cost little: for the coverage of a thousand constants."""
MOST_RIVALS = 6
"""Laws that the loop tried, of which the nearest wrong one is looked for beside the others."""

FORCES = ("pair", "field", "declared_term_change")
"""Kinds of causes that a law tells whole."""
FAR = 5.0
"""SNR of the nearest rival from which on a single name is to be right."""
FEWEST_STEPS = 5
"""Of a second engine between two frames."""
THROWN = {**FALL, "n_scenes": 10, "speed_x": (-4.0, 4.0), "speed_y": (0.0, 5.0)}
SLIDING = {**MAT, "n_scenes": 10}
ORBITING = {**NBODY, "n_scenes": 6}
MEETING = {**PUCKS, "n_scenes": 10}
POST = (1.0, 4.0)
PUSH = "a * cos(w * t + f) * e_x"


def _spring(value):
    post = ExtraBody(point("post"), POST, is_hidden=False)
    return Effect("spring", (("value", value),), False, (PointSpring(value, *POST),), body=post)


def _grip(value):
    return Effect("mat friction", (("value", value),), False, (MatFriction(value),))


def _named(name, **fixed):
    return lambda value: effect(name, value, is_declared=False, **fixed)


CASES = {
    "linear drag": ("fall", THROWN, _named("drag"), 0.02),
    "quadratic drag": ("fall", THROWN, _named("quadratic_drag"), 0.005),
    "uniform wind": ("fall", THROWN, _named("wind"), 0.02),
    "perpendicular": ("fall", THROWN, _named("perpendicular"), 0.02),
    "magnetic": ("fall", THROWN, _named("magnetic"), 0.02),
    "spring to a point": ("fall", THROWN, _spring, 0.02),
    "periodic push": ("fall", THROWN, _named("push", period=PERIOD), 0.05),
    "friction on a mat": ("mat", SLIDING, _grip, 0.02),
    "pair force": ("nbody", ORBITING, _named("pair"), 1.0),
    "changed exponent": ("nbody", ORBITING, lambda v: _named("exponent")(2.0 + v), 0.001),
    "inelastic contact": ("pucks", MEETING, _named("dashpot"), 0.2),
}
"""Preset, its numbers, effect of a strength, and a strength to begin with."""

GRAVITY = "G * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"


def declared_of(case, truth):
    """The declared laws. An exponent is only wrong where the strength does not have to make up."""
    return (GRAVITY,) if case == "changed exponent" else truth.declared


def engine_of(name, settings):
    """The engine of this name, or None where it lacks the effect or is not installed."""
    if name == "pymunk":
        return run_pymunk
    try:
        from second_engine import run_mujoco

        make(replace(settings, n_scenes=1, n_frames=3), np.random.default_rng(0), run_mujoco)
    except (MissingDependencyError, BspError):
        return None
    return run_mujoco


def for_engine(settings, engine):
    """Settings with the steps that an engine needs: mujoco's Runge-Kutta rule gets by with few."""
    if engine != "mujoco":
        return settings
    return replace(settings, substeps=max(settings.substeps // 10, FEWEST_STEPS))


def data_set(case, strength, seed, engine="pymunk", noise=None, is_declared=True):
    """Data set and truth of a case; whether its noise is declared or is to be estimated."""
    name, numbers, build, _ = CASES[case]
    noise = numbers["noise"] if noise is None else noise
    made = world(name, numbers, [build(strength)], noise=noise, is_declared=is_declared)
    settings = for_engine(made, engine)
    run = engine_of(engine, settings)
    if run is None:
        raise BspError(f"{engine} has no {case}")
    closest = 0.0 if name == "pucks" else CLOSEST  # pucks are to meet
    dataset, truth = make_apart(settings, (list(CASES).index(case), seed), run, closest)
    return replace(dataset, train=(), test=()), truth  # the loop is to split it


def seen_against(dataset, declared, extra, sigma):
    """SNR of exact positions against the declared model, or it and one more law."""
    laws = (*declared, extra) if extra else tuple(declared)
    dataset = declare_noise(dataset, (sigma,) * dataset.n_dims)
    hypothesis = Hypothesis.from_laws(dataset, laws)
    found = fit(hypothesis, dataset, starts=_rates(hypothesis.law))
    return float(np.sqrt(found.chisqr))


def _rates(law):
    """Where frequencies of a law begin."""
    return {name: start_of(name, 0.0) for name in law.names if name.startswith("w")}


def strength_at(snr, strength, seen):
    """Strength at which something is seen at this SNR, and the SNR found; `seen` of a strength."""
    for _ in range(4):
        found = seen(strength)
        if abs(found / snr - 1) < 0.01:
            break
        strength *= snr / found
    return strength, found


def tuned(case, snr, seed, engine):
    """Strength at which the exact data of a case differ from the declared model by `snr`."""
    sigma = CASES[case][1]["noise"]
    made = []

    def seen(strength):
        made[:] = data_set(case, strength, seed, engine, noise=0.0)
        dataset, truth = made
        return seen_against(dataset, declared_of(case, truth), "", sigma)

    strength, found = strength_at(snr, CASES[case][3], seen)
    return strength, found, *made


def rival_of(case, dataset, truth, tried=()):
    """SNR against the nearest wrong effect or law that the loop tried, and its name."""
    best, sigma = ("", np.inf), CASES[case][1]["noise"]
    judge = Judge(dataset, truth, declared_of(case, truth))
    texts = {name: text for name, text in LAWS.items() if name != case}
    texts |= {cause.law: cause.law for cause in tried if not judge.is_form(cause)}
    for name, text in texts.items():
        try:
            value = seen_against(dataset, declared_of(case, truth), text, sigma)
        except BspError:  # the data have not what it names
            continue
        if np.isfinite(value):
            best = min(best, (name, value), key=lambda item: item[1])
    return best


def taken_for(case, report, judge, is_named):
    """What the loop says that the effect is: an effect's name, another law, or its verdict."""
    if is_named:
        return case
    if not any(map(is_adopted, report.rounds)):
        return report.rounds[0].verdict
    return judge.name_of(report.law)


def work(case, engine, noise, snr, seed):
    """One data set: a row."""
    strength, found, exact, truth = tuned(case, snr, seed, engine)
    exact_truth = truth
    is_declared = noise == "declared"
    dataset, truth = data_set(case, strength, seed, engine, is_declared=is_declared)
    declared = declared_of(case, truth)
    loop_rng = np.random.default_rng((1, seed)).spawn(1)[0]
    report = close_loop(dataset, declared, rng=loop_rng, alpha=ALPHA, max_rounds=3)
    judge = Judge(dataset, truth, declared)
    law = right_law(report, judge)
    first = report.rounds[0]
    told = causes_of(first)
    tried = [Cause("law", row["law"]) for row in first.hypotheses if row["code"] == "law"]
    tried = tried[:MOST_RIVALS] + [cause for cause in told[:1] if cause.law and law is None]
    rival, snr_rival = rival_of(case, exact, exact_truth, tried)
    covered = ""
    if law is not None:
        new = [c for c in report.constants if c.name not in judge.declared.names]
        covered = [bool(c.low <= law.constants[c.name] <= c.high) for c in new]
    return [{
        "effect": case, "engine": engine, "noise": noise, "snr": found, "snr_rival": snr_rival,
        "rival": rival, "seed": seed, "strength": strength,
        "detected": any(r.missing.p_value <= ALPHA for r in report.rounds),
        "verdict": first.verdict, "n_adopted": sum(map(is_adopted, report.rounds)),
        "adopted": any(map(is_adopted, report.rounds)), "named": law is not None,
        "taken_for": taken_for(case, report, judge, law is not None),
        "in_class": law is not None or any(map(judge.is_form, told)), "n_class": len(told),
        "covered": " ".join(map(str, covered)), "law": report.law_text,
        "p_value": first.effect.p_value if first.effect else "",
        "code": first.effect.code if first.effect else "", "reason": first.reason,
        "rollout_ratio_to_oracle": report.total["after"].rollout_rmse
        / oracle(split_as(report, dataset), truth, case),
    }]  # fmt: skip


def right_law(report, judge):
    """The adopted law with the constants of the truth, where it has its form; or None."""
    adopted = [done for done in report.rounds if is_adopted(done)]
    if not adopted or any(done.effect.kind not in FORCES for done in adopted):
        return None
    return judge.refitted(report.law) if judge.is_found(report.law) else None


def split_as(report, dataset):
    """The data set with the split of a report."""
    return replace(
        dataset, train=tuple(report.dataset["train"]), test=tuple(report.dataset["test"])
    )


def oracle(dataset, truth, case):
    """Held-out rollout error of the declared model with the true form added, or of truth itself."""
    laws = list(declared_of(case, truth))
    if case in LAWS:
        laws.append(LAWS[case])
    elif case == "periodic push":
        laws.append(PUSH)
    elif case == "changed exponent":
        laws = [f"{GRAVITY} * norm(p_i - p_j)^c"]
    return fit_law(dataset, laws, starts=_rates(read_law(dataset, laws))).errors.rollout_rmse


def jobs_of(quick, seed, share=1.0):
    """The jobs.

    Every other seed by the second engine where it has the effect, every other pair of seeds with
    noise that is estimated.
    """
    cases = ("linear drag", "magnetic") if quick else CASES
    n_seeds, n_more = of_share(N_SEEDS, share), of_share(MORE_SEEDS, share)
    seeds = (seed, seed + 3) if quick else range(seed, seed + n_seeds + n_more)
    able = {}
    for case in cases:
        name, numbers, build, strength = CASES[case]
        able[case] = engine_of("mujoco", world(name, numbers, [build(strength)])) is not None
    return [(case, "mujoco" if s % 2 and able[case] else "pymunk", NOISES[s // 2 % 2], snr, s)
            for snr in SNRS for s in seeds for case in cases
            if s < seed + n_seeds or CASES[case][0] == "fall"]  # fmt: skip


def summary(table):
    """Rates of each effect."""
    lines = [
        "# Undeclared effects: detected, named, measured\n",
        f"Made by {_counts(table['engine'])}; noise {_counts(table['noise'])}.\n",
        "Named: the adopted law is that of the truth, with no term more. In class: it is among the "
        "laws that are reported as not to be told apart. Wrong: a law is adopted, or one alone is "
        "shown, and the right one is not in its class. Ratio: held-out rollout error over that of "
        "the true form fitted to the same data.\n",
        "| effect | sets | SNR | rival SNR | detected | adopted | named | in class | laws in it "
        "| wrong | covered (90 %) | ratio: median, 90 % |",
        "|---" * 12 + "|",
    ]
    parts = [*table.groupby("effect", sort=False)]
    parts += [(f"all, noise {name}", part) for name, part in table.groupby("noise")]
    for name, part in [*parts, ("all", table)]:
        ratio = part["rollout_ratio_to_oracle"].dropna()
        cells = [
            name, len(part), f"{part['snr'].median():.1f}", f"{part['snr_rival'].median():.1f}",
            *(f"{part[c].mean():.0%}" for c in ("detected", "adopted", "named", "in_class")),
            f"{part['n_class'].median():.0f}", f"{is_wrong(part).mean():.0%}", covered(part),
            f"{ratio.median():.2f}, {ratio.quantile(0.9):.2f}" if len(ratio) else "",
        ]  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    for is_far, part in table.groupby(table["snr_rival"] >= FAR):
        lines.append(
            f"\nWhere the nearest rival is {'at' if is_far else 'below'} SNR {FAR:g}"
            f"{' or more' if is_far else ''} ({len(part)} sets): the right form is adopted in "
            f"{part['named'].mean():.0%}, in the class in {part['in_class'].mean():.0%}, "
            f"a wrong one alone is given in {is_wrong(part).mean():.1%}."
        )
    lines.append(f"\nConstants but those of the push, which has three: {covered(table, 'push')}.")
    return "\n".join([*lines, "", *confusion(table)]) + "\n"


def is_wrong(table):
    """Where a wrong law is given alone."""
    return ~table["in_class"] & (table["adopted"] | (table["n_class"] == 1))


def covered(table, but=None):
    """Share of constants in their intervals, and its standard error by whole sets."""
    if but is not None:
        table = table[~table["effect"].str.contains(but)]
    told = [np.array(str(row).split()) == "True" for row in table["covered"].dropna()]
    n = sum(map(len, told))
    if not n:
        return ""
    share = sum(t.sum() for t in told) / n
    error = np.sqrt(sum((t - share).sum() ** 2 for t in told)) / n
    return f"{share:.1%} ± {error:.1%} of {n}"


def _counts(column):
    return ", ".join(f"{name} ({n} sets)" for name, n in column.value_counts().items())


def confusion(table):
    """Confusion matrix: of each effect, what it was taken for, in sets; lines of Markdown."""
    effects, said = list(dict.fromkeys(table["effect"])), list(dict.fromkeys(table["taken_for"]))
    columns = [*(e for e in effects if e in said), *(s for s in said if s not in effects)]
    lines = [f"| effect, taken for | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    for name in effects:
        found = table.loc[table["effect"] == name, "taken_for"].value_counts()
        lines.append(f"| {name} | " + " | ".join(str(found.get(c, "")) for c in columns) + " |")
    return lines


def figure(table):
    """Verdicts of each effect as stacked bars."""
    import matplotlib.pyplot as plt

    kinds = {"right form": "#009e73", "right in class": "#56b4e9", "wrong": "#d55e00",
             "cannot tell": "#e69f00", "seen, not adopted": "#cccccc",
             "nothing missing": "#555555"}  # fmt: skip
    verdict = table["verdict"].where(~table["adopted"], "wrong")
    verdict = verdict.where(~(table["adopted"] & table["in_class"]), "right in class")
    verdict = verdict.where(~table["named"], "right form")
    names = list(dict.fromkeys(table["effect"]))
    fig, ax = plt.subplots(figsize=(7, 0.4 * len(names) + 1.3), layout="constrained")
    left = np.zeros(len(names))
    for kind, colour in kinds.items():
        share = [(verdict[table["effect"] == n] == kind).mean() for n in names]
        ax.barh(names, share, left=left, color=colour, label=kind)
        left += share
    ax.invert_yaxis()
    ax.set(xlabel="share of data sets", xlim=(0, 1))
    ax.spines[["top", "right"]].set_visible(False)
    fig.legend(loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    return fig


def main():
    args = options(__doc__.splitlines()[0], declare=take_share)
    table = run_jobs(jobs_of(args.quick, args.seed, args.share), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "power")


if __name__ == "__main__":
    main()
