"""Pushes with a period: found where one is, with its rate, and as often as chance allows else."""

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.proposers.defects import Defects
from bsp_gp.loop.proposers.periods import Periods
from bsp_gp.loop.view import selected
from tests.loop_views import throws, view_of
from tests.throws import SI

RATE = 4 * np.pi


def shaken(force, has_mass=False):
    """Displacement by ``force * cos(RATE t)`` along x."""

    def move(t, mass):
        size = force / (1 if has_mass else mass)
        return size * (1 - np.cos(RATE * t))[:, None] / RATE**2 * [1, 0]

    return move


@pytest.mark.slow
@pytest.mark.parametrize("has_mass", [False, True])
def test_a_period_is_found_with_its_rate_axis_and_mass(has_mass):
    force = 2.0 if has_mass else 0.5
    data = throws(np.random.default_rng(3), n_scenes=6, move=shaken(force, has_mass))
    view = view_of(data)
    family = Periods().propose(view)
    assert selected(family.gain, family.rank, family.null, view.noise_dof) < 1e-9
    fits = [fit(p.hypothesis, data, starts=p.starts, bounds=p.bounds) for p in family.proposals]
    heights = [
        log_evidence(f, p.hypothesis) + p.log_prior
        for f, p in zip(fits, family.proposals, strict=True)
    ]
    k = int(np.argmax(heights))
    best, found = family.proposals[k], fits[k].law.constants
    assert best.code == "period"
    assert ("m_i" in best.text) == has_mass
    assert "e_x" in best.text
    assert "e_y" not in best.text
    assert found["w1"] == pytest.approx(RATE, rel=0.02)
    assert best.starts["w1"] == pytest.approx(found["w1"], rel=0.003)  # sought between the grid's
    assert np.hypot(found["a1"], found["b1"]) == pytest.approx(force, rel=0.1)
    assert heights[k] > log_evidence(view.fit, view.hypothesis) + 10


def test_gains_are_those_of_a_score_test_of_the_same_columns():
    view = view_of(throws(np.random.default_rng(5), move=shaken(0.05)))
    family = Periods().propose(view)
    alone = next(p for p in family.proposals if p.text.count("e_") == 1 and "m_i" not in p.text)
    axis = 0 if "e_x" in alone.text else 1
    rate = next(iter(alone.starts.values()))
    columns = []
    for wave in (np.cos, np.sin):
        parts = []
        for batch in view.response.regression.batches:
            push = np.zeros(batch.valid.shape)
            mass = batch.bodies.column("mass")[:, batch.bodies.receivers]
            push[..., axis] = wave(rate * batch.times)[:, :, None] / mass
            parts.append(batch.whiten(push).ravel())
        columns.append(np.concatenate(parts))
    assert view.score_forces(np.stack(columns, axis=1)).statistic == pytest.approx(alone.gain)


def test_equal_masses_make_one_variant_with_a_tie():
    data = throws(np.random.default_rng(5), n_scenes=1)
    proposals = Periods().propose(view_of(data)).proposals
    assert len(proposals) == 6  # of one axis, the other, both: everywhere alike, and a trap's
    assert all("m_i" not in p.text and "m_i" in p.ties[0] for p in proposals)


@pytest.mark.slow
def test_noise_alone_is_called_missing_as_often_as_is_said():
    chances = {"periods": [], "defects": []}
    for seed in range(200):
        rng = np.random.default_rng([22, seed])
        view = view_of(throws(rng, n_bodies=2), seed=seed)
        for proposer in (Periods(), Defects()):
            f = proposer.propose(view)
            chances[f.name].append(selected(f.gain, f.rank, f.null, view.noise_dof, f.is_continuum))
    for name, values in chances.items():
        values = np.array(values)
        # Four standard deviations of a count of 200.
        assert np.sum(values < 0.05) <= 22, name
        assert 72 <= np.sum(values < 0.5) <= 128, name


def test_gains_of_many_numbers_are_told_as_of_two():
    gain = np.array([0.0, 3.0, 30.0, 400.0])
    for rank in (1, 2, 5, 40):
        assert stats.chi2.sf(as_pair(gain, rank), 2) == pytest.approx(stats.chi2.sf(gain, rank))
    # Beyond what a chance can be as a number: of four, exp(-x/2) (1 + x/2).
    assert as_pair(5000.0, 4) == pytest.approx(5000 - 2 * np.log(2501), abs=1e-3)
    assert as_pair(5000.0, 2) == pytest.approx(5000)


@pytest.mark.slow
def test_a_trap_that_oscillates_is_found():
    rate, scenes = 60.0, []
    t = np.linspace(0.0, 0.6, 121)

    def push(t, state):
        pull = 500.0 * np.cos(rate * t) * np.array([1.0, -1.0])
        return np.concatenate([state[2:], pull * state[:2]])

    rng = np.random.default_rng(4)
    for k in range(4):
        first = np.concatenate([rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.5, 0.5, 2)])
        path = solve_ivp(push, (0, 0.6), first, t_eval=t, rtol=1e-9, atol=1e-12).y[:2].T
        path = path + 5e-4 * rng.standard_normal(path.shape)
        scenes.append(Scene(str(k), t, path[:, None], (Entity("ion"),)))
    data = Dataset("trap", tuple(scenes), noise=(5e-4,), units=SI)
    best = Periods().propose(view_of(data, "-c * v_i")).proposals[0]
    assert "* x_i * e_x" in best.text
    assert "* y_i * e_y" in best.text
    found = fit(best.hypothesis, data, starts=best.starts, bounds=best.bounds)
    assert found.law.constants["w1"] == pytest.approx(rate, rel=1e-3)
    assert found.law.constants["a1"] == pytest.approx(500.0, rel=0.02)
    assert found.law.constants["g1"] == pytest.approx(-500.0, rel=0.02)
    assert found.chi2_red == pytest.approx(1.0, abs=0.15)
