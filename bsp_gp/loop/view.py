"""A fit as proposers look at it: its tangent, its response to forces, noise that was simulated."""

import math
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import stats

from bsp_gp.data.extent import is_astronomical, is_of_the_sky
from bsp_gp.data.noise import estimate_noise
from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.bent import steadied
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Forces, TrackNoise
from bsp_gp.fitting.response import respond
from bsp_gp.fitting.tangent import Tangent, p_of_gain, score_of
from bsp_gp.language.formula import Call, Input, Number
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.loop.clock import TimeIsUp
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.proposal import FAULTS
from bsp_gp.loop.questions import least_chance
from bsp_gp.physics.force import Term, split_linear
from bsp_gp.search.columns import orthonormal
from bsp_gp.units import Unit, parse_unit

MOST_PAIRS = 100_000
"""Pairs of bodies, at all instants, for which every law is evaluated; of more only the best are."""
MOST_WEIGHTS = 400_000
"""Products that the moments of one force are made of, above which forms that act on bodies by
themselves, and waves, are scanned on a part of the chains, and the best of them scored on all."""
MOST_ROWS = 10_000
"""Of which forces that change from row to row are asked for."""
NOTHING = 1e-150
"""Size of moments below which numbers do not carry them."""
MOST_LEVELS = 4
"""Times that the level of the noise is told anew beside a free force."""
N_DRAWS, N_ROW_DRAWS = 49, 99
"""Simulated moments behind the effective number of forces that were tried; residuals row by row."""


class View:
    """One fit to the training scenes.

    Parameters
    ----------
    dataset : Dataset
        Training scenes.
    usual : sequence of Formula
        Laws by which pieces are known whose moments are bent, see `bsp_gp.fitting.bent`.

    Attributes
    ----------
    tick : callable or None
        Asked by long work as it goes on; raises where the time is up.
    seconds_left : float or None
        Seconds that are left for fits; None = no limit.
    explained, promised : float
        Chi-squared that the likeliest law without inner constants explains, and its promise, once
        they are known.
    foremost : float
        The greatest promise of all forms that are listed, and of sums of them, once it is known.
    search_rng : numpy.random.Generator
        For searches that draw.
    drawn : tuple of Candidate
        Laws with constants inside that these have found, once they are known.
    leading : dict of Formula to float
        The likeliest laws without inner constants, once they are known, less their own constant,
        and the nats that each costs beforehand.
    noise_findings : tuple of Finding
        Of the noise of the fit, once it was asked.
    """

    def __init__(self, fit, hypothesis, dataset, rng, criteria=None, usual=()):
        self.criteria, self._usual = criteria or Criteria(), tuple(usual)
        self._fit, self.hypothesis, self._dataset = fit, hypothesis, dataset
        self.dataset = hypothesis.seen(dataset)
        self.seconds_left = None
        self.tick, self.explained, self.promised, self.foremost = None, 0.0, -np.inf, -np.inf
        self.noise_findings, self.drawn, self.leading = (), (), {}
        self._rows_rng, self._moments_rng = rng.spawn(2)
        (self.search_rng,) = self._moments_rng.spawn(1)
        (self._white_rng,) = self._rows_rng.spawn(1)

    @cached_property
    def _as_fitted(self):
        return respond(self._fit, self.dataset)

    @cached_property
    def _found(self):
        """The fit, under the noise that a free force leaves if it is estimated; its response."""
        found, response = self._without_memory or (self._fit, self._as_fitted)
        is_free = found.noise.is_free[np.isfinite(found.noise.levels)]  # nan: an axis without data
        for _ in range(MOST_LEVELS if is_free.all() else 0):
            if response.level == 1.0:
                break
            levels = np.maximum(np.array(found.noise.levels) * response.level, found.noise.floors)
            levels = tuple(levels.tolist())
            found = replace(found, noise=replace(found.noise, levels=levels))
            response = respond(found, self.dataset)
        return found, steadied(response, lambda: self._usual_moments(response))

    def _usual_moments(self, response):
        """Moments of the usual laws, of those that the data can show, (n, c)."""
        columns = [np.zeros((len(response.regression.target()), 0))]
        for formula in self._usual:
            try:
                self._tick()
                column = response.regression.column(Term(split_linear(formula)[1]))[0]
            except EvaluationError:  # some body lacks a property that it names
                continue
            except TimeIsUp:  # nobody has asked for a proposal yet: some tell which are bent
                break
            if np.isfinite(column).all() and column.any():
                columns.append(column)
        return np.concatenate(columns, axis=1)

    def _tick(self):
        if self.tick is not None:
            self.tick()

    @cached_property
    def _without_memory(self):
        """A fit under noise without memory, and its response, or None.

        What forces do slowly looks like noise with a memory: where a force that knows no physics
        is likelier than the memory that was estimated, laws are looked for without it.
        """
        if not self.forced > self.criteria.noise_nats:
            return None
        return self._white[:2]

    @property
    def forced(self):
        """Nats by which a force that knows no physics is likelier than the memory of the noise."""
        if self._white is None:
            return -np.inf
        _, response, less = self._white
        return float(response.free_height - less)

    @cached_property
    def _white(self):
        """A fit under noise without memory, its response, and the nats that it is less likely.

        None where no memory was estimated, or where that leads nowhere.
        """
        noise = self._fit.noise
        if not noise.correlated or noise.is_correlation_known or self._fit.is_failed:
            return None
        plain = TrackNoise(replace(noise, correlated=0.0, correlation_time=0.0), is_given=True)
        try:
            found = fit(
                self.hypothesis + plain, self._dataset, near=self._fit,
                effort=self.criteria.effort, deadline=self.seconds_left,
            )  # fmt: skip
        except FAULTS:
            return None
        if found.is_failed:
            return None
        # As moments do, with all initial states integrated out: noise with a memory tells less of
        # them, some nats for each track, which a maximum over them hides.
        heights = [f.log_likelihood + f.state_volume for f in (self._fit, found)]
        return found, respond(found, self.dataset), heights[0] - heights[1]

    def in_white(self):
        """The same under noise without memory, and the nats that it is less likely; or None.

        None also where it is asked without memory anyway, and where rows are so many that asking
        again with as many moments would take long.
        """
        n_rows = sum(len(scene.times) for scene in self.dataset.scenes)
        if self._white is None or self.is_memory_doubted or n_rows > MOST_ROWS:
            return None
        view = View(
            self._fit, self.hypothesis, self._dataset, self._white_rng, self.criteria, self._usual
        )
        view.tick, view.seconds_left = self.tick, self.seconds_left
        view.noise_findings = self.noise_findings
        found, _, less = self._white
        view._without_memory = found, respond(found, self.dataset, is_quick=True)
        return view, less

    @property
    def is_memory_doubted(self):
        """Whether a force that knows no physics is likelier than the memory of the noise."""
        return self._without_memory is not None

    @property
    def is_lost(self):
        """Whether the law could not be fitted, so that its tracks are not those of the bodies."""
        return self._fit.is_failed

    @property
    def fit(self):
        return self._found[0]

    @property
    def near(self):
        """The fit as it was made, at smoothed tracks: where fits of what may be missing begin.

        Where no free force is likelier than noise its own tracks are nearer.
        """
        if self.free_gain <= self.criteria.noise_nats:
            return self._fit
        smoothed, nodes = self.response.nodes, self._fit.nodes
        is_same = [a.shape for a in smoothed] == [a.shape for a in nodes]
        return replace(self._fit, nodes=smoothed) if is_same else self._fit

    @property
    def response(self):
        return self._found[1]

    @cached_property
    def step(self):
        """Median time from row to row, s."""
        return self.dataset.typical_step

    def since(self, near):
        """The time since the first row, a Formula; the time itself where that begins nearby.

        Parameters
        ----------
        near : float
            Part of the span of the times that is nearby.
        """
        begin = min(float(scene.times[0]) for scene in self.dataset.scenes)
        span = max(float(scene.times[-1]) for scene in self.dataset.scenes) - begin
        time = Input("t", STATE_INPUTS["t"])
        if abs(begin) < near * span:
            return time
        second = Unit.of(s=1)
        unit = self.dataset.units.text(second) if self.dataset.units.is_calibrated(second) else ""
        size = parse_unit(unit)[0] if unit else 1.0
        digits = 4 if abs(begin) < 1e3 * span else 17  # as a person would write it
        text = f"{begin / size:.{digits}g}"
        written = f"{text} [{unit}]" if unit else text
        return Call("sub", time, Number(float(text) * size, second, written))

    @cached_property
    def is_astronomical(self):
        """Whether tracks are so large, in metres, that only gravity acts as far."""
        return is_astronomical(self.dataset)

    @cached_property
    def is_sky(self):
        """Whether places are of the sky: of astronomical size, or angles without a distance."""
        return is_of_the_sky(self.dataset)

    @property
    def odd_nats(self):
        """What a cause costs beforehand that nobody expects of the sky, nats; 0 elsewhere.

        Nothing up there is held, rubbed, turned aside, or shaken along the axes of a picture;
        bodies attract each other, and move as the declared law has it.
        """
        return self.criteria.cause_nats if self.is_sky else 0.0

    def odd_of(self, formula, kind):
        """The same of a force, nats; what acts along the axes of a picture is odder still.

        Parameters
        ----------
        formula : Formula
            In which a place that is sought is no sum along axes.
        kind : str
            Others than "field" are not odd.
        """
        if kind != "field":
            return 0.0
        is_along = self.is_sky and formula.inputs & {"e_x", "e_y"}
        return self.odd_nats + (self.criteria.class_nats if is_along else 0.0)

    @cached_property
    def reference(self):
        """The body of the sky from which places count, so that what pulls it is not seen; or "".

        No measured place is exactly zero: these coordinates are ways from that body.
        """
        if not self.is_sky:
            return ""
        still = [
            {e.name for e, track in zip(s.entities, np.swapaxes(s.positions, 0, 1), strict=True)
             if e.is_static and not np.any(track)}
            for s in self.dataset.scenes
        ]  # fmt: skip
        return min(set.intersection(*still), default="")

    @property
    def free_gain(self):
        """Log-evidence of a force that knows no physics beside white noise, nats."""
        found = self._without_memory
        return (found[1] if found else self._as_fitted).free_gain

    @cached_property
    def noise_chance(self):
        """Chance that noise as it was assumed leaves as odd an error, see `noise_findings`.

        Where a force that knows no physics explains what noise of another level does not, only its
        tails count, which no force makes, and steps as coarse as it, what they round being as
        smooth as a force: what laws lack may be quicker than the functions of time beside which
        the noise is asked.
        """
        if self.is_memory_doubted:  # unless a law is likelier, it is a memory all the same
            return 0.0
        found = self.noise_findings
        if self.free_gain > self.criteria.noise_nats:
            found = [f for f in found if f.code in ("tails", "grid")]
        return least_chance(found)

    @cached_property
    def scatter(self):
        """Noise of each axis that tracks show whatever their law is, m; nan where nothing moves."""
        return np.array(estimate_noise(self.dataset).sigma)

    @cached_property
    def tangent(self):
        return Tangent(self.fit)

    @property
    def noise_dof(self):
        return self.tangent.noise_dof

    @cached_property
    def row_draws(self):
        """Residuals of noise alone, beside everything free, (B, n)."""
        return self.tangent.noise(self._rows_rng, N_ROW_DRAWS)

    @cached_property
    def moment_draws(self):
        """Moments of noise alone, (n, B)."""
        kept = np.concatenate([b.kept.ravel() for b in self.response.regression.batches])
        return self._moments_rng.standard_normal((len(kept), N_DRAWS)) * kept[:, None]

    @cached_property
    def n_pairs(self):
        """Pairs of a body and a source, at all instants at which forces are evaluated."""
        shapes = [(*b.target.shape[:3], b.positions.shape[2] - 1)
                  for b in self.response.regression.batches]  # fmt: skip
        return sum(map(math.prod, shapes))

    @cached_property
    def n_weights(self):
        """Products that the moments of one force are made of."""
        return sum(batch.whitener.size for batch in self.response.regression.batches)

    @cached_property
    def masses(self):
        """Masses of receivers, (S, R) per batch of the response; None where one is not known."""
        batches = self.response.regression.batches
        masses = [b.bodies.column("mass")[:, b.bodies.receivers] for b in batches]
        return masses if all(np.isfinite(m).all() for m in masses) else None

    @cached_property
    def single_terms(self):
        """Terms of the law that are causes by themselves, with their places in it."""
        parts = [p for p in self.hypothesis.parts if isinstance(p, Forces)]
        alone = [not part.is_one_cause for part in parts for _ in part.law.terms]
        return [(k, t) for k, t in enumerate(self.fit.law.terms) if k >= len(alone) or alone[k]]

    # --- forces ----------------------------------------------------------------------------------

    @cached_property
    def _moments(self):
        """Moments left beside the constants, and the basis of what these can take up."""
        target, columns = self.response.left()
        q = orthonormal(columns, len(target))
        return target - q @ (q.T @ target), q

    @property
    def left(self):
        """Moments that the constants leave, (n,)."""
        return self._moments[0]

    @property
    def taken(self):
        """Orthonormal moments that the constants of the law can take up, (n, k)."""
        return self._moments[1]

    @property
    def n_left(self):
        """Independent moments beside the constants."""
        kept = sum(int(b.kept.sum()) for b in self.response.regression.batches)
        return kept - self._moments[1].shape[1]

    def beside(self, columns):
        """Moments (n, c) beside what the constants of the law can take up."""
        return columns - self.taken @ (self.taken.T @ columns)

    def gain_of(self, columns):
        """What columns (n, c) explain together."""
        basis = orthonormal(columns, len(columns))
        return float(np.square(basis.T @ self.left).sum())

    def fitted_to(self, columns):
        """Amounts of columns (n, c) that explain most together, the columns' sizes, the gain."""
        top = np.abs(columns).max(axis=0, initial=0.0)  # squares may be beyond all numbers
        top = np.where(top > NOTHING, top, 1.0)
        size = top * np.linalg.norm(columns / top, axis=0)
        size = np.where(size > NOTHING, size, 1.0)
        amounts = np.linalg.lstsq(columns / size, self.left, rcond=1e-10)[0] / size
        gain = self.left @ self.left - np.square(self.left - columns @ amounts).sum()
        return amounts, size, float(gain)

    def lesser(self, most):
        """The view by so few chains that the moments of a force take no more products than that.

        Returns
        -------
        view : View
            Itself where all are as few.
        rows : ndarray of int or slice
            Where its moments stand among all.
        """
        if self.n_weights <= most:
            return self, slice(None)
        regression, rows = self.response.regression.part(most / self.n_weights)
        other, columns = copy(self), self.response.columns[rows]
        for name in [n for n in vars(self) if isinstance(getattr(View, n, None), cached_property)]:
            del other.__dict__[name]
        response = replace(self.response, regression=regression, columns=columns)
        other._found = self.fit, response
        return other, rows

    def part(self, share):
        """The moments of no more than such a share of all chains.

        Returns
        -------
        regression : ResponseRegression
        rows : ndarray of int
            Where its moments stand among all.
        beside : callable
            ``beside(columns)``: moments (n, c) of it beside what constants of the law take up.
        """
        regression, rows = self.response.regression.part(share)
        q = orthonormal(self.taken[rows], len(rows))
        return regression, rows, lambda columns: columns - q @ (q.T @ columns)

    @cached_property
    def draws_left(self):
        """Of the draws, what the constants of the law cannot take up, (n, B)."""
        return self.beside(self.moment_draws)

    def force_columns(self, formulas, kind="field"):
        """Moments of forces without constants, (n, c)."""
        terms = [Term(formula, kind) for formula in formulas]
        return np.concatenate([self.response.regression.column(t)[0] for t in terms], axis=1)

    def score_forces(self, columns):
        """Score of moments (n, c)."""
        size = np.square(columns).sum(axis=0)
        return score_of(self.beside(columns).T, self.left, size, self.noise_dof)

    def null_forces(self, columns):
        """Gains of the same columns on simulated noise, (B,)."""
        return gains(self.beside(columns).T, self.draws_left.T)

    def detectable(self, alpha):
        """Least constant acceleration, one for all bodies, seen with 95 % on every axis, m/s^2.

        Beside the constants of the law; nan where these imitate it on every axis.
        """
        needed = stats.norm.isf(alpha / 2) + stats.norm.isf(0.05)
        worst = np.nan
        for axis in np.eye(self.dataset.n_dims):
            parts = [
                b.whiten(np.broadcast_to(axis, b.target.shape)).ravel()
                for b in self.response.regression.batches
            ]
            column = np.concatenate(parts)
            left = np.linalg.norm(self.beside(column[:, None]))
            if left > 1e-4 * np.linalg.norm(column):
                worst = np.fmax(worst, needed / left)
        return float(worst)


def gains(rows, draws):
    """Chi-squared that rows (c, n) gain together on each draw (B, n)."""
    size = np.linalg.norm(rows, axis=1)
    unit = rows[size > 0] / size[size > 0, None]
    if not len(unit):
        return np.zeros(len(draws))
    _, s, basis = np.linalg.svd(unit, full_matrices=False)
    return np.square(draws @ basis[s > 1e-6 * s[0]].T).sum(axis=1)


def selected(gain, rank, null, noise_dof=np.inf, is_continuum=False):
    """Chance that noise alone shows as much to the best of all that was tried.

    The effective number of independent trials is read off the greatest gains on simulated noise,
    where these are large; the chance of a single one is exact, however small.

    Parameters
    ----------
    gain : float
        Greatest gain of chi-squared on the data.
    rank : int
        Of what gained it.
    null : ndarray, shape (B,)
        Greatest gains on simulated noise, in whose making the level was known.
    noise_dof : float
    is_continuum : bool
        Whether what was tried runs through a continuum, of rates or places (Davies 1977).
    """
    if not np.isfinite(gain) or not rank:
        return 1.0
    if not len(null):
        return float(p_of_gain(gain, rank, noise_dof))
    # Of trials M, the expected number beyond a bar is M sf(bar): counted at the upper half.
    chance = np.sort(p_of_gain(null, rank))[: max(len(null) // 2, 1)]
    bar = chance[-1]
    if bar == 0.0:  # chances of one trial are below all numbers: what noise shows is counted
        return float((1 + np.count_nonzero(null >= gain)) / (len(null) + 1))
    share = len(chance) / (len(null) + 1)
    trials = max(np.log1p(-share) / np.log1p(-min(bar, 1 - 1e-12)), 1.0)
    height = float(np.sort(null)[::-1][len(chance) - 1])
    if is_continuum and gain > height > 0:  # more of its trials are apart, the higher the bar
        trials *= np.sqrt(gain / height)
    one = min(float(p_of_gain(gain, rank, noise_dof)), 1 - 1e-16)
    return float(-np.expm1(trials * np.log1p(-one)))
