"""Rows that are far off their neighbours: told, and left out of fits.

The tails of a noise model say how often such rows come; a single one of them would still pull on
the constants. They are found before any law is fitted, so that no law can profit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.data.point_errors import gross_errors
from bsp_gp.data.scene import CHECK

__all__ = ["without_outliers"]

LISTED = 5
EXACT = 1e-9
"""Noise below this part of the extent is numerical."""
RESOLUTION = 1e-7
"""Part of the extent by which neighbours of exact rows are taken to predict one."""


def without_outliers(scenes, sigma):
    """Scenes in which gross errors are not seen.

    Parameters
    ----------
    scenes : sequence of Scene
    sigma : array-like, shape (d,), metres
        Standard deviation of a position; nan = an axis that is left out.

    Returns
    -------
    scenes : tuple of Scene
    notes : tuple of str
        What was left out.
    """
    sigma = np.asarray(sigma, dtype=float)
    extent = max(float(np.nanmax(s.positions) - np.nanmin(s.positions)) for s in scenes)
    is_exact = not np.nanmax(sigma) > EXACT * extent
    if is_exact:
        sigma = np.where(np.isfinite(sigma), RESOLUTION * extent, sigma)
    out, found = [], []
    for scene in scenes:
        positions = scene.positions.copy()
        for k in scene.dynamic:
            track = scene.times, scene.positions[:, k], sigma
            is_far = gross_errors(*track, is_exact=is_exact) > 1
            positions[is_far, k] = np.nan
            found += [
                f"{scene.names[k]} of {scene.name} at t = {time:.4g}"
                for time in scene.times[is_far]
            ]
        is_same = np.array_equal(positions, scene.positions, equal_nan=True)
        out.append(scene if is_same else replace(scene, positions=positions))
    if not found:
        return tuple(out), ()
    more = f" and {len(found) - LISTED} more" if len(found) > LISTED else ""
    listed = ", ".join(found[:LISTED])
    note = f"{CHECK}far off their neighbours, and left out of the fit: {listed}{more}"
    return tuple(out), (note,)
