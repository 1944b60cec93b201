"""Tracks that are grown from their calmest rows."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.fitting import growing
from bsp_gp.fitting.climb import Climb
from bsp_gp.fitting.fit import FitTolerances, _Run
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.starts import scales_of
from tests.fitted_tracks import body, dataset_of, scene_of

GRAVITY = "k * m_i / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
SIGMA = 0.001


def orbit(eccentricity=0.85, revolutions=12, n=73, k=1.0):
    """An orbit of axis 1 about a body at rest, seen six times in a turn."""
    times = np.linspace(0.0, revolutions * 2 * np.pi, n)
    farthest = 1 + eccentricity
    start = [farthest, 0.0, 0.0, np.sqrt(k * (2 / farthest - 1))]

    def slope(t, y):
        return [y[2], y[3], *(-k * y[:2] / np.hypot(*y[:2]) ** 3)]

    found = solve_ivp(slope, (0, times[-1]), start, t_eval=times, rtol=1e-11, atol=1e-12)
    places = np.zeros((n, 2, 2))
    noise = np.random.default_rng(4).standard_normal((n, 2))
    places[:, 0] = found.y[:2].T + SIGMA * noise
    sun = body("sun", is_static=True)
    return dataset_of([scene_of(times, (body("moon"), sun), places)], noise=(SIGMA, SIGMA))


@pytest.mark.parametrize("share", [0.35, 3.0])
def test_a_track_that_is_lost_grows_on_with_fewer_rows(monkeypatch, share):
    """Foreseen to four times its rows at once, the track is lost, and found with fewer."""
    monkeypatch.setattr(growing, "GROWTH", share)
    dataset = orbit()
    run = _Run(Hypothesis.from_laws(dataset, [GRAVITY]), dataset, {}, {}, FitTolerances())
    noises = run.noises(run.hypothesis.noise)
    climb = Climb(run, noises, scales_of(run.groups, noises), False)
    (_, point, rank), *_ = growing.tried(climb, climb.first_points(), range(3))
    lengths = []
    fit_rows = growing._fit_rows

    def counted(*args, **settings):
        lengths.append(int((args[3][0][1] - args[3][0][0]).sum()))
        return fit_rows(*args, **settings)

    monkeypatch.setattr(growing, "_fit_rows", counted)
    grown = growing.grow(climb, point, rank)
    assert lengths[-1] == 73
    assert (np.diff(lengths) < 0).any() == (share > 1)  # it stepped back
    places = np.moveaxis(grown.nodes[0][0], (-2, -1), (0, 1))[:, 0, 0]
    left = (places - dataset.scenes[0].positions[:, 0]) / SIGMA
    assert np.square(left).mean() < 100  # found; the last descent joins it
    assert climb.coordinates.constants(grown.values)[0] == pytest.approx([1.0], abs=0.01)
