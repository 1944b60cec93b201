"""Whole tracks as a problem of the least-squares driver, and the noise that weighs their rows."""

from dataclasses import dataclass

import numpy as np

from bsp_gp.fitting.channels import split
from bsp_gp.fitting.problem import Linearised
from bsp_gp.fitting.whitening import whitener_of
from bsp_gp.physics.engine.flow import Flow


class ChainNoise:
    """The noise of the rows of some chains.

    Parameters
    ----------
    times : ndarray, shape (T, S), s
    variance : ndarray, shape (T, S, R, d), m^2
        Of the white part; nan = not seen.
    amplitude : ndarray, shape (T, S, R, d), m
        Standard deviation of the part with a memory.
    correlation_time : float, s
    adding : Adding, optional
        As of `NoiseModel`.
    """

    def __init__(self, times, variance, amplitude=None, correlation_time=0.0, adding=None):
        self.times, self.variance = times, variance
        self.amplitude = np.zeros(variance.shape) if amplitude is None else amplitude
        self.correlation_time, self.adding = correlation_time, adding
        self._lengths = np.isfinite(times).sum(axis=0)
        self._whiteners = {}

    def whiten(self, errors, rows, chain):
        """Errors of unit covariance, 0 where nothing was seen.

        Parameters
        ----------
        errors : ndarray, shape (c, L, W, R, d)
            Not finite = not seen: outside of a window.
        rows : ndarray of int, shape (L, W)
        chain : ndarray of int, shape (W,)
        """
        is_white = not self.amplitude.any() and not self.adding
        if is_white or len(rows) < self._lengths[chain].max():
            # Within windows that are pieces of tracks the memory is left out: they only lead on.
            variance = self.variance[rows, chain] + np.square(self.amplitude[rows, chain])
            seen = np.isfinite(variance) & np.isfinite(errors[-1])
            size = np.sqrt(np.where(seen, variance, 1.0))
            return np.where(seen, errors, 0.0) / size
        n = len(rows)
        key = n, chain.tobytes()
        if key not in self._whiteners:
            variance = self.variance[:n, chain]
            shape = variance.shape
            times = np.broadcast_to(self.times[:n, chain, None, None], shape).reshape(n, -1)
            variance = variance.reshape(n, -1)
            amplitude = self.amplitude[:n, chain].reshape(n, -1)
            self._whiteners[key] = whitener_of(
                times, variance, amplitude, self.correlation_time, self.adding
            )
        flat = np.where(np.isfinite(errors), errors, 0.0).reshape(*errors.shape[:2], -1)
        return self._whiteners[key].whiten(flat).reshape(errors.shape)

    @property
    def least(self):
        """Least standard deviation of a row of each chain, (S,); inf where none was seen."""
        variance = np.where(np.isfinite(self.variance), self.variance, np.inf)
        return np.sqrt(variance.min(axis=(0, 2, 3)))

    @property
    def n_seen(self):
        return int(np.isfinite(self.variance).sum())


def chain_noises(groups, white, amplitude, model):
    """The noise of the rows of groups of chains, from parts (T, C) of a model's, tuple."""
    parts = zip(groups, split(white, groups), split(np.nan_to_num(amplitude), groups), strict=True)
    return tuple(
        ChainNoise(chains.times, variance, size, model.correlation_time, model.adding)
        for chains, variance, size in parts
    )


@dataclass(frozen=True, eq=False)
class TrackPoint:
    """Where a fit is.

    Attributes
    ----------
    values : ndarray, shape (k,)
        Of the constants, in the coordinates of the problem.
    nodes : tuple of ndarray, shape (2, R, d, T, S)
        State at every row, per group of like-built chains.
    """

    values: np.ndarray
    nodes: tuple


@dataclass(frozen=True, eq=False)
class TrackLinearised(Linearised):
    """Tracks linearised; `condensed` holds what moves their nodes."""

    condensed: tuple = ()

    def own(self, reins):
        first, out = 0, []
        for part in (part for parts in self.condensed for part in parts):
            some = reins[first : first + len(part.factor)]
            first += len(some)
            image = part.image(some)
            along = (image * part.image(np.ones(len(some)))).sum(axis=1)
            out.append(np.stack([along, np.square(image).sum(axis=1)]))
        return np.concatenate(out, axis=1)


class TrackProblem:
    """Tracks cut into windows, for `least_squares.minimise`.

    Parameters
    ----------
    shootings : sequence of Shooting
        One per group of like-built chains.
    coordinates : Coordinates
        Between the driver's unknowns and the constants of the law.
    ridge : tuple of ndarray, shape (k,), optional
        Where unknowns are expected, and inverse standard deviations: their priors, or on the way,
        where few rows may determine nothing of a constant.
    """

    def __init__(self, shootings, meshes, coordinates, ridge=None):
        self.shootings, self.meshes = tuple(shootings), tuple(meshes)
        self.coordinates = coordinates
        self.ridge = ridge

    def values(self, point):
        return point.values

    def linearise(self, point):
        """The tracks linearised about a point, initial states eliminated."""
        if not all(mesh.is_complete for mesh in self.meshes):
            return None
        constants, slopes = self.coordinates.constants(point.values)
        residuals, jacobians, rests, condensed, rounding = [], [], [], [], 0.0
        for shooting, mesh, nodes in zip(self.shootings, self.meshes, point.nodes, strict=True):
            residual, jacobian, own, parts = shooting.linearise(constants, nodes, mesh)
            residuals.append(residual)
            jacobians.append(jacobian)
            rests.append(own)
            rounding += shooting.rounding(parts, nodes)
            condensed.append(parts)
        residual, rests = np.concatenate(residuals), np.concatenate(rests)
        block = np.repeat(np.arange(len(rests)), len(residual) // max(len(rests), 1))
        with np.errstate(all="ignore"):  # constants that run away are refused below
            jacobian = -np.concatenate(jacobians) @ slopes  # of the residual
            if self.ridge is not None:
                centre, pull = self.ridge
                residual = np.concatenate([residual, pull * (point.values - centre)])
                jacobian = np.concatenate([jacobian, np.diag(pull)])
        return TrackLinearised(residual, jacobian, rests, block, rounding, tuple(condensed))

    def move(self, point, linearised, values, share, reins):
        """The point with these unknowns; nodes follow by the linearisation."""
        _, slopes = self.coordinates.constants(point.values)
        step = slopes @ (values - point.values)
        nodes = tuple(
            shooting.move(own, parts, step, share, some)
            for shooting, own, parts, some in zip(
                self.shootings, point.nodes, linearised.condensed, self.split(reins), strict=True
            )
        )
        return self.upon(values, nodes)

    def split(self, blocks):
        """What there is of all blocks (or one number) as a list per group of chains."""
        ends = np.cumsum([shooting.n_blocks for shooting in self.shootings])
        return np.split(np.broadcast_to(blocks, ends[-1]), ends[:-1])

    def upon(self, values, nodes):
        """A point with its nodes put on the constraints of the law."""
        return self._put(values, nodes, Flow.held)

    def righted(self, point):
        """A point with its nodes in front of the walls of the law."""
        return self._put(point.values, point.nodes, Flow.righted)

    def _put(self, values, nodes, where):
        """A point with nodes as ``where(flow, nodes)`` gives them under these values."""
        constants, _ = self.coordinates.constants(values)
        out = []
        for shooting, own in zip(self.shootings, nodes, strict=True):
            shooting.flow.motion.set_constants(constants)
            out.append(where(shooting.flow, own))
        return TrackPoint(values, tuple(out))

    def settled(self, point, times=1, held=()):
        """The point after steps of the initial states alone, but of blocks that are held."""
        reins = np.where(held, 0.0, 1.0) if len(held) else 1.0
        for _ in range(times):
            linearised = self.linearise(point)
            if linearised is None or not linearised.is_finite:
                return point
            point = self.move(point, linearised, point.values, 1.0, reins)
        return point

    def is_as_fine_as(self, other):
        """Whether every interval has as many steps as in the same problem with other meshes."""
        return all(
            a.is_as_fine_as(b) for a, b in zip(self.meshes, other.meshes, strict=True)
        )

    def with_meshes(self, point, is_checked=False):
        """The same problem with steps chosen anew at a point; see `Flow.mesh` for the check."""
        constants, _ = self.coordinates.constants(point.values)
        meshes = []
        for shooting, nodes in zip(self.shootings, point.nodes, strict=True):
            shooting.flow.motion.set_constants(constants)
            flow = shooting.flow
            meshes.append(flow.mesh(nodes) if is_checked else flow.quick_mesh(nodes))
        return type(self)(self.shootings, meshes, self.coordinates, self.ridge)


class FlownProblem(TrackProblem):
    """Tracks of which every window is flown from its first state, for laws with walls.

    Where an instant of contact passes a row, the state there jumps, and no linearisation moves a
    node so: nodes are integrated anew behind every step, and their intervals join.
    """

    def linearise(self, point):
        """The same with steps that end at the contacts of this point."""
        return TrackProblem.linearise(self.with_meshes(point), point)

    def move(self, point, linearised, values, share, reins):
        """The point with these unknowns and first states, flown on from them."""
        return self.flown(super().move(point, linearised, values, share, reins))

    def flown(self, point):
        """A point with the nodes of every window as its first leads to; nan where that fails."""
        constants, _ = self.coordinates.constants(point.values)
        out = []
        for shooting, nodes in zip(self.shootings, point.nodes, strict=True):
            flow, windows, nodes = shooting.flow, shooting.windows, nodes.copy()
            flow.motion.set_constants(constants)
            times = flow.chains.times
            for step in range(1, int(windows.length.max(initial=0))):
                on = windows.length > step
                chain, row = windows.chain[on], windows.first[on] + step
                begin, end = times[row - 1, chain], times[row, chain]
                nodes[..., row, chain] = flow.advance(nodes[..., row - 1, chain], chain, begin, end)
            out.append(nodes)
        return TrackPoint(point.values, tuple(out))
