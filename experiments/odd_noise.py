"""Errors of a measurement that are not white, on data that lack nothing.

Every kind changes exact scenes and says by how many nats the truth about its errors beats white
noise of the best level. Two kinds are set aside: no number of the package may be chosen by them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

ASIDE = ("multiplicative", "times on a grid")
DEGREES = 3.0
SHARE, FAR = 0.03, 8.0
"""Of outliers, and how much larger they are."""
MEMORY = 0.7
LOST = 0.25
LEVELS = (0.5, 1.8, 0.9, 1.3)
"""Of bodies, by their names."""


@dataclass(frozen=True)
class Noise:
    """One way in which errors may not be white.

    Attributes
    ----------
    draw : callable
        ``draw(scenes, sigma, rng) -> scenes, gain in nats``; scenes with their exact velocities.
    codes : tuple of str
        Findings that name it.
    causes : tuple of str
        Causes, of the measurement, that are right as well.
    """

    draw: Callable
    codes: tuple
    causes: tuple = ()


def _white(errors):
    """Log density of errors under white noise of the best level."""
    every = np.concatenate([e.ravel() for e in errors])
    return float(stats.norm.logpdf(every, scale=np.sqrt(np.square(every).mean())).sum())


def _with(scene, errors, times=None):
    """The scene, without its velocities, with errors on the bodies that move."""
    positions = np.array(scene.positions)
    positions[:, scene.dynamic] += errors
    times = scene.times if times is None else times
    return replace(scene, times=times, positions=positions, velocities=None)


def _moving(scene):
    """Positions and velocities of the bodies that move, (T, n, d)."""
    return scene.positions[:, scene.dynamic], scene.velocities[:, scene.dynamic]


def _independent(of_scene):
    """Errors that are independent; ``of_scene(scene, rng) -> distribution`` of relative size."""

    def draw(scenes, sigma, rng):
        errors, gain = [], 0.0
        for scene in scenes:
            law = of_scene(scene, rng)
            drawn = law.rvs(size=_moving(scene)[0].shape, random_state=rng)
            errors.append(sigma * drawn)
            gain += float((law.logpdf(drawn) - np.log(sigma)).sum())
        return [_with(*both) for both in zip(scenes, errors, strict=True)], gain - _white(errors)

    return draw


def _tails(scene, rng):
    return stats.t(DEGREES, scale=DEGREES**-0.5)


def _by_scene(scene, rng):
    return stats.norm(scale=np.exp(0.7 * rng.standard_normal()))


def _by_body(scene, rng):
    index = [ord(scene.names[k][0]) % len(LEVELS) for k in scene.dynamic]
    return stats.norm(scale=np.array(LEVELS)[index][:, None])


def _by_speed(scene, rng):
    speed = np.linalg.norm(_moving(scene)[1], axis=-1, keepdims=True)
    return stats.norm(scale=0.2 + speed / speed.mean())


def _by_place(scene, rng):
    size = np.linalg.norm(_moving(scene)[0], axis=-1, keepdims=True)
    return stats.norm(scale=0.1 + size / size.mean())


def _outliers(scenes, sigma, rng):
    errors, gain = [], 0.0
    for scene in scenes:
        shape = _moving(scene)[0].shape
        is_far = np.broadcast_to(rng.random(shape[:2])[..., None] < SHARE, shape)
        error = sigma * np.where(is_far, FAR, 1.0) * rng.standard_normal(shape)
        both = [
            stats.norm.logpdf(error, scale=size).sum(axis=-1) + np.log(share)
            for size, share in ((sigma, 1 - SHARE), (FAR * sigma, SHARE))
        ]
        gain += float(np.logaddexp(*both).sum())
        errors.append(error)
    return [_with(*both) for both in zip(scenes, errors, strict=True)], gain - _white(errors)


def _bad_scene(scenes, sigma, rng):
    bad = int(rng.integers(len(scenes)))
    sizes = [4.0 if k == bad else 1.0 for k in range(len(scenes))]
    laws = iter([stats.norm(scale=size) for size in sizes])
    return _independent(lambda scene, rng: next(laws))(scenes, sigma, rng)


def _remembered(scenes, sigma, rng):
    errors, gain = [], 0.0
    for scene in scenes:
        drawn = rng.standard_normal(_moving(scene)[0].shape)
        error, fresh = np.array(drawn), np.sqrt(1 - MEMORY**2)
        for k in range(1, len(error)):
            error[k] = MEMORY * error[k - 1] + fresh * drawn[k]
        # The innovations are independent.
        gain += float(stats.norm.logpdf(drawn).sum())
        gain -= error.size * np.log(sigma) + error[1:].size * np.log(fresh)
        errors.append(sigma * error)
    return [_with(*both) for both in zip(scenes, errors, strict=True)], gain - _white(errors)


def _shaken(scenes, sigma, rng):
    """A camera that shakes by as much as the noise: all bodies of a scene alike."""
    errors, gain = [], 0.0
    for scene in scenes:
        shape = _moving(scene)[0].shape
        error = sigma * (rng.standard_normal(shape) + rng.standard_normal((shape[0], 1, shape[2])))
        # The sum over the bodies holds what they share.
        n = shape[1]
        whole = np.square(error.mean(axis=1)) * n
        rest = np.square(error).sum() - whole.sum()
        gain -= 0.5 * (rest + whole.sum() / (1 + n)) / sigma**2
        gain -= error.size * np.log(sigma * np.sqrt(2 * np.pi)) + 0.5 * whole.size * np.log(1 + n)
        errors.append(error)
    return [_with(*both) for both in zip(scenes, errors, strict=True)], gain - _white(errors)


def _drifting(scenes, sigma, rng):
    """A camera that wanders smoothly, by about the noise: all bodies of a scene alike."""
    errors, gain = [], 0.0
    for scene in scenes:
        shape = _moving(scene)[0].shape
        share = (scene.times - scene.times[0]) / np.ptp(scene.times)
        shared = np.exp(-0.5 * np.square((share[:, None] - share) / 0.08))
        root = np.linalg.cholesky(shared + 1e-9 * np.eye(len(share)))
        path = root @ rng.standard_normal((shape[0], shape[2]))
        error = sigma * (rng.standard_normal(shape) + path[:, None])
        # The sum over the bodies holds the path, what they differ by is white.
        n = shape[1]
        mean = error.mean(axis=1) * np.sqrt(n)
        covariance = sigma**2 * (np.eye(len(share)) + n * shared)
        law = stats.multivariate_normal(cov=covariance, allow_singular=True)
        gain += float(np.sum([law.logpdf(column) for column in mean.T]))
        rest = (np.square(error).sum() - np.square(mean).sum()) / sigma**2
        count = (n - 1) * shape[0] * shape[2]
        gain -= 0.5 * rest + count * np.log(sigma * np.sqrt(2 * np.pi))
        errors.append(error)
    return [_with(*both) for both in zip(scenes, errors, strict=True)], gain - _white(errors)


def _on_grid(scenes, sigma, rng):
    """Rounded to three times the noise: under a continuous law a grid has no probability."""
    step, out = 3 * sigma, []
    for scene in scenes:
        places = _moving(scene)[0]
        seen = places + sigma * rng.standard_normal(places.shape)
        out.append(_with(scene, step * np.round(seen / step) - places))
    return out, np.inf


def _in_time(of_scene):
    """Instants that are not those that are told.

    ``of_scene(scene, unit, rng)`` gives how much later a row was seen, how much later it is said to
    be seen, both (T,), and the spread of what they differ by, s; in `unit` a body moves by sigma.
    """

    def draw(scenes, sigma, rng):
        out, errors, gain = [], [], 0.0
        for scene in scenes:
            _, v = _moving(scene)
            speed = np.sqrt(np.square(v).sum(axis=-1).mean())
            seen, told, spread = of_scene(scene, sigma / speed, rng)
            white = sigma * rng.standard_normal(v.shape)
            out.append(_with(scene, white + v * seen[:, None, None], scene.times + told))
            errors.append(white + v * (seen - told)[:, None, None])
            flat, way = errors[-1].reshape(len(v), -1), v.reshape(len(v), -1)
            # Of a covariance sigma^2 + spread^2 v v', row by row.
            more = np.square(spread / sigma) * np.square(way).sum(axis=1)
            inner = np.square(np.einsum("tk,tk->t", flat, way) * spread / sigma)
            size = np.square(flat).sum(axis=1) - inner / (1 + more)
            gain -= float(0.5 * (size / sigma**2 + np.log1p(more)).sum())
            gain -= flat.size * np.log(sigma * np.sqrt(2 * np.pi))
        return out, gain - _white(errors)

    return draw


def _jittered(scene, unit, rng):
    seen = 2 * unit * rng.standard_normal(len(scene.times))
    return seen, np.zeros_like(seen), 2 * unit


def _rounded(scene, unit, rng):
    step = min(6 * unit, 0.9 * np.diff(scene.times).min())
    told = step * np.round(scene.times / step) - scene.times
    return np.zeros_like(told), told, step / np.sqrt(12)


def _missing(scenes, sigma, rng):
    """White noise; rows that are lost here and there, and one stretch of them."""
    out = []
    for scene in scenes:
        places = _moving(scene)[0]
        positions = np.array(_with(scene, sigma * rng.standard_normal(places.shape)).positions)
        n = len(positions)
        lost = rng.random(n) < LOST
        first = int(rng.integers(n // 3, n // 2))
        lost[first : first + n // 8] = True
        lost[:4] = lost[-4:] = False
        positions = positions[~lost]
        out.append(replace(scene, times=scene.times[~lost], positions=positions, velocities=None))
    return out, 0.0


def _by_part(scenes, sigma, rng):
    """One stretch of every recording is noisier: a passing lorry."""

    def of_scene(scene, rng):
        share = np.linspace(0, 1, len(scene.times))
        is_loud = np.abs(share - rng.uniform(0.2, 0.8)) < 0.1
        return stats.norm(scale=np.where(is_loud, 4.0, 1.0)[:, None, None])

    return _independent(of_scene)(scenes, sigma, rng)


STAMPS = ("time_stamps", "jitter", "level_with_speed")
NOISES = {
    "tails": Noise(_independent(_tails), ("tails", "row"), ("bad_row",)),
    "outliers": Noise(_outliers, ("tails", "row"), ("bad_row",)),
    "level by scene": Noise(_independent(_by_scene), ("level_of_scene",)),
    "level by body": Noise(_independent(_by_body), ("level_of_body",)),
    "one bad scene": Noise(_bad_scene, ("level_of_scene",)),
    "noisy stretch": Noise(_by_part, ("level_with_time", "tails")),
    "growing with speed": Noise(_independent(_by_speed), ("level_with_speed",)),
    "multiplicative": Noise(_independent(_by_place), ("level_with_place", "tails")),
    "on a grid": Noise(_on_grid, ("grid",)),
    "memory": Noise(_remembered, ("autocorrelation",)),
    "time-stamp jitter": Noise(_in_time(_jittered), STAMPS),
    "times on a grid": Noise(_in_time(_rounded), STAMPS),
    "missing rows": Noise(_missing, ()),
    "wandering camera": Noise(_drifting, ("autocorrelation", "common"), ("drift",)),
    "shaking camera": Noise(_shaken, ("common",)),
}
