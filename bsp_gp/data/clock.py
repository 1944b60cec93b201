"""Whether the times of a table can be right: a declared rate that they contradict."""

from __future__ import annotations

import numpy as np

__all__ = ["check_declared_rate"]

SAME_RATE = 0.01
"""Part by which a declared step and the steps of the times may differ."""
MOST_FRAMES = 25
"""Frames between two rows, at most: any step is nearly a whole number of much finer ones."""


def check_declared_rate(rows, declaration, second):
    """Compare the column t with a declared ``dt`` or ``fps``.

    The column counts in any case. Rows that are whole numbers of steps apart are gaps, or every
    k-th frame of a recording.

    Parameters
    ----------
    rows : Rows
        With times of the column t, increasing for every entity of a scene.
    declaration : Declaration
    second : float
        Of the unit of the column t, how many seconds it is.

    Returns
    -------
    tuple of str
        A note where rows are some whole steps apart throughout.

    Raises
    ------
    DataError
        Where the times of a scene contradict the declaration.
    """
    if declaration.fps is None and declaration.dt is None:
        return ()
    step = 1 / declaration.fps if declaration.dt is None else declaration.dt * second
    name = "dt" if declaration.fps is None else "fps"
    value = f"{name} = {getattr(declaration, name):g}"
    usual = {}
    for scene, gaps in _gaps_of_scenes(rows).items():
        counts = np.maximum(np.round(gaps / step), 1)
        # Digits that were rounded leave the mean right, some rows at odd times the median.
        means = gaps.sum() / counts.sum(), np.median(gaps / counts)
        is_same = min(abs(mean / step - 1) for mean in means) <= SAME_RATE
        usual[scene] = int(np.median(counts))
        if not is_same or usual[scene] > MOST_FRAMES:
            where = int(np.flatnonzero(rows.scene == scene)[0])
            rows.fail(
                f"the times of scene {rows.scene_names[scene]!r} are {np.median(gaps) / second:.4g}"
                f" apart, which contradicts {value} ({step / second:.4g} a frame)", where, "t",
                f"leave out {name} if column t is right; if it is not, give a column frame in its "
                "place; or mend the unit of time",
            )  # fmt: skip
    most = max(usual.values(), default=1)
    if most < 2:
        return ()
    return (
        f"rows are up to {most} frames of {value} apart: the times are those of column t; if the "
        f"recording has every frame, {name} contradicts them",
    )


def _gaps_of_scenes(rows):
    """Steps of time between successive rows of an entity, by scene code."""
    key = rows.scene * len(rows.entity_names) + rows.entity
    order = np.argsort(key, kind="stable")
    same = np.diff(key[order]) == 0
    gaps, scene = np.diff(rows.times[order])[same], rows.scene[order[1:]][same]
    return {int(code): gaps[scene == code] for code in np.unique(scene)}
