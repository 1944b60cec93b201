"""Noise as it is declared: of all bodies, of one axis each, or body by body."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bsp_gp.data.declaration import select_scenes
from bsp_gp.data.scene import CHECK
from bsp_gp.errors import DataError


def noise_of_all(declaration, conversion, n_dims):
    """Noise of all bodies; None where each has its own."""
    if declaration.noise is None or isinstance(declaration.noise, Mapping):
        return None
    return _levels(declaration.noise, "noise", declaration, conversion, n_dims)


def doubts_of_noise(declaration, rows):
    """That declared noise of all bodies has no say where points quote errors of their own."""
    if declaration.noise is None or rows.sigma is None or not np.isfinite(rows.sigma).any():
        return ()
    if isinstance(declaration.noise, Mapping):
        return ()  # fills what is not quoted
    return (
        f"{CHECK}noise is declared and points quote errors of their own (columns sx, sy, sz): the "
        "quoted ones count, on every axis that has any",
    )


def _levels(values, what, declaration, conversion, n_dims):
    if len(values) not in (1, n_dims):
        raise DataError(
            f"{what} must be one number or one per axis ({n_dims}), got {len(values)}",
            file=declaration.file, column="noise",
        )  # fmt: skip
    return tuple(value * conversion.length("x") for value in values)


def with_noise_of_bodies(scenes, declaration, conversion, names):
    """Scenes whose points quote the noise declared for their body, where they quote none."""
    if not isinstance(declaration.noise, Mapping):
        return scenes
    of_bodies = {}
    for pattern, values in declaration.noise.items():
        found = select_scenes((pattern,), names, what="[noise]", file=declaration.file)
        what = f"noise of {pattern}"
        levels = _levels(values, what, declaration, conversion, scenes[0].n_dims)
        for name in found:
            if name == pattern or name not in of_bodies:
                of_bodies[name] = levels
    changed = []
    for scene in scenes:
        sigma = np.full(scene.positions.shape, np.nan) if scene.sigma is None else scene.sigma
        sigma = sigma.copy()
        for k in scene.dynamic:
            if scene.names[k] not in of_bodies:
                raise DataError(
                    f"[noise] has nothing for {scene.names[k]!r}", file=declaration.file,
                    column="noise", remedy='add it, or "*" for all the others',
                )  # fmt: skip
            own = np.where(np.isnan(scene.positions[:, k]), np.nan, of_bodies[scene.names[k]])
            sigma[:, k] = np.where(np.isnan(sigma[:, k]), own, sigma[:, k])
        changed.append(replace(scene, sigma=sigma))
    return tuple(changed)
