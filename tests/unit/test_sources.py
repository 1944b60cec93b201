"""Bodies that act on all others by strengths of their own, which nobody has told."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.law_fit import constant_estimates
from bsp_gp.fitting.parts.latents import Properties
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.proposers.sources import Sources, _gravity
from bsp_gp.loop.view import View
from bsp_gp.physics.masses import with_usable_masses
from bsp_gp.planning.means import Body, Experiment, means_from
from bsp_gp.report.page import page_of
from tests.throws import SI

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


def charged(charges, masses):
    """Bodies that push each other apart by the product of two charges over distance squared."""
    rng, scenes, times = np.random.default_rng(6), [], np.linspace(0.0, 2.0, 61)
    charges, masses = np.array(charges), np.array(masses)
    size = 2 * len(charges)

    def rates(_, state):
        places = state[:size].reshape(-1, 2)
        gaps = places[:, None] - places[None]
        distance = np.linalg.norm(gaps, axis=2, keepdims=True)
        distance[distance == 0] = 1.0
        force = (charges[:, None, None] * charges[None, :, None] * gaps / distance**3).sum(axis=1)
        return np.concatenate([state[size:], (force / masses[:, None]).ravel()])

    for number in range(4):
        angle = 2 * np.pi * (np.arange(len(charges)) / len(charges) + rng.uniform())
        start = 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        begin = np.concatenate([start.ravel(), rng.uniform(-0.3, 0.3, size)])
        moved = solve_ivp(rates, (0, 2), begin, t_eval=times, rtol=1e-9, atol=1e-10).y
        places = moved[:size].T.reshape(-1, len(charges), 2)
        places = places + 0.001 * rng.standard_normal(places.shape)
        # Which body comes first is another one in every scene.
        order = rng.permutation(len(charges))
        crew = tuple(Entity("ABC"[k], properties={"mass": masses[k]}) for k in order)
        scenes.append(Scene(str(number), times, places[:, order], crew))
    return Dataset("charged", tuple(scenes), noise=(0.001,), units=SI)


def test_charges_of_both_bodies_are_proposed_with_their_signs():
    charges = np.array([1.0, 0.5, -0.7])
    found = [p for p in proposals(charged(charges, (0.4, 0.6, 0.5))) if "_i * strength" in p.text]
    assert found and "^-2" in found[0].text and found[0].text.endswith("normalize(p_i - p_j)")
    (part,) = [p for p in found[0].hypothesis.parts if isinstance(p, Properties)]
    told = dict(zip(part.names, part.starts, strict=True))
    told = np.array([told[f"strength1[{name}]"] for name in "ABC"])
    np.testing.assert_allclose(told * np.sign(told[0]), charges, rtol=0.1)


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


# --- two stars ------------------------------------------------------------------------------------

SUNS, YEAR, AU = np.array([1.5, 0.6]), 365.25 * 86400, 1.495978707e11


def stars(masses=None, n=60, sigma=0.01, seed=0):
    """Two stars about their middle, in au and years, of 1.5 and 0.6 suns."""
    total, axis, bent = SUNS.sum(), 4.0, 0.3
    near = axis * (1 - bent)
    fast = np.sqrt(4 * np.pi**2 * total * (1 + bent) / near)
    times = np.linspace(0, 1.3 * axis**1.5 / np.sqrt(total), n)

    def rates(_, z):
        return [*z[2:], *(-4 * np.pi**2 * total * z[:2] / np.hypot(*z[:2]) ** 3)]

    ways = solve_ivp(rates, (0, times[-1]), [near, 0, 0, fast], t_eval=times, rtol=1e-10,
                     atol=1e-12).y[:2].T  # fmt: skip
    noise = sigma * np.random.default_rng(seed).standard_normal((2, n, 2))
    shares = {"A": -SUNS[1] / total, "B": SUNS[0] / total}
    rows = [
        {"t": t, "entity": name, "x": share * way[0] + off[0], "y": share * way[1] + off[1]}
        for (name, share), own in zip(shares.items(), noise, strict=True)
        for t, way, off in zip(times, ways, own, strict=True)
    ]  # fmt: skip
    known = {} if masses is None else {"properties": {"mass": masses}}
    return bsp_gp.Dataset.from_frames(
        pd.DataFrame(rows), units={"length": "au", "time": "yr"}, **known
    )


def test_the_masses_of_two_stars_are_asked_for_where_nobody_says_them():
    """Told was a pull as the speed over the distance: of two stars the lighter one is faster."""
    data = with_usable_masses(stars())
    (best,) = proposals(data)
    assert best.code == "gravity"
    found = fit(best.hypothesis, data, starts=best.starts)
    told = {c.name: c for c in constant_estimates(found, data)}
    for name, mass in zip("AB", SUNS, strict=True):
        own = told[f"mass[{name}]"]
        assert own.unit == "kg" and own.value == pytest.approx(mass * 1.98841e30, rel=0.01)
        assert own.high / own.low < 1.02


def test_masses_that_are_said_are_not_asked_for():
    assert not proposals(stars("A:1.5[Msun],B:0.6[Msun]"))


@pytest.mark.slow
def test_two_stars_are_told_by_their_masses():
    report = bsp_gp.close_loop(stars(), "nothing", rng=0, n_bootstrap=0)
    (done,) = [r for r in report.rounds if r.adopted]
    assert (report.verdict, done.effect.code) == ("effect adopted", "gravity")
    name = page_of(report).rounds[0].effect.name
    assert name == "pull to the other body, as distance⁻², by masses that it tells"


def test_a_body_that_moments_tell_to_push_has_a_mass_all_the_same():
    """A planet of no mass ended the run."""
    view = SimpleNamespace(
        hypothesis=Hypothesis(()), criteria=Criteria(), dataset=SimpleNamespace(n_dims=2)
    )
    proposal = _gravity(view, ["sun", "mars"], np.array([4e-10, -1e-12]), 2, 50.0)
    (masses,) = (p for p in proposal.hypothesis.parts if isinstance(p, Properties))
    assert min(masses.starts) > masses.parameters[0].low > 0
