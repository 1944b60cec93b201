"""Laws that are the same on the data are told once, in the units of the data."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.loop.writing_up import about_data
from bsp_gp.report.page import page_of
from bsp_gp.report.recording import data_text
from bsp_gp.report.rewritings import dependence, other_way, rewritten, told_once
from bsp_gp.report.summary import summary_text
from tests.unit.report_sample import adopted

KNOWN = {"is_constant": True, "is_vector": False, "unit": ["1", "0", "0", "0", "0", "0", "0"]}
ONE_MASS = {"properties": {"mass": KNOWN}, "way": ""}
FALL = {**ONE_MASS, "way": "x"}
DRAG = "c1 * (norm(v_i)^2 * normalize(v_i))"


@pytest.mark.parametrize(
    ("law", "others", "dataset", "kept"),
    [
        (DRAG, ["c1 * (m_i * norm(v_i)^2 * normalize(v_i))",
                "c1 * (inverse(m_i^2) * norm(v_i)^2 * normalize(v_i))"], ONE_MASS, []),
        (DRAG, ["c1 * (norm(v_i)^2 * e_x)", "c1 * (m_i * norm(v_i)^2 * e_x)"], FALL, []),
        (DRAG, ["c1 * (norm(v_i)^2 * e_x)", "c1 * (m_i * norm(v_i)^2 * e_x)"], ONE_MASS,
         ["c1 * (norm(v_i)^2 * e_x)"]),
        (DRAG, ["c1 * (m_i * norm(v_i)^2 * normalize(v_i))"], {}, None),
        (DRAG, ["c1 * (norm(v_i) * normalize(v_i))"], FALL, None),
        ("c1 * (m_i * normalize(v_i))",
         ["c1 * normalize(v_i)", "c1 * (m_i * normalize(v_i)) + c2 * (norm(v_i) * e_y)",
          "c1 * (m_i * normalize(v_i)) + c2 * (m_i * norm(v_i) * e_y)"], FALL,
         ["c1 * (m_i * normalize(v_i)) + c2 * (norm(v_i) * e_y)"]),
        ("c1 * (q_i * v_i)", ["c1 * v_i"], ONE_MASS, None),
        ("", ["an unseen body at rest"], FALL, None),
    ],
)  # fmt: skip
def test_only_what_differs_on_the_data_is_kept(law, others, dataset, kept):
    found, n_same, why = told_once(law, others, dataset)
    kept = others if kept is None else kept
    assert found == tuple(kept) and n_same == len(others) - len(kept) and bool(why) == (n_same > 0)


def test_the_phrase_says_how_many_and_why():
    others = ["c1 * (m_i * norm(v_i)^2 * normalize(v_i))", "c1 * (norm(v_i)^2 * e_x)"]
    assert rewritten(*told_once(DRAG, others, FALL)[1:]) == (
        "2 others that are the same on these data (powers of m_i, e_x for normalize(v_i))"
    )


def test_a_report_tells_them_once_and_keeps_them_all():
    report = adopted()
    effect = report.rounds[0].effect
    more = [effect.law.replace("c1", "c1 * m_i")]
    effect = dataclasses.replace(effect, equivalents=tuple(more))
    first = dataclasses.replace(report.rounds[0], effect=effect)
    dataset = {**report.dataset, **ONE_MASS}
    changed = dataclasses.replace(report, rounds=(first, *report.rounds[1:]), dataset=dataset)
    assert not page_of(changed).rounds[0].effect.equivalents
    assert "1 other that is the same on these data (powers of m_i)" in " ".join(
        summary_text(changed).split()
    )
    assert changed.rounds[0].effect.equivalents == tuple(more)


def data(y=0.0, x=None, **settings):
    t = np.linspace(0, 1, 12)
    frame = pd.DataFrame({"t": t, "x": -(t**2) if x is None else x(t), "y": y * t})
    return bsp_gp.Dataset.from_frames(frame, units={"length": "au", "time": "yr"}, **settings)


@pytest.mark.parametrize(
    ("dataset", "way"),
    [
        (data(), "-x"), (data(x=lambda t: t**2), "x"), (data(y=1.0), ""),
        (data(x=lambda t: t - 2 * t**2), ""),
    ],
)  # fmt: skip
def test_one_way_along_one_axis_is_seen(dataset, way):
    class Split:
        train, test, told = (), (), ""

    assert about_data(dataset, Split, ())["way"] == way


def test_what_check_says_and_the_report_are_in_the_units_of_the_data():
    text = data_text(data())
    assert "Units: length in au, time in yr\n" in text
    assert "t from 0 to 1.000 yr" in text and "from −1.000 to 0 au" in text
    report = adopted()
    units = {"length": "au", "time": "yr", "mass": "Msun"}
    bound = {"snr": 3.0, "force": 6.8e21, "unit": "kg m/s^2", "percent": 0.001}
    report = dataclasses.replace(
        report, dataset={**report.dataset, "units": units, "symbols": {}}, hidden_bound=bound
    )
    near = dataclasses.replace(
        report, dataset={**report.dataset, "units": {"length": "cm", "time": "s", "mass": "kg"}}
    )
    assert "force of up to 6.8e+21 N is" in repr(near)
    for told in (repr(report), " ".join(summary_text(report).split())):
        assert "of up to" in told and "Msun" in told and " N " not in told


SEVERAL = {"properties": {"mass": {"is_constant": False}, "q": {"is_constant": True}}}
ACROSS = "c1 * (norm(v_i) * perp(normalize(v_i)))"
PER_MASS = "c1 * (inverse(m_i) * norm(v_i) * perp(normalize(v_i)))"
TIMES_MASS = "c1 * (m_i^2 * norm(v_i) * perp(normalize(v_i)))"


@pytest.mark.parametrize(
    ("law", "others", "tried", "words"),
    [
        (ACROSS, [], [ACROSS, PER_MASS], "the force does not depend on the mass is told"),
        (TIMES_MASS, [], [PER_MASS], "the force is proportional to the mass to the 2 is told"),
        (ACROSS, [PER_MASS], [PER_MASS], f"these data do not tell: {PER_MASS} does as well"),
        (ACROSS, [], [ACROSS, "c1 * perp(normalize(v_i))", "t = (1 + clock) T"], ""),
        ("c1 * v_i + c2 * e_x", [], ["c1 * m_i * v_i + c2 * e_x"], ""),
        ("", [], [PER_MASS], ""),
    ],
)  # fmt: skip
def test_whether_the_data_tell_how_a_force_depends_on_the_mass(law, others, tried, words):
    told = dependence(law, others, tried, SEVERAL)
    assert words in told and bool(told) == bool(words)
    assert not dependence(law, others, tried, {"properties": {"mass": {"is_constant": True}}})


@pytest.mark.parametrize(
    ("law", "strength", "way", "said"),
    [
        ("c1 * e_x", -2.3, "x", "or friction"), ("c1 * e_x", 2.3, "-x", "or friction"),
        ("c1 * e_x", 2.3, "x", ""),  # it drives
        ("c1 * normalize(v_i)", -2.3, "-x", "or a push along x"), ("c1 * e_x", -2.3, "", ""),
        ("c1 * (norm(v_i)^2 * normalize(v_i))", -2.3, "-x", ""),  # no push grows with the speed
    ],
)  # fmt: skip
def test_what_brakes_where_nothing_turns_back_may_be_friction(law, strength, way, said):
    dataset = {**ONE_MASS, "way": way}
    swap = [("e_x", "normalize(v_i)"), ("normalize(v_i)", "e_x")]["normalize" in law]
    other = law.replace(*swap)
    effect = SimpleNamespace(written=law, constants=(SimpleNamespace(value=strength),))
    told = other_way(effect, told_once(law, [other], dataset)[2], dataset)
    assert (said in told) if said else told == ""
