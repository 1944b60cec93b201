"""NewtonBench (HKUST-KnowComp/NewtonBench), modules m0 and m2, without a language model.

Two bodies on a line or in a plane, one held fast at the origin: `bsp_gp.discover` makes experiments
with the benchmark's own simulator and finds the force. A form is right if, its exponents rounded to
0.1, it is the true one but for a constant; its error is that over the benchmark's test range.
Speeds are measured beside places, to the same part: places are the integrals of speeds.

    python experiments/scoreboards/newton_bench.py --repo PATH --out DIR [--systems simple_system]
"""

import importlib
import json
import re
import sys
import time
import types
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, whole, write_table

import bsp_gp
from bsp_gp.errors import BspError
from bsp_gp.planning.apparatus import Recording
from bsp_gp.planning.means import Experiment, means_from

ROWS = 20
DIGITS = 3e-4
"""Part of a number that is lost in the steps of the benchmark's integration, and in its digits."""
RIGHT = 1e-2
"""Relative error of a law that is right."""
MODULES = {
    "m0_gravity": {
        "names": ("mass1", "mass2", "distance"), "property": "mass", "ranges": ("1..1000",) * 2,
        "x": "1..10", "v": "-0.05..0.05", "until": "0.5..50", "test": ((0, 3), (0, 3), (0, 1)),
    },
    "m2_magnetic_force": {
        "names": ("current1", "current2", "distance"), "property": "current",
        "ranges": ("0.001..0.1",) * 2, "x": "0.001..0.1", "v": 0.0, "until": "0.01..10",
        "test": ((-3, -1), (-3, -1), (-3, -1)),
    },
}  # fmt: skip
"""Per module: names of its arguments, ranges of properties and places that are tried, and decades
of its test."""


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
                part.write_text(json.dumps(judged(*item, args.seed)), encoding="utf-8")
        rows.append(json.loads(path.read_text(encoding="utf-8")))
        print(name, {k: rows[-1][k] for k in ("is_form", "error", "law", "cpu_s")}, flush=True)
        write_table(rows, args.out / "results.csv")
    table = pd.DataFrame(rows)
    table["is_right"] = table.is_form & (table.error <= RIGHT)
    print(table.groupby(["noise", "system", "module"]).is_right.agg(["sum", "count"]).to_string())


def declare(parser):
    parser.add_argument("--repo", type=Path, required=True, help="checkout of the benchmark")
    parser.add_argument("--modules", nargs="+", default=["m0_gravity"], choices=list(MODULES))
    parser.add_argument("--systems", nargs="+", default=["simple_system", "complex_system"])
    parser.add_argument("--noise", nargs="+", type=float, default=[0.0, 1e-4, 1e-2])
    parser.add_argument("--most", type=int, default=1000, help="items, by chance")


def means_of(module, system, noise):
    """What the benchmark lets be chosen: a probe on the axis, thrown along or across it."""
    said = MODULES[module]
    across = {"y": 0.0, "vx": 0.0, "vy": "0..0.1"}
    moves = {"vx": said["v"]} if system == "simple_system" else across
    name, look = said["property"], {"until": said["until"], "rows": ROWS, "at_once": 20}
    probe = {"x": said["x"], **moves, name: said["ranges"][1]}
    source = {"dynamic": 0, "x": 0, name: said["ranges"][0]}
    return means_from({
        "bodies": {"probe": probe, "source": source},
        "units": {} if name == "mass" else {name: "A"},
        "look": {**look, "noise_share": noise or DIGITS},
    })  # fmt: skip


class Apparatus:
    """The benchmark's simulator as an apparatus."""

    def __init__(self, module, system, difficulty, version, noise, rng):
        self.module, self.system, self.noise = module, system, noise
        self.core = importlib.import_module(f"modules.{module}.core")
        # Its noise, but from a generator of its own: a part of the number, with a floor.
        self.core.inject_noise = lambda true, share, floor: true + rng.standard_normal(
            np.shape(true)
        ) * np.where(share > 0, np.maximum(np.abs(true) * share, floor), 0.0)
        self.settings = {"difficulty": difficulty, "law_version": version, "system": system,
                         "noise_level": noise}  # fmt: skip

    def __call__(self, experiment: Experiment):
        said = MODULES[self.module]
        probe, source = experiment.bodies
        values = (source.properties, probe.properties)
        step = experiment.times[-1] / (ROWS - 1)
        thrown = probe.velocity[0] if self.system == "simple_system" else probe.velocity[1]
        found = self.core.run_experiment_for_module(
            **{said["names"][k]: v[said["property"]] for k, v in enumerate(values)},
            distance=probe.position[0], initial_velocity=thrown, time_step=step,
            duration=(ROWS + 0.5) * step, **self.settings,
        )  # fmt: skip
        t = np.array(found["time"], dtype=float)
        v = np.array(found["velocity"], dtype=float).reshape(len(t), -1)
        start, first = np.array(probe.position), np.array(probe.velocity)
        v[0] = first
        t = step * np.arange(len(t))
        gone = np.concatenate([np.zeros((1, v.shape[1])),
                               np.cumsum(0.5 * step * (v[1:] + v[:-1]), axis=0)])  # fmt: skip
        share = max(self.noise, DIGITS)
        # Errors of speeds add up, by chance, over the rows.
        error = share * step * np.sqrt(np.cumsum(np.square(v), axis=0)) + 1e-12 * np.abs(start)
        error = error + DIGITS * np.abs(gone)
        seen = np.array(found["position"], dtype=float).reshape(v.shape)
        is_better = share * np.abs(seen) < error  # the place itself, or the sum of its speeds
        error = np.where(is_better, share * np.abs(seen), error)
        places = np.where(is_better, seen, start + gone)
        places = np.stack([places, np.zeros_like(gone)], axis=1)
        sigma = np.stack([error, np.ones_like(error)], axis=1)
        return Recording(t, places, sigma)


def judged(module, system, difficulty, version, noise, seed):
    """One row of the table."""
    began = time.process_time()
    row = {"module": module, "system": system, "difficulty": difficulty, "version": version,
           "noise": noise, "law": "", "is_form": False, "error": float("inf"), "stands": False,
           "rounds": 0, "why": ""}  # fmt: skip
    try:
        found = bsp_gp.discover(
            Apparatus(module, system, difficulty, version, noise, np.random.default_rng(seed)),
            means_of(module, system, noise), 6, rng=seed, time_limit=120,
        )  # fmt: skip
    except BspError as error:
        return row | {"why": str(error)[:200], "cpu_s": time.process_time() - began}
    row |= {"stands": found.stands, "rounds": found.rounds, "why": " ".join(found.open)}
    if found.law is not None:
        row |= {"law": found.law.text(), **compared(found.law, module, difficulty, version)}
    return row | {"cpu_s": time.process_time() - began}


def compared(law, module, difficulty, version):
    """Whether the form is right, and the median relative error over the test range."""
    said = MODULES[module]
    laws = importlib.import_module(f"modules.{module}.laws")
    truth, _ = laws.get_ground_truth_law(difficulty, version)
    rng = np.random.default_rng(1)
    points = 10.0 ** np.stack([rng.uniform(*d, 400) for d in said["test"]], axis=1)
    true = np.array([truth(*point) for point in points])
    texts = {}
    for name, value in law.constants.items():
        is_power = re.search(rf"\^-?\(?-?{re.escape(name)}\b", law.text(digits=False))
        texts[name] = round(value, 1) if is_power else value
    rounded = _force(law.with_constants(texts), said["property"], points) / true
    error = np.abs(_force(law, said["property"], points) / true - 1)
    is_form = bool(np.ptp(rounded) < 1e-4 * abs(np.median(rounded)))
    return {"is_form": is_form, "error": float(np.median(error))}


def _force(law, name, points):
    """Size of the force on the probe towards the source, (n,)."""
    from bsp_gp.physics.bodies import stack
    from bsp_gp.planning.means import Body

    out = []
    for one, other, distance in points:
        bodies = (
            Body("probe", (distance,), (0.0,), {name: other}),
            Body("source", (0.0,), (0.0,), {name: one}, is_static=True),
        )  # fmt: skip
        (batch,) = stack((Experiment(bodies, (0.0, 1.0, 2.0)).scene("a"),))
        p, v = batch.positions[0], np.zeros_like(batch.positions[0])
        pull = law.acceleration(batch.bodies, p, v, np.zeros(1))[0, 0, 0]
        out.append(-pull * (other if name == "mass" else 1.0))
    return np.array(out)


if __name__ == "__main__":
    main()
