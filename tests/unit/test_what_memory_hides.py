"""What noise with a memory, a camera or an odd law would take for its own."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import close_loop
from tests.fitted_tracks import body, dataset_of, scene_of


def swung(push, n, sigma, seed=0, span=15.0):
    """One recording of a mass on a spring along x that is pushed as well."""
    t = np.linspace(0.0, span, n)
    track = solve_ivp(
        lambda t, y: [y[1], -9.0 * y[0] - 0.05 * y[1] + push(t, y[0])], (0.0, span), [0.3, 0.0],
        t_eval=t, rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    noise = sigma * np.random.default_rng(seed).standard_normal(n)
    places = np.stack([track.y[0] + noise, 0 * t], axis=-1)
    return dataset_of((scene_of(t, (body("bob"),), places[:, None], name="a"),))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("push", "code"),
    [
        (lambda t, x: 0.2 * np.cos(1.3 * t + 1.0), "period"),
        (lambda t, x: -0.9 * np.cos(1.7 * t + 0.3) * x, "pulsing"), (lambda t, x: 0.0, None),
    ],
)  # fmt: skip
def test_what_goes_on_and_on_is_no_memory_of_the_noise(push, code):
    """At a signal-to-noise ratio of 20 the first of them was "nothing missing", p = 1."""
    data = swung(push, 600, 0.02)
    laws = ["-k * (x_i - X) * e_x", "-c * v_i"]
    report = close_loop(data, laws, rng=np.random.default_rng(1), n_bootstrap=0)
    adopted = [r.effect.code for r in report.rounds if r.adopted]
    assert adopted == ([code] if code else []), report.verdict
    assert code or report.verdict == "nothing missing"


def test_weight_and_drag_are_asked_for_before_a_camera_or_a_wind_is_told():
    """A balloon was "a camera that zooms. No force is missing beside it."."""
    rng, t = np.random.default_rng(2), np.linspace(0.0, 1.0, 40)
    scenes = []
    for k, start in enumerate((0.5, 2.0, 4.0)):
        fade = -np.expm1(-0.12 * t) / 0.12  # a = -9.5157 - 0.12 v
        y = 5.0 + start * fade - 9.5157 * (t - fade) / 0.12 + 0.004 * rng.standard_normal(len(t))
        places = np.stack([0 * t, y], axis=-1)
        scenes.append(scene_of(t, (body("ball"),), places[:, None], name=f"s{k}"))
    law = "9.81 [m/s^2] * m_i * down"
    report = close_loop(dataset_of(scenes), law, rng=np.random.default_rng(1), n_bootstrap=0)
    tried = {row["law"] for row in report.rounds[0].hypotheses if row["status"] == "converged"}
    assert any(
        "c1 * (norm(v_i) * normalize(v_i)) + c2 * (m_i * e_y)" in law for law in tried
    ), tried  # fmt: skip
