"""Made-up scenes of physics engines: as the paper's? Which laws do searches find on them?

Four tables: zero_force.csv (the paper's scenes and ours, error without any force), results.csv
(what the exhaustive search finds on NBODY, BOUNCE and MAT of several engines and step sizes),
contacts.csv (what engines make of the collision of two discs), cradle.csv (of three at once).
"""

import time

import numpy as np
import second_engine
from common import options, reference_data, whole, write_table, write_text

from bsp_gp.cli_inputs import masked_grammar
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import EvaluationError, MissingDependencyError
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, split_linear
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.metrics import one_step_nrmse
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.exhaustive import search_exhaustive
from bsp_gp.simulate.engine import Contacts, Motion, run_pymunk
from bsp_gp.simulate.synth import make, preset
from bsp_gp.simulate.world import States, World, disc

SYNTH = ("nbody", "bounce", "mat")
TRUE = {
    "nbody": "c1 * (m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i))",
    "bounce": "c1 * (m_i * m_j / (m_i + m_j) * abs(along(v_i - v_j, p_i - p_c)) "
    "* normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j))",
    "mat": "c1 * (mu_j * m_i * normalize(v_i) * is_on(s_i, p_i, s_j, p_j))",
}
ENGINES = {
    "pymunk": run_pymunk,
    "rebound": second_engine.run_rebound,
    "mujoco": second_engine.run_mujoco,
}
# Engine and steps per frame. rebound has no walls, and neither of the two has mats; a contact of
# mujoco's takes 2 ms, which its steps must resolve.
CASES = {
    "nbody": (("pymunk", 1), ("pymunk", 4), ("pymunk", 20), ("rebound", 1)),
    "bounce": (("pymunk", 1), ("pymunk", 4), ("pymunk", 20), ("mujoco", 100)),
    "mat": (("pymunk", 1), ("pymunk", 4), ("pymunk", 20)),
}
N_TRAIN = {"nbody": (2, 5), "bounce": (2, 5), "mat": (2, 5, 20)}
N_TEST = 20


def bounce_by_law(projection):
    """An engine that moves balls by a collision force, a leapfrog step a frame, as the paper's.

    While two bodies overlap, 2 m_i m_j / (m_i + m_j) / dt times the approach speed pushes i away
    from the point of contact. `projection` is "paper" (sum of |u_k dv_k| over axes) or "true".
    """

    def engine(worlds, motion):
        moved = [_bounce_world(world, motion, projection) for world in worlds]
        positions, velocities = (np.stack(parts) for parts in zip(*moved, strict=True))
        shape = (len(worlds), motion.n_frames - 1, positions.shape[2])
        times = motion.dt * np.arange(motion.n_frames)
        return States(times, positions, velocities, np.zeros(shape, dtype=bool))

    return engine


def _bounce_world(world, motion, projection):
    p, v, h = np.array(world.positions), np.array(world.velocities), motion.dt
    positions, velocities = [p.copy()], [v.copy()]
    v = v + _bounce_kick(world, p, v, h, projection) / 2
    for _ in range(motion.n_frames - 1):
        p = p + h * v
        kick = _bounce_kick(world, p, v, h, projection)
        v = v + kick
        positions.append(p.copy())
        velocities.append(v - kick / 2)
    return np.array(positions), np.array(velocities)


def _bounce_kick(world, p, v, h, projection):
    """Change of velocity within one step."""
    out = np.zeros_like(v)
    for i, a in enumerate(world.entities):
        for j, b in enumerate(world.entities):
            if a.is_static or i == j:
                continue
            gap, foot = p[i] - p[j], p[j].copy()
            if b.shape == "rect_wall":
                hits = abs(gap[0]) < b.width / 2 + a.radius and abs(gap[1]) < (
                    b.height / 2 + a.radius
                )
                axis = 0 if b.width > b.height else 1
                foot[axis] = p[i, axis]
            else:
                hits = np.hypot(*gap) < a.radius + b.radius
            if not hits:
                continue
            u = (p[i] - foot) / np.linalg.norm(p[i] - foot)
            product = u * (v[i] - v[j])
            size = np.abs(product).sum() if projection == "paper" else abs(product.sum())
            out[i] += 2 * b.mass / (a.mass + b.mass) * size * u
    return out


# --- without any force ----------------------------------------------------------------------------


def zero_force(n_scenes, seeds):
    """Errors without any force of the paper's scenes, of ours, and of BOUNCE moved by its law."""
    rows = []
    for name in SYNTH:
        data = load_dataset(reference_data("synth", name))
        rows.append(zero_row(name, "paper's data", -1, data.scenes))
        rows.append(zero_row(name, "paper's data, test scenes", -1, data.select(data.test)))
        engines = {"pymunk": run_pymunk}
        if name == "bounce":
            engines["elastic law"] = bounce_by_law("true")
            engines["paper's law"] = bounce_by_law("paper")
        for source, engine in engines.items():
            for seed in seeds:
                settings = preset(name, n_scenes=n_scenes)
                made, truth = make(settings, np.random.default_rng(seed), engine)
                rows.append(zero_row(name, source, seed, made.scenes, truth))
    return rows


def zero_row(name, source, seed, scenes, truth=None):
    errors = np.array([one_step_nrmse([scene], ForceLaw()) for scene in scenes])
    return {
        "scenario": name, "source": source, "seed": seed, "n_scenes": len(scenes),
        "nrmse": errors.mean(), "standard_error": errors.std(ddof=1) / np.sqrt(len(errors)),
        "energy_ratio": np.mean([kinetic_ratio(scene) for scene in scenes]),
    }  # fmt: skip


def kinetic_ratio(scene):
    """Kinetic energy at the end over that at the start, from differences of positions."""
    steps = np.diff(scene.positions[:, scene.dynamic], axis=0)
    masses = np.array([scene.entities[k].mass for k in scene.dynamic])
    energy = (masses * (steps**2).sum(axis=-1)).sum(axis=-1)
    return energy[-1] / energy[0]


# --- what is found --------------------------------------------------------------------------------


def search(name, engine, substeps, grammar_name, n_train, seed):
    """One search; the row of the table."""
    settings = preset(name, n_scenes=n_train + N_TEST, substeps=substeps)
    dataset, _ = make(settings, np.random.default_rng(seed), ENGINES[engine])
    train, test = dataset.scenes[:n_train], dataset.scenes[n_train:]
    types = dataset_types(dataset)
    grammar = load_grammar(grammar_name)
    if grammar_name == "physics":
        grammar, missing = masked_grammar(grammar, dataset)
    else:
        grammar, missing = grammar.masked(set(types), 2)
    regression = build_regression(train)
    started = time.process_time()
    result = search_exhaustive(regression, grammar, kind="pair", missing_inputs=missing)
    seconds = time.process_time() - started
    best = result.best
    found = ForceLaw([Term(best.formula, "pair")]).with_constants(best.constants)
    true = ForceLaw([Term(parse_formula(TRUE[name], types), "pair")])
    true = fit_constants(regression, true.with_constants({"c1": 1.0})).law
    everywhere = build_regression(dataset.scenes)
    same = [cosine(everywhere, f, true.terms[0].formula) for f in (best.formula, *best.ties)]
    return {
        "scenario": name, "engine": engine, "substeps": substeps, "grammar": grammar_name,
        "n_train": n_train, "seed": seed, "laws": result.n_evaluated, "cpu_s": seconds,
        "law": to_text(best.formula), "constant": float(next(iter(best.constants.values()))),
        "ties": len(best.ties), "is_true": max(same) > 1 - 1e-10, "cosine": same[0],
        "left": 2 * best.loss / best.total,
        "next_left": 2 * result.candidates[1].loss / best.total,
        "true_constant": true.constants["c1"],
        "nrmse_zero": one_step_nrmse(test, ForceLaw()), "nrmse_found": held_out(test, found),
        "nrmse_true": one_step_nrmse(test, true),
    }  # fmt: skip


def held_out(scenes, law):
    """The error of a law, nan where it has no finite value on scenes that it was not found on."""
    try:
        return one_step_nrmse(scenes, law)
    except EvaluationError:
        return np.nan


def cosine(regression, one, other):
    """Likeness of two laws without their constants, on all scenes: 1 if they are proportional."""
    try:
        columns = [
            regression.column(Term(split_linear(f)[1], "pair"))[0][:, 0] for f in (one, other)
        ]
    except EvaluationError:  # no finite value somewhere, which the true laws have
        return 0.0
    a, b = (c / (np.linalg.norm(c) or 1.0) for c in columns)
    return float(abs(a @ b))


# --- contacts -------------------------------------------------------------------------------------


def pairs(n, rng):
    """Worlds of two discs of radius 1 that will meet, at 1 to 5 m/s."""
    worlds = []
    for _ in range(n):
        masses, speed = rng.uniform(0.5, 5, 2), rng.uniform(1, 5)
        offset = rng.uniform(-1.6, 1.6)
        share = masses[1] / masses.sum()
        v = [(speed * share, 0), (-speed * (1 - share), 0)]
        start = np.array([(0, 0), (2.0 + speed * rng.uniform(0.1, 0.4), offset)])
        worlds.append(World([disc("1", 1, masses[0]), disc("2", 1, masses[1])], start, v))
    return worlds


def exact_pair(world, restitution, t):
    """Places and velocities at time t of two discs that meet as the law says, at an instant."""
    p, v = np.array(world.positions), np.array(world.velocities)
    masses = np.array([e.mass for e in world.entities])
    gap, speed = p[1] - p[0], v[1] - v[0]
    b, c = gap @ speed, gap @ gap - 4.0
    when = (-b - np.sqrt(b * b - speed @ speed * c)) / (speed @ speed)
    u = (gap + speed * when) / 2.0
    push = (1 + restitution) * (speed @ u) * masses.prod() / masses.sum()
    after = v + np.array([push * u / masses[0], -push * u / masses[1]])
    return p + v * when + after * (t - when), after, -(speed @ u)


def contact_rows(engine, substeps, restitution, n_pairs, seed):
    worlds = pairs(n_pairs, np.random.default_rng(seed))
    motion = Motion((), 51, 0.02, substeps, Contacts(restitution=restitution))
    started = time.process_time()
    states = ENGINES[engine](worlds, motion)
    seconds = time.process_time() - started
    shift, back, energy, momentum = [], [], [], []
    for k, world in enumerate(worlds):
        masses = np.array([[e.mass] for e in world.entities])
        p, v, approach = exact_pair(world, restitution, states.times[-1])
        got = states.velocities[k, -1]
        start = world.velocities
        shift.append(np.abs(states.positions[k, -1] - p).max() / approach)
        u = (v - start)[1] / np.linalg.norm((v - start)[1])
        back.append(((got[1] - got[0]) @ u) / approach)
        energy.append((masses * got**2).sum() / (masses * v**2).sum() - 1)
        momentum.append(np.abs((masses * (got - start)).sum(axis=0)).max())
    return {
        "engine": engine, "substeps": substeps, "restitution": restitution, "n_pairs": n_pairs,
        "seed": seed, "measured": np.mean(back), "measured_sd": np.std(back),
        "energy_error": np.mean(energy), "momentum_error": np.max(momentum),
        "place_error_ms": 1e3 * np.mean(shift), "cpu_s": seconds,
    }  # fmt: skip


def cradle_row(engine, substeps, iterations, gap):
    """A disc hits two that touch (or nearly): speeds along the line of the three."""
    places = [(-3.0, 0.0), (0.0, 0.0), (2.0 + gap, 0.0)]
    world = World([disc(str(k), 1.0, 1.0) for k in range(3)], places, [(2, 0), (0, 0), (0, 0)])
    motion = Motion((), 51, 0.02, substeps, Contacts(iterations=iterations))
    v = ENGINES[engine]([world], motion).velocities[0, -1, :, 0]
    return {
        "engine": engine, "substeps": substeps, "iterations": iterations, "gap": gap,
        "v1": v[0], "v2": v[1], "v3": v[2], "energy_ratio": (v**2).sum() / 4,
    }  # fmt: skip


# --- all of it ------------------------------------------------------------------------------------


def main():
    args = options(__doc__.splitlines()[0])
    seeds = range(args.seed, args.seed + (1 if args.quick else 3))
    zero = table(args, "zero_force.csv", lambda: zero_force(100, seeds))
    searches = [
        {"name": name, "engine": engine, "substeps": substeps, "grammar_name": grammar,
         "n_train": n_train, "seed": seed}
        for name in SYNTH
        for engine, substeps in CASES[name]
        for grammar in ("newtonian", "physics")
        for n_train in ((2,) if args.quick else N_TRAIN[name])
        for seed in (seeds if not args.quick else seeds[:1])
        if engine != "mujoco" or n_train == 2  # its small steps take a while
    ]  # fmt: skip
    results = resumed(args, "results.csv", searches, search)
    hits = [
        {"engine": engine, "substeps": substeps, "restitution": e,
         "n_pairs": 20 if args.quick else 100, "seed": args.seed}
        for engine, steps in (("pymunk", (1, 4, 20)), ("rebound", (1, 4, 20)),
                              ("mujoco", (20, 100)))
        for substeps in steps
        for e in (0.0, 0.3, 0.6, 0.9, 1.0)
    ]  # fmt: skip
    contacts = resumed(args, "contacts.csv", hits, contact_rows)
    cradles = [
        {"engine": engine, "substeps": substeps, "iterations": iterations, "gap": gap}
        for engine, substeps, counts in (
            ("pymunk", 20, (1, 5, 20, 100)), ("rebound", 20, (20,)), ("mujoco", 100, (20,)),
        )
        for iterations in counts
        for gap in (0.0, 0.01, 0.1)
    ]  # fmt: skip
    cradle = resumed(args, "cradle.csv", cradles, cradle_row)
    draw(args.out / "engines.png", zero, results, contacts)
    text = summary(zero, results, contacts, cradle)
    write_text(text, args.out / "summary.md")
    print(text)
    print(f"tables, figure and summary: {args.out}")


def table(args, name, make_rows):
    """A table that is made in one go, or read if it is there."""
    import pandas as pd

    path = args.out / name
    if not path.exists():
        write_table(make_rows(), path)
    return pd.read_csv(path)


def resumed(args, name, cases, run):
    """Rows of all cases, those of an older run kept; written after every case."""
    import pandas as pd

    path = args.out / name
    log = path.with_suffix(".done")
    rows = pd.read_csv(path).to_dict("records") if path.exists() and log.exists() else []
    done = log.read_text().splitlines()[: len(rows)] if rows else []
    missing = set()
    for case in cases:
        key = repr(sorted(case.items()))
        if key in done or case["engine"] in missing:
            continue
        try:
            row = run(**case)
        except MissingDependencyError as error:
            print(error)
            missing.add(case["engine"])
            continue
        rows.append(row)
        done.append(key)
        write_table(rows, path)
        write_text("\n".join(done), log)
        shown = {k: f"{v:.3g}" if isinstance(v, float) else v for k, v in row.items()}
        print(" ".join(str(v) for v in shown.values()), flush=True)
    return pd.read_csv(path)


def draw(path, zero, results, contacts):
    from bsp_gp.report.drawing import AFTER, BEFORE, FLOOR, log_ticks, new_figure, png_bytes, tidy

    def panels(figure):
        left, middle, right = figure.subplots(1, 3)
        for k, name in enumerate(SYNTH):
            part = zero[zero.scenario == name]
            scale = float(part[part.source == "paper's data"].nrmse.iloc[0])
            for source, colour, shift in (
                ("paper's data", FLOOR, -0.2), ("pymunk", AFTER, 0.0), ("paper's law", BEFORE, 0.2),
            ):  # fmt: skip
                rows = part[part.source == source]
                left.errorbar(
                    k + shift + np.linspace(-0.06, 0.06, len(rows)), rows.nrmse / scale,
                    rows.standard_error / scale, fmt="o", ms=3, lw=0.8, color=colour,
                    label={"paper's law": "moved by its law"}.get(source, source)
                    if k == 1 else None,
                )  # fmt: skip
        left.axhspan(0.75, 1.25, color="#EEEEEE", zorder=0, lw=0)
        left.set_xticks(range(3), [name.upper() for name in SYNTH])
        left.set_title("error without force,\nover that of the paper's data")
        left.set_ylim(bottom=0)
        left.legend(frameon=False, loc="lower left")
        found = results[(results.engine == "pymunk") & (results.grammar == "physics")]
        found = found[found.n_train == found.n_train.max()]
        for name, colour in zip(SYNTH, (FLOOR, BEFORE, AFTER), strict=True):
            part = found[found.scenario == name].groupby("substeps")
            ratio = part.nrmse_true.median() / part.nrmse_zero.median()
            middle.plot(
                ratio.index, np.maximum(ratio, 1e-13), "o-", ms=3, lw=1, color=colour,
                label=name.upper(),
            )  # fmt: skip
        middle.set(xscale="log", yscale="log", xlabel="engine's steps per frame")
        middle.set_xticks([1, 4, 20], ["1", "4", "20"])
        middle.minorticks_off()
        log_ticks(middle.yaxis)
        middle.set_title("held-out error of the true law,\nover that of no force")
        middle.legend(frameon=False)
        styles = (("pymunk", AFTER, "o-"), ("rebound", FLOOR, "x:"), ("mujoco", BEFORE, "o-"))
        for engine, colour, mark in styles:
            part = contacts[contacts.engine == engine]
            part = part[part.substeps == part.substeps.max()]
            if len(part):
                right.errorbar(part.restitution, part.measured - part.restitution,
                               part.measured_sd, fmt=mark, ms=4, lw=1, color=colour,
                               label=engine)  # fmt: skip
        right.set_title("restitution,\nmeasured less nominal")
        right.set_xlabel("nominal restitution")
        right.legend(frameon=False)
        for axes in (left, middle, right):
            tidy(axes)
        left.set_xticks(range(3), [name.upper() for name in SYNTH])
        middle.set_xticks([1, 4, 20], ["1", "4", "20"])

    with whole(path) as part:
        part.write_bytes(png_bytes(new_figure(panels, 3.0)))


def summary(zero, results, contacts, cradle):
    """What came out, beside the paper's figures."""
    lines = ["# Scenes made by engines", "", "## Error without any force", ""]
    lines += [
        "| scenario | source | nRMSE | ± s.e. | energy, end / start |",
        "|---|---|---|---|---|",
    ]
    for (name, source), part in zero.groupby(["scenario", "source"], sort=False):
        lines.append(
            f"| {name.upper()} | {source} | {part.nrmse.mean():.4g} "
            f"| {part.standard_error.mean() / np.sqrt(len(part)):.2g} "
            f"| {part.energy_ratio.mean():.3f} |"
        )
    lines += [
        "", "The paper prints 1.768, 0.05984 and 0.001199, on its 20 test scenes.", "",
        "## What the exhaustive search finds", "",
        "| scenario | engine | steps | grammar | scenes | true law leads | constant (true law) "
        "| left, median | held-out nRMSE: zero, true law, found |",
        "|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    keys = ["scenario", "engine", "substeps", "grammar", "n_train"]
    for key, part in results.groupby(keys, sort=False):
        name, engine, substeps, grammar, n_train = key
        errors = [part[f"nrmse_{k}"].median() for k in ("zero", "true", "found")]
        lines.append(
            f"| {name.upper()} | {engine} | {substeps} | {grammar} | {n_train} "
            f"| {int(part.is_true.sum())}/{len(part)} | {part.true_constant.median():.6g} "
            f"| {part.left.median():.1e} | {', '.join(f'{e:.3g}' for e in errors)} |"
        )
    lines += ["", "Laws of BOUNCE found, an example each:", ""]
    part = results[results.scenario == "bounce"]
    for key, rows in part.groupby(["engine", "substeps", "grammar"], sort=False):
        row = rows.iloc[-1]
        lines.append(
            f"- {key[0]}, {key[1]} step(s), {key[2]}: {row.constant:.5g} for c1 in `{row.law}`"
        )
    lines += [
        "", "## Two discs that meet", "",
        "| engine | steps per frame | restitution | measured | sd | energy error "
        "| place error over speed, ms |", "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in contacts.itertuples():
        lines.append(
            f"| {row.engine} | {row.substeps} | {row.restitution} | {row.measured:.4f} "
            f"| {row.measured_sd:.1e} | {row.energy_error:.1e} | {row.place_error_ms:.2f} |"
        )
    lines += [
        "", "## Three in a row, one hits two (speed 2; elastic by pairs: 0, 0, 2)", "",
        "| engine | steps | iterations | gap | speeds | energy |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in cradle.itertuples():
        lines.append(
            f"| {row.engine} | {row.substeps} | {row.iterations} | {row.gap} "
            f"| {row.v1:.3f}, {row.v2:.3f}, {row.v3:.3f} | {row.energy_ratio:.4f} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
