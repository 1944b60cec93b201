"""What a bad measurement makes of a good motion: data sets that are measured wrongly on purpose."""

from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

SPRING = "c1 * (norm(p_j - p_i) - l_i) * normalize(p_j - p_i)"
"""Of a known rest length: the declared law of `worlds.tied`."""


def changed(dataset, change, scene=None):
    """The data set with every scene (or one, by name) changed by ``change(scene) -> Scene``."""
    return replace(
        dataset,
        scenes=tuple(change(s) if scene in (None, s.name) else s for s in dataset.scenes),
    )


def scaled(scene, factor=1.03):
    """Measured with a length scale that is off."""
    return replace(scene, positions=factor * scene.positions)


def clocked(scene, factor=1.02):
    """Measured with a clock that is off."""
    return replace(scene, times=factor * scene.times)


def drifting(scene, speed=(0.02, -0.01)):
    """The moving bodies drift."""
    positions = np.array(scene.positions)
    positions[:, scene.dynamic] += scene.times[:, None, None] * np.array(speed)
    return replace(scene, positions=positions)


def shifted(scene, offset=(0.03, -0.02)):
    """The bodies that do not move are measured off."""
    positions = np.array(scene.positions)
    fixed = [k for k, e in enumerate(scene.entities) if e.is_static]
    positions[:, fixed] += offset
    return replace(scene, positions=positions)


def late(scene, body=1, delay=0.1):
    """One body is shown late."""
    positions = np.array(scene.positions)
    track = make_interp_spline(scene.times, positions[:, body], k=5)
    positions[:, body] = track(scene.times - delay)
    return replace(scene, positions=positions)


def exposed(scene, every=10):
    """Every frame is the average over the time from half a frame before to half a frame after."""
    n = len(scene.times) // every
    blocks = scene.positions[: n * every].reshape(n, every, *scene.positions.shape[1:])
    times = scene.times[: n * every].reshape(n, every).mean(axis=1)
    return replace(scene, times=times, positions=blocks.mean(axis=1), sigma=None)


def noisy(scene, sigma, seed=0):
    """The moving bodies with white noise."""
    rng = np.random.default_rng([seed, sum(map(ord, scene.name))])
    positions = np.array(scene.positions)
    shape = positions[:, scene.dynamic].shape
    positions[:, scene.dynamic] += sigma * rng.standard_normal(shape)
    return replace(scene, positions=positions)


def swapped(scene, row=20, pair=(1, 2)):
    """Two bodies exchange their labels from a row on."""
    positions = np.array(scene.positions)
    positions[row:, list(pair)] = positions[row:, list(pair)[::-1]]
    return replace(scene, positions=positions)


def frozen(scene, row=28, body=1, sigma=0.01):
    """A track that stands still from a row on."""
    rng = np.random.default_rng(5)
    positions = np.array(scene.positions)
    positions[row:, body] = positions[row, body]
    positions[row:, body] += sigma * rng.standard_normal(positions[row:, body].shape)
    return replace(scene, positions=positions)


def jolted(scene, row=17, shift=(0.05, -0.03)):
    """One frame is shifted as a whole."""
    positions = np.array(scene.positions)
    positions[row] += shift
    return replace(scene, positions=positions)
