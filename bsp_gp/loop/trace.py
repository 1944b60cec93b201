"""Questions 2 and 3 of the loop: where and when the residual is, and what it depends on.

The residual accelerations of the fitted model, whitened and reduced to their smooth part
(`smooth_view`), are taken apart in the directions in which physics lives (`channels`): for each,
how much of the sum of squares a free smooth push explains beyond what noise would (`shares`). In
the leading directions its size is followed against speed, distance, time and the declared
properties (`exponents`).
"""

from __future__ import annotations

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.loop.channels import directions_of, nearest_distance, to_point
from bsp_gp.loop.exponents import exponents_of
from bsp_gp.loop.shares import Resampling, carriers, explain
from bsp_gp.loop.smooth_view import smooth_view
from bsp_gp.loop.stand_in import fit_with_stand_in
from bsp_gp.loop.traced import Carrier, Channel, Segment, Trace

__all__ = ["trace_residual"]

TIE_NATS = 12.0
"""Channels whose evidence is within this of the best lead as well."""
ENOUGH = 0.95
"""Share at which no further channel is looked for beside the leading ones."""
MOST_LEADING = 3
MOST_CARRIERS = 12
GRID_WORK = 1e9
"""Bound on the multiplications spent on the grid of unseen points."""
GRID = (5, 13)
NEAR = 0.5
"""Part of the median distance to the nearest body below which one is near."""


def trace_residual(observation, fit, rng):
    """Say where the residual of a fitted model is, and what it depends on.

    Parameters
    ----------
    observation : Observation
    fit : Fit
        Of the model, to the training scenes.
    rng : numpy.random.Generator
        For resampling.

    Returns
    -------
    Trace or None
        None where the law has no finite value at the denoised states.
    """
    try:
        view = smooth_view(observation, fit)
    except EvaluationError:
        return None
    dataset = observation.dataset
    resampling = Resampling(view, rng)
    found = [(d, *_explained(view, d)) for d in directions_of(view, dataset.up)]
    found = [row for row in found if row[2].n_free]
    if found and found[0][1][0].shape[2]:
        found += _unseen_point(view)
    found.sort(key=lambda row: -row[2].evidence(view.size))
    leading, companions = _leading(view, resampling, found)
    channels = tuple(
        _channel(view, resampling, direction, explained, direction in leading)
        for direction, _, explained in found
    )

    def nearer(direction, scaling, powers):
        along = fit_with_stand_in(observation, fit, direction, scaling, powers)
        try:
            return smooth_view(observation, fit, along) if along is not None else None
        except EvaluationError:
            return None

    exponents = _exponents(view, found, leading[:MOST_LEADING], companions, dataset, nearer)
    total = float(sum(np.square(target).sum() for target in view.target))
    return Trace(
        channels,
        tuple(_segments(view, resampling)),
        *(
            tuple(Carrier(*row) for row in carriers(resampling, place)[:MOST_CARRIERS])
            for place in (1, 0)
        ),
        tuple(exponents),
        resampling.method,
        total / max(view.size, 1),
        view.notes,
    )


def _explained(view, direction):
    columns = [direction.columns(group) for group in view.groups]
    return columns, explain(view, columns)


def _channel(view, resampling, direction, explained, is_leading):
    return Channel(
        direction.name,
        direction.kind,
        *resampling.share(explained),
        explained.n_free,
        float(explained.evidence(view.size)),
        is_leading,
        direction.inputs,
        direction.place,
    )


def _leading(view, resampling, found):
    """The best direction and those that tie with it, and what explains the rest beside them.

    An unseen point leads where it is better than all that is seen; what is seen leads as well.

    Returns
    -------
    leading, companions : list of Direction
        Companions explain the residual together.
    """
    total = resampling.total.sum()
    seen = [row for row in found if row[0].kind != "point"]
    if not seen or not total > 0 or found[0][2].evidence(view.size) <= 0:
        return [], []
    best, columns, explained = seen[0]
    bar = explained.evidence(view.size) - TIE_NATS
    leading = [d for d, _, e in seen if e.evidence(view.size) >= bar]
    companions = [best]
    while len(leading) < MOST_LEADING and _net(explained) < ENOUGH * total:
        beside = []
        for direction, more, _ in seen:
            if direction not in leading:
                joined = [np.concatenate(p, axis=3) for p in zip(columns, more, strict=True)]
                beside.append((direction, joined, explain(view, joined)))
        if not beside:
            break
        further = max(beside, key=lambda row: row[2].evidence(view.size))
        if further[2].evidence(view.size) < explained.evidence(view.size) + TIE_NATS:
            break
        leading.append(further[0])
        companions.append(further[0])
        _, columns, explained = further
    bar += 2 * TIE_NATS
    points = [d for d, _, e in found if d.kind == "point" and e.evidence(view.size) > bar]
    return points + leading, companions


def _exponents(view, found, leading, companions, dataset, nearer):
    """Exponents in the leading channels, each beside free pushes in those that complement it."""
    out = []
    for direction, *_ in found:
        if direction in leading and direction.is_summed:
            others = companions if direction in companions else []
            others = [d for d in others if d is not direction]
            out += exponents_of(view, direction, dataset, others, None if others else nearer)
    return out


def _net(explained):
    return float((explained.gain - explained.freedom).sum())


def _unseen_point(view):
    """The channel along the line to the place that explains most, as a row of the list."""
    from scipy.optimize import minimize

    places = np.concatenate(
        [
            g.batch.positions[:, :, g.batch.bodies.receivers].reshape(-1, g.maps.shape[2])
            for g in view.groups
        ]
    )
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    span = np.max(high - low)
    if not span > 0 or len(low) < 2:
        return []
    low, high = low - 0.75 * span, high + 0.75 * span
    work = sum(g.maps.size * g.splines.shape[2] for g in view.groups)
    count = int(np.clip((GRID_WORK / work) ** (1 / len(low)), *GRID))

    def loss(place):
        return -float(_explained(view, to_point(place))[1].gain.sum())

    axes = [np.linspace(a, b, count) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
    start = grid[int(np.argmin([loss(place) for place in grid]))]
    corners = np.vstack([start, start + np.diag((high - low) / count)])
    corners = np.clip(corners, low, high)
    options = {"initial_simplex": corners, "maxfev": 80, "xatol": 1e-4 * span, "fatol": 0.1}
    place = minimize(loss, start, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)),
                     options=options).x  # fmt: skip
    direction = to_point(place)
    columns, explained = _explained(view, direction)
    if not explained.n_free:
        return []
    # The place itself has been fitted.
    explained.freedom[:] += len(place) / len(explained.freedom)
    return [(direction, columns, explained)]


# --- parts of the motion ------------------------------------------------------------------------


def _segments(view, resampling):
    """What a push of any direction in each part of the motion explains."""
    distances = [nearest_distance(group) for group in view.groups]
    known = np.concatenate([d[np.isfinite(d)] for d in distances])
    bar = NEAR * float(np.median(known)) if len(known) else 0.0
    masks = {}
    for group, distance in zip(view.groups, distances, strict=True):
        seen = group.batch.valid.any(axis=-1)
        touching = seen & group.touching.any(axis=-1)
        inside = seen & group.inside.any(axis=-1) & ~touching
        with np.errstate(invalid="ignore"):
            near = seen & (distance < bar) & ~touching & ~inside
        parts = {
            "in contact": touching,
            "over a region": inside,
            "near another body": near,
            "free flight": seen & ~touching & ~inside & ~near,
        }
        for name, mask in parts.items():
            masks.setdefault(name, []).append(mask)
    for name, parts in masks.items():
        n_rows = int(sum(mask.sum() for mask in parts))
        if n_rows:
            columns = [_pushes(g, mask) for g, mask in zip(view.groups, parts, strict=True)]
            yield Segment(name, n_rows, *resampling.share(explain(view, columns)))


def _pushes(group, mask):
    """A free push along every axis where the mask holds, (S, R, D, C)."""
    n_dims = group.batch.target.shape[3]
    profiles = group.splines.transpose(1, 0, 2)[:, :, None] * mask[..., None]  # (n, S, R, C)
    pushes = profiles[..., None, None] * np.eye(n_dims)
    return group.project(pushes.reshape(*mask.shape, -1, n_dims))
