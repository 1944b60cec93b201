"""An unseen body beside places that count from a body which it pulls as well."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import NOTHING, Hypothesis
from bsp_gp.fitting.parts.hidden import pull_of
from bsp_gp.fitting.parts.inclined import stretched
from bsp_gp.fitting.starts import _slope
from bsp_gp.fitting.unseen import without_unseen
from bsp_gp.language.formula import evaluate
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.proposal import continued, without_term
from bsp_gp.loop.proposers.aslant import Aslant
from bsp_gp.loop.proposers.companions import Companions
from bsp_gp.loop.proposers.inclined import Inclinations
from bsp_gp.loop.queue import chosen_of
from bsp_gp.loop.view import View
from bsp_gp.units import UnitSystem

GRAVITY = "M * (p_j - p_i) / norm(p_j - p_i)^3"
SHARE, PLACE = 0.4, np.array([1.7, 0.6])
ARCSEC = UnitSystem.from_declared({"length": "arcsec", "time": "s"})


def relative_orbit(seed=0, n_rows=60, sigma=1e-3):
    """A light companion from its primary, and a body farther out on a circle about that one."""
    rng = np.random.default_rng(seed)
    speed = np.sqrt((1 + SHARE) / np.linalg.norm(PLACE))
    across = np.array([-PLACE[1], PLACE[0]]) / np.linalg.norm(PLACE) * speed

    def rate(_, state):
        p, q, v, w = state.reshape(4, 2)

        def pull(x):
            return x / np.linalg.norm(x) ** 3

        return np.concatenate([v, w, -pull(p) + SHARE * (pull(q - p) - pull(q)),
                               -(1 + SHARE) * pull(q)])  # fmt: skip

    times = np.sort(rng.uniform(0, 7, n_rows))
    start = np.concatenate([[0.6, 0.0], PLACE, [0.0, 1.2], across])
    path = solve_ivp(rate, (0, 7), start, t_eval=times, rtol=1e-10, atol=1e-12).y[:2].T
    places = np.zeros((n_rows, 2, 2))
    places[:, 0] = path + sigma * rng.standard_normal(path.shape)
    bodies = (Entity("companion", properties={"mass": 1.0}), Entity("primary", is_static=True))
    sigmas = np.full(places.shape, np.nan)
    sigmas[:, 0] = sigma
    return Dataset("sky", (Scene("sky", times, places, bodies, sigma=sigmas),), units=ARCSEC)


def look(dataset):
    """The fit of the declared law as proposers look at it."""
    hypothesis = Hypothesis.from_laws(dataset, [GRAVITY])
    return View(fit(hypothesis, dataset), hypothesis, dataset, np.random.default_rng(0))


@pytest.mark.slow
def test_a_companion_is_moved_against_its_primary_by_what_pulls_both():
    view = look(relative_orbit())
    assert view.reference == "primary"
    best, *_ = Companions().propose(view).proposals
    found = fit(best.hypothesis, view.dataset, near=view.near, starts=best.starts,
                bounds=best.bounds)  # fmt: skip
    assert found.status == "converged" and found.chi2_red < 1.4
    known = {name: k for k, (name, _) in enumerate(found.parameters)}
    numbers = [known[n] for n in ("M1", "h_x1", "h_y1")]
    off = (found.values[numbers] - [SHARE, *PLACE]) / found.errors[numbers]
    assert np.abs(off).max() < 3.5
    assert np.all(found.errors[numbers] < 0.5 * np.abs([SHARE, *PLACE]))


@pytest.mark.slow
def test_a_body_at_the_origin_of_a_small_table_is_held_by_whoever_put_it_there():
    (scene,) = relative_orbit().scenes
    in_metres = Dataset("table", (scene,), units=UnitSystem.from_declared({"length": "m"}))
    assert look(in_metres).reference == ""


def test_what_pulls_both_alike_moves_nothing_and_else_the_tide_is_left():
    dataset = relative_orbit()
    (term,) = Hypothesis.from_laws(dataset, [GRAVITY]).law.terms
    pull = pull_of(term, "S", ("h_x", "h_y"), is_relative=True)
    far = {"M": 1.0, "S": 1e9, "h_x": 1e3, "h_y": 0.0}
    at = {"p_i": np.array([1.0, 0.0]), "p_j": np.zeros(2), "v_i": np.zeros(2), "t": 0.0,
          "origin": np.zeros(2), "e_x": np.eye(2)[0], "e_y": np.eye(2)[1]}  # fmt: skip
    force = evaluate(pull.formula, at, far)
    assert force == pytest.approx([2.0, 0.0], rel=0.01)  # 2 M r / d^3: a tide


def test_rows_of_one_night_tell_no_velocity():
    times = np.array([0.0, 1.0, 2.0, 2.001, 3.0, 4.0, 5.0])
    seen = times + np.array([0, 0, 0.01, -0.01, 0, 0, 0])
    assert _slope(times, seen, False) == pytest.approx(np.ones(7), abs=0.05)


@pytest.mark.slow
def test_an_inclined_orbit_is_proposed_near_where_it_is_and_forces_act_in_its_plane():
    dataset = seen_aslant(angle=np.radians(55.0), node=0.7)
    view = look(dataset)
    best, *_ = Inclinations().propose(view).proposals
    found = fit(best.hypothesis, dataset)
    at = {name: k for k, (name, _) in enumerate(found.parameters)}
    numbers = [at["inclination"], at["node"], at["M"]]
    assert found.status == "converged"
    off = (found.values[numbers] - [np.radians(55.0), 0.7, 1.0]) / found.errors[numbers]
    assert np.abs(off).max() < 3.5
    after = View(found, best.hypothesis, dataset, np.random.default_rng(1))
    places = after.response.regression.batches[0].positions
    assert np.nanmax(np.linalg.norm(places[:, 0, 0], axis=-1)) == pytest.approx(0.6, rel=0.02)
    assert not Inclinations().propose(after).proposals


@pytest.mark.slow
def test_an_orbit_seen_nearly_edge_on_is_followed_from_its_ellipse_and_on_fewer_rows():
    """Moments tell nothing of it, and a few rows leave its plane a curved valley."""
    angle, node = np.radians(88.8), 0.7
    dataset = seen_aslant(angle, node, n_rows=30)
    view = look(dataset)
    best, *_ = Inclinations().propose(view).proposals
    found = best.fitted(view.fit, dataset, criteria=Criteria())
    at = {name: k for k, (name, _) in enumerate(found.parameters)}
    numbers = [at["inclination"], at["node"], at["M"]]
    off = (found.values[numbers] - [angle, node, 1.0]) / found.errors[numbers]
    assert found.status == "converged" and np.abs(off).max() < 3.5
    (scene,) = dataset.scenes
    first = replace(dataset, scenes=(replace(scene, times=scene.times[:20],
                    positions=scene.positions[:20], sigma=scene.sigma[:20]),))  # fmt: skip
    again = fit(continued(best.hypothesis, found), first)
    assert again.status == "converged" and again.chi2_red < 2


def seen_aslant(angle, node, n_rows=80):
    """An ellipse about the primary, foreshortened across a line of nodes."""
    rng, times = np.random.default_rng(5), np.linspace(0, 4, n_rows)

    def rate(_, state):
        return [*state[2:], *(-state[:2] / np.linalg.norm(state[:2]) ** 3)]

    path = solve_ivp(rate, (0, 4), [0.6, 0, 0, 1.2], t_eval=times, rtol=1e-10, atol=1e-12).y[:2].T
    across = np.array([-np.sin(node), np.cos(node)])
    path = path - (1 - np.cos(angle)) * np.outer(path @ across, across)
    places, sigmas = np.zeros((n_rows, 2, 2)), np.full((n_rows, 2, 2), np.nan)
    places[:, 0], sigmas[:, 0] = path + 2e-3 * rng.standard_normal(path.shape), 2e-3
    bodies = (Entity("companion", properties={"mass": 1.0}), Entity("primary", is_static=True))
    return Dataset("sky", (Scene("sky", times, places, bodies, sigma=sigmas),), units=ARCSEC)


def test_what_a_lone_star_goes_round_is_found_where_its_orbit_is_seen_aslant():
    (scene,) = seen_aslant(angle=np.radians(50.0), node=1.1).scenes
    alone = Scene("sky", scene.times, scene.positions[:, :1] + [0.3, -0.2], scene.entities[:1],
                  sigma=scene.sigma[:, :1])  # fmt: skip
    dataset = Dataset("sky", (alone,), units=ARCSEC)
    hypothesis = Hypothesis.from_laws(dataset, [NOTHING])
    view = View(fit(hypothesis, dataset), hypothesis, dataset, np.random.default_rng(0))
    (best,) = Aslant().propose(view).proposals
    assert best.path is not None  # it begins at the ellipse's own track
    found = best.fitted(view.fit, dataset, criteria=Criteria())
    at = {name: k for k, (name, _) in enumerate(found.parameters)}
    numbers = [at[name] for name in ("M1", "inclination", "node")]
    off = (found.values[numbers] - [1.0, np.radians(50.0), 1.1]) / found.errors[numbers]
    assert found.status == "converged" and np.abs(off).max() < 3.5
    place = np.linalg.solve(stretched(found.law), found.values[[at["h_x1"], at["h_y1"]]])
    assert place == pytest.approx([0.3, -0.2], abs=0.02)


@pytest.mark.slow
def test_both_sides_of_the_primary_are_tried():
    view = look(relative_orbit())
    family = Companions().propose(view)
    every = [(family.name, proposal) for proposal in family.proposals]
    assert len({tuple(np.sign(list(p.starts.values())[1:3])) for _, p in every}) > 1
    assert chosen_of(every, [family.name], Criteria()) == every


@pytest.mark.slow
def test_what_an_unseen_body_brings_stands_and_falls_as_one():
    view = look(relative_orbit())
    best, *_ = Companions().propose(view).proposals
    whole = best.hypothesis
    *_, body = whole.parts
    assert len(body.law.terms) > 1
    for term in body.law.terms:
        assert without_term(whole, term.formula).parts == whole.parts[:-1]
    found = fit(whole, view.dataset, near=view.near, starts=best.starts, bounds=best.bounds)
    after = View(found, continued(whole, found), view.dataset, np.random.default_rng(1))
    assert [index for index, _ in after.single_terms] == [0]
    assert [t.formula for t in without_unseen(found.law).terms] == [found.law.terms[0].formula]
