"""Which proposals promise too little, beside what was found, to be fitted."""

from types import SimpleNamespace

from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.turn import Turn

NOTHING = {False: 0.0, True: 0.0}


def is_behind(
    promise, gain, *, missing, measures, found=NOTHING, kept=NOTHING, spare=NOTHING, **more
):
    turn = SimpleNamespace(
        found=found, kept=kept, spare=spare, missing=missing,
        run=SimpleNamespace(criteria=Criteria()),
    )  # fmt: skip
    kind = {"kind": "force", "is_afresh": False, **more}
    proposal = SimpleNamespace(promise=promise, gain=gain, **kind)
    return Turn.is_behind(turn, proposal, measures)


def test_a_law_that_explains_all_that_moments_miss_is_fitted_whatever_a_rod_has_gained():
    found = {False: 3000.0, True: 0.0}
    assert is_behind(1000.0, 2000.0, found=found, missing=8000.0, measures={False})
    assert not is_behind(1000.0, 2000.0, found=found, missing=2100.0, measures={False})


def test_what_rows_have_gained_is_of_another_measure():
    found = {False: 0.0, True: 3000.0}
    assert not is_behind(1000.0, 2000.0, found=found, missing=8000.0, measures={False})
    assert is_behind(1000.0, 2000.0, found=found, missing=2100.0, measures={False, True})


def test_what_is_far_behind_a_law_that_explains_all_is_not_fitted():
    """By more than a hundred nats, and than moments are off by."""
    of_all = {"missing": 2000.0, "measures": {False}, "kept": {False: 1000.0, True: 0.0}}
    assert is_behind(890.0, 1900.0, **of_all)
    assert not is_behind(910.0, 1900.0, **of_all)
    assert not is_behind(890.0, 1900.0, **of_all, spare={False: 120.0, True: 0.0})


def test_names_that_are_swapped_are_tried_whatever_rows_that_are_left_out_have_gained():
    """Of two tracks that bear each other's names the rows behind the swap were left out."""
    of_all = {"missing": 2000.0, "measures": {True}, "kept": {False: 0.0, True: 1000.0}}
    assert is_behind(890.0, 1900.0, **of_all, kind="measurement")
    assert not is_behind(890.0, 1900.0, **of_all, kind="measurement", is_afresh=True)
