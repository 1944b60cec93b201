"""Bodies that never move while others do: held fast, as pegs, tripods and reference marks are.

Under gravity a mark on a tripod would have to fall. Whether a body is held is asked of its tracks
only where nobody has said it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.data.scene import CHECK

__all__ = ["held_still", "steadied"]

FEWEST_ROWS = 5
JITTER = 2.0
"""Standard deviations of a track, in those that its steps from row to row show, up to which it is
jitter about one place."""
ROWS_OF_HELD, WHITE, ALIKE = 10, 1.3, 3.0
"""Rows from which a body that is said to be held may jitter only; the same ratio, of errors that
know nothing of each other; and how far it may be off, in the error of bodies that move."""
LITTLE = 0.01
"""Part of the way of what moves most that this may be."""


def held_still(scenes):
    """Scenes whose bodies that never move are static, at their mean place, and what was done.

    Parameters
    ----------
    scenes : sequence of Scene

    Returns
    -------
    scenes : tuple of Scene
    notes : tuple of str
    """
    still = {}
    for scene in scenes:
        spans = {k: _span(scene.positions[:, k]) for k in scene.dynamic}
        longest = max(spans.values(), default=0.0)
        for k in scene.dynamic:
            is_still = _is_still(scene.positions[:, k], longest)
            name = scene.names[k]
            still[name] = still.get(name, True) and is_still
    names = [name for name, is_still in still.items() if is_still]
    if not names or len(names) == len(still):
        return tuple(scenes), ()
    told = ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
    note = (
        f"{CHECK}{told} never {'moves' if len(names) == 1 else 'move'}: taken as held fast at the "
        "mean place; a column dynamic of entities.csv (1: moved by forces, 0: held) says what holds"
    )
    held = [[k for k in scene.dynamic if scene.names[k] in names] for scene in scenes]
    return tuple(map(_with_held, scenes, held)), (note,)


def steadied(scene):
    """Positions of a scene with static bodies at their mean place where all that they do is jitter.

    A body that is held and was measured again and again is where it is: its error of each row,
    which is that of the bodies that move, is none of the forces that it exerts. One that is moved
    keeps its track.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    ndarray, shape (T, N, d), m
    """
    static = [k for k, entity in enumerate(scene.entities) if entity.is_static]
    static = [k for k in static if _is_jitter(scene.positions[:, k], ROWS_OF_HELD, WHITE)]
    if not static:
        return scene.positions
    errors = [_error(scene.positions[:, k]) for k in scene.dynamic]
    most = ALIKE * float(np.nanmedian(errors)) if len(errors) else np.nan
    held = [k for k in static if np.linalg.norm(_spread(scene.positions[:, k])) <= most]
    return _at_means(scene.positions, held) if held else scene.positions


def _error(places):
    """Of a place, as third differences of neighbouring rows tell it; nan of too few."""
    steps = np.diff(places[np.isfinite(places).all(axis=1)], 3, axis=0)
    return float(np.sqrt(np.square(steps).sum(axis=1).mean() / 20)) if len(steps) else np.nan


def _spread(places):
    """Standard deviations of the seen places, (d,)."""
    return places[np.isfinite(places).all(axis=1)].std(axis=0)


def _span(places):
    """The way from end to end, m."""
    seen = places[np.isfinite(places).all(axis=1)]
    return float(np.linalg.norm(np.ptp(seen, axis=0))) if len(seen) else 0.0


def _is_still(places, longest):
    seen = places[np.isfinite(places).all(axis=1)]
    if len(seen) < FEWEST_ROWS:
        return False
    is_one = _is_jitter(places) or not np.any(seen != seen[0])
    return is_one and float(np.linalg.norm(_spread(places))) < LITTLE * longest


def _is_jitter(places, n_rows=FEWEST_ROWS, most=JITTER):
    """Whether a track is jitter about one place, and not that place."""
    seen = places[np.isfinite(places).all(axis=1)]
    if len(seen) < n_rows or not np.any(seen != seen[0]):
        return False
    steps = np.sqrt(np.mean(np.square(np.diff(seen, axis=0)), axis=0) / 2)
    return bool(np.all(seen.std(axis=0) <= most * steps + 1e-12 * np.abs(seen).max()))


def _with_held(scene, held):
    """The scene with bodies, by their numbers, held at their mean places."""
    if not held:
        return scene
    entities = list(scene.entities)
    for k in held:
        entities[k] = replace(entities[k], is_static=True)
    places = _at_means(scene.positions, held)
    return replace(scene, positions=places, entities=tuple(entities))


def _at_means(positions, held):
    positions = positions.copy()
    for k in held:
        place = np.nanmean(positions[:, k], axis=0)
        positions[:, k] = np.where(np.isnan(positions[:, k]), np.nan, place)
    return positions
