"""Eleven balls dropped from a bridge: the loop trained on one drop of each, tested on the other.

The 12-frame protocol: both directions, ten balls (one drop of the bowling ball is too short), 20
predictions. The loop asks the other drops whether they contradict a law; which law the training
drops choose by themselves, later rows against earlier ones, is told beside it. The start of a
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
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.bootstrap import bootstrap, strength
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.effects import EffectSearch
from bsp_gp.loop.memory import search_with_memory
from bsp_gp.loop.preparing import observe
from bsp_gp.workers import worker_pool

DECLARED = "9.81 [m/s^2] * m_i * down"
LEFT_OUT = "bowling_ball"
HALF_DENSITY = 0.5 * 1.2 * np.pi
"""Half the density of air, kg/m^3, times pi: drag is this times C_d R^2 |v| v."""
Z_90 = 1.645
DIRECTIONS = (("*_drop1", "*_drop2"), ("*_drop2", "*_drop1"))
EARLY = 0.7
"""Part of a training drop from which a law is chosen without a look at the other drops."""
N_SIMULATED = 99
"""Data sets of the bootstrap."""
WHOLE = "adopted, starts fitted on all rows"


def run(train, test, seed, pool):
    """One direction: rows of the table, the report, and lines about the choice of its law."""
    dataset = load_dataset(reference_data("measured", "ball_drops"), train=train, test=test)
    loop_rng, rng, significance_rng, alone_rng = np.random.default_rng(seed).spawn(4)
    started = time.perf_counter()
    report = close_loop(dataset, [DECLARED], rng=loop_rng, seed=seed, workers=pool)
    declared = declared_law(dataset, [DECLARED])
    observation = observe(dataset, declared, rng, sources=False)
    significance = simulated(observation, declared, significance_rng, pool)
    told = [significance.text(), f"loop and bootstrap: {time.perf_counter() - started:.0f} s"]
    alone = close_loop(in_time(dataset), [DECLARED], rng=alone_rng, workers=pool).rounds[0]
    same = alone.effect.law == report.rounds[0].effect.law
    told.append(f"from the training drops alone, their first {EARLY:.0%} against the rest: "
                f"{alone.effect.name} ({alone.verdict}), {'the same' if same else 'another'} law")
    rows = []
    for held_out in report.rounds[0].held_out:  # the loop's own, under the noise that it found
        if LEFT_OUT not in held_out["scene"]:
            for label, key in (("declared", "endpoint_before"), ("adopted", "endpoint_after")):
                rows.append(
                    {"scene": held_out["scene"], "model": label, "endpoint_m": held_out[key]}
                )
    observation = replace(observation, memory=report.noise["memory_s"])
    return rows + whole_starts(observation, report.law), report, told


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


def simulated(observation, law, rng, pool):
    """The search on data that the declared law would have made, without any gate before it."""
    search_rng, rng = rng.spawn(2)
    search = EffectSearch(observation, load_grammar("physics"), n_null=0)
    fit = observation.fit(law)
    _, _, proposals = search_with_memory(search, fit, search_rng)
    return bootstrap(search, fit, strength(proposals), rng, n_max=N_SIMULATED, workers=pool)


def whole_starts(observation, law):
    """The same with starts fitted on all rows: what is left of the error is that of the law."""
    tracks = observation.held_out_tracks(law)
    last = observation.dataset.evaluation.endpoint_row - 1
    rows = []
    for scene in observation.test:
        if LEFT_OUT not in scene.name and last < len(scene.times):
            error = tracks[scene.name][0][last, 0, 1] - scene.positions[last, scene.dynamic[0], 1]
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


def pooled(seed):
    """One drag law for all balls of known mass and radius, and each ball's own coefficient."""
    folder = reference_data("measured", "ball_drops")
    dataset = load_dataset(folder, train="*_drop1", test="*_drop2")
    balls = {
        e.name: e for s in dataset.scenes for e in s.entities
        if np.isfinite(e.mass) and np.isfinite(e.radius)
    }  # fmt: skip
    known = [s for s in dataset.scenes if s.names[s.dynamic[0]] in balls]
    fits = {}
    for power, form in ((1, "v_i"), (2, "norm(v_i) * v_i")):
        law = declared_law(dataset, [DECLARED, f"-d1 * R_i^2 * {form}"])
        part = replace(dataset, scenes=tuple(known), train=(), test=())
        observation = observe(part, law, np.random.default_rng(seed), sources=False)
        scenes = (*observation.train, *observation.test)
        fit = observation.with_train(scenes).fit(law)
        own = law.with_constants({"d1": dict.fromkeys(balls, 1.0)})
        fits[power] = fit, observation.with_train(scenes).fit(own, start=own)
    return fits


def told_of_pooled(fits):
    """Lines about the pooled law."""
    n_eff = fits[1][0].n_effective
    power = min(fits, key=lambda p: fits[p][0].bic(n_eff))
    common, own = fits[power]
    value, half = common.values[0], common.intervals[0]
    unit, form = {1: ("kg/(m^2 s)", ""), 2: ("kg/m^3", "|v|")}[power]
    yield f"one law for all: -{value:.3g} ± {half:.2g} {unit} * R^2 * {form}v"
    square = fits[2][0]
    worse = square.bic(n_eff) - common.bic(n_eff)
    size, error = square.values[0] / HALF_DENSITY, square.intervals[0] / HALF_DENSITY
    yield (f"    square in speed: drag coefficient {size:.2f} ± {error:.2f}"
           + (f", BIC higher by {worse:.0f}" if worse > 0 else ""))  # fmt: skip
    gain = common.bic(n_eff) - own.bic(n_eff)
    yield f"    with a coefficient for each ball BIC falls by {gain:.0f}"
    for (_, ball), v, h in zip(own.parameters, own.values, own.intervals, strict=True):
        off = (v - value) / np.hypot(h, half) * Z_90
        verdict = "  departs" if abs(off) > 3 else ""
        yield f"    {ball:20s} {v:8.3g} ± {h:.2g}  {off:+.1f} sd{verdict}"


def main():
    args = options(__doc__.splitlines()[0])
    with worker_pool(args.workers) as pool:
        study(args, pool)


def study(args, pool):
    """Both directions, and the pooled law."""
    rows = []
    for train, test in DIRECTIONS[: 1 if args.quick else 2]:
        more, report, told = run(train, test, args.seed, pool)
        rows += more
        found = [r.effect.name for r in report.rounds if r.adopted]
        print(f"trained on {train}: {report.verdict}: {', '.join(found)}; {report.law_text}")
        for line in told:
            print(f"    {line}")
        watson = [f"{r.missing.durbin_watson:.2f}" for r in report.rounds]
        print(f"    Durbin-Watson of the whitened residual, round by round: {', '.join(watson)}")
        signs = [c.value for c in report.constants]
        print(f"    {sum(v > 0 for v in signs)} of {len(signs)} coefficients push forward")
        for rival in report.rounds[0].rivals:
            if rival.kind == "declared_term_change":
                print(f"    rival: {rival.name}: {rival.reason}")
        for note in report.notes:
            if "cannot be told from" in note:
                print(f"    {note}")
    for label in ("declared", "adopted", WHOLE):
        mine = [row for row in rows if row["model"] == label]
        told = []
        for name, function in (("median", np.median), ("mean", np.mean)):
            value = function([row["endpoint_m"] for row in mine])
            low, high = interval(mine, function, np.random.default_rng(args.seed))
            told.append(f"{name} {value:.2f} m [{low:.2f}, {high:.2f}]")
        print(f"{label}: {len(mine)} predictions: end point {', '.join(told)}")
    for line in told_of_pooled(pooled(args.seed)):
        print(line)
    write_table(rows, args.out / "results.csv")
    print(f"table: {args.out / 'results.csv'}")


if __name__ == "__main__":
    main()
