"""An open world: does the loop know when the cause is none of those that it lists?

Foreign causes, each as strong as makes its signal-to-noise ratio the one asked for (defined as in
`power.py`), and data that lack nothing but white noise; all made by scipy. What is told is judged
by codes, by the forms of laws and by their directions, never by words. Families and kinds of noise
that are set aside are run with --aside only: they are looked at once, at the end.
"""

import time
from dataclasses import replace

import numpy as np
from causes import LAWS, Cause, causes_of
from common import options, run_jobs, write_study
from foreign_layouts import LAYOUTS
from foreign_motion import Plan, moved
from foreign_worlds import KINDS
from odd_noise import ASIDE as NOISES_ASIDE
from odd_noise import NOISES
from open_judge import Referee, judge_foreign, judge_null
from open_tables import NULL, figure, summary
from power import ALPHA, seen_against, strength_at
from scenes import with_noise

from bsp_gp.data.noise import declare_noise
from bsp_gp.errors import BspError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.view import View
from bsp_gp.physics.force import Term, split_linear

SNRS = (5.0, 10.0, 30.0)
N_SETS = 2500
SHARE_NULL = 0.2
MAX_ROUNDS = 3
MOST_RIVALS = 6
QUICK = (("speed to the 1.5", 10.0), ("speed to the 0.5", 10.0), ("tails", 0.0), ("outliers", 0.0))
NULL_LAYOUTS = tuple(LAYOUTS)


# --- data -----------------------------------------------------------------------------------------


def turn_of(name, snr, seed):
    """Numbers by which sets of one kind take turns: of the kind, and of the set within it."""
    if name in NOISES:
        return list(NOISES).index(name), seed
    return list(KINDS).index(name), len(SNRS) * seed + SNRS.index(snr)


def plan_of(name, snr, seed):
    """What of a set is drawn but its force and its noise; half of the sets are long."""
    number, turn = turn_of(name, snr, seed)
    if name in NOISES:
        layout = NULL_LAYOUTS[(number + turn) % len(NULL_LAYOUTS)]
        n_dims = 3 if layout in ("thrown", "sliding") and turn % 3 == 2 else 2
        properties = ("mass", "charge") if layout == "charged" else ("mass",)
        is_long = (number + turn) // 2 % 2 == 0
        return Plan(layout, n_dims, is_long, properties, (1, number, seed))
    kind = KINDS[name]
    n_dims = 3 if kind.has_space and turn // 2 % 2 else 2
    return Plan(kind.layout, n_dims, (number + turn) % 2 == 0, kind.properties, (0, number, turn))


def is_declared(name, snr, seed):
    """Whether the data set declares its noise: every other one does."""
    number, turn = turn_of(name, snr, seed)
    return (number + (number + turn) // 2) % 2 == 0


def foreign(name, strength, plan):
    """Exact data of a foreign kind, and the truth."""
    rng = np.random.default_rng((*plan.entropy, 1))
    return moved(plan, KINDS[name].build(strength, rng))


def tuned(name, snr, plan):
    """Strength at which the exact data differ from the refitted declared model by `snr`.

    Returns
    -------
    strength, found : float
    Dataset, Truth
    """
    layout = LAYOUTS[plan.layout]
    made = []

    def seen(strength):
        made[:] = foreign(name, strength, plan)
        return seen_against(made[0], layout.declared(plan.n_dims), "", layout.sigma)

    strength, _ = strength_at(snr, KINDS[name].strength * snr / 10, seen)
    return strength, seen(strength), *made


# --- how far the nearest rival is -----------------------------------------------------------------


def separation(exact, declared, sigma, referee, told):
    """Standard deviations by which the nearest law that is not the truth fails, and its name.

    Of laws with one constant, textbook ones and those that were told of, linearised at the declared
    model on exact data.
    """
    data = declare_noise(exact, (sigma,) * exact.n_dims)
    hypothesis = Hypothesis.from_laws(data, declared)
    found = fit(hypothesis, data)
    view = View(found, continued(hypothesis, found), data, np.random.default_rng(0))
    total, best = float(view.left @ view.left), ("", np.inf)
    causes = {name: Cause("law", text) for name, text in LAWS.items()}
    causes |= {cause.law: cause for cause in told[:MOST_RIVALS] if cause.code == "law"}
    for name, cause in causes.items():
        terms, _ = referee.judge.terms(cause)
        rests = [split_linear(term.formula)[1] for term in terms]
        if not rests or any(rest.constants for rest in rests) or referee.is_right(cause):
            continue
        try:
            parts = [view.response.regression.column(Term(rest))[0] for rest in rests]
        except BspError:  # the data have not what it names
            continue
        columns = np.concatenate(parts, axis=1)
        if np.isfinite(columns).all():
            left = np.sqrt(max(total - view.score_forces(columns).statistic, 0.0))
            best = min(best, (name, float(left)), key=lambda item: item[1])
    return best


# --- one set --------------------------------------------------------------------------------------


def closed(dataset, declared, entropy):
    """Report of the loop, and CPU seconds that it took."""
    rng = np.random.default_rng((*entropy, 3))
    started = time.process_time()
    report = close_loop(dataset, declared, rng=rng, alpha=ALPHA, max_rounds=MAX_ROUNDS)
    return report, time.process_time() - started


def data_set(name, snr, seed):
    """Data set of a job as the loop gets it, its declared laws, and what is known of it.

    Returns
    -------
    Dataset, tuple of str, dict
        Of a foreign kind: exact, truth, strength, snr_found; of a null: noise_gain.
    """
    plan = plan_of(name, snr, seed)
    layout = LAYOUTS[plan.layout]
    declared, rng = layout.declared(plan.n_dims), np.random.default_rng((*plan.entropy, 2))
    if name in NOISES:
        exact, truth = moved(plan)
        scenes, gain = NOISES[name].draw(truth.scenes, layout.sigma, rng)
        size = layout.sigma if name == "missing rows" else _size(exact.scenes, scenes)
        noise = (size,) if is_declared(name, snr, seed) else None
        return replace(exact, scenes=tuple(scenes), noise=noise), declared, {"noise_gain": gain}
    strength, found, exact, truth = tuned(name, snr, plan)
    scenes = tuple(with_noise(scene, layout.sigma, rng) for scene in exact.scenes)
    noise = (layout.sigma,) if is_declared(name, snr, seed) else None
    known = {"exact": exact, "truth": truth, "strength": strength, "snr_found": found}
    return replace(exact, scenes=scenes, noise=noise), declared, known


def _size(exact, seen):
    """Root mean square of errors: what an honest observer declares."""
    errors = [
        (b.positions - a.positions)[:, a.dynamic].ravel() for a, b in zip(exact, seen, strict=True)
    ]
    return float(np.sqrt(np.square(np.concatenate(errors)).mean()))


def learned_from(exact, report):
    """The part of exact data that the loop learned from; None where it does not say.

    Of few scenes that is all, the part that is held out of each included.
    """
    if report.residuals is None:
        return None
    names = report.residuals["scene"].str.removesuffix(" (held out)")
    is_used = (report.residuals["split"] == "train") | (names != report.residuals["scene"])
    rows, names = report.residuals[is_used], names[is_used]
    out = []
    for scene in exact.scenes:
        seen = rows.loc[names == scene.name, "t"]
        if len(seen):
            out.append(scene.rows(0, int(np.searchsorted(scene.times, seen.max())) + 1))
    return replace(exact, scenes=tuple(out))


def lead_of(report):
    """The variable with which what is missing changes most, in the first round that tells one."""
    entries = [done.varies_with[0] for done in report.rounds if done.varies_with]
    return entries[0]["variable"] if entries else ""


def work(name, snr, seed):
    """One data set: a row."""
    plan = plan_of(name, snr, seed)
    dataset, declared, known = data_set(name, snr, seed)
    report, seconds = closed(dataset, declared, plan.entropy)
    common = {
        "kind": name, "layout": plan.layout, "snr": snr, "seed": seed, "n_dims": plan.n_dims,
        "n_scenes": len(dataset.scenes), "n_rows": sum(len(s.times) for s in dataset.scenes),
        "noise": "declared" if dataset.noise else "estimated",
    }  # fmt: skip
    after = {
        "verdict": report.verdict, "reason": report.rounds[0].reason, "law": report.law_text,
        "lead": lead_of(report), "cpu_s": seconds,
    }  # fmt: skip
    if name in NOISES:
        own = judge_null(report, NOISES[name])
        more = {"family": NULL, "aside": name in NOISES_ASIDE, **known}
        return [{**common, **more, **own, **after}]
    kind = KINDS[name]
    exact, truth = known.pop("exact"), known.pop("truth")
    referee = Referee(exact, truth, declared, kind.near)
    own = judge_foreign(report, referee, ALPHA)
    told = [cause for done in report.rounds for cause in causes_of(done)]
    part = learned_from(exact, report)
    sigma = LAYOUTS[plan.layout].sigma
    rival, apart = separation(exact, declared, sigma, referee, told)
    known["snr_train"] = np.nan if part is None else seen_against(part, declared, "", sigma)
    is_lead = after["lead"] in kind.varies or own["code"] in kind.near
    more = {"family": kind.family, "aside": kind.is_aside, **known, "separation": apart}
    return [{**common, **more, "rival": rival, **own, "lead_right": is_lead, **after}]


# --- the study ------------------------------------------------------------------------------------


def jobs_of(quick, n_sets, seed, with_aside, snrs=SNRS):
    """The jobs: kinds in turn, each at every ratio, then with the next seed."""
    if quick:
        return [(name, snr, seed) for name, snr in QUICK]
    foreign = [name for name, kind in KINDS.items() if with_aside or not kind.is_aside]
    noises = [name for name in NOISES if with_aside or name not in NOISES_ASIDE]
    n_null = round(SHARE_NULL * n_sets)
    jobs = []
    for k in range(n_sets - n_null):
        turn, number = divmod(k, len(foreign))
        snr = snrs[(turn + number) % len(snrs)]
        jobs.append((foreign[number], snr, seed + turn // len(snrs)))
    for k in range(n_null):
        turn, number = divmod(k, len(noises))
        jobs.append((noises[number], 0.0, seed + turn))
    return jobs


def declare(parser):
    parser.add_argument("--sets", type=int, default=N_SETS, help=f"default {N_SETS}")
    parser.add_argument("--snr", type=float, nargs="+", choices=SNRS, default=SNRS)
    parser.add_argument("--aside", action="store_true", help="with what is set aside")


def main():
    args = options(__doc__.splitlines()[0], declare=declare)
    jobs = jobs_of(args.quick, args.sets, args.seed, args.aside, tuple(args.snr))
    table = run_jobs(jobs, work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "open_world")


if __name__ == "__main__":
    main()
