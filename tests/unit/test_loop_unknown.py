"""Unknown properties in fits and in the new loop: found, left at their priors, held out."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, LatentDeclaration, Scene
from bsp_gp.errors import SettingsError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import held_out_rows
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.law_fit import constant_estimates
from bsp_gp.fitting.parts.latents import unknown_properties
from bsp_gp.fitting.response import respond
from bsp_gp.inference.latents import declared_latents
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.kept import rounds_from, text_of
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.table import held_out_gain
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion
from tests.fitted_tracks import law_of
from tests.planted import GRAVITY
from tests.throws import SI
from tests.worlds import moved

WEIGHT, DRAG = "-9.81 [m/s^2] * m_i * e_y", "-0.3 [kg/s] * v_i"
MASSES = {"A": 0.4, "B": 1.1}
SIGMA = 0.004


def dragged(seed, push=0.0, n_scenes=4, masses=None, **latent):
    """Bodies thrown with drag and a push along x; their masses are unknown.

    Parameters
    ----------
    masses : callable, optional
        ``masses(rng)``: every scene has bodies of its own.
    """
    rng = np.random.default_rng(seed)
    t = 0.03 * np.arange(40)
    crew = [Entity(name, properties={"mass": m}) for name, m in MASSES.items()]
    scenes = []
    for s in range(n_scenes):
        own = [Entity(e.name, properties={"mass": masses(rng)}) for e in crew] if masses else crew
        places = []
        for body in own:
            rate = 0.3 / body.mass
            limit = (np.array([push, -9.81 * body.mass])) / 0.3
            start, v = rng.uniform((-3, 3), (3, 5)), rng.uniform((-4, 1), (4, 5))
            gone = (1 - np.exp(-rate * t))[:, None] / rate
            places.append(start + limit * t[:, None] + (v - limit) * gone)
        exact = np.stack(places, axis=1)
        scenes.append(Scene(str(s), t, exact + SIGMA * rng.standard_normal(exact.shape), own))
    latents = (LatentDeclaration("mass", **{"low": 0.1, "high": 3.0, **latent}),)
    return Dataset("dragged", tuple(scenes), noise=(SIGMA,), units=SI, latents=latents)


def hypothesis_of(dataset, laws, train=None):
    """Laws with the unknowns of a data set, and the data set that it is fitted to."""
    latents = declared_latents(dataset)
    scenes = dataset.scenes if train is None else dataset.scenes[:train]
    part = unknown_properties(dataset, latents, scenes)
    known = replace(part.seen(replace(dataset, latents=())), scenes=part.filled(scenes))
    return Hypothesis.from_laws(known, laws) + part, known


# --- exact derivatives ----------------------------------------------------------------------------


def test_derivatives_by_properties_and_indexed_constants_are_exact():
    data = dragged(1)
    part = unknown_properties(data, declared_latents(data), data.scenes)
    law = law_of(
        "b[body] * norm(v_i) * v_i", "c[scene] * m_j / norm(p_i - p_j)^2 * (p_j - p_i)",
        "m_i^2 * m_j * (p_j - p_i)",
    )  # fmt: skip
    law = replace(law, frame=(part,), constants={
        "b[body]": {"A": -0.3, "B": -0.5}, "c[scene]": {str(s): 1.0 + s for s in range(4)},
        "mass[A]": 0.7, "mass[B]": 1.3,
    })  # fmt: skip
    parameters = [
        (name, entity) for name in law.names
        for entity in (law.constants[name] if name[0] in "bc" else [""])
    ]  # fmt: skip
    values = np.array(
        [law.constants[n][e] if e else law.constants[n] for n, e in parameters], dtype=float
    )
    (chains,) = build_chains(law, data.scenes)
    motion = Motion(law, chains, parameters)
    flow = Flow(motion, np.full(chains.n_chains, 1e-6))
    rng = np.random.default_rng(0)
    state = rng.standard_normal((2, chains.n_moving, 2, flow.n_intervals))
    motion.set_constants(values)
    points = flow.points(state, flow.start, flow.chain)
    exact = motion.slopes(points)[1]
    step = 1e-6
    for k in range(len(values)):
        ends = []
        for sign in (1, -1):
            moved = values.copy()
            moved[k] += sign * step
            motion.set_constants(moved)
            ends.append(motion.acceleration(points))
        slope = np.moveaxis((ends[0] - ends[1]) / (2 * step), -1, 0).reshape(exact.shape[:2])
        np.testing.assert_allclose(exact[:, :, k], slope, rtol=1e-5, atol=1e-5)
        assert np.abs(slope).max() > 1e-3


def test_the_response_projects_out_what_properties_change():
    data = dragged(2)
    hypothesis, known = hypothesis_of(data, [WEIGHT, DRAG])
    found = fit(hypothesis, known)
    columns = respond(found, known).columns
    assert columns.shape[1] == 2
    assert (np.linalg.norm(columns, axis=0) > 1).all()


# --- fits -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_masses_lie_in_their_intervals_and_take_part_in_the_evidence():
    told, evidence = [], []
    for seed in range(12):
        data = dragged(seed)
        hypothesis, known = hypothesis_of(data, [WEIGHT, DRAG])
        found = fit(hypothesis, known)
        for c in constant_estimates(found, known):
            told.append(c.low <= MASSES[c.name[5]] <= c.high)
            assert c.state == "" and c.unit == "kg"
        wider = replace(data, latents=(replace(data.latents[0], high=30.0),))
        other = hypothesis_of(wider, [WEIGHT, DRAG])[0]
        evidence.append(log_evidence(found, hypothesis) - log_evidence(fit(other, known), other))
    assert 17 <= sum(told) <= 24  # 24 of 90 %: fewer than 17 have a chance of 0.1 %
    # A prior ten times as wide is a factor of ten for each of both masses.
    np.testing.assert_allclose(evidence, 2 * np.log(29.9 / 2.9), atol=1e-3)


def test_what_the_motion_never_needs_stays_at_its_prior():
    data = dragged(3)
    hypothesis, known = hypothesis_of(data, [WEIGHT, "-c * m_i * v_i"])
    found = fit(hypothesis, known)
    estimates = {c.name: c for c in constant_estimates(found, known)}
    for name in ("mass[A]", "mass[B]"):
        assert estimates[name].state == "undetermined"
        assert estimates[name].value == pytest.approx(1.55)
    assert estimates["c"].state == ""


def test_a_normal_prior_pulls_as_another_measurement_does():
    plain = dragged(4, entities=("A",))
    normal = LatentDeclaration("mass", "truncated_normal", 0.1, 3.0, ("A",), mean=0.41, sd=0.004)
    pulled = replace(plain, latents=(normal,))
    a, b = (fit(*hypothesis_of(data, [WEIGHT, DRAG])) for data in (plain, pulled))
    weights = np.array([1 / a.covariance[0, 0], 1 / 0.004**2])
    expected = (weights @ [a.values[0], 0.41]) / weights.sum()
    assert b.values[0] == pytest.approx(expected, abs=0.1 * b.errors[0])
    assert b.covariance[0, 0] == pytest.approx(1 / weights.sum(), rel=0.05)
    assert b.chisqr > a.chisqr


def test_the_mass_of_a_source_at_rest_is_found():
    def pulled(t, p, v):
        gap = p[1] - p
        cube = np.maximum(np.sum(gap**2, axis=1, keepdims=True), 1e-9) ** 1.5
        return 5.0 * gap / cube * [[1.0], [0.0]]

    t = 0.1 * np.arange(60)
    start = np.array([[[2.0, 0.0], [0.0, 0.0]], [[0.0, 1.4], [0.0, 0.0]]])
    places, _ = moved(pulled, start, t)
    places = places + SIGMA * np.random.default_rng(0).standard_normal(places.shape) * [[1], [0]]
    crew = (Entity("moon", properties={"mass": 0.1}), Entity("sun", is_static=True))
    latents = (LatentDeclaration("mass", "log_uniform", 0.5, 50.0, ("sun",)),)
    data = Dataset("orbit", (Scene("s", t, places, crew),), noise=(SIGMA,), units=SI,
                   latents=latents)  # fmt: skip
    hypothesis, known = hypothesis_of(data, [GRAVITY])
    found = fit(hypothesis, known)
    assert found.status == "converged"
    assert abs(found.values[0] - 5.0) < 4 * found.errors[0] < 0.05


def test_evidence_of_unknowns_does_not_depend_on_units():
    gains = []
    for scale in (1.0, 0.3048):
        data = dragged(5, push=0.2)
        scenes = tuple(replace(s, positions=s.positions / scale) for s in data.scenes)
        data = replace(data, scenes=scenes, noise=(SIGMA / scale,))
        weight = f"{-9.81 / scale!r} [m/s^2] * m_i * e_y"
        heights = []
        for laws in ([weight, DRAG], [weight, DRAG, "c * e_x"]):
            hypothesis, known = hypothesis_of(data, laws)
            heights.append(log_evidence(fit(hypothesis, known), hypothesis))
        gains.append(heights[1] - heights[0])
    assert gains[0] == pytest.approx(gains[1], abs=1e-4)


def test_bodies_of_held_out_scenes_have_properties_of_their_own():
    data = dragged(6, n_scenes=6, masses=lambda rng: rng.uniform(0.2, 0.6))
    hypothesis, known = hypothesis_of(data, [WEIGHT, DRAG], train=3)
    found = fit(hypothesis, known)
    assert len(found.values) == 6
    errors = []
    for used in (found, replace(found, law=replace(found.law, frame=()))):  # or the middle, 1.55
        held = hypothesis_of(data, [WEIGHT, DRAG])[1].scenes[3:]
        rows = held_out_rows(used, known, held)
        errors.append(np.sqrt(np.mean([np.nanmean(np.square(r["track"])) for r in rows])))
    assert errors[0] < 0.5 * errors[1]
    # No scene foretells the mass of a body that no other scene shows: both are asked beside it.
    more, _ = hypothesis_of(data, [WEIGHT, DRAG, "c * e_x"], train=3)
    gained = held_out_gain(found, fit(more, known))
    assert np.isfinite(gained.gain) and gained.gain < 4


# --- the loop -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_push_is_found_beside_unknown_masses():
    report = close_loop(
        dragged(7, push=0.6), [WEIGHT, DRAG], rng=np.random.default_rng(0), n_bootstrap=0,
        max_levels=5, max_rounds=1,
    )  # fmt: skip
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.law == "c1 * e_x"
    found = {c.name: c for c in report.constants}
    for name, true in {"mass[A]": 0.4, "mass[B]": 1.1, "c1": 0.6}.items():
        assert found[name].low < true < found[name].high, name
    assert report.total["ratio"].value < 0.5


@pytest.mark.slow
def test_nothing_is_missing_where_only_masses_are_unknown():
    report = close_loop(
        dragged(8), [WEIGHT, DRAG], rng=np.random.default_rng(0), n_bootstrap=3, max_levels=5
    )
    assert report.verdict == "nothing missing"
    assert np.isfinite(report.total["floor"].rollout_rmse)
    assert {c.name for c in report.constants} == {"mass[A]", "mass[B]"}


def test_rounds_with_unknowns_are_kept_to_the_last_bit():
    hypothesis, known = hypothesis_of(dragged(9), [WEIGHT, DRAG])
    rounds = run_rounds(hypothesis, known, [], rng=np.random.default_rng(0))
    again = rounds_from(text_of(rounds), hypothesis, known, fit(hypothesis, known))
    assert np.array_equal(again[0].entering.values, rounds[0].entering.values)


def test_discrete_unknowns_are_refused():
    data = dragged(0, values=(0.4, 1.1))
    with pytest.raises(SettingsError, match="continuous"):
        close_loop(data, [WEIGHT], rng=np.random.default_rng(0))
