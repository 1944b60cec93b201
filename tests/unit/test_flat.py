"""Axes along which nothing moves beyond its noise, and bodies held there whatever pulls."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.flat import held_flat
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.rails import Rail, rail_of
from bsp_gp.loop.close import close_loop
from tests.throws import SI

TIMES = 0.05 * np.arange(60)
STRENGTH, LANES, NOISE = 0.02, (0.0, 0.08), 1e-3
LAW = "c * (p_i - p_j) / norm(p_i - p_j)^3"


def carts(rng, lanes=LANES, noise=(NOISE, NOISE), n_scenes=3):
    """Two carts on tracks side by side that repel each other; forces across move nothing."""
    scenes = []
    for k in range(n_scenes):
        start = [0.0, 0.7, 0.3 + 0.1 * k, -0.3]

        def rate(t, s):
            apart = s[0] - s[1]
            push = STRENGTH * apart / (apart**2 + (lanes[0] - lanes[1]) ** 2) ** 1.5
            return [s[2], s[3], push, -push]

        found = solve_ivp(rate, (0, TIMES[-1]), start, t_eval=TIMES, rtol=1e-10, atol=1e-12).y
        places = np.stack([found[:2].T, np.tile(lanes, (len(TIMES), 1))], axis=-1)
        places = places + np.array(noise) * rng.standard_normal(places.shape)
        entities = [Entity(name, properties={"mass": 1.0}) for name in "ab"]
        scenes.append(Scene(f"run {k}", TIMES, places, tuple(entities)))
    return Dataset("carts", tuple(scenes), units=SI)


def test_an_axis_of_noise_is_held_and_told():
    held = held_flat(carts(np.random.default_rng(0)))
    for scene in held.scenes:
        assert np.ptp(scene.positions[:, :, 1], axis=0) == pytest.approx([0, 0], abs=0)
        assert np.ptp(scene.positions[:, 0, 0]) > 0.1
    assert "along y no body moves beyond its noise" in held.notes[-1]


def test_what_moves_is_left_as_it_is():
    """Slopes, bends and waves of ten times their error, and noise with a memory."""
    rng = np.random.default_rng(1)
    dataset = carts(rng)
    share = np.linspace(-1, 1, len(TIMES))
    wave = np.sin(2 * np.pi * 7 * share + 1)
    walk = 0.3 * np.cumsum(rng.standard_normal(len(TIMES))) / 3
    for way in (share, share**2, wave, walk):
        way = way - way.mean()
        size = 10 * NOISE / np.linalg.norm(way)
        scenes = list(dataset.scenes)
        places = scenes[1].positions.copy()
        places[:, 0, 1] += size * way
        scenes[1] = replace(scenes[1], positions=places)
        moved = replace(dataset, scenes=tuple(scenes))
        assert held_flat(moved) is moved
    assert held_flat(dataset, spoken={"y"}) is dataset


def test_noise_is_seldom_taken_for_motion():
    """One time in a hundred, as it is meant; the level is told by few rows."""
    taken = 0
    for seed in range(200):
        dataset = carts(np.random.default_rng((2, seed)), n_scenes=1)
        taken += held_flat(dataset) is dataset
    assert taken <= 8


def test_forces_across_a_rail_move_nothing():
    """The strength is that of the motion along, where free bodies would be turned aside."""
    dataset = held_flat(carts(np.random.default_rng(3), noise=(NOISE, 0.0)))
    assert rail_of(dataset, ("y",)) == Rail((1,)) and rail_of(dataset, ()) is None
    behind = carts(np.random.default_rng(3), lanes=(0.0, 0.0), noise=(NOISE, 0.0))
    assert rail_of(behind, ("y",)) == Rail((1,)), "all motion is along a line"
    deep = [replace(s, positions=np.pad(s.positions, ((0, 0), (0, 0), (0, 1))))
            for s in behind.scenes]  # fmt: skip
    assert rail_of(replace(behind, scenes=tuple(deep)), ("z",)) is None
    hypothesis = Hypothesis.from_laws(dataset, (LAW,))
    free, held = (fit(h, dataset) for h in (hypothesis, hypothesis + Rail((1,))))
    assert held.status == "converged" and held.chisqr < 1.3 * held.n_rows
    assert held.values == pytest.approx([STRENGTH], abs=4 * held.errors[0])
    assert free.is_failed or free.chisqr > 2 * held.chisqr or abs(
        free.values[0] - STRENGTH
    ) > 4 * free.errors[0]  # fmt: skip


def clock(n_rows=200, noise=0.01):
    """A weight that swings by a push along its velocity, from two beginnings, along x."""
    t, rng, scenes = np.arange(n_rows) / 30, np.random.default_rng(5), []
    for k, start in enumerate((0.1, 1.2)):
        found = solve_ivp(
            lambda t, s: [s[1], -30 * s[0] - 0.3 * s[1] + 0.6 * np.sign(s[1])], (0, t[-1]),
            [start, 0.05], t_eval=t, rtol=1e-9, atol=1e-11, max_step=0.01,
        )  # fmt: skip
        x = found.y[0] + noise * rng.standard_normal(n_rows)
        places = np.stack([x, np.zeros(n_rows)], axis=-1)[:, None]
        scenes.append(Scene(f"run {k}", t, places, (Entity("bob", properties={"mass": 1.0}),)))
    return Dataset("clock", tuple(scenes), units=SI)


def test_a_push_along_the_velocity_is_fitted_through_turns_on_a_line():
    """Beside the line a body that turns has no direction: derivatives across are without end."""
    laws = ("-c1 * p_i - c2 * v_i", "c3 * m_i * normalize(v_i)")
    dataset = clock()
    found = fit(Hypothesis.from_laws(dataset, laws) + rail_of(dataset, ("y",)), dataset)
    assert found.status == "converged" and found.chi2_red < 1.2
    assert found.values == pytest.approx([30.0, 0.3, 0.6], abs=4 * max(found.errors))


def test_heights_that_do_not_change_are_those_of_a_plane():
    scenes = [replace(s, positions=np.pad(s.positions, ((0, 0), (0, 0), (0, 1)),
                                          constant_values=1.6 + 0.1 * k))
              for k, s in enumerate(clock().scenes)]  # fmt: skip
    dataset = replace(clock(), scenes=tuple(scenes))
    plane = held_flat(dataset)
    assert plane.n_dims == 2
    assert "z does not change" in plane.notes[-1]
    assert held_flat(dataset, ("z",)) is dataset


@pytest.mark.slow
def test_nothing_is_missing_from_carts_on_tracks():
    report = close_loop(carts(np.random.default_rng(4)), (LAW,), rng=0, n_bootstrap=0)
    assert report.verdict == "nothing missing"
    assert report.constants[0].value == pytest.approx(STRENGTH, rel=0.03)
