"""Forces that repeat along an axis: a washboard, an egg crate, an optical lattice."""

from functools import partial

import numpy as np

from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.language.formula import Call, Constant
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.proposers.periods import (
    MOST_FREQUENCIES,
    NYQUIST,
    OVERSAMPLING,
    Scan,
    coordinate_of,
    scanned,
    text_of,
    variants,
    waving,
)
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, fresh_name

FEWEST = 2.0
"""Periods within the extent of the tracks; of fewer nobody knows that they repeat."""
SHORTEST = 1.0
"""Radians by which a standard deviation of a place may move a wave."""


class Ripples:
    """Forces along axes that repeat with the coordinate, one period for all axes."""

    name = "ripples"

    def propose(self, view):
        """The family of all wavenumbers."""
        axes = np.flatnonzero(np.isfinite(view.fit.noise.levels))
        numbers = _wavenumbers(view, axes)
        if view.is_sky or not len(numbers):
            return Family(self.name, null=np.zeros(view.moment_draws.shape[1]))
        scan = _Placed(view, numbers, np.column_stack([view.left, view.draws_left]))
        kinds = (
            ([scan.kernels(weights, axis) for axis in axes],
             partial(_proposal, view, numbers, has_mass, ties))
            for has_mass, weights, ties in variants(view)
        )  # fmt: skip
        return scanned(self.name, scan, axes, kinds)


class _Placed(Scan):
    """Gains of waves along the coordinates of bodies in place of time."""

    def kernels(self, weights, axis):
        """An axis, and moments by the push along it of every body at every instant."""
        out = []
        for batch, weight in zip(self.batches, weights, strict=True):
            acting = np.where(batch.valid[..., axis], weight, 0.0)  # (n, S, R)
            each = np.einsum("smnr,nsr->smnr", batch.whitener[..., axis], acting)
            out.append(each.reshape(*each.shape[:2], -1))
        return axis, out

    def waves(self, kernel, rates):
        """Moments of cosines and sines, (n, F, 2)."""
        axis, matrices = kernel
        places = [b.positions[:, :, b.bodies.receivers, axis] for b in self.batches]
        phases = [np.moveaxis(place, 1, 0).reshape(place.shape[1], -1) for place in places]
        return self.waves_of(phases, matrices, rates)


def _wavenumbers(view, axes):
    """From few periods within the tracks up to the Nyquist limit of their steps, rad/m."""
    extent, steps = 0.0, []
    for scene in view.dataset.scenes:
        places = scene.positions[:, scene.dynamic][..., axes]
        extent = max(extent, float(np.nanmax(np.nanmax(places, 0) - np.nanmin(places, 0))))
        tracks = places.reshape(len(places), -1).T
        steps += [np.abs(np.diff(own[np.isfinite(own)])) for own in tracks]
    steps = np.concatenate(steps)
    step = float(np.median(steps)) if len(steps) else 0.0
    error = float(np.nanmax(view.fit.noise.levels))
    if not (extent > 0 and step > 0 and error > 0):
        return np.array([])
    low, high = FEWEST * 2 * np.pi / extent, min(NYQUIST * np.pi / step, SHORTEST / error)
    count = int(OVERSAMPLING * FEWEST * (high / low - 1)) + 1 if high > low else 0
    return low * (1 + np.arange(min(count, MOST_FREQUENCIES)) / (OVERSAMPLING * FEWEST))


def _proposal(view, numbers, has_mass, ties, axes, number, gain):
    terms, constants = _ripple(view, axes, has_mass)
    name = next(reversed(constants))
    constants[name] = number
    other = [text_of(_ripple(view, axes, True)[0])] if ties else []
    return Proposal(
        "ripple", text_of(terms), view.hypothesis + Forces(ForceLaw(terms, constants)),
        -(1 + has_mass) * view.criteria.cause_nats, float(gain), 2 * len(axes) + 1,
        {name: number}, {name: (float(numbers[0]), float(numbers[-1]))}, ties=tuple(other),
    )  # fmt: skip


def _ripple(view, axes, has_mass):
    """Terms of one wavenumber, one per axis, and their constants, the wavenumber last."""
    types, number = dataset_types(view.dataset), Constant(fresh_name(view.fit.law, "q"))

    def angle(axis):
        return Call("mul", number, coordinate_of(types, axis)[0])

    return waving(view, axes, number, angle, has_mass)
