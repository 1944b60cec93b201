"""Which search takes which grammar, and that guided ones find what the exhaustive one does."""

import numpy as np
import pytest

from bsp_gp.errors import GrammarError, SettingsError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.canonical import canonical_key
from bsp_gp.language.grammar import load_grammar, read_grammar
from bsp_gp.loop.proposers import laws as laws_module
from bsp_gp.loop.proposers.inside import Inside
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.view import View, selected
from bsp_gp.search.choice import searches_for
from tests.fitted_tracks import body, dataset_of, scene_of
from tests.unit.test_inside import is_within
from tests.unit.test_inside import pushed as pushed_by

UPWARD = {
    "grammar": {"name": "upward", "start": "Force", "kind": "field"},
    "types": {"Force": "vector *", "Const": "scalar *"},
    "inputs": {"m_i": "scalar kg", "v_i": "vector m/s", "e_y": "vector 1", "e_x": "vector 1"},
    "constants": {"c1": "scalar *", "c2": "scalar *"},
    "rules": {
        "Force": "mul(Const, e_y) | mul(Const, v_i) | add(mul(c1, v_i), mul(c2, e_x))",
        "Const": "c1",
    },
}


def pushed(sideways=0.0, seed=0):
    """Bodies under 0.4 m/s^2 along y, and a wind along x with a linear drag."""
    rng, times, scenes = np.random.default_rng(seed), np.linspace(0.0, 2.0, 30), []
    for k in range(3):
        start, drag = rng.uniform(-3.0, 3.0, 2), 0.5 if sideways else 0.0
        t = times[:, None]
        places = start * t + np.array([0.0, 0.2]) * t**2
        if drag:
            rest = np.array([sideways / drag, 0.0])
            places = rest * t + (start - rest) * (1 - np.exp(-drag * t)) / drag
        places = places + 0.003 * rng.standard_normal(places.shape)
        scenes.append(scene_of(times, (body("ball"),), places[:, None], name=f"s{k}"))
    return dataset_of(scenes, noise=(0.003, 0.003))


def proposed(data, grammar, search):
    hypothesis = Hypothesis.from_laws(data, [])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(1))
    laws = Laws(grammar, data, max_levels=6, search=search, budget=400)
    return laws.propose(view)


def test_noise_that_is_searched_anew_is_less_and_ends_in_an_answer(monkeypatch):
    """Where the level is near a search runs on a few draws of noise, and kin on the same."""
    monkeypatch.setattr(laws_module, "selected", lambda *args, **more: 0.005)
    monkeypatch.setattr(laws_module, "MOST_ANEW", 3)
    data = pushed()
    hypothesis = Hypothesis.from_laws(data, ["-c * norm(v_i) * v_i"])  # has kin
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(1))
    laws = Laws(load_grammar("physics"), data, max_levels=5, search="genetic", budget=100)
    assert laws.propose(view).null.shape == (3,)


def test_what_a_search_cannot_take_is_said_before_it_begins():
    with pytest.raises(GrammarError, match="search auto, cross_entropy and genetic take"):
        searches_for("exhaustive", read_grammar(UPWARD), ["field"], 6)
    with pytest.raises(SettingsError, match="search must be one of"):
        searches_for("greedy", read_grammar(UPWARD), ["field"], 6)


def test_auto_goes_on_beyond_the_certificate():
    grammar = load_grammar("physics")
    assert searches_for("auto", grammar, ["field"], 6) == {
        "exhaustive": 6, "cross_entropy": 8, "genetic": 8,
    }  # fmt: skip
    assert "exhaustive" not in searches_for("auto", read_grammar(UPWARD), ["field"], 6)


@pytest.mark.parametrize("search", ["cross_entropy", "genetic"])
def test_guided_searches_find_the_law_that_the_exhaustive_one_finds(search):
    data = pushed()
    found = proposed(data, load_grammar("physics"), search)
    assert next(p.text for p in found.proposals if len(p.formulas) == 1) == "c1 * e_y"
    assert f"{search} search" in found.certificate and "others may do better" in found.certificate
    assert selected(found.gain, found.rank, found.null) < 1e-6
    assert np.all(found.null > 0)


@pytest.mark.parametrize("search", ["auto", "genetic"])
def test_grammars_that_are_no_products_are_searched(search):
    found = proposed(pushed(sideways=1.0), read_grammar(UPWARD), search)
    assert found.proposals[0].text == "c1 * v_i + c2 * e_x"
    assert found.proposals[0].rank == 2


def test_guided_searches_draw_the_same_again():
    data = pushed()
    one, other = (proposed(data, load_grammar("physics"), "genetic") for _ in range(2))
    assert [p.text for p in one.proposals] == [p.text for p in other.proposals]
    np.testing.assert_array_equal(one.null, other.null)


@pytest.mark.slow
@pytest.mark.parametrize("search", ["cross_entropy", "genetic"])
def test_a_law_with_constants_inside_that_no_form_lists_is_drawn(search):
    """A drag that saturates and acts above a height only: found by drawing or not at all."""

    def push(place, velocity, time):
        size = np.linalg.norm(velocity)
        return -1.2 * (place[1] > 0.9) * velocity / (1 + size / 2.0)

    data = pushed_by(push)
    hypothesis = Hypothesis.from_laws(data, [])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(1))
    laws = Laws(load_grammar("physics"), data, search=search)
    laws.propose(view)
    inside = Inside(laws, data)
    best = max(inside.propose(view).proposals, key=lambda p: p.promise)
    assert "sign(y_i - h_y1)" in best.text and {"n1", "u1"} & set(best.starts)
    (formula,) = best.formulas
    assert canonical_key(formula) not in {canonical_key(f.term.formula) for f in inside.forms}
    found = fit(best.hypothesis, data, starts=best.starts)
    assert is_within(found, h_y=0.9)


def test_near_the_level_of_chance_noise_is_searched_anew(monkeypatch):
    data = pushed()
    hypothesis = Hypothesis.from_laws(data, ["0.4 [m/s^2] * m_i * e_y"])
    view = View(fit(hypothesis, data), hypothesis, data, np.random.default_rng(1))
    proposer = Laws(load_grammar("physics"), data, max_levels=5, search="genetic", budget=100)
    null = np.zeros(view.moment_draws.shape[1])
    assert proposer._searched_anew(view, 100.0, null + 4.0)[0] == 4.0  # far beyond any chance
    assert proposer._searched_anew(view, 2.0, null + 4.0)[0] == 4.0  # far below
    monkeypatch.setattr("bsp_gp.loop.proposers.laws.MOST_ANEW", 3)
    near = next(g for g in np.arange(4.0, 60.0, 0.5)
                if 1e-4 < selected(g, 1, null + 4.0, view.noise_dof) < 0.01)  # fmt: skip
    anew = proposer._searched_anew(view, near, null + 4.0)
    assert len(anew) == 3 and (anew > 4.0).all() and (anew < 60.0).all()
