"""What a step of the engine costs, compiled and with NumPy, in one run: `--out DIR`.

Seconds of a step of DOP853 and of its derivatives by states and constants, for a few points and
for many, the best of five. The same tapes run in both columns and compute the same to the last
digits (`tests/unit/test_compiled.py`).
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from common import options, write_table

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.flow import SCHEMES, Flow
from bsp_gp.physics.engine.motion import Motion
from bsp_gp.units import UnitSystem

LAWS = {
    "drag": ("-c1 * norm(v_i) * v_i", "-c2 * m_i * e_y"),
    "gravity": ("c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)",),
    "a free power": ("c1 * m_i * m_j * norm(p_i - p_j)^c2 * normalize(p_j - p_i)", "-c3 * v_i"),
}
POINTS = (1, 10, 100, 1000)


def main(argv=None):
    args = options(__doc__.splitlines()[0], argv)
    rows = [row for name in LAWS for n in POINTS for row in timed(name, n)]
    for row in rows:
        print("  ".join(f"{value:>12.4g}" if isinstance(value, float) else f"{value!s:>12}"
                        for value in row.values()))  # fmt: skip
    write_table(rows, args.out / "engine.csv")


def timed(name, n_points):
    """Rows of the table: a step, and its derivatives."""
    times = [spent(*ready(name, n_points, is_compiled)) for is_compiled in (True, False)]
    for what, ours, numpys in zip(("step", "derivatives"), *times, strict=True):
        yield {"law": name, "points": n_points, "what": what, "compiled_us": 1e6 * ours,
               "numpy_us": 1e6 * numpys, "ratio": numpys / ours}  # fmt: skip


def spent(flow, points):
    """Seconds of a step of a flow, and of its derivatives."""
    scheme, h = SCHEMES["dop853"], np.full(len(points.times), 1e-3)
    _, stages, _ = flow.step(scheme, points, h)
    return (
        best_of_five(lambda: flow.step(scheme, points, h)),
        best_of_five(lambda: flow.step_slopes(scheme, stages, h)),
    )


def ready(name, n_points, is_compiled):
    """The flow of a law on three bodies (one by one where they do not meet), and points of it."""
    rng = np.random.default_rng(0)
    bodies = [Entity(f"b{k}", properties={"mass": 1.0 + k}) for k in range(3)]
    scene = Scene("s", np.arange(5.0), rng.normal(size=(5, 3, 2)), bodies)
    units = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
    law = Hypothesis.from_laws(Dataset("d", (scene,), units=units), LAWS[name]).law
    law = law.with_values([(c, "") for c in law.constants], [-1.9] * len(law.constants))
    (chains,) = build_chains(law, [scene], "y")
    motion = Motion(law, chains, [(c, "") for c in law.constants])
    if not is_compiled:
        motion.compiled = None
    motion.set_constants(np.full(len(law.constants), -1.9))
    flow = Flow(motion, np.full(chains.n_chains, 1e-9))
    state = rng.normal(size=(2, chains.n_moving, 2, n_points))
    return flow, flow.points(state, np.zeros(n_points), np.zeros(n_points, dtype=int))


def best_of_five(call):
    """Processor seconds of a call."""
    times = []
    for _ in range(5):
        count, begun = 0, time.process_time()
        while (spent := time.process_time() - begun) < 0.05:
            call()
            count += 1
        times.append(spent / count)
    return min(times)


if __name__ == "__main__":
    main()
