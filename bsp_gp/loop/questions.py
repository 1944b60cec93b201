"""What is asked of every fit beside causes: is its noise as assumed, and how much may be hidden.

The noise is asked on the pure error: the residual beside initial states and smooth functions of
time, so that what a law lacks is not taken for noise. How a projection changes statistics is read
off noise that was simulated and projected in the same way.
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from bsp_gp.fitting.tangent import p_of_gain
from bsp_gp.loop.trace import moments_of
from bsp_gp.physics.force import ForceLaw

MOST_FUNCTIONS, MOST_QUICK = 8, 64
ROWS_EACH = 4
"""Rows for each of the smooth functions, at the least."""
LEAST_LEFT = 0.05
"""Part of its variance that a row must have left to be looked at."""
LEAST_TAIL = -700.0
"""Log chance of a row beyond which it is as far off as numbers tell."""
LEVEL = 0.95
Z = float(stats.norm.ppf(LEVEL))
PARTS = {
    "correlation": "autocorrelation", "scenes": "level_of_scene", "bodies": "level_of_body",
    "speed": "level_with_speed", "tails": "tails",
}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One way in which the noise may differ from what was assumed.

    Attributes
    ----------
    code : str
        One of `NOISE_FINDINGS`.
    p_value : float
        Choices among scenes, bodies and rows counted.
    scene, entity : str
        Where it shows most; "" = everywhere.
    row : int
        -1 = all.
    """

    code: str
    p_value: float
    scene: str = ""
    entity: str = ""
    row: int = -1


def noise_findings(view, most=MOST_FUNCTIONS):
    """Answers to all questions about the noise, the most striking first.

    Parts that the fit adopted (`NoiseModel.findings`) are findings, and whitened away for the rest.

    Parameters
    ----------
    most : int
        Functions of time for each channel. What forces do quickly is taken for noise beside few,
        and memories that are long for forces beside many.
    """
    noise = view.fit.noise
    found = [
        Finding(PARTS[f.part], float(stats.chi2.sf(2 * f.gain, 1)), *_where(view.fit, f.part))
        for f in noise.findings if f.is_adopted
    ]  # fmt: skip
    steps, levels = np.array(noise.steps), np.array(noise.levels)
    if np.any((steps > 0) & (steps >= levels)):
        found.append(Finding("grid", 0.0))
    error = _PureError(view, most)
    if error.z[0].any():
        found += error.findings()
    return tuple(sorted(found, key=lambda f: f.p_value))


def least_chance(findings):
    """Chance of the most striking of some findings, their number counted."""
    chances = [f.p_value for f in findings]
    return min(min(chances) * len(chances), 1.0) if chances else 1.0


def _where(fit, part):
    """The scene and body whose factor is furthest from one; of tails, the row furthest off."""
    noise, channels = fit.noise, fit.channels
    if part == "tails":
        off = np.abs(fit.whitened if noise.adding else fit.residual / noise.sizes(channels))
        row, k = np.unravel_index(int(np.nan_to_num(off).argmax()), off.shape)
        return _place(channels, row, k)
    scenes = noise.scenes if part == "scenes" else ()
    bodies = noise.bodies if part == "bodies" else ()
    return tuple(
        max(factors, key=lambda pair: abs(np.log(pair[1])), default=("", 1.0))[0]
        for factors in (scenes, bodies)
    )


def _place(channels, row, k):
    """Scene, body and row of a channel's entry."""
    scene = channels.scene_names[channels.scene[k]]
    return scene, channels.body_names[channels.body[k]], int(row)


class _PureError:
    """The whitened residual, (1 + B, T, C) with draws of noise, beside states and smooth functions.

    `left` is the part of the variance that each row has left; `z` is 0 where nothing can be said.
    """

    def __init__(self, view, most):
        fit, tangent = view.fit, view.tangent
        self.view, self.channels = view, fit.channels
        seen = tangent.whitener.seen
        smooth = _smooth(tangent.whitener, fit.channels, seen, most)  # (K, T, C)
        flat = np.concatenate([tangent.residual[None], view.row_draws])
        self.rows = np.zeros((len(flat), *seen.shape))
        self.left = seen - np.square(smooth).sum(axis=0)
        self.rank, first = len(fit.values) + smooth.shape[0] * int(seen.any(axis=0).sum()), 0
        for index, own in zip(tangent.chains, tangent.own, strict=True):
            count, stop = len(own), first + len(seen) * len(index)  # none where states are known
            shape, waves = (-1, len(seen), len(index)), smooth[:, :, index]
            own = _beside(own.reshape(count, *shape[1:]), waves).reshape(count, stop - first)
            _, sizes, basis = np.linalg.svd(own, full_matrices=False)
            basis = basis[sizes > 1e-6]
            rows = _beside(flat[:, first:stop].reshape(shape), waves).reshape(len(flat), -1)
            rows = rows - (rows @ basis.T) @ basis
            self.rows[:, :, index] = rows.reshape(shape)
            self.left[:, index] -= np.square(basis).sum(axis=0).reshape(shape)[0]
            self.rank += len(basis)
            first = stop
        self.used = seen & (self.left > LEAST_LEFT)
        self.z = np.where(self.used, self.rows, 0.0) / np.sqrt(np.where(self.used, self.left, 1.0))
        if np.isfinite(tangent.fit.noise.degrees):  # as if normal
            tail = stats.t.logsf(np.abs(self.z[0]), fit.noise.degrees)
            self.z[0] = np.sign(self.z[0]) * stats.norm.isf(np.exp(np.maximum(tail, LEAST_TAIL)))

    def findings(self):
        """One Finding for each question that can be asked."""
        channels, square = self.channels, np.square(self.z)
        both = self.used[1:] & self.used[:-1]
        mean = square.sum(axis=(1, 2)) / self.used.sum()
        lagged = (self.z[:, 1:] * self.z[:, :-1] * both).sum(axis=(1, 2)) / mean
        # Without the greatest of each: one row is a finding of its own. Upturned: nearly normal.
        rest = np.where(square < square.max(axis=(1, 2), keepdims=True), square, 0.0)
        heavy = -np.square(rest.sum(axis=(1, 2))) / np.square(rest).sum(axis=(1, 2))
        yield Finding("autocorrelation", _p_beside(lagged))
        yield Finding("tails", _p_beside(heavy, is_upper=True))
        yield from self._common(mean)
        speed = channels.speed
        if speed is not None:
            fast = np.where(self.used, np.square(np.nan_to_num(speed)), 0.0)
            fast = np.where(self.used, fast - fast.sum() / self.used.sum(), 0.0)
            if fast.any():
                yield Finding("level_with_speed", _p_beside((square * fast).sum((1, 2)) / mean))
        yield from self._levels("level_of_scene", channels.scene, channels.scene_names, "scene")
        yield from self._levels("level_of_body", channels.body, channels.body_names, "entity")
        row, k = np.unravel_index(int(square[0].argmax()), square[0].shape)
        chance = float(p_of_gain(square[0, row, k], 1, self.view.noise_dof)) * int(self.used.sum())
        yield Finding("row", min(chance, 1.0), *_place(channels, row, k))
        if not self.view.fit.noise.is_free.any():
            dof = max(int(self.view.tangent.whitener.seen.sum()) - self.rank, 1)
            total = float(np.square(self.rows[0]).sum())
            chance = 2 * min(stats.chi2.sf(total, dof), stats.chi2.cdf(total, dof))
            yield Finding("size", float(chance))
        elif self.view.fit.noise.is_beside_quoted:
            size = np.square(self.view.fit.residual / channels.quoted)[self.used]
            dof = max(size.size - self.rank, 1)
            yield Finding("size", float(stats.chi2.sf(np.nansum(size), dof)))

    def _common(self, mean):
        """Whether bodies of a scene are off together, as where a camera shakes."""
        channels, total = self.channels, np.zeros(len(self.z))
        kinds, group = np.unique(
            np.stack([channels.scene, channels.axis]), axis=1, return_inverse=True
        )
        pairs = 0
        for number in range(kinds.shape[1]):
            own = self.z[:, :, group.ravel() == number]
            seen = self.used[:, group.ravel() == number].sum(axis=1)
            pairs += int((seen * (seen - 1)).sum())
            total += np.square(own.sum(axis=2)).sum(axis=1) - np.square(own).sum(axis=(1, 2))
        if pairs:
            yield Finding("common", _p_beside(total / mean, is_upper=True))

    def _levels(self, code, index, names, place):
        """Whether a scene or a body has another level than all others."""
        size = np.bincount(index, np.square(self.rows[0]).sum(axis=0), len(names))
        dof = np.bincount(index, np.where(self.left > 0, self.left, 0.0).sum(axis=0), len(names))
        others = dof.sum() - dof
        able = np.flatnonzero((dof > 1) & (others > 1))
        if len(able) < 2:
            return
        ratio = size / np.maximum(dof, 1e-9) / ((size.sum() - size) / np.maximum(others, 1e-9))
        chance = 2 * np.minimum(stats.f.sf(ratio, dof, others), stats.f.cdf(ratio, dof, others))
        least = chance[able] <= 2 * chance[able].min()  # of two, either; the louder is told
        k = able[least][np.argmax(ratio[able][least])]
        yield Finding(code, min(float(chance[k]) * len(able), 1.0), **{place: names[k]})


def _smooth(whitener, channels, seen, most):
    """Whitened polynomials of time, orthonormal channel by channel, (K, T, C)."""
    counts = seen.sum(axis=0)
    n = int(np.clip(counts[counts > 0].min() // ROWS_EACH, 1, most))
    low, high = (
        f(np.where(seen, channels.times, end), axis=0)
        for f, end in ((np.min, np.inf), (np.max, -np.inf))
    )
    with np.errstate(invalid="ignore"):  # of a channel that shows nothing
        share = (channels.times - low) / (high - low)
    angle = np.arccos(np.clip(2 * np.where(seen, share, 0.0) - 1, -1, 1))
    waves = np.cos(np.arange(n)[:, None, None] * angle) * seen
    q, _ = np.linalg.qr(np.moveaxis(whitener.whiten(waves), (0, 1, 2), (2, 1, 0)))
    return np.moveaxis(q, (0, 1, 2), (2, 1, 0)) * seen


def _beside(rows, waves):
    """Rows (B, T, c) less waves (K, T, c), channel by channel."""
    inside = np.einsum("ktc,btc->bkc", waves, rows)
    return rows - np.einsum("bkc,ktc->btc", inside, waves)


def _p_beside(values, is_upper=False):
    """Chance of the first value, from the others as draws of a normal distribution."""
    size = np.abs(values).max()
    values = values / size if 0 < size < np.inf else values
    draws = values[1:]
    spread = draws.std(ddof=1) * np.sqrt(1 + 1 / len(draws))
    t = (values[0] - draws.mean()) / spread if spread > 0 else 0.0
    return float(stats.t.sf(t if is_upper else abs(t), len(draws) - 1) * (1 if is_upper else 2))


# --- how much may be hidden -----------------------------------------------------------------------


@dataclass(frozen=True)
class HiddenBound:
    """Upper bounds, 95 %, on what may still be missing; nan where it cannot be said.

    Attributes
    ----------
    snr : float
        Of any force that the moments show.
    acceleration : float, m/s^2
        Of a constant force on a body of median mass, on the worst axis; inf where constants of
        the law can imitate it.
    force : float, N
    share : float
        Of the root mean square of the declared force.
    """

    snr: float
    acceleration: float
    force: float
    share: float


def hidden_bound(view):
    """How much could still be hidden beside the fit of a View; no force, of velocities alone."""
    if view.dataset.is_of_sight:
        return HiddenBound(_snr_bound(view), np.nan, np.nan, np.nan)
    batches = view.response.regression.batches
    masses = view.masses or [np.ones(b.valid.shape[1:3]) for b in batches]
    typical = float(np.median(np.concatenate([m.ravel() for m in masses])))
    worst = 0.0
    for axis in np.flatnonzero(np.isfinite(view.fit.noise.levels)):
        pushes = [np.zeros((*b.valid.shape[:3], 1, b.valid.shape[3])) for b in batches]
        for push, mass in zip(pushes, masses, strict=True):
            push[..., 0, axis] = typical / mass
        score = view.score_forces(moments_of(view, pushes))
        worst = max(worst, float(abs(score.amplitudes[0]) + Z * score.errors[0]))
    force = np.nan if view.masses is None else worst * typical
    declared = _declared_force(view, masses)
    share = force / declared if declared > 0 else np.nan
    return HiddenBound(_snr_bound(view), worst, force, share)


def _snr_bound(view):
    """Upper bound on the SNR of what the moments hold, never below what noise alone allows."""
    rank, size = view.n_left, float(view.left @ view.left)
    if np.isfinite(view.noise_dof):  # the level may have been estimated too high
        size *= 1 + Z * np.sqrt(2 / view.noise_dof)
    if rank < 1 or not np.isfinite(size):
        return np.nan
    if size > 1e4 + 10 * rank:
        return float(np.sqrt(size - rank) + Z)
    whole = stats.chi2.cdf(size, rank)

    def excess(square):
        return stats.ncx2.cdf(size, rank, square) - (1 - LEVEL) * whole

    return float(np.sqrt(optimize.brentq(excess, 1e-9, 4 * size + 10 * rank + 100)))


def _declared_force(view, masses):
    """Root mean square of the declared force on a body, N."""
    law, regression = view.fit.law, view.response.regression
    declared = ForceLaw(tuple(t for t in law.terms if t.is_declared), law.constants)
    squares = [np.zeros(0)]
    for batch, mass in zip(regression.batches, masses, strict=True):
        size = np.square(regression.predict(batch, declared) * mass[..., None]).sum(axis=-1)
        squares.append(size[batch.valid.any(axis=-1)])
    squares = np.concatenate(squares)
    return float(np.sqrt(squares.mean())) if len(squares) else np.nan
