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

import numpy as np

from bsp_gp.errors import DataError, SettingsError
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.differences import difference_weights, gls_whitener
from bsp_gp.physics.noise import relative_sizes
from bsp_gp.physics.regression import Regression, RegressionBatch
from bsp_gp.physics.weak import WeakForm
from bsp_gp.physics.weak_width import estimated_level

METHODS = (
    "one_step", "one_step_gls", "central", "gls", "derivative", "weak", "one_step_weak"
)  # fmt: skip
DERIVATIVE_POINTS = 11


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
    memory=0.0,
    may_be_empty=False,
    whitened=True,
):
    """Read accelerations off measured tracks.

    Parameters
    ----------
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
    memory : float
        Correlation time of the position noise, s, for ``gls`` and ``one_step_gls``; these also
        heed the errors that single points quote.
    may_be_empty : bool
        Whether tracks of which no instant is usable are no error.
    whitened : bool
        False where residuals are only asked for as they are: what makes them white is a square
        matrix of the rows of a track.

    Raises
    ------
    DataError
        If there is no scene, or no row is left and that is an error.
    SettingsError
        If the method is unknown, or takes no noise with a memory.
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
    if is_weak and memory:
        raise SettingsError(
            f"the weak form takes noise for white, and a memory of {memory:g} s was given; "
            "use gls"
        )
    measured = "measured" if method == "derivative" or (is_weak and velocity == "measured") else ""
    batches = stack(scenes, up, measured or "ignore")
    if is_weak:
        found, widths = _weak_batches(
            batches, method, sigma, level, sources, states or {}, unsure, bool(measured), width
        )
    else:
        found = [
            _regression_batch(batch, method, sigma, sources, states or {}, unsure, memory, whitened)
            for batch in batches
        ]
        widths = None
    regression = Regression(tuple(found), method, np.array(sigma), tuple(scenes), widths)
    if not (regression.n_rows or may_be_empty):
        raise DataError(
            "no instant is usable: a force needs a body in three successive frames"
            + (", with every other body seen as well" if sources else "")
        )
    return regression


def _regression_batch(batch, method, sigma, sources, given, unsure, memory, whitened):
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
    if whitened and method in ("gls", "one_step_gls"):
        sizes = relative_sizes(batch, sigma)
        sizes = None if sizes is None else sizes[:, :, bodies.receivers]
        whitener = gls_whitener(batch.times, valid, sizes, memory)
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


def _require_numbers(batch, accelerations):
    """Refuse positions and times of which no accelerations can be made."""
    p = batch.positions
    seen = np.isfinite(p[1:-1]) & np.isfinite(p[:-2]) & np.isfinite(p[2:])
    bad = np.argwhere(seen & ~np.isfinite(accelerations))
    if len(bad):
        row, s, entity, _ = bad[0]
        raise DataError(
            f"scene {batch.scenes[s].name!r}, t = {batch.times[row + 1, s]:g}: the acceleration of "
            f"{batch.bodies.names[s][entity]!r} is beyond all numbers",
            remedy="give times and positions in units of the order of what was recorded",
        )


def _from_positions(batch, method, sigma):
    p = batch.positions
    before, after = _steps(batch.times)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        step_back = (p[1:-1] - p[:-2]) / before
        step_on = (p[2:] - p[1:-1]) / after
        target = (step_on - step_back) / ((before + after) / 2)
    _require_numbers(batch, target)
    if method in ("one_step", "one_step_gls"):
        velocities = step_back
    else:
        velocities = (before * step_on + after * step_back) / (before + after)
    # Back to an error of position; the exact covariance does that by itself.
    correlated = method in ("gls", "one_step_gls")
    scale = np.ones_like(after) if correlated else after * (before + after) / 2
    velocities = np.where(batch.is_still[:, None] & np.isfinite(velocities), 0.0, velocities)
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
