"""The joint optimum of latents, constants and initial states on whole tracks.

Short pieces of the tracks are fitted first, then ever longer ones (as `bsp_gp.fitting.climb`
does for constants alone): at every level the tracks are linearised (`track_path`), latents and
constants fitted together, and nodes settled under them, until nothing moves. The tracks
linearised at the end are what posteriors are read from.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.starts import first_nodes, scales_of
from bsp_gp.inference.misfit import misfit_of
from bsp_gp.inference.profile import FixedConstants, Profile, fit_profile
from bsp_gp.inference.track_bank import TrackBank
from bsp_gp.inference.track_path import curve_paths, paths_of
from bsp_gp.inference.track_world import RISE, Tracks, TrackWorld
from bsp_gp.physics.bodies import stack

GROWTH, LEAST_ROWS = 3, 4
"""Times that pieces are longer from level to level, and the shortest ones."""
CURVE_ROWS = 5
"""Rows of the pieces on which curves are compared with accelerations."""
COARSE, TURN = 4, 0.5
"""As in `bsp_gp.fitting.climb`: whether bodies turn from row to row."""
FEW, MOST = 8, 25
"""Linearisations of a level that leads on, and of whole tracks."""
IDLE, LITTLE = 4, 1e-3
"""Steps in a row that gain so little of what they promise, after which a descent is given up."""
SHARES = (1.0, 0.5, 0.2, 0.05)
MOVED = 1e-4
"""Squared length of a step, in standard deviations, below which an optimum has been reached."""
LEVEL_PASSES = 4
"""Times that the noise is estimated anew at the optimum under the last one."""
SAME_LEVEL = 0.01


@dataclass(frozen=True, eq=False)
class Reference:
    """Tracks linearised at their joint optimum.

    Attributes
    ----------
    world : TrackWorld
        With the level of the noise as it was found.
    nodes : tuple of ndarray, shape (2, R, d, T, S)
        Per group of like-built scenes.
    is_settled : bool
        Whether the optimum stays where it is, and tracks join end to end.
    has_modes : bool
        Whether the law has conditions that change along the tracks.
    """

    world: TrackWorld
    profile: Profile
    bank: TrackBank = field(repr=False)
    nodes: tuple = field(repr=False)
    is_settled: bool
    has_modes: bool = False

    def exact_chisq(self, values, constants):
        """Whitened sums of squares of the tracks with nodes settled anew at each draw, (W,).

        Parameters
        ----------
        values : ndarray, shape (W, k)
        constants : ndarray, shape (W, n_c) or None
            None: the law's own.
        """
        tracks = Tracks(self.world)
        out = np.zeros(len(values))
        nodes = [np.tile(own, len(values)) for own in self.nodes]
        shootings = tracks.shootings(values, constants)
        for shooting, own in zip(shootings, nodes, strict=True):
            _, parts = tracks.settled_group(shooting, own)
            out += parts.reshape(len(values), -1).sum(axis=1)
        return out


def find_reference(world, starts, constants=None):
    """The joint optimum on whole tracks.

    Parameters
    ----------
    starts : ndarray, shape (B, k)
        Values of the latents to start from, the likeliest first.
    constants : ndarray, shape (n_c,), optional
        Where constants begin; by default the law's own.

    Raises
    ------
    EvaluationError
        If the law has no finite value along the tracks, or conditions on continuous motion: what
        it does at a contact hangs on when that begins, which a frozen track does not know.
    """
    # As in a fit, numbers that overflow on trial lead to points that are not finite: refused.
    with np.errstate(all="ignore"):
        run = _Climb(world, np.atleast_2d(np.asarray(starts, dtype=float)), constants)
        return run.result()


class _Climb:
    """One search for a joint optimum."""

    def __init__(self, world, starts, constants):
        self.world, self.starts = world, starts
        self.tracks = Tracks(world)
        if self.tracks.has_modes and not world.paper_steps:
            raise EvaluationError("conditions of a law are linearised in the paper's steps only")
        noises = [self.tracks.noise(chains) for chains in self.tracks.groups]
        self.scales = scales_of(self.tracks.groups, noises)
        self.values = starts[0]
        own = [world.law.constants[n] for n in self.tracks.names]
        self.constants = np.array(own if constants is None else constants, dtype=float)
        is_coarse = self.scales.rows <= COARSE and self.scales.turn > TURN
        self.nodes = [first_nodes(chains, is_coarse) for chains in self.tracks.groups]
        if is_coarse and not world.paper_steps:
            self._read_off_curves()

    def _read_off_curves(self):
        """Latents and constants off curves through the rows, where one step is too coarse."""
        rows = max(self.scales.rows, CURVE_ROWS)
        shootings = self.tracks.shootings(self.values[None], self.constants[None], rows)
        _, profile = self._profile(shootings, False, is_curve=True)
        self.values = profile.values
        if len(profile.constants):
            self.constants = profile.constants

    def result(self):
        """Climb to whole tracks, the noise estimated on the way where it is not given."""
        for rows in self._levels():
            self._descend(rows, FEW)
        reference = self._descend(None, MOST)
        for _ in range(LEVEL_PASSES if self.world.is_estimated else 0):
            sigma = self._level(reference)
            both = np.isfinite(sigma)
            same = np.abs(sigma - self.world.sigma)[both] <= SAME_LEVEL * sigma[both]
            if same.all():
                break
            self.world = replace(self.world, sigma=sigma)
            self.tracks.world = self.world
            reference = self._descend(None, MOST)
        return reference

    def _levels(self):
        longest = max(int(chains.lengths.max()) for chains in self.tracks.groups)
        rows = max(self.scales.rows, LEAST_ROWS)
        while rows < 0.7 * longest:
            yield rows
            rows *= GROWTH

    def _descend(self, rows, most):
        """Gauss-Newton steps on pieces of so many rows."""
        shootings, chisq = self._settled(self.values, self.constants, rows, self.nodes)
        self.nodes = self._trial
        is_settled, best, n_idle = False, chisq, 0
        for _ in range(most):
            bank, profile = self._profile(shootings, rows is None)
            if self._size(profile) < MOVED:
                is_settled = True
                break
            if not self._step(profile, chisq, rows):
                break
            promised, (shootings, chisq) = best - profile.chisq, self._last
            n_idle = n_idle + 1 if best - chisq <= max(RISE, LITTLE * promised) else 0
            best = min(best, chisq)
            if n_idle == IDLE:
                break
        if rows is not None:
            return None
        bank, profile = self._profile(shootings, True)
        is_settled = is_settled or self._size(profile) < MOVED
        return Reference(
            self.world, profile, bank, tuple(self.nodes), is_settled, self.tracks.has_modes
        )

    def _settled(self, values, constants, rows, nodes):
        """Tracks at a point with their nodes settled, and what they leave (priors included)."""
        shootings = self.tracks.shootings(values[None], constants[None], rows)
        total, moved = self._pull(values), []
        for shooting, own in zip(shootings, nodes, strict=True):
            own, chisq = self.tracks.settled_group(shooting, own)
            moved.append(own)
            total += float(chisq.sum())
        self._trial = moved
        if not np.isfinite(total) or not all(np.isfinite(own).all() for own in moved):
            total = np.inf
        return shootings, total

    def _step(self, profile, chisq, rows):
        """Go to the optimum of the linearised tracks, or so far towards it as helps."""
        latents = self.world.latents
        here, there = latents.to_coordinate(self.values), latents.to_coordinate(profile.values)
        for share in SHARES if not latents.is_discrete.any() else SHARES[:1]:
            values = profile.values
            if share < 1:
                values = latents.from_coordinate(here + share * (there - here))
            constants = self.constants + share * (profile.constants - self.constants) \
                if len(profile.constants) else self.constants
            tried = self._settled(values, constants, rows, self.nodes)
            if tried[1] <= chisq + RISE:
                self.values, self.constants = values, constants
                self.nodes, self._last = self._trial, tried
                return True
        return False

    def _profile(self, shootings, is_whole, is_curve=False):
        """Tracks linearised where they are, and the optimum that they lead to."""
        world = self.world
        nodes = [np.array(own) for own in self.nodes]
        paths = []
        scenes = world.latents.filled(world.scenes, self.values)
        for shooting, own, batch in zip(shootings, nodes, stack(scenes, world.up), strict=True):
            receivers = batch.bodies.receivers
            if is_curve:
                paths += curve_paths(shooting, own, receivers)
            else:
                paths += paths_of(shooting, own, shooting.flow.mesh(own), receivers)
        law = world.law
        if len(self.constants):
            law = law.with_constants(dict(zip(self.tracks.names, self.constants, strict=True)))
        bank = TrackBank(paths, scenes, law, world.up, world.sigma)
        misfit = misfit_of(law, world.latents, bank)
        if world.holds_constants:
            misfit = FixedConstants(misfit)
        starts = self.values[None]
        if not is_whole or world.latents.is_discrete.any():
            starts = np.concatenate([starts, self.starts])
        profile = fit_profile(misfit, starts)
        if not np.isfinite(profile.loss):
            raise EvaluationError("the law has no finite value along the tracks")
        return bank, profile

    def _size(self, profile):
        """Squared distance to an optimum in its standard deviations."""
        to = self.world.latents.to_coordinate
        change = to(profile.values) - to(self.values)
        if len(profile.constants):
            change = np.concatenate([change, profile.constants - self.constants])
        return float(change @ profile.information @ change)

    def _pull(self, values):
        coordinates = self.world.latents.to_coordinate(values)
        mean, sd = self.world.latents.of_priors("pull").T
        return float(np.square((coordinates - mean) / sd).sum())

    def _level(self, reference):
        """Levels per axis that the optimum leaves, degrees of freedom counted."""
        n_dims = self.world.scenes[0].n_dims
        squares, counts, n_free = np.zeros(n_dims), np.zeros(n_dims), 0
        for path in reference.bank.paths:
            own, seen = path.axis_squares(path.residual, n_dims)
            squares, counts, n_free = squares + own, counts + seen, n_free + path.n
        n_free += int(np.linalg.matrix_rank(reference.profile.jacobian))
        share = max(1 - n_free / counts.sum(), 1 / counts.sum())
        with np.errstate(invalid="ignore", divide="ignore"):
            sigma = self.world.sigma * np.sqrt(squares / (counts * share))
        return np.maximum(sigma, self.world.floor)
