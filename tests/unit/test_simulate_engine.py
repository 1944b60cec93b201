"""Motion made by pymunk against closed forms, force by force, and what contacts conserve."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bsp_gp.errors import SettingsError
from bsp_gp.simulate.engine import Contacts, Motion, run_pymunk
from bsp_gp.simulate.forces import (
    AnchorSpring,
    ContactDamping,
    Drag,
    DryFriction,
    MatFriction,
    PairForce,
    PeriodicPush,
    Perpendicular,
    PointSpring,
    QuadraticDrag,
    SoftContact,
    UniformField,
)
from bsp_gp.simulate.world import World, disc, mat, point, wall

FREE = Contacts(has_contacts=False)


def one(mass=2.0, p=(0.0, 0.0), v=(3.0, 4.0), **properties):
    return World([disc("a", 0.1, mass, **properties)], [p], [v])


def moved(world, *forces, n_frames=51, dt=0.02, substeps=20, contacts=FREE):
    """Times, positions and velocities of one world, shapes (T,), (T, N, 2), (T, N, 2)."""
    states = run_pymunk([world], Motion(forces, n_frames, dt, substeps, contacts))
    return states.times, states.positions[0], states.velocities[0]


def converges(world, exact, *forces, tolerance, **options):
    """Positions of body 0 tend to `exact(t)` as the square of the sub-step."""
    errors = []
    for substeps in (10, 20):
        t, p, _ = moved(world, *forces, substeps=substeps, **options)
        errors.append(np.abs(p[:, 0] - np.stack([exact(tt) for tt in t])).max())
    assert errors[1] < tolerance
    assert 3.5 < errors[0] / errors[1] < 4.5


def test_free_motion_is_straight():
    t, p, v = moved(one())
    np.testing.assert_allclose(p[:, 0], t[:, None] * (3, 4), atol=1e-12)
    np.testing.assert_array_equal(v[:, 0], np.broadcast_to((3.0, 4.0), (51, 2)))


@pytest.mark.parametrize("substeps", [1, 7])
def test_free_fall_is_a_parabola_whatever_the_mass_and_the_step(substeps):
    for mass in (0.02, 9.0):
        t, p, v = moved(one(mass), UniformField(9.81), substeps=substeps)
        exact = np.stack([3 * t, 4 * t - 9.81 * t**2 / 2], axis=1)
        np.testing.assert_allclose(p[:, 0], exact, atol=1e-11)
        np.testing.assert_allclose(v[:, 0, 1], 4 - 9.81 * t, atol=1e-11)


def test_a_push_moves_a_heavy_body_less():
    t, p, _ = moved(one(4.0, v=(0, 0)), UniformField(2.0, 0.0, per_mass=False))
    np.testing.assert_allclose(p[:, 0, 0], 2.0 / 4.0 * t**2 / 2, atol=1e-12)


def test_linear_drag_in_wind():
    c, m, w = 1.5, 2.0, np.array([0.0, 2.0])
    v = np.array([3.0, 4.0])

    def exact(t):
        return w * t + (v - w) * m / c * (1 - math.exp(-c * t / m))

    converges(one(m), exact, Drag(c, 2.0, 90.0), tolerance=1e-6)


def test_quadratic_drag():
    c, m, v = 0.8, 2.0, 5.0

    def exact(t):
        return np.array([0.6, 0.8]) * m / c * math.log1p(c * v * t / m)

    converges(one(m), exact, QuadraticDrag(c), tolerance=1e-5)


def test_quadratic_drag_drives_to_the_wind():
    _, _, v = moved(one(0.1), QuadraticDrag(5.0, 3.0, 180.0), n_frames=500)
    np.testing.assert_allclose(v[-1, 0], (-3, 0), atol=1e-2)


@pytest.mark.parametrize("column", ["", "charge"])
def test_perpendicular_force_makes_circles(column):
    m, b, q = 2.0, 4.0, -1.5 if column else 1.0
    world = one(m, charge=-1.5)
    omega = b * q / m

    def exact(t):
        s, c = math.sin(omega * t) / omega, (1 - math.cos(omega * t)) / omega
        return np.array([3 * s - 4 * c, 3 * c + 4 * s])

    converges(world, exact, Perpendicular(b, column), tolerance=1e-4)
    _, _, v = moved(world, Perpendicular(b, column))
    speed = np.hypot(*v[:, 0].T)
    np.testing.assert_allclose(speed, 5.0, rtol=(omega * 1e-3) ** 2)
    assert np.ptp(speed[1:]) < 1e-6  # neither gained nor lost


def test_periodic_push():
    m, a, period, phase = 2.0, 3.0, 0.7, 30.0
    w, f = 2 * math.pi / period, math.radians(phase)

    def exact(t):
        x = 3 * t + a / m / w**2 * (math.cos(f) - math.cos(w * t + f) - w * t * math.sin(f))
        return np.array([x, 4 * t])

    converges(one(m), exact, PeriodicPush(a, period, 0.0, phase), tolerance=1e-4)


def test_dry_friction_stops_and_never_turns_round():
    mu_g = 8.0
    t, p, v = moved(one(), DryFriction(mu_g))
    stop, path = 5.0 / mu_g, 25.0 / (2 * mu_g)
    speed = np.hypot(*v[:, 0].T)
    np.testing.assert_allclose(speed[t < stop], 5 - mu_g * t[t < stop], atol=1e-9)
    np.testing.assert_allclose(np.hypot(*p[t > stop + 0.01, 0].T), path, atol=5 * 1e-3**2 * mu_g)
    assert np.abs(v[t > stop + 0.01]).max() < 1e-12


def test_dry_friction_holds_against_a_weaker_field_and_not_against_a_stronger():
    _, p, _ = moved(one(v=(0, 0)), DryFriction(3.0), UniformField(2.9, 0.0))
    assert np.abs(p).max() < 1e-5
    t, p, _ = moved(one(v=(0, 0)), DryFriction(3.0), UniformField(4.0, 0.0))
    np.testing.assert_allclose(p[:, 0, 0], (4 - 3) * t**2 / 2, atol=1e-3)


def test_a_mat_takes_its_width_times_the_friction_of_energy():
    world = World(
        [disc("a", 0.5, 2.0), mat("m", 4.0, 1.0, 3.0)], [(-5, 0), (0, 0)], [(10, 0), (0, 0)]
    )
    _, p, v = moved(world, MatFriction(0.8))
    assert p[-1, 0, 0] > 2.5
    loss = 0.5 * 2 * (10**2 - v[-1, 0, 0] ** 2)
    assert loss == pytest.approx(0.8 * 2.0 * 3.0 * 4.0, rel=5e-3)  # a sub-step at either edge
    world = World(world.entities, [(-5, 2), (0, 0)], world.velocities)
    assert moved(world, MatFriction(0.8))[2][-1, 0, 0] == 10


def test_spring_to_an_unseen_point():
    k, m, x, y = 30.0, 2.0, 1.0, -2.0
    w = math.sqrt(k / m)

    def exact(t):
        start, v = np.array([-x, -y]), np.array([3.0, 4.0])
        return (x, y) + start * math.cos(w * t) + v / w * math.sin(w * t)

    converges(one(m), exact, PointSpring(k, x, y), tolerance=1e-3)


def test_anchor_spring_has_its_rest_length():
    anchor = point("o", stiffness=20.0, rest_length=0.5)
    world = World([disc("a", 0.01, 2.0), anchor], [(0, 0.8), (0, 0)], np.zeros((2, 2)))
    t, p, _ = moved(world, AnchorSpring())
    np.testing.assert_allclose(p[:, 0, 1], 0.5 + 0.3 * np.cos(math.sqrt(10) * t), atol=1e-5)
    np.testing.assert_array_equal(p[:, 1], 0)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_soft_discs_part_with_the_speed_of_a_damped_half_swing(damping):
    """The gap swings with w^2 = k / m - g^2 until it is nought; g = c / 2 m, m the reduced mass.

    Dashpots pull a little at the end of a contact, which lasts as long as discs overlap.
    """
    k, masses, speed = 60.0, (1.0, 3.0), 2.0
    m = masses[0] * masses[1] / sum(masses)
    g = damping / (2 * m)
    half = math.pi / math.sqrt(k / m - g**2)
    discs = [disc("a", 0.5, masses[0]), disc("b", 0.3, masses[1])]
    world = World(discs, [(0, 0), (0.8, 0)], [(speed, 0), (0, 0)])
    forces = (SoftContact(k), ContactDamping(damping))
    t, p, v = moved(world, *forces, n_frames=3, dt=half, substeps=2000)
    restitution = math.exp(-g * half)
    assert v[-1, 1, 0] - v[-1, 0, 0] == pytest.approx(restitution * speed, rel=1e-3)
    np.testing.assert_allclose(np.array(masses) @ v[-1], (masses[0] * speed, 0), atol=1e-9)
    assert p[-1, 1, 0] - p[-1, 0, 0] == pytest.approx(0.8 + restitution * speed * half, rel=1e-3)


@pytest.mark.parametrize("power", [1.0, 2.0, 2.5, 3.0])
def test_two_bodies_circle_each_other(power):
    """r = 2, equal masses: v^2 = strength m / (2 r^(power - 1))."""
    strength, m, r = 7.0, 3.0, 2.0
    v = math.sqrt(strength * m / (2 * r ** (power - 1)))
    world = World([disc("a", 0.1, m), disc("b", 0.1, m)], [(-1, 0), (1, 0)], [(0, -v), (0, v)])
    t, p, _ = moved(world, PairForce(strength, "mass", power))
    angle = v * t
    exact = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_allclose(p[:, 1], exact, atol=2e-5)
    np.testing.assert_allclose(p[:, 0], -exact, atol=2e-5)


def energy(p, v, masses, charges, strength):
    """Kinetic plus potential energy of a pair force of power 2."""
    kinetic = 0.5 * (masses * (v**2).sum(axis=-1)).sum(axis=-1)
    gap = np.linalg.norm(p[:, :, None] - p[:, None], axis=-1)
    i, j = np.triu_indices(len(masses), 1)
    return kinetic - strength * (charges[i] * charges[j] / gap[:, i, j]).sum(axis=-1)


@pytest.mark.parametrize("column", ["mass", "charge"])
def test_pair_forces_conserve_momentum_spin_and_energy(column):
    masses = np.array([2.0, 1.0, 3.0])
    charges = masses if column == "mass" else np.array([1.0, -2.0, 1.5])
    strength = 4.0 if column == "mass" else -4.0
    bodies = [disc(str(k), 0.1, masses[k], charge=charges[k]) for k in range(3)]
    world = World(bodies, [(0, 0), (3, 0), (0, 4)], [(0.2, 0), (0, 1), (-1, 0)])
    _, p, v = moved(world, PairForce(strength, column), n_frames=61)
    momentum = (masses[:, None] * v).sum(axis=1)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-12)
    spin = (masses * (p[..., 0] * v[..., 1] - p[..., 1] * v[..., 0])).sum(axis=1)
    np.testing.assert_allclose(spin, spin[0], rtol=1e-6)
    total = energy(p, v, masses, charges, strength)
    kinetic = 0.5 * (masses * (v**2).sum(axis=-1)).sum(axis=-1)
    assert np.ptp(kinetic) > 0.1
    np.testing.assert_allclose(total, total[0], atol=1e-5)


def test_static_sources_pull_and_stay():
    sun = point("sun", mass=100.0)
    world = World([disc("a", 0.1, 2.0), sun], [(5, 0), (0, 0)], [(0, 0), (0, 0)])
    _, p, v = moved(world, PairForce(1.0), n_frames=26)
    speed = np.sqrt(2 * 100 * (1 / p[:, 0, 0] - 1 / 5))
    np.testing.assert_allclose(-v[:, 0, 0], speed, atol=1e-4)
    np.testing.assert_array_equal(p[:, 1], 0)


def test_several_forces_add_up():
    t, p, _ = moved(one(2.0), UniformField(9.81), UniformField(4.0, 0.0, per_mass=False))
    exact = np.stack([3 * t + t**2, 4 * t - 9.81 * t**2 / 2], axis=1)
    np.testing.assert_allclose(p[:, 0], exact, atol=1e-11)


# --- contacts -------------------------------------------------------------------------------------


def hit(masses, v1, v2, offset=0.0, **contacts):
    """Velocities of two discs of radius 1 after they met, and how often they touched."""
    world = World(
        [disc("a", 1.0, masses[0]), disc("b", 1.0, masses[1])], [(0, 0), (4, offset)], [v1, v2]
    )
    states = run_pymunk([world], Motion((), 101, 0.02, 20, Contacts(**contacts)))
    return states.velocities[0, -1], states.touched[0].any(axis=1).sum()


@pytest.mark.slow
@given(
    st.floats(0.02, 9), st.floats(0.02, 9), st.floats(2, 5), st.floats(-2, 1),
    st.floats(-1.5, 1.5), st.sampled_from([0.0, 0.3, 1.0]),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_contact_of_two_discs(m1, m2, v1, v2, offset, restitution):
    """Momentum stays; along the line of centres the speed comes back times the restitution."""
    before = np.array([(v1, 0.0), (v2, 0.3)])
    after, touched = hit((m1, m2), *before, offset, restitution=restitution)
    masses = np.array([m1, m2])[:, None]
    np.testing.assert_allclose((masses * after).sum(axis=0), (masses * before).sum(axis=0))
    change = after - before
    if not touched:
        assert np.abs(change).max() == 0
        return
    line = change[1] / np.linalg.norm(change[1])
    approach, leave = (before[0] - before[1]) @ line, (after[1] - after[0]) @ line
    assert approach > 0
    assert leave == pytest.approx(restitution * approach, abs=1e-9)


def test_equal_discs_exchange_velocities_head_on():
    after, touched = hit((2.0, 2.0), (3.0, 0.0), (-1.0, 0.0))
    np.testing.assert_allclose(after, [(-1, 0), (3, 0)], atol=1e-12)
    assert touched == 1


@pytest.mark.parametrize("restitution", [0.0, 0.6, 1.0])
def test_a_wall_gives_back_the_normal_speed(restitution):
    world = World([disc("a", 1.0, 3.0), wall("w", 2.0, 20.0)], [(0, 0), (4, 0)], [(5, 1), (0, 0)])
    _, p, v = moved(world, contacts=Contacts(restitution=restitution))
    np.testing.assert_allclose(v[-1, 0], (-5 * restitution, 1), atol=1e-12)
    assert p[:, 0, 0].max() == pytest.approx(2.0, abs=0.01)


def test_what_falls_comes_to_rest_on_a_table():
    world = World(
        [disc("a", 0.1, 0.3), wall("table", 10.0, 1.0)], [(0, 0.5), (0, -0.5)], np.zeros((2, 2))
    )
    fall = math.sqrt(2 * 0.4 / 9.81)
    t, p, v = moved(world, UniformField(9.81), contacts=Contacts(restitution=0.3), n_frames=151)
    first = int(np.argmax(v[:, 0, 1] > 0))
    assert t[first] == pytest.approx(fall, abs=0.021)
    assert np.abs(v[-20:, 0]).max() < 1e-9
    assert p[-1, 0, 1] == pytest.approx(0.1, abs=0.01)
    # Bounces are 0.3 as fast: this long for all of them together.
    rest = fall + 2 * fall * 0.3 / 0.7
    assert t[np.argmax(np.abs(v[:, 0, 1]) < 1e-6)] < rest + 0.5


def test_discs_pass_through_each_other_without_contacts():
    after, touched = hit((2.0, 1.0), (3.0, 0.0), (-1.0, 0.0), has_contacts=False)
    np.testing.assert_array_equal(after, [(3, 0), (-1, 0)])
    assert not touched


def test_rough_discs_turn():
    before = 0.5 * 2 * 3.0**2 + 0.5 * 1.0**2
    after, _ = hit((2.0, 1.0), (3.0, 0.0), (-1.0, 0.0), 1.0, surface_friction=0.5)
    kinetic = 0.5 * 2 * (after[0] ** 2).sum() + 0.5 * (after[1] ** 2).sum()
    smooth, _ = hit((2.0, 1.0), (3.0, 0.0), (-1.0, 0.0), 1.0)
    assert kinetic < before - 0.01  # some of it is rotation now
    assert np.abs(after - smooth).max() > 0.01


def test_overlaps_are_corrected_where_asked():
    world = World([disc("a", 1.0, 1.0), disc("b", 1.0, 1.0)], [(0, 0), (1.5, 0)], np.zeros((2, 2)))
    for share, gap in ((0.0, 1.5), (0.5, 2.0)):
        _, p, _ = moved(world, contacts=Contacts(overlap_correction=share))
        assert p[-1, 1, 0] - p[-1, 0, 0] == pytest.approx(gap, abs=1e-3)


# --- the engine -----------------------------------------------------------------------------------


def test_worlds_do_not_know_of_each_other():
    rng = np.random.default_rng(5)
    worlds = [
        World(
            [disc(str(k), 1.0, 1.0 + k) for k in range(3)],
            [(0, 0), (9, 0), (0, 9)], rng.uniform(-9, 9, (3, 2)),
        )
        for _ in range(5)
    ]  # fmt: skip
    motion = Motion((PairForce(20.0, power=1.7), Drag(0.1)), 30, 0.05, 5)
    together = run_pymunk(worlds, motion)
    for k, world in enumerate(worlds):
        alone = run_pymunk([world], motion)
        np.testing.assert_array_equal(alone.positions[0], together.positions[k])
        np.testing.assert_array_equal(alone.touched[0], together.touched[k])


def test_a_world_that_leaves_the_range_of_numbers_is_named():
    quiet = World([disc("a", 0.1, 1.0), disc("b", 0.1, 1.0)], [(0, 0), (1, 0)], np.zeros((2, 2)))
    wild = World(quiet.entities, [(0, 0), (1e-160, 0)], np.zeros((2, 2)))
    motion = Motion((PairForce(1.0),), contacts=FREE)
    with pytest.raises(SettingsError, match="world 2 left the range of numbers"):
        run_pymunk([quiet, wild], motion)


@pytest.mark.parametrize(
    "bad",
    [
        lambda: Motion(dt=0.0),
        lambda: Motion(n_frames=2),
        lambda: Motion(substeps=0),
        lambda: Contacts(restitution=1.1),
        lambda: Contacts(surface_friction=-1.0),
        lambda: Drag(math.nan),
        lambda: PeriodicPush(1.0, 0.0),
        lambda: World([point("a")], [(0, 0, 0)], [(0, 0)]),
        lambda: World([disc("a", 1.0, None)], [(0, 0)], [(0, 0)]),
        lambda: World([point("a"), point("a")], np.eye(2), np.eye(2)),
        lambda: World([point("a")], [(0, 0)], [(0, 0)], frozenset({"b"})),
        lambda: run_pymunk(
            [one(), World([point("a"), point("b")], np.eye(2), np.eye(2))], Motion()
        ),
    ],
)
def test_what_cannot_be_moved_is_refused(bad):
    with pytest.raises(SettingsError):
        bad()
