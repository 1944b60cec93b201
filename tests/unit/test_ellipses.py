"""Kepler's ellipses as they are seen on the sky."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.fitting.ellipses import FEWEST, ellipse_of

STRENGTH, INCLINATION, NODE = 4 * np.pi**2, 0.9, 0.7  # au^3/yr^2
FOCUS = (0.3, -0.2)


def _seen(times, speed=0.6):
    """Places (T, 2) and velocities of a body about a sun, in a plane that is inclined."""
    start = [1.3, 0.0, 0.0, speed * np.sqrt(STRENGTH / 1.3)]

    def move(t, s):
        return [*s[2:], *(-STRENGTH * s[:2] / np.hypot(*s[:2]) ** 3)]

    flat = solve_ivp(move, (0, times[-1]), start, t_eval=times, rtol=1e-11, atol=1e-12).y
    cos, sin = np.cos(NODE), np.sin(NODE)
    turn = np.array([[cos, -sin], [sin, cos]]) @ np.diag([1.0, np.cos(INCLINATION)])
    return (turn @ flat[:2]).T + FOCUS, (turn @ flat[2:]).T


@pytest.mark.parametrize("span", [1.1, 3.7])
def test_the_ellipse_nearest_to_dates_and_places_is_the_orbit(span):
    times = np.sort(np.random.default_rng(1).uniform(0, span, 40))
    times[-1] = span
    places, velocities = _seen(times)
    found = ellipse_of(times, places, np.full(places.shape, 1e-4))
    assert found.chisqr < 1e-6
    np.testing.assert_allclose(found.focus, FOCUS, atol=1e-6)
    assert found.strength == pytest.approx(STRENGTH, rel=1e-6)
    assert found.inclination == pytest.approx(INCLINATION, abs=1e-6)
    assert np.tan(found.node) == pytest.approx(np.tan(NODE), abs=1e-5)
    nodes = found.nodes(times[:, None])
    np.testing.assert_allclose(nodes[0, 0, :, :, 0].T, places, atol=1e-6)
    np.testing.assert_allclose(nodes[1, 0, :, :, 0].T, velocities, atol=1e-4)


def test_rows_that_are_missing_at_the_end_of_a_chain_stay_so():
    times = np.linspace(0, 2, 20)
    found = ellipse_of(times, _seen(times)[0], np.full((20, 2), 1e-4))
    nodes = found.nodes(np.array([[0.0], [1.0], [np.nan]]))
    assert np.isfinite(nodes[..., :2, :]).all() and np.isnan(nodes[..., 2, :]).all()


def test_too_few_places_tell_no_ellipse():
    times = np.linspace(0, 1, FEWEST - 1)
    assert ellipse_of(times, _seen(times)[0], np.full((FEWEST - 1, 2), 1e-4)) is None
    assert ellipse_of(np.zeros(9), np.zeros((9, 2)), np.ones((9, 2))) is None


def test_a_body_that_stays_where_it_is_has_no_orbit():
    assert ellipse_of(np.linspace(0, 1, 9), np.zeros((9, 2)), np.ones((9, 2))) is None
