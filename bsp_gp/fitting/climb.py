"""From starts to one minimum: short pieces of the tracks first, then ever longer ones.

From a wrong start a long track shows only that the prediction is out of step: its misfit has a
minimum at every period. Pieces that show the acceleration just above the noise have one minimum,
and each level hands the nodes that it found to the next.
"""

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from bsp_gp.fitting.channels import join
from bsp_gp.fitting.coordinates import Coordinates, powers_of
from bsp_gp.fitting.growing import RANKS, grow, tried
from bsp_gp.fitting.jumps import nodes_between
from bsp_gp.fitting.least_squares import minimise
from bsp_gp.fitting.parts.cut_short import CutShort
from bsp_gp.fitting.problem import Minimum, Settings
from bsp_gp.fitting.regression import regressed
from bsp_gp.fitting.shooting import Shooting, cut_windows, in_groups, most_steps
from bsp_gp.fitting.starts import candidates, first_nodes, stepped_nodes
from bsp_gp.fitting.tracks import FlownProblem, TrackPoint, TrackProblem
from bsp_gp.fitting.unseen import carried
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion, Points
from bsp_gp.physics.engine.walls import walls_of

STEP_ERROR = 0.002
"""Error of the integration over a whole track, in standard deviations of a position."""
GAP = 1e-3
"""How far intervals of a converged fit may fail to join, in the same."""
PRIOR_WIDTH = 10.0
"""Prior standard deviation of a constant, in changes that alter the acceleration by its typical
size."""
GROWTH = 8
"""Times that pieces are longer from level to level."""
GROUPS_GROWTH = 3
"""The same where rows come in groups, between which much may happen."""
MOST_BETWEEN, BETWEEN = 3, 1.3
"""Levels that are put in where one is not reached from the one before, and how much longer their
pieces must be."""
LEAST_ROWS = 3
FEW = Settings(absolute=1e-2, max_linearised=12, last_steps=0)
"""For levels that only lead on."""
PATIENT = Settings(absolute=1e-2, max_linearised=30, last_steps=0)
"""The same across gaps."""
WHOLE = Settings(absolute=1e-6, max_linearised=60, last_steps=4)
VALLEY = 300
"""The same where noise lets it be no nearer to the data: few of them leave a curved valley."""
COARSE = 4
"""Rows of a piece that shows the acceleration, up to which the rows may be coarse."""
TURN = 0.5
"""Change of velocity from row to row, in velocities, from which they are."""
KEPT = 4
"""Starts that go on beyond the first level."""
KEPT_WIDTH = 0.02
"""Extents that constants of a constraint may move while pieces of tracks do not determine them."""
FINISHING = 60
"""Linearisations that a minimum may take to its end whatever was spent on the way to it."""
GROWN_EFFORT, LEAST_GROWN = 1.0, 1000.0
"""Effort for which dense tracks are grown, in that of the ways before; and at the least, where
nobody set it."""
JOININGS, MOST_RISEN = 6, 2
RISING = 10.0
"""Times that nodes are joined and, of these, that a descent may stall higher than the one before;
how much higher at once."""
HOPELESS = 30.0
"""Times that of the fit which is extended, from which a chi-squared leads nowhere."""
GROWN = 4
"""Trials from which whole tracks are grown."""
AGREE = 2
"""Starts that lead to one minimum before it is believed in, where the noise is estimated."""
ALLOWED = 2.0
"""Standard deviations above its mean up to which chi-squared may be that of noise."""
FEW_LOST = 0.2
"""Part of the tracks that may stay behind where all others follow a law."""
ENOUGH = 2
"""Starts that agree, after which no more are asked."""
STEPS = 2
"""Of the linearisation, which lead forces that know no physics to the data."""


class Climb:
    """All descents of one fit with one kind of steps."""

    def __init__(self, run, noises, scales, paper_steps):
        self.run, self.noises, self.scales = run, noises, scales
        self.paper_steps = paper_steps
        self.flows = [
            Flow(
                motion, self.tolerance(motion.chains, noise), paper_steps, is_over=run.is_over
            )
            for motion, noise in zip(run.motions, noises, strict=True)
        ]
        self.coordinates = Coordinates(run.law, run.parameters, self._bases())
        self.problem = None
        self.was_led = False  # whether pieces led to tracks that no other start can do better than

    def tolerance(self, chains, noise):
        """Error of one interval such that a whole track keeps to its tolerance."""
        sigma = self.sigma(noise)
        floor = 1e-13 * np.nanmax(np.abs(chains.observed))
        return np.maximum(STEP_ERROR * sigma / chains.lengths, floor)

    @staticmethod
    def sigma(noise):
        """Least standard deviation of a row of each chain, (S,)."""
        sigma = noise.least
        return np.where(np.isfinite(sigma), sigma, sigma[np.isfinite(sigma)].min())

    def _bases(self):
        """Typical value of the base of every fitted power."""
        bases = {}
        for term in self.run.law.terms:
            for base, _, _ in powers_of(term.formula):
                bases[base] = _median_of(base, term.kind, self.run)
        return bases

    def with_noises(self, noises):
        return Climb(self.run, noises, self.scales, self.paper_steps)

    # --- levels ---------------------------------------------------------------------------------

    def levels(self):
        """Rows of the pieces, level by level; None = whole tracks.

        Of a body without rows a piece of its track tells nothing.
        """
        if self.run.law.unseen:
            return [None]
        rows = max(self.scales.rows, LEAST_ROWS)
        out = []
        while rows < 0.7 * self.longest:
            out.append(rows)
            rows *= GROUPS_GROWTH if self.is_grouped else GROWTH
        return [*out, None]

    def at(self, rows, point, is_checked=False):
        """The problem with pieces of so many rows, its steps chosen at a point."""
        shootings = self._shootings(rows)
        ridge = self.pull if rows is None else self.ridge(point)
        problem = TrackProblem(shootings, (None,) * len(shootings), self.coordinates, ridge)
        return problem.with_meshes(point, is_checked)

    @property
    def pull(self):
        """Means and inverse widths of normal priors; None where there is none."""
        mean, width = self.run.pull
        return None if np.isinf(width).all() else (mean, 1.0 / width)

    def ridge(self, point):
        """Centres and inverse widths of unknowns while pieces of tracks may not determine them."""
        size = self.typical_changes(point, point.nodes)
        roles = [self.run.roles[name] for name, _ in self.run.parameters]
        linear = np.array([role == "linear" for role in roles], dtype=bool)
        known = linear & (size > 0)
        width = PRIOR_WIDTH * np.where(known, size, 1.0)
        has_prior = np.isfinite(self.run.width)
        width = np.where(has_prior, self.run.width, np.where(known, width, np.inf))
        is_kept = np.array([role == "kept" for role in roles], dtype=bool)
        width = np.where(is_kept, KEPT_WIDTH * self.scales.extent, width)
        return np.where(has_prior | is_kept, point.values, 0.0), 1.0 / width

    def _shootings(self, rows):
        return [
            Shooting(flow, noise, cut_windows(flow.chains.lengths, rows, flow.chains.times))
            for flow, noise in zip(self.flows, self.noises, strict=True)
        ]

    def best(self):
        """The best minimum of all starts, with the count of those that agree."""
        end = self._from_near()
        if end is not None:
            return self._finish(replace(end, n_starts=1, n_agree=1))
        points = self.first_points()
        # Where rows are dense and no constant is free, starts cannot differ.
        may_grow = not self.paper_steps and (self.is_coarse or self.run.parameters)
        may_grow = may_grow and not self.run.law.unseen
        ways = [self._climbed, self._grown] if may_grow else [self._climbed]
        if walls_of(self.run.law):
            ways = [self._flown, *ways]
        ends, is_over = [], self.run.is_over
        began = is_over.spent
        for way in ways[:: -1 if self.is_coarse and not self.is_grouped else 1]:
            # Rows from which pieces lead nowhere are hardly followed one by one, if they are dense.
            is_last = way == self._grown and not self.is_coarse
            least = LEAST_GROWN if math.isinf(is_over.left) else 0.0
            most = max(GROWN_EFFORT * (is_over.spent - began), least) if is_last else math.inf
            with is_over.within(most):
                ends += way(points)
            # Flown through contacts no start may come to an end.
            if ends and (self._is_enough(ends) or self.is_behind or self.run.is_over()):
                break
        best = min(ends, key=_height)
        agree = sum(_agree(m, best) for m in ends)
        return self._finish(replace(best, n_starts=len(ends), n_agree=agree))

    def _from_near(self):
        """The minimum that tracks which are known lead to, if they lead to one.

        Those of a path that was given, or of a smaller hypothesis.
        """
        near, run = self.run.near, self.run
        if run.path is not None:
            return self._from(tuple(run.path.nodes(chains.times) for chains in run.groups), {})
        if near is None or not near.shows_tracks or near.paper_steps != self.paper_steps:
            return None
        return self._from(near.nodes, dict(zip(near.parameters, near.values, strict=True)))

    def _from(self, nodes, there):
        """The minimum that nodes lead to, with constants as they are there."""
        run = self.run
        if not self._can_begin_at(nodes):
            return None
        # Of chains that are cut shorter now, rows are left over.
        nodes = tuple(
            np.where(np.isfinite(chains.times), own, np.nan)
            for chains, own in zip(run.groups, nodes, strict=True)
        )
        known = np.array([run.starts.get(pair, there.get(pair, np.nan)) for pair in run.parameters])
        missing = np.flatnonzero(np.isnan(known))
        if any(run.roles[run.parameters[k][0]] != "linear" for k in missing):
            return None
        if len(missing):
            known[missing] = 0.0
            known = regressed(self.flows, nodes, self.noises, known, list(missing))
        point = TrackPoint(self.coordinates.unknowns(known), nodes)
        end = self._whole_from(point)
        is_end = end.linearised is not None and end.status != "unconverged"
        return end if is_end else None

    def _can_begin_at(self, nodes):
        """Whether nodes are of the bodies and rows of this fit, and of no others."""
        shapes = [(2, c.n_moving, c.n_dims, *c.times.shape) for c in self.run.groups]
        return shapes == [own.shape for own in nodes]

    @property
    def is_behind(self):
        """Whether whole tracks were fitted but for a few, for which alone no start is tried."""
        return bool(self.run.lost)

    def _is_enough(self, ends):
        """Whether nothing more is tried: a good minimum, or as many as were asked for."""
        if self._is_good(ends):
            return True
        found = sum(end.linearised is not None for end in ends)
        return found >= self.run.most_starts

    def _is_good(self, ends):
        """Whether starts agree on a minimum that the noise allows; declared noise vouches for one.

        Where the noise is declared, a track as near to the data as the truth is has been found.
        Where that noise allowed the pieces, what whole tracks leave is what the law lacks.
        """
        best = min(ends, key=_height)
        if self.was_led:
            return best.linearised is not None
        if self.run.is_noise_estimated:  # misfit or noise: starts that agree must do
            # Where every constant was told, what neighbouring rows tell of the noise does as well.
            if all(pair in self.run.starts for pair in self.run.parameters):
                if best.linearised is not None and self._is_allowed(best):
                    return True
            return best.linearised is not None and sum(_agree(m, best) for m in ends) >= AGREE
        return self._is_allowed(best) or self._is_lone(ends)

    def _is_lone(self, ends):
        """Whether starts lead nowhere else: what the best leaves is what the law lacks.

        One more than where the noise is estimated: declared noise knows that something is left.
        """
        found = [end for end in ends if end.linearised is not None]
        return len(found) > AGREE and len(_distinct(found)) == 1

    def _is_allowed(self, minimum):
        """Whether no more is left than the noise that is assumed."""
        seen = sum(noise.n_seen for noise in self.noises)
        return minimum.kept_chisqr < seen + ALLOWED * np.sqrt(2 * seen)

    def _is_found(self, ends):
        """Whether nothing better than the best can be hoped for."""
        return self._is_good(ends) and self._is_allowed(min(ends, key=_height))

    def _flown(self, points):
        """Minima that tracks flown through their contacts lead to."""
        firsts = self._firsts(max(self.scales.rows, LEAST_ROWS), points)
        ends = []
        for minimum in _distinct(firsts)[:KEPT]:
            if minimum.linearised is None:
                continue
            for rows in self.levels()[1:]:
                problem = FlownProblem(
                    self._shootings(rows), (None,) * len(self.flows), self.coordinates, self.pull
                )
                found = self._minimise(problem, problem.flown(minimum.point), FEW)
                if found.linearised is None:
                    break
                minimum = found
            ends.append(self._whole_from(minimum.point))
            if self.run.is_over() or self._is_enough(ends):
                break
        return ends

    def _grown(self, points):
        """Minima that tracks grown from their calmest rows lead to."""
        ends = []
        for _, point, rank in tried(self, points, range(RANKS))[:GROWN]:
            if ends and (self.run.is_over() or self._is_enough(ends)):
                break
            if not self.run.is_noise_estimated:  # with such constants pieces may do as well
                end = self._vouched(self.levels(), point)
                if end is not None:
                    return [end]
            ends.append(self._whole_from(grow(self, point, rank)))
        return ends

    def _climbed(self, points):
        """Minima that ever longer pieces lead to; every start of the first level counts."""
        levels = self.levels()
        firsts, known = [], {}
        if not self.run.is_noise_estimated:
            firsts = self._firsts(levels[0], points[:1])
            if self._is_allowed(firsts[0]):  # it may be all that there is to find
                known[id(firsts[0])] = end = self._up(levels, firsts[0])
                if self._is_good([end]):
                    return [end]
        firsts = self._firsts(levels[0], points[len(firsts) :], firsts)
        ends = []
        best = min(firsts, key=_height)
        agree = sum(_agree(other, best) for other in firsts)
        self.was_led = self._is_allowed(best) and agree >= min(ENOUGH, len(points))
        for minimum in _distinct(firsts)[:KEPT]:
            if ends and (self.run.is_over() or self.is_behind or self._is_found(ends)):
                break
            end = known.get(id(minimum)) or self._up(levels, minimum)
            ends += [end] * sum(_agree(other, minimum) for other in firsts)
            if end.linearised is None and not self.is_behind:  # pieces may tell which stay behind
                problem = TrackProblem(self._shootings(levels[0]), (), self.coordinates)
                self._tell_lost(minimum, problem)
        # Nothing leaves less than pieces do: whole tracks that leave little more need no rival.
        end = min(ends or firsts, key=_height)
        is_near = end.status != "unconverged" and not end.held.any()
        self.was_led |= is_near and end.kept_chisqr < RISING * best.kept_chisqr
        return ends or firsts

    def _vouched(self, levels, point):
        """The minimum that a point leads to if declared noise allows it, level by level."""
        (first,) = self._firsts(levels[0], [point])
        if not self._is_allowed(first):
            return None
        end = self._up(levels, first)
        return end if self._is_good([end]) else None

    def _firsts(self, rows, points, firsts=()):
        """Minima of the first level, the best first; no more starts than it takes to agree."""
        firsts = list(firsts)
        for point in points:
            if firsts and self.run.is_over():
                break
            problem = self.at(rows, point)
            firsts.append(self._minimise(problem, problem.settled(point, 2), FEW))
            firsts.sort(key=_height)
            if sum(_agree(m, firsts[0]) for m in firsts) >= ENOUGH:
                break
        return firsts

    def _up(self, levels, minimum):
        """Go on from the first level to whole tracks.

        Where these lead to no minimum, the pieces before them show best where the bodies were.
        """
        problem, lead = None, minimum
        before, above, n_between = levels[0], list(levels[1:]), 0
        while above:
            if minimum.linearised is None:
                return minimum
            rows = above.pop(0)
            problem, lead = self.at(rows, minimum.point), minimum
            few = PATIENT if self.is_grouped else FEW
            settings = WHOLE if rows is None else few
            minimum = self._minimise(problem, minimum.point, settings)
            between = int(math.sqrt(before * (rows or self.longest)))
            is_lost = minimum.status == "unconverged" and self.is_grouped
            if is_lost and n_between < MOST_BETWEEN and between > BETWEEN * before:
                above, minimum = [between, rows, *above], lead  # with a shorter step between
                n_between += 1
            else:
                before = rows
        if problem is None:  # the first level is the last
            problem = self.at(None, minimum.point)
            minimum = self._minimise(problem, minimum.point, WHOLE)
        end = self._joined(minimum, problem)
        if end.linearised is None:
            return replace(end, point=lead.point, values=lead.values)
        return end

    def _whole_from(self, point):
        """The minimum of whole tracks that a point leads to."""
        problem = self.at(None, point)
        return self._joined(self._minimise(problem, point, WHOLE), problem)

    def _joined(self, minimum, problem):
        """A minimum of whole tracks; one whose intervals do not join is none."""
        self.problem = problem
        if minimum.linearised is None:
            return minimum
        if not minimum.held.any() and self.is_joined(minimum):
            return minimum
        self._tell_lost(minimum, problem)
        return replace(minimum, linearised=None)

    def _tell_lost(self, minimum, problem):
        """Remember the tracks that were held, if those are few."""
        if minimum.code != "held":
            return
        held = problem.split(minimum.held)
        lost = [
            (shooting.chains, noise, s)
            for shooting, noise, own in zip(problem.shootings, self.noises, held, strict=True)
            for s in shooting.chains_of(own)
        ]
        if len(lost) <= FEW_LOST * sum(flow.chains.n_chains for flow in self.flows):
            n_lost = sum(np.isfinite(noise.variance[:, s]).sum() for _, noise, s in lost)
            n_others = sum(noise.n_seen for noise in self.noises) - n_lost
            scenes = {scene.name: scene for scene in self.run.dataset.scenes}
            cut = tuple(
                CutShort.at_turn(chains, s, scenes[chains.scenes[s]]) for chains, _, s in lost
            )
            self.run.lost.append((minimum.kept_chisqr / max(n_others, 1), cut, minimum))

    def again(self, minimum, meshes, is_last=True):
        """Descend from a minimum under this noise, with the steps it was found with.

        Unless it is the last time, those steps are kept.
        """
        self.problem = self.whole(meshes)
        new = self._minimise(self.problem, minimum.point, WHOLE)
        if self.run.is_over() and new.linearised is None:
            return self._stopped(minimum)
        new = replace(new, n_starts=minimum.n_starts, n_agree=minimum.n_agree)
        if new.code == "held":
            return self._joined(new, self.problem)
        if not is_last:
            return new
        if new.linearised is not None and new.status != "unconverged":
            self.run.is_over.spare(FINISHING)
        return self._finish(new)

    def whole(self, meshes):
        """The problem of whole tracks with these steps."""
        return TrackProblem(self._shootings(None), meshes, self.coordinates, self.pull)

    def _finish(self, minimum):
        """Choose the steps anew at a minimum, and descend again where they must be finer."""
        found = None  # the last minimum with steps that were chosen for it, and its problem
        for _ in range(3):
            if self.run.is_over():
                return self._kept(found, minimum)
            point = minimum.point
            if self.problem is not None and walls_of(self.run.law):
                point = self.problem.righted(point)
            finer = self.at(None, point, is_checked=True)
            if self.problem is not None and self.problem.is_as_fine_as(finer):
                break
            self.problem = finer
            new = self._minimise(finer, point, WHOLE)
            if minimum.linearised is None or new.code == "held":  # pieces alone led here
                new = self._joined(new, finer)
            if new.linearised is None:
                if self.run.is_over():
                    return self._kept(found, minimum)
                new = replace(new, point=minimum.point, values=minimum.values)
            minimum = replace(new, n_starts=minimum.n_starts, n_agree=minimum.n_agree)
            if minimum.linearised is None:
                break
            found = minimum, finer
        return minimum

    def _kept(self, found, minimum):
        """What there is when the work is over: the last minimum, if there is one."""
        if found is None or found[0].status == "unconverged":
            return self._stopped(minimum)
        minimum, self.problem = found
        self.run.is_over.spare(FINISHING)  # to look at it
        return minimum

    def _stopped(self, minimum):
        """What was found when the time was over."""
        if self.problem is None:  # whole tracks were not reached
            self.problem = self.at(None, minimum.point)
            minimum = replace(minimum, linearised=None)
        return replace(minimum, status="unconverged", code="stopped")

    def _minimise(self, problem, start, settings):
        """Descend; whole tracks until their nodes join.

        The driver's chi-squared takes gaps between nodes for closed as far as the linearisation
        goes; while they are wide, what it foresees of a small step is less than what it neglects,
        and it stalls. Where it stalls higher and higher, they do not join.
        """
        low, high = self.run.low, self.run.high
        is_whole = settings is WHOLE
        if is_whole:
            settings = replace(WHOLE, hopeless=self.hopeless)
        point = problem.upon(np.clip(start.values, low, high), start.nodes)
        count, n_risen, before = 0, 0, np.inf
        for _ in range(JOININGS):
            found = minimise(
                problem, point, low=low, high=high, settings=settings, is_over=self.run.is_over
            )
            count += found.n_linearised
            is_near = found.linearised is not None and not self.run.has_misfit(found)
            if is_whole and found.code == "limit" and is_near and settings.max_linearised < VALLEY:
                settings, point = replace(settings, max_linearised=VALLEY), found.point
                continue
            is_lost = found.linearised is None or found.code in ("stopped", "limit")
            n_risen += found.code == "stalled" and found.kept_chisqr > before
            is_lost = is_lost or n_risen == MOST_RISEN or found.kept_chisqr > RISING * before
            before = found.kept_chisqr
            if not is_whole or is_lost:
                break
            if found.code != "stalled" and self.is_joined(found, problem):
                break
            point = problem.settled(found.point, 2, found.held)
        return replace(found, n_linearised=count)

    @cached_property
    def hopeless(self):
        """Chi-squared of whole tracks that is far above that of the fit which this one extends."""
        near = self.run.near
        if near is None or not near.shows_tracks or not self._can_begin_at(near.nodes):
            return math.inf
        variance = join(noise.variance for noise in self.noises)
        if near.residual.shape != variance.shape:
            return math.inf
        seen = np.isfinite(variance)
        left = float(np.sum(np.square(near.residual[seen]) / variance[seen]))
        return HOPELESS * left if 0 < left < math.inf else math.inf

    # --- starts ---------------------------------------------------------------------------------

    def first_points(self):
        """Points to begin with: nodes off the data, constants given, regressed or of their size."""
        run, nodes = self.run, self._read_off()
        inner = candidates(
            run.law, run.parameters, self.scales, self._rates(), run.most_starts
        )
        free = [
            k for k, (name, _) in enumerate(run.parameters)
            if run.roles[name] == "linear" and run.parameters[k] not in run.starts
        ]  # fmt: skip
        points = []
        for values in inner:
            constants = [run.starts.get(pair, values.get(pair[0], 0.0)) for pair in run.parameters]
            constants = np.array(constants, dtype=float)
            if free:
                constants = regressed(self.flows, nodes, self.noises, constants, free)
            own = tuple(carried(f, o, constants) for f, o in zip(self.flows, nodes, strict=True))
            points.append(TrackPoint(self.coordinates.unknowns(constants), own))
        if len(inner) == 1 and free:
            points += self._sized(points[0], nodes, free)
        return _unlike(points)[: run.most_starts]

    def _read_off(self):
        nodes = tuple(first_nodes(chains, self.is_coarse) for chains in self.run.groups)
        if self.paper_steps:
            return tuple(map(stepped_nodes, self.run.groups, nodes))
        if walls_of(self.run.law):
            pairs = zip(self.run.groups, nodes, strict=True)
            return tuple(nodes_between(*pair, self._stands) for pair in pairs)
        return nodes

    @property
    def _stands(self):
        """Where walls stand to begin with, by axis and side."""
        starts = {name: at for (name, _), at in self.run.starts.items()}
        walls = [wall for wall in walls_of(self.run.law) if wall.names[0] in starts]
        return {(wall.axis, wall.side): starts[wall.names[0]] for wall in walls}

    @property
    def is_coarse(self):
        """Whether bodies turn from row to row: no noise, but too few rows."""
        turns = self.scales.turn > TURN and not walls_of(self.run.law)
        return self.scales.rows <= COARSE and turns

    @cached_property
    def longest(self):
        """Usual steps that the longest chain lasts."""
        return max(map(most_steps, self.run.groups))

    @cached_property
    def is_grouped(self):
        """Whether rows come in groups, in each of which the force may be seen."""
        return any(
            in_groups(chains.times[:n, s])
            for chains in self.run.groups for s, n in enumerate(chains.lengths.tolist())
        )  # fmt: skip

    def _sized(self, point, nodes, free):
        """Starts with linear constants at zero, or of the size that makes the acceleration seen."""
        size = self.typical_changes(point, nodes)
        out = []
        for scale in (0.0, 1.0, -1.0, 0.1, 10.0, -0.1):
            values = point.values.copy()
            values[free] = scale * size[free]
            out.append(TrackPoint(values, nodes))
        return out

    def typical_changes(self, point, nodes):
        """Change of each unknown that alters the acceleration by its typical size, shape (k,)."""
        k = len(self.run.parameters)
        constants, slopes = self.coordinates.constants(point.values)
        total, count = np.zeros(k), 0
        for flow, own in zip(self.flows, nodes, strict=True):
            flow.motion.set_constants(constants)
            _, by_constant = flow.motion.slopes(flow.at(own, flow.row, flow.chain))
            with np.errstate(all="ignore"):
                by_unknown = by_constant @ slopes
            good = np.isfinite(by_unknown).all(axis=(1, 2))
            total += np.square(by_unknown[good]).sum(axis=(0, 1))
            count += int(good.sum()) * flow.chains.n_moving
        rms = np.sqrt(total / max(count, 1))
        return self.scales.acceleration / np.where(rms > 0, rms, np.inf)

    def _rates(self):
        """Angular frequencies at which the tracks move most, for constants that are rates."""
        if "rate" not in self.run.roles.values():
            return ()
        from bsp_gp.fitting.periodogram import leading_rates

        return leading_rates(self.run.groups, self.noises)

    def stepped(self, constants, nodes=None):
        """Where steps of the linearisation lead, first constants held; None if to nothing finite.

        Parameters
        ----------
        constants : ndarray, shape (j,)
            Of the first parameters; the others begin at zero, and are led to the data.
        nodes : sequence of ndarray, optional
            Near the data; read off these where there are none that fit.
        """
        if nodes is None or not self._can_begin_at(nodes):
            nodes = self._read_off()
        values = np.zeros(len(self.run.parameters))
        values[: len(constants)] = constants
        own = tuple(carried(f, o, values) for f, o in zip(self.flows, nodes, strict=True))
        point = TrackPoint(self.coordinates.unknowns(values), own)
        problem = self.problem = TrackProblem(
            self._shootings(None), (None,) * len(self.flows), self.coordinates, self.ridge(point)
        ).with_meshes(point)
        for _ in range(STEPS):
            linearised = problem.linearise(point)
            if linearised is None or not linearised.is_finite:
                return None
            free = linearised.jacobian[:, len(constants) :]
            step = np.zeros(len(values))
            step[len(constants) :] = np.linalg.lstsq(free, -linearised.residual, rcond=None)[0]
            point = problem.move(point, linearised, point.values + step, 1.0, 1.0)
        linearised = problem.linearise(point)
        if linearised is None or not linearised.is_finite:
            return None
        nothing = np.zeros(len(values), dtype=bool)
        return Minimum(
            point, point.values, linearised, "unconverged", "limit", 1.0, math.inf, nothing, STEPS
        )

    def probe_columns(self, minimum, motions, n_most):
        """Changes of the tracks by terms of strength zero, as columns local to every chain.

        They are of shape (n_most + q, T, S, R, d) for every group.

        Parameters
        ----------
        motions : sequence of Motion
            Of the run's law with the terms behind it.
        n_most : int
            Columns of the initial state, which come first.
        """
        constants, _ = self.coordinates.constants(minimum.values)
        n_more = len(motions[0].parameters) - len(constants)
        values = np.concatenate([constants, np.zeros(n_more)])
        out = []
        for flow, motion, noise, nodes, mesh in zip(
            self.flows, motions, self.noises, minimum.point.nodes, self.problem.meshes,
            strict=True,
        ):  # fmt: skip
            probed = Flow(motion, flow.tolerance, self.paper_steps)
            shooting = Shooting(probed, noise, cut_windows(flow.chains.lengths))
            condensed = shooting.linearise(values, nodes, mesh)[-1]
            own, shared = shooting.columns(condensed, n_most)
            out.append(np.concatenate([own, shared[len(constants) :]]))
        return out

    # --- what a minimum is ----------------------------------------------------------------------

    def is_joined(self, minimum, problem=None):
        """Whether the intervals of whole tracks join end to end, but for those that are held."""
        constants, _ = self.coordinates.constants(minimum.values)
        problem = problem or self.problem
        held = problem.split(minimum.held if len(minimum.held) else False)
        for shooting, mesh, nodes, noise, own in zip(
            problem.shootings, problem.meshes, minimum.point.nodes, self.noises, held, strict=True
        ):
            shooting.flow.motion.set_constants(constants)
            gaps = shooting.gaps(nodes, mesh)
            gaps[..., np.isin(shooting.flow.chain, shooting.chains_of(own))] = 0.0
            sigma = self.sigma(noise)[shooting.flow.chain]
            floor = 1e-10 * np.nanmax(np.abs(shooting.chains.observed))
            allowed = np.maximum(GAP * sigma, floor)
            if not mesh.is_complete or not np.all(np.abs(gaps) <= allowed):
                return False
        return True

    def is_lost(self, minimum):
        """Whether a descent ended where no minimum is, and none of many starts led there again."""
        is_alone = minimum.n_agree < AGREE <= minimum.n_starts
        return minimum.status == "unconverged" and is_alone and not self._is_allowed(minimum)

    def is_aliased(self, minimum):
        """Whether the motion turns back and forth between rows: a frequency beyond Nyquist's."""
        constants, _ = self.coordinates.constants(minimum.values)
        for k, (name, _) in enumerate(self.run.parameters):
            if self.run.roles[name] == "rate" and abs(constants[k]) * self.scales.step > np.pi:
                return True
        for flow, nodes in zip(self.flows, minimum.point.nodes, strict=True):
            flow.motion.set_constants(constants)
            by_state, _ = flow.motion.slopes(flow.at(nodes, flow.row, flow.chain))
            stiffness = -by_state[:, :, : flow.n_state // 2]
            good = np.isfinite(stiffness).all(axis=(1, 2))
            if not good.any():
                continue
            rate = np.sqrt(np.maximum(np.linalg.eigvals(stiffness[good]).real.max(axis=-1), 0.0))
            if np.median(rate * flow.length[good]) > np.pi:
                return True
        return False

    def _narrowings(self, minimum):
        """How many times narrower than their prior the initial states are, (W, n) per group."""
        for shooting, parts in zip(
            self.problem.shootings, minimum.linearised.condensed, strict=True
        ):
            n = shooting.flow.n_state
            for group, part in zip(shooting.groups, parts, strict=True):
                size = np.abs(np.diagonal(part.factor[:, :n, :n], axis1=1, axis2=2))
                prior = shooting.prior[:, shooting.windows.chain[group]].T
                yield size / prior

    def n_undetermined(self, minimum):
        """States and constants that only priors determine."""
        count = int(minimum.undetermined.sum())
        if minimum.linearised is None:
            return count
        for narrowing in self._narrowings(minimum):
            count += int((narrowing < 3).sum())
        return count

    def state_volume(self, minimum):
        """Logarithm of the part of the prior of initial states that the data leave, nats."""
        if minimum.linearised is None:
            return -np.inf
        narrowings = self._narrowings(minimum)
        return -sum(float(np.log(np.maximum(n, 1.0)).sum()) for n in narrowings)

    def log_volume(self, minimum):
        """Logarithm of the part of the prior that the data leave: Occam's factor, nats."""
        total = self.state_volume(minimum)
        if minimum.linearised is None:
            return total
        width = PRIOR_WIDTH * self.typical_changes(
            minimum.point, minimum.point.nodes
        )
        known = width > 0
        width = width[known]
        if len(width):
            jacobian = minimum.linearised.jacobian[:, known] * width
            information = jacobian.T @ jacobian + np.eye(len(width))
            total -= 0.5 * float(np.linalg.slogdet(information)[1])
            total -= 0.5 * float(np.square(minimum.values[known] / width).sum())
        return total


def _median_of(base, kind, run):
    """Median absolute value of a formula over the rows of the data."""
    from bsp_gp.physics.engine.graph import Graph, Tape
    from bsp_gp.physics.engine.lowering import Lowering

    found = []
    for chains in run.groups:
        motion = Motion(run.law, chains, run.parameters)
        flow = Flow(motion, np.ones(chains.n_chains))
        nodes = first_nodes(chains)[..., flow.row, flow.chain]
        for program, static in zip(motion.programs, motion._static, strict=True):
            if program.kind != kind:
                continue
            graph = Graph()
            lowered = Lowering(graph, chains.n_dims, chains.direction).lower(base)
            tape = Tape(graph, [lowered], program.moving)
            driven = flow.driven.at(flow.start, flow.chain)
            points = Points(nodes, flow.start, flow.chain, driven, [])
            prepared = tape.prepare(static, dict.fromkeys(base.constants, np.float64(1.0)))
            inputs = _where_all_holds(motion._inputs(program, 0, points))
            values = tape.run(prepared, inputs)[0]
            found.append(np.abs(np.ravel(values)))
    found = np.concatenate(found) if found else np.ones(1)
    found = found[np.isfinite(found) & (found > 0)]
    return float(np.median(found)) if len(found) else 1.0


def _where_all_holds(inputs):
    """Inputs of a formula where its conditions hold: elsewhere it is mostly nothing."""
    return lambda name, axis: 1.0 if name == "mode" else inputs(name, axis)


def _unlike(points):
    """Points whose constants differ, in their order."""
    seen, out = set(), []
    for point in points:
        key = point.values.tobytes()
        if key not in seen:
            seen.add(key)
            out.append(point)
    return out


def _height(minimum):
    """What minima are compared by: the worse end last, those that are none behind all."""
    is_none = minimum.linearised is None
    return (np.inf, np.inf) if is_none else (int(minimum.held.sum()), minimum.kept_chisqr)


def _agree(minimum, best):
    """Whether two minima are the same, as far as the noise tells."""
    return bool(
        minimum.linearised is not None
        and minimum.held.sum() == best.held.sum()
        and minimum.kept_chisqr - best.kept_chisqr <= 1e-2 + 1e-6 * best.kept_chisqr
    )


def _distinct(minima):
    """Minima that differ, the best first; those that are not finite are left out if any is."""
    finite = [m for m in minima if m.linearised is not None and np.isfinite(m.kept_chisqr)]
    out = []
    for minimum in finite or minima[:1]:
        if not any(_agree(minimum, other) for other in out):
            out.append(minimum)
    return out
