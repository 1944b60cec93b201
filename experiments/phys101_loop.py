"""SPRING in SI: gravity and Hooke declared, and what the loop finds that they lack.

Every clip with the sideways sway left out (``vertical``), the heavy block also as it is filmed
(``plane``): the light one sways by half its amplitude about a point that is not the marked anchor,
and fits in the plane fall out of step with it. The noise is the tracker's own. Beside the search,
damping linear in speed is weighed by name: what it does to the fit and to the held-out end.
"""

import time

import numpy as np
import pandas as pd
from common import write_table
from phys101_clips import FPS

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.loop.close import close_loop
from bsp_gp.units import UnitSystem

DECLARED = (
    "9.81 [m/s^2] * m_i * down",
    "k0 * (p_j - p_i)",  # Hooke's law k0 (r - l0) towards the anchor, linear in its constants:
    "f0 * normalize(p_i - p_j)",  # f0 = k0 l0, so that the rest length is f0 / k0
)
DAMPING = "d0 * v_i"


def spring_dataset(clip, px_per_m, view):
    """One clip as a data set in SI, y up; the last 30 % of its time is held out by the loop."""
    rows = clip.frames >= clip.window[0]
    flip = np.array([1.0, -1.0]) / px_per_m
    x = clip.px[rows] * flip
    anchored = clip.anchor * flip
    if view == "vertical":
        x[:, 0] = anchored[0]
    block = Entity("block", "point", properties={"mass": clip.mass})
    anchor = Entity("anchor", "point", is_static=True)
    positions = np.stack([x, np.broadcast_to(anchored, x.shape)], axis=1)
    scene = Scene(clip.name, np.arange(len(x)) / FPS, positions, (block, anchor))
    units = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
    variance = np.nanmedian(np.einsum("tii->ti", clip.cov[rows]), axis=0)
    noise = tuple(np.sqrt(variance) / px_per_m)
    return Dataset(clip.name, (scene,), up="y", units=units, noise=noise)


def close_spring(clip, px_per_m, view, seed):
    """The loop's report on one clip."""
    return close_loop(
        spring_dataset(clip, px_per_m, view), DECLARED, rng=np.random.default_rng(seed), seed=seed,
        max_rounds=3,
    )  # fmt: skip


def weigh_damping(clip, px_per_m, view, seed):
    """Gravity and Hooke without and with damping: a row like those of the loop's rounds."""
    dataset = spring_dataset(clip, px_per_m, view)
    before, after = (fit_law(dataset, laws, rng=seed) for laws in (DECLARED, (*DECLARED, DAMPING)))
    d0 = next(c for c in after.constants if c.name == "d0")
    gain = after.log_evidence - before.log_evidence
    b, a = (_rmse(found.errors) for found in (before, after))
    return {
        "round": 0, "effect": "damping, linear in speed",
        "law": f"{d0.value:.4f} [{d0.low:.4f}, {d0.high:.4f}] kg/s * v_i",
        "adopted": bool(gain > 0 and a < b), "reason": f"log evidence rises by {gain:.1f} nats",
        "before_px": px_per_m * b, "after_px": px_per_m * a, "floor_px": float("nan"),
    }  # fmt: skip


def loop_rows(clip, px_per_m, args):
    """Rows of one clip, kept in ``loop/NAME.csv``: rounds of the loop, and damping by name."""
    path = args.out / "loop" / f"{clip.name}.csv"
    if path.is_file():
        return pd.read_csv(path, keep_default_na=False, na_values=[""]).to_dict("records")
    rows = []
    for view in ("vertical", "plane") if clip.mass > 0.2 else ("vertical",):
        started = time.process_time()
        found = [weigh_damping(clip, px_per_m, view, args.seed)]
        report = close_spring(clip, px_per_m, view, args.seed)
        found += [_row(round_, px_per_m) for round_ in report.rounds]
        spent = time.process_time() - started
        rows += [{"clip": clip.name, "view": view, "cpu_s": spent} | row for row in found]
    write_table(rows, path)
    return rows


def _row(round_, px_per_m):
    effect = round_.effect
    return {
        "round": round_.number, "effect": effect.name if effect else "nothing",
        "law": effect.law if effect else "", "adopted": round_.adopted, "reason": round_.reason,
        "before_px": px_per_m * _rmse(round_.before), "after_px": px_per_m * _rmse(round_.after),
        "floor_px": px_per_m * _rmse(round_.floor),
    }  # fmt: skip


def _rmse(measures):
    value = getattr(measures, "rollout_rmse", None) if measures is not None else None
    return float("nan") if value is None else float(value)


def loop_lines(rows):
    """What the summary says: one line a round."""
    lines = ["| clip | view | round | effect | adopted? | held out, px | reason |",
             "|---|---|---|---|---|---|---|"]  # fmt: skip
    for r in rows:
        name = "by name" if r["round"] == 0 else r["round"]
        verdict = "yes" if r["adopted"] else "no"
        after = f" -> {r['after_px']:.2f}" if np.isfinite(r["after_px"]) else ""
        floor = r.get("floor_px", np.nan)
        floor = f" (floor {floor:.2f})" if np.isfinite(floor) else ""
        lines.append(
            f"| {r['clip']} | {r['view']} | {name} | {r['effect']} (`{r['law']}`) | {verdict} | "
            f"{r['before_px']:.2f}{after}{floor} | {r['reason']} |"
        )
    return lines
