"""What a fit costs: against rows, bodies, periods and constants, beside solve_ivp + least_squares.

Processor time on one core, the best of three where that is short. The other fit is what a person
writes with scipy: the equation of motion by hand in numpy, `solve_ivp` (DOP853, 1e-8), slopes by
`2-point` differences, started 2 % from the truth; ours is started with nothing. "limit" is what
is asked of the case; a start is a factor on the true stiffness.
"""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, write_table, write_text
from fit_judging import constants_of, fitted
from fit_tracks import Shot, World, dataset_of, integrated
from fit_worlds import anchor, moving
from scipy.optimize import least_squares

MAX_PEER_ROWS = 30_000
STARTS = (0.5, 0.7, 1.4, 2.0)
TERMS = {
    "k": ("-k * (p_i - p_j)", 4.0, lambda p, v, c: -c * p),
    "c": ("-c * v_i", 0.02, lambda p, v, c: -c * v),
    "d": ("-d * norm(v_i) * v_i", 0.01, lambda p, v, c: -c * np.abs(v) * v),
    "f": ("f * e_x", 0.3, lambda p, v, c: c + 0 * v),
    "h": ("-h * norm(p_i - p_j)^2 * (p_i - p_j)", 0.2, lambda p, v, c: -c * p**3),
    "u": ("-u * norm(v_i)^2 * v_i", 0.002, lambda p, v, c: -c * v**3),
}


@dataclass(frozen=True, eq=False)
class Case:
    """One fit to time."""

    family: str
    size: float
    world: World
    acceleration: object
    limit: float | None = None
    ratio: float | None = None
    starts: tuple = (None,)


def line(n_rows, periods, names=("k", "c")):
    """A body of 1 kg on a spring along x, noise of 1 %."""

    def acceleration(t, p, v, c):
        return sum(TERMS[name][2](p, v, c[name]) for name in names)

    times = np.linspace(0.0, periods * np.pi, n_rows)
    shot = Shot(times, np.array([[[1.0]], [[0.4]]]), np.array(0.01))
    truth = {name: TERMS[name][1] for name in names}
    laws = tuple(TERMS[name][0] for name in names)
    entities = (moving("bob", 1.0), anchor())
    world = World("", laws, truth, entities, (shot,), integrated(acceleration), fixed=(0.0, 0.0))
    return world, acceleration


def crowd(rng, n_bodies, n_rows, n_scenes=1, span=6.0):
    """Bodies around a heavy one that moves as well, noise of 1 % of the innermost distance."""
    masses = np.array([50.0, *rng.uniform(0.5, 2.0, n_bodies - 1)])

    def acceleration(t, p, v, c):
        apart = p[:, None, :] - p[:, :, None]
        cube = (np.square(apart).sum(axis=-1) + np.eye(n_bodies)) ** 1.5
        return ((c["g"] * masses / cube)[..., None] * apart).sum(axis=2)

    shots = []
    for _ in range(n_scenes):
        radii = np.array([0.0, *(1.6 ** np.arange(n_bodies - 1))])
        angles = rng.uniform(0, 2 * np.pi, n_bodies)
        turn = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        speeds = np.sqrt(50 * 0.02 / np.maximum(radii, 1.0)) * (radii > 0) * rng.uniform(
            0.9, 1.1, n_bodies
        )
        states = np.stack([
            radii[:, None] * turn, speeds[:, None] * np.stack([-turn[:, 1], turn[:, 0]], axis=-1)
        ])  # fmt: skip
        shots.append(Shot(np.linspace(0.0, span, n_rows), states, np.array(0.01)))
    law = "g * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
    entities = tuple(moving(f"b{j}", m) for j, m in enumerate(masses))
    world = World("", (law,), {"g": 0.02}, entities, tuple(shots), integrated(acceleration))
    return world, acceleration


def cases(rng, is_quick):
    """All of them, the stated ones first."""
    yield Case("oscillator, 50 periods", 1000, *line(1000, 50, ("k",)), limit=0.2,
               starts=(None, *STARTS))  # fmt: skip
    yield Case("one track", 20_000, *line(20_000, 20), limit=2.0)
    yield Case("four bodies, two scenes", 30, *crowd(rng, 4, 30, 2), limit=0.3)
    yield Case("NBODY-like scene", 50, *crowd(rng, 4, 50), ratio=10.0)
    for exponent in range(2, 5 if is_quick else 7):
        yield Case("rows", 10**exponent, *line(10**exponent, 10))
    for n_bodies in (2, 4) if is_quick else (2, 4, 8, 12):
        yield Case("bodies", n_bodies, *crowd(rng, n_bodies, 60))
    for periods in (1, 10) if is_quick else (1, 5, 20, 50, 100):
        yield Case("periods", periods, *line(1000, periods))
    for count in (1, 3) if is_quick else range(1, len(TERMS) + 1):
        yield Case("constants", count, *line(1000, 5, tuple(TERMS)[:count]))


def ours(case, dataset, rng, start, deadline):
    """Seconds of the fit, its status, and how far it is from the truth."""
    best = np.inf
    starts = {"k": start * case.world.truth["k"]} if start else None
    for _ in range(3):
        found, facts = fitted(
            dataset, case.world.laws, rng=rng.spawn(1)[0], starts=starts, deadline=deadline
        )
        best = min(best, facts["cpu_s"])
        if best > 1.0:
            break
    row = {"seconds": best, "status": facts["status"], "error": facts["error"]}
    if found is not None and np.isfinite(found.values).all():
        values, covariance = constants_of(found, case.world)
        deviation = (values - case.world.values) / np.sqrt(np.diag(covariance))
        row["largest_deviation"] = float(np.abs(deviation).max())
    return row


def theirs(case, dataset):
    """Seconds of solve_ivp + least_squares."""
    world = replace(case.world, track=integrated(case.acceleration, accuracy=1e-8))
    names, shots = list(world.truth), world.shots
    ends = np.cumsum([len(names), *(shot.states.size for shot in shots)])

    def left(x):
        constants = {name: x[k : k + 1] for k, name in enumerate(names)}
        parts = []
        for shot, scene, a, b in zip(shots, dataset.scenes, ends[:-1], ends[1:], strict=True):
            shape = shot.states.shape
            found = world.track(shot.times, constants, x[a:b].reshape(1, *shape))[0]
            seen = scene.positions[:, : shape[1], : shape[2]]
            parts.append(((found - seen) / shot.sigma).ravel())
        return np.concatenate(parts)

    start = np.concatenate([1.02 * world.values, *(shot.states.ravel() for shot in shots)])
    began = time.process_time()
    least_squares(left, start, jac="2-point", x_scale="jac")
    return time.process_time() - began


def run(case, rng, deadline):
    """Rows of the table: one for each start."""
    dataset = dataset_of(case.world, rng)
    is_asked = len(case.world.shots[0].times) <= MAX_PEER_ROWS
    peer = theirs(case, dataset) if is_asked else np.nan
    rows = []
    for start in case.starts:
        row = ours(case, dataset, rng, start, deadline)
        ratio = peer / row["seconds"]
        is_met = "" if case.limit is None and case.ratio is None else bool(
            row["status"] == "converged"
            and (case.limit is None or row["seconds"] <= case.limit)
            and (case.ratio is None or ratio >= case.ratio)
        )  # fmt: skip
        asked = f"<= {case.limit} s" if case.limit else f">= {case.ratio} x" if case.ratio else ""
        rows.append({
            "family": case.family, "size": case.size, "start": start or "", **row,
            "scipy_seconds": peer, "ratio": ratio, "asked": asked, "met": is_met,
        })  # fmt: skip
    return rows


def main(argv=None):
    args = options(
        __doc__.splitlines()[0], argv,
        lambda parser: parser.add_argument("--time-limit", type=float, default=120.0),
    )  # fmt: skip
    args.out = Path("runs") / "bench-fits" if args.out == Path("runs/fits") else args.out
    rng, rows = np.random.default_rng(args.seed), []
    for item in cases(rng, args.quick):
        rows += run(item, rng, args.time_limit)
        write_table(rows, args.out / "results.csv")
        print(f"{item.family} {item.size}: {rows[-1]['seconds']:.3g} s", flush=True)
    lines = ["# Seconds of a fit on one core", "",
             "| case | size | start | s | status | z | scipy, s | ratio | asked | met |",
             "|" + "---|" * 10]  # fmt: skip
    lines += [
        f"| {r['family']} | {r['size']} | {r['start']} | {r['seconds']:.3g} | {r['status']} "
        f"| {r.get('largest_deviation', np.nan):.2f} | {r['scipy_seconds']:.3g} "
        f"| {r['ratio']:.3g} | {r['asked']} | {r['met']} |"
        for r in rows
    ]
    text = "\n".join(lines) + "\n"
    write_text(text, args.out / "summary.md")
    print(text)


if __name__ == "__main__":
    main()
