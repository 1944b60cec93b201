"""What print(report) says, and what is told where a number or a motion is not known."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

import bsp_gp
from bsp_gp.fitting.estimates import ConstantEstimate
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import headline
from bsp_gp.report.summary import summary_text
from bsp_gp.report.unseen_body import name_of
from tests.unit import report_sample as sample


def test_a_report_tells_name_probability_constants_and_rivals():
    assert bsp_gp.LoopReport.words, "whoever asks for reports gets words"
    lines = repr(sample.adopted()).splitlines()
    text = "\n".join(lines)
    assert len(lines) <= 10
    assert "found (probability " in text and "drag, quadratic in speed" in text
    assert "g = 9.807 [9.791, 9.822] m/s²" in text
    assert "these data do not tell it from " in text
    assert "seen, not adopted" in repr(sample.seen_not_adopted())


def without_after(value):
    report = sample.adopted()
    after = replace(report.total["after"], rollout_rmse=value)
    return replace(report, total={**report.total, "after": after})


@pytest.mark.parametrize(
    ("value", "left_out", "words"),
    [(math.inf, (), "run away"), (math.nan, ("errors",), "the time was up"),
     (math.nan, (), "its constants or tracks were not found")],
)  # fmt: skip
def test_an_error_that_is_missing_has_its_reason(value, left_out, words):
    report = replace(without_after(value), left_out=left_out)
    told = headline(page_of(report))
    assert words in told["text"] and "→" not in told["text"] and not told["has_after"]
    assert "→ –" not in summary_text(report)
    assert "nan" not in repr(report)


def hidden(motion, *rivals):
    """An unseen body as pages read it, its place with a skew interval."""
    constants = tuple(ConstantEstimate(*each) for each in (
        ("h_x1", -24, -26, -6, "au"), ("h_y1", 6, -3, 7, "au"), ("M1", 0.045, 0.007, 0.047, "Msun"),
    ))  # fmt: skip
    details = {"names": ["h_x1", "h_y1", "M1"], "centre": [0, 0], "property": "mass",
               "motion": motion, "epoch": 1988.04, "time_unit": "yr"}  # fmt: skip
    return SimpleNamespace(name="", details=details, constants=constants, equivalents=rivals)


def test_an_unseen_body_is_told_with_intervals_and_its_motion_in_words():
    place = "of 0.045 [0.007, 0.047] Msun at (−24 [−26, −6], 6 [−3, 7]) au"
    told = name_of(hidden("under the law", "moving: at (-20, 3)"))
    assert told == (
        f"an unseen body {place} at t = 1988.04 yr, moved by the law as the others are (how it "
        "moves is not told by these data: moving straight on fits as well)"
    )
    assert name_of(hidden("at rest")) == f"an unseen body {place}, at rest"
