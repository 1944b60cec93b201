"""A hypothesis fitted to whole tracks: `fit(hypothesis, dataset) -> Fit`.

Constants, initial states and noise are fitted together. From every start short pieces of the
tracks are fitted first, then ever longer ones, at last the whole (`bsp_gp.fitting.climb`); the
noise is estimated beside the law, and the law fitted again under it.
"""

import math
import time
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from operator import itemgetter

import numpy as np

from bsp_gp.errors import DataError, SettingsError
from bsp_gp.fitting.channels import Channels, join
from bsp_gp.fitting.climb import FINISHING, Climb
from bsp_gp.fitting.hypothesis import Forces, Hypothesis, TrackNoise
from bsp_gp.fitting.led import led_by
from bsp_gp.fitting.noise_estimate import estimate, estimate_beside, needs
from bsp_gp.fitting.noise_model import NoiseModel
from bsp_gp.fitting.probes import probe_terms
from bsp_gp.fitting.starts import roles_of, scales_of
from bsp_gp.fitting.student import log_likelihood
from bsp_gp.fitting.tracks import chain_noises
from bsp_gp.fitting.weighing import bears_outliers, informed, to_begin_with, weighed
from bsp_gp.physics.engine.chains import build_chains, spread
from bsp_gp.physics.engine.constrained import constraints_of
from bsp_gp.physics.engine.linked import is_held
from bsp_gp.physics.engine.motion import Motion
from bsp_gp.physics.engine.seen import sight
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.geometry import POINT
from bsp_gp.threads import one_thread

STATUSES = ("nonfinite", "unconverged", "aliased", "at_bound", "refuted", "converged")
"""How a fit can end; the first that applies."""
FAILED = STATUSES[:3]
"""These say nothing about the law: a failed fit is never "nothing missing"."""
SAME = 1e-9
"""Part of a log-likelihood by which two fits of exact data that are one may differ."""
# No tolerance changes what a converged fit says.
EXACT = 1e-9
"""Noise below this part of the extent is numerical: its level is that of what is left."""
RESOLUTION = 1e-7
"""Part of the extent by which a law may miss exact data (another integrator, numbers cut short):
what it leaves is then their noise."""
MOST_STARTS = 16
"""Starts at the most; all are taken where no two agree."""
NOISE_PASSES, LED_PASSES = 4, 2
"""Times at the most that noise and law are fitted in turn, and that bodies are led anew by the
tracks that a fit gives the others."""
REFUTED = 5.0
"""Standard deviations of chi-squared above its mean from which declared errors refute a law."""
MISFIT = 1.5
"""Reduced chi-squared from which what is left is looked at for a force before its noise is
estimated."""


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """What a fit found.

    Attributes
    ----------
    law : ForceLaw
        With the fitted constants.
    parameters : tuple of (name, entity)
        Entity is "" for a constant that is one for all.
    values : ndarray, shape (k,)
        SI.
    covariance : ndarray, shape (k, k)
        Inverse Fisher information, initial states marginalised, priors of properties counted; inf
        where the data determine nothing.
    noise : NoiseModel
        As it was estimated under the hypothesis.
    status : str
        One of `STATUSES`.
    chisqr, chi2_red : float
        Whitened sum of squares of the tracks, and per degree of freedom.
    n_rows, n_free : int
        Coordinates seen, and free numbers, initial states included.
    n_starts, n_agree : int
        Starts, and those that led here.
    gradient : float
        Largest cosine between residual and the column of a constant, 0 at a minimum.
    log_likelihood, log_evidence : float, nats
        The evidence by Laplace's approximation over everything fitted, with proper priors.
    state_volume : float, nats
        Logarithm of the part of the prior of the initial states that the data leave.
    groups : tuple of Chains
    nodes : tuple of ndarray, shape (2, R, d, T, S)
        Fitted state at every row, per group.
    channels : Channels
        What the columns of `residual` are.
    residual : ndarray, shape (T, C), m
        Observed less predicted; nan where nothing was seen.
    whitened : ndarray, shape (T, C)
        0 where nothing was seen.
    jacobian : ndarray, shape (m, k)
        Whitened, initial states eliminated (compressed to few rows per chain); under tails with
        the weights that give the expected information.
    rows, row_scenes : ndarray, shape (m,); of float and of str
        The whitened residual compressed in the same way, and which scene each row is of.
    local_columns, shared_columns : ndarray, shapes (n, T, C) and (k, T, C)
        Changes of the prediction by the initial state of its chain and by the constants.
    message : str
        Code of why the descent ended.
    lost : tuple of CutShort
        Tracks that no path under the law follows, where all others are followed, each cut where
        it turns most sharply: for them alone it has not converged, or leads others no better.
    chi2_others : float
        Reduced chi-squared of all others where some are lost, else nan.
    """

    law: ForceLaw
    parameters: tuple
    values: np.ndarray
    covariance: np.ndarray
    noise: NoiseModel
    status: str
    chisqr: float
    chi2_red: float
    n_rows: int
    n_free: int
    n_starts: int
    n_agree: int
    gradient: float
    log_likelihood: float
    log_evidence: float
    state_volume: float
    groups: tuple = field(repr=False)
    nodes: tuple = field(repr=False)
    channels: Channels = field(repr=False)
    residual: np.ndarray = field(repr=False)
    whitened: np.ndarray = field(repr=False)
    jacobian: np.ndarray = field(repr=False)
    rows: np.ndarray = field(repr=False)
    row_scenes: np.ndarray = field(repr=False)
    local_columns: np.ndarray = field(repr=False)
    shared_columns: np.ndarray = field(repr=False)
    paper_steps: bool = False
    seconds: float = 0.0
    message: str = ""
    lost: tuple = ()
    chi2_others: float = math.nan

    def __repr__(self):
        names = [f"{n}{f' of {e}' if e else ''} = {v:.4g}" for (n, e), v in
                 zip(self.parameters, self.values, strict=True)]  # fmt: skip
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        return (
            f"Fit: {self.status}, {self.n_agree} of {self.n_starts} starts\n"
            f"  F_i = {self.law.text(digits=False)}\n  {', '.join(names[:8])}{more}\n"
            f"  reduced chi-square {self.chi2_red:.3g} of {self.n_rows} numbers, log-evidence "
            f"{self.log_evidence:.6g}"
        )

    @property
    def is_failed(self):
        """Whether it says nothing about the law."""
        return self.status in FAILED

    @property
    def shows_tracks(self):
        """Whether its nodes show where the bodies were, though the law may not lead there."""
        is_left = self.status == "unconverged" and self.message != "stopped"
        return not self.is_failed or (is_left and np.isfinite(self.residual).any())

    @property
    def starts(self):
        """Its constants, (name, entity) -> float, as where another fit begins."""
        return dict(zip(self.parameters, self.values.tolist(), strict=True))

    @property
    def uncertain(self):
        """Constants of the law, one for all, that the data determine: names, and covariance."""
        known = [k for k, (name, entity) in enumerate(self.parameters)
                 if name in self.law.names and not entity and np.isfinite(self.covariance[k, k])]
        names = tuple(self.parameters[k][0] for k in known)
        return names, self.covariance[np.ix_(known, known)]

    @property
    def errors(self):
        """Standard errors of the constants, shape (k,)."""
        return np.sqrt(np.diag(self.covariance))


def fit(
    hypothesis, dataset, *, starts=None, bounds=None, deadline=None, effort=None, near=None,
    path=None, most_starts=MOST_STARTS,
):  # fmt: skip
    """Fit a hypothesis to all scenes of a data set.

    Parameters
    ----------
    starts : mapping of str to float, optional
        Where constants begin, SI; the others are found from the data.
    bounds : mapping of str to (float, float), optional
        Between which constants stay, SI.
    deadline : float, optional
        Seconds after which a fit ends with what it has, within an integration if need be.
    effort : int, optional
        Steps of all intervals, and of descents, after which it ends so, the same on every
        machine.
    near : Fit, optional
        Of a hypothesis that this one extends: the first descent begins at its tracks, and is the
        last one if it converges.
    path : object, optional
        Whose ``nodes(times)`` says where the bodies are and how they move, shape (2, R, d, T, S):
        the same, instead of the tracks of a fit.

    Raises
    ------
    SettingsError
        If a start or a bound names no constant, or a start is out of its bounds.
    DataError
        If nothing moves.
    """
    began = time.monotonic()
    run = _Run(hypothesis, hypothesis.seen(dataset), starts or {}, bounds or {}, most_starts)
    run.near, run.path = near, path
    if near is not None:
        run.lead(near)
    run.is_over = _Patience(began, deadline, effort and effort * _longer(run.groups))
    # BLAS on one thread is faster on small matrices, with the same bits everywhere. Numbers that
    # overflow on trial lead to points that are not finite, and those are refused.
    with one_thread(), np.errstate(all="ignore"):
        found = []
        for paper in run.step_kinds():
            found.append(run.fit(paper))
            if run.is_reproduced(found[-1]) or run.is_over():
                break
        best = run.led_further(reduce(_better, found))
    return replace(best, seconds=time.monotonic() - began)


def _better(one, other):
    """The better of two fits; the first where they lead to the same tracks, but for rounding."""
    if one.is_failed != other.is_failed:
        return other if one.is_failed else one
    gain = other.log_likelihood - one.log_likelihood
    return other if gain > SAME * abs(one.log_likelihood) else one


def _longer(groups):
    """How many times longer intervals are than usual ones: where rows come in groups, 1 else."""
    steps = [np.diff(chains.times, axis=0) for chains in groups]
    steps = np.concatenate([own[np.isfinite(own)] for own in steps])
    return max(float(steps.mean() / np.median(steps)), 1.0) if len(steps) else 1.0


class _Patience:
    """Asked at every step, whether a fit has gone on for long enough.

    A step that only a share of the intervals takes counts as that share: else the fastest
    interval of many scenes would use up the patience for all of them.
    """

    def __init__(self, began, deadline, effort):
        self.end = math.inf if deadline is None else began + deadline
        self.left = math.inf if effort is None else effort
        self.spent, self.most = 0.0, math.inf

    def __call__(self, share=1.0):
        self.left -= share
        self.spent += share
        return self.left < 0 or self.spent > self.most or time.monotonic() > self.end

    @contextmanager
    def within(self, effort):
        """Be over after so much effort, until what is done with it has come back."""
        self.most = self.spent + effort
        try:
            yield
        finally:
            self.most = math.inf

    def spare(self, least):
        """Leave so much at least, but of time."""
        self.left, self.most = max(self.left, least), max(self.most, self.spent + least)


class _Run:
    """One call of `fit`."""

    def __init__(self, hypothesis, dataset, starts, bounds, most_starts):
        self.hypothesis, self.dataset, self.most_starts = hypothesis, dataset, most_starts
        self.law = hypothesis.law
        self.parameters = tuple((p.name, p.entity) for p in hypothesis.parameters)
        self.low = np.array([p.low for p in hypothesis.parameters], dtype=float)
        self.high = np.array([p.high for p in hypothesis.parameters], dtype=float)
        self.starts = self._starts(hypothesis, starts)
        self._bound(bounds)
        # Means and widths of normal priors, and the widths of all; inf where there is none.
        self.pull = np.array([p.pull for p in hypothesis.parameters]).reshape(-1, 2).T
        self.width = np.array([
            p.width(self.starts.get((p.name, p.entity), 0.0)) for p in hypothesis.parameters
        ])  # fmt: skip
        groups = build_chains(
            self.law, dataset.scenes, dataset.up, dataset.velocity, may_lead=True
        )
        self.groups = hypothesis.followed(tuple(groups))
        self.channels = Channels.of(self.groups)
        self.roles = roles_of(self.law)
        self.is_over = _Patience(0.0, None, None)
        # Of descents of which a few tracks stayed behind: what is left of the others, these, and
        # where it ended.
        self.lost = []
        self.near = self.path = None
        model = hypothesis.noise
        if not np.isfinite(model.levels).any():
            raise DataError("nothing moves: no dynamic entity changes its position on any axis")

    def _starts(self, hypothesis, starts):
        """Where parameters begin, (name, entity) -> float, as far as it is known."""
        names = {p.name for p in hypothesis.parameters}
        _check_names("start", {k[0] if isinstance(k, tuple) else k for k in starts}, names)
        given = {}
        for parameter, pair in zip(hypothesis.parameters, self.parameters, strict=True):
            known = self.law.constants.get(parameter.name, np.nan)
            known = np.nan if hasattr(known, "items") else known
            tried = (starts.get(pair), starts.get(parameter.name), parameter.start, known)
            value = next((v for v in tried if v is not None and np.isfinite(v)), None)
            if value is not None:
                given[pair] = float(value)
        return given

    def _bound(self, bounds):
        _check_names("bound", bounds, {name for name, _ in self.parameters})
        for name, (low, high) in bounds.items():
            if not low <= high:
                raise SettingsError(f"bounds of {name} must be LOW..HIGH, got {low:g}..{high:g}")
            mine = np.array([n == name for n, _ in self.parameters])
            self.low, self.high = np.where(mine, low, self.low), np.where(mine, high, self.high)
        for (name, _), value in self.starts.items():
            low, high = bounds.get(name, (-np.inf, np.inf))
            if not low <= value <= high:
                raise SettingsError(
                    f"the start of {name} must lie within its bounds {low:g}..{high:g}, "
                    f"got {value:g}"
                )

    def step_kinds(self):
        """Whether the paper's steps, continuous motion, or both are tried, and in which order.

        On even rows both may reproduce exact data, with other constants: motion is continuous
        then, unless bodies have a size, as in the paper's scenes.
        """
        said = self.hypothesis.paper_steps
        if said is not None:
            return (said,)
        if not self.is_exact or is_held(self.law):
            return (False,)
        has_sizes = any(np.any(chains.code != POINT) for chains in self.groups)
        return (True, False) if has_sizes else (False, True)

    def lead(self, found):
        """Let bodies that are led by others be so by the tracks of a fit; whether that changes."""
        groups = led_by(self.groups, found)
        if groups is not None:
            self.groups = groups
            for name in ("motions", "probed_motions"):  # of the chains as they were
                self.__dict__.pop(name, None)
        return groups is not None

    def led_further(self, found):
        """The fit with bodies that are led by the tracks that it gives the others."""
        for _ in range(LED_PASSES):
            if found.is_failed or self.is_over() or not self.lead(found):
                break
            self.near, self.path = found, None
            self.starts = found.starts
            new = self.fit(found.paper_steps)
            if new.is_failed:
                if new.lost and new.message != "stopped":  # what there is of it leads no further
                    found = replace(found, lost=new.lost, chi2_others=new.chi2_others)
                break
            found = new
        return found

    def is_reproduced(self, found):
        """Whether nothing is left of exact data but rounding, below which no fit can get."""
        return self.is_exact and found.chisqr <= found.n_rows - found.n_free

    @property
    def extent(self):
        return max(float(spread(g.observed).max()) for g in self.groups)

    @property
    def is_exact(self):
        model = self.hypothesis.noise
        levels = np.array(model.levels)
        if not np.nanmax(levels) <= EXACT * self.extent:
            return False
        # What was declared is believed as far as numbers carry it.
        return bool(model.is_free.any() or np.nanmax(levels) <= 10 * np.nanmax(model.floors))

    # --- one way of stepping ---------------------------------------------------------------------

    def fit(self, paper_steps):
        """The fit with one kind of steps."""
        self.lost = []
        model = self.hypothesis.noise
        climb, minimum = self.descend(model, paper_steps)
        if self.is_exact and minimum.linearised is not None:
            model = self.resolved(model, minimum)
            meshes = climb.problem.meshes
            climb = climb.with_noises(self.noises(model))
            minimum = climb.again(minimum, meshes)
        elif self.is_noise_estimated and minimum.linearised is not None:
            new = self.noise_beside(climb, minimum, paper_steps)
            for number in range(NOISE_PASSES):
                is_settled, known, model = _same_noise(new, model), model, new
                before = climb, minimum
                climb, minimum = weighed(self, climb, minimum, model)
                if number and minimum.code == "stopped" and before[1].status != "unconverged":
                    (climb, minimum), model = before, known  # a minimum, and noise near enough
                    self.is_over.spare(FINISHING)
                    break
                if self.is_memory_in_the_way(before[1], minimum, model):
                    model = replace(model, correlated=0.0, correlation_time=0.0)
                    climb, minimum = weighed(self, *before, model)
                    break
                # What is left of a misfit is no noise: its level is that of the pure error.
                is_over = is_settled or minimum.linearised is None or self.is_over()
                if is_over or self.has_misfit(minimum):
                    break
                new = self.estimated(climb, minimum, model, adopt=False)
        return self.result(climb, minimum, model, paper_steps)

    def is_memory_in_the_way(self, before, minimum, model):
        """Whether no minimum was found only since noise was given a memory.

        Beside a law that is far off it is what the law lacks that has one: the steps that such
        noise allows are then many, and lead to no end.
        """
        may_be = model.correlated and not model.is_correlation_known and not self.is_over()
        return may_be and minimum.status == "unconverged" and before.status == "converged"

    @property
    def dof(self):
        """Rows beyond those that the parameters use up, one at least."""
        return max(int(self.channels.seen.sum()) - len(self.parameters), 1)

    def resolved(self, model, minimum):
        """The noise of exact data: rounding, or what a law leaves that misses them by little more.

        What is left beyond that is no noise, and refutes the law.
        """
        levels = np.array(model.levels) * max(np.sqrt(minimum.chisqr / self.dof), 1.0)
        if not np.nanmax(levels) <= RESOLUTION * self.extent:
            return model
        return replace(model, levels=tuple(map(float, levels)))

    def descend(self, model, paper_steps):
        """A climb under a noise, and the minimum that it leads to.

        Rows that tails will weigh are left out of it.
        """
        led = self.led
        noises = led.noises(model)
        climb = Climb(led, noises, scales_of(led.groups, noises), paper_steps)
        minimum = climb.best()
        if led is not self:
            meshes = climb.problem.meshes
            climb = Climb(self, self.noises(model), climb.scales, paper_steps)
            climb.problem = climb.whole(meshes)
        return climb, minimum

    @property
    def led(self):
        """The run on the rows to begin with."""
        model = self.hypothesis.noise
        if not bears_outliers(model, self.is_exact):
            return self
        dataset = to_begin_with(self.dataset, model)
        if dataset is self.dataset:
            return self
        led = _Run(self.hypothesis, dataset, self.starts, {}, self.most_starts)
        led.low, led.high, led.near = self.low, self.high, self.near
        led.path = self.path
        led.is_over, led.lost = self.is_over, self.lost
        if self.near is not None:
            led.lead(self.near)
        return led

    def has_misfit(self, minimum):
        """Whether more is left than the noise that was assumed."""
        return minimum.chisqr > MISFIT * self.dof

    def noise_beside(self, climb, minimum, paper_steps):
        """The noise, told from what the law lacks by forces that know no physics."""
        model = self.hypothesis.noise
        if self.hypothesis.has_given_noise:
            return self.estimated(climb, minimum, model, adopt=False)
        if climb.is_lost(minimum):  # what it leaves is neither noise nor what the law lacks
            return model
        if self.has_misfit(minimum) and self.probed_motions and not paper_steps:
            tracks = self.tracks_beside(climb, minimum, model)
            if tracks is not None:
                n_own = len(self.parameters)
                # What a force does may differ from scene to scene, and is no noise either.
                return estimate_beside(
                    model, tracks.channels, tracks.residual, tracks.shared[:n_own],
                    tracks.local, tracks.shared[n_own:],
                )  # fmt: skip
        return self.estimated(climb, minimum, model)

    def tracks_beside(self, climb, minimum, model):
        """Tracks of the law and its probes, of strengths that lead to the data; None if none do.

        A descent with so many forces has no end where they tell little apart; from nodes that lie
        at the data, two steps of the linearisation lead as far.
        """
        parts = (Forces(self.probed_law, False), TrackNoise(model))
        beside = _Run(Hypothesis(parts), self.dataset, self.starts, {}, self.most_starts)
        beside.is_over, beside.groups = self.is_over, self.groups
        wider = Climb(beside, self.noises(model), climb.scales, False)
        nodes = self.near.nodes if self.near is not None and self.near.shows_tracks else None
        found = wider.stepped(climb.coordinates.constants(minimum.values)[0], nodes)
        if found is None or found.chisqr >= minimum.chisqr:
            return None
        return _tracks_of(beside, wider, found)

    def estimated(self, climb, minimum, model, adopt=True):
        """The noise of the residual, what probes could explain of it taken out.

        Nothing is taken out where all that the law leaves is said to be noise and may be. With
        `adopt` further parts than those of the model are asked for.
        """
        tracks = _tracks_of(self, climb, minimum)
        local = tracks.local
        known = model, tracks.channels, tracks.residual, tracks.shared
        if not self.probed_motions:
            return estimate(*known, local, adopt=adopt)
        columns = climb.probe_columns(minimum, self.probed_motions, len(local))
        probes = np.nan_to_num(join(columns))[len(local) :]
        if self.hypothesis.leaves_noise:
            alone = estimate(*known, local, adopt=adopt)
            if not needs(alone, *known[1:], local, probes):
                return alone  # noise of that kind looks no larger where probes are taken out
        if adopt:
            return estimate_beside(*known, local, probes)
        return estimate(*known, np.concatenate([local, probes]), adopt=False)

    @cached_property
    def motions(self):
        return tuple(Motion(self.law, chains, self.parameters) for chains in self.groups)

    @cached_property
    def probed_law(self):
        """The law with probes beside it, of unknown strength."""
        law = self.law
        is_moving = np.isfinite(self.hypothesis.noise.levels)
        for term in probe_terms(self.groups, is_moving, bool(constraints_of(law))):
            law = law.plus(term, {term.formula.constants[0]: np.nan})
        return law

    @cached_property
    def probed_motions(self):
        """The law and its probes on every group; none where the tracks bear no probes."""
        more = [(name, "") for name in self.probed_law.names if name not in self.law.names]
        if not more:
            return ()
        parameters = (*self.parameters, *more)
        return tuple(Motion(self.probed_law, chains, parameters) for chains in self.groups)

    def left_at(self, climb, minimum):
        """What every row is at a minimum, and observed less predicted, (T, C)."""
        return self.channels_at(minimum), join(_left_at(climb, minimum))

    def channels_at(self, minimum):
        """The channels with the speeds of a minimum."""
        speeds = join(np.moveaxis(own[1], (-2, -1), (0, 1)) for own in minimum.point.nodes)
        return replace(self.channels, speed=np.abs(speeds))

    @property
    def is_noise_estimated(self):
        return bool(self.hypothesis.noise.is_free.any())

    def noises(self, model, channels=None, weights=1.0):
        """The rows' noise under a model, per group; white variances are divided by weights."""
        channels = channels or self.channels
        white, amplitude = model.parts(channels)
        return chain_noises(self.groups, white / weights, amplitude, model)

    def result(self, climb, minimum, model, paper_steps):
        """Everything that is said of a minimum."""
        chi2_others, lost = math.nan, ()
        if self.lost and minimum.linearised is None:
            chi2_others, lost, left = min(self.lost, key=itemgetter(0))
            minimum = replace(minimum, point=left.point, values=left.values)
        tracks = _tracks_of(self, climb, minimum)
        constants, _ = climb.coordinates.constants(minimum.values)
        law = self.law.with_values(self.parameters, constants) if self.parameters else self.law
        n_states = sum(g.n_chains * 2 * g.n_moving * g.n_dims for g in self.groups)
        n_rows = int(np.isfinite(tracks.white_variance).sum())
        n_free = len(self.parameters) + n_states - climb.n_undetermined(minimum)
        row_scenes = _row_scenes(climb, minimum)
        rows = np.zeros(0) if minimum.linearised is None else minimum.linearised.residual
        rows, pulled = rows[: len(row_scenes)], rows[len(row_scenes) :]  # priors stand last
        chisqr = minimum.chisqr - float(pulled @ pulled)
        missed, n_known = known_of(climb, minimum)
        n_rows += n_known
        likelihood = log_likelihood(model, tracks.channels, tracks.residual) - 0.5 * missed
        known = informed(self, climb, minimum, model)
        jacobian = _told_of_constants(self, climb, known)[: len(row_scenes)]
        at_bound = (constants <= self.low) | (constants >= self.high)
        widths = [
            p.width(value) for p, value in zip(self.hypothesis.parameters, constants, strict=True)
        ]
        information = jacobian.T @ jacobian + np.diag(np.square(1.0 / np.array(widths)))
        covariance = _covariance(information, at_bound)
        found = Fit(
            law=law, parameters=self.parameters, values=constants, covariance=covariance,
            noise=model, status="converged", chisqr=float(chisqr),
            chi2_red=float(chisqr / max(n_rows - n_free, 1)), n_rows=n_rows, n_free=n_free,
            n_starts=minimum.n_starts, n_agree=minimum.n_agree, gradient=minimum.gradient,
            log_likelihood=float(likelihood),
            log_evidence=float(likelihood + climb.log_volume(known)),
            state_volume=climb.state_volume(known),
            groups=self.groups, nodes=minimum.point.nodes, channels=tracks.channels,
            residual=tracks.residual, whitened=tracks.whitened, jacobian=jacobian,
            rows=rows, row_scenes=row_scenes,
            local_columns=tracks.local, shared_columns=tracks.shared, paper_steps=paper_steps,
            message="stopped" if minimum.linearised is None and self.is_over() else minimum.code,
            lost=lost, chi2_others=chi2_others,
        )  # fmt: skip
        return replace(found, status=self.status(climb, minimum, found))

    def status(self, climb, minimum, found):
        """The first of `STATUSES` that applies."""
        finite = np.isfinite(found.log_likelihood) and np.isfinite(found.values).all()
        if minimum.linearised is None or not finite:
            is_left = found.message in ("stopped", "stalled", "limit", "held")
            return "unconverged" if is_left and finite else "nonfinite"
        is_minimum = minimum.status != "unconverged" or self.is_reproduced(found)
        if not is_minimum or not climb.is_joined(minimum):
            return "unconverged"
        if climb.is_aliased(minimum):
            return "aliased"
        if minimum.status == "at_bound":
            return "at_bound"
        if self.is_exact or not self.is_noise_estimated:
            dof = max(found.n_rows - found.n_free, 1)
            if found.chisqr > dof + REFUTED * np.sqrt(2 * dof):
                return "refuted"
        return "converged"


def known_of(climb, minimum):
    """Sum of squares of what tracks miss of known first states, and how many those are."""
    found = [
        shooting.misfit_of_known(nodes)
        for shooting, nodes in zip(climb.problem.shootings, minimum.point.nodes, strict=True)
    ]
    return tuple(map(sum, zip(*found, strict=True)))


@dataclass(frozen=True, eq=False)
class _Tracks:
    """A minimum seen row by row."""

    channels: Channels
    residual: np.ndarray
    whitened: np.ndarray
    local: np.ndarray
    shared: np.ndarray
    white_variance: np.ndarray


def _left_at(climb, minimum):
    """Observed less what is seen of the nodes of a minimum, (T, S, R, d) per group."""
    constants, _ = climb.coordinates.constants(minimum.values)
    for shooting, nodes in zip(climb.problem.shootings, minimum.point.nodes, strict=True):
        shooting.flow.motion.set_constants(constants)
        yield shooting.chains.observed - sight(shooting.flow, nodes).places


def _tracks_of(run, climb, minimum):
    residuals, whitened, locals_, shareds, variances = [], [], [], [], []
    n_most = max(s.flow.n_state for s in climb.problem.shootings)
    for shooting, noise, left, parts in zip(
        climb.problem.shootings, climb.noises, _left_at(climb, minimum),
        minimum.linearised.condensed if minimum.linearised else [()] * len(run.groups),
        strict=True,
    ):  # fmt: skip
        chains = shooting.chains
        left = np.where(np.isfinite(noise.variance), left, np.nan)
        residuals.append(left)
        rows = np.broadcast_to(np.arange(len(left))[:, None], left.shape[:2])
        whitened.append(noise.whiten(left[None], rows, np.arange(chains.n_chains))[0])
        own, shared = shooting.columns(parts, n_most)
        locals_.append(own)
        shareds.append(shared)
        variances.append(noise.variance)
    return _Tracks(
        run.channels_at(minimum), join(residuals), join(whitened),
        np.nan_to_num(join(locals_)), np.nan_to_num(join(shareds)), join(variances),
    )  # fmt: skip


def _row_scenes(climb, minimum):
    """Names of the scenes of the compressed rows."""
    names = [np.zeros(0, dtype=str)]
    if minimum.linearised is not None:
        for shooting, parts in zip(
            climb.problem.shootings, minimum.linearised.condensed, strict=True
        ):
            scenes, n = np.array(shooting.chains.scenes), shooting.flow.n_state
            for group, part in zip(shooting.groups, parts, strict=True):
                count = part.factor.shape[1] - n
                names.append(np.repeat(scenes[shooting.windows.chain[group]], count))
    return np.concatenate(names)


def _told_of_constants(run, climb, minimum):
    """Whitened changes of the tracks by the constants of the law, initial states eliminated."""
    if minimum.linearised is None:
        return np.zeros((0, len(run.parameters)))
    _, slopes = climb.coordinates.constants(minimum.values)
    return -minimum.linearised.jacobian @ _inverse(slopes)


def _inverse(slopes):
    """Inverse of the slopes of the constants; nan where a power has left the range of numbers."""
    try:
        return np.linalg.inv(slopes)
    except np.linalg.LinAlgError:
        return np.full(slopes.shape, np.nan)


def covariance_of(information):
    """Inverse of a Fisher information; infinite for parameters that it does not determine."""
    n = len(information)
    if not n:
        return np.zeros((0, 0))
    if not np.isfinite(information).all():
        return np.diag(np.full(n, np.inf))
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    lost = values <= 1e-13 * values[-1]
    inverse = np.where(lost, 0.0, 1.0 / np.where(lost, 1.0, values))
    covariance = (vectors * inverse) @ vectors.T / np.outer(size, size)
    free = (np.abs(vectors[:, lost]) > 0.05).any(axis=1) | (np.diag(information) <= 0)
    covariance[free, free] = np.inf
    return covariance


def _covariance(information, is_held):
    """Covariance of constants of which some stand at a bound: the others' with those held there."""
    covariance = np.zeros_like(information)
    free = np.flatnonzero(~is_held)
    covariance[np.ix_(free, free)] = covariance_of(information[np.ix_(free, free)])
    for k in np.flatnonzero(is_held):
        covariance[k, k] = 1.0 / information[k, k] if information[k, k] > 0 else np.inf
    return covariance


def _same_noise(new, old):
    """Whether a noise is as before, to a part in a thousand of its levels."""
    if (new.correlated > 0) != (old.correlated > 0) or len(new.findings) != len(old.findings):
        return False
    a, b = np.array(new.levels), np.array(old.levels)
    both = np.isfinite(a) & np.isfinite(b)
    return bool(np.all(np.abs(a - b)[both] <= 1e-3 * b[both]))


def _check_names(what, given, names):
    unknown = sorted(set(given) - names)
    if unknown:
        raise SettingsError(
            f"{what} of {', '.join(unknown)}: the law has no such constant; it has "
            f"{', '.join(sorted(names)) or 'none'}"
        )
