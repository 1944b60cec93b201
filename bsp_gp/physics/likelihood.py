"""What a law must explain: accelerations at instants, with the covariance of their errors.

Several ways to read them off a track, one interface (`Regression`):

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
``weak``
    The equation of motion integrated against compact test functions (`bsp_gp.physics.weak`):
    both time derivatives fall upon the test function, whose width is chosen from the data.
    Bridges short gaps, weighs every row by its quoted error, and takes measured velocities. For
    motion in continuous time.
``one_step_weak``
    The same for data made by steps: forces act at rows, with backward velocities.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import DataError, EvaluationError, SettingsError
from bsp_gp.language.formula import evaluate
from bsp_gp.physics.bodies import law_inputs, stack
from bsp_gp.physics.differences import difference_weights, gls_whitener
from bsp_gp.physics.force import settle, term_gradient
from bsp_gp.physics.weak import WeakForm, estimated_level

__all__ = [
    "METHODS",
    "Regression",
    "RegressionBatch",
    "build_regression",
    "difference_weights",
    "stack_draws",
]

METHODS = (
    "one_step", "one_step_gls", "central", "gls", "derivative", "weak", "one_step_weak"
)  # fmt: skip
DERIVATIVE_POINTS = 11


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
        Applied along time before `scale`; None = identity. ``(k, n)`` shared, ``(S, R, k, n)`` or
        ``(S, R, d, k, n)``; where k < n, the last n - k whitened rows are 0.
    observed : ndarray, shape (n, S, R, d), or None
        What the whitened law is to explain, before `scale`; None: the whitened `target`.
    kept : ndarray of bool, shape (n, S, R, d)
        Whitened rows that count; by default the valid ones. In the weak form these are test
        functions, and no instants.
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
    observed: np.ndarray | None = None
    kept: np.ndarray | None = None

    def __post_init__(self):
        if self.kept is None:
            object.__setattr__(self, "kept", self.valid)

    def whiten(self, values):
        """Whiten accelerations, shape (n, S, R, ..., d); rows that are not kept become 0."""
        extra = values.ndim - 4
        index = (slice(None),) * 3 + (None,) * extra
        values = np.where(self.valid[index], values, 0.0)
        if self.whitener is not None:
            values = _along_time(self.whitener, values)
        return values * self.scale[index]

    def whitened_target(self):
        """What the whitened law is to explain, shape (n, S, R, d)."""
        return self.whiten(self.target) if self.observed is None else self.observed * self.scale

    def whitened_residual(self, predicted):
        """Whitened observed minus predicted accelerations, shape (n, S, R, d)."""
        if self.observed is None:
            return self.whiten(self.target - predicted)
        return self.observed * self.scale - self.whiten(predicted)


def _along_time(whitener, values):
    """Apply a whitener to the first axis of values (n, S, R, ..., d); 0 beyond its rows."""
    if whitener.ndim == 2:
        out = np.tensordot(whitener, values, axes=(1, 0))
    elif whitener.ndim == 4:
        out = np.einsum("srtu,usr...->tsr...", whitener, values, optimize=True)
    else:
        out = np.einsum("srdtu,usr...d->tsr...d", whitener, values, optimize=True)
    if len(out) == len(values):
        return out
    return np.concatenate([out, np.zeros((len(values) - len(out), *out.shape[1:]))])


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
    widths : Widths or None
        Of the test functions (``weak``).
    n_rows : int
        Rows that count: instants and axes, or independent test functions.
    """

    batches: tuple[RegressionBatch, ...]
    method: str
    sigma: np.ndarray
    scenes: tuple
    widths: object = None
    n_rows: int = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "n_rows", int(sum(batch.kept.sum() for batch in self.batches)))

    def target(self):
        """Whitened observed accelerations, one vector."""
        return self._flat(batch.whitened_target() for batch in self.batches)

    def residual(self, law):
        """Whitened observed minus predicted accelerations, one vector.

        Raises
        ------
        EvaluationError
            If the law has no finite value at a valid instant.
        """
        return self._flat(
            batch.whitened_residual(checked(self.predict(batch, law), batch))
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
            value = settle(
                evaluate(term.acceleration_formula, lookup, cache=known),
                term,
                batch.bodies,
                batch.target.shape,
                per_entity,
            )
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
    return Regression(batches, first.method, first.sigma, first.scenes, first.widths)


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
    width=None,
):
    """Read accelerations off measured tracks.

    Parameters
    ----------
    scenes : sequence of Scene
    method : str
        One of `METHODS`.
    sigma : array-like, shape (d,) or float, optional
        Standard deviation of positions (``derivative``: of accelerations; ``weak`` with measured
        velocities: of these); 1 if None. A nan axis (without variation) is left out. ``weak`` uses
        it where the scene quotes none.
    up : str, optional
        Declared vertical axis.
    velocity : str
        "measured" to use the velocity columns: ``weak`` then integrates by parts once;
        ``derivative`` always uses them, other methods never.
    sources : bool
        Whether laws may name other bodies: then rows where any of them is lost are left out.
    states : mapping of str to (ndarray, ndarray), optional
        Scene name -> positions and velocities (T, R, d) of the receivers at which laws are
        evaluated in the place of the measured ones (``gls``); the accelerations to be explained
        stay those of the measured positions.
    unsure : float, optional
        Rows whose contact or region condition would flip if a body moved by less than this,
        metres, are left out: with position noise they are as likely wrong as right.
    width : float, optional
        Reach of the test functions of ``weak``, s; by default chosen from the data.

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
    level = sigma
    sigma = np.broadcast_to(np.asarray(1.0 if sigma is None else sigma, dtype=float), (n_dims,))
    is_weak = method in ("weak", "one_step_weak")
    measured = "measured" if method == "derivative" or (is_weak and velocity == "measured") else ""
    batches = stack(scenes, up, measured or "ignore")
    if is_weak:
        found, widths = _weak_batches(
            batches, method, sigma, level, sources, states or {}, unsure, bool(measured), width
        )
    else:
        found = [_regression_batch(b, method, sigma, sources, states or {}, unsure) for b in batches]
        widths = None
    regression = Regression(tuple(found), method, np.array(sigma), tuple(scenes), widths)
    if not regression.n_rows:
        raise DataError(
            "no instant is usable: a force needs a body in three successive frames"
            + (", with every other body seen as well" if sources else "")
        )
    return regression


def _regression_batch(batch, method, sigma, sources, given, unsure):
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
        whitener = gls_whitener(batch.times, valid)
    names = tuple(scene.name for scene in batch.scenes)
    return RegressionBatch(
        bodies, times, positions, velocities, target, valid, scale, names, whitener
    )


def _weak_batches(batches, method, sigma, level, sources, given, unsure, is_measured, width):
    """Batches of the weak form, and the widths of their test functions."""
    if level is None:
        level = estimated_level(batches, is_measured)
    form = WeakForm(
        batches,
        sigma,
        level=np.broadcast_to(np.asarray(level, dtype=float), sigma.shape),
        width=width,
        sources=sources,
        is_stepped=method == "one_step_weak",
        is_measured=is_measured,
        is_unsure=(lambda bodies, p: _is_unsure(bodies, p, unsure)) if unsure else None,
    )
    out = []
    for batch, part in zip(batches, form.parts, strict=True):
        state = (batch.times[part.rows], part.positions, part.velocities)
        times, positions, velocities = state if is_measured else _replaced(state, batch, given)
        names = tuple(scene.name for scene in batch.scenes)
        out.append(
            RegressionBatch(
                batch.bodies,
                times,
                positions,
                velocities,
                part.target,
                part.valid,
                part.kept.astype(float),
                names,
                part.whitener,
                part.observed,
                part.kept,
            )
        )
    return out, form.widths


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
