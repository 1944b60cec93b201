"""Tracks of scenes under drawn latents and constants, ready to be integrated."""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.fitting.shooting import Shooting, cut_windows
from bsp_gp.fitting.tracks import ChainNoise
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion

STEP_ERROR = 0.02
"""Error of the integration over a whole track, in standard deviations of a position."""
SETTLINGS = 12
"""Steps of the nodes at new latents and constants, at the most."""
RISE = 1e-2
"""Rise of chi-squared that is rounding and the error of the integration."""


@dataclass(frozen=True, eq=False)
class TrackWorld:
    """What tracks are compared with.

    Attributes
    ----------
    law : ForceLaw
    latents : Latents
    scenes : tuple of Scene
    sigma : ndarray, shape (d,), m
        nan: an axis that carries no information.
    is_estimated : bool
        Whether `sigma` is only where the estimate of the level begins.
    floor : float, m
        No estimated level is below it.
    holds_constants : bool
        Whether the law's constants are not fitted.
    is_quoted : bool
        Whether errors quoted point by point come before `sigma`.
    """

    law: object
    latents: object
    scenes: tuple
    sigma: np.ndarray
    paper_steps: bool = False
    up: str | None = None
    is_estimated: bool = False
    floor: float = 0.0
    holds_constants: bool = False
    is_quoted: bool = False


class Tracks:
    """Tracks of a world under given latents and constants."""

    def __init__(self, world):
        self.world = world
        law = world.law
        self.names = tuple(n for n in law.names if not hasattr(law.constants[n], "items"))
        parameters = tuple((name, "") for name in self.names)
        self.groups = self.chains(world.latents.medians[None])
        self.motions = [Motion(law, chains, parameters) for chains in self.groups]

    @property
    def has_modes(self):
        """Whether the law has conditions that change along a track."""
        return any(motion.has_modes for motion in self.motions)

    def chains(self, values):
        """Chains of all scenes for every draw of the latents, draws outermost."""
        world = self.world
        scenes = []
        for w, draw in enumerate(values):
            filled = world.latents.filled(world.scenes, draw)
            scenes += filled if len(values) == 1 else [
                replace(scene, name=f"{scene.name}#{w}") for scene in filled
            ]  # fmt: skip
        return build_chains(world.law, scenes, world.up, coupled=True)

    def shootings(self, values, constants, rows=None):
        """The tracks under draws (W, k) and (W, n_c), cut to pieces of so many rows."""
        if constants is None:
            constants = [[self.world.law.constants[n] for n in self.names]] * len(values)
        constants = np.asarray(constants, dtype=float).reshape(len(values), -1)
        out = []
        for chains, motion in zip(self.chains(values), self.motions, strict=True):
            noise = self.noise(chains)
            flow = Flow(
                motion.on(chains, self.world.law), _tolerance(chains, noise),
                self.world.paper_steps,
            )  # fmt: skip
            shooting = Shooting(flow, noise, cut_windows(chains.lengths, rows))
            shooting.constants = np.repeat(constants, chains.n_chains // len(values), axis=0).T
            flow.motion.set_constants(shooting.constants)
            out.append(shooting)
        return out

    def noise(self, chains):
        """Errors of the rows: quoted, or the level of their axis."""
        variance = np.broadcast_to(np.square(self.world.sigma), chains.observed.shape)
        if chains.sigma is not None and self.world.is_quoted:
            quoted = np.isfinite(chains.sigma) & np.isfinite(variance)
            variance = np.where(quoted, np.square(chains.sigma), variance)
        return ChainNoise(chains.times, np.where(np.isfinite(chains.observed), variance, np.nan))

    def settled_group(self, shooting, nodes):
        """Nodes after steps of the states alone, and what they leave per chain, (S,)."""
        mesh = shooting.flow.mesh(nodes)
        still = np.zeros(len(shooting.constants))
        best = (np.inf, nodes, np.full(shooting.chains.n_chains, np.inf))
        for _ in range(SETTLINGS):
            *_, condensed = shooting.linearise(shooting.constants, nodes, mesh)
            chisq = squares_of(shooting, condensed)
            total = float(chisq.sum())
            if not np.isfinite(total):
                break
            gained = best[0] - total
            nodes = shooting.move(nodes, condensed, still, 1.0)
            best = (total, nodes, chisq)
            if abs(gained) <= RISE / 10:
                break
        return best[1], best[2]


def squares_of(shooting, condensed):
    """Chi-squared per chain, initial states eliminated."""
    n, out = shooting.flow.n_state, np.zeros(shooting.chains.n_chains)
    for group, part in zip(shooting.groups, condensed, strict=True):
        squares = np.square(part.factor[:, n:, -1]).sum(axis=1)
        np.add.at(out, shooting.windows.chain[group], squares)
    return out


def _tolerance(chains, noise):
    """Error of one interval such that a whole track keeps to its tolerance."""
    with np.errstate(invalid="ignore"):
        sigma = np.sqrt(np.nanmin(noise.variance, axis=(0, 2, 3)))
    floor = 1e-13 * np.nanmax(np.abs(chains.observed))
    return np.maximum(STEP_ERROR * sigma / chains.lengths, floor)
