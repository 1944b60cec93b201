"""The profile of a law: its constants and the latents fitted together, from many starts at once.

Levenberg-Marquardt within the bounds of the priors (Marquardt 1963, SIAM J. 11, 431; variables at
a bound that the data push outwards are held there), vectorised over starts. Latents of different
scenes are differenced together, since they touch no common residual.
"""

from dataclasses import dataclass, field

import numpy as np

MAX_ITERATIONS = 100
STIFF = 1e3
"""Damping at which a step is so short that a failure means an optimum."""
STEP = 1e-7
"""Finite-difference step, in standard deviations of the prior."""
ENOUGH = 1e-13
"""Loss below this is rounding."""
SLOW = 1e-5
"""A start has converged when an iteration takes off less than this part of its loss."""

CHANGED = 4
"""Best places whose discrete latents are changed one by one."""
MOST_CHANGES = 50


@dataclass(frozen=True, eq=False)
class Profile:
    """The joint optimum of a law.

    Attributes
    ----------
    law : ForceLaw
        With the fitted constants.
    values : ndarray, shape (k,)
        Latents at the optimum.
    constants : ndarray, shape (n_c,)
    loss : float
        Half the whitened sum of squares there, less the log of Gaussian priors: -log joint up to
        a constant, nats.
    chisq : float
        The whitened sum of squares alone.
    jacobian : ndarray, shape (m, k + n_c)
        Of the (compressed) residual by coordinates of the latents and constants.
    pull : ndarray, shape (k + n_c,)
        Information that Gaussian priors add (1 / sd^2).
    at_bound : ndarray of bool, shape (k,)
    losses : ndarray, shape (B,)
        From every start, sorted: several near the least mean that it was found repeatedly.
    """

    law: object
    values: np.ndarray
    constants: np.ndarray
    loss: float
    chisq: float
    jacobian: np.ndarray = field(repr=False)
    pull: np.ndarray = field(repr=False)
    at_bound: np.ndarray
    losses: np.ndarray
    n_rows: int

    @property
    def information(self):
        """Fisher information of coordinates and constants, priors included."""
        return self.jacobian.T @ self.jacobian + np.diag(self.pull)


def fit_profile(misfit, starts, *, give_up=np.inf):
    """Fit latents and constants of a law together.

    Discrete latents end at values of their sets: the best of the nearest values and of the starts,
    improved by changes of one latent at a time.

    Parameters
    ----------
    starts : ndarray, shape (B, k)
        Values of the latents to start from.
    give_up : float
        Losses above this are not worth finishing: the fit ends after a third of its iterations.
    """
    problem = _Problem(misfit)
    first = problem.initial(np.atleast_2d(np.asarray(starts, dtype=float)))
    x, loss = _descend(problem, first.copy(), give_up)
    if problem.is_discrete.any() and loss.min() <= give_up:  # fits no worse between its values
        x, loss = _on_values(problem, np.concatenate([x, first]))
    return problem.profile(x, loss)


class FixedConstants:
    """A misfit whose constants are not free."""

    def __init__(self, misfit):
        self.misfit = misfit
        self.law, self.latents, self.constants = misfit.law, misfit.latents, ()
        self.scene_names, self.row_scene = misfit.scene_names, misfit.row_scene
        self.rest, self.n_rows = misfit.rest, misfit.n_rows

    @property
    def start(self):
        """No constants."""
        return np.zeros(0)

    def residual(self, values, constants=None):
        """With the constants of the law."""
        return self.misfit.residual(values)


def _descend(problem, x, give_up=np.inf):
    """Damped Gauss-Newton from every row; the places it ends in and their losses."""
    damping = np.full(len(x), 1e-3)
    r = problem.residual(x)
    loss = problem.loss(r, x)
    slow = np.zeros(len(x), dtype=int)
    for iteration in range(MAX_ITERATIONS):
        live = np.flatnonzero((slow < 3) & (loss > ENOUGH) & np.isfinite(loss))
        if not len(live) or (3 * iteration > MAX_ITERATIONS and loss.min() > give_up):
            break
        trial = problem.step(x[live], r[live], damping[live])
        trial_r = problem.residual(trial)
        trial_loss = problem.loss(trial_r, trial)
        better = trial_loss < loss[live]
        gained = np.where(better, loss[live] - trial_loss, 0.0)
        # A step that was too long says nothing about convergence, unless it was a short one.
        is_slow = (gained <= SLOW * loss[live]) & (better | (damping[live] > STIFF))
        slow[live] = np.where(gained > SLOW * loss[live], 0, slow[live] + is_slow)
        damping[live] = np.clip(np.where(better, damping[live] / 5, damping[live] * 8), 1e-15, 1e8)
        kept = live[better]
        x[kept], r[kept], loss[kept] = trial[better], trial_r[better], trial_loss[better]
    return x, loss


def _on_values(problem, x):
    """Discrete latents at values of their sets: the nearest ones, then single changes that help."""
    problem.holds_discrete = True
    x, loss = _descend(problem, problem.with_constants(problem.on_values(x)))
    best = np.argsort(loss, kind="stable")[:CHANGED]
    x, loss = x[best], loss[best]
    for row in range(len(x)):
        for _ in range(MOST_CHANGES):
            trial = problem.changes(x[row])
            if not len(trial):
                break
            trial = problem.with_constants(trial)
            trial_loss = problem.loss(problem.residual(trial), trial)
            k = int(np.argmin(trial_loss))
            if not trial_loss[k] < loss[row] * (1 - SLOW):
                break
            x[row], loss[row] = trial[k], trial_loss[k]
    return _descend(problem, x)


class _Problem:
    """Parameters x = (coordinates of latents / spread, constants / their scale)."""

    def __init__(self, misfit):
        self.misfit = misfit
        self.latents = misfit.latents
        self.k = len(self.latents)
        self.unit = self.latents.of_priors("spread")
        self.low, self.high = (self.latents.of_priors("bounds") / self.unit[:, None]).T
        mean, sd = self.latents.of_priors("pull").T
        self.center = mean / self.unit
        self.weight = self.unit / sd  # of the prior residual, 0 where flat
        self.constant_unit = np.ones(len(misfit.constants))
        self.colours = self._colours()
        self.is_discrete = self.latents.is_discrete
        self.holds_discrete = False

    def _colours(self):
        """Groups of latents that touch disjoint scenes."""
        place = {name: s for s, name in enumerate(self.misfit.scene_names)}
        groups, scenes_of = [], []
        for k, item in enumerate(self.latents.items):
            mine = {place[s] for s, _ in item.members if s in place}
            for group, taken in zip(groups, scenes_of, strict=True):
                if not taken & mine:
                    group.append((k, mine))
                    taken |= mine
                    break
            else:
                groups.append([(k, mine)])
                scenes_of.append(set(mine))
        return groups

    def initial(self, values):
        z = self.latents.to_coordinate(values) / self.unit if self.k else values
        z = np.clip(z, self.low, self.high)
        c = linear_constants(self.misfit, self.values(z))
        typical = np.median(np.abs(c), axis=0) if len(c) else np.ones(0)
        self.constant_unit = np.where(typical > 0, typical, 1.0)
        return np.concatenate([z, c / self.constant_unit], axis=1)

    def on_values(self, x):
        """Discrete latents at the nearest of their values."""
        x = x.copy()
        for k in np.flatnonzero(self.is_discrete):
            values = self._set(k)
            x[:, k] = values[np.abs(x[:, k, None] - values).argmin(axis=1)]
        return x

    def changes(self, row):
        """Every row in which one discrete latent has another of its values."""
        out = []
        for k in np.flatnonzero(self.is_discrete):
            for value in self._set(k):
                if value != row[k]:
                    out.append(row.copy())
                    out[-1][k] = value
        return np.array(out)

    def with_constants(self, x):
        """The rows with the constants that fit best, where the law is linear in them."""
        fitted = linear_constants(self.misfit, self.values(x[:, : self.k])) / self.constant_unit
        other = np.concatenate([x[:, : self.k], fitted], axis=1)
        better = self.loss(self.residual(other), other) < self.loss(self.residual(x), x)
        return np.where(better[:, None], other, x)

    def _exact(self, values):
        """Discrete latents as their priors have them, without rounding."""
        if self.holds_discrete:
            for k in np.flatnonzero(self.is_discrete):
                own = np.array(self.latents.items[k].prior.values)
                values[k] = own[np.abs(own - values[k]).argmin()]
        return values

    def _set(self, k):
        return np.sort(self.latents.items[k].prior.values) / self.unit[k]

    def values(self, z):
        return self.latents.from_coordinate(z * self.unit)

    def residual(self, x):
        with np.errstate(all="ignore"):
            data = self.misfit.residual(
                self.values(x[:, : self.k]), x[:, self.k :] * self.constant_unit
            )
        return data

    def loss(self, r, x):
        with np.errstate(all="ignore"):
            prior = ((x[:, : self.k] - self.center) * self.weight) if self.k else x[:, :0]
            total = np.square(r).sum(axis=1) + self.misfit.rest.sum()
            total = 0.5 * (total + np.square(prior).sum(axis=1))
        return np.where(np.isfinite(total), total, np.inf)

    def jacobian(self, x, r):
        """(B, m, k + n_c) by forward differences, backward at the upper bound."""
        b, m = r.shape
        n_c = x.shape[1] - self.k
        rows = self.misfit.row_scene
        out = np.zeros((b, m, x.shape[1]))
        moved, signs = [], []
        for group in self.colours:
            trial = x.copy()
            sign = np.ones((b, len(group)))
            for column, (k, _) in enumerate(group):
                sign[:, column] = np.where(x[:, k] + STEP > self.high[k], -1.0, 1.0)
                trial[:, k] += STEP * sign[:, column]
            moved.append(trial)
            signs.append(sign)
        for k in range(self.k, x.shape[1]):
            trial = x.copy()
            trial[:, k] += STEP * np.maximum(np.abs(x[:, k]), 1.0)
            moved.append(trial)
        if not moved:
            return out
        slopes = self.residual(np.concatenate(moved)).reshape(len(moved), b, m) - r
        for slope, group, sign in zip(slopes, self.colours, signs, strict=False):
            for column, (k, scenes) in enumerate(group):
                mine = np.isin(rows, list(scenes))
                out[:, mine, k] = slope[:, mine] / (STEP * sign[:, column, None])
        for j in range(n_c):
            h = STEP * np.maximum(np.abs(x[:, self.k + j]), 1.0)
            out[:, :, self.k + j] = slopes[len(self.colours) + j] / h[:, None]
        return np.where(np.isfinite(out), out, 0.0)

    def step(self, x, r, damping):
        """One damped, projected Gauss-Newton step for every start."""
        jacobian = self.jacobian(x, r)
        gradient = np.einsum("bmp,bm->bp", jacobian, np.where(np.isfinite(r), r, 0.0))
        normal = np.einsum("bmp,bmq->bpq", jacobian, jacobian)
        p = x.shape[1]
        index = np.arange(self.k)
        normal[:, index, index] += np.square(self.weight)
        gradient[:, : self.k] += (x[:, : self.k] - self.center) * np.square(self.weight)
        low = np.concatenate([self.low, np.full(p - self.k, -np.inf)])
        high = np.concatenate([self.high, np.full(p - self.k, np.inf)])
        held = ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
        if self.holds_discrete:
            held[:, : self.k] |= self.is_discrete
        size = np.einsum("bpp->bp", normal)
        size = np.where(size > 0, size, 1.0)
        scale = 1 / np.sqrt(size)
        system = normal * scale[:, :, None] * scale[:, None, :]
        system = np.where(held[:, :, None] | held[:, None, :], 0.0, system)
        every = np.arange(p)
        system[:, every, every] = np.where(held, 1.0, 1.0 + damping[:, None])
        right = np.where(held, 0.0, -gradient * scale)
        move = np.linalg.solve(system, right[..., None])[..., 0] * scale
        return np.clip(x + move, low, high)

    def profile(self, x, loss):
        best = int(np.argmin(loss))
        one = x[best : best + 1]
        r = self.residual(one)
        jacobian = self.jacobian(one, r)[0]
        units = np.concatenate([self.unit, self.constant_unit])
        z = one[0, : self.k]
        constants = one[0, self.k :] * self.constant_unit
        law = self.misfit.law.with_constants(
            dict(zip(self.misfit.constants, constants, strict=True))
        )
        pull = np.concatenate([np.square(self.weight / self.unit), np.zeros(len(constants))])
        return Profile(
            law, self._exact(self.values(z[None])[0]) if self.k else np.zeros(0), constants,
            float(loss[best]), float(np.square(r).sum() + self.misfit.rest.sum()), jacobian / units,
            pull, ((z <= self.low) | (z >= self.high)) & ~self.is_discrete, np.sort(loss),
            self.misfit.n_rows,
        )  # fmt: skip


def linear_constants(misfit, values):
    """Best constants (W, n_c) at given latents, taking the law as linear in them.

    Constants that are not linear keep the start values of the law.
    """
    n_draws, n_c = len(values), len(misfit.constants)
    if not n_c:
        return np.zeros((n_draws, 0))
    start = np.broadcast_to(misfit.start, (n_draws, n_c))
    with np.errstate(all="ignore"):
        base = misfit.residual(values, np.zeros((n_draws, n_c)))
        columns = np.stack(
            [misfit.residual(values, np.tile(row, (n_draws, 1))) - base for row in np.eye(n_c)],
            axis=2,
        )
        double = misfit.residual(values, np.full((n_draws, n_c), 2.0))
        scale = np.abs(double).max() + 1e-300
        is_linear = np.abs(double - base - 2 * columns.sum(axis=2)).max() <= 1e-8 * scale
    if not is_linear or not np.isfinite(columns).all() or not np.isfinite(base).all():
        return np.array(start)
    top = np.linalg.norm(columns, axis=1)
    top = np.where(top > 0, top, 1.0)
    scaled = columns / top[:, None, :]
    normal = np.einsum("wmp,wmq->wpq", scaled, scaled)
    right = -np.einsum("wmp,wm->wp", scaled, base)
    solved = np.einsum("wpq,wq->wp", np.linalg.pinv(normal, hermitian=True), right)
    return solved / top
