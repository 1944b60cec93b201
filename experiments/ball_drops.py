"""Eleven balls dropped from a bridge: the loop trained on one drop of each, tested on the other.

The 12-frame protocol: both directions, ten balls (one drop of the bowling ball is too short), 20
predictions. Which law the training drops choose by themselves, later rows against earlier ones, is
told beside it. The start of a
predicted drop is fitted on its first 12 rows; scored is the height error at row 42. Beside it
stands the error with starts fitted on all rows, which is that of the law alone.

And one law for all balls whose mass and radius are known: drag by their cross-section, and which of
them depart from it.
"""

import time
from dataclasses import replace

import numpy as np
from common import options, reference_data, write_table

from bsp_gp.data.tables import load_dataset
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import with_states
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.physics.masses import with_usable_masses

DECLARED = "9.81 [m/s^2] * m_i * down"
LEFT_OUT = "bowling_ball"
HALF_DENSITY = 0.5 * 1.2 * np.pi
"""Half the density of air, kg/m^3, times pi: drag is this times C_d R^2 |v| v."""
Z_90 = 1.645
DIRECTIONS = (("*_drop1", "*_drop2"), ("*_drop2", "*_drop1"))
EARLY = 0.7
"""Part of a training drop from which a law is chosen without a look at the other drops."""
WHOLE = "adopted, starts fitted on all rows"


def run(train, test, seed):
    """One direction: rows of the table, the report, and lines about the choice of its law."""
    dataset = load_dataset(reference_data("measured", "ball_drops"), train=train, test=test)
    loop_rng, alone_rng = np.random.default_rng(seed).spawn(2)
    started = time.process_time()
    report = close_loop(dataset, [DECLARED], rng=loop_rng, seed=seed)
    told = [f"loop: {time.process_time() - started:.0f} s"]
    alone = close_loop(in_time(dataset), [DECLARED], rng=alone_rng, max_rounds=1).rounds[0]
    first = report.rounds[0]
    same = getattr(alone.effect, "law", "") == getattr(first.effect, "law", "")
    told.append(f"from the training drops alone, their first {EARLY:.0%} against the rest: "
                f"{getattr(alone.effect, 'name', 'nothing')} ({alone.verdict}), "
                f"{'the same' if same else 'another'} law")  # fmt: skip
    last = dataset.evaluation.endpoint_row - 1
    rows = []
    for track in report.overlays:
        if LEFT_OUT not in track.scene and last < len(track.times):
            for label in ("declared", "adopted"):
                error = getattr(track, label)[last, 1] - track.observed[last, 1]
                rows.append({"scene": track.scene, "model": label, "endpoint_m": abs(error)})
    return rows + whole_starts(dataset, report), report, told


def in_time(dataset):
    """The training drops alone, the later part of each held out."""
    parts = {"early": [], "late": []}
    for scene in dataset.select(dataset.train):
        cut = int(EARLY * len(scene.times))
        parts["early"].append(replace(scene.rows(0, cut), name=f"{scene.name} early"))
        parts["late"].append(replace(scene.rows(cut + 1, None), name=f"{scene.name} late"))
    names = {part: tuple(s.name for s in scenes) for part, scenes in parts.items()}
    return replace(
        dataset, scenes=(*parts["early"], *parts["late"]), train=names["early"],
        test=names["late"], evaluation=replace(dataset.evaluation, endpoint_row=None),
    )  # fmt: skip


def whole_starts(dataset, report):
    """The same with starts fitted on all rows: what is left of the error is that of the law."""
    test = [s for s in dataset.scenes if s.name in report.dataset["test"]]
    found = with_states(report.fit, dataset, test)
    tracks = {
        name: nodes[0, 0, :, :, s].T
        for chains, nodes in zip(found.groups, found.nodes, strict=True)
        for s, name in enumerate(chains.scenes)
    }
    last = dataset.evaluation.endpoint_row - 1
    rows = []
    for scene in test:
        if LEFT_OUT not in scene.name and last < len(scene.times):
            error = tracks[scene.name][last, 1] - scene.positions[last, scene.dynamic[0], 1]
            rows.append({"scene": scene.name, "model": WHOLE, "endpoint_m": abs(error)})
    return rows


def interval(rows, function, rng, n_draws=2000):
    """90 % interval of a statistic of end-point errors, whole balls drawn anew."""
    balls = {}
    for row in rows:
        balls.setdefault(row["scene"].rsplit("_", 1)[0], []).append(row["endpoint_m"])
    balls = list(balls.values())
    picks = rng.integers(len(balls), size=(n_draws, len(balls)))
    draws = [function(np.concatenate([balls[k] for k in pick])) for pick in picks]
    return np.quantile(draws, (0.05, 0.95))


def pooled():
    """One drag law for all balls of known mass and radius, and each ball's own coefficient."""
    folder = reference_data("measured", "ball_drops")
    dataset = load_dataset(folder, train="*_drop1", test="*_drop2")
    balls = {
        e.name: e for s in dataset.scenes for e in s.entities
        if np.isfinite(e.mass) and np.isfinite(e.radius)
    }  # fmt: skip
    fits = {}
    for power, form in ((1, "v_i"), (2, "norm(v_i) * v_i")):
        laws = [DECLARED, f"-d1 * R_i^2 * {form}"]
        every = [s for s in dataset.scenes if s.names[s.dynamic[0]] in balls]
        own = {
            ball: _fitted(dataset, [s for s in every if ball in s.names], laws)
            for ball in balls
        }
        fits[power] = _fitted(dataset, every, laws), own
    return fits


def _fitted(dataset, scenes, laws):
    """The constant fitted to all of some scenes, half of its interval, and the log-evidence."""
    dataset = with_usable_masses(replace(dataset, scenes=tuple(scenes), train=(), test=()))
    hypothesis = Hypothesis.from_laws(dataset, laws)
    found = fit(hypothesis, dataset)
    half = Z_90 * float(found.covariance[0, 0]) ** 0.5
    return float(found.values[0]), half, log_evidence(found, hypothesis)


def told_of_pooled(fits):
    """Lines about the pooled law."""
    power = max(fits, key=lambda p: fits[p][0][2])
    (value, half, evidence), own = fits[power]
    unit, form = {1: ("kg/(m^2 s)", ""), 2: ("kg/m^3", "|v|")}[power]
    yield f"one law for all: -{value:.3g} ± {half:.2g} {unit} * R^2 * {form}v"
    worse = evidence - fits[2][0][2]
    size, error = (x / HALF_DENSITY for x in fits[2][0][:2])
    yield (f"    square in speed: drag coefficient {size:.2f} ± {error:.2f}"
           + (f", log evidence lower by {worse:.0f}" if worse > 0 else ""))  # fmt: skip
    for ball, (v, h, _) in own.items():
        off = (v - value) / np.hypot(h, half) * Z_90
        verdict = "  departs" if abs(off) > 3 else ""
        yield f"    {ball:20s} {v:8.3g} ± {h:.2g}  {off:+.1f} sd{verdict}"


def main():
    """Both directions, and the pooled law."""
    args = options(__doc__.splitlines()[0])
    rows = []
    for train, test in DIRECTIONS[: 1 if args.quick else 2]:
        more, report, told = run(train, test, args.seed)
        rows += more
        found = [r.effect.name for r in report.rounds if r.adopted]
        print(f"trained on {train}: {report.verdict}: {', '.join(found)}; {report.law_text}")
        for done in report.rounds:
            told.append(f"round {done.number}: {done.verdict} ({done.reason}), likeliest "
                        f"{getattr(done.effect, 'name', 'nothing')}")  # fmt: skip
        for line in told:
            print(f"    {line}")
        signs = [c.value for c in report.constants]
        print(f"    {sum(v > 0 for v in signs)} of {len(signs)} coefficients push forward")
    for label in ("declared", "adopted", WHOLE):
        mine = [row for row in rows if row["model"] == label]
        told = []
        for name, function in (("median", np.median), ("mean", np.mean)):
            value = function([row["endpoint_m"] for row in mine])
            low, high = interval(mine, function, np.random.default_rng(args.seed))
            told.append(f"{name} {value:.2f} m [{low:.2f}, {high:.2f}]")
        print(f"{label}: {len(mine)} predictions: end point {', '.join(told)}")
    for line in told_of_pooled(pooled()):
        print(line)
    write_table(rows, args.out / "results.csv")
    print(f"table: {args.out / 'results.csv'}")


if __name__ == "__main__":
    main()
