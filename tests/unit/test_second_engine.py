"""Effects of pymunk's worlds against engines that share no code with it (extra `engines`)."""

import numpy as np
import pytest

from bsp_gp.errors import SettingsError
from bsp_gp.simulate.effects import effect
from bsp_gp.simulate.engine import Contacts, Motion, run_pymunk
from bsp_gp.simulate.synth import make, preset
from bsp_gp.simulate.world import World, disc, wall

pytest.importorskip("rebound", reason="pip install 'bsp_gp[engines]'")
pytest.importorskip("mujoco", reason="pip install 'bsp_gp[engines]'")
from experiments.second_engine import run_mujoco, run_rebound  # noqa: E402

# Without contacts these are exact to 1e-6 or better.
ORBITS = {"distance": (60, 100), "mass": (1, 9), "n_frames": 16, "has_contacts": False}
HIDDEN = {"near": 3.0, "far": 4.0}


def tracks(name, effects, engine, **numbers):
    """Exact positions, shape (S, T, N, 2)."""
    settings = preset(name, effects, n_scenes=2, **numbers)
    return make(settings, np.random.default_rng(4), engine)[1].states.positions


@pytest.mark.slow
@pytest.mark.parametrize("engine", [run_rebound, run_mujoco])
@pytest.mark.parametrize(
    "change",
    [
        effect("drag", 0.5),
        effect("drag", 0.5, wind=20.0, angle=40.0),
        effect("quadratic_drag", 0.01),
        effect("perpendicular", 1.5),
        effect("magnetic", 1.5),
        effect("pair", -1e4),
        effect("exponent", 2.02),
        effect("field", 50.0, angle=20.0),
        effect("hidden", 100.0, **HIDDEN),
        effect("hidden", 100.0, moves=True, speed=90.0, **HIDDEN),
    ],
    ids=lambda e: e.name,
)
def test_an_effect_is_the_same_in_another_engine(engine, change):
    """The difference is the leapfrog's own error: four times less with half the step."""
    steps = {"substeps": 20, **ORBITS} if engine is run_mujoco else {"substeps": 1, **ORBITS}
    other = tracks("nbody", [change], engine, **steps)
    plain = tracks("nbody", [], run_pymunk, substeps=20, **ORBITS)
    n = plain.shape[2]
    errors = [
        np.abs(tracks("nbody", [change], run_pymunk, substeps=s, **ORBITS) - other).max()
        for s in (20, 40)
    ]
    assert 3.3 < errors[0] / errors[1] < 4.7
    assert errors[0] < 0.05 * np.abs(other[:, :, :n] - plain).max()


@pytest.mark.parametrize("name", ["spring", "push", "wind"])
def test_springs_and_pushes_are_the_same_in_mujoco(name):
    numbers = {"has_contacts": False, "has_table": False, "n_frames": 30}
    change = effect(name, 0.5)
    plain = tracks("fall", [], run_pymunk, substeps=20, **numbers)
    other = tracks("fall", [change], run_mujoco, substeps=20, **numbers)
    ours = tracks("fall", [change], run_pymunk, substeps=20, **numbers)
    assert np.abs(ours - other).max() < 2e-3 * np.abs(other - plain).max()


@pytest.mark.slow
def test_soft_contacts_are_the_same_in_mujoco():
    change = effect("dashpot", 2.0)
    plain = tracks("pucks", [], run_pymunk, substeps=100, n_frames=40)
    other = tracks("pucks", [change], run_mujoco, substeps=20, n_frames=40)
    ours = tracks("pucks", [change], run_pymunk, substeps=100, n_frames=40)
    assert np.abs(ours - other).max() < 1e-2 * np.abs(other - plain).max()


def two_discs(engine, restitution, substeps):
    """Velocities after a glancing collision."""
    world = World([disc("a", 1, 2), disc("b", 1, 1)], [(0, 0), (4, 0.8)], [(3, 0), (-1, 0)])
    motion = Motion((), 51, 0.02, substeps, Contacts(restitution=restitution))
    return engine([world], motion).velocities[0, -1]


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_contact_of_discs_is_that_of_rebound(restitution):
    ours = two_discs(run_pymunk, restitution, 50)
    np.testing.assert_allclose(ours, two_discs(run_rebound, restitution, 50), atol=1e-9)


def test_elastic_contact_of_discs_and_walls_is_that_of_mujoco():
    """Mujoco's contacts are springs that last 2 ms, hence the tolerance."""
    np.testing.assert_allclose(
        two_discs(run_pymunk, 1.0, 100), two_discs(run_mujoco, 1.0, 100), atol=0.02
    )
    world = World([disc("a", 1, 3), wall("w", 2, 20)], [(0, 0), (4, 0)], [(5, 1), (0, 0)])
    motion = Motion((), 51, 0.02, 100)
    ours, other = (e([world], motion).velocities[0, -1, 0] for e in (run_pymunk, run_mujoco))
    np.testing.assert_allclose(ours, (-5, 1), atol=1e-12)
    np.testing.assert_allclose(other, ours, atol=0.05)


def test_what_an_engine_has_not_is_refused():
    with pytest.raises(SettingsError, match="rebound has no walls"):
        tracks("bounce", [], run_rebound)
    with pytest.raises(SettingsError, match="mujoco is not taught MatFriction"):
        tracks("mat", [], run_mujoco)
