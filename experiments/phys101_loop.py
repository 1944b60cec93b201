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
from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.verdict import MIN_BIC_GAIN, MIN_SHARE
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


def close_spring(clip, px_per_m, view, seed, n_null=99):
    """The loop's report on one clip."""
    return close_loop(
        spring_dataset(clip, px_per_m, view), DECLARED, rng=np.random.default_rng(seed), seed=seed,
        n_null=n_null, max_rounds=3,
    )  # fmt: skip


def weigh_damping(clip, px_per_m, view, seed):
    """Gravity and Hooke without and with damping, by the loop's own bars: a row like its rounds'.

    The search ranks laws by accelerations, in which so weak a drag drowns; whole tracks show it.
    """
    dataset = spring_dataset(clip, px_per_m, view)
    laws = [declared_law(dataset, texts) for texts in (DECLARED, (*DECLARED, DAMPING))]
    split_rng, floor_rng = np.random.default_rng(seed).spawn(2)
    observation = observe(dataset, laws[0], split_rng, sources=True)
    before, after = (evaluate(observation, law) for law in laws)
    floor, _ = observation.floor(after.law, floor_rng)
    k = [name for name, _ in after.fit.parameters].index("d0")
    n_eff = after.fit.n_effective
    gain = before.fit.bic(n_eff) - after.fit.bic(n_eff)
    b, a, f = (_rmse(errors) ** 2 for errors in (before.errors, after.errors, floor))
    share = (b - a) / (b - f) if b > f else 0.0
    return {
        "round": 0, "effect": "damping, linear in speed",
        "law": f"{after.fit.values[k]:.4f} +- {after.fit.intervals[k]:.4f} kg/s * v_i",
        "adopted": bool(gain >= MIN_BIC_GAIN and share >= MIN_SHARE),
        "reason": f"BIC falls by {gain:.1f}, {share:.0%} of the held-out error above noise goes",
        "before_px": px_per_m * b**0.5, "after_px": px_per_m * a**0.5,
        "floor_px": px_per_m * f**0.5,
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
