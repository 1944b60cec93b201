"""Balls whose bounces no wall foretells: weight shows in the flights between them."""

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.kinked import bounce, bounce_oddly, in_flights
from tests.bouncing import bounces
from tests.planted import SI


def odd(rng, sigma=0.001, dt=1 / 80, n_rows=400):
    """A ball that spins: each bounce turns it aside by chance, and keeps another part of it."""
    places, t = np.empty((n_rows, 2)), 0.0
    p, v = np.array([0.1, 0.7]), np.array([0.0, 0.0])
    for k in range(n_rows):
        while True:
            hit = (v[1] + np.sqrt(v[1] ** 2 + 2 * 9.81 * max(p[1], 0.0))) / 9.81
            if k * dt - t < hit:
                break
            p, t = np.array([p[0] + v[0] * hit, 0.0]), t + hit
            v = np.array(
                [0.3 * rng.standard_normal(), rng.uniform(0.88, 1.0) * (9.81 * hit - v[1])]
            )
        s = k * dt - t
        places[k] = p + v * s - [0.0, 9.81 * s**2 / 2]
    places += sigma * rng.standard_normal(places.shape)
    scene = Scene("film", dt * np.arange(n_rows), places[:, None], (Entity("ball"),))
    return Dataset("odd", (scene,), units=SI)


def test_odd_bounces_are_told_from_regular_ones():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        assert bounce(odd(rng)) and bounce_oddly(odd(rng))
        plain = bounces(rng, n_rows=400, sigma=0.001, kept=0.93, along=0.9)
        assert bounce(plain) and not bounce_oddly(plain)


def test_flights_have_no_bounce_in_them():
    data = odd(np.random.default_rng(1))
    cut = in_flights(data)
    assert len(cut.scenes) > 4 and not bounce(cut)
    assert any("turn back at a wall" in note for note in cut.notes)
    assert sum(len(scene.times) for scene in cut.scenes) > 0.9 * len(data.scenes[0].times)


@pytest.mark.slow
def test_the_weight_of_a_ball_that_bounces_oddly_is_found():
    for seed in range(2):
        law = close_loop(odd(np.random.default_rng(seed)), rng=0, n_bootstrap=0).law
        assert law.text().endswith("* e_y")
        assert list(law.constants.values()) == [pytest.approx(-9.81, rel=0.005)]
