"""What a law must explain: accelerations at instants, with the covariance of their errors.

Three ways to read them off a track, one interface (`Regression`):

``one_step``
    The paper's vectorised likelihood (section 3.3.1): velocity by backward difference, one
    symplectic Euler step, independent Gaussian errors of position.
``one_step_gls``
    The same accelerations and velocities with the exact covariance that white position noise
    gives to second differences (sigma^2 times 6, -4, 1): generalised least squares. For noisy
    data made by steps, as the paper's are.
``central``
    One step with the velocity by central difference, an order better for smooth motion.
``gls``
    Generalised least squares with velocities by central difference, for motion in continuous
    time: equivalent to fitting positions with free initial states.
``derivative``
    For data with *measured* velocities: their derivative by a central difference of high order.

A weak form against compact test functions has its place beside these.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import DataError, EvaluationError, SettingsError
from bsp_gp.language.formula import evaluate
from bsp_gp.physics.bodies import law_inputs, stack
from bsp_gp.physics.evaluation import Settling
from bsp_gp.physics.force import term_gradient
from bsp_gp.physics.noise import relative_sizes

__all__ = [
    "METHODS",
    "Regression",
    "RegressionBatch",
    "build_regression",
    "difference_weights",
    "stack_draws",
]

METHODS = ("one_step", "one_step_gls", "central", "gls", "derivative")
DERIVATIVE_POINTS = 11
DENSE_LIMIT = 1500
"""Longest track (rows) whose whitening matrix is kept dense."""


@dataclass(frozen=True, eq=False)
class RegressionBatch:
    """Instants of like-built scenes.

    Attributes
    ----------
    bodies : Bodies
    times : ndarray, shape (n, S), s
    positions, velocities : ndarray, shape (n, S, N, d)
        The state at which a law is evaluated.
    target : ndarray, shape (n, S, R, d), m/s^2
        Observed accelerations; 0 where not valid.
    valid : ndarray of bool, shape (n, S, R, d)
    scale : ndarray, shape (n, S, R, d)
        1 / standard deviation of independent errors; 0 where not valid.
    scene_names : tuple of str, length S
    whitener : ndarray or None
        ``(n, n)`` shared or ``(S, R, n, n)``: applied along time before `scale`; None = identity.
    """

    bodies: object
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    target: np.ndarray
    valid: np.ndarray
    scale: np.ndarray
    scene_names: tuple[str, ...] = ()
    whitener: np.ndarray | None = None

    def whiten(self, values):
        """Whiten accelerations, shape (n, S, R, ..., d); invalid rows become 0."""
        extra = values.ndim - 4
        index = (slice(None),) * 3 + (None,) * extra
        values = np.where(self.valid[index], values, 0.0)
        if self.whitener is not None:
            if self.whitener.ndim == 2:
                values = np.tensordot(self.whitener, values, axes=(1, 0))
            else:
                values = np.einsum("srtu,usr...->tsr...", self.whitener, values, optimize=True)
        return values * self.scale[index]


@dataclass(frozen=True, eq=False)
class Regression:
    """All instants of some scenes, ready for laws.

    Attributes
    ----------
    batches : tuple of RegressionBatch
    method : str
    sigma : ndarray, shape (d,)
        Standard deviation used: of positions, metres, or of accelerations (``derivative``).
    scenes : tuple of Scene
    """

    batches: tuple[RegressionBatch, ...]
    method: str
    sigma: np.ndarray
    scenes: tuple
    n_rows: int = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "n_rows", int(sum(batch.valid.sum() for batch in self.batches)))

    def target(self):
        """Whitened observed accelerations, one vector."""
        return self._flat(batch.whiten(batch.target) for batch in self.batches)

    def residual(self, law):
        """Whitened observed minus predicted accelerations, one vector.

        Raises
        ------
        EvaluationError
            If the law has no finite value at a valid instant.
        """
        return self._flat(
            batch.whiten(batch.target - checked(self.predict(batch, law), batch))
            for batch in self.batches
        )

    def predict(self, batch, law):
        """Accelerations of a law at the instants of a batch, shape (n, S, R, d)."""
        return law.acceleration(batch.bodies, batch.positions, batch.velocities, batch.times)

    def column(self, term, per_entity=False, cache=None):
        """Whitened acceleration of a constant-free term: one vector, or a column per receiver.

        Parameters
        ----------
        term : Term
        per_entity : bool
        cache : list of dict, one per batch, optional
            Values of sub-formulas, kept between calls for terms of one kind.

        Returns
        -------
        columns : ndarray, shape (n_flat, k)
        names : tuple of str
            Receiver names for ``per_entity``, else ``("",)``.
        """
        parts = []
        for index, batch in enumerate(self.batches):
            lookup = law_inputs(
                term.kind, batch.bodies, batch.positions, batch.velocities, batch.times
            )
            known = None if cache is None else cache[index]
            force = evaluate(term.acceleration_formula, lookup, cache=known)
            value = Settling(term, batch.bodies, per_entity)(force, batch.target.shape)
            parts.append(batch.whiten(checked(value, batch)))
        if not per_entity:
            return self._flat(parts)[:, None], ("",)
        names = self.receiver_names()
        columns = []
        for name in names:
            pieces = []
            for batch, part in zip(self.batches, parts, strict=True):
                mine = np.array([[n == name for n in row] for row in batch.bodies.receiver_names])
                pieces.append(part * mine[..., None])
            columns.append(self._flat(pieces))
        return np.stack(columns, axis=1), names

    def gradient(self, law, term):
        """Whitened derivatives of one term by its constants, dict of vectors."""
        out = {}
        for batch in self.batches:
            _, slopes = term_gradient(
                law, term, batch.bodies, batch.positions, batch.velocities, batch.times
            )
            for name, slope in slopes.items():
                out.setdefault(name, []).append(batch.whiten(checked(slope, batch)))
        return {name: self._flat(parts) for name, parts in out.items()}

    def receiver_names(self):
        """Names of all receivers, in order of first appearance."""
        return tuple(
            dict.fromkeys(
                name
                for batch in self.batches
                for row in batch.bodies.receiver_names
                for name in row
            )
        )

    def log_scale(self):
        """Logarithm of the determinant of the whitening, for likelihoods of the noise itself."""
        total = 0.0
        for batch in self.batches:
            total += float(np.log(batch.scale[batch.valid]).sum())
            if batch.whitener is not None:
                diagonal = np.einsum("...tt->...t", batch.whitener)
                if diagonal.ndim == 3:
                    diagonal = np.moveaxis(diagonal, -1, 0)
                else:
                    diagonal = diagonal[:, None, None]
                used = np.broadcast_to(diagonal[..., None], batch.valid.shape)[batch.valid]
                total += float(np.log(used).sum())
        return total

    def raw_residuals(self, law):
        """Observed minus predicted accelerations, m/s^2, one list entry per batch; nan = no row."""
        return [
            np.where(batch.valid, batch.target - self.predict(batch, law), np.nan)
            for batch in self.batches
        ]

    def _flat(self, parts):
        return np.concatenate([np.ravel(part) for part in parts]) if self.batches else np.zeros(0)


def stack_draws(regressions, weights):
    """One regression for an expectation over draws of latent properties.

    Least squares on it minimises the weighted mean of the draws' losses, constants shared.

    Parameters
    ----------
    regressions : sequence of Regression
        The same scenes, each with the properties of one draw.
    weights : sequence of float
        Not negative; normalised to sum to one.

    Raises
    ------
    SettingsError
        If weights and draws do not match.
    """
    weights = np.asarray(weights, dtype=float)
    if weights.shape != (len(regressions),) or not weights.sum() > 0 or np.any(weights < 0):
        raise SettingsError(
            f"weights must be {len(regressions)} numbers that are not negative and not all 0, "
            f"got {weights!r:.80}"
        )
    batches = tuple(
        replace(batch, scale=batch.scale * np.sqrt(weight))
        for regression, weight in zip(regressions, weights / weights.sum(), strict=True)
        for batch in regression.batches
    )
    first = regressions[0]
    return Regression(batches, first.method, first.sigma, first.scenes)


def checked(values, batch):
    """Return values (n, S, R, d), or raise EvaluationError where a valid row is not finite."""
    bad = ~np.isfinite(values) & batch.valid
    if bad.any():
        raise EvaluationError(f"the law has no finite value at {int(bad.sum())} instants")
    return np.where(batch.valid, values, 0.0)


def build_regression(
    scenes,
    *,
    method="one_step",
    sigma=None,
    up=None,
    velocity="ignore",
    sources=True,
    states=None,
    unsure=None,
    memory=0.0,
):
    """Read accelerations off measured tracks.

    Parameters
    ----------
    scenes : sequence of Scene
    method : str
        One of `METHODS`.
    sigma : array-like, shape (d,) or float, optional
        Standard deviation of positions (``derivative``: of accelerations); 1 if None. A nan axis
        (without variation) is left out.
    up : str, optional
        Declared vertical axis.
    velocity : str
        "measured" to use the velocity columns; needed by ``derivative``.
    sources : bool
        Whether laws may name other bodies: then rows where any of them is lost are left out.
    states : mapping of str to (ndarray, ndarray), optional
        Scene name -> positions and velocities (T, R, d) of the receivers at which laws are
        evaluated in the place of the measured ones (``gls``); the accelerations to be explained
        stay those of the measured positions.
    unsure : float, optional
        Rows whose contact or region condition would flip if a body moved by less than this,
        metres, are left out: with position noise they are as likely wrong as right.
    memory : float
        Correlation time of the position noise, s, for the methods with an exact covariance;
        these also heed the errors that single points quote.

    Raises
    ------
    DataError
        If there is no scene, or no row is left.
    """
    if method not in METHODS:
        raise SettingsError(f"likelihood must be one of {', '.join(METHODS)}, got {method!r}")
    if not scenes:
        raise DataError(
            "no scene is left to score a law on: the tracks are too short to hold a part out",
            remedy="record longer tracks or more scenes, or declare which are train and test",
        )
    n_dims = scenes[0].n_dims
    sigma = np.broadcast_to(np.asarray(1.0 if sigma is None else sigma, dtype=float), (n_dims,))
    measured = "measured" if method == "derivative" else "ignore"
    batches = [
        _regression_batch(batch, method, sigma, sources, states or {}, unsure, memory)
        for batch in stack(scenes, up, measured)
    ]
    regression = Regression(tuple(batches), method, np.array(sigma), tuple(scenes))
    if not regression.n_rows:
        raise DataError(
            "no instant is usable: a force needs a body in three successive frames"
            + (", with every other body seen as well" if sources else "")
        )
    return regression


def _regression_batch(batch, method, sigma, sources, given, unsure, memory):
    bodies = batch.bodies
    if method == "derivative":
        state, target, whitener, scale = _from_velocities(batch)
    else:
        state, target, whitener, scale = _from_positions(batch, method, sigma)
    times, positions, velocities = _replaced(state, batch, given)
    target = target[:, :, bodies.receivers]
    valid = np.isfinite(target) & np.isfinite(sigma)
    own = np.isfinite(velocities[:, :, bodies.receivers]).all(axis=-1)
    if sources:
        own &= (np.isfinite(positions) & np.isfinite(velocities)).all(axis=(-1, -2))[..., None]
    valid &= own[..., None]
    if unsure:
        valid &= ~_is_unsure(bodies, positions, unsure)[..., None]
    target = np.where(valid, target, 0.0)
    safe = np.where(np.isfinite(sigma), sigma, 1.0)
    scale = np.where(valid, np.broadcast_to(scale / safe, target.shape), 0.0)
    if method in ("gls", "one_step_gls"):
        sizes = relative_sizes(batch, sigma)
        sizes = None if sizes is None else sizes[:, :, bodies.receivers]
        whitener = _gls_whitener(batch.times, valid, sizes, memory)
    names = tuple(scene.name for scene in batch.scenes)
    return RegressionBatch(
        bodies, times, positions, velocities, target, valid, scale, names, whitener
    )


def _is_unsure(bodies, positions, distance):
    """Whether a condition of a receiver and any source is about to flip, (n, S, R)."""
    here, there = bodies.receivers, bodies.others
    margin = bodies.shapes[:, here, None].contact_margin(
        positions[:, :, here, None], bodies.shapes[:, there], positions[:, :, there]
    )
    return (margin < distance).any(axis=-1)


def _replaced(state, batch, given):
    """States with those of the receivers replaced where others are given."""
    times, positions, velocities = state
    if not any(scene.name in given for scene in batch.scenes):
        return state
    positions, velocities = positions.copy(), velocities.copy()
    for s, scene in enumerate(batch.scenes):
        if scene.name in given:
            p, v = given[scene.name]
            rows = slice(0, len(p) - 2)
            for r, index in enumerate(batch.bodies.receivers):
                seen = np.isfinite(positions[rows, s, index])
                positions[rows, s, index] = np.where(seen, p[1:-1, r], np.nan)
                velocities[rows, s, index] = np.where(seen, v[1:-1, r], np.nan)
    return times, positions, velocities


def _steps(times):
    h = np.diff(times, axis=0)[..., None, None]
    return h[:-1], h[1:]


def _from_positions(batch, method, sigma):
    p = batch.positions
    before, after = _steps(batch.times)
    step_back = (p[1:-1] - p[:-2]) / before
    step_on = (p[2:] - p[1:-1]) / after
    target = (step_on - step_back) / ((before + after) / 2)
    if method in ("one_step", "one_step_gls"):
        velocities = step_back
    else:
        velocities = (before * step_on + after * step_back) / (before + after)
    # Back to an error of position; the exact covariance does that by itself.
    correlated = method in ("gls", "one_step_gls")
    scale = np.ones_like(after) if correlated else after * (before + after) / 2
    static = np.array([i not in set(batch.bodies.receivers) for i in range(p.shape[2])])
    still = static & np.all((p == p[:1]) | np.isnan(p), axis=(0, 1, 3))
    velocities = np.where(still[:, None] & np.isfinite(velocities), 0.0, velocities)
    return (batch.times[1:-1], p[1:-1], velocities), target, None, np.nan_to_num(scale)


def _from_velocities(batch):
    if batch.velocities is None:
        raise DataError(
            "the likelihood 'derivative' needs measured velocities (columns vx, vy and "
            '[columns] velocity = "measured")'
        )
    half = DERIVATIVE_POINTS // 2
    n = batch.times.shape[0]
    if n <= 2 * half:
        raise DataError(f"the likelihood 'derivative' needs more than {2 * half} rows, got {n}")
    target = np.full_like(batch.velocities[half:-half], np.nan)
    for s in range(batch.times.shape[1]):
        times = batch.times[:, s]
        for k in range(half, n - half):
            if np.isfinite(times[k + half]):
                window = slice(k - half, k + half + 1)
                weights = difference_weights(times[window] - times[k], 1)
                target[k - half, s] = np.tensordot(weights, batch.velocities[window, s], axes=1)
    inner = slice(half, n - half)
    state = (batch.times[inner], batch.positions[inner], batch.velocities[inner])
    return state, target, None, 1.0


def difference_weights(offsets, order):
    """Weights of a finite difference at 0 on any grid (Fornberg 1988, Math. Comp. 51, 699).

    Parameters
    ----------
    offsets : ndarray, shape (k,)
        Places of the samples relative to where the derivative is wanted.
    order : int
        Order of the derivative.

    Returns
    -------
    ndarray, shape (k,)
    """
    # Scaled to unit spacing, so that the powers stay near one.
    width = np.max(np.abs(offsets))
    x = np.asarray(offsets, dtype=float) / width
    n = len(x)
    weights = np.zeros((n, order + 1))
    weights[0, 0] = 1.0
    c1, c4 = 1.0, x[0]
    for i in range(1, n):
        top = min(i, order)
        c2, c5, c4 = 1.0, c4, x[i]
        for j in range(i):
            c3 = x[i] - x[j]
            c2 *= c3
            if j == i - 1:
                for k in range(top, 0, -1):
                    weights[i, k] = c1 * (k * weights[i - 1, k - 1] - c5 * weights[i - 1, k]) / c2
                weights[i, 0] = -c1 * c5 * weights[i - 1, 0] / c2
            for k in range(top, 0, -1):
                weights[j, k] = (c4 * weights[j, k] - k * weights[j, k - 1]) / c3
            weights[j, 0] = c4 * weights[j, 0] / c3
        c1 = c2
    return weights[:, order] / width**order


def _difference_matrix(times):
    """Rows of the second difference of positions, shape (T - 2, T), for one grid of times."""
    before, after = np.diff(times)[:-1], np.diff(times)[1:]
    n = len(times) - 2
    matrix = np.zeros((n, n + 2))
    rows = np.arange(n)
    matrix[rows, rows] = 2 / (before * (before + after))
    matrix[rows, rows + 2] = 2 / (after * (before + after))
    matrix[rows, rows + 1] = -matrix[rows, rows] - matrix[rows, rows + 2]
    return matrix


def _gls_whitener(times, valid, sizes=None, memory=0.0):
    """Inverse Cholesky factors of the covariance of second differences, per unit sigma.

    `sizes` (T, S, R) are the errors of the points as parts of sigma.
    """
    n_times, n_scenes = times.shape
    rows_valid = valid.any(axis=-1)  # (n, S, R)
    same_grid = np.all(times == times[:, :1])
    if same_grid and sizes is None and rows_valid.all():
        return _whitening_block(times[:, 0], rows_valid[:, 0, 0], None, memory)
    if n_times > DENSE_LIMIT:
        raise DataError(
            f"tracks of {n_times} rows with gaps, differing times or errors of single points are "
            "too long for the exact covariance; split them into scenes of at most 1500 rows"
        )
    blocks = np.zeros((n_scenes, valid.shape[2], n_times - 2, n_times - 2))
    for s in range(n_scenes):
        for r in range(valid.shape[2]):
            size = None if sizes is None else sizes[:, s, r]
            blocks[s, r] = _whitening_block(times[:, s], rows_valid[:, s, r], size, memory)
    return blocks


def _whitening_block(times, rows, size, memory):
    from scipy.linalg import solve_triangular

    n = len(times) - 2
    block = np.zeros((n, n))
    if not rows.any():
        return block
    matrix = np.nan_to_num(_difference_matrix(times))[rows]
    if size is not None:
        matrix = matrix * size
    covariance = matrix @ matrix.T
    if memory > 0:
        gaps = np.nan_to_num(np.abs(times[:, None] - times))
        covariance = matrix @ np.exp(-gaps / memory) @ matrix.T
    factor = np.linalg.cholesky(covariance)
    inverse = solve_triangular(factor, np.eye(len(factor)), lower=True)
    block[np.ix_(rows, rows)] = inverse
    return block
