"""Made-up data sets: reproducible, with what was undeclared in the truth and nowhere else."""

import dataclasses
import json
import math

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.tables import load_dataset, save_dataset
from bsp_gp.errors import SettingsError
from bsp_gp.fitting.hypothesis import declared_law
from bsp_gp.physics.metrics import one_step_nrmse
from bsp_gp.simulate.effects import EFFECTS, effect, parse_effect
from bsp_gp.simulate.layouts import Layout
from bsp_gp.simulate.observation import Observation
from bsp_gp.simulate.synth import (
    PRESETS,
    Settings,
    configured,
    make,
    numbers_of,
    preset,
    read_numbers,
)
from bsp_gp.simulate.truth import fill_truth
from bsp_gp.simulate.world import World, disc

VALUES = {"exponent": 1.8, "inelastic": 0.5, "hidden": 3.0}


def made(name, *effects, seed=7, **numbers):
    numbers = {"n_frames": 12, "substeps": 2, **numbers}
    return make(preset(name, effects, **numbers), np.random.default_rng(seed))


def positions(dataset):
    return np.stack([scene.positions for scene in dataset.scenes])


@pytest.mark.parametrize("name", PRESETS)
def test_same_seed_same_bits_and_scenes_do_not_depend_on_their_number(name):
    first, _ = made(name, n_scenes=4, noise=0.01)
    again, _ = made(name, n_scenes=4, noise=0.01)
    fewer, _ = made(name, n_scenes=2, noise=0.01)
    other, _ = made(name, n_scenes=4, noise=0.01, seed=8)
    np.testing.assert_array_equal(positions(first), positions(again))
    np.testing.assert_array_equal(positions(first)[:2], positions(fewer))
    assert np.all((positions(first) != positions(other)).any(axis=(1, 2, 3)))
    assert len({scene.positions.tobytes() for scene in first.scenes}) == 4


@pytest.mark.parametrize("name", PRESETS)
def test_what_is_saved_reads_back(name, tmp_path):
    dataset, _ = made(name, n_scenes=6, noise=0.01)
    save_dataset(dataset, tmp_path / "d")
    back = load_dataset(tmp_path / "d")
    np.testing.assert_array_equal(positions(back), positions(dataset))
    assert back.train == ("1", "2", "3", "4", "5") and back.test == ("6",)
    assert back.noise == (0.01,) and back.up == dataset.up
    assert back.scenes[0].entities[0].mass == dataset.scenes[0].entities[0].mass


@pytest.mark.parametrize("name", ["nbody", "mat", "magnet", "spring", "pucks"])
def test_declared_laws_are_read_and_hold(name):
    """With one step a frame our one-step prediction under the declared law is exact."""
    near = {"distance": 0.55} if name == "pucks" else {}
    numbers = {"n_scenes": 2, "substeps": 1, "n_frames": 10, "has_contacts": False}
    dataset, truth = made(name, **numbers, **near)
    law = declared_law(dataset, truth.declared)
    nothing = one_step_nrmse(dataset.scenes, declared_law(dataset, ()), dataset.up)
    assert one_step_nrmse(dataset.scenes, law, dataset.up) < 1e-12 < 1e-3 * nothing


@pytest.mark.parametrize("name", [n for n in EFFECTS if n not in ("dashpot", "inelastic", "mat")])
def test_an_effect_changes_the_motion_after_the_start(name):
    change = effect(name, VALUES.get(name, 2.0), is_declared=False)
    base, numbers = "magnet", {"n_scenes": 2}
    extra = [effect("pair", 3.0, column="mass")] if name == "hidden" else []
    plain, _ = made(base, *extra, **numbers)
    changed, truth = made(base, *extra, change, **numbers)
    p, q = positions(plain), positions(changed)
    np.testing.assert_array_equal(p[:, 0], q[:, 0])  # the same start, so that they compare
    assert np.abs(p - q).max() > 1e-3
    assert truth.undeclared == (change,)


def test_effects_of_contacts_and_mats():
    plain, _ = made("bounce", n_frames=40)
    soft, truth = made("bounce", effect("inelastic", 0.5, is_declared=False), n_frames=40)
    assert np.abs(positions(plain) - positions(soft)).max() > 1
    assert truth.settings.motion().contacts.restitution == 0.5
    assert truth.settings.contacts.restitution == 1.0
    plain, _ = made("pucks", n_frames=40)
    damped, truth = made("pucks", effect("dashpot", 0.5, is_declared=False), n_frames=40)
    assert np.abs(positions(plain) - positions(damped)).max() > 0.05
    assert len(truth.declared) == 1 and "along(v_i" in truth.settings.laws()[1]
    patch = effect("mat", 5.0, width=4.0, height=40.0, x=0.0, y=0.0, grip=2.0)
    slowed, truth = made("magnet", patch, repulsion=0.0, n_frames=40, speed=3, dt=0.1)
    free, _ = made("magnet", repulsion=0.0, n_frames=40, speed=3, dt=0.1)
    assert slowed.scenes[0].names[-1] == "patch"
    assert np.abs(positions(slowed)[:, :, :4] - positions(free)).max() > 0.1


@pytest.mark.parametrize("moves", [False, True])
def test_hidden_bodies_act_and_are_not_in_the_data(moves, tmp_path):
    dark = effect("hidden", 400.0, is_declared=False, x=0.0, y=90.0, moves=moves, speed=5.0)
    dataset, truth = made("nbody", dark, n_scenes=2)
    plain, _ = made("nbody", n_scenes=2)
    assert np.abs(positions(dataset) - positions(plain)).max() > 1e-2
    assert dataset.scenes[0].names == plain.scenes[0].names
    save_dataset(dataset, tmp_path / "d")
    (tmp_path / "t").mkdir()
    fill_truth(truth, tmp_path / "t")
    assert "hidden" not in (tmp_path / "d" / "trajectories.csv").read_text()
    states = pd.read_csv(tmp_path / "t" / "states.csv", dtype={"scene": str, "entity": str})
    dark = states[(states.entity == "hidden") & (states.t == 0)]
    assert list(dark.x) == [0, 0] and list(dark.y) == [90, 90]
    path = states[(states.entity == "hidden") & (states.scene == "1")]
    assert (path.x.nunique() > 1) == moves
    assert "hidden" in truth.unsaid


def test_a_hidden_body_lies_where_it_was_asked_for():
    dark = effect("hidden", 5.0, near=2.0, far=3.0)
    _, truth = made("nbody", dark, n_scenes=20)
    for world in truth.worlds:
        bodies = world.positions[:4]
        spread = np.sqrt(((bodies - bodies.mean(axis=0)) ** 2).sum(axis=1).mean())
        distance = np.linalg.norm(world.positions[4] - bodies.mean(axis=0))
        assert 2 <= distance / spread <= 3


def test_the_loop_cannot_peek(tmp_path):
    """Nothing that the folder of the data holds depends on what is undeclared, but the tracks."""
    secret = [
        effect("drag", 0.123, is_declared=False), effect("exponent", 1.9, is_declared=False),
        effect("hidden", 3.21, is_declared=False),
    ]  # fmt: skip
    plain, open_truth = made("nbody", n_scenes=5)
    dataset, truth = made("nbody", *secret, n_scenes=5)
    for name, each in (("a", plain), ("b", dataset)):
        save_dataset(each, tmp_path / name)
    (tmp_path / "b-truth").mkdir()
    fill_truth(truth, tmp_path / "b-truth", seed=7)
    assert sorted(p.name for p in (tmp_path / "b").iterdir()) == [
        ".bsp_gp", "dataset.toml", "entities.csv", "trajectories.csv",
    ]  # fmt: skip
    for name in ("dataset.toml", "entities.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert truth.declared == open_truth.declared
    told = json.loads((tmp_path / "b-truth" / "truth.json").read_text())
    assert [e["name"] for e in told["effects"]] == ["drag", "exponent", "hidden"]
    assert not any(e["is_declared"] for e in told["effects"])
    assert told["effects"][0]["laws"] == ["-0.123 [kg/s] * v_i"]
    assert "-0.123 [kg/s] * v_i" in told["acting"] and told["seed"] == 7
    assert told["declared"] == list(open_truth.declared)


def test_declared_effects_are_in_the_model():
    _, truth = made("nbody", effect("drag", 0.5), effect("exponent", 3.0))
    assert len(truth.declared) == 2 and truth.declared == truth.acting
    assert "norm(p_i - p_j)^3" in truth.declared[0]
    dataset, truth = made(
        "nbody", effect("pair", 2.0, column="colour"), substeps=1, has_contacts=False
    )
    assert truth.declared[1].count("colour") == 2
    law = declared_law(dataset, truth.declared)
    assert one_step_nrmse(dataset.scenes, law) < 1e-9
    assert all("colour" in e.properties for e in dataset.scenes[0].entities)


LAWS = [
    ("drag", 0.3, {}), ("drag", 0.3, {"wind": 4.0, "angle": 90.0}), ("quadratic_drag", 0.05, {}),
    ("wind", 2.0, {"angle": 30.0}), ("field", 1.5, {}), ("perpendicular", 0.4, {}),
    ("magnetic", 0.4, {}), ("friction", 0.5, {}), ("pair", -2.0, {}), ("pair", 2.0, {"power": 3.0}),
    ("pair", 2.0, {"column": "colour", "power": 1.5}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value", "options"), LAWS)
def test_laws_of_effects_say_what_acts(name, value, options):
    """Accelerations from the law's text equal those that the bodies show, in the limit."""
    change = effect(name, value, **options)
    dataset, truth = made(
        "magnet", change, n_frames=5, dt=1e-3, substeps=1, has_contacts=False, n_scenes=3,
        speed=(1, 2), repulsion=1e-9,
    )  # fmt: skip
    law = declared_law(dataset, truth.declared)
    nothing = one_step_nrmse(dataset.scenes, declared_law(dataset, ()))
    assert one_step_nrmse(dataset.scenes, law) < 2e-3 * nothing


def test_noise_is_as_asked_for():
    for memory in (0.0, 0.8):
        observation = Observation(0.3, memory)
        errors = observation.errors((4000, 5, 2), np.random.default_rng(1))
        n_eff = errors.size * (1 - memory**2) / (1 + memory**2)
        assert np.std(errors) == pytest.approx(0.3, rel=4 / math.sqrt(2 * n_eff))
        correlation = np.mean(errors[1:] * errors[:-1]) / 0.09
        assert correlation == pytest.approx(memory, abs=4 / math.sqrt(n_eff))
        assert np.std(errors[0]) < 3 * 0.3  # the first frame is as good as any


def test_outliers_are_as_many_and_as_large_as_asked_for():
    errors = Observation(1.0, 0.0, 0.1, 50.0).errors((5000, 4, 2), np.random.default_rng(2))
    is_outlier = np.abs(errors).max(axis=-1) > 6
    missed = 1 - math.erf(6 / 50 / math.sqrt(2)) ** 2  # of outliers, seen beyond 6
    assert is_outlier.mean() == pytest.approx(0.1 * missed, abs=4 * math.sqrt(0.09 / 20000))


def test_only_what_moves_is_noisy_and_truth_is_exact():
    noisy, truth = made("bounce", noise=0.1, n_scenes=2)
    exact, _ = made("bounce", n_scenes=2)
    difference = positions(noisy) - positions(exact)
    assert np.all(difference[:, :, 4:] == 0)
    assert 0.08 < difference[:, :, :4].std() < 0.12
    np.testing.assert_array_equal(truth.states.positions, positions(exact))
    np.testing.assert_array_equal(truth.scene(1).positions, exact.scenes[1].positions)
    undeclared, _ = made("bounce", noise=0.1, is_declared=False)
    assert noisy.noise == (0.1,) and undeclared.noise is None


def test_every_number_can_be_set():
    settings = preset("bounce")
    numbers = numbers_of(settings)
    assert {"n_bodies", "mass", "radius", "restitution", "iterations", "dt", "memory"} <= set(
        numbers
    )
    changed = configured(
        settings, n_bodies=2, mass=(1, 2), radius=5, restitution=0.9, noise=0.1, dt=0.01, up="y"
    )
    assert changed.layout.radius == (5, 5) and changed.contacts.restitution == 0.9
    assert changed.observation.noise == 0.1 and changed.dt == 0.01
    dataset, _ = make(changed, np.random.default_rng(0))
    masses = [e.mass for e in dataset.scenes[0].entities if not e.is_static]
    assert len(masses) == 2 and all(1 <= m <= 2 for m in masses)
    assert configured(preset("nbody"), pull=1.0).forces[0].strength == 1.0
    texts = {"mass": "0.5..2", "radius": "3", "n_bodies": "3", "has_contacts": "no", "up": "none"}
    assert read_numbers(settings, texts) == {
        "mass": (0.5, 2.0), "radius": (3.0, 3.0), "n_bodies": 3, "has_contacts": False, "up": None,
    }  # fmt: skip


@pytest.mark.parametrize(("name", "count"), [("nbody", 7), ("mat", 3), ("magnet", 1), ("fall", 4)])
def test_the_number_of_bodies_can_be_set(name, count):
    dataset, _ = made(name, n_bodies=count)
    assert sum(not e.is_static for e in dataset.scenes[0].entities) == count


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (lambda: preset("orbit"), "preset must be one of nbody"),
        (lambda: preset("nbody", mas=1), "there is no number 'mas'; those of nbody are"),
        (lambda: preset("nbody", mass=(3, 1)), "mass must be a number or a range"),
        (lambda: preset("nbody", mass=0), "mass must be positive"),
        (lambda: preset("nbody", n_scenes=0), "n_scenes must be at least 1"),
        (lambda: preset("nbody", n_bodies=2.5), "n_bodies must be a whole number"),
        (lambda: preset("nbody", noise=-1), "noise must not be negative"),
        (lambda: preset("nbody", up="z"), "up must be x, y"),
        (lambda: preset("bounce", [effect("exponent", 2.0)]), "there is none"),
        (lambda: preset("bounce", [effect("hidden", 2.0)]), "a hidden body acts by its mass"),
        (lambda: preset("bounce", [effect("dashpot", 1.0)]), "take the preset pucks"),
        (lambda: preset("pucks", [effect("inelastic", 0.5)]), "dashpot damps its soft discs"),
        (lambda: preset("pucks", [effect("mat", 0.5)]), "adds a body without a radius"),
        (lambda: made("bounce", n_bodies=40), "found no places"),
        (lambda: made("bounce", radius=60), "must fit into the room"),
        (lambda: effect("drog", 1.0), "effect must be one of drag"),
        (lambda: effect("drag", 1.0, period=2), "has no option 'period'; it has wind, angle"),
        (lambda: effect("hidden", 1.0, x=2.0), "needs both x and y"),
        (lambda: parse_effect("drag"), "must be NAME=VALUE"),
        (lambda: parse_effect("drag=fast"), "must be a finite number"),
        (lambda: parse_effect("push=1,period=1,period=2"), "gives 'period' twice"),
        (lambda: read_numbers(preset("nbody"), {"mass": "a..b"}), "a number or a range"),
        (lambda: read_numbers(preset("nbody"), {"colour": "1"}), "there is no number 'colour'"),
    ],
)
def test_bad_settings_are_named(bad, message):
    with pytest.raises(SettingsError, match=message):
        bad()


def test_effects_are_read_from_text():
    push = parse_effect(" push=2, period=0.5,angle=90 ", is_declared=False)
    (force,) = push.forces
    assert (force.strength, force.period, force.angle) == (2.0, 0.5, 90.0)
    assert not push.is_declared
    assert parse_effect("pair=3,column=colour").new_property.name == "colour"


def test_worlds_of_ones_own():
    world = World([disc("ball", 0.1, 1.0)], [(0, 1)], [(1, 0)])

    class Mine(Layout):
        def draw(self, rng):
            return world

    settings = Settings("mine", Mine(), n_frames=5)
    dataset, _ = make(settings, np.random.default_rng(0))
    np.testing.assert_allclose(dataset.scenes[0].positions[-1, 0], (0.08, 1))


def test_another_engine_can_move_the_worlds():
    def frozen(worlds, motion):
        from bsp_gp.simulate.engine import run_pymunk

        return run_pymunk(
            [World(w.entities, w.positions, 0 * w.velocities) for w in worlds],
            dataclasses.replace(motion, forces=()),
        )

    dataset, _ = make(preset("magnet"), np.random.default_rng(0), frozen)
    assert np.ptp(dataset.scenes[0].positions, axis=0).max() == 0


def test_states_of_the_truth_are_those_of_every_step(tmp_path):
    _, truth = made("mat", n_scenes=2)
    fill_truth(truth, tmp_path)
    assert len(pd.read_csv(tmp_path / "states.csv")) == 2 * 12 * 2


def test_contacts_are_recorded():
    _, truth = made("bounce", n_scenes=3, n_frames=51, substeps=1)
    told = truth.to_dict()["scenes"]
    masses = truth.settings.layout
    assert masses.n_bodies == 4
    for k, scene in enumerate(told):
        v = truth.states.velocities[k]
        turned = np.flatnonzero(np.abs(np.diff(v, axis=0)).max(axis=(1, 2)) > 1e-9) + 1
        assert scene["frames_with_contact"] == turned.tolist()
        assert len(turned) > 0


def test_true_accelerations_are_those_of_the_motion():
    """A leapfrog step a frame: second differences are accelerations."""
    dark = effect("hidden", 300.0, is_declared=False, x=0.0, y=200.0)
    dataset, truth = made("nbody", dark, n_scenes=2, substeps=1, has_contacts=False)
    p = positions(dataset)
    second = (p[:, 2:] - 2 * p[:, 1:-1] + p[:, :-2]) / 0.02**2
    a = truth.accelerations()
    np.testing.assert_allclose(a[:, 1:-1], second, atol=1e-8)
    missing = a - truth.accelerations(of_declared=True)
    gap = np.array([0.0, 200.0]) - p
    pull = 8167.007 * 300 * gap / np.linalg.norm(gap, axis=-1, keepdims=True) ** 3
    np.testing.assert_allclose(missing, pull, atol=1e-9)


def test_what_is_undeclared_is_what_a_loop_has_to_find():
    changes = [effect("drag", 0.3, is_declared=False), effect("wind", 2.0)]
    dataset, truth = made("magnet", *changes, n_scenes=2, has_contacts=False)
    missing = truth.accelerations() - truth.accelerations(of_declared=True)
    masses = np.array([[e.mass for e in scene.entities] for scene in dataset.scenes])
    drag = -0.3 * truth.states.velocities / masses[:, None, :, None]
    np.testing.assert_allclose(missing, drag, atol=1e-12)
