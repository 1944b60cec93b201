"""Bodies of one table that are never seen at the same time: recordings of their own.

One file may hold throw after throw of one ball, each under a name of its own. As one scene every
throw would exist from the first row on, long before it is seen, and a law that brings tracks
together in the past (drag, run backwards) could not be fitted at all.
"""

from dataclasses import replace

import numpy as np

MAX_NAMES = 3
"""Bodies that the name of a scene tells, and scenes that a note lists times four."""


def recordings_apart(rows, roster, has_scenes):
    """Rows of one scene as scenes of bodies whose times overlap, directly or through others.

    Parameters
    ----------
    roster : Roster or None
        Where it holds bodies that do not move, or speaks of scenes, nothing is taken apart: a wall
        is there though it is seen once.
    has_scenes : bool
        Whether the table says which rows are one scene; then it is believed.
    """
    if has_scenes or len(rows.entity_names) < 2 or _has_own_scenes(roster):
        return rows, ()
    group_of = _groups(rows)
    n_groups = int(group_of.max()) + 1
    if n_groups < 2:
        return rows, ()
    members = [np.flatnonzero(group_of == k) for k in range(n_groups)]
    names = tuple(_name([rows.entity_names[body] for body in group]) for group in members)
    listed = ", ".join(names[: 4 * MAX_NAMES])
    listed += ", …" if n_groups > 4 * MAX_NAMES else ""
    what = "bodies" if n_groups == len(rows.entity_names) else "groups of bodies"
    note = f"{n_groups} {what} that are never seen at the same time: {n_groups} scenes ({listed})"
    return replace(rows, scene=group_of[rows.entity], scene_names=names), (note,)


def _has_own_scenes(roster):
    if roster is None:
        return False
    is_still = any(entity.is_static for entity in roster.entities)
    return is_still or any(scene is not None for scene, _ in roster.rows)


def _groups(rows):
    """Group of every entity, shape (n_entities,), in order of their first rows."""
    n_bodies = len(rows.entity_names)
    begin, end = np.full(n_bodies, np.inf), np.full(n_bodies, -np.inf)
    np.minimum.at(begin, rows.entity, rows.times)
    np.maximum.at(end, rows.entity, rows.times)
    order = np.argsort(begin, kind="stable")
    seen_until = np.maximum.accumulate(end[order])
    begins_anew = np.append(0, begin[order][1:] > seen_until[:-1])
    groups = np.empty(n_bodies, dtype=np.int64)
    groups[order] = np.cumsum(begins_anew)
    return groups


def _name(bodies):
    if len(bodies) > MAX_NAMES:
        return f"{bodies[0]} and {len(bodies) - 1} more"
    return " and ".join(bodies)
