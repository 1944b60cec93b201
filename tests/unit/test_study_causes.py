"""What the studies of the loop take for the right cause: `experiments/causes.py`."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"


@pytest.fixture(scope="module")
def causes():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS))
        import causes

        yield causes
    sys.modules.pop("causes", None)


@pytest.fixture(scope="module")
def judge(causes):
    from bsp_gp.simulate.effects import effect
    from bsp_gp.simulate.synth import make, preset

    drag = effect("drag", 0.02, is_declared=False)
    settings = preset("fall", [drag], has_table=False, noise=0.0, n_frames=12, n_scenes=3)
    dataset, truth = make(settings, np.random.default_rng(3))
    return causes.Judge(dataset, truth, truth.declared)


@pytest.mark.parametrize(
    ("code", "text", "is_right"),
    [
        ("law", "c * v_i", True),
        ("law", "k * norm(v_i) * normalize(v_i)", True),
        ("law", "c * norm(v_i) * v_i", False),
        ("law", "a * v_i + b * e_x", False),  # a term that is not needed
        ("law", "an error of the camera", False),
        ("clock", "c * v_i", False),  # of another code, whatever it is called
        ("number", "number of 9.81 [m/s^2] * m_i * down", False),
    ],
)
def test_the_right_form_is_known_by_code_and_law(causes, judge, code, text, is_right):
    assert judge.is_form(causes.Cause(code, text)) is is_right


def test_a_freed_exponent_is_a_law_in_the_place_of_a_declared_term(causes):
    cause = causes.Cause("exponent", "exponent of norm(p_i - p_j) in G * m_i * (p_j - p_i)")
    assert cause.law == "(norm(p_i - p_j))^n * (G * m_i * (p_j - p_i))"


def test_a_term_with_its_exponent_freed_is_the_law_that_it_is_written_as(causes):
    text = "(norm(p_i - p_j) / 2 [m])^n1 * (G * m_i * (p_j - p_i))"
    assert causes.Cause("exponent", text).law == text
    assert causes.Cause("number", "(1 + s1) * (m_i * down)").law == "(1 + s1) * (m_i * down)"


def test_a_law_is_taken_for_what_has_its_form(causes, judge):
    terms, start = judge.terms(causes.Cause("law", "2 [kg/s] * v_i"))
    law = judge.declared.plus(terms[0], start)
    assert judge.name_of(law) == "linear drag"


def test_rivals_keep_the_code_of_their_rows(causes):
    others = ("x = R(tilt) X", "c * e_x")
    effect = SimpleNamespace(
        code="law", law="c1 * v_i", name="c * v_i", constants=(), equivalents=others
    )
    rows = [{"law": others[0], "code": "tilt"}]
    done = SimpleNamespace(effect=effect, hypotheses=rows, adopted=True)
    assert [cause.code for cause in causes.causes_of(done)] == ["law", "tilt", "law"]
    assert causes.causes_of(done)[0].text == "c1 * v_i"
    assert causes.is_adopted(done)
    effect.code = "noise"
    assert not causes.is_adopted(done)
    assert causes.causes_of(done) == []
