"""Fits that are made again: without held-out rows, and without what may be superfluous."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.loop.backward import _Pruning
from bsp_gp.loop.ready import _cut
from tests.loop_views import GRAVITY, throws


def test_a_fit_to_the_first_rows_begins_at_that_to_all_and_ends_where_they_lead():
    data = throws(np.random.default_rng(0), n_scenes=2)
    hypothesis = Hypothesis.from_laws(data, [GRAVITY, "c * v_i"])
    found = fit(hypothesis, data)
    cut = tuple(s.rows(0, n) for s, n in zip(data.scenes, (20, 25), strict=True))
    near = _cut(found, cut)
    (kept,), (whole,) = near.nodes, found.nodes
    assert kept.shape[3] == 25
    assert np.array_equal(kept[..., :20, 0], whole[..., :20, 0])
    assert np.array_equal(kept[..., 1], whole[..., :25, 1])
    less = replace(data, scenes=cut)
    begun, alone = fit(hypothesis, less, near=near), fit(hypothesis, less)
    assert abs(begun.values[0] - alone.values[0]) < 1e-3 * alone.errors[0]


def test_rows_at_other_times_are_no_beginning():
    data = throws(np.random.default_rng(0), n_scenes=2)
    found = fit(Hypothesis.from_laws(data, [GRAVITY]), data)
    moved = tuple(replace(s.rows(0, 20), times=s.times[:20] + 0.01) for s in data.scenes)
    assert _cut(found, moved) is None


def test_no_fit_is_tried_without_a_term_that_is_sure_beyond_doubt():
    data = throws(np.random.default_rng(0))
    law = read_law(data, ["-g * m_i * e_y", "c * v_i"])
    pruning = _Pruning.__new__(_Pruning)
    pruning.found = SimpleNamespace(
        parameters=(("g", ""), ("c", "")), values=np.array([9.8, 0.3]), errors=np.array([0.1, 0.1])
    )
    assert [pruning._is_needed(term.formula) for term in law.terms] == [True, False]
