"""Scenes that no path under a law follows, among others that it does."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.law_fit import about_lost, followed
from tests.fitted_tracks import body, dataset_of, scene_of

GRAVITY = "1 [m^3/(kg s^2)] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"


def orbits(drag, odd=None, count=8, sigma=0.003):
    """Orbits about a heavy body with linear drag; `odd` comes out of it where no path leads."""
    rng, times = np.random.default_rng(1), np.linspace(0.0, 1.0, 31)

    def rate(t, y):
        return np.concatenate([y[2:], -40 * y[:2] / np.hypot(*y[:2]) ** 3 - drag * y[2:]])

    def path(start):
        return solve_ivp(rate, (0, 1), start, t_eval=times, rtol=1e-10, atol=1e-12).y[:2].T

    scenes = []
    for k in range(count):
        angle, speed = rng.uniform(0, 2 * np.pi), np.sqrt(40 / 3) * rng.uniform(0.7, 1.0)
        x, y = np.cos(angle), np.sin(angle)
        places = path(np.array([3 * x, 3 * y, -speed * y, speed * x]))
        if k == odd:
            fall = path(np.array([2.0, 0.1, -4.0, 0.0]))
            on = np.arange(31)[:, None] - 9
            places = np.where(on < 1, fall, fall[9] + on * np.array([0.15, 0.35]))
        seen = np.stack([places + rng.normal(0, sigma, places.shape), 0 * places], axis=1)
        crew = (body("planet"), body("sun", 40.0, is_static=True))
        scenes.append(scene_of(times, crew, seen, name=f"s{k}"))
    return dataset_of(tuple(scenes), noise=(sigma,))


@pytest.mark.slow
def test_a_scene_that_no_path_follows_is_named():
    dataset = orbits(0.3, odd=5)
    found = fit(Hypothesis.from_laws(dataset, read_law(dataset, [GRAVITY])), dataset)
    assert (found.status, found.lost) == ("unconverged", ("s5",))
    alone = orbits(0.3)
    found = fit(Hypothesis.from_laws(alone, read_law(alone, [GRAVITY])), alone)
    assert (found.status, found.lost) == ("refuted", ())


@pytest.mark.slow
def test_such_a_scene_hides_nothing_of_what_acts_in_the_others():
    def declared(dataset):
        return Hypothesis.from_laws(dataset, read_law(dataset, [GRAVITY, "-c * v_i"]))

    found, lost = followed(declared, orbits(0.3, odd=5))
    assert lost == ("s5",) and found.status == "converged"
    assert abs(found.values[0] - 0.3) < 3 * found.errors[0] < 0.02


def test_such_scenes_are_told():
    assert about_lost(()) == ()
    (one,), (two,) = about_lost(("s5",)), about_lost(("s5", "s6"))
    assert "follows scene s5," in one and "follows scenes s5, s6," in two
