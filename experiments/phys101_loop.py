"""SPRING in SI: gravity and Hooke declared, and what the loop finds that they lack."""

import numpy as np
from phys101_clips import FPS

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.loop.close import close_loop
from bsp_gp.units import UnitSystem

DECLARED = (
    "9.81 [m/s^2] * m_i * down",
    "k0 * (p_j - p_i)",  # Hooke's law k0 (r - l0) towards the anchor, linear in its constants:
    "f0 * normalize(p_i - p_j)",  # f0 = k0 l0, so that the rest length is f0 / k0
)


def spring_dataset(clip, px_per_m, vertical=False):
    """One clip as a data set in SI, y up; the last 30 % of its time is held out by the loop.

    With `vertical` the sideways sway is left out (block and anchor above one another): with it the
    loop first finds a push along x, which says that the block hangs beside the marked anchor.
    """
    rows = clip.frames >= clip.window[0]
    flip = np.array([1.0, -1.0]) / px_per_m
    x = clip.px[rows] * flip
    anchored = clip.anchor * flip
    if vertical:
        x[:, 0] = anchored[0]
    block = Entity("block", "point", properties={"mass": clip.mass})
    anchor = Entity("anchor", "point", is_static=True)
    positions = np.stack([x, np.broadcast_to(anchored, x.shape)], axis=1)
    scene = Scene(clip.name, np.arange(len(x)) / FPS, positions, (block, anchor))
    units = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
    return Dataset(clip.name, (scene,), up="y", units=units)


def close_spring(clip, px_per_m, seed, n_null=299, progress=None):
    """Rounds of the loop on one clip: list of rows for the table."""
    report = close_loop(
        spring_dataset(clip, px_per_m), DECLARED, rng=np.random.default_rng(seed), seed=seed,
        n_null=n_null, max_rounds=3, progress=progress,
    )  # fmt: skip
    rows = []
    for k, round_ in enumerate(report.rounds, 1):
        effect = round_.effect
        rows.append(
            {"clip": clip.name, "round": k, "effect": effect.name if effect else "",
             "law": effect.law if effect else "", "adopted": round_.adopted,
             "reason": round_.reason,
             "before_px": px_per_m * _rmse(round_.before),
             "after_px": px_per_m * _rmse(round_.after)}
        )  # fmt: skip
    return rows, report


def _rmse(measures):
    value = getattr(measures, "rollout_rmse", None) if measures is not None else None
    return float("nan") if value is None else float(value)
