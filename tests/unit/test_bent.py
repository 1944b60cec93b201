"""Pieces of tracks with bent moments, as a close pass makes them: others tell the law."""

import numpy as np
import pytest

from bsp_gp.fitting.bent import steadied
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.response import respond
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.view import View
from tests.unit.test_lost_scenes import orbits


def viewed(dataset):
    """What laws are proposed beside nothing, and the view."""
    hypothesis = Hypothesis.from_laws(dataset, ())
    laws = Laws(load_grammar("physics"), dataset)
    found = fit(hypothesis, dataset)
    return laws, View(found, hypothesis, dataset, np.random.default_rng(0), usual=laws.common)


def test_orbits_that_are_struck_hide_no_law():
    laws, view = viewed(orbits(0.0, odd=5, count=9))
    plain, steady = respond(view.fit, view.dataset).regression, view.response.regression
    (before,), (after,) = (r.batches for r in (plain, steady))
    scale = np.nanmedian(after.moments / np.where(before.moments, before.moments, np.nan), axis=0)
    others = np.arange(9) != 5
    assert np.allclose(scale[others], 1.0) and scale[5] < 0.1
    # Forces are scaled like what is left of them.
    assert np.allclose(after.whitener[5], scale[5] * before.whitener[5])
    first = next(p for p in laws.propose(view).proposals if len(p.formulas) == 1)
    assert "norm(p_i - p_j)^-2" in first.text or "inverse(norm(p_i - p_j)^2)" in first.text


@pytest.mark.parametrize("odd", [None, 5])
def test_where_laws_explain_every_piece_or_few_pieces_are_asked_all_count(odd):
    dataset = orbits(0.0, odd=odd, count=9 if odd is None else 6)
    response = respond(fit(Hypothesis.from_laws(dataset, ()), dataset), dataset)
    column = response.regression.target()[:, None]  # a law that explains everything
    assert steadied(response, lambda: column) is response


def test_what_acts_in_one_scene_alone_is_not_taken_for_a_bent_piece():
    still = orbits(0.0, odd=5, count=9)
    law = ("-40 [m^3/s^2] * m_i * (p_i - p_j) / norm(p_i - p_j)^3",)
    view = View(
        fit(Hypothesis.from_laws(still, law), still), Hypothesis.from_laws(still, law), still,
        np.random.default_rng(0), usual=Laws(load_grammar("physics"), still).common,
    )  # fmt: skip
    plain = respond(view.fit, view.dataset).regression
    assert np.array_equal(view.response.regression.target(), plain.target())
