"""A cause that says all of the tracks is a rival of all laws together."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from bsp_gp.loop.aside import Aside, law_beside, settled
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.decide import Decision
from bsp_gp.loop.loop import Round
from bsp_gp.loop.table import HypothesisTable, Row


def row(number, code, nats, kind="force"):
    prior = 0.0 if not number else -6.9
    return Row(
        number, code, f"{code} {number}", code, "converged", nats, prior, nats, 2, kind,
        key=(code, number),
    )  # fmt: skip


BASE, LAW, KICKS = row(0, "base", 0.0), row(1, "law", 300.0), row(2, "kicks", 900.0, "kicks")
PROPOSALS = {
    1: SimpleNamespace(is_last=False, formulas=("f",), judged=None),
    2: SimpleNamespace(is_last=True, formulas=(), judged=None),
}


def round_of(number, rows, decision, aside=None):
    table = HypothesisTable(tuple(rows), 1e-9).with_probabilities()
    return Round(number, None, table, decision, {}, {}, (), PROPOSALS, aside=aside)


def adopted(best):
    return Decision("effect adopted", "adopted", best, True)


def test_a_law_takes_the_place_of_kicks_as_long_as_others_are_asked_for():
    table = HypothesisTable((BASE, LAW, KICKS), 1e-9).with_probabilities()
    found = law_beside(table, adopted(KICKS), PROPOSALS, Criteria())
    assert found.best.id == LAW.id and found.is_adopted
    assert law_beside(table, adopted(LAW), PROPOSALS, Criteria()) is None
    alone = HypothesisTable((BASE, KICKS), 1e-9).with_probabilities()
    assert law_beside(alone, adopted(KICKS), PROPOSALS, Criteria()) is None


@pytest.mark.parametrize("second, codes", [(950.0, ["law", "law"]), (600.0, ["kicks"])])
def test_all_laws_together_are_weighed_against_kicks(second, codes):
    first = round_of(1, (BASE, LAW, KICKS), adopted(LAW), Aside(adopted(KICKS), {"constants": ()}))
    more = row(1, "law", second)
    rounds = settled([first, round_of(2, (replace(LAW, id=0), more), adopted(more))])
    assert [done.decision.best.code for done in rounds] == codes
    assert all(done.aside is None for done in rounds)
    if codes[0] == "kicks":
        assert rounds[0].details == {"constants": ()}
    else:
        assert all(r.code != "kicks" for r in rounds[0].table.rows)
        assert rounds[0].table.rows[1].probability == pytest.approx(1.0)
