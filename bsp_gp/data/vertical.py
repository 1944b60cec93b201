"""The vertical where a law speaks of it and nothing declares it: the axis that is called so."""

from dataclasses import replace

import numpy as np

from bsp_gp.data.scene import CHECK
from bsp_gp.units import UNCALIBRATED

VERTICAL = {"up", "down"}
SURE = 10.0
"""Standard errors of a curvature from which an axis counts downwards."""


def with_vertical(dataset, names):
    """A data set with a vertical, where names of a law ask for one and nothing declares it.

    Height is y, or z in three dimensions. Not where that axis may count downwards, as of pixels and
    of bodies that all gain along it, nor where nothing moves along it: there a user must say.
    """
    axis = dataset.n_dims - 1
    if dataset.up is not None or not VERTICAL & set(names) or axis < 1:
        return dataset
    if dataset.units.symbols.get("m") in UNCALIBRATED.values():
        return dataset
    bends = [bend for scene in dataset.scenes for bend in _bends(scene, axis)]
    if not any(np.isfinite(bend) for bend in bends) or all(bend > SURE for bend in bends):
        return dataset
    name = "xyz"[axis]
    note = (
        f"{CHECK}{name} is taken as the height, since the law speaks of a vertical and none is "
        f"declared; if that is so, write --up {name}, and --up=-{name} where it counts downwards"
    )
    return replace(dataset, up=name, notes=(*dataset.notes, note))


def _bends(scene, axis):
    """Curvatures along an axis in their standard errors, one per body; nan where it is at rest."""
    for k in scene.dynamic:
        places = scene.positions[:, k, axis]
        seen = np.isfinite(places) & np.isfinite(scene.times)
        times = scene.times[seen]
        if seen.sum() < 4 or not np.ptp(places[seen]) > 0:
            yield np.nan
            continue
        u = (times - times.mean()) / np.ptp(times)
        columns = np.stack([np.ones_like(u), u, u * u], axis=1)
        amounts = np.linalg.lstsq(columns, places[seen], rcond=None)[0]
        left = np.square(places[seen] - columns @ amounts).sum() / (len(u) - 3)
        error = np.sqrt(left * np.linalg.inv(columns.T @ columns)[2, 2])
        yield float(amounts[2] / max(error, np.finfo(float).tiny))
