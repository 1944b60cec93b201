"""A hidden body: its pull, the linear view, the search, the fit, and what is told of it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.before_after import compared
from bsp_gp.loop.close import declared_law
from bsp_gp.loop.explanation import HIDDEN_BODY
from bsp_gp.loop.hidden import hidden_body
from bsp_gp.loop.hidden_fit import with_hidden
from bsp_gp.loop.hidden_motion import ORBIT, REST, UNIFORM, motions_of
from bsp_gp.loop.hidden_place import Stage, survey
from bsp_gp.loop.hidden_posterior import LEAST_STRENGTH, MOST_STRENGTH, _Strengths
from bsp_gp.loop.hidden_pull import pulls_of
from bsp_gp.loop.hidden_view import View, view_of
from bsp_gp.loop.preparing import observe
from bsp_gp.physics.shooting import fit_rollout
from bsp_gp.report.hidden_map import draw_hidden_map
from experiments.disc_worlds import GRAVITY, HIDDEN_MASS, discs
from tests.planted import SI

SEED = 3


def prepared(dataset, text=GRAVITY):
    law = declared_law(dataset, [text])
    observation = observe(dataset, law, np.random.default_rng(0))
    return observation, evaluate(observation, law)


@pytest.fixture(scope="module")
def world():
    dataset, place = discs(SEED, n_times=60)
    return *prepared(dataset), place


@pytest.fixture(scope="module")
def found(world):
    observation, model, _ = world
    return hidden_body(observation, model, np.random.default_rng(1))


def test_the_pull_is_that_of_the_declared_law(world):
    observation, model, _ = world
    (pull,) = pulls_of(observation, model.law)
    assert pull.column == "mass" and pull.is_positive
    scene = observation.train[0]
    act = pull.on([scene.entities[0]], 2)
    a = act(np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), np.zeros(1), np.array([[[0.0, 2.0]]]),
            np.zeros((1, 1, 2)))  # fmt: skip
    assert a[0, 0, 0] == pytest.approx([0.0, 0.25])


def test_a_law_without_a_pair_term_says_nothing_of_hidden_bodies():
    times = np.arange(20.0)
    positions = np.stack([times, 0.1 * times**2], axis=1)[:, None]
    ball = Entity("ball", properties={"mass": 1.0})
    scenes = [Scene(str(k), times, positions + 0.01 * k, (ball,)) for k in range(2)]
    dataset = Dataset(
        "ball", tuple(scenes), train=("0",), test=("1",), noise=(0.1,), up="y", units=SI
    )
    law = declared_law(dataset, ["9.81 [m/s^2] * m_i * down"])
    observation = observe(dataset, law, np.random.default_rng(0), sources=False)
    model = evaluate(observation, law)
    assert hidden_body(observation, model, np.random.default_rng(0)) is None


def test_the_view_foretells_what_a_source_does_to_the_residual():
    """Linear response against a full fit of the initial states with the source in the scene."""
    observation, model = prepared(discs(SEED, hidden=False, n_times=60)[0])
    (pull,) = pulls_of(observation, model.law)
    (motion, *_) = motions_of(observation, model, pull)
    view = view_of(observation, model.fit, pull)
    place, strength = np.array([7.0, -7.0]), HIDDEN_MASS
    left = view.y - strength * view.response(motion, place)[0]
    grown = with_hidden(observation, pull, motion, place, strength)
    fit = fit_rollout(
        grown.segments, model.law, grown.sigma, integrator=grown.integrator,
        substeps=grown.substeps,
    )  # fmt: skip
    foretold = left @ left - view.y @ view.y
    assert fit.chisqr - model.fit.chisqr == pytest.approx(foretold, rel=0.1)


def test_noise_alone_is_standard_normal_on_the_view(world):
    observation, model, place = world
    (pull,) = pulls_of(observation, model.law)
    view = view_of(observation, model.fit, pull)
    targets, totals = view.null(np.random.default_rng(5), 400)
    assert totals.mean() == pytest.approx(view.dof, abs=5 * np.sqrt(2 * view.dof / 400))
    response = view.response(motions_of(observation, model, pull)[0], place)
    strength, gain = view.strengths(response, targets)
    assert strength.min() == 0.0  # a mass is never below zero
    one = view.strengths(response, targets[:, 7])
    assert (strength[0, 7], gain[0, 7]) == pytest.approx((one[0][0], one[1][0]))


def test_the_grid_finds_no_more_in_the_scene_than_in_noise():
    observation, model = prepared(discs(SEED, hidden=False, n_times=60)[0])
    (pull,) = pulls_of(observation, model.law)
    view = view_of(observation, model.fit, pull)
    motions = motions_of(observation, model, pull)[:1]
    stage = Stage.of(observation, pull, view)
    grid = survey(view, motions, stage, np.random.default_rng(0), n_null=99)
    assert grid.p_value() > 0.01
    assert grid.p_value(share=2 * grid.null.max()) == 0.01


@pytest.mark.parametrize("is_positive", [True, False])
def test_the_strength_is_integrated_out(world, is_positive):
    """Against quadrature; strengths that are seen well, hardly, not, and with the other sign."""
    observation, model, _ = world
    (pull,) = pulls_of(observation, model.law)
    pull = replace(pull, is_positive=is_positive)
    y = np.array([3.0, -1.0])
    response = np.array([[1.0, 0.0], [40.0, 5.0], [1e-3, 0.0], [-0.5, 0.1], [0.0, 0.0]])
    strengths = _Strengths(replace(empty_view(pull), y=y), pull, 1.3)
    found, *_ = strengths(response)
    least, most = LEAST_STRENGTH * pull.most, MOST_STRENGTH * pull.most
    u = np.linspace(0.0, np.log1p(most / least), 400_001)
    s = least * np.expm1(u)
    for value, r in zip(found, response, strict=True):
        total = 0.0
        for side in (1.0, -1.0)[: 1 + (not is_positive)]:
            exponent = side * s * (r @ y) / 1.3 - 0.5 * np.square(s) * (r @ r) / 1.3
            total += np.trapezoid(np.exp(exponent), u)
        assert value == pytest.approx(np.log(total), abs=0.02)
    strengths = _Strengths(replace(empty_view(pull), y=2.0 * response[1]), pull, 1.3)
    drawn = strengths.drawn(np.repeat(response[1:2], 20_000, axis=0), np.random.default_rng(0))
    sd = np.sqrt(1.3 / (response[1] @ response[1]))
    assert np.mean(drawn) == pytest.approx(2.0, abs=0.05 * sd)
    assert np.std(drawn) == pytest.approx(sd, rel=0.03)


def empty_view(pull):
    return View((), np.zeros(0), 0.0, 1, np.zeros((0, 0)), pull, False)


def test_one_recording_allows_motion_and_several_only_a_place(world):
    observation, model, _ = world
    (pull,) = pulls_of(observation, model.law)
    kinds = [m.kind for m in motions_of(observation, model, pull)]
    assert kinds == [REST, UNIFORM, ORBIT]
    again = replace(observation.train[0], name="another")
    several = replace(observation, train=(*observation.train, again))
    assert [m.kind for m in motions_of(several, model, pull)] == [REST]


def test_an_orbit_obeys_the_law(world):
    """Central differences of the integrated track are the accelerations of the law."""
    observation, model, _ = world
    (pull,) = pulls_of(observation, model.law)
    motion = motions_of(observation, model, pull)[-1]
    times = motion.epoch + np.array([-1e-3, 0.0, 1e-3])
    p, v = motion(np.array([[30.0, 0.0, 0.0, 1.0]]), np.linspace(*times[[0, 2]], 3))
    assert v[0, 1] == pytest.approx([0.0, 1.0], abs=1e-3)
    scene = motion.field.scene
    row = np.argmin(np.abs(scene.times - motion.epoch))
    masses = [e.mass for e in scene.entities]
    gap = scene.positions[row] - np.array([30.0, 0.0])
    pulls = (np.array(masses)[:, None] * gap / np.linalg.norm(gap, axis=1)[:, None] ** 3).sum(0)
    speed = (v[0, 2] - v[0, 0]) / (times[2] - times[0])
    assert speed == pytest.approx(pulls, rel=0.05, abs=1e-4)


def test_the_unseen_disc_is_found(world, found):
    observation, model, place = world
    assert found.kind == HIDDEN_BODY and not found.reason
    assert found.details["p_value"] <= 0.01
    error = np.array(found.details["best"][:2]) - place
    assert np.linalg.norm(error) < 3 * np.linalg.norm(found.details["sd"][:2])
    n = found.fit.n_effective
    assert found.bic(n) < model.fit.bic(n) - 6
    mass = found.constants[-1]
    assert mass.name == "mass_hidden"
    error = found.details["mean"][-1] - HIDDEN_MASS
    assert abs(error) < 3 * found.details["sd"][-1] < HIDDEN_MASS


def test_what_is_adopted_has_the_source_in_every_scene(found):
    for scene in (*found.observation.train, *found.observation.test):
        assert scene.names[-1] == "hidden body" and scene.entities[-1].is_static
        assert np.isfinite(scene.positions[:, -1]).all()
    fit = found.observation.fit(found.fit.law)
    assert fit.chisqr == pytest.approx(found.fit.chisqr, rel=1e-3)


def test_predictions_use_the_source(world, found):
    observation, model, _ = world
    before, after = (
        o.errors(law)[0].rollout_rmse
        for o, law in ((observation, model.law), (found.observation, found.fit.law))
    )
    assert after < before


def test_errors_are_those_of_the_bodies_seen(world, found):
    observation, model, _ = world
    after = evaluate(found.observation, found.fit.law, found.fit)
    n_seen = len(observation.test[0].entities)
    assert [row["steps"].shape[1] for row in after.rows] == [n_seen] * len(after.rows)
    # Fewer scenes than five: held-out data are simulated, the hidden body among them.
    few = replace(found.observation, test=found.observation.test[:2])
    before = evaluate(replace(observation, test=observation.test[:2]), model.law, model.fit)
    after = evaluate(few, found.fit.law, found.fit)
    _, copies = few.floor(after.law, np.random.default_rng(2))
    assert copies
    errors = compared(few, before, after, copies, np.random.default_rng(3))
    for ratio in errors.ratios.values():
        assert ratio.low <= ratio.value <= ratio.high


def test_details_are_json_and_make_a_map(found):
    details = json.loads(json.dumps(found.details))
    figure = draw_hidden_map(details)
    assert len(figure.axes) == 2
    figure = draw_hidden_map({**details, "draws": (np.ones((5, 3))).tolist()}, truth=(0.0, 1.0))
    assert figure.axes[0].get_xlabel()


def test_the_same_seed_gives_the_same_bits(world, found):
    observation, model, _ = world
    again = hidden_body(observation, model, np.random.default_rng(1))
    assert again.details["draws"] == found.details["draws"]


@pytest.mark.slow
def test_intervals_of_place_and_mass_cover_the_truth():
    """90 %, all numbers of a world being one in the end; sources that hold or are open."""
    held = []
    for seed in range(7):
        dataset, place = discs(seed, n_times=60)
        found = hidden_body(*prepared(dataset), np.random.default_rng(1))
        if found is not None and found.details["motion"] == REST:
            truth = (*place, HIDDEN_MASS)
            held.append([c.low <= t <= c.high for c, t in zip(found.constants, truth, strict=True)])
    assert len(held) >= 5
    # Three binomial standard errors, as if the three numbers of a world were one.
    assert np.mean(held) > 0.9 - 3 * np.sqrt(0.09 / len(held)), held
