"""Of many chains some are looked at, and told by all; long work keeps to its time."""

import numpy as np
import pytest

from bsp_gp.fitting.langevin import Track, models_of
from bsp_gp.loop.clock import TimeIsUp
from bsp_gp.loop.proposers import periods
from tests.loop_views import throws, view_of

RATE = 4 * np.pi


@pytest.fixture(scope="module")
def view():
    def shaken(t, mass):
        return 0.5 / mass * (1 - np.cos(RATE * t))[:, None] / RATE**2 * [1, 0]

    return view_of(throws(np.random.default_rng(3), n_scenes=6, move=shaken))


def test_a_lesser_view_has_moments_of_some_chains(view):
    assert view.lesser(view.n_weights) == (view, slice(None))
    lesser, rows = view.lesser(view.n_weights / 2)
    assert 0 < lesser.n_weights <= view.n_weights / 2
    assert len(lesser.left) == len(rows) < len(view.left)
    target, _ = view.response.left()
    own, _ = lesser.response.left()
    np.testing.assert_array_equal(own, target[rows])
    np.testing.assert_allclose(lesser.taken.T @ lesser.left, 0.0, atol=1e-9 * np.abs(own).max())


def test_a_wave_that_is_sought_by_some_chains_is_told_by_all(view, monkeypatch):
    nothing = np.zeros((len(view.left), 0))
    whole = periods.wave_beside(view, nothing, periods.waves_alone(view))
    monkeypatch.setattr(periods, "MOST_WEIGHTS", view.n_weights / 2)
    pushes = periods.waves_alone(view)
    assert pushes.scan.view is not view
    found = periods.wave_beside(view, nothing, pushes)
    assert found.columns.shape == whole.columns.shape
    assert found.rate == pytest.approx(whole.rate, rel=0.02)
    assert found.rate == pytest.approx(RATE, rel=0.03)


def test_kicks_look_at_the_clock():
    """Of 12,500 rows they had gone on for two minutes after the time was up."""
    looks = iter(range(20))

    def tick():
        if next(looks) == 10:
            raise TimeIsUp

    places = np.cumsum(np.random.default_rng(0).standard_normal((300, 1)), axis=0)
    with pytest.raises(TimeIsUp):
        models_of([Track(0.1 * np.arange(300), places)], tick=tick)
