"""A data set made ready for inference: unknowns, likelihood, and scenes with stand-in values."""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.data.noise import FLOOR, estimate_noise, is_declared_noisy
from bsp_gp.data.split import choose_split
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.inference.latents import Latents, declared_latents
from bsp_gp.inference.likelihood import Likelihood

EXACT = 1e-9
"""Noise below this part of the range is numerical: the positions count as exact."""
NOMINAL = 1e-4
"""Part of the range that sets the scale of searches on exact positions, and of samplers along what
these leave free; posteriors that are read have what the law leaves of them for their error."""


@dataclass(frozen=True, eq=False)
class LatentProblem:
    """What inference needs of a data set.

    Attributes
    ----------
    dataset : Dataset
        Unknown properties stand at the median of their priors, so that laws that name them can
        be read; recorded values are not used.
    train, test : tuple of Scene
    latents : Latents
        Of the training scenes.
    """

    dataset: object
    train: tuple
    test: tuple
    latents: Latents
    test_latents: Latents
    likelihood: Likelihood
    notes: tuple[str, ...] = ()


def latent_problem(dataset, *, rng, kind="auto", noise=None, everything=False, test=True):
    """Make a data set ready for inference.

    Parameters
    ----------
    dataset : Dataset
        With latents declared.
    rng : numpy.random.Generator
        For a split that is not declared.
    kind : str
        Of likelihood: "auto" takes "one_step" for exact positions and "gls" for noisy ones.
    noise : float or sequence of float, optional
        Standard deviation of a position, metres, in place of the data's.
    everything : bool
        Use all scenes for training.
    test : bool
        Whether held-out scenes are wanted.

    Raises
    ------
    SettingsError
        If nothing is latent, or a declared prior is none.
    """
    if not dataset.latents:
        raise SettingsError(
            "nothing is declared latent; write [latent.mass] with a prior in dataset.toml, or "
            "give --latent mass --prior mass=uniform:LOW:HIGH"
        )
    split_note = "all scenes are used"
    train = held = dataset.scenes
    if everything:
        held = ()
    else:
        train, held, split_note, _ = choose_split(dataset, rng)
    held = tuple(held) if test else ()
    latents = declared_latents(dataset, train)
    test_latents = declared_latents(dataset, held) if held else Latents()
    likelihood, note = _likelihood(dataset, kind, noise)
    filled = replace(dataset, scenes=stand_ins(dataset.scenes, _all(latents, test_latents)))
    return LatentProblem(
        filled, stand_ins(train, latents), stand_ins(held, test_latents), latents, test_latents,
        likelihood, (split_note, note),
    )  # fmt: skip


def _all(*parts):
    """Latents of both sides, those of the same members once."""
    seen = {}
    for part in parts:
        for item in part.items:
            seen.setdefault((item.column, item.members), item)
    items = list(seen.values())
    return Latents(tuple(replace(item, name=f"{k}") for k, item in enumerate(items)))


def stand_ins(scenes, latents):
    """The scenes with unknown properties at the medians of their priors."""
    return latents.filled(scenes, latents.medians)


def _likelihood(dataset, kind, noise):
    """Likelihood and a sentence on how it came about."""
    spans = [np.nanmax(s.positions) - np.nanmin(s.positions) for s in dataset.scenes]
    extent = float(np.max(spans)) or 1.0
    if noise is None:
        estimate = estimate_noise(dataset)
        sigma = np.array(estimate.sigma, dtype=float)
        source = estimate.source
    else:
        sigma = np.broadcast_to(np.asarray(noise, dtype=float), (dataset.n_dims,))
        sigma, source = np.maximum(sigma, FLOOR * extent), "given"
    if not np.isfinite(sigma).any():
        raise DataError("nothing moves: no dynamic entity changes its position on any axis")
    is_exact = bool(np.nanmax(sigma) <= EXACT * extent)
    touching = any(e.shape != "point" for s in dataset.scenes for e in s.entities)
    chosen = kind if kind != "auto" else "one_step" if is_exact else "gls"
    is_given = is_declared_noisy(dataset) if noise is None else np.max(noise) > 0
    if is_exact and not is_given:
        sigma = np.where(np.isfinite(sigma), NOMINAL * extent, sigma)
        note = f"the positions are exact; single steps are weighed by {NOMINAL * extent:.3g} m"
    else:
        note = f"noise {np.nanmax(sigma):.3g} m ({source})"
    if chosen == "ahead":
        sigma = float(np.nanmax(sigma))
    likelihood = Likelihood(
        chosen, sigma=sigma, velocities="backward" if touching else "central",
        drops_unsure=touching and chosen == "gls", up=dataset.up,
        sources=max(len(s.entities) for s in dataset.scenes) > 1,
        is_estimated=source == "estimated" and not is_exact, is_quoted=source == "quoted",
        exact=FLOOR * extent if is_exact else 0.0,
    )  # fmt: skip
    return likelihood, note
