"""The least-squares driver: every fit of the project is a `Problem` that `minimise` solves.

A trust-region Levenberg-Marquardt method (Moré, Lecture Notes in Mathematics 630, 105, 1978) with
bounds, for problems whose points carry more than the unknowns: the states of tracks are eliminated
from each linearisation and move along with the unknowns. `scipy.optimize.least_squares` knows no
such points, and what it calls success is often a stall (experiments/nist_strd.py counts both).
"Converged" means here that a whole Gauss-Newton step would gain nothing that the noise lets anyone
see. Geodesic acceleration was measured and left out: 8 % fewer evaluations on those problems.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from bsp_gp.errors import SettingsError
from bsp_gp.fitting.problem import Linearised, Minimum, Settings

_EPS = np.finfo(float).eps
_REFUSALS = 8
"""Steps that are refused in a row, each shorter, after which none is expected to be taken."""
_HUGE = 1e125
"""Residuals and columns longer than this are those of a model that runs away."""
_BLOCK = 256
_KINK, _SLIGHT = 0.01, 1e-5
"""Fall of chi-squared, in variances of the noise and as a part of it, that is none where no step
makes it: friction that stops a body leaves kinks in the sum of squares."""
_ACCEPTED, _POOR, _GOOD = 1e-4, 0.25, 0.75
"""Parts of the fall foreseen: from the first a step is taken, below the second the radius shrinks,
above the third it grows."""
_REINED, _LEAST_REIN = 0.1, 0.05
"""How much shorter steps become of blocks whose last ones failed; blocks of still shorter ones are
held."""
_OWN = 0.5
"""Part of what a step is to change of a block that its own step must make to be to blame."""
_CREEPING, _CREPT = 1e-3, 5
"""Part of the fall of a whole step below which steps creep, and how many of these in a row end a
descent: where a node passes an instant at which forces change at once, what intervals tell of each
other jumps as long as they do not join, and no step is short enough."""
_TRIED = 12
"""Linearisations after which a descent that is hopelessly far up is given up."""
_FEWEST_BLOCKS, _MOST_HELD = 3, 0.5
"""Blocks from which single ones may be to blame; part of them that may fail at once, or be held."""


def minimise(problem, start, *, low=None, high=None, settings=None, is_over=None):
    """Descend from a point to a minimum of chi-squared.

    Parameters
    ----------
    start : object
        A point of the problem, inside of the bounds.
    low, high : array_like, shape (k,), optional
        Bounds of the shared unknowns; equal ones hold an unknown fixed.
    is_over : callable, optional
        Asked before every linearisation; true ends the search ("unconverged", code "stopped").

    Raises
    ------
    SettingsError
        If the start lies outside of the bounds.
    """
    with np.errstate(all="ignore"):  # a trial step may run away; what is not finite is refused
        return _Descent(problem, start, low, high, settings or Settings(), is_over).run(start)


@dataclass(frozen=True, eq=False)
class _Place:
    """A point and its linearisation in few numbers: J = Q triangle, image = Q' residual."""

    point: Any
    values: np.ndarray
    linearised: Linearised
    own: np.ndarray  # what own steps of the blocks do, see `Linearised.own`
    chisqr: float
    lengths: np.ndarray
    triangle: np.ndarray
    image: np.ndarray
    free: np.ndarray
    gradient: float

    @property
    def rounding(self):
        """Fall of chi-squared that rounding of the residuals and the unknowns alone foresees."""
        terms = np.sum(np.square(self.lengths * self.values))
        return (4 * _EPS) ** 2 * (self.chisqr + terms) if np.isfinite(terms) else 0.0


@dataclass(frozen=True, eq=False)
class _Step:
    values: np.ndarray
    share: float
    size: float
    fall: float
    unseen: np.ndarray  # part of each unknown (0 to 1) that lies where nothing is determined
    n_unseen: int


class _Descent:
    """One run: bounds, settings and the count of linearisations."""

    def __init__(self, problem, start, low, high, settings, is_over):
        values = np.asarray(problem.values(start), dtype=float)
        self.problem, self.settings, self.is_over = problem, settings, is_over
        self.low = np.full(values.shape, -np.inf) if low is None else np.array(low, dtype=float)
        self.high = np.full(values.shape, np.inf) if high is None else np.array(high, dtype=float)
        outside = ~((self.low <= values) & (values <= self.high)) & np.isfinite(values)
        if outside.any():
            k = int(np.flatnonzero(outside)[0])
            raise SettingsError(
                f"the start of unknown {k} must lie within its bounds {self.low[k]:g} to "
                f"{self.high[k]:g}, got {values[k]:g}; move the start or widen the bounds"
            )
        self.n_linearised = 0
        self.reins = None  # longest parts of their own steps that blocks may make; 0 = held
        self.seen = None  # what the last look showed, finite or not
        self.was_released = False

    @property
    def held(self):
        return self.reins == 0

    def run(self, start):
        here = self.look(start)
        if here is None and self.seen is not None:
            here = self.without_lost(start)
        if here is None:
            values = np.asarray(self.problem.values(start), dtype=float)
            nothing = np.ones(values.shape, dtype=bool)
            return Minimum(start, values, None, "nonfinite", "start", np.inf, np.inf, nothing,
                           self.n_linearised)  # fmt: skip
        scale, radius, least, code = np.zeros(len(here.values)), np.inf, np.inf, ""
        n_crept = 0
        while not code:
            scale = np.maximum(scale, here.lengths)
            whole = self.solve(here, here.lengths, np.inf)
            least = min(least, whole.n_unseen)
            if whole.fall > self.negligible(here):
                before, (here, radius, code) = here, self.descend(here, scale, radius)
                creeps = before.chisqr - here.chisqr < _CREEPING * whole.fall
                # Without local unknowns nothing is left to join: a valley is followed to its end.
                n_crept = n_crept + 1 if creeps and len(here.linearised.rests) else 0
                if n_crept >= _CREPT:
                    code = code or "stalled"
                if self.n_linearised >= _TRIED and here.chisqr > self.settings.hopeless:
                    code = code or "limit"
                continue
            # Blocks that failed while the unknowns were far off may follow them now.
            released = self.released(here)
            if released is None:
                code = "fall"
            else:
                here, radius = released, np.inf
        if code == "stalled" and self.settings.absolute:
            code = "fall" if whole.fall < min(_KINK, _SLIGHT * here.chisqr) else code
        if code == "fall":
            here, whole = self.polish(here, self.solve(here, here.lengths, np.inf))
        return self.finish(here, whole, code, least)

    def negligible(self, here):
        settings = self.settings
        return max(settings.absolute, settings.relative * here.chisqr, here.rounding)

    def reason_to_stop(self):
        if self.n_linearised >= self.settings.max_linearised:
            return "limit"
        return "stopped" if self.is_over is not None and self.is_over() else ""

    def look(self, point):
        """Linearise at a point; None where that is not finite."""
        self.n_linearised += 1
        self.seen = self.problem.linearise(point)
        return None if self.seen is None else self.place(point, self.seen)

    def without_lost(self, start):
        """The start without the blocks that are not finite there; None if those are too many."""
        chisqr = self.seen.by_block(self.seen.residual) + self.seen.rests
        is_lost = ~(chisqr < _HUGE**2)
        if len(is_lost) < _FEWEST_BLOCKS or not self.may_hold(is_lost):
            return None
        self.reins[is_lost] = 0.0
        return self.place(start, self.seen)

    def place(self, point, linearised):
        """A point without the blocks that are held; None where it is not finite."""
        if self.reins is None:
            self.reins = np.ones(len(linearised.rests))
        residual, jacobian, rests = linearised.residual, linearised.jacobian, linearised.rests
        if self.held.any():
            rows = np.flatnonzero(self.held[linearised.block])
            residual, jacobian = residual.copy(), jacobian.copy()
            residual[rows], jacobian[rows] = 0.0, 0.0
            rests = np.where(self.held, 0.0, rests)
        own = np.where(self.held, 0.0, linearised.own(self.reins))
        lengths = np.sqrt(np.sum(np.square(jacobian), axis=0))
        chisqr = float(residual @ residual + rests.sum())
        if not (chisqr < _HUGE**2 and np.all(lengths < _HUGE)):
            return None
        values = np.asarray(self.problem.values(point), dtype=float)
        triangle, image = _triangle(jacobian, residual)
        slopes = jacobian.T @ residual
        blocked = ((values <= self.low) & (slopes > 0)) | ((values >= self.high) & (slopes < 0))
        free = (self.low < self.high) & ~blocked
        lines = lengths * np.sqrt(residual @ residual)
        cosines = np.abs(slopes[free]) / np.where(lines > 0, lines, 1.0)[free]
        gradient = float(np.max(cosines, initial=0.0))
        return _Place(
            point, values, linearised, own, chisqr, lengths, triangle, image, free, gradient
        )

    def solve(self, here, scale, radius):
        """The step of the free unknowns that the linearisation finds best within a radius.

        Lengths are those of the change of the residual, unknown by unknown (`scale`: lengths of
        columns), so that units do not matter; the local step counts as one more direction.
        """
        free = here.free
        along, rest = here.own.sum(axis=1)
        scale = np.where(scale > 0, scale, 1.0)[free]
        left, s, right = np.linalg.svd(here.triangle[:, free] / scale, full_matrices=False)
        seen = s > self.settings.rank * np.max(s, initial=0.0)
        s, right = s[seen], right[seen]
        unseen = np.zeros(len(here.values))
        unseen[free] = 1.0 - np.sum(np.square(right), axis=0)
        image = left[:, seen].T @ here.image
        damping = _damping(np.append(s, 1.0), np.append(image, np.sqrt(rest)), radius)
        scaled = -right.T @ (s / (s * s + damping) * image)
        low = (self.low - here.values)[free] * scale
        high = (self.high - here.values)[free] * scale
        if np.any((scaled < low) | (scaled > high)):
            rows = np.vstack([s[:, None] * right, np.sqrt(damping) * np.eye(len(scale))])
            target = np.concatenate([-image, np.zeros(len(scale))])
            bounded = lsq_linear(rows, target, (low, high), method="bvls", max_iter=9 * len(scale))
            scaled = np.clip(bounded.x, low, high)
            scaled = np.where(bounded.active_mask < 0, low, scaled)  # to the last bit
            scaled = np.where(bounded.active_mask > 0, high, scaled)
        share = 1.0 / (1.0 + damping)
        left_over = image + s * (right @ scaled)
        values = here.values.copy()
        values[free] += scaled / scale
        values[free] = np.where(scaled <= low, self.low[free], values[free])
        values[free] = np.where(scaled >= high, self.high[free], values[free])
        values = np.clip(values, self.low, self.high)
        fall = image @ image - left_over @ left_over
        fall += share * (2.0 * along - share * rest)
        size = np.sqrt(scaled @ scaled + share**2 * rest)
        return _Step(values, share, float(size), float(fall), unseen, len(scale) - len(s))

    def moved(self, here, step):
        point = self.problem.move(
            here.point, here.linearised, step.values, step.share, self.reins
        )
        return self.look(point)

    def descend(self, here, scale, radius):
        """Try shorter and shorter steps until one is taken: (place, radius, why there is none).

        As long as whole Gauss-Newton steps gain what they promise, there is no radius.
        """
        for _ in range(_REFUSALS):
            step = self.solve(here, scale, radius)
            if not step.fall > _EPS * here.chisqr:
                return here, radius, "stalled"
            if reason := self.reason_to_stop():
                return here, radius, reason
            there = self.moved(here, step)
            gain = -1.0 if there is None else (here.chisqr - there.chisqr) / step.fall
            if gain < _GOOD and step.fall <= here.linearised.rounding:
                # The last digits of the local unknowns may be all that is left, and are not
                # always: states that grow fast gain much more than their bound lets expect.
                return (there if gain > 0 else here), radius, "fall"
            if gain < _GOOD and self.rein(here, step):
                here = self.place(here.point, here.linearised)
                continue
            is_taken = gain >= _ACCEPTED
            if np.isinf(radius) and gain < _GOOD:
                radius = np.sqrt(np.sum(np.square(scale * here.values))) or np.sqrt(here.chisqr)
                is_taken = is_taken and step.size <= radius
            if gain < _POOR:
                radius = min(radius, step.size * (0.25 if there is not None else 0.1))
            elif gain > _GOOD:
                radius = max(radius, 2.0 * step.size)
            if is_taken:
                if self.loosen(here, step):
                    there = self.place(there.point, there.linearised)
                return there, radius, ""
        return here, radius, "stalled"

    def rein(self, here, step):
        """Shorten the steps of single blocks if those alone are to blame that a step fails.

        Blocks share nothing but the unknowns: one that its linearisation tells wrong must not
        shorten the steps of all others.
        """
        is_own = ~self.held
        if self.seen is None or is_own.sum() < _FEWEST_BLOCKS:
            return False
        now, foreseen, found, promised = self.blocks(here, step)
        excess = found - foreseen
        failed = is_own & (excess > (1.0 - _POOR) * promised)
        failed &= promised > _OWN * np.abs(now - foreseen)
        failed &= excess > (1.0 - _GOOD) * step.fall / is_own.sum()
        others = is_own & ~failed
        gained, asked = (now - found)[others].sum(), (now - foreseen)[others].sum()
        if not failed.any() or not self.may_hold(failed):
            return False
        if not gained >= _POOR * asked - self.negligible(here):  # these fail as well
            return False
        self.reins = np.where(failed, _REINED * self.reins, self.reins)
        self.reins[self.reins < _LEAST_REIN] = 0.0
        return True

    def released(self, here):
        """The place with all blocks that are held once more free, once; None without such."""
        if self.was_released or not self.held.any():
            return None
        self.was_released, held = True, self.held
        self.reins[held] = 1.0
        free = self.place(here.point, here.linearised)
        if free is None:
            self.reins[held] = 0.0
        return free

    def may_hold(self, failed):
        """Whether these blocks and those that are held are few enough to be to blame."""
        return 0 < np.sum(failed | self.held) <= _MOST_HELD * len(self.reins)

    def loosen(self, here, step):
        """Let blocks whose own steps did what was foreseen make longer ones; whether any did."""
        if not (self.reins < 1.0).any():
            return False
        _, foreseen, found, promised = self.blocks(here, step)
        is_good = found - foreseen <= (1.0 - _GOOD) * promised
        self.reins = np.where(is_good, np.minimum(self.reins / _REINED, 1.0), self.reins)
        return bool(is_good.any())

    def blocks(self, here, step):
        """Chi-squared of every block: here, foreseen after a step, found there, own part of it."""
        known, found = here.linearised, self.seen
        along, size = here.own
        promised = step.share * (2.0 * along - step.share * size)
        linear = known.residual + known.jacobian @ (step.values - here.values)
        there = found.by_block(found.residual) + found.rests
        return (
            known.by_block(known.residual) + known.rests,
            known.by_block(linear) + known.rests - promised,
            np.where(np.isfinite(there), there, np.inf), promised,
        )  # fmt: skip

    def polish(self, here, whole):
        """Make last whole steps while they bring the gradient down and chi-squared stays.

        So small a fall of chi-squared is lost in its rounding; that of the gradient is not.
        """
        enough = max(here.rounding, 1e-4 * self.negligible(here))
        for _ in range(self.settings.last_steps):
            if whole.fall <= enough or self.reason_to_stop():
                break
            there = self.moved(here, whole)
            if there is None or there.chisqr > here.chisqr * (1.0 + 1e-12) + here.rounding:
                break
            after = self.solve(there, there.lengths, np.inf)
            if not after.fall < whole.fall:
                break
            here, whole = there, after
        return here, whole

    def finish(self, here, whole, code, least):
        values = here.values
        is_bound = (self.low < self.high) & ((values <= self.low) | (values >= self.high))
        is_exact = here.chisqr <= max(self.settings.absolute, here.rounding)
        if code == "fall" and not (is_bound.any() or is_exact):
            has_idle = np.any(here.lengths[here.free] == 0)
            code = "flat" if has_idle or whole.n_unseen > least else code
        if self.held.any():
            code = "held" if code == "fall" else code
        status = "unconverged"
        if code == "fall":
            status = "at_bound" if is_bound.any() else "converged"
        undetermined = whole.unseen > 1e-6
        return Minimum(here.point, values, here.linearised, status, code, here.gradient,
                       whole.fall, undetermined, self.n_linearised, held=self.held)  # fmt: skip


def _triangle(jacobian, residual):
    """R and Q' residual of jacobian = QR, by blocks of rows and without Q: cheaper."""
    rows = np.column_stack([jacobian, residual])
    n_blocks, n_columns = len(rows) // _BLOCK, rows.shape[1]
    if n_blocks > 1 and n_columns < _BLOCK // 2:
        blocks = rows[: n_blocks * _BLOCK].reshape(n_blocks, _BLOCK, n_columns)
        blocks = np.linalg.qr(blocks, mode="r").reshape(-1, n_columns)
        rows = np.concatenate([blocks, rows[n_blocks * _BLOCK :]])
    triangle = np.linalg.qr(rows, mode="r")[: n_columns - 1]
    return triangle[:, :-1], triangle[:, -1]


def _damping(s, image, radius):
    """The damping by which ``s / (s**2 + damping) * image`` is as long as the radius, within 10 %.

    Zero if the undamped step is not longer. Newton's method on the inverse length, from the left.
    """
    damping = 0.0
    for _ in range(60):
        step = s / (s * s + damping) * image
        length = np.sqrt(step @ step)
        excess = length - radius
        if excess <= 0.1 * radius:
            break
        damping += excess / radius * length**2 / np.sum(np.square(step) / (s * s + damping))
    return damping
