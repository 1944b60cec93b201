"""Bodies that never move while others do: held fast, as pegs, tripods and reference marks are.

Under gravity a mark on a tripod would have to fall. Whether a body is held is asked of its tracks
only where nobody has said it.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.data.scene import CHECK
from bsp_gp.errors import in_python

FEWEST_ROWS = 5
JITTER = 2.0
"""Standard deviations of a track, in those that its steps from row to row show, up to which it is
jitter about one place."""
LITTLE = 0.01
"""Part of the way of what moves most that this may be."""


def held_still(scenes, free=()):
    """Scenes whose bodies that never move are static, at their mean place, and what was done.

    Nothing holds the bodies in `free`, of the sky, with known masses: a heavy one hardly moves, and
    that it does shows in the others' periods. One without any jitter is where places count from.
    """
    still, moves = {}, False
    for scene in scenes:
        spans = {k: _span(scene.positions[:, k]) for k in scene.dynamic}
        longest = max(spans.values(), default=0.0)
        moves |= longest > 0 or not spans
        for k in scene.dynamic:
            is_still = _is_still(scene.positions[:, k], longest)
            name = scene.names[k]
            is_still &= name not in free or not spans[k]
            still[name] = still.get(name, True) and is_still
    names = [name for name, is_still in still.items() if is_still]
    if not moves:
        return tuple(scenes), (in_python(
            f"{CHECK}nothing moves: all places are the same in all rows; if other columns have the "
            "places, say which: --columns x=NAME y=NAME"
        ),)  # fmt: skip
    if not names or len(names) == len(still):
        return tuple(scenes), ()
    told = ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
    note = (
        f"{CHECK}{told} never {'moves' if len(names) == 1 else 'move'}: taken as held fast at the "
        "mean place; a column dynamic of entities.csv (1: moved by forces, 0: held) says what holds"
    )
    return tuple(_with_held(scene, set(names)) for scene in scenes), (note,)


def _span(places):
    """The way from end to end, m."""
    seen = places[np.isfinite(places).all(axis=1)]
    return float(np.linalg.norm(np.ptp(seen, axis=0))) if len(seen) else 0.0


def _is_still(places, longest):
    seen = places[np.isfinite(places).all(axis=1)]
    if len(seen) < FEWEST_ROWS:
        return False
    spread = seen.std(axis=0)
    steps = np.sqrt(np.mean(np.square(np.diff(seen, axis=0)), axis=0) / 2)
    is_jitter = bool(np.all(spread <= JITTER * steps + 1e-12 * np.abs(seen).max()))
    return is_jitter and float(np.linalg.norm(spread)) < LITTLE * longest


def _with_held(scene, names):
    held = [k for k in scene.dynamic if scene.names[k] in names]
    if not held:
        return scene
    positions, entities = scene.positions.copy(), list(scene.entities)
    for k in held:
        place = np.nanmean(positions[:, k], axis=0)
        positions[:, k] = np.where(np.isnan(positions[:, k]), np.nan, place)
        entities[k] = replace(entities[k], is_static=True)
    return replace(scene, positions=positions, entities=tuple(entities))
