"""The directions in which physics lives: axes, velocity, lines to bodies, contacts, regions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bsp_gp.loop.smooth_view import MAX_RUNS, runs_of, spline_basis
from bsp_gp.physics.geometry import contact_point

__all__ = ["Direction", "directions_of", "nearest_distance", "to_point"]

MAX_BODIES = 5
"""Other bodies to which lines are channels of their own."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A channel before anything is known of it.

    Attributes
    ----------
    name, kind : str
        As in `Channel`.
    inputs : tuple of str
    legs : callable
        ``legs(group) -> (vectors, active)``: unit vectors (n, S, R, L, d), 0 where there is none.
        The legs of a body are those of several sources, or of several normals.
    distances : callable or None
        ``distances(group)`` -> lengths of the legs, (n, S, R, L).
    sources : callable or None
        ``sources(group)`` -> index of the source of each leg, (S, R, L), -1 for none.
    is_summed : bool
        Whether one amplitude for all legs makes a law; normals in three dimensions do not.
    in_stays : bool
        Whether the push is a constant for each stay (in contact, over a region).
    place : tuple of float or None
        Of the unseen point.
    vector : str
        The unit vector as a law writes it; "" where it has no words for it.
    """

    name: str
    kind: str
    inputs: tuple
    legs: object
    distances: object = None
    sources: object = None
    is_summed: bool = True
    in_stays: bool = False
    place: tuple | None = None
    vector: str = ""

    def columns(self, group):
        """Coordinates of a free push in this direction, shape (S, R, D, C)."""
        legs = self.legs(group)
        n, n_scenes, n_receivers, n_legs, n_dims = legs.shape
        if self.in_stays:
            return group.project(_stays(legs))
        profiles = group.splines
        if n_legs > 1 and self.is_summed:
            # Several sources share about as many constants as one would have.
            keep = max(2, profiles.shape[2] // n_legs)
            profiles = np.stack([spline_basis(t, keep) for t in group.batch.times.T])
        pushes = legs[..., None, :] * profiles.transpose(1, 0, 2)[:, :, None, None, :, None]
        return group.project(pushes.reshape(n, n_scenes, n_receivers, -1, n_dims))


def _stays(legs):
    """One push for every stay of every leg, (n, S, R, C, d); at most `MAX_RUNS` per track."""
    n, n_scenes, n_receivers, n_legs, n_dims = legs.shape
    present = legs.any(axis=-1)
    found = {}
    for s in range(n_scenes):
        for r in range(n_receivers):
            found[s, r] = [
                (leg, *run) for leg in range(n_legs) for run in runs_of(present[:, s, r, leg])
            ][:MAX_RUNS]
    out = np.zeros((n, n_scenes, n_receivers, max(map(len, found.values()), default=0), n_dims))
    for (s, r), stays in found.items():
        for c, (leg, start, stop) in enumerate(stays):
            out[start:stop, s, r, c] = legs[start:stop, s, r, leg]
    return out


def unit(vectors):
    """Unit vectors; 0 where there is no direction."""
    vectors = np.nan_to_num(vectors)
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(size > 0, size, 1.0) * (size > 0)


def perp(vectors):
    """Vectors of a plane turned by +90 degrees."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def normals(along):
    """Two unit vectors across each of the unit vectors (n, ..., 3), carried along smoothly."""
    first = np.zeros_like(along)
    helper = np.zeros_like(along[0])
    for k, direction in enumerate(along):
        flat = helper - (helper * direction).sum(axis=-1, keepdims=True) * direction
        lost = np.linalg.norm(flat, axis=-1) < 1e-3
        fresh = np.eye(3)[np.argmin(np.abs(direction), axis=-1)]
        fresh = fresh - (fresh * direction).sum(axis=-1, keepdims=True) * direction
        first[k] = helper = unit(np.where(lost[..., None], fresh, flat))
    return first * along.any(axis=-1, keepdims=True), np.cross(along, first)


def across(along):
    """Legs across directions (n, S, R, L, d): one in the plane, two for every one in space."""
    if along.shape[-1] == 2:
        return perp(along)
    return np.concatenate(normals(along), axis=3)


# --- what stands at every instant ---------------------------------------------------------------


def _axis(group, axis):
    shape = (*group.batch.target.shape[:3], 1)
    out = np.zeros((*shape, group.batch.target.shape[3]))
    out[..., axis] = 1.0
    return out


def _velocity(group):
    return unit(group.batch.velocities[:, :, group.batch.bodies.receivers])[:, :, :, None]


def _gaps(group):
    """Separations p_i - p_j from every other entity, (n, S, R, N - 1, d)."""
    p, bodies = group.batch.positions, group.batch.bodies
    return p[:, :, bodies.receivers, None] - p[:, :, bodies.others]


def _others_named(group, name):
    """Which of the other entities of each receiver bears a name, (S, R, N - 1)."""
    names = np.array(group.batch.bodies.names)
    return names[:, group.batch.bodies.others] == name


def _line(group, name=None):
    """Unit vectors p_i - p_j: one leg to the body of that name, or a leg to every other one."""
    lines = unit(_gaps(group))
    if name is None:
        return lines
    return np.where(_others_named(group, name)[..., None], lines, 0.0).sum(axis=3, keepdims=True)


def _lengths(group, name=None):
    lengths = np.linalg.norm(_gaps(group), axis=-1)
    if name is None:
        return lengths
    return np.where(_others_named(group, name), lengths, 0.0).sum(axis=3, keepdims=True)


def _sources(group, name=None):
    others = group.batch.bodies.others
    index = np.broadcast_to(others, (len(group.batch.bodies.names), *others.shape))
    if name is None:
        return index
    mine = _others_named(group, name)
    return np.where(mine.any(axis=2), np.where(mine, index, 0).sum(axis=2), -1)[..., None]


def _touch(group):
    """Unit vectors from the contact point, where there is contact, a leg per other entity."""
    bodies, p = group.batch.bodies, group.batch.positions
    here, there = p[:, :, bodies.receivers, None], p[:, :, bodies.others]
    other = bodies.shapes[:, bodies.others]
    point = contact_point(here, other, there)
    return unit(here - point) * group.touching[..., None]


def _over(group):
    """The velocity, where a receiver is over a region, a leg per other entity."""
    return _velocity(group) * group.inside[..., None]


def _point(group, place):
    """Unit vectors from an unseen place."""
    p = group.batch.positions[:, :, group.batch.bodies.receivers]
    return unit(p - np.asarray(place))[:, :, :, None]


def _point_lengths(group, place):
    p = group.batch.positions[:, :, group.batch.bodies.receivers]
    return np.linalg.norm(p - np.asarray(place), axis=-1)[..., None]


def nearest_distance(group):
    """Distance to the nearest other entity, (n, S, R); nan where there is none."""
    lengths = _lengths(group)
    if not lengths.shape[3]:
        return np.full(lengths.shape[:3], np.nan)
    return lengths.min(axis=3)


# --- the list -----------------------------------------------------------------------------------


def _turned(legs, group):
    return across(legs(group))


def _pair(names, kind, inputs, legs, vector="", **settings):
    """A direction and the one across it."""
    turned = f"perp({vector})" if vector else ""
    yield Direction(names[0], kind, inputs, legs, vector=vector, **settings)
    yield Direction(names[1], kind, inputs, partial(_turned, legs), vector=turned, **settings)


def directions_of(view, up=None):
    """All channels of a view but the unseen point.

    Parameters
    ----------
    view : SmoothView
    up : str or None
        Declared vertical axis.

    Returns
    -------
    list of Direction
    """
    batch = view.groups[0].batch
    n_dims = batch.target.shape[3]
    flat = n_dims == 2
    out = []
    for axis in range(n_dims):
        letter = "xyz"[axis]
        vertical = ("up", "down") if up and up[-1] == letter else ()
        name = f"along {letter}" + (" (vertical)" if vertical else "")
        inputs = (f"e_{letter}", *vertical)
        out.append(Direction(name, "axis", inputs, partial(_axis, axis=axis), vector=f"e_{letter}"))
    if n_dims > 1:
        out += _pair(
            ("along the velocity", "across the velocity"),
            "velocity",
            ("v_i", "v_j"),
            _velocity,
            "normalize(v_i)",
        )
        out[-1] = _as_normals(out[-1], flat)
    if not any(group.touching.shape[3] for group in view.groups):
        return out
    names = _names_of_others(view)
    for name in names if len(names) <= MAX_BODIES else ():
        out += _lines(f"the line to {name}", name, flat, len(names) == 1)
    if len(names) > 1:
        out += _lines("the lines to all other bodies", None, flat, True)
    if any(group.touching.any() for group in view.groups):
        inputs = ("s_i", "s_j", "p_i", "p_j", "p_c")
        pair = ("along the line to the contact point", "across the line to the contact point")
        out += _pair(pair, "contact", inputs, _touch, in_stays=True)
        out[-1] = _as_normals(out[-1], flat)
    if any(group.inside.any() for group in view.groups):
        inputs = ("s_i", "s_j", "p_i", "p_j", "v_i", "v_j")
        pair = ("along the velocity, over a region", "across the velocity, over a region")
        out += _pair(pair, "region", inputs, _over, in_stays=True)
        out[-1] = _as_normals(out[-1], flat)
    return out


def _lines(words, name, flat, is_all):
    """Along and across the line to a body, or to all of them."""
    settings = {"distances": partial(_lengths, name=name), "sources": partial(_sources, name=name)}
    legs = partial(_line, name=name)
    pair = (f"along {words}", f"across {words}")
    vector = "normalize(p_i - p_j)" if is_all else ""
    along, turned = _pair(pair, "line", ("p_i", "p_j", "v_j"), legs, vector, **settings)
    return along, _as_normals(turned, flat)


def _as_normals(direction, flat):
    """In space a direction has two normals, and no single amplitude for both."""
    return direction if flat else replace(direction, is_summed=False, vector="")


def _names_of_others(view):
    """Names of the entities that act on some receiver, those in most scenes first."""
    counts = {}
    for group in view.groups:
        bodies = group.batch.bodies
        acting = set(bodies.others.ravel().tolist())
        for names in bodies.names:
            for index in acting:
                counts[names[index]] = counts.get(names[index], 0) + 1
    return sorted(counts, key=lambda name: (-counts[name], name))


def to_point(place):
    """The channel along the line to an unseen place."""
    return Direction(
        "along the line to an unseen point",
        "point",
        (),
        partial(_point, place=tuple(place)),
        partial(_point_lengths, place=tuple(place)),
        place=tuple(map(float, place)),
    )
