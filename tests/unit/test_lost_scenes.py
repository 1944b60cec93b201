"""Tracks that no path under a law follows, among others that it does."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import close_loop
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.followed import about_lost, followed
from bsp_gp.fitting.growing import seeds
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.parts.cut_short import CutShort
from bsp_gp.fitting.tracks import ChainNoise
from bsp_gp.loop.clock import Clock
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.proposal import Proposal, with_term
from bsp_gp.loop.turn import Turn
from bsp_gp.physics.engine.chains import build_chains
from tests.fitted_tracks import body, dataset_of, scene_of

GRAVITY = "1 [m^3/(kg s^2)] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"


def orbits(drag, odd=None, count=8, sigma=0.003):
    """Orbits about a heavy body with linear drag; `odd` comes out of it where no path leads."""
    rng, times = np.random.default_rng(1), np.linspace(0.0, 1.0, 31)

    def rate(t, y):
        return np.concatenate([y[2:], -40 * y[:2] / np.hypot(*y[:2]) ** 3 - drag * y[2:]])

    def path(start):
        return solve_ivp(rate, (0, 1), start, t_eval=times, rtol=1e-10, atol=1e-12).y[:2].T

    scenes = []
    for k in range(count):
        angle, speed = rng.uniform(0, 2 * np.pi), np.sqrt(40 / 3) * rng.uniform(0.7, 1.0)
        x, y = np.cos(angle), np.sin(angle)
        places = path(np.array([3 * x, 3 * y, -speed * y, speed * x]))
        if k == odd:
            fall = path(np.array([2.0, 0.1, -4.0, 0.0]))
            on = np.arange(31)[:, None] - 9
            places = np.where(on < 1, fall, fall[9] + on * np.array([0.15, 0.35]))
        seen = np.stack([places + rng.normal(0, sigma, places.shape), 0 * places], axis=1)
        crew = (body("planet"), body("sun", 40.0, is_static=True))
        scenes.append(scene_of(times, crew, seen, name=f"s{k}"))
    return dataset_of(tuple(scenes), noise=(sigma,))


@pytest.mark.slow
def test_a_track_that_no_path_follows_is_named():
    dataset = orbits(0.3, odd=5)
    found = fit(Hypothesis.from_laws(dataset, read_law(dataset, [GRAVITY])), dataset)
    assert found.status == "unconverged"
    ((scene, bodies, row),) = [(cut.scene, cut.bodies, cut.row) for cut in found.lost]
    assert (scene, bodies) == ("s5", ("planet",)) and 8 <= row <= 10
    alone = orbits(0.3)
    found = fit(Hypothesis.from_laws(alone, read_law(alone, [GRAVITY])), alone)
    assert (found.status, found.lost) == ("refuted", ())


@pytest.mark.slow
def test_such_a_track_hides_nothing_of_what_acts_in_the_others():
    dataset = orbits(0.3, odd=5)
    declared = Hypothesis.from_laws(dataset, read_law(dataset, [GRAVITY, "-c * v_i"]))
    found, hypothesis = followed(declared, dataset)
    (note,) = about_lost(hypothesis)
    assert "planet in scene s5 before row" in note and found.status == "converged"
    assert abs(found.values[0] - 0.3) < 3 * found.errors[0] < 0.02
    # What came before tells the law as well.
    k = found.channels.scene_names.index("s5")
    seen = np.isfinite(found.residual[:, found.channels.scene == k]).all(axis=1)
    assert seen[:8].all() and not seen[10:].any()
    assert hypothesis.log_density < declared.log_density == 0.0


def test_such_tracks_are_told():
    dataset = orbits(0.3)
    declared = Hypothesis.from_laws(dataset, read_law(dataset, [GRAVITY]))
    assert about_lost(declared) == ()
    cuts = CutShort("s5", 9, bodies=("planet",)), CutShort("s6", 4, bodies=("a", "b"))
    (note,) = about_lost(declared + Hypothesis(cuts))
    assert "planet in scene s5 before row 9; a, b in scene s6 before row 4;" in note


def test_a_track_is_cut_where_it_turns_and_leads_as_before():
    dataset = orbits(0.3, odd=5)
    law = read_law(dataset, [GRAVITY])
    groups = tuple(build_chains(law, dataset.scenes))
    chain = groups[0].scenes.index("s5")
    cut = CutShort.at_turn(groups[0], chain, dataset.scenes[5])
    assert (cut.scene, cut.bodies) == ("s5", ("planet",)) and 8 <= cut.row <= 10
    assert cut.n_left_out == 2 * (31 - cut.row)
    (after,) = cut.followed(groups)
    lengths = np.full(8, 31)
    lengths[chain] = cut.row
    assert after.lengths.tolist() == lengths.tolist()
    assert np.array_equal(after.driven, groups[0].driven)
    others = np.arange(8) != chain
    assert np.array_equal(after.observed[:, others], groups[0].observed[:, others])


def test_a_turn_is_found_in_noise_that_hides_it_from_row_to_row():
    rng, times = np.random.default_rng(2), np.linspace(0.0, 1.0, 101)
    crew, off = (body("ball"),), []
    for _ in range(40):
        row = rng.integers(20, 80)
        x = np.where(times < times[row], times, 2 * times[row] - times)
        places = np.stack([x, 0.3 * times], axis=1)[:, None]
        scene = scene_of(times, crew, places + rng.normal(0, 0.02, places.shape), name="s")
        (chains,) = build_chains(read_law(dataset_of((scene,)), ["-c * v_i"]), (scene,))
        off.append(CutShort.at_turn(chains, 0, scene).row - row)
    assert np.mean(np.abs(off) <= 6) > 0.9


def test_a_body_is_cut_in_whatever_chain_it_is():
    times = np.linspace(0.0, 1.0, 21)
    places = np.stack([np.stack([times, k + times], axis=1) for k in (0, 1)], axis=1)
    scene = scene_of(times, (body("a"), body("b")), places, name="s")
    data = dataset_of((scene,))
    alone = tuple(build_chains(read_law(data, ["-c * v_i"]), (scene,)))
    pair = tuple(build_chains(read_law(data, [GRAVITY]), (scene,)))
    cut = CutShort("s", 10, bodies=("a",), n_left_out=22)
    (apart,), (both,) = cut.followed(alone), cut.followed(pair)
    assert apart.lengths.tolist() == [10, 21] and both.lengths.tolist() == [21]
    assert np.isfinite(both.observed[:10]).all() and np.isfinite(both.observed[:, 0, 1]).all()
    assert np.isnan(both.observed[10:, 0, 0]).all()
    (left,) = CutShort("s", 10, bodies=("a", "b")).followed(alone)
    assert left.lengths.tolist() == [10, 10]


def test_bodies_at_rest_and_unseen_ones_are_cut_without_complaint():
    times = np.linspace(0.0, 1.0, 21)
    for places in (np.zeros((21, 1, 2)), np.full((21, 1, 2), np.nan)):
        scene = scene_of(times, (body("a"),), places, name="s")
        (chains,) = build_chains(read_law(dataset_of((scene,)), ["-c * v_i"]), (scene,))
        cut = CutShort.at_turn(chains, 0, scene)
        assert cut.row == 2 and np.isfinite(cut.log_density)


@pytest.mark.slow
def test_a_law_that_nobody_declared_is_fitted_to_tracks_as_far_as_it_follows_them():
    report = close_loop(orbits(0.0, odd=1), rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    (term,) = report.law.terms
    assert "m_i * m_j * inverse(norm(p_i - p_j)^2)" in report.law.text()
    (value,) = (report.law.constants[name] for name in term.formula.constants)
    assert value == pytest.approx(-1.0, rel=0.01)
    assert any("planet in scene s1 before row" in note for note in report.dataset["notes"])


def test_what_a_cut_gives_the_base_is_not_earned_by_a_law():
    dataset = orbits(0.0, odd=1)
    law = Hypothesis.from_laws(dataset, read_law(dataset, [GRAVITY]))
    free = Hypothesis.from_laws(dataset, [])
    cut = CutShort("s1", 4, bodies=("planet",), n_left_out=54, extent=7.0)
    prices = []
    for base in (law, free):
        found = fit(base + cut, dataset)
        if base is law:  # as of all rows, of which those that are cut misfit
            worse = {"log_likelihood": -300.0, "log_evidence": -300.0}
            found = replace(found, status="refuted", **worse)
        turn = Turn(
            SimpleNamespace(
                criteria=Criteria(), dataset=dataset, bounds={}, clock=Clock(None), proposers=(),
            ), found, base,
        )  # fmt: skip
        drag = with_term(base, read_law(dataset, ["-c * v_i"]).terms[0], {})
        own = Proposal("law", "-c v", drag + cut, -3.0, 10.0, bounds={"c": (0.0, 9.0)})
        prices.append(turn._price_of_cuts(own))
    declared, nothing = prices
    assert declared > 300.0 and nothing == Criteria().cause_nats


@pytest.mark.parametrize("row", [1, 2])
def test_tracks_cut_after_two_rows_are_no_places_to_begin(row):
    dataset = orbits(0.3)
    cut = CutShort("s5", row, bodies=("planet",), n_left_out=58, extent=6.0)
    (chains,) = cut.followed(tuple(build_chains(read_law(dataset, [GRAVITY]), dataset.scenes)))
    noise = ChainNoise(chains.times, np.ones(chains.observed.shape))
    first, stop, turn = seeds(chains, noise, 5)
    k = chains.scenes.index("s5")
    assert (first[k], stop[k]) == (0, row) and np.argmax(turn) == k and np.isfinite(turn).all()
