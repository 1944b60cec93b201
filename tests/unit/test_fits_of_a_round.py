"""Which proposals of a round are fitted, and how many."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.clock import Clock
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.decide import Decision
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.rows import is_less
from bsp_gp.loop.table import HeldOut, Row
from bsp_gp.loop.turn import Turn
from tests.throws import throws


def test_fits_are_no_more_than_asked_for_where_families_give_up(monkeypatch):
    """Each that is passed over takes a fit away; none may take more than there are."""
    data = throws(n_scenes=3, n_times=12)
    hypothesis = Hypothesis.from_laws(data, ())
    run = SimpleNamespace(
        criteria=Criteria(most_fits=4), dataset=data, bounds={}, clock=Clock(None), proposers=(),
        says=lambda text: None, is_usual=lambda proposal: False,
    )  # fmt: skip
    turn, fitted = Turn(run, fit(hypothesis, data), hypothesis), []
    for name, count in (("a", 12), ("b", 30)):
        own = tuple(
            Proposal("contact", f"{name} {k}", hypothesis, -3.0, 16.0 - 0.01 * k - (name == "b"))
            for k in range(count)
        )
        turn.families.append(Family(name, own, 20.0, 1))
    turn.chances = {"a": 1e-6, "b": 1e-6}

    def followed(source, proposal, found):
        fitted.append(proposal.text)
        nats = turn.rows[0].log_posterior + (1.0 if source == "b" else -1e3)
        row = Row(len(turn.rows), "contact", proposal.text, source, "converged", nats, 0.0, nats, 4)
        return row, proposal

    fits = SimpleNamespace(result=lambda k: None, end=lambda: None)
    monkeypatch.setattr(turn, "_fits", lambda queue: fits)
    monkeypatch.setattr(turn, "_followed", followed)
    monkeypatch.setattr(turn, "note_gain", lambda *_: None)
    monkeypatch.setattr(turn, "_tell_near", lambda *_: None)
    turn.fit_best()
    assert len(fitted) == 4


def test_what_explains_less_than_the_law_that_it_extends_is_no_candidate():
    """It may be likelier, saying less of its numbers: it is another minimum, and no cause more."""
    data = throws(n_scenes=3, n_times=12)
    hypothesis = Hypothesis.from_laws(data, ())
    base = fit(hypothesis, data)
    run = SimpleNamespace(criteria=Criteria(), proposers=(), dataset=data)
    turn = Turn(run, base, hypothesis)
    wider = Proposal("law", "c * v_i", hypothesis, -3.0, 16.0)
    for times, status in ((1.5, "less"), (0.5, base.status)):  # of what is negative
        found = replace(base, log_likelihood=times * base.log_likelihood)
        row = turn._fitted("laws", wider, (found, found, 0.0))
        assert row.status == status and row.is_fit == (times < 1)


@pytest.mark.parametrize("left_out, leaves_nothing, verdict", [
    ([], False, "effect adopted"), (["fits"], True, "effect adopted"),
    (["fits"], False, "cannot tell"), (["proposers", "fits"], True, "effect adopted"),
    (["proposers"], False, "cannot tell"), (["fits", "held_out"], True, "cannot tell"),
])  # fmt: skip
def test_where_the_time_is_up_a_law_that_leaves_nothing_stands(left_out, leaves_nothing, verdict):
    """Not as fact: rivals that were not fitted may do as well."""
    data = throws(n_scenes=3, n_times=12)
    hypothesis = Hypothesis.from_laws(data, ())
    turn = Turn(
        SimpleNamespace(criteria=Criteria(), proposers=()), fit(hypothesis, data), hypothesis
    )
    best = Row(1, "law", "c * v_i", "laws", "converged", 50.0, -3.0, 50.0, 5)
    turn.left_out = left_out
    turn.leaving_nothing = [(1, 1, 47.0)] if leaves_nothing else []
    said = turn.in_time(Decision("effect adopted", "adopted", best, True, (), True))
    assert said.verdict == verdict and said.is_adopted == (verdict == "effect adopted")
    assert said.is_fact == (not left_out)


def test_what_was_not_asked_is_told_though_all_is_asked_under_other_noise():
    """What is asked without a memory of the noise is asked anew, and says nothing of the rest."""
    turn = SimpleNamespace(
        unasked=["walls"], left_out=[], families=[], near=None, missing=0.0, levels=None,
        chances={}, run=SimpleNamespace(proposers=(), criteria=Criteria()), known={},
        propose=lambda *asked, **told: setattr(turn, "unasked", []),
    )  # fmt: skip
    turn.note = turn.left_out.append
    Turn.ask_without_memory(turn, 1, SimpleNamespace(in_white=lambda: (None, 0.0)))
    assert turn.left_out == ["proposers"] and not turn.unasked


@pytest.mark.parametrize("part, kept, verdict", [
    (0.2, 0.0, "effective law"), (0.4, 0.0, "cannot tell"), (0.4, 0.99, "effective law"),
    (0.6, 0.99, "cannot tell"),
])  # fmt: skip
def test_where_the_time_is_up_a_law_that_other_scenes_bear_out_describes(part, kept, verdict):
    data = throws(n_scenes=3, n_times=12)
    hypothesis = Hypothesis.from_laws(data, ())
    run = SimpleNamespace(criteria=Criteria(), proposers=(), dataset=data)
    turn = Turn(run, fit(hypothesis, data), hypothesis)
    turn.left_out = ["fits"]
    told = HeldOut(kept * 1000.0, 1.0, 1000.0)
    best = Row(1, "law", "c * v_i", "laws", "converged", 5.0, 0.0, 5.0, 1, held_out=told,
               left=part * turn.rows[0].left)  # fmt: skip
    assert turn.in_time(Decision("effect adopted", "adopted", best, True)).verdict == verdict
    lost = replace(turn.rows[0], left=math.nan)  # then by how far bodies move
    turn.rows[0] = lost
    far = replace(best, left=100.0)
    assert turn.in_time(Decision("effect adopted", "adopted", far, True)).verdict == "cannot tell"


def test_a_law_is_not_less_for_noise_that_was_not_fitted_beside_it():
    """Sums of a gyroscope: under a noise of its own a pendulum was less likely than no law."""
    data = throws(n_scenes=3, n_times=12)
    base = fit(Hypothesis.from_laws(data, ()), data)
    size = abs(base.log_likelihood)
    found = replace(base, log_likelihood=base.log_likelihood - size)
    assert is_less(base, found) and is_less(base, found, 0.5 * size)
    assert not is_less(base, found, 1.5 * size)


def test_rods_that_were_fitted_before_all_others_are_not_fitted_again():
    """Where the time was up behind them a bowl was told as no law at all."""
    data = throws(n_scenes=3, n_times=12)
    hypothesis = Hypothesis.from_laws(data, ())
    run = SimpleNamespace(
        criteria=Criteria(), dataset=data, bounds={}, clock=Clock(None), proposers=(),
    )  # fmt: skip
    begun = fit(hypothesis, data)
    rod = Proposal("rod", "L", hypothesis, 0.0, 1.0, rank=2, kind="constraint")
    turn = Turn(run, begun, hypothesis, known={rod.key: [("rods", rod, (begun, begun, 5.0))]})
    (told,) = turn._take_over(rod.key)
    assert told == (turn.rows[1], rod) and not turn._take_over(rod.key)
    assert [row.code for row in turn.rows] == ["base", "rod"]
