"""What the size of a residual may depend on: speed, distance, time, declared properties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bsp_gp.language.inputs import SHORT
from bsp_gp.loop.channels import nearest_distance
from bsp_gp.units import Unit

__all__ = ["Quantity", "masses_of", "quantities_of"]

FLOOR = 0.01
"""Part of its typical size below which a quantity counts as this part, so that powers are finite"""
MIN_RANGE = 1.15
"""Factor between the 5 % and the 95 % point below which a quantity hardly varies."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """A positive number at every instant, receiver and leg.

    Attributes
    ----------
    name : str
        speed, distance, stretch (distance less rest length), time, or a property with its role, as
        laws write it: m_i, q_j.
    logs : list of ndarray, shape (n or 1, S, R, L or 1)
        Per group, logarithms over the typical size.
    signs : list of ndarray or None
        Where it has both.
    typical : float
    unit : Unit or None
    is_property, varies_in_track : bool
    spread : float
        Factor between its 5 % and 95 % points.
    """

    name: str
    logs: list
    signs: list | None
    typical: float
    unit: object
    is_property: bool
    varies_in_track: bool
    spread: float

    def values(self, group):
        """The quantity itself, in group number `group`."""
        return self.typical * np.exp(self.logs[group])


def quantities_of(view, direction, dataset):
    """Everything that the push in a direction may depend on.

    Parameters
    ----------
    view : SmoothView
    direction : Direction
    dataset : Dataset
        For units of properties.

    Returns
    -------
    list of Quantity
        Motion first, then properties; those that are unknown for some body are left out.
    """
    legs = [direction.legs(group) for group in view.groups]
    masks = [
        leg.any(axis=-1) & group.batch.valid.any(axis=-1)[..., None]
        for leg, group in zip(legs, view.groups, strict=True)
    ]
    out = []
    for name, values, unit in _motions(view, direction):
        out.append(_quantity(name, values, masks, unit, False))
    for name, values, unit in _properties(view, direction, dataset):
        out.append(_quantity(name, values, masks, unit, True))
    return [q for q in out if q is not None]


def _motions(view, direction):
    receivers = [group.batch.bodies.receivers for group in view.groups]
    yield (
        "speed",
        [
            np.linalg.norm(g.batch.velocities[:, :, r], axis=-1)[..., None]
            for g, r in zip(view.groups, receivers, strict=True)
        ],
        Unit.of(m=1, s=-1),
    )
    if direction.distances is not None:
        lengths = [direction.distances(g) for g in view.groups]
        yield "distance", lengths, Unit.of(m=1)
        rest = [values for name, values, _ in _columns(view, direction) if name == "l_j"]
        if rest:
            stretch = [length - own for length, own in zip(lengths, rest[0], strict=True)]
            yield "stretch", stretch, Unit.of(m=1)
    else:
        nearest = [nearest_distance(g)[..., None] for g in view.groups]
        if all(np.isfinite(d).any() for d in nearest):
            yield "distance", nearest, Unit.of(m=1)
    since = []
    for group in view.groups:
        times = group.batch.times
        step = np.nanmedian(np.diff(times, axis=0)) if len(times) > 1 else 1.0
        since.append((times - np.nanmin(times, axis=0) + step)[:, :, None, None])
    yield "time", since, Unit.of(s=1)


def _properties(view, direction, dataset):
    for name, values, column in _columns(view, direction):
        unit = dataset.property_units.get(column)
        yield name, values, Unit.of(m=1) if column == "radius" and unit is None else unit


def _columns(view, direction):
    """Properties of receivers and of the sources of legs: name, values, column."""
    columns = {name for g in view.groups for name in g.batch.bodies.properties}
    for column in sorted(columns):
        arrays = [g.batch.bodies.column(column) for g in view.groups]
        if any(a.ndim != 2 for a in arrays):
            continue
        stem = SHORT.get(column, column)
        own = [
            a[:, g.batch.bodies.receivers][None, :, :, None]
            for a, g in zip(arrays, view.groups, strict=True)
        ]
        yield f"{stem}_i", own, column
        if direction.sources is not None:
            of_sources = []
            for a, g in zip(arrays, view.groups, strict=True):
                index = direction.sources(g)
                scene = np.arange(len(a))[:, None, None]
                of_sources.append(np.where(index >= 0, a[scene, np.maximum(index, 0)], 1.0)[None])
            yield f"{stem}_j", of_sources, column


def _quantity(name, values, masks, unit, is_property):
    """None where it is unknown or zero for something that counts, or the same everywhere."""
    shown = np.concatenate(
        [np.broadcast_to(v, m.shape)[m] for v, m in zip(values, masks, strict=True)]
    )
    sizes = np.abs(shown)
    if is_property and not (np.isfinite(shown).all() and (sizes > 0).all() and len(shown)):
        return None
    sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
    if not len(sizes):
        return None
    typical = float(np.exp(np.mean(np.log(sizes)))) if is_property else float(np.median(sizes))
    low, high = np.quantile(np.maximum(sizes, FLOOR * typical), [0.05, 0.95])
    if is_property:
        low, high = sizes.min(), sizes.max()
        if high <= low * (1 + 1e-9):
            return None
    logs, signs = [], []
    for value in values:
        size = np.nan_to_num(np.abs(value), nan=typical, posinf=typical)
        logs.append(np.log(np.maximum(size, FLOOR * typical) / typical))
        signs.append(np.where(np.nan_to_num(value) < 0, -1.0, 1.0))
    has_signs = (shown < 0).any() and (shown > 0).any()
    return Quantity(
        name, logs, signs if has_signs else None, typical, unit, is_property,
        _varies(logs, masks) if is_property else True, float(high / low),
    )  # fmt: skip


def _varies(logs, masks):
    """Whether a property differs between the sources of one receiver."""
    for log, mask in zip(logs, masks, strict=True):
        legs = mask.any(axis=0)  # (S, R, L)
        values = np.broadcast_to(log[0], legs.shape)
        for s, r in np.ndindex(legs.shape[:2]):
            mine = values[s, r][legs[s, r]]
            if len(mine) > 1 and np.ptp(mine) > 1e-9:
                return True
    return False


def masses_of(view):
    """Masses of receivers over the typical one, (1, S, R, 1) per group; None if one is unknown."""
    masses = [
        g.batch.bodies.column("mass")[:, g.batch.bodies.receivers][None, :, :, None]
        for g in view.groups
    ]
    known = np.concatenate([m.ravel() for m in masses])
    if not (np.isfinite(known).all() and (known > 0).all()):
        return None
    return [m / np.exp(np.mean(np.log(known))) for m in masses]
