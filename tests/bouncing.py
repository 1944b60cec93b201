"""Balls that bounce off a floor, exactly, by the roots of their parabolas."""

import numpy as np

from bsp_gp.data.scene import Dataset, Entity, Scene
from tests.planted import SI

GRAVITY = 9.81
REST = 1e-5
"""Seconds in the air below which a ball is at rest."""


def flights(start, velocity, times, *, floor=0.0, kept=0.8, along=1.0, gravity=GRAVITY):
    """Places (T, d) of a ball under weight along the last axis, at times that rise from 0."""
    p, v, t0 = np.array(start, dtype=float), np.array(velocity, dtype=float), 0.0
    out = np.empty((len(times), len(p)))
    for k, t in enumerate(times):
        while True:
            far, speed = p[-1] - floor, v[-1]
            hit = (speed + np.sqrt(speed**2 + 2 * gravity * max(far, 0.0))) / gravity
            if t - t0 < hit or hit < REST:
                break
            p, t0 = p + v * hit, t0 + hit
            p[-1] = floor
            v[-1] = kept * (gravity * hit - speed)
            v[:-1] *= along
        s = t - t0
        out[k] = p + v * s
        out[k, -1] = max(out[k, -1] - gravity * s**2 / 2, floor)
    return out


def bounces(rng, *, n_scenes=1, n_dims=2, n_rows=150, dt=1 / 60, sigma=0.002, noise=True, **wall):
    """A ball dropped, in a plane with some speed along the floor."""
    times, scenes = dt * np.arange(n_rows), []
    for k in range(n_scenes):
        start = [0.1, rng.uniform(0.9, 1.4)][-n_dims:]
        places = flights(start, [0.4, 0.0][-n_dims:], times, **wall)
        seen = places + sigma * rng.standard_normal(places.shape)
        scenes.append(Scene(str(k), times, seen[:, None], (Entity("ball"),)))
    noise = (sigma,) * n_dims if noise else None
    return Dataset("bounces", tuple(scenes), noise=noise, units=SI)
