"""The measurement as a rival: each is found with its number, or said not to be visible."""

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from bsp_gp.data.scene import Entity, Scene
from bsp_gp.loop.corrections import corrections_of
from bsp_gp.loop.defects import bad_frame, frozen_tails, swaps_of
from bsp_gp.loop.measurement import measurement_rivals, same_numbers
from bsp_gp.loop.rivals import explanations, winner_of
from bsp_gp.loop.seeing import corrected_scenes
from bsp_gp.loop.separating import LIKE_THESE, Member, separating_text, separations
from tests import measured as wrong
from tests import worlds
from tests.measured import SPRING, changed, prepared
from tests.planted import GRAVITY
from tests.worlds import WEIGHT, flights, orbits, tied

FEW = {"n_train": 2, "n_test": 1, "n_times": 30}
STIFF = "8 [kg/s^2] * (norm(p_j - p_i) - l_i) * normalize(p_j - p_i)"


def late_on_a_spring():
    return changed(changed(pulling(), lambda s: wrong.late(s, 1, 0.02)),
                   lambda s: wrong.noisy(s, 0.003))  # fmt: skip


def tilted(t, p, angle=0.05):
    c, s = np.cos(angle), np.sin(angle)
    return t, p @ np.array([[c, s], [-s, c]])


def pulling(seed=0):
    """Two bodies of like mass on one spring, without noise."""

    def scene(name, rng):
        start = np.array([[[0.0, 0.0], [2.0, 0.5]], rng.uniform(-1.0, 1.0, (2, 2))])
        masses = np.array([1.0, 1.5])

        def motion(t, p, v):
            return 4.0 * (p[::-1] - p) / masses[:, None]

        times = 0.05 * np.arange(60)
        p, _ = worlds.moved(motion, start, times)
        bodies = [Entity(f"body{k}", properties={"mass": m}) for k, m in enumerate(masses)]
        return Scene(name, times, p, bodies)

    return worlds.split_dataset("pulling", scene, seed, n_train=2, n_test=1)


FOUND = {
    "tilted": (lambda: flights(0, worlds.nothing, warp=tilted, **FEW), WEIGHT,
               "a camera that is tilted (its axes rotated)", [0.05]),
    "scale": (lambda: changed(tied(0, **FEW), wrong.scaled), SPRING,
              "a length scale that is off", [0.03]),
    "clock": (lambda: changed(tied(0, **FEW), wrong.clocked), STIFF,
              "a clock that is off", [0.02]),
    "drift": (lambda: changed(tied(0, **FEW), wrong.drifting), SPRING,
              "a camera that drifts", [0.02, -0.01]),
    "offset": (lambda: changed(tied(0, **FEW), wrong.shifted), SPRING,
               "an offset between moving and fixed bodies", [0.03, -0.02]),
    "delay": (late_on_a_spring, "c1 * (p_j - p_i)", "a delay of body1", [0.02]),
}  # fmt: skip


@pytest.mark.parametrize("case", FOUND)
def test_the_right_one_is_best_and_its_number_is_right(case):
    make, law, name, values = FOUND[case]
    observation, model = prepared(make(), law)
    best = measurement_rivals(observation, model, None)[0]
    assert best.name == name and not best.reason
    assert best.details["p_value"] < 1e-6
    for constant, value in zip(best.constants, values, strict=True):
        half = (constant.high - constant.low) / 2
        assert abs(constant.value - value) < 3 * half / 1.645
    dof = best.fit.n_rows - best.fit.whole.n_free
    assert best.fit.chisqr < dof + 5 * np.sqrt(2 * dof)


def test_what_initial_states_take_up_is_not_visible():
    """Under a constant weight a drift is a velocity, and an exposure shifts all alike."""
    observation, model = prepared(flights(0, worlds.wind, **FEW), WEIGHT)
    found = {e.name: e for e in measurement_rivals(observation, model, None)}
    for name in ("a camera that drifts", "positions smoothed over time (exposure, filter)"):
        assert "do not see it" in found[name].reason
        assert found[name].fit is model.fit


def test_a_tilt_is_not_visible_without_a_direction():
    observation, model = prepared(orbits(0, **FEW), GRAVITY)
    found = {e.name: e for e in measurement_rivals(observation, model, None)}
    assert "do not see it" in found["a camera that is tilted (its axes rotated)"].reason


def test_scale_clock_and_number_are_one_by_the_rank_of_the_derivatives():
    alike = {"a length scale that is off", "a clock that is off"}
    for dataset, laws in (
        (flights(0, worlds.nothing, **FEW), (WEIGHT,)),
        (flights(0, worlds.linear_drag, **FEW), (WEIGHT, "-c1 * v_i")),
        (orbits(0, **FEW), (GRAVITY,)),
    ):
        observation, model = prepared(dataset, *laws)
        (names,) = same_numbers(observation, model.fit).values()
        assert set(names) == alike


def test_a_known_length_parts_scale_and_clock():
    observation, model = prepared(tied(0, **FEW), STIFF)
    (names,) = same_numbers(observation, model.fit).values()
    assert names == ("a clock that is off",)
    observation, model = prepared(
        flights(0, worlds.linear_drag, same_mass=True, **FEW), WEIGHT, "-0.3 [kg/s] * v_i"
    )
    assert set(same_numbers(observation, model.fit).values()) == {
        ("a length scale that is off",), ()
    }  # fmt: skip


def test_chi_squared_is_that_of_the_positions_as_measured():
    """A scale of two makes noise half as large; it is not chi-squared that falls by it."""
    observation, model = prepared(changed(tied(0, **FEW), lambda s: wrong.scaled(s, 1.2)), SPRING)
    best = measurement_rivals(observation, model, None)[0]
    assert best.observation.sigma == pytest.approx(observation.sigma / 1.2, rel=0.01)
    dof = best.fit.n_rows - best.fit.whole.n_free
    assert best.fit.chisqr == pytest.approx(dof, abs=5 * np.sqrt(2 * dof))


def test_a_correction_by_nothing_changes_nothing():
    observation, model = prepared(orbits(0, **FEW), GRAVITY)
    tracks = {s.name: s.positions[:, s.dynamic] for s in observation.train}
    corrections = corrections_of(observation)
    assert len(corrections) == 11
    for c in corrections:
        mended = corrected_scenes(observation.train, c, np.zeros(len(c)), tracks)
        for old, new in zip(observation.train, mended, strict=True):
            np.testing.assert_allclose(new.positions, old.positions, atol=1e-9)
            np.testing.assert_allclose(new.times, old.times)


def test_an_exposure_pulls_a_track_towards_its_inside():
    """A circle seen through an exposure w shrinks by w^2 omega^2 / 24."""
    fine = tied(0, sigma=0.0, n_times=400, dt=0.005, n_train=1, n_test=0).scenes[0]
    seen, clean = wrong.exposed(fine), wrong.exposed(fine, every=1)
    (c,) = [c for c in corrections_of(prepared(tied(0, **FEW), SPRING)[0]) if "smoothed" in c.name]
    (mended,) = corrected_scenes([seen], c, [0.05**2 / 12], {seen.name: seen.positions[:, :1]})
    there = make_interp_spline(clean.times, clean.positions[:, 0], k=5)(seen.times)
    before = np.abs(seen.positions[:, 0] - there).max()
    assert np.abs(mended.positions[:, 0] - there).max() < 0.1 * before


# --- defects --------------------------------------------------------------------------------------


def test_swapped_tracks_are_found_and_put_right():
    dataset = changed(orbits(0, **FEW), lambda s: wrong.swapped(s, 15), "1")
    observation, model = prepared(dataset, GRAVITY)
    best = measurement_rivals(observation, model, None)[0]
    assert best.name == "swapped tracks" and "scene 1" in best.text
    clean, _ = prepared(orbits(0, **FEW), GRAVITY)
    mended = {s.name: s for s in best.observation.train}["1"]
    np.testing.assert_array_equal(mended.positions, {s.name: s for s in clean.train}["1"].positions)


def test_tracks_that_are_not_swapped_are_left_alone():
    for scene in orbits(1).scenes:
        assert swaps_of(scene, np.array([0.01, 0.01])) == []
        assert frozen_tails(scene, np.array([0.01, 0.01])) == []


def test_a_lost_track_is_found():
    dataset = changed(orbits(0, **FEW), lambda s: wrong.frozen(s, 20), "1")
    observation, model = prepared(dataset, GRAVITY)
    best = measurement_rivals(observation, model, None)[0]
    assert best.name == "a lost track" and "body1" in best.text
    assert best.fit.n_rows == model.fit.n_rows
    body = {s.name: s for s in best.observation.train}["1"].positions[:, 1]
    assert np.isnan(body[20:]).all() and np.isfinite(body[:20]).all()


def test_one_bad_frame_is_found():
    observation, model = prepared(changed(orbits(0, **FEW), wrong.jolted, "1"), GRAVITY)
    assert bad_frame(observation, model.fit)[:2] == ("1", 17)
    best = measurement_rivals(observation, model, None)[0]
    assert best.name == "one bad frame" and best.details["p_value"] < 1e-6


# --- ranking and what would separate --------------------------------------------------------------


def test_nothing_wins_where_nothing_is_wrong():
    for dataset, law in ((orbits(3, **FEW), GRAVITY), (flights(3, worlds.nothing, **FEW), WEIGHT)):
        observation, model = prepared(dataset, law)
        found = explanations(observation, model, np.random.default_rng(0))
        assert winner_of(model, [], found) is None


def test_a_law_that_explains_more_is_not_beaten():
    observation, model = prepared(flights(0, worlds.nothing, warp=tilted, **FEW), WEIGHT)
    found = explanations(observation, model, np.random.default_rng(0))
    best = winner_of(model, [], found)
    assert best is found[0]
    assert winner_of(model, [best.fit], found) is None


def test_a_longer_track_parts_a_push_from_a_tilt():
    push = "9.81 [m/s^2] * m_i * down", "c1 * m_i * e_x"
    dataset = flights(0, worlds.nothing, warp=tilted, **FEW)
    observation, model = prepared(dataset, WEIGHT)
    tilt = measurement_rivals(observation, model, None)[0]
    _, pushed = prepared(dataset, *push)
    members = [Member("push", pushed.fit), Member(tilt.name, tilt.fit, tilt.view)]
    found = separations(observation, *members)
    # What is left of g along y grows with the square of the time, beside the initial velocity.
    assert found["a track twice as long"] > 4 * found[LIKE_THESE]
    assert found["a second height"] == pytest.approx(found[LIKE_THESE], rel=0.01)
    text = separating_text(observation, members)
    assert text.startswith("a track twice as long: predictions differ by")


def test_what_is_one_and_the_same_is_parted_by_nothing():
    dataset = flights(0, worlds.nothing, warp=lambda t, p: (1.02 * t, p), **FEW)
    observation, model = prepared(dataset, WEIGHT)
    first, second = measurement_rivals(observation, model, None)[:2]
    assert second.name in first.equivalents
    members = [Member(e.name, e.fit, e.view) for e in (first, second)]
    assert max(separations(observation, *members).values()) < 0.1
    assert "none of the further recordings" in separating_text(observation, members)
