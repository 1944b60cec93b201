"""Back to a law of textbooks, where more was found beside an odd one."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from bsp_gp.loop import retraced as module
from bsp_gp.loop.aside import Aside
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.retraced import is_likelier, retraced, usual_law
from bsp_gp.loop.table import HypothesisTable
from tests.unit.test_aside import BASE, LAW, adopted, round_of, row

ODD = replace(LAW, left=0.1)
PLAIN = replace(row(3, "law", 200.0), left=0.14)
TURN = SimpleNamespace(proposals={1: "odd", 3: "plain"})


@pytest.mark.parametrize("best, left, found", [
    (ODD, 0.14, True), (ODD, 0.3, False), (PLAIN, 0.14, False),
    (replace(ODD, kind="measurement"), 0.14, False),
])  # fmt: skip
def test_plain_laws_that_leave_hardly_more_than_an_odd_one_are_kept_in_mind(best, left, found):
    plain = replace(PLAIN, left=left)
    table = HypothesisTable((BASE, ODD, plain), 1e-9).with_probabilities()
    decision = usual_law(TURN, table, adopted(best), lambda proposal: proposal == "plain")
    assert (decision is not None) is found
    assert not found or decision.best.id == PLAIN.id and decision.is_adopted


IN_MIND = Aside(adopted(PLAIN), {"told": 1})


def two_rounds(second, usual=IN_MIND):
    first = replace(round_of(1, (BASE, ODD, PLAIN), adopted(ODD)), usual=usual)
    return [first, round_of(2, (BASE, row(1, "drift", 350.0)), second)]


def test_the_way_back_is_taken_where_a_cause_was_found_beside_the_odd_law():
    (only,) = retraced(two_rounds(adopted(row(1, "drift", 350.0))))
    assert only.decision.best.id == PLAIN.id and only.details == {"told": 1}
    assert only.usual is None
    nothing = replace(adopted(BASE), is_adopted=False)
    assert retraced(two_rounds(nothing)) is None
    assert retraced(two_rounds(adopted(row(1, "drift", 350.0)), usual=None)) is None


def test_all_that_is_adopted_is_compared(monkeypatch):
    """What a cause costs beforehand counts, of each that was adopted."""
    monkeypatch.setattr(module, "log_evidence", lambda found, hypothesis, criteria: found)

    def ends(evidence, *adopted_rows):
        told = [SimpleNamespace(decision=adopted(one)) for one in adopted_rows]
        told[-1] = SimpleNamespace(decision=told[-1].decision, after=evidence, continuing=None)
        return told

    one, two = row(1, "law", 0.0), row(2, "law", 0.0)
    assert is_likelier(ends(10.0, one), ends(9.0, one), Criteria())
    assert not is_likelier(ends(10.0, one, two), ends(9.0, one), Criteria())
