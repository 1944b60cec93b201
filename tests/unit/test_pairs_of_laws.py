"""Two laws at once: which are weighed, and what they are told to gain."""

from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.proposers.sums import MOST_PAIRED, pairs_of
from bsp_gp.physics.force import split_linear
from bsp_gp.search.candidate import Candidate

TYPES = input_types(PROPERTY_UNITS, up="y")


def crowd(rng, n_rows=400):
    """A law that explains most, many variants of it, and a drag that alone shows less than they."""
    main, drag = np.linalg.qr(rng.standard_normal((n_rows, 2)))[0].T
    left = 300 * main + 30 * drag
    columns = {}
    for k in range(MOST_PAIRED + 10):
        formula = parse_formula(f"c1 * (norm(v_i)^{1 + k / 50} * e_x)", TYPES)
        columns[formula] = main + 0.002 * k * rng.standard_normal(n_rows) / np.sqrt(n_rows)
    last = parse_formula("c1 * v_i", TYPES)
    columns[last] = drag
    found = []
    for formula, column in columns.items():
        gain = (column @ left) ** 2 / (column @ column)
        total = float(left @ left)
        found.append(Candidate(formula, "field", {"c1": 1.0}, 0.0, 4.0, gain, total))
    found.sort(key=lambda c: c.complexity - 0.5 * c.gain)
    by_rest = {split_linear(f)[1]: column for f, column in columns.items()}
    regression = SimpleNamespace(column=lambda term: (by_rest[term.formula][:, None],))
    view = SimpleNamespace(
        left=left, beside=lambda rows: rows, response=SimpleNamespace(regression=regression)
    )
    return view, found, last


def test_variants_of_one_law_crowd_out_no_second_cause():
    view, found, drag = crowd(np.random.default_rng(0))
    assert found[-1].formula == drag
    assert not any(drag in (c.formula for c in both) for both, *_ in pairs_of(view, found))
    (both, amounts, gain), *_ = pairs_of(view, found, {drag})
    assert drag in (c.formula for c in both)
    assert gain == pytest.approx(view.left @ view.left, rel=1e-6)
    assert sorted(np.abs(amounts)) == pytest.approx([30, 300], rel=1e-3)
