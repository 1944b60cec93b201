"""Scenes as a fitted law with its noise would have made them."""

import math
from dataclasses import replace

import numpy as np

from bsp_gp.fitting.channels import join
from bsp_gp.fitting.held_out import with_states
from bsp_gp.fitting.outliers import without_outliers
from bsp_gp.fitting.parts.latents import filled
from bsp_gp.physics.force import COPY


def simulated(found, dataset, scenes, count, rng):
    """Copies of scenes: the best tracks of a law through them, and noise as it was estimated.

    A list of scenes for every copy; none where the law cannot follow the scenes.
    """
    if not count or not scenes:
        return []
    kept, _ = without_outliers(scenes, found.noise.levels)  # no path leads through what is far off
    best = with_states(found, dataset, kept)
    if best.is_failed:
        return []
    channels, scenes = best.channels, filled(best.law, scenes)
    tracks = join(chains.observed for chains in best.groups) - best.residual
    made = tracks + draw_noise(found.noise, channels, count, rng)
    places = [_places(channels, scene) for scene in scenes]
    copies = []
    for number, values in enumerate(made, 1):
        copy = []
        for scene, (order, shape) in zip(scenes, places, strict=True):
            track = values[: shape[0], order].reshape(shape)
            # Along an axis on which nothing moves everything stays as it was measured.
            track = np.where(np.isfinite(track), track, scene.positions[:, scene.dynamic])
            if scene.first is not None and scene.first.is_placed:
                track[0] = scene.positions[0, scene.dynamic]
            copy.append(replace(scene.on_track(track), name=f"{scene.name}{COPY}{number}"))
        copies.append(copy)
    return copies


def draw_noise(model, channels, count, rng):
    """Errors of a noise model, shape (count, T, C), metres; nan where nothing was seen."""
    white, amplitude = model.parts(channels)
    shape = (count, *white.shape)
    if math.isfinite(model.degrees):
        errors = rng.standard_t(model.degrees, shape)
        errors = np.where(model.is_free[channels.axis], errors, rng.standard_normal(shape))
    else:
        errors = rng.standard_normal(shape)
    if model.adding:
        return _added(errors, channels, model)
    errors *= np.sqrt(white)
    if model.correlated:
        errors += amplitude * _remembered(channels.times, model.correlation_time, rng, shape)
    return errors


def _added(draws, channels, model):
    """Errors (B, T, C) that add up from row to row, none in the first that are seen."""
    whitener = model.whitener(channels)
    is_first = np.cumsum(whitener.seen, axis=0) <= model.adding.order
    errors = whitener.colour(np.where(is_first, 0.0, draws))
    return np.where(whitener.seen, errors, np.nan)


def _remembered(times, memory, rng, shape):
    """An Ornstein-Uhlenbeck process of unit size at some times (T, C)."""
    draws = rng.standard_normal(shape)
    gaps = np.nan_to_num(np.diff(times, axis=0))
    with np.errstate(divide="ignore"):
        kept = np.exp(-np.abs(gaps) / memory) if memory else np.zeros_like(gaps)
    for row, part in enumerate(kept, 1):
        draws[:, row] = part * draws[:, row - 1] + np.sqrt(1.0 - part**2) * draws[:, row]
    return draws


def _places(channels, scene):
    """Which channels a scene's moving bodies have, in the order of its positions; their shape."""
    at = channels.scene_names.index(scene.name)
    mine = np.flatnonzero(channels.scene == at)
    bodies = [channels.body_names.index(scene.names[k]) for k in scene.dynamic]
    rank = {body: k for k, body in enumerate(bodies)}
    order = sorted(mine, key=lambda c: (rank[channels.body[c]], channels.axis[c]))
    return np.array(order), (len(scene.times), len(bodies), scene.n_dims)
