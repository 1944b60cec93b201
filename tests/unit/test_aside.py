"""A cause that says all of the tracks is a rival of all laws together."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.loop.aside import Aside, is_hopeless, law_beside, settled
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.decide import Decision
from bsp_gp.loop.kept import text_of
from bsp_gp.loop.loop import Round
from bsp_gp.loop.table import HypothesisTable, Row
from tests.unit.test_kicks import kicked, recorded


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


@pytest.mark.parametrize("second, is_hopeless_now", [(500.0, True), (700.0, False)])
def test_laws_that_come_no_nearer_are_given_up(second, is_hopeless_now):
    first = round_of(1, (BASE, LAW, KICKS), adopted(LAW), Aside(adopted(KICKS)))
    assert not is_hopeless([first])
    more = row(1, "law", second)
    rounds = [first, round_of(2, (replace(LAW, id=0), more), adopted(more))]
    assert is_hopeless(rounds) is is_hopeless_now


def test_where_the_time_was_up_nothing_is_taken_back():
    late = Decision("cannot tell", "time_is_up", LAW, False)
    (done,) = settled([round_of(1, (BASE, LAW, KICKS), late, Aside(adopted(KICKS)))])
    assert done.decision is late and done.aside is None


@pytest.mark.slow
def test_what_is_set_aside_is_kept_for_a_run_that_goes_on():
    track = kicked(np.random.default_rng(3), trap=1.0, drag=0.3, n_rows=200)
    data, rounds = recorded(track), []
    whole = close_loop(data, "nothing", rng=0, n_bootstrap=0, on_round=rounds.append)
    assert rounds[0].aside is not None and len(rounds) > 1
    assert [r.effect.code for r in whole.rounds if r.adopted] == ["kicks"]
    again = close_loop(data, "nothing", rng=0, n_bootstrap=0, earlier=text_of(rounds[:1]))
    assert [r.effect.constants for r in again.rounds if r.adopted] == [
        r.effect.constants for r in whole.rounds if r.adopted
    ]
