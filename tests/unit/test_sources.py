"""Bodies that act on all others by strengths of their own, which nobody has told."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.latents import Properties
from bsp_gp.loop.proposers.sources import Sources
from bsp_gp.loop.view import View
from bsp_gp.planning.means import Body, Experiment, means_from

SIGMA, TIMES = 0.02, np.linspace(0.0, 6.0, 31)
STARTS = np.array([[-4.0, 1.0], [3.0, 3.5], [1.0, -4.0]])


def world(strengths, power, n_scenes=3):
    """Bodies, and a probe on which they act and that acts on none, known where they begin."""
    rng, scenes = np.random.default_rng(5), []
    strengths = np.array([*strengths, 0.0])
    means = means_from({
        "bodies": {"body": {"x": 0.0, "y": 0.0}}, "look": {"until": 6.0, "noise": SIGMA}
    })  # fmt: skip
    for number in range(n_scenes):
        start = np.vstack([STARTS, rng.uniform(-5, 5, 2)])
        speed = np.vstack([np.zeros_like(STARTS), rng.uniform(-0.5, 0.5, 2)])

        def rates(_, state, shape=start.shape):
            places = state[: len(state) // 2].reshape(shape)
            gaps = places[None] - places[:, None]
            distance = np.linalg.norm(gaps, axis=2, keepdims=True)
            distance[distance == 0] = 1.0
            pulls = (strengths[None, :, None] * gaps * distance ** (power - 1)).sum(axis=1)
            return np.concatenate([state[len(state) // 2 :], pulls.ravel()])

        begin = np.concatenate([start.ravel(), speed.ravel()])
        moved = solve_ivp(rates, (0, 6), begin, t_eval=TIMES, rtol=1e-9, atol=1e-10).y
        places = moved[: start.size].T.reshape(-1, *start.shape)
        places[1:] += SIGMA * rng.standard_normal(places[1:].shape)
        bodies = tuple(
            Body(name, tuple(p), tuple(v))
            for name, p, v in zip("ABCP", start.tolist(), speed.tolist(), strict=True)
        )
        experiment = Experiment(bodies, tuple(TIMES.tolist()))
        sigma = np.full(places.shape, SIGMA)
        scenes.append(experiment.scene(f"recording {number}", places, sigma=sigma))
    return means.dataset(scenes)


def proposals(data):
    hypothesis = Hypothesis.from_laws(data, ["nothing"])
    return Sources().propose(View(fit(hypothesis, data), hypothesis, data,
                                  np.random.default_rng(0))).proposals  # fmt: skip


def test_strengths_of_their_own_are_proposed_with_the_power_of_the_distance():
    best = proposals(world((0.15, 0.45, -0.3), -1))[0]
    assert "norm(p_i - p_j)^-1 " in best.text and best.code == "law_by_source"
    part = next(p for p in best.hypothesis.parts if isinstance(p, Properties))
    found = dict(zip(part.names, part.starts, strict=True))
    assert found["strength1[B]"] > found["strength1[A]"] > 0 > found["strength1[C]"]


def test_a_body_may_be_held_in_one_recording_and_move_in_another():
    """The one that moves stands first: so built alike, these recordings are looked at as one."""
    rng, times, scenes = np.random.default_rng(0), np.linspace(0.0, 2.0, 21), []
    for order in ("ABC", "BAC", "CAB"):
        bodies = tuple(
            Body(name, (3.0 * k, 0.0), (0.0, 0.3 * (k == 0)), {}, k > 0)
            for k, name in enumerate(order)
        )
        places = np.repeat([[b.position for b in bodies]], len(times), axis=0)
        places[:, 0, 1] += 0.3 * times + SIGMA * rng.standard_normal(len(times))
        experiment = Experiment(bodies, tuple(times.tolist()))
        scenes.append(experiment.scene(f"recording {order[0]}", places))
    means = means_from({"bodies": {"body": {"x": 0.0}}, "look": {"until": 2.0, "noise": SIGMA}})
    data = means.dataset(scenes)
    hypothesis = Hypothesis.from_laws(data, ["nothing"])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(0))
    (batch,) = view.response.regression.batches
    np.testing.assert_allclose(batch.positions[0, :, 1:, 0], [[3.0, 6.0]] * 3)
    assert Sources().propose(view).n_tried > 0


@pytest.mark.slow
def test_hidden_charges_are_found_and_hold_in_recordings_that_were_left_out():
    strengths = (0.15, 0.45, -0.3)
    report = bsp_gp.close_loop(world(strengths, -1, 5), rng=0, n_bootstrap=0)
    (done, *_) = report.rounds
    assert done.adopted and done.effect.code == "law_by_source"
    found = {c.name: c for c in report.constants}
    for name, true in zip("ABCP", (*strengths, 0.0), strict=True):
        one = found[f"strength1[{name}]"]
        assert abs(one.value - true) < 3 * (one.high - one.low) / 1.645
    before, after = (report.total[key].rollout_rmse for key in ("before", "after"))
    assert after < 0.1 * before
