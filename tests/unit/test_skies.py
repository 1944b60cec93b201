"""Made-up stars and beads: what they are, and that the loop is told nothing of it."""

import numpy as np
import pytest

from bsp_gp.loop.close import close_loop
from bsp_gp.simulate.forces import Kicks
from bsp_gp.simulate.skies import AU, NEWTON
from bsp_gp.simulate.synth import make, preset


def test_beads_have_the_temperature_of_what_kicks_them():
    settings = preset("beads", n_beads=40, n_frames=60, substeps=5)
    _, truth = make(settings, np.random.default_rng(0))
    v = truth.states.velocities[0, 20:]
    temperature = settings.layout.mass * np.mean(np.square(v)) / Kicks.BOLTZMANN
    assert temperature == pytest.approx(300.0, rel=0.1)
    assert not settings.declared


def test_kicks_differ_from_seed_to_seed_and_not_from_run_to_run():
    settings = preset("beads", n_frames=5)
    one, same, other = (make(settings, np.random.default_rng(k))[0].scenes[0].positions
                        for k in (1, 1, 2))  # fmt: skip
    assert np.array_equal(one, same)
    assert not np.allclose(one - one[0], other - other[0])


def test_stars_go_round_as_kepler_has_them():
    _, truth = make(preset("binary", n_frames=30), np.random.default_rng(3))
    world, states = truth.worlds[0], truth.states
    mass = sum(e.mass for e in world.entities)
    gap = states.positions[0, :, 1] - states.positions[0, :, 0]
    speed = states.velocities[0, :, 1] - states.velocities[0, :, 0]
    energy = np.square(speed).sum(axis=1) / 2 - NEWTON * mass / np.linalg.norm(gap, axis=1)
    assert energy == pytest.approx(energy[0], rel=1e-3)
    assert 4 < -NEWTON * mass / 2 / energy[0] / AU < 8


@pytest.mark.slow
def test_an_unseen_star_is_found_and_no_rod():
    settings = preset("star_about_unseen", noise=3e10)
    dataset, truth = make(settings, np.random.default_rng(0))
    assert dataset.scenes[0].names == ("A",) and not settings.declared
    report = close_loop(dataset, "nothing", rng=0, n_bootstrap=0)
    assert [r.effect.code for r in report.rounds if r.adopted] == ["hidden_body"]
    mass = next(c for c in report.constants if c.name == "M1")
    assert mass.value == pytest.approx(truth.worlds[0].entities[1].mass, rel=0.3)
