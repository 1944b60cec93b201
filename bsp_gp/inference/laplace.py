"""Gaussian posteriors about a joint optimum: where ensembles start, and what exact data leave."""

import numpy as np

from bsp_gp.inference.posterior import Posterior

POINT_DRAWS = 1000


def start_places(latents, profile, n_places, rng, constants=0):
    """Laplace draws about the joint optimum, inside the priors' support, in coordinates.

    Returns
    -------
    places : ndarray, shape (n_places, k + constants)
    mean : ndarray
    covariance : ndarray
        Inverse information, the prior's own width included.
    """
    k = len(latents)
    spread = latents.of_priors("spread")
    extra = np.zeros(k + constants)
    extra[:k] = 1 / np.square(spread)
    information = profile.information + np.diag(extra)
    size = np.sqrt(np.diag(information))
    size = np.where(size > 0, size, 1.0)
    covariance = np.linalg.pinv(information / np.outer(size, size), hermitian=True)
    covariance = covariance / np.outer(size, size)
    mean = np.concatenate([latents.to_coordinate(profile.values), profile.constants[:constants]])
    values, vectors = np.linalg.eigh(covariance)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    places = mean + rng.standard_normal((n_places, k + constants)) @ factor.T
    low, high = latents.of_priors("bounds").T
    inside = places[:, :k]
    for _ in range(4):  # reflect at the bounds
        inside = np.where(inside < low, 2 * low - inside, inside)
        inside = np.where(inside > high, 2 * high - inside, inside)
    margin = 1e-9 * np.where(np.isfinite(high - low), high - low, 1.0)
    places[:, :k] = np.clip(inside, low + margin, high - margin)
    return places, mean, covariance


def softened_note(level):
    """What is said of a posterior that was sampled with an error that the data have not."""
    return (
        f"the exact positions leave something free: it was sampled with an error of {level:.2g} m, "
        "and what they determine is known better than its interval says"
    )


def point_posterior(latents, profile, constants, rng):
    """Draws about an optimum that is numerically a point, with its numerical width."""
    k = len(latents)
    places, _, covariance = start_places(latents, profile, POINT_DRAWS, rng, len(constants))
    values = latents.from_coordinate(places[:, :k])
    widths = np.sqrt(np.diag(covariance))
    names = (*latents.names, *constants)
    gaps = places - places.mean(axis=0)
    log_prob = -0.5 * np.einsum("wi,ij,wj->w", gaps, np.linalg.pinv(covariance), gaps)
    size = np.abs(np.concatenate([profile.values, profile.constants[: len(constants)]]))
    relative = float(np.max(widths / np.where(size > 0, size, 1.0)))
    return Posterior(
        names, np.concatenate([values, places[:, k:]], axis=1),
        np.full(POINT_DRAWS, 1 / POINT_DRAWS), log_prob, "laplace",
        np.full(len(names), float(POINT_DRAWS)), np.full(len(names), np.nan),
        notes=(
            f"numerically a point: relative width {relative:.1g} (Laplace's approximation, "
            "no sampler)",
        ),
    )  # fmt: skip
