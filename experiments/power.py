"""Which undeclared effects are found, named rightly, and measured rightly, at a given strength.

Every data set lacks one effect, made by pymunk or by a second engine, as strong as makes its
signal-to-noise ratio the one asked for: SNR^2 = d' S^-1 d, d being the difference of positions
between the true motion and the best refitted declared model (constants and initial states free),
S the covariance of the noise, summed over the data set. `snr_rival` is the same against the
nearest wrong effect, refitted. Both come from the truth of the generator.
"""

from dataclasses import replace

import numpy as np
from common import options, run_jobs, write_study
from made_worlds import CLOSEST, FALL, MAT, NBODY, PUCKS, make_apart, world
from scipy.optimize import least_squares

from bsp_gp.errors import BspError, MissingDependencyError
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.preparing import observe
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.shooting import fit_rollout, parameter_list
from bsp_gp.simulate.effects import Effect, ExtraBody, effect
from bsp_gp.simulate.engine import run_pymunk
from bsp_gp.simulate.forces import MatFriction, PointSpring
from bsp_gp.simulate.synth import make
from bsp_gp.simulate.world import point

ALPHA = 0.01
SNRS = (10.0,)
N_SEEDS = 100
SAME_FORM = 1e-5
"""Laws are of one form if their accelerations on the true motion are parallel to this part."""
MOST_RIVALS = 6
"""Laws that the loop tried, of which the nearest wrong one is looked for beside the others."""

FEWEST_STEPS = 5
"""Of a second engine between two frames."""
THROWN = {**FALL, "n_scenes": 10, "speed_x": (-4.0, 4.0), "speed_y": (0.0, 5.0)}
SLIDING = {**MAT, "n_scenes": 10}
ORBITING = {**NBODY, "n_scenes": 6}
MEETING = {**PUCKS, "n_scenes": 10}
POST = (1.0, 4.0)
PERIOD = 0.5
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
LAWS = {
    "linear drag": "c * v_i", "quadratic drag": "c * norm(v_i) * v_i", "uniform wind": "c * e_x",
    "perpendicular": "c * perp(v_i)", "magnetic": "c * charge_i * perp(v_i)",
    "spring to a point": "c * (p_j - p_i)", "attraction": "c * m_i * m_j * normalize(p_j - p_i)",
    "pair force": "c * charge_i * charge_j / norm(p_i - p_j)^2 * normalize(p_i - p_j)",
    "friction on a mat": "c * is_on(s_i, p_i, s_j, p_j) * m_i * mu_j * normalize(v_i)",
    "inelastic contact": "c * along(v_i - v_j, p_i - p_j) * normalize(p_i - p_j) "
                         "* does_collide(s_i, p_i, s_j, p_j)",
    "friction": "c * m_i * normalize(v_i)",
}  # fmt: skip
"""What may be taken for an effect, where the data have what it names."""


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


def data_set(case, strength, seed, engine="pymunk", noise=None):
    """Data set and truth of a case."""
    name, numbers, build, _ = CASES[case]
    noise = numbers["noise"] if noise is None else noise
    settings = for_engine(world(name, numbers, [build(strength)], noise=noise), engine)
    run = engine_of(engine, settings)
    if run is None:
        raise BspError(f"{engine} has no {case}")
    closest = 0.0 if name == "pucks" else CLOSEST  # pucks are to meet
    return make_apart(settings, (list(CASES).index(case), seed), run, closest)


def start_of(name, usual):
    """Where a constant begins: a frequency at the true one, from afar it would not be found."""
    return 2 * np.pi / PERIOD if name.startswith("w") else usual


def seen_against(dataset, declared, extra, sigma):
    """SNR of exact positions against the declared model, or it and one more law."""
    law = declared_law(dataset, declared)
    if extra:
        formula = parse_formula(extra, dataset_types(dataset), units=dataset.units)
        start = {name: start_of(name, 0.0) for name in formula.constants}
        law = law.plus(Term(formula), start)
    fit = fit_rollout(dataset.scenes, law, np.full(2, sigma), up=dataset.up, substeps=2)
    return float(np.sqrt(fit.chisqr))


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
    wrong = [law for law in dict.fromkeys(tried) if not judge.is_form(law)]
    for name, text in {**texts, **dict(zip(wrong, wrong, strict=True))}.items():
        try:
            value = seen_against(dataset, declared_of(case, truth), text, sigma)
        except BspError:  # the data have not what it names
            continue
        best = min(best, (name, value), key=lambda item: item[1])
    return best


class Judge:
    """Compares laws with what was undeclared, along the true motion."""

    def __init__(self, dataset, truth, declared):
        from bsp_gp.physics.bodies import stack

        self.dataset, self.declared = dataset, declared_law(dataset, declared)
        scenes = [truth.scene(k) for k in range(len(truth.scenes))]
        moving = scenes[0].dynamic
        (self.batch,) = stack(scenes, dataset.up, "measured")
        self.true = truth.accelerations()[:, :, moving].ravel()
        self.missing = self.true - truth.accelerations(of_declared=True)[:, :, moving].ravel()

    def acceleration(self, law):
        """Accelerations of a law along the true motion, one vector."""
        b = self.batch
        value = law.acceleration(b.bodies, b.positions, b.velocities, b.times)
        return np.moveaxis(value, 1, 0).ravel()

    def refitted(self, law):
        """The law with the constants that come nearest to the truth; None if it is another form.

        A law has the form of the truth if with some constants it leaves next to nothing of what
        was undeclared.
        """
        parameters = parameter_list(law)

        def left(values):
            return self.true - self.acceleration(law.with_values(parameters, values))

        if not parameters:
            found, size = law, np.square(left(())).sum()
        else:
            start = np.array([law.constants[n] for n, _ in parameters], dtype=float)
            scale = np.maximum(np.abs(start), 1e-9)
            with np.errstate(all="ignore"):
                if not np.isfinite(left(start)).all():
                    return None
                fit = least_squares(left, start, method="lm", x_scale=scale)
            found, size = law.with_values(parameters, fit.x), 2 * fit.cost
        return found if size < SAME_FORM * (self.missing @ self.missing) else None

    def is_form(self, text, known=()):
        """Whether the declared law and a further one, or that one in its place, is the truth.

        `known` has values of constants to begin with, by name.
        """
        try:
            formula = parse_formula(text, dataset_types(self.dataset), units=self.dataset.units)
        except BspError:
            return False
        own = set(formula.constants)
        start = {n: 0.0 if n.startswith("n") else start_of(n, 1.0) for n in own}
        start.update((n, value) for n, value in dict(known).items() if n in own)
        alone = ForceLaw((Term(formula),), start)
        beside = self.declared.plus(Term(formula), start)
        return any(self.refitted(law) is not None for law in (alone, beside))


def work(case, engine, snr, seed):
    """One data set: a row."""
    strength, found, exact, truth = tuned(case, snr, seed, engine)
    exact_truth = truth
    dataset, truth = data_set(case, strength, seed, engine)
    declared = declared_of(case, truth)
    loop_rng, observe_rng = np.random.default_rng((1, seed)).spawn(2)
    report = close_loop(dataset, declared, rng=loop_rng, alpha=ALPHA, max_rounds=3)
    judge = Judge(dataset, truth, declared)
    is_adopted = any(done.adopted for done in report.rounds)
    law = judge.refitted(report.law) if is_adopted else None
    first = report.rounds[0]
    reported = [] if first.effect is None else [first.effect.law, *first.effect.equivalents]
    tried = [r.law for r in first.rivals if r.kind in ("pair", "field")][:MOST_RIVALS]
    tried += [first.effect.law] if first.effect and law is None else []
    rival, snr_rival = rival_of(case, exact, exact_truth, tried)
    covered = ""
    if law is not None:
        new = [c for c in report.constants if c.name not in judge.declared.names]
        covered = [bool(c.low <= law.constants[c.name] <= c.high) for c in new]
    return [{
        "effect": case, "engine": engine, "snr": found, "snr_rival": snr_rival, "rival": rival,
        "seed": seed, "strength": strength,
        "detected": any(r.is_something_missing for r in report.rounds), "verdict": first.verdict,
        "adopted": is_adopted, "named": law is not None,
        "in_class": law is not None or any(map(judge.is_form, reported)),
        "n_class": len(reported) + (first.effect.n_unnamed if first.effect else 0),
        "covered": " ".join(map(str, covered)), "law": report.law_text,
        "p_value": first.effect.p_value if first.effect else "", "reason": first.reason,
        "rollout_ratio_to_oracle": report.total["after"].rollout_rmse / oracle(
            dataset, truth, case, observe_rng),
    }]  # fmt: skip


def oracle(dataset, truth, case, rng):
    """Held-out rollout error of the declared model with the true form added, or of truth itself."""
    law = declared_law(dataset, declared_of(case, truth))
    if case in LAWS:
        formula = parse_formula(LAWS[case], dataset_types(dataset), units=dataset.units)
        law = law.plus(Term(formula), {"c": 0.0})
    elif case == "periodic push":
        law = declared_law(dataset, [*truth.declared, PUSH])
        law = law.with_constants({"a": 0.0, "w": start_of("w", 0.0), "f": 0.0})
    elif case == "changed exponent":
        law = declared_law(dataset, [f"{GRAVITY} * norm(p_i - p_j)^c"]).with_constants({"c": 0.0})
    pairs = any(term.kind == "pair" for term in law.terms)
    observation = observe(dataset, law, rng, sources=pairs)
    return evaluate(observation, law, observation.fit(law, start=law)).errors.rollout_rmse


def jobs_of(quick, seed):
    """The jobs; every other seed by the second engine where it has the effect."""
    cases = ("linear drag", "magnetic") if quick else CASES
    seeds = range(seed, seed + (2 if quick else N_SEEDS))
    able = {}
    for case in cases:
        name, numbers, build, strength = CASES[case]
        able[case] = engine_of("mujoco", world(name, numbers, [build(strength)])) is not None
    return [(case, "mujoco" if s % 2 and able[case] else "pymunk", snr, s)
            for snr in SNRS for s in seeds for case in cases]  # fmt: skip


def summary(table):
    """Rates of each effect."""
    lines = [
        "# Undeclared effects: detected, named, measured\n",
        "Named: the right form is adopted. In class: it is among the laws that are reported as not "
        "to be told apart. Wrong: another form is adopted, the right one is not in its class.\n",
        "| effect | sets | SNR | rival SNR | detected | adopted | named | in class | wrong "
        "| covered (90 %) | ratio to oracle: median, 90 % |",
        "|---" * 11 + "|",
    ]
    for name, part in [*table.groupby("effect", sort=False), ("all", table)]:
        covered = [c == "True" for row in part["covered"].dropna() for c in str(row).split()]
        ratio = part["rollout_ratio_to_oracle"].dropna()
        wrong = part["adopted"] & ~part["in_class"]
        cells = [
            name, len(part), f"{part['snr'].median():.1f}", f"{part['snr_rival'].median():.1f}",
            *(f"{part[c].mean():.0%}" for c in ("detected", "adopted", "named", "in_class")),
            f"{wrong.mean():.0%}",
            f"{np.mean(covered):.0%} of {len(covered)}" if covered else "",
            f"{ratio.median():.2f}, {ratio.quantile(0.9):.2f}" if len(ratio) else "",
        ]  # fmt: skip
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    clear = table[table["snr_rival"] >= 5]
    if len(clear):
        lines.append(f"\nWhere the nearest rival is at SNR 5 or more ({len(clear)} sets): the "
                     f"adopted law has the right form in {clear['named'].mean():.0%}.")  # fmt: skip
    return "\n".join(lines) + "\n"


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
    fig.legend(loc="outside upper center", ncols=6, fontsize=8, frameon=False)
    return fig


def main():
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "power")


if __name__ == "__main__":
    main()
