"""DiscoverPhysics (souspilot/DiscoverPhysicsWIP, engine nbody), without a language model.

Worlds are told apart by what their instructions let be chosen, never by their names: of a probe
beside a fixed source, and of a ring of which two settings make everything, `bsp_gp.discover`
chooses; of many bodies, of which few are set off at will, recordings are made by chance within the
ranges of the instructions, and `bsp_gp.close_loop` is asked, of calm rows alone where what it finds
does not fit all. The noise is the benchmark's (7.5 % of the spread of its test motions, of every
place). The error is its own: the mean square over its test motions, by their variance. The form of
a law between two bodies is right if, its exponents rounded to 0.1 and its lengths and rates free,
it is proportional to the true force within 5 % over nine tenths of what was tried; laws of more
kinds of bodies are left to a reader.

    python experiments/scoreboards/discover_physics.py --repo PATH --out DIR [--worlds gravity]
"""

import importlib
import json
import math
import sys
import time
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import k1

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, whole, write_table
from forms import with_rounded_powers

import bsp_gp
from bsp_gp.errors import BspError
from bsp_gp.fitting.starts import roles_of
from bsp_gp.planning.apparatus import Recording
from bsp_gp.planning.discover import calm
from bsp_gp.planning.means import Body, Experiment, means_from

NOISE = 0.075
"""Part of the spread of a world's test motions (the benchmark's configs/bench.yml)."""
STEP = 0.005
"""Seconds to which the benchmark rounds times."""
ROUNDS = 16
RECORDINGS, RUNS = 6, 5
"""Recordings of many bodies that are made, each put together from runs that begin alike and are
looked at ten times each, as the instructions allow."""
GOOD, ITS_BAR = 1e-2, 0.1
FITS = 1.5
"""Reduced chi-squared up to which a law fits."""
ALIKE = 0.05
R_SMALL, IMAGES = 0.5, 20
TRUE = {
    "gravity": lambda p1, p2, r, t: p1 / p2 / r,
    "yukawa": lambda p1, p2, r, t: p1 / p2 * k1(r / 2),
    "fractional": lambda p1, p2, r, t: p1 / p2 / r**2,
    "coulomb_easy": lambda p1, p2, r, t: p1 * p2 / r**2,
    "extra_dimensions": lambda p1, p2, r, t: p1 / p2 * sum(
        r * (r**2 + (2 * np.pi * R_SMALL * n) ** 2) ** -1.5 for n in range(-IMAGES, IMAGES + 1)
    ),
    "oscillator": lambda p1, p2, r, t: p1 / p2 / r * np.cos(np.pi / 2 * t),
    "circle": lambda p1, p2, r, t: r**-1.5,
}  # fmt: skip
"""The key: accelerations but for a constant, as the benchmark's page has them."""
WORLDS = (
    "gravity", "yukawa", "fractional", "dark_matter", "three_species", "ether", "hubble",
    "coulomb_easy", "extra_dimensions", "circle", "oscillator",
)  # fmt: skip


def main(argv=None):
    args = options(__doc__.splitlines()[0], argv, declare)
    worlds = load(args.repo.resolve())
    rows = []
    for seed in args.seeds:
        for world in args.worlds:
            path = args.out / "trials" / f"{world}-{seed}.json"
            if not path.exists():
                with whole(path) as part:
                    part.write_text(json.dumps(judged(worlds, world, seed, args)), encoding="utf-8")
            rows.append(json.loads(path.read_text(encoding="utf-8")))
            print(
                world,
                seed,
                {k: rows[-1].get(k) for k in ("is_form", "error", "law", "cpu_s")},
                flush=True,
            )
            write_table(rows, args.out / "results.csv")
    table = pd.DataFrame(rows)
    table["is_good"], table["is_its"] = table.error <= GOOD, table.error < ITS_BAR
    print(table.groupby("world")[["is_good", "is_its"]].agg(["sum", "count"]).to_string())


def declare(parser):
    parser.add_argument("--repo", type=Path, required=True, help="checkout of the benchmark")
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=WORLDS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="of experiments, at most")
    parser.add_argument("--limit", type=float, default=120.0, help="s of a closing of the loop")


def load(repo):
    """What is asked of the benchmark: its worlds, its test motions and their variances."""
    sys.path[:0] = [str(repo / part) for part in ("ScienceAgent", "PhysicsSchool", "scripts")]
    for name in ("yaml", "anthropic", "openai"):  # of its own runs, with language models
        sys.modules.setdefault(name, types.ModuleType(name))
    return types.SimpleNamespace(
        get=importlib.import_module("scienceagent.worlds").get_world,
        evaluator=importlib.import_module("scienceagent.evaluator"),
        variances=importlib.import_module("run_benchmark")._WORLD_VARS,
    )


# --- what can be chosen, by the instructions of a world -------------------------------------------


class Planned:
    """Everything that may be chosen is a setting or a number of a body: `bsp_gp.discover` plans."""

    at_once = 12

    def __init__(self, executor, sigma):
        self.executor, self.sigma = executor, sigma
        look = {"until": 10.0, "rows": 11, "noise": sigma, "at_once": self.at_once}
        self.means = means_from({**self.choices(), "look": look})

    def __call__(self, experiment):
        """Run one experiment; the begin is known."""
        times = STEP * np.unique(np.maximum(np.round(np.array(experiment.times[1:]) / STEP), 1))
        begin = np.array([b.position for b in experiment.bodies])
        seen = self.seen(experiment, times.tolist())
        positions = np.concatenate([begin[None], seen])
        return Recording(np.append(0.0, times), positions, np.full(positions.shape, self.sigma))

    def find(self, seed, args, says):
        return bsp_gp.discover(self, self.means, args.rounds, rng=seed, time_limit=args.limit,
                               progress=says)  # fmt: skip


class Pair(Planned):
    """A probe beside a source that is held fast; each has a number of unknown meaning."""

    tests = "_DEFAULT_TEST_CASES"

    def choices(self):
        return {
            "bodies": {
                "probe": {"x": "-6..6", "y": "-6..6", "vx": "-1..1", "vy": "-1..1",
                          "size": "0.1..10"},
                "source": {"dynamic": 0, "x": 0, "y": 0, "size": "0.1..10"},
            },
            "units": {"size": "1"},
        }  # fmt: skip

    def seen(self, experiment, times):
        """Places of all bodies, (T, 2, 2)."""
        probe, source = experiment.bodies
        (shown,) = self.executor.run([{
            "p1": source.properties["size"], "p2": probe.properties["size"], "pos2": probe.position,
            "velocity2": probe.velocity, "measurement_times": times,
        }])  # fmt: skip
        places = np.array(shown["pos2"])
        return np.stack([places, np.zeros_like(places)], axis=1)

    def scenes(self, case):
        """A test motion as a scene, and which of its bodies are scored."""
        probe = Body("probe", tuple(case["pos2"]), tuple(case["velocity2"]), {"size": case["p2"]})
        source = Body("source", (0.0, 0.0), (0.0, 0.0), {"size": case["p1"]}, is_static=True)
        times = (0.0, *case["measurement_times"])
        return Experiment((probe, source), times).scene("test"), [0]

    def true(self, shown):
        return np.array(shown["pos2"])[:, None]


class Ring(Planned):
    """A ring of bodies about one more, all alike; its radius and speed may be chosen."""

    tests, n_ring, at_once = "_CIRCLE_TEST_CASES", 10, 4

    def choices(self):
        bodies = {"body 0": {"x": 0.0, "y": 0.0}}
        for k in range(self.n_ring):
            angle = f"(2 * pi * {k} / {self.n_ring})"
            bodies[f"body {k + 1}"] = {
                "x": f"radius * cos{angle}", "y": f"radius * sin{angle}",
                "vx": f"-speed * sin{angle}", "vy": f"speed * cos{angle}",
            }  # fmt: skip
        return {"bodies": bodies, "settings": {"radius": "2..10", "speed": "0..2"}}

    def seen(self, experiment, times):
        """Places of all bodies, (T, 11, 2)."""
        return np.array(self.shown(experiment.settings, times)["positions"])

    def shown(self, settings, times):
        (shown,) = self.executor.run([{
            "ring_radius": settings["radius"],
            "initial_tangential_velocity": settings["speed"], "measurement_times": times,
        }])  # fmt: skip
        return shown

    def scenes(self, case):
        """A test motion as a scene, and which of its bodies are scored."""
        settings = {"radius": case["ring_radius"], "speed": case["initial_tangential_velocity"]}
        bodies = replace(self.means, settings=settings).draw(np.random.default_rng(0)).bodies
        scene = Experiment(bodies, (0.0, *case["measurement_times"])).scene("test")
        return scene, list(range(self.n_ring + 1))

    def true(self, shown):
        return np.array(shown["positions"])


class Many:
    """Bodies of which only some, or only a few numbers, can be chosen."""

    def __init__(self, executor, sigma):
        self.executor, self.sigma = executor, sigma
        self.means = means_from({
            "bodies": {"body": {"x": 0.0, "y": 0.0}},
            "look": {"until": 10.0, "noise": sigma},
        })  # fmt: skip

    def find(self, seed, args, says):
        rng = np.random.default_rng(seed)
        scenes = [self.seen(f"recording {k}", self.drawn(rng)) for k in range(1, RECORDINGS + 1)]
        asked = {"rng": seed, "time_limit": 2 * args.limit, "progress": says, "n_bootstrap": 0}
        whole = bsp_gp.close_loop(self.means.dataset(scenes), **asked)
        if whole.law.terms and whole.fit.chi2_red < FITS:
            return whole
        # Of bodies that meet closely the end tells little, and a descent is lost in it.
        return bsp_gp.close_loop(self.means.dataset([calm(s) for s in scenes]), **asked)

    def seen(self, name, asked):
        """One recording as a scene."""
        times = np.arange(1, 10 * RUNS + 1) / RUNS
        runs = self.executor.run([{**asked, "measurement_times": times[k::RUNS].tolist()}
                                  for k in range(RUNS)])  # fmt: skip
        begun = self.begun(asked, runs[0])
        times = (0.0, *times.tolist())
        start = np.array([b.position for b in begun])
        rows = np.stack([shown["positions"] for shown in runs], axis=1)
        positions = np.concatenate([start[None], rows.reshape(-1, *start.shape)])
        return Experiment(begun, times).scene(
            name, positions, sigma=np.full(positions.shape, self.sigma)
        )

    def scenes(self, case):
        (shown,) = self.executor.run([case])
        begun = self.begun(case, shown)
        scene = Experiment(begun, (0.0, *case["measurement_times"])).scene("test")
        return scene, list(range(len(begun)))[self.scored]

    def true(self, shown):
        return np.array(shown["positions"])[:, self.scored]


class Probes(Many):
    """Five probes among bodies that begin as they do."""

    scored = slice(-5, None)

    def __init__(self, executor, sigma, reach, fast, tests):
        super().__init__(executor, sigma)
        self.reach, self.fast, self.tests = reach, fast, tests

    def drawn(self, rng):
        places = rng.uniform(-self.reach, self.reach, (5, 2))
        speeds = rng.uniform(-self.fast, self.fast, (5, 2))
        return {"probe_positions": places.tolist(), "probe_velocities": speeds.tolist()}

    def begun(self, asked, shown):
        """Where bodies begin; how fast those begin that cannot be chosen may not be told."""
        places = [*shown["background_initial_positions"], *asked["probe_positions"]]
        count = len(places) - 5
        unknown = [[np.nan, np.nan]] * count
        speeds = [*shown.get("background_initial_velocities", unknown), *asked["probe_velocities"]]
        masses = shown.get("particle_masses")
        return tuple(
            Body(f"body {k}" if k < count else f"probe {k - count + 1}", tuple(p), tuple(v),
                 {} if masses is None else {"mass": masses[k]})
            for k, (p, v) in enumerate(zip(places, speeds, strict=True))
        )  # fmt: skip


class Weighed(Probes):
    """The same with masses."""

    def drawn(self, rng):
        return {**super().drawn(rng), "probe_masses": rng.choice([1.0, 2.0, 4.0], 5).tolist()}


def topology(world, tests, sigma):
    """What the instructions of a world let be chosen."""
    executor, kind = world["executor"], Path(world["instructions"]).stem
    if kind == "2particle_instructions":
        return Pair(executor, sigma)
    if kind == "circle_instructions":
        return Ring(executor, sigma)
    if kind == "probes_with_masses_instructions":
        return Weighed(executor, sigma, 22.0, 3.0, tests)
    return Probes(executor, sigma, 15.0, 2.0, tests)


# --- the score ------------------------------------------------------------------------------------


def judged(worlds, name, seed, args):
    """One row of the table."""
    began, variance = time.process_time(), worlds.variances[name]
    sigma = NOISE * variance**0.5
    world = worlds.get(name, engine="nbody", noise_std=sigma, noise_seed=seed)
    place = topology(world, f"_{name.upper()}_TEST_CASES", sigma)
    row = {"world": name, "seed": seed, "law": "", "error": float("inf"), "stands": False,
           "rounds": 0, "why": ""}  # fmt: skip
    says = (lambda text: print(f"  {time.process_time() - began:.0f} s: {text}", flush=True)) \
        if args.quick else None  # fmt: skip
    try:
        found = place.find(seed, args, says)
    except BspError as error:
        return row | {"why": str(error)[:300], "cpu_s": time.process_time() - began}
    row["cpu_s"] = time.process_time() - began
    is_planned = isinstance(place, Planned)
    row["why"] = " ".join(found.open) if is_planned else found.verdict
    row |= {"stands": found.stands, "rounds": found.rounds} if is_planned else {}
    if found.law is not None:
        cases = getattr(worlds.evaluator, place.tests)
        error = held_out(found.law, place, cases) / variance
        row |= {"law": found.law.text(), "error": error}
        row["is_form"] = is_alike(found.law, TRUE[name]) if name in TRUE else None
    return row


def is_alike(law, truth):
    """Whether a law between two bodies has the form of the true one."""
    law = with_rounded_powers(law)
    lengths = [name for name, role in roles_of(law).items() if role in ("inner", "rate")]

    def off(scales):
        own = {n: law.constants[n] * math.exp(k) for n, k in zip(lengths, scales, strict=True)}
        return apart(law.with_constants({**law.constants, **own}), truth)

    if not lengths:
        return off(()) <= ALIKE
    return bool(minimize(off, np.zeros(len(lengths)), method="Nelder-Mead").fun <= ALIKE)


def apart(law, truth):
    """Part of the true force by which a law is off that is proportional to it, over most of it."""
    from bsp_gp.physics.bodies import stack

    rng, told, true = np.random.default_rng(1), [], []
    for _ in range(200):
        p1, p2, r, t = *10 ** rng.uniform(-1, 1, 2), rng.uniform(1, 8), rng.uniform(0, 10)
        bodies = (
            Body("probe", (r, 0.0), (0.0, 0.0), {"mass": 1.0, "size": p2}),
            Body("source", (0.0, 0.0), (0.0, 0.0), {"mass": 1.0, "size": p1}, is_static=True),
        )
        (batch,) = stack((Experiment(bodies, (0.0, 1.0, 2.0)).scene("a"),))
        p = batch.positions[0]
        v = np.zeros_like(p)
        v[:, 0] = rng.uniform(-1, 1, 2)  # what depends on it is none of the form
        told.append(law.acceleration(batch.bodies, p, v, np.full(1, t))[0, 0])
        true.append((truth(p1, p2, r, t), 0.0))
    told, true = np.array(told), np.array(true)
    scaled = np.median(told[:, 0] / true[:, 0]) * true
    off = np.linalg.norm(told - scaled, axis=1) / np.linalg.norm(scaled, axis=1)
    return float(np.quantile(off, 0.9))


def held_out(law, place, cases):
    """Mean squared distance over bodies that are scored, times and test motions."""
    off = []
    with place.executor.noise_disabled():
        for case, shown in zip(cases, place.executor.run(cases), strict=True):
            scene, scored = place.scenes(case)
            told = law.simulate(scene, substeps=64).positions[1:, scored]
            off.append(np.square(told - place.true(shown)).sum(axis=-1).ravel())
    return float(np.nan_to_num(np.mean(np.concatenate(off)), nan=np.inf))


if __name__ == "__main__":
    main()
