import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS, Entity, Scene
from bsp_gp.errors import SettingsError
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics import evaluation
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import INTEGRATORS, Tracks, rollout
from bsp_gp.physics.force import ForceLaw, Term

TYPES = input_types(PROPERTY_UNITS, n_dims=3, up="y")
ORDER = {"euler": 1, "leapfrog": 2, "rk4": 4}
BALL = Entity("ball", properties={"mass": 1.0})
ANCHOR = Entity("anchor", is_static=True, properties={"mass": 1.0})


def law_of(*texts, **constants):
    return ForceLaw([Term(parse_formula(text, TYPES)) for text in texts], constants)


def batch_of(times, others=None, crew=(BALL,), velocities=None, name="s"):
    """A batch whose receivers' measured places do not matter."""
    times = np.asarray(times, dtype=float)
    positions = np.zeros((len(times), len(crew), 2))
    positions[:, 0] = [1.0, 0.5]
    if others is not None:
        positions[:, 1:] = others
    measured = None
    if velocities is not None:
        measured = np.zeros_like(positions)
        measured[:, 1:] = velocities
    scene = Scene(name, times, positions, crew, measured)
    (batch,) = stack([scene], velocity="measured" if velocities is not None else "ignore")
    return batch


def roll(law, batch, p, v, **settings):
    p, v = np.array(p, float)[None, None], np.array(v, float)[None, None]
    return rollout(law, batch, p, v, **settings)[:, 0, 0]


SPRING = law_of("4 * (p_j - p_i)")  # to a still anchor at the origin: omega = 2
KEPLER = law_of("m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)")
DRAG = law_of("-0.7 * norm(v_i) * v_i")
PUSH = law_of("t^3 * e_x")
MAGNETIC = law_of("1.5 * perp(v_i)")


def spring(t):
    return [np.cos(2 * t) + 0.5 * np.sin(2 * t), -0.25 * np.sin(2 * t)]


def circle(t):
    return [np.cos(t), np.sin(t)]


def slowing(t):
    return [np.log1p(0.7 * 2 * t) / 0.7, 0 * t]


def pushed(t):
    return [t**5 / 20, t]


def gyration(t):
    return [np.sin(1.5 * t) / 1.5, (1 - np.cos(1.5 * t)) / 1.5]


PROBLEMS = {
    "spring": (SPRING, True, (1, 0), (1, -0.5), spring),
    "kepler": (KEPLER, True, (1, 0), (0, 1), circle),
    "drag": (DRAG, False, (0, 0), (2, 0), slowing),
    "in time": (PUSH, False, (0, 0), (0, 1), pushed),
    "magnetic": (MAGNETIC, False, (0, 0), (1, 0), gyration),
}


@pytest.mark.parametrize("integrator", ORDER)
@pytest.mark.parametrize("problem", PROBLEMS)
def test_order_of_convergence(problem, integrator):
    """Errors fall by 2^order when the step is halved, up to terms of the next order.

    For steps near 1/40 of the time of the motion those change the exponent by less than 0.2;
    symmetric cases may be better than promised.
    """
    law, anchored, p, v, exact = PROBLEMS[problem]
    crew = (BALL, ANCHOR) if anchored else (BALL,)
    times = np.linspace(0, 2, 21)
    truth = np.stack(exact(times), axis=-1)
    errors = []
    for substeps in (2, 4, 8):
        batch = batch_of(times, 0.0 if anchored else None, crew)
        found = roll(law, batch, p, v, integrator=integrator, substeps=substeps)
        errors.append(np.abs(found - truth).max())
    assert errors[-1] > 1e-13  # not yet at rounding
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > ORDER[integrator] - 0.2), orders
    assert np.all(orders < ORDER[integrator] + 1.2), orders


def test_euler_is_the_papers_step():
    """v += a h, then p += v h (equation 1): by hand for three steps of a spring."""
    p, v, h = np.array([1.0, 0.5]), np.array([0.0, 1.0]), 0.1
    expected = [p]
    for _ in range(3):
        v = v - 4 * p * h
        p = p + v * h
        expected.append(p)
    batch = batch_of(h * np.arange(4), 0.0, (BALL, ANCHOR))
    found = roll(SPRING, batch, (1, 0.5), (0, 1), integrator="euler")
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_leapfrog_keeps_the_energy_of_an_orbit_and_rk4_loses_it():
    """Eccentric orbit (e = 0.5), 24 periods of 60 steps.

    The velocity of leapfrog is the central difference of its positions, exactly. Its energy
    error swings within a period and does not grow: the swing of the last periods is that of the
    first up to where the steps fall. rk4 loses energy in every period.
    """
    periods, steps = 24, 60
    times = np.linspace(0, 2 * np.pi * periods, periods * steps + 1)
    swing, mean = {}, {}
    for integrator in ("leapfrog", "rk4"):
        batch = batch_of(times, 0.0, (BALL, ANCHOR))
        p = roll(KEPLER, batch, (0.5, 0), (0, np.sqrt(3)), integrator=integrator)
        v = (p[2:] - p[:-2]) / (2 * times[1])
        energy = 0.5 * np.sum(v**2, axis=-1) - 1 / np.linalg.norm(p[1:-1], axis=-1)
        parts = np.array_split(energy, 3)
        swing[integrator] = [np.ptp(part) for part in parts]
        mean[integrator] = [part.mean() for part in parts]
    assert swing["leapfrog"][2] < 1.1 * swing["leapfrog"][0] < 0.05
    assert np.ptp(mean["leapfrog"]) < 0.1 * swing["leapfrog"][0]
    loss = -np.diff(mean["rk4"])
    assert np.all(loss > 3 * np.ptp(mean["leapfrog"]))


@pytest.mark.parametrize("integrator", ORDER)
def test_free_motion_is_exact(integrator):
    times = np.cumsum([0, 0.5, 0.25, 1.0, 0.125])
    batch = batch_of(times)
    found = roll(ForceLaw(), batch, (1, 2), (0.5, -1), integrator=integrator, substeps=2)
    np.testing.assert_allclose(
        found, np.array([1, 2]) + times[:, None] * np.array([0.5, -1]), rtol=1e-15
    )


def test_unknown_integrators_are_named():
    with pytest.raises(SettingsError, match="euler, leapfrog, rk4, got 'verlet'"):
        roll(SPRING, batch_of([0, 1, 2], 0.0, (BALL, ANCHOR)), (1, 0), (0, 0), integrator="verlet")
    assert set(INTEGRATORS) == set(ORDER)


def cubic(t):
    return np.stack([1 + t - 0.5 * t**2 + 0.1 * t**3, 2 - 0.3 * t**3], axis=-1)


def cubic_speed(t):
    return np.stack([1 - t + 0.3 * t**2, -0.9 * t**2], axis=-1)


@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("n_times", [4, 5, 8])
def test_driven_entities_are_where_their_track_says(measured, n_times):
    """Between rows as well: cubics are reproduced exactly, at irregular times."""
    times = np.cumsum(np.linspace(0.2, 0.5, n_times))
    batch = batch_of(
        times, cubic(times)[:, None], (BALL, ANCHOR),
        cubic_speed(times)[:, None] if measured else None,
    )  # fmt: skip
    tracks = Tracks(batch, substeps=3)
    blank = np.zeros((1, 2, 2))
    for k in range(n_times - 1):
        for point in range(7):
            t = times[k] + (times[k + 1] - times[k]) * point / 6
            p, v = tracks.place(blank, blank, k, point)
            np.testing.assert_allclose(p[0, 1], cubic(t), rtol=1e-12)
            np.testing.assert_allclose(v[0, 1], cubic_speed(t), rtol=1e-10, atol=1e-10)
            assert not p[0, 0].any() and not v[0, 0].any()
    assert not blank.any()


def test_three_rows_of_a_driven_track_are_joined_by_lines():
    times = np.array([0.0, 1.0, 2.0])
    track = np.array([[0.0, 0.0], [2.0, 1.0], [2.0, 5.0]])
    tracks = Tracks(batch_of(times, track[:, None], (BALL, ANCHOR)), substeps=1)
    p, _ = tracks.place(np.zeros((1, 2, 2)), np.zeros((1, 2, 2)), 1, 1)
    np.testing.assert_allclose(p[0, 1], [2.0, 3.0])


@pytest.mark.parametrize("measured", [False, True])
def test_a_body_on_a_driven_spring(measured):
    """x'' = k (q - x) with q = cubic: x = q - q''/k + a cos(wt) + b sin(wt) exactly."""
    omega = 2.0
    times = np.linspace(0, 3, 31)
    batch = batch_of(
        times, cubic(times)[:, None], (BALL, ANCHOR),
        cubic_speed(times)[:, None] if measured else None,
    )  # fmt: skip

    def particular(t):
        bend = np.stack([-1 + 0.6 * t, -1.8 * t], axis=-1)
        return cubic(t) - bend / omega**2

    slope = cubic_speed(0.0) - np.array([0.6, -1.8]) / omega**2
    p0, v0 = np.array([0.3, -0.2]), np.array([1.0, 0.4])
    a, b = p0 - particular(0.0), (v0 - slope) / omega
    exact = particular(times) + a * np.cos(omega * times)[:, None]
    exact = exact + b * np.sin(omega * times)[:, None]
    found = roll(SPRING, batch, p0, v0, substeps=4)
    # rk4: (omega h)^4 omega t / 120 per unit of amplitude, with h = 0.025.
    np.testing.assert_allclose(found, exact, atol=(omega * 0.025) ** 4 * omega * 3 / 60)


def test_velocities_of_driven_entities_are_felt():
    """Drag relative to a belt that runs at a steady speed: x' -> belt's."""
    times = np.linspace(0, 2, 21)
    belt = np.stack([3 * times, -times], axis=-1)
    batch = batch_of(times, belt[:, None], (BALL, ANCHOR))
    found = roll(law_of("v_j - v_i"), batch, (0, 0), (0, 0), substeps=2)
    exact = np.array([3, -1]) * (times - 1 + np.exp(-times))[:, None]
    np.testing.assert_allclose(found, exact, atol=0.05**4)


@pytest.mark.parametrize("measured", [False, True])
def test_gaps_in_driven_tracks_are_bridged(measured):
    times = np.linspace(0, 2, 11)
    track, speed = cubic(times)[:, None].copy(), cubic_speed(times)[:, None].copy()
    track[[4, 5]] = np.nan
    speed[[4, 5]] = np.nan
    batch = batch_of(times, track, (BALL, ANCHOR), speed if measured else None)
    found = roll(SPRING, batch, (0, 0), (1, 0))
    whole = roll(SPRING, batch_of(times, cubic(times)[:, None], (BALL, ANCHOR)), (0, 0), (1, 0))
    np.testing.assert_allclose(found, whole, atol=1e-9)


def test_driven_tracks_go_straight_on_where_they_are_not_seen():
    times = np.linspace(0, 2, 11)
    track = cubic(times)[:, None].copy()
    track[[0, 9, 10]] = np.nan
    tracks = Tracks(batch_of(times, track, (BALL, ANCHOR)), substeps=1)
    blank = np.zeros((1, 2, 2))
    for k, point, t, seen in ((0, 0, 0.0, 0.2), (9, 2, 2.0, 1.6)):
        p, v = tracks.place(blank, blank, k, point)
        np.testing.assert_allclose(p[0, 1], cubic(seen) + (t - seen) * cubic_speed(seen), rtol=1e-9)
        np.testing.assert_allclose(v[0, 1], cubic_speed(seen), rtol=1e-9)


def test_gaps_in_still_tracks_are_filled():
    times = np.linspace(0, 2, 11)
    track = np.zeros((11, 1, 2))
    track[[0, 7]] = np.nan
    found = roll(SPRING, batch_of(times, track, (BALL, ANCHOR)), (1, 0), (0, 0))
    whole = roll(SPRING, batch_of(times, 0.0, (BALL, ANCHOR)), (1, 0), (0, 0))
    np.testing.assert_array_equal(found, whole)


def two_scenes():
    out = []
    for name, n_times, at in (("long", 9, 0.0), ("short", 6, 1.0)):
        times = np.cumsum(np.linspace(0.1, 0.2, n_times)) + at
        positions = np.zeros((n_times, 2, 2))
        positions[:, 0] = [1.0, 0.5]
        positions[:, 1] = cubic(times) - at
        out.append(Scene(name, times, positions, (BALL, ANCHOR)))
    return out


def test_padded_scenes_move_as_if_alone():
    scenes = two_scenes()
    (batch,) = stack(scenes)
    law = law_of("4 * (p_j - p_i)", "t * e_y")
    p = np.array([[[1.0, 0.0]], [[0.0, 2.0]]])
    v = np.array([[[0.0, 1.0]], [[-1.0, 0.5]]])
    together = rollout(law, batch, p, v, substeps=2)
    assert together.shape == (9, 2, 1, 2)
    for s, scene in enumerate(scenes):
        (alone,) = stack([scene])
        found = rollout(law, alone, p[s : s + 1], v[s : s + 1], substeps=2)
        np.testing.assert_array_equal(together[: len(scene.times), s], found[:, 0])
    assert np.isnan(together[6:, 1]).all()
    assert np.isfinite(together[:, 0]).all()


def test_copies_of_states_and_constants_are_independent():
    (batch,) = stack(two_scenes())
    law = law_of("k1 * (p_j - p_i)", k1=1.0)
    rng = np.random.default_rng(1)
    p, v = rng.normal(size=(2, 3, 2, 1, 2))  # three copies of two scenes
    constants = np.array([0.5, 2.0, 7.0])
    values = law.values(batch.bodies)
    values["pair"]["k1"] = constants[:, None, None, None]
    together = rollout(law, batch, p, v, values=values)
    assert together.shape == (9, 3, 2, 1, 2)
    for b, k1 in enumerate(constants):
        alone = rollout(law.with_constants({"k1": k1}), batch, p[b], v[b])
        np.testing.assert_array_equal(together[:, b], alone)


def test_contacts_are_computed_where_bodies_meet_alone(monkeypatch):
    """The same bits as where every force is computed at every instant."""
    crew = [Entity(n, "disc", radius=0.3, properties={"mass": 1.0 + k}) for k, n in enumerate("ab")]
    apart = np.arange(42.0).reshape(21, 2)[..., None] * [1, 1]
    (batch,) = stack([Scene("s", np.linspace(0, 2, 21), apart, tuple(crew))])
    touch = "does_collide(s_i, p_i, s_j, p_j)"
    law = law_of(f"80 * (p_i - p_j) * {touch}", f"-(2 * (v_i - v_j) * {touch}) / 3",
                 "m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)")  # fmt: skip
    # Two copies; in the second they pass each other by.
    p = np.array([[[-1.0, 0.1], [1.0, 0.0]], [[-1.0, 2.0], [1.0, -2.0]]])[:, None]
    v = np.broadcast_to([[3.0, 0.0], [-0.5, 0.1]], p.shape)
    for terms in (law.terms, law.terms[:2], law.terms[:1]):
        found = rollout(ForceLaw(terms), batch, p, v, substeps=3)
        gap = np.linalg.norm(found[..., 0, :] - found[..., 1, :], axis=-1).min(axis=0)
        assert gap[0] < 0.6 < gap[1]
        with monkeypatch.context() as patch:
            patch.setattr(evaluation, "CONTACTS", ())
            whole = rollout(ForceLaw(terms), batch, p, v, substeps=3)
        np.testing.assert_array_equal(found, whole)


def test_runaway_motion_gives_no_numbers_and_no_warning():
    batch = batch_of(np.linspace(0, 10, 11))
    found = roll(law_of("norm(v_i)^3 * v_i"), batch, (0, 0), (5, 0))
    assert np.isfinite(found[0]).all() and not np.isfinite(found[-1]).all()


def test_three_dimensions():
    """A charge in a magnetic field along z: a helix."""
    times = np.linspace(0, 2, 21)
    scene = Scene("s", times, np.zeros((21, 1, 3)), (BALL,))
    (batch,) = stack([scene])
    law = law_of("cross(v_i, e_z)")
    found = rollout(law, batch, np.zeros((1, 1, 3)), np.array([[[1.0, 0.0, 0.5]]]), substeps=2)
    exact = np.stack([np.sin(times), np.cos(times) - 1, 0.5 * times], axis=-1)
    np.testing.assert_allclose(found[:, 0, 0], exact, atol=0.05**4)
