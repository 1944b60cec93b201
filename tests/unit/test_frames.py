"""What moves freely, seen from a frame that turns: declared with one constant, and proposed."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import bsp_gp
from bsp_gp.errors import LawError
from bsp_gp.report.page import page_of

STARTS = ((0.5, 0.1, 0.2, -0.6, 0.4, 0.1), (-0.4, 0.3, 0.0, 0.5, 0.7, -0.3))


def seen_turning(spin, rate=0.0, sigma=1e-3, n_dims=2, centre=(0.0, 0.0, 0.0), n=80):
    """Straight lines at even speed, as who turns about a point sees them."""
    rng, t = np.random.default_rng(3), np.arange(n) * 0.03
    turned = np.outer(t, np.array(spin)) + np.outer(t**2 / 2, rate * np.array(spin))
    frames = {}
    for k, start in enumerate((*STARTS, STARTS[0][::-1])):  # the last is held out
        places = np.array(start[:3]) + np.outer(t, start[3:])
        if n_dims == 2:
            places[:, 2] = 0.0
        places = Rotation.from_rotvec(-turned).apply(places - centre) + centre
        places = places[:, :n_dims] + sigma * rng.standard_normal((n, n_dims))
        frames[f"s{k}"] = pd.DataFrame({"t": t, **dict(zip("xyz", places.T, strict=False))})
    return bsp_gp.Dataset.from_frames(
        frames, units={"length": "m", "time": "s"}, train=["s0", "s1"]
    )  # fmt: skip


@pytest.mark.parametrize(
    ("world", "law", "truth"),
    [
        ({"spin": (0, 0, 0.8)}, "rotating(Omega)", {"Omega": 0.8}),
        (
            {"spin": (0, 0, 0.8), "centre": (0.3, -0.2, 0)}, "rotating(Omega) about (a, b)",
            {"Omega": 0.8, "a": 0.3, "b": -0.2},
        ),
        ({"spin": (0, 0, 0.8), "rate": 0.5}, "rotating(Omega, d)", {"Omega": 0.8, "d": 0.4}),
        (
            {"spin": (0.2, -0.3, 0.8), "n_dims": 3}, "rotating(Omega)",
            {"Omega_x": 0.2, "Omega_y": -0.3, "Omega_z": 0.8},
        ),
    ],
)  # fmt: skip
def test_a_declared_frame_gives_its_constants_and_leaves_noise(world, law, truth):
    found = bsp_gp.fit_law(seen_turning(**world), [law])
    for constant in found.constants:
        error = (constant.high - constant.low) / 4
        assert 0 < error < 0.02
        assert abs(constant.value - truth[constant.name]) < 4 * error
    assert {c.name for c in found.constants} == set(truth)
    assert found.noise["sigma"][0] == pytest.approx(1e-3, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spin", "n_dims"), [((0, 0, 0.8), 2), ((0.2, -0.3, 0.8), 3)], ids=["flat", "space"]
)
def test_a_frame_that_turns_is_proposed_with_one_omega(spin, n_dims):
    data = seen_turning(spin, n_dims=n_dims, sigma=0.02)
    report = bsp_gp.close_loop(data, [], rng=np.random.default_rng(0), n_bootstrap=0)
    (effect,) = (done.effect for done in report.rounds if done.adopted)
    assert effect.code == "frame"
    values = [c.value for c in report.constants]
    assert values == pytest.approx([w for w in spin if w], abs=0.1)
    told = page_of(report).rounds[0].effect.name
    assert told == "a frame that turns: Coriolis and centrifugal forces"


@pytest.mark.parametrize(
    ("n_dims", "law", "problem"),
    [(2, "rotating(Omega) about (1, 2, 3)", "2 coordinates"), (3, "rotating(0.8)", "vector")],
)
def test_a_frame_that_makes_no_sense_is_refused(n_dims, law, problem):
    data = seen_turning((0, 0, 0.8), n_dims=n_dims)
    with pytest.raises(LawError, match=problem):
        bsp_gp.fit_law(data, [law])
