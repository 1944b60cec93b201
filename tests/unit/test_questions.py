"""Questions about the noise of a fit, and bounds on what it may hide."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.loop.criteria import NOISE_FINDINGS
from bsp_gp.loop.questions import hidden_bound, noise_findings
from bsp_gp.loop.view import View
from tests.loop_views import edited, throws, view_of

SIGMA = 0.005


def smallest(noise=None, *, n_bodies=2, n_rows=80, change=None, **more):
    """The most striking finding about some noise."""
    rng = np.random.default_rng(7)
    made = noise and (lambda s, z: noise(rng, s, z))
    data = throws(rng, n_bodies=n_bodies, n_rows=n_rows, noise=made, **more)
    if change is not None:
        data = edited(data, change)
    return noise_findings(view_of(data))[0]


def normal(rng, shape):
    return SIGMA * rng.standard_normal(shape)


def remembered(rng, scene, shape):
    out = normal(rng, shape)
    for k in range(1, len(out)):
        out[k] = 0.7 * out[k - 1] + np.sqrt(1 - 0.49) * out[k]
    return out


def shaken(rng, shape):
    return (normal(rng, shape) + normal(rng, (shape[0], 1, shape[2]))) / np.sqrt(2)


def test_noise_as_declared_shows_nothing():
    found = noise_findings(view_of(throws(np.random.default_rng(7), n_bodies=2, n_rows=80)))
    assert {f.code for f in found} == set(NOISE_FINDINGS) - {"grid"}
    assert all(f.p_value > 0.003 for f in found)


@pytest.mark.parametrize(
    ("noise", "code", "place"),
    [
        (remembered, "autocorrelation", ("", "")),
        (lambda rng, s, z: 1.5 * normal(rng, z), "size", ("", "")),
        (lambda rng, s, z: 0.6 * normal(rng, z), "size", ("", "")),
        (lambda rng, s, z: SIGMA * rng.standard_t(3, z) / np.sqrt(3), "tails", ("", "")),
        (lambda rng, s, z: shaken(rng, z), "common", ("", "")),
        (lambda rng, s, z: (2 if s == 2 else 0.8) * normal(rng, z), "level_of_scene", ("3", "")),
        (lambda rng, s, z: [[[0.7], [1.4]]] * normal(rng, z), "level_of_body", ("", "2")),
    ],
)
def test_odd_noise_is_told_in_its_words(noise, code, place):
    found = smallest(noise)
    assert (found.code, (found.scene, found.entity)) == (code, place)
    assert found.p_value < 1e-4


def test_noise_that_grows_with_speed_is_told():
    def noise(rng, s, shape):  # the fall along y gets fast in the end
        return normal(rng, shape) * np.linspace(0.3, 2.0, shape[0])[:, None, None] ** [0, 1]

    found = smallest(noise, n_bodies=1)
    assert found.code == "level_with_speed"


def test_one_bad_row_is_told_with_its_place():
    def change(positions):
        positions[30, 1] += 8 * SIGMA

    found = smallest(change=change)
    assert (found.code, found.scene, found.entity, found.row) == ("row", "1", "2", 30)


def test_rounding_that_hides_the_noise_is_told():
    data = throws(np.random.default_rng(7), sigma=0.01)
    scenes = tuple(replace(s, positions=np.round(s.positions, 2)) for s in data.scenes)
    found = noise_findings(view_of(replace(data, scenes=scenes, noise=None)))
    assert found[0].code == "grid"


def test_a_missing_force_is_not_taken_for_noise():
    def push(t, mass):
        return 0.5 * 0.4 * np.square(t)[:, None] * [1, 0]

    data = throws(np.random.default_rng(7), n_bodies=2, n_rows=80, move=push)
    view = view_of(data)
    assert view.fit.chi2_red > 3
    assert all(f.p_value > 1e-3 for f in noise_findings(view))


def test_rows_that_are_off_beyond_all_numbers_are_told_like_others():
    def change(positions):
        positions[30::7, 1] += 1e5 * SIGMA

    view = view_of(edited(throws(np.random.default_rng(7), n_bodies=2, n_rows=80), change))
    heavy = replace(view.fit, noise=replace(view.fit.noise, degrees=300.0))
    found = noise_findings(View(heavy, view.hypothesis, view.dataset, np.random.default_rng(0)))
    assert found and all(0 <= f.p_value <= 1 for f in found)


# --- how much may be hidden -----------------------------------------------------------------------


def test_the_bound_covers_a_force_that_is_there_and_shrinks_with_the_noise():
    force = 0.02

    def push(t, mass):
        return 0.5 * force / mass * np.square(t)[:, None] * [1, 0]

    bounds = [
        hidden_bound(view_of(throws(np.random.default_rng(3), move=push, sigma=s)))
        for s in (0.005, 0.0005)
    ]
    assert all(b.force > force for b in bounds)
    assert bounds[1].force == pytest.approx(force, rel=0.1)
    assert bounds[0].force > 1.1 * bounds[1].force
    typical = bounds[0].force / bounds[0].acceleration
    assert 0.1 < typical < 0.5
    assert bounds[0].share == pytest.approx(bounds[0].acceleration / 9.81, rel=0.3)


@pytest.mark.slow
def test_the_bound_on_the_signal_covers_what_is_there():
    def push(t, mass):
        return 0.05 * np.square(t)[:, None] * [1, 0]

    covered = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        view = view_of(throws(rng, move=push))
        axis = np.zeros(len(view.left))
        parts = []
        for batch in view.response.regression.batches:
            acting = np.zeros(batch.valid.shape)
            acting[..., 0] = 0.1
            parts.append(batch.whiten(acting).ravel())
        axis = view.beside(np.concatenate(parts)[:, None])
        true = float(np.linalg.norm(axis))
        bound = hidden_bound(view).snr
        covered += bound > true
        assert bound > 0
    assert covered >= 17  # 95 %: fewer in one of 500 tries


def test_without_masses_the_bound_is_an_acceleration():
    data = throws(np.random.default_rng(3))
    scenes = tuple(
        replace(s, entities=tuple(replace(e, properties={}) for e in s.entities))
        for s in data.scenes
    )
    bound = hidden_bound(view_of(replace(data, scenes=scenes)))
    assert np.isfinite(bound.acceleration)
    assert np.isnan(bound.force)
    assert np.isnan(bound.share)


def test_what_a_constant_of_the_law_imitates_is_not_bounded():
    data = throws(np.random.default_rng(3))
    bound = hidden_bound(view_of(data, "-9.81 [m/s^2] * m_i * e_y", "c * e_x"))
    assert bound.force == np.inf
