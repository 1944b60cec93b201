"""Many bodies in one scene: a part of their pairs is searched, and the best scored on all."""

import numpy as np
import pytest

from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.proposers import inside, laws, sums
from bsp_gp.loop.proposers.inside import Inside
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term
from bsp_gp.search.moments import _patterns
from tests.loop_views import throws, view_of

PUSH = 1.5


def pushed(t, mass):
    """What a push of so many m/s^2 along x does to a throw."""
    return np.outer(0.5 * PUSH * np.square(t), [1.0, 0.0])


@pytest.fixture(scope="module")
def crowd():
    rng = np.random.default_rng(0)
    return throws(rng, n_scenes=1, n_bodies=8, n_rows=30, sigma=0.003, move=pushed)


def test_patterns_of_sources_weigh_them_as_the_factors_do():
    rng = np.random.default_rng(1)
    masses = rng.uniform(1, 2, (3, 2, 9))
    own = rng.uniform(1e-9, 2e-9, (3, 2, 1))
    ones = np.ones_like(masses)
    left = np.stack([ones, masses, own * ones, own * masses, 1e12 * masses])
    weights, groups = _patterns(left)
    assert weights.shape == (3, 2, 2, 9)
    again = np.einsum("srkj,lsrk->lsrj", weights, groups.reshape(5, 3, 2, 2))
    assert again == pytest.approx(left, rel=1e-9, abs=1e-9 * left.min())
    assert _patterns(rng.uniform(1, 2, (9, 3, 2, 4)))[0] is None  # every source is its own


def test_a_part_of_the_pieces_has_the_moments_of_the_whole(crowd):
    view = view_of(crowd)
    regression = view.response.regression
    part, rows = regression.part(1 / 3)
    assert 0 < len(rows) < len(view.left)
    types = dataset_types(crowd)
    for text in ("v_i", "m_i * inverse(norm(p_i - p_j)) * normalize(p_i - p_j)"):
        term = Term(parse_formula(text, types, units=crowd.units))
        whole = regression.column(term)[0][:, 0]
        assert part.column(term)[0][:, 0] == pytest.approx(whole[rows], rel=1e-9)
    assert part.target() == pytest.approx(regression.target()[rows], abs=0)


def test_what_a_part_shows_is_scored_on_all(crowd, monkeypatch):
    whole = Laws(load_grammar("physics"), crowd, max_levels=6).propose(view_of(crowd))
    for module in (inside, laws, sums):
        monkeypatch.setattr(module, "MOST_PAIRS", 500)
    view = view_of(crowd)
    assert view.n_pairs > 500
    proposer = Laws(load_grammar("physics"), crowd, max_levels=6)
    family = proposer.propose(view)
    assert "the best were scored on all" in family.certificate
    assert family.proposals[0].text == whole.proposals[0].text
    assert family.proposals[0].gain == pytest.approx(whole.proposals[0].gain, rel=1e-9)
    forms = Inside(proposer, crowd).propose(view)
    assert forms.n_tried > 0


def test_guided_searches_take_a_part_as_well(crowd, monkeypatch):
    for module in (inside, laws, sums):
        monkeypatch.setattr(module, "MOST_PAIRS", 500)
    proposer = Laws(
        load_grammar("physics"), crowd, max_levels=6, search="cross_entropy", budget=100
    )
    told = proposer.propose(view_of(crowd)).certificate
    assert "cross_entropy search" in told and "pair laws of grammar physics" in told
    assert told.count("the best were scored on all") == 1


def test_moments_that_a_smooth_force_does_not_show_are_left_out(crowd):
    """What is left of a push is large and smooth: few moments tell it, and they tell all of it."""
    view = view_of(crowd)
    assert view.n_left < 0.6 * sum(scene.positions.size for scene in crowd.scenes)
    law = parse_formula("m_i * e_x", dataset_types(crowd), units=crowd.units)
    column = view.beside(view.force_columns([law]))[:, 0]
    column = column / np.linalg.norm(column)
    left = view.left - column * (column @ view.left)
    assert view.left @ view.left > 1e4 and left @ left < 2 * view.n_left
