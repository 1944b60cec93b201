"""The smooth part of whitened residuals: few numbers per track that hold what a force can do.

Position noise makes second differences noisy at high frequencies; a force shows at low ones. Per
track and axis a basis of cubic B-splines in time (and of one step function for every stay in
contact or over a region) is whitened and made orthonormal. Residual, columns of constants and any
assumed force are projected on it, which leaves a small linear model with white noise of unit
variance, in which hundreds of forces are compared at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.loop.felt_noise import (
    linear_residual,
    slopes_of,
    whole_sizes,
    whole_times,
    with_felt_noise,
)
from bsp_gp.loop.leftover import Leftover
from bsp_gp.physics.geometry import DISC, WALL
from bsp_gp.search.columns import balanced

__all__ = ["SmoothView", "TrackGroup", "runs_of", "smooth_view", "spanned", "spline_basis"]

ROWS_PER_FUNCTION = 5
MIN_FUNCTIONS, MAX_FUNCTIONS = 5, 64
CHANNEL_PART = 0.6
"""Functions of a push in one direction, as a part of those of the basis."""
MAX_RUNS = 12
"""Stays in contact or over a region, per track, that get a step function of their own."""
MAX_TRACKS = 64
"""Tracks that are traced; of more, an even choice of scenes."""
MAX_NUMBERS = 6_000_000
"""Bound on the size of all projections, in floats."""
MIN_ROUGH = 10
"""Rows beyond the smooth ones that are needed to estimate the level of the noise."""
UNEVEN = 0.01
"""Relative change of the time step up to which steps count as even."""
_RANK = 1e-9
_SPAN = 1e-8


@dataclass(frozen=True, eq=False)
class TrackGroup:
    """Tracks of like-built scenes.

    Attributes
    ----------
    batch : RegressionBatch
    maps : ndarray, shape (S, R, d, K, n)
        Accelerations at the instants -> coordinates in the orthonormal basis of that track.
    splines : ndarray, shape (S, n, K_c)
        Smooth profiles in time for channels: fewer functions than the basis has.
    touching, inside : ndarray of bool, shape (n, S, R, N - 1)
        Where a receiver touches another entity, or is over it.
    bend : ndarray, shape (n, S, R)
        Weight of the second difference that makes of accelerations at instants what second
        differences of positions show, their mean over a time step on either side.
    times : ndarray, shape (n + 2, S)
        Of the rows of the scenes, those at the ends included.
    sizes : ndarray, shape (n + 2, S, R), or None
        Quoted errors of those rows as parts of the typical one; None where all are alike.
    mixing : ndarray, shape (S, R, d K, d K), or None
        What makes coordinates white where the noise of states is felt (`felt_noise`).
    slopes : ndarray, shape (2, n, S, R, d, d), or None
        Of the law's accelerations by place and velocity; None where all forces are counted.
    taken : ndarray, shape (S, R, d K, B), or None
        Orthonormal columns that are projected out of everything.
    """

    batch: object
    maps: np.ndarray
    splines: np.ndarray
    touching: np.ndarray
    inside: np.ndarray
    bend: np.ndarray | None = None
    times: np.ndarray | None = None
    sizes: np.ndarray | None = None
    mixing: np.ndarray | None = None
    slopes: np.ndarray | None = None
    taken: np.ndarray | None = None

    @property
    def shape(self):
        """Number of scenes, receivers, and coordinates of a track."""
        s, r, d, k, _ = self.maps.shape
        return s, r, d * k

    def project(self, vectors):
        """Coordinates of accelerations (n, S, R, C, d), shape (S, R, d K, C)."""
        s, r, size = self.shape
        vectors = self.averaged(np.nan_to_num(vectors, posinf=0.0, neginf=0.0))
        moved = np.ascontiguousarray(vectors.transpose(1, 2, 4, 0, 3))  # (S, R, d, n, C)
        raw = np.matmul(self.maps, moved).reshape(s, r, size, vectors.shape[3])
        return self.freed(raw if self.mixing is None else self.mixing @ raw)

    def averaged(self, vectors):
        """Accelerations (n, S, R, C, d) as second differences of positions show them."""
        if self.bend is None:
            return vectors
        out = vectors.copy()
        change = vectors[2:] - 2 * vectors[1:-1] + vectors[:-2]
        out[1:-1] += self.bend[1:-1, ..., None, None] * change
        return out

    def coordinates_of(self, vectors, s, r):
        """Coordinates of accelerations (n, C, d) of one track, shape (d K, C)."""
        raw = np.matmul(self.maps[s, r], vectors.transpose(2, 0, 1)).reshape(self.shape[2], -1)
        return raw if self.mixing is None else self.mixing[s, r] @ raw

    def freed(self, coordinates):
        """Coordinates (S, R, d K, C) without what is taken."""
        if self.taken is None:
            return coordinates
        inner = np.swapaxes(self.taken, -1, -2) @ coordinates
        return coordinates - self.taken @ inner


@dataclass(frozen=True, eq=False)
class SmoothView:
    """All tracks.

    Attributes
    ----------
    groups : tuple of TrackGroup
    target : list of ndarray, shape (S, R, D)
        The residual, constants of the law projected out, noise at unit variance.
    constants : ndarray, shape (sum of S R D, k)
        Orthonormal columns of the law's constants over all tracks.
    dimensions : list of ndarray, shape (S, R)
        Coordinates that carry anything, per track.
    level : float
        Variance of the whitened noise, from what is not smooth.
    sigma : ndarray, shape (d,)
        Of the regression.
    tracks : tuple of (scene, entity)
        In the order of the coordinates.
    notes : tuple of str
    memory : float
        Correlation time of the noise, s.
    """

    groups: tuple
    target: list
    constants: np.ndarray
    dimensions: list
    level: float
    sigma: np.ndarray
    tracks: tuple
    notes: tuple = ()
    memory: float = 0.0

    @property
    def size(self):
        """Dimensions less those that the law's constants take."""
        return int(sum(d.sum() for d in self.dimensions)) - self.constants.shape[1]

    def flat(self, parts):
        """Coordinates of all tracks in one vector (or in the rows of a matrix)."""
        return np.concatenate([p.reshape(-1, *p.shape[3:]) for p in parts])

    def beside(self, columns):
        """The view of what is left when pushes with a free amplitude each are taken out.

        Parameters
        ----------
        columns : list of ndarray, shape (S, R, D, C)
            Per group, as `TrackGroup.project` gives them.
        """
        groups, dimensions = [], []
        for group, block, n in zip(self.groups, columns, self.dimensions, strict=True):
            basis, rank = spanned(block)
            groups.append(replace(group, taken=basis))
            dimensions.append(n - rank)
        parts = [self.split(column) for column in self.constants.T]
        freed = [
            self.flat([g.freed(p[..., None])[..., 0] for g, p in zip(groups, part, strict=True)])
            for part in parts
        ]
        constants = np.stack(freed, axis=1) if freed else self.constants
        constants = _orthonormal(constants, 1e-6)
        target = self.flat(
            [g.freed(t[..., None])[..., 0] for g, t in zip(groups, self.target, strict=True)]
        )
        target = target - constants @ (constants.T @ target)
        return replace(
            self, groups=tuple(groups), constants=constants, dimensions=dimensions,
            target=self.split(target),
        )  # fmt: skip

    def mixed(self, mixings):
        """The view with the coordinates of every track multiplied by a matrix, (S, R, D, D)."""

        def moved(parts):
            pairs = zip(mixings, parts, strict=True)
            return self.flat([(m @ part[..., None])[..., 0] for m, part in pairs])

        groups = [
            replace(g, mixing=m if g.mixing is None else m @ g.mixing)
            for g, m in zip(self.groups, mixings, strict=True)
        ]
        columns = [moved(self.split(column)) for column in self.constants.T]
        constants = np.stack(columns, axis=1) if columns else self.constants
        constants = np.linalg.qr(constants)[0] if columns else constants
        target = moved(self.target)
        target = target - constants @ (constants.T @ target)
        return replace(self, groups=tuple(groups), constants=constants, target=self.split(target))

    def split(self, flat):
        """The reverse of `flat`."""
        out, start = [], 0
        for group in self.groups:
            s, r, size = group.shape
            out.append(flat[start : start + s * r * size].reshape(s, r, size))
            start += s * r * size
        return out


def smooth_view(observation, fit, along=None):
    """Project what a fitted law leaves on what is smooth, or bound to contacts and regions.

    Parameters
    ----------
    observation : Observation
    fit : Fit
    along : Fit, optional
        Of a law nearer to the truth, along whose tracks to look.

    Returns
    -------
    SmoothView
    """
    scenes, notes = _some(observation.train)
    if along is None:
        leftover = Leftover(observation, fit)
        regression = leftover.regression(scenes)
        residual, jacobian = leftover.residual(regression, fit.law)
    else:
        regression, residual, jacobian, slopes = linear_residual(observation, fit, along, scenes)
    columns = np.concatenate([residual[:, None], _live(jacobian)], axis=1)
    most = _functions_allowed(regression)
    pieces, tracks, start = [], [], 0
    for batch in regression.batches:
        part = columns[start : start + batch.target.size]
        start += batch.target.size
        pieces.append(_group(batch, part.reshape(*batch.target.shape, -1), most))
        for scene, receivers in zip(batch.scene_names, batch.bodies.receiver_names, strict=True):
            tracks += [(scene, receiver) for receiver in receivers]
    dimensions = [ranks for _, _, ranks in pieces]
    flat = np.concatenate([c.reshape(-1, c.shape[-1]) for _, c, _ in pieces])
    constants = flat[:, 1:] / np.maximum(np.linalg.norm(flat[:, 1:], axis=0), 1e-300)
    constants = _orthonormal(constants)
    n_rough = regression.n_rows - sum(int(d.sum()) for d in dimensions)
    rough = float(residual @ residual - flat[:, 0] @ flat[:, 0])
    level = rough / n_rough if n_rough >= MIN_ROUGH and rough > 0 else 1.0
    groups = tuple(replace(g, maps=g.maps / np.sqrt(level)) for g, _, _ in pieces)
    view = SmoothView(
        groups, [], constants, dimensions, level, regression.sigma, tuple(tracks), notes,
        observation.memory,
    )  # fmt: skip
    target = flat[:, 0] - constants @ (constants.T @ flat[:, 0])
    view.target.extend(view.split(target / np.sqrt(level)))
    if observation.method != "gls":
        return view
    groups = []
    if along is None:
        slopes = [
            slopes_of(group.batch, lambda batch: regression.predict(batch, fit.law))
            for group in view.groups
        ]
    for group, own in zip(view.groups, slopes, strict=True):
        group = replace(
            group, times=whole_times(group.batch, scenes),
            sizes=whole_sizes(group.batch, scenes, regression.sigma),
        )  # fmt: skip
        # Along a nearer law, what the finite step leaves is taken off already.
        extra = {"slopes": own, "bend": _bend(group.batch)} if along is None else {}
        groups.append(replace(group, **extra))
    return with_felt_noise(replace(view, groups=tuple(groups)), slopes, regression.sigma)


def _bend(batch):
    """Numerov's weight, 1/12 inside of even steps whose neighbours are seen, else 0."""
    seen = batch.valid.any(axis=-1)
    step = np.diff(batch.times, axis=0)
    with np.errstate(invalid="ignore"):
        even = np.abs(np.diff(step, axis=0)) < UNEVEN * step[1:]
    out = np.zeros(seen.shape)
    out[1:-1] = even[..., None] & seen[2:] & seen[:-2]
    return out / 12


def _some(scenes):
    """The scenes, or an even choice of them where there are very many tracks."""
    count = sum(len(scene.dynamic) for scene in scenes)
    if count <= MAX_TRACKS:
        return scenes, ()
    n = max(len(scenes) * MAX_TRACKS // count, 1)
    chosen = np.unique(np.linspace(0, len(scenes) - 1, n).round().astype(int))
    note = f"{len(chosen)} of {len(scenes)} training scenes were traced"
    return [scenes[k] for k in chosen], (note,)


def _functions_allowed(regression):
    size = sum(batch.target.size for batch in regression.batches)
    return int(np.clip(MAX_NUMBERS // max(size, 1), MIN_FUNCTIONS, MAX_FUNCTIONS))


def _group(batch, columns, most):
    """The group of a batch, coordinates of whitened columns (n, S, R, d, C), and ranks."""
    n, n_scenes, n_receivers, n_dims = batch.target.shape
    touching, inside = _contacts(batch)
    n_functions = min(int(np.clip(n // ROWS_PER_FUNCTION, MIN_FUNCTIONS, most)), n)
    pieces = {}
    for s in range(n_scenes):
        smooth = spline_basis(batch.times[:, s], n_functions)
        for r in range(n_receivers):
            steps = [_steps(mask[:, s, r]) for mask in (touching, inside)]
            basis = np.concatenate([smooth, *steps], axis=1)
            for axis in range(n_dims):
                pieces[s, r, axis] = _whitened(batch, s, r, axis, basis)
    widest = max(u.shape[1] for u, _ in pieces.values())
    maps = np.zeros((n_scenes, n_receivers, n_dims, widest, n))
    coordinates = np.zeros((n_scenes, n_receivers, n_dims, widest, columns.shape[-1]))
    ranks = np.zeros((n_scenes, n_receivers), dtype=int)
    for (s, r, axis), (u, image) in pieces.items():
        rank = u.shape[1]
        maps[s, r, axis, :rank] = image
        coordinates[s, r, axis, :rank] = u.T @ columns[:, s, r, axis]
        ranks[s, r] += rank
    coarse = max(round(CHANNEL_PART * n_functions), 2)
    splines = np.stack([spline_basis(t, coarse) for t in batch.times.T])
    group = TrackGroup(batch, maps, splines, touching, inside)
    return group, coordinates.reshape(*group.shape, -1), ranks


def _whitened(batch, s, r, axis, basis):
    """Orthonormal columns that span the whitened basis, (n, K), and the map to them, (K, n)."""
    valid, scale = batch.valid[:, s, r, axis], batch.scale[:, s, r, axis]
    if batch.whitener is None:
        whiten = np.diag(scale * valid)
    else:
        matrix = batch.whitener if batch.whitener.ndim == 2 else batch.whitener[s, r]
        whiten = scale[:, None] * matrix * valid
    columns = whiten @ basis
    sizes = np.linalg.norm(columns, axis=0)
    columns = columns[:, sizes > 0] / sizes[sizes > 0]
    u, singular, _ = np.linalg.svd(columns, full_matrices=False)
    u = u[:, singular > _RANK * np.max(singular, initial=0.0)]
    return u, u.T @ whiten


def spline_basis(times, n_functions, degree=3):
    """B-splines over a stretch of time, shape (n, n_functions); 0 where time is nan.

    Parameters
    ----------
    times : ndarray, shape (n,)
    n_functions : int
        At least 1; below four the degree falls.
    degree : int
    """
    from scipy.interpolate import BSpline

    degree = min(degree, n_functions - 1)
    seen = np.isfinite(times)
    out = np.zeros((len(times), n_functions))
    low, high = times[seen].min(), times[seen].max()
    if not high > low:
        out[seen, 0] = 1.0
        return out
    inner = np.linspace(0, 1, n_functions - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    x = np.clip((times[seen] - low) / (high - low), 0.0, 1.0)
    out[seen] = BSpline.design_matrix(x, knots, degree).toarray()
    return out


def _contacts(batch):
    """Where a receiver touches another entity, and where it is over one, (n, S, R, N - 1).

    A hit between two frames counts for the frames beside it: what moves by more than the gap in a
    time step may have touched.
    """
    bodies, p, v = batch.bodies, batch.positions, batch.velocities
    own = bodies.shapes[:, bodies.receivers][:, :, None]
    other = bodies.shapes[:, bodies.others]
    here, there = p[:, :, bodies.receivers, None], p[:, :, bodies.others]
    touching = own.collides(here, other, there) > 0
    inside = own.is_on(here, other, there) > 0
    can_touch = (own.code == DISC) & ((other.code == DISC) | (other.code == WALL))
    with np.errstate(invalid="ignore"):
        margin = own.contact_margin(here, other, there)
        speed = np.linalg.norm(v[:, :, bodies.receivers, None] - v[:, :, bodies.others], axis=-1)
        step = np.nanmedian(np.diff(batch.times, axis=0)) if len(batch.times) > 1 else 0.0
        touching |= can_touch & (margin < speed * step)
    return touching, inside


def runs_of(mask):
    """Indices (start, stop) of the stretches in which a mask of shape (n,) holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2], edges[1::2], strict=True))


def _steps(mask):
    """A step function for every stay, (n, m), of at most `MAX_RUNS` stays with any entity."""
    stays = [run for j in range(mask.shape[1]) for run in runs_of(mask[:, j])]
    out = np.zeros((len(mask), min(len(stays), MAX_RUNS)))
    for k, (start, stop) in enumerate(sorted(stays)[:MAX_RUNS]):
        out[start:stop, k] = 1.0
    return out


def _live(columns):
    return balanced(columns[:, np.any(columns, axis=0)])


def spanned(columns):
    """Orthonormal columns that span those of every track, and how many they are.

    Parameters
    ----------
    columns : ndarray, shape (S, R, D, C)

    Returns
    -------
    basis : ndarray, shape (S, R, D, min(D, C))
        Padded with zeros.
    rank : ndarray of int, shape (S, R)
    """
    if not columns.shape[3]:
        return columns, np.zeros(columns.shape[:2], dtype=int)
    sizes = np.linalg.norm(columns, axis=2, keepdims=True)
    u, singular, _ = np.linalg.svd(columns / np.where(sizes > 0, sizes, 1.0), full_matrices=False)
    keep = (singular > _SPAN * singular[..., :1]) & (singular > 0)
    return u * keep[..., None, :], keep.sum(axis=-1)


def _orthonormal(columns, least=_RANK):
    """Orthonormal basis of unit columns, shape (n, rank)."""
    u, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, sizes > least]
