"""NewtonBench (HKUST-KnowComp/NewtonBench), modules m0 to m2, without a language model.

Two bodies, one held fast at the origin: `bsp_gp.discover` chooses what they are and how far apart,
and finds the force. Every experiment is so short that the force hardly changes in it: then neither
the coarse steps of the benchmark nor charges that fade are seen, and every speed that it shows is
one measurement of the force. A form is right if, its exponents rounded to 0.1, it is the true one
but for a constant; its error is that over the benchmark's test range.

    python experiments/scoreboards/newton_bench.py --repo PATH --out DIR [--systems simple_system]
"""

import importlib
import json
import sys
import time
import types
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, whole, write_table
from forms import with_rounded_powers

import bsp_gp
from bsp_gp.errors import BspError
from bsp_gp.planning.apparatus import Recording
from bsp_gp.planning.means import Experiment, means_from

ROWS = 6
"""Measurements of the force in an experiment."""
SHOWN = 20
"""Rows that the benchmark shows at most."""
MOVED = 1e-4, 0.03
"""Part of the distance by which a body moves in a recording, and that part per noise."""
CHANGE = 3.0
"""Relative change of a force per relative change of the distance, about."""
COORDINATE = 1e-6
"""Noise of a coordinate, as a part, that the planner reckons with: errors are those of forces."""
ROUNDS, AT_ONCE = 3, 16
LEAST_FORCE, LEAST_SPEED = 1e-12, 1e-9
"""Floors of its noise, N and m/s; that of energies is 1e-9 J."""
RIGHT = 1e-2
"""Relative error of a law that is right."""
TENTH, ALIKE = 0.1, 3e-3
"""To what exponents are rounded, and how far constants may differ that are one."""
SYSTEMS = "vanilla_equation", "simple_system", "complex_system"
MODULES = {
    "m0_gravity": {
        "names": ("mass1", "mass2"), "property": "mass", "sense": -1,
        "ranges": ("1..1000", "1..1000", "1..10"), "test": ((0, 3), (0, 3), (0, 1)),
    },
    "m1_coulomb_force": {
        "names": ("q1", "q2"), "property": "charge", "sense": 1,
        "ranges": ("0.1..10",) * 3, "test": ((-1, 1),) * 3,
    },
    "m2_magnetic_force": {
        "names": ("current1", "current2"), "property": "current", "sense": -1,
        "ranges": ("0.001..0.1",) * 3, "test": ((-3, -1),) * 3,
    },
}  # fmt: skip
"""Per module: names of its arguments, ranges of properties and places that are tried, whether the
force pushes (1) or pulls (its texts say so), and decades of its test."""


def main(argv=None):
    args = options(__doc__.splitlines()[0], argv, declare)
    sys.path.insert(0, str(args.repo.resolve()))
    sys.modules["utils.call_llm_api"] = types.ModuleType("utils.call_llm_api")
    sys.modules["utils.call_llm_api"].call_llm_api = None  # no language model is asked
    items = [
        (module, system, difficulty, version, noise)
        for noise in args.noise for system in args.systems for module in args.modules
        for difficulty in ("easy", "medium", "hard") for version in ("v0", "v1", "v2")
    ]  # fmt: skip
    order = np.random.default_rng(args.seed).permutation(len(items))
    items = [items[k] for k in order][: 2 if args.quick else args.most]
    rows = []
    for item in items:
        name = "-".join(map(str, item))
        path = args.out / "items" / f"{name}.json"
        if not path.exists():
            with whole(path) as part:
                part.write_text(json.dumps(judged(*item, args.seed, args.limit)), encoding="utf-8")
        rows.append(json.loads(path.read_text(encoding="utf-8")))
        print(name, {k: rows[-1][k] for k in ("is_form", "error", "law", "cpu_s")}, flush=True)
        write_table(rows, args.out / "results.csv")
    table = pd.DataFrame(rows)
    table["is_right"] = table.is_form & (table.error <= RIGHT)
    print(table.groupby(["noise", "system", "module"]).is_right.agg(["sum", "count"]).to_string())


def declare(parser):
    parser.add_argument("--repo", type=Path, required=True, help="checkout of the benchmark")
    parser.add_argument("--modules", nargs="+", default=list(MODULES), choices=list(MODULES))
    parser.add_argument("--systems", nargs="+", default=list(SYSTEMS), choices=SYSTEMS)
    parser.add_argument("--noise", nargs="+", type=float, default=[0.0, 1e-4, 1e-2])
    parser.add_argument("--limit", type=float, default=30.0, help="s of a closing of the loop")
    parser.add_argument("--most", type=int, default=1000, help="items, by chance")


def means_of(module):
    """What the benchmark lets be chosen: two properties and a distance; the probe is at rest.

    From rest, since errors are a part of the speed: a speed that was given hides what is gained.
    """
    said = MODULES[module]
    name, (source, probe, distance) = said["property"], said["ranges"]
    units = {"mass": {}, "charge": {}, "current": {"current": "A"}}[name]
    return means_from({
        "bodies": {"probe": {"x": distance, "vx": 0.0, name: probe},
                   "source": {"dynamic": 0, "x": 0, name: source}},
        "units": units,
        "look": {"until": 1.0, "rows": ROWS + 1, "at_once": AT_ONCE, "noise_share": COORDINATE},
    })  # fmt: skip


class Apparatus:
    """The benchmark's simulator as an apparatus that measures how a body at rest sets off."""

    def __init__(self, module, system, difficulty, version, noise, rng):
        self.module, self.system, self.noise = module, system, noise
        self.core = importlib.import_module(f"modules.{module}.core")
        # Its noise, but from a generator of its own: a part of the number, with a floor.
        self.core.inject_noise = lambda true, share, floor: (
            true
            + rng.standard_normal(np.shape(true))
            * np.where(share > 0, np.maximum(np.abs(true) * share, floor), 0.0)
        )
        self.settings = {"difficulty": difficulty, "law_version": version, "system": system,
                         "noise_level": noise}  # fmt: skip

    def __call__(self, experiment: Experiment):
        said = MODULES[self.module]
        probe, source = experiment.bodies
        values = [b.properties[said["property"]] for b in (source, probe)]
        asked = dict(zip(said["names"], values, strict=True))
        distance = probe.position[0]
        mass = values[1] if said["property"] == "mass" else 1.0
        with np.errstate(all="ignore"):
            found, share = _measured(self, asked, distance, mass)
        part = max(MOVED[0], MOVED[1] * self.noise)
        until = np.sqrt(2 * part * distance / np.median(np.abs(found)))
        times = until * np.linspace(0.5, 1.0, ROWS)
        gone = 0.5 * found * np.square(times)
        error = np.hypot(share, CHANGE * part) * np.median(np.abs(found)) * 0.5 * times**2
        return _recording(times, distance + said["sense"] * gone, error, distance)

    def run(self, **asked):
        """What the benchmark answers."""
        return self.core.run_experiment_for_module(**asked, **self.settings)


def _recording(times, places, error, distance):
    """Rows of the probe on the x-axis, the begin among them, and of the source."""
    times, places = np.append(0.0, times), np.append(distance, places)
    error = np.append(error[0], error)
    positions = np.stack([places, np.zeros_like(places)], axis=1)[..., None]
    sigma = np.stack([error, np.full_like(error, error.max())], axis=1)[..., None]
    return Recording(times, positions, sigma)


def _measured(apparatus, asked, distance, mass):
    """Accelerations (ROWS,), m/s^2, and the relative error of one."""
    how = {"vanilla_equation": _forces, "simple_system": _speeds, "complex_system": _speeds}
    if apparatus.module == "m2_magnetic_force" and apparatus.system == "complex_system":
        return _alternating(apparatus, asked, distance)
    return how[apparatus.system](apparatus, asked, distance, mass)


def _forces(apparatus, asked, distance, mass):
    """Forces as they are told, one after the other."""
    forces = [float(apparatus.run(**asked, distance=distance)) for _ in range(ROWS)]
    least = LEAST_FORCE / np.median(np.abs(forces)) if apparatus.noise else 0.0
    return np.array(forces) / mass, np.hypot(apparatus.noise, least)


def _speeds(apparatus, asked, distance, mass):
    """Speeds from rest, over times so short that the body hardly moves.

    The time is shortened until speeds grow in proportion to it. Where the mass may be chosen (m1,
    where charges fade), it is so little that little time passes; speeds are told as of 1 kg.
    """
    light = 1e-18 if apparatus.module == "m1_coulomb_force" else 1.0
    part = max(MOVED[0], MOVED[1] * apparatus.noise)
    until = 1e4 if light < 1 else 100.0
    extra = {"m1": 1.0, "m2": light} if light < 1 else {"initial_velocity": 0.0}
    for _ in range(200):
        step = until / (ROWS + 1)
        shown = apparatus.run(**asked, **extra, distance=distance, time_step=step * light**0.5,
                              duration=(SHOWN + 0.5) * step * light**0.5)  # fmt: skip
        speeds, floor = _told(shown, light, MODULES[apparatus.module]["sense"])
        speeds, times = speeds[1 : ROWS + 1], step * np.arange(1, ROWS + 1)
        moved = np.abs(speeds[-1]) * times[-1] / 2
        if np.isfinite(speeds).all() and moved <= 2 * part * distance:
            break
        until *= 0.5 if moved < 8 * part * distance else 0.1
    share = apparatus.noise * (0.5 if floor else 1.0)
    return speeds / times, np.hypot(share, _least(speeds / times, times, floor, light, apparatus))


def _least(found, times, floor, light, apparatus):
    """What the floor of its noise adds to the relative error, row by row: first rows err most."""
    if not apparatus.noise:
        return 0.0
    speed = np.median(np.abs(found)) * times
    if floor:
        return np.minimum(floor / speed**2, np.sqrt(2 * floor) / speed)
    return LEAST_SPEED * light**0.5 / speed


def _told(shown, light, sense):
    """Speeds of a body as if of 1 kg, and the least error of an energy.

    What errs to the other side keeps its sign: speeds of weak forces are then nil on average.
    """
    if "kinetic_energy" in shown:
        energies = np.array(shown["kinetic_energy"], dtype=float)
        return np.sign(energies) * np.sqrt(2 * np.abs(energies)), 1e-9
    speeds = np.array(shown["velocity"], dtype=float)
    return sense * speeds.reshape(len(speeds), -1)[:, 0] * light**0.5, 0.0


def _alternating(apparatus, asked, distance):
    """The second step under an alternating current.

    In the first no speed is gained: the current of a step is that at its begin, 0 at first. So
    the second tells the force of a part of the amplitude. The wire is so heavy that it stays.
    """
    phase = np.sin(2 * np.pi / (SHOWN - 1))
    step, heavy = 0.02 / (SHOWN - 1), 1e16
    asked = asked | {"current1": asked["current1"] / phase}
    part = max(MOVED[0], MOVED[1] * apparatus.noise)
    gained = np.zeros(ROWS)
    while np.median(gained) * step < part * distance / 10 and heavy > 1e-30:
        heavy /= 10
        shown = [apparatus.run(**asked, distance=distance, mass_wire=heavy, initial_velocity=0.0)
                 for _ in range(ROWS)]  # fmt: skip
        gained = np.array([-float(s["velocity"][2]) for s in shown])
    least = LEAST_SPEED / np.median(gained) if apparatus.noise else 0.0
    return heavy * gained / step, np.hypot(apparatus.noise, least)


def judged(module, system, difficulty, version, noise, seed, limit):
    """One row of the table."""
    began = time.process_time()
    row = {"module": module, "system": system, "difficulty": difficulty, "version": version,
           "noise": noise, "law": "", "is_form": False, "error": float("inf"), "stands": False,
           "rounds": 0, "why": ""}  # fmt: skip
    try:
        found = bsp_gp.discover(
            Apparatus(module, system, difficulty, version, noise, np.random.default_rng(seed)),
            means_of(module), ROUNDS, rng=seed, time_limit=limit,
        )  # fmt: skip
    except BspError as error:
        return row | {"why": str(error)[:200], "cpu_s": time.process_time() - began}
    row |= {"stands": found.stands, "rounds": found.rounds, "why": " ".join(found.open)}
    if found.law is not None:
        row |= {"law": found.law.text(), **compared(found.law, module, difficulty, version)}
    return row | {"cpu_s": time.process_time() - began}


def compared(law, module, difficulty, version):
    """Whether the form is right, the median relative error and RMSLE over the test range."""
    said = MODULES[module]
    laws = importlib.import_module(f"modules.{module}.laws")
    truth, _ = laws.get_ground_truth_law(difficulty, version)
    rng = np.random.default_rng(1)
    points = 10.0 ** np.stack([rng.uniform(*d, 400) for d in said["test"]], axis=1)
    true = np.array([truth(*point) for point in points])
    rounded = _force(with_rounded_powers(law), said, points) / true
    found = _force(law, said, points)
    is_form = _is_constant(rounded, points)
    rmsle = np.sqrt(np.mean(np.square(np.log1p(np.maximum(found, 0.0)) - np.log1p(true))))
    return {"is_form": is_form, "error": float(np.median(np.abs(found / true - 1))),
            "rmsle": float(rmsle)}  # fmt: skip


def _is_constant(ratio, points):
    """Whether a ratio of forces is a constant, but for powers that are none when rounded.

    True exponents that are no tenths (r^e) are rounded as those that were found. Of a sum that is
    expanded the constants are free, and equal as far as noise lets them.
    """
    if not np.all(ratio > 0):
        return False
    logs = np.column_stack([np.ones(len(points)), np.log(points)])
    powers = np.linalg.lstsq(logs, np.log(ratio), rcond=None)[0]
    left = np.log(ratio) - logs @ powers
    return bool(np.abs(powers[1:]).max() < TENTH / 2 and np.abs(left).max() < ALIKE)


def _force(law, said, points):
    """Size of the force on the probe, (n,), towards the source or away as the module says."""
    from bsp_gp.physics.bodies import stack
    from bsp_gp.planning.means import Body

    out, name = [], said["property"]
    for one, other, distance in points:
        bodies = (
            Body("probe", (distance,), (0.0,), {"mass": 1.0, name: other}),
            Body("source", (0.0,), (0.0,), {name: one}, is_static=True),
        )  # fmt: skip
        (batch,) = stack((Experiment(bodies, (0.0, 1.0, 2.0)).scene("a"),))
        p, v = batch.positions[0], np.zeros_like(batch.positions[0])
        pull = law.acceleration(batch.bodies, p, v, np.zeros(1))[0, 0, 0]
        out.append(said["sense"] * pull * (other if name == "mass" else 1.0))
    return np.array(out)


if __name__ == "__main__":
    main()
