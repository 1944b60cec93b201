"""How a law is compared with the data when properties are unknown: a choice of likelihood."""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.inference.horizon import HorizonMisfit
from bsp_gp.inference.misfit import MotionBank, misfit_of
from bsp_gp.inference.profile import fit_profile
from bsp_gp.inference.propagation import PropagatedBank
from bsp_gp.inference.tracks import track_misfit
from bsp_gp.physics.likelihood import build_regression

KINDS = ("one_step", "gls", "propagated", "track", "ahead")
REFERENCES = 2
"""Times that the propagated covariance is found anew at the optimum under the last one."""
UNSURE = 4.0
"""Rows whose contact flag lies within so many sigma of flipping are left out of noisy data."""


@dataclass(frozen=True)
class Likelihood:
    """Settings of a likelihood.

    Attributes
    ----------
    kind : str
        "one_step": the paper's one symplectic Euler step, independent Gaussian errors; exact for
        errors that enter the motion, and for exact data. "gls": the same second differences with
        the covariance that position noise gives to them. "propagated": that, and what the noise
        of the states does to the forces (`bsp_gp.inference.propagation`), about the joint
        optimum. "track": whole tracks with their initial states free, linearised about the joint
        optimum (`bsp_gp.inference.tracks`), however coarse the rows are. "ahead": the paper's
        code, `n_ahead` steps from every instant (`bsp_gp.inference.horizon`).
    sigma : float
        Standard deviation of a position, metres; for "ahead" the protocol's noise level.
    n_ahead : int
    velocities : str
        "backward" differences (motion made in Euler steps, contacts) or "central" ones (smooth
        motion), at which laws are evaluated. With "gls", a smooth motion's second differences
        are compared with accelerations averaged over three rows (Numerov's rule), so that the
        time step may be as coarse as the motion allows.
    drops_unsure : bool
        Whether rows are left out whose contact flag lies within 4 sigma of flipping; for data
        with noise.
    up : str, optional
        Declared vertical axis.
    sources : bool
        Whether laws may name other bodies.
    is_estimated : bool
        Whether `sigma` was estimated from the tracks alone; "track" estimates it anew under the
        law.
    is_quoted : bool
        Whether "track" takes the errors that are quoted point by point, where there are any.
    exact : float
        Level of numerical noise, metres, where positions are exact; 0 where they have noise.
        "track" takes what the law leaves for the noise, but no less.
    reads_tracks : bool
        Whether posteriors are read from whole tracks.
    """

    kind: str = "one_step"
    sigma: float = 1.0
    n_ahead: int = 5
    velocities: str = "backward"
    drops_unsure: bool = False
    up: str | None = None
    sources: bool = True
    is_estimated: bool = False
    is_quoted: bool = False
    exact: float = 0.0
    reads_tracks: bool = False

    def __post_init__(self):
        if self.kind not in KINDS:
            raise SettingsError(f"likelihood must be one of {', '.join(KINDS)}, got {self.kind!r}")
        if np.any(np.asarray(self.sigma) <= 0):
            raise SettingsError(f"sigma must be positive, got {self.sigma!r}")
        if self.velocities not in ("backward", "central"):
            raise SettingsError(f"velocities must be backward or central, got {self.velocities!r}")

    @property
    def for_posterior(self):
        """The likelihood of a posterior that is read: noise propagated through the law."""
        if self.reads_tracks:
            return replace(self, kind="track")
        return replace(self, kind="propagated") if self.kind == "gls" else self

    @property
    def for_search(self):
        """The likelihood of the M-step: one step, independent errors, as searches score laws."""
        sigma = np.sqrt(self.sigma / 2) if self.kind == "ahead" else self.sigma
        if self.is_gls:  # a second difference of white noise has the variance 6 sigma^2
            sigma = np.sqrt(6.0) * np.asarray(sigma)
        return replace(self, kind="one_step", sigma=sigma)

    def regression(self, scenes):
        """The regression behind "one_step" and "gls"."""
        unsure = UNSURE * float(np.nanmax(self.sigma)) if self.drops_unsure else None
        states = None
        if self.is_gls and self.velocities == "backward":
            states = {scene.name: _backward(scene) for scene in scenes}
        central = self.velocities == "central"
        method = "gls" if self.is_gls else "central" if central else "one_step"
        return build_regression(
            scenes, method=method, sigma=self.sigma,
            up=self.up, states=states, unsure=unsure, sources=self.sources,
        )  # fmt: skip

    def bank(self, scenes):
        """Motion parts of laws on these scenes, to share between laws; None for "ahead"."""
        if self.kind == "ahead":
            return None
        return MotionBank(self.regression(scenes), is_smooth=self.is_smooth)

    @property
    def is_smooth(self):
        """Whether the motion is taken for smooth between rows (Numerov's rule)."""
        return self.is_gls and self.velocities == "central"

    @property
    def is_gls(self):
        """Whether errors are those of positions."""
        return self.kind in ("gls", "propagated", "track")

    def misfit(self, law, latents, scenes, bank=None, holds_constants=False):
        """The misfit of a law on scenes.

        Parameters
        ----------
        law : ForceLaw
        latents : Latents
        scenes : sequence of Scene
        bank : MotionBank, optional
        holds_constants : bool
            Whether the joint optimum about which tracks are linearised has the law's constants.

        Raises
        ------
        EvaluationError
            If the law has no finite value on the data.
        """
        if self.kind == "ahead":
            return HorizonMisfit(
                law, latents, scenes, n_ahead=self.n_ahead, level=float(self.sigma), up=self.up
            )
        if self.kind == "track":
            return track_misfit(self, law, latents, scenes, holds_constants)
        if self.kind == "propagated" and bank is None:
            bank = self._propagated(law, latents, scenes)
        return misfit_of(law, latents, bank or self.bank(scenes))

    def _propagated(self, law, latents, scenes):
        """Bank whitened about the joint optimum, found with independent errors first."""
        rng = np.random.default_rng(0)  # start places only
        misfit = self.for_search.misfit(law, latents, scenes)
        profile = fit_profile(misfit, latents.sample(8, rng=rng))
        for _ in range(REFERENCES):
            filled = latents.filled(scenes, profile.values)
            backward = self.velocities == "backward"
            settings = {
                "method": "gls", "up": self.up, "sources": self.sources,
                "states": _backward if backward else None,
            }  # fmt: skip
            bank = PropagatedBank(
                self.regression(scenes), filled, profile.law, settings, self.is_smooth
            )
            profile = fit_profile(
                misfit_of(profile.law, latents, bank),
                np.concatenate([profile.values[None], latents.sample(4, rng=rng)]),
            )
        return bank


def _backward(scene):
    """Places and backward velocities of the receivers, as `build_regression` takes states."""
    moving = scene.dynamic
    p = scene.positions[:, moving]
    v = np.full_like(p, np.nan)
    v[1:] = np.diff(p, axis=0) / np.diff(scene.times)[:, None, None]
    return p, v
