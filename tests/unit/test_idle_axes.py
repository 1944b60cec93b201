"""Carts on a track: along the axis where nothing moves nothing is told, whatever grows there."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.loop.close import close_loop
from tests.loop_views import view_of
from tests.throws import SI

SPRING = "-k * (norm(p_i - p_j) - 0.4 [m]) * normalize(p_i - p_j)"
"""Shorter than 0.4 m it pushes aside: a rounding error across the track grows."""


def carts(n_scenes=4, sigma=0.0005):
    """Two carts on one track, joined by a spring and a damper, 8 N/m and 0.1 kg/s."""
    rng, scenes, t = np.random.default_rng(2), [], np.arange(120) / 30

    def rate(t, s):
        pull = -8.0 * (s[1] - s[0] - 0.4) - 0.1 * (s[3] - s[2])
        return [s[2], s[3], -pull / 0.3, pull / 0.45]

    for k in range(n_scenes):
        first = [0.35, 0.75 + rng.uniform(-0.12, -0.05), rng.uniform(-0.3, 0.3), 0.0]
        path = solve_ivp(rate, (0, t[-1]), first, t_eval=t, rtol=1e-10, atol=1e-12).y[:2].T
        places = np.zeros((len(t), 2, 2))
        places[..., 0] = path + sigma * rng.standard_normal(path.shape)
        bodies = (Entity("A", properties={"mass": 0.3}), Entity("B", properties={"mass": 0.45}))
        scenes.append(Scene(str(k), t, places, bodies))
    return Dataset("carts", tuple(scenes), noise=(sigma,), units=SI)


@pytest.mark.slow
def test_smoothed_tracks_stay_on_the_track():
    view = view_of(carts(), SPRING)
    for nodes in view.response.nodes:
        assert not np.any(nodes[:, :, 1])
    assert float(view.left @ view.left) < 20 * view.fit.chisqr


@pytest.mark.slow
def test_a_damper_between_carts_is_found():
    report = close_loop(carts(), SPRING, rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    found = {c.name: c.value for c in report.constants}
    assert abs(found["c1"]) == pytest.approx(0.1, abs=0.003)
