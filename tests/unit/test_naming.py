"""Terms in plain words, and laws that are not told apart from themselves."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.fitting.estimates import ConstantEstimate
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.formula import rename_constants
from bsp_gp.language.inputs import input_types
from bsp_gp.language.operators import Type
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposal import Proposal
from bsp_gp.physics.force import ForceLaw, Term, fresh_name
from bsp_gp.report.naming import (
    SWINGS,
    along_one_line,
    bad_rows,
    clock_jumps,
    constant_distance,
    describe,
    kept_curve,
    period,
)
from bsp_gp.report.page import _parts
from bsp_gp.report.sentences import group_range, powers_sentence
from bsp_gp.units import Unit
from tests.fitted_tracks import law_of
from tests.worlds import WEIGHT, flights, linear_drag

TYPES = input_types(PROPERTY_UNITS, up="y") | {"wind": input_types(PROPERTY_UNITS)["v_i"]}
R = "norm(p_i - p_j)"


def formula(text):
    return parse_formula(text, TYPES)


@pytest.mark.parametrize(
    ("law", "value", "name"),
    [
        ("c1 * norm(v_i) * normalize(v_i)", -0.1, "drag, linear in speed"),
        ("c1 * v_i", -0.1, "drag, linear in speed"),
        ("c1 * ((x_i - X)^3 * m_i * e_x)", -0.1,
         "spring along x that hardens or softens, cubic in its stretch"),
        ("c1 * (abs(x_i - X) * (x_i - X) * e_x)", -0.1,
         "spring along x that hardens or softens, quadratic in its stretch"),
        ("c1 * v_i", None, "drag, linear in speed"),
        ("c1 * v_i", 0.1, "forward push, linear in speed"),
        ("c1 * norm(v_i) * v_i", -0.1, "drag, quadratic in speed"),
        ("c1 * norm(v_i)^2 * normalize(v_i)", -0.1, "drag, quadratic in speed"),
        ("c1 * norm(v_i)^3 * normalize(v_i)", -0.1, "drag, cubic in speed"),
        ("c1 * inverse(norm(v_i)) * normalize(v_i)", -0.1, "drag, power -1 in speed"),
        ("c1 * R_i^2 * norm(v_i)^2 * normalize(v_i)", -0.1, "drag, quadratic in speed"),
        ("c1 * normalize(v_i)", -0.1, "friction of constant size"),
        ("c1 * m_i * tanh(norm(v_i) / 2 [m/s]) * normalize(v_i)", -0.1,
         "drag, as tanh(norm(v_i) / 2 [m/s])"),
        ("c1 * normalize(v_i)", 0.1, "forward push of constant size"),
        ("c1 * m_i * mu_j * normalize(v_i) * is_on(s_i, p_i, s_j, p_j)", -9.8,
         "friction of constant size while on the mat"),
        ("c1 * q_i * norm(v_i) * perp(normalize(v_i))", 1.0,
         "force across the velocity, linear in speed (magnetic, Magnus or Coriolis)"),
        ("c1 * m_i * norm(v_i) * perp(normalize(v_i))", 1.0,
         "force across the velocity, to its left, linear in speed (magnetic, Magnus or Coriolis)"),
        ("c1 * perp(v_i)", -1.0,
         "force across the velocity, to its right, linear in speed (magnetic, Magnus or Coriolis)"),
        ("c1 * norm(v_i)^2 * perp(normalize(v_i))", None,
         "force across the velocity, quadratic in speed (magnetic or Magnus)"),
        ("c1 * perp(normalize(v_i))", 1.0,
         "force across the velocity, to its left, of constant size (magnetic or Magnus)"),
        (f"c1 * inverse({R}) * norm(v_i) * perp(normalize(v_i))", 1.0,
         "force across the velocity, to its left, linear in speed, as distance⁻¹ (magnetic, "
         "Magnus or Coriolis)"),
        ("c1 * norm(v_i) * cross(e_x, normalize(v_i))", 1.0,
         "force across the velocity, linear in speed (magnetic, Magnus or Coriolis)"),
        ("c1 * tanh(norm(v_i) / 2 [m/s]) * perp(normalize(v_i))", 1.0,
         "force across the velocity, to its left, as tanh(norm(v_i) / 2 [m/s])"),
        ("c1 * e_x", 1.0, "uniform push along x"),
        ("c1 * m_i * e_y", 1.0, "uniform push along y"),
        ("c1 * norm(v_i) * e_y", 1.0, "force along y, as speed"),
        ("c1 * vx_i^3 * m_i * e_x", -1.0, "drag along x, cubic in speed"),
        ("c1 * abs(vx_i) * vx_i * e_x", 1.0, "forward push along x, quadratic in speed"),
        ("c1 * vx_i * e_y", 1.0, "force along y, as speed along x"),
        (f"c1 * pow({R}, -4) * perp(normalize(p_i - p_j))", 1.0,
         "force across the line to the other body, as distance⁻⁴"),
        (f"c1 * m_i * m_j * inverse(square({R})) * normalize(p_i - p_j)", -1.0,
         "pull to the other body, as distance⁻²"),
        (f"c1 * q_i * q_j * inverse(square({R})) * normalize(p_i - p_j)", 1.0,
         "push from the other body, as distance⁻²"),
        (f"c1 * pow({R}, -3) * normalize(p_i - p_j)", None,
         "force along the line to the other body, as distance⁻³"),
        (f"c1 * ({R} - l_i) * normalize(p_i - p_j)", -8.0, "spring towards the other body"),
        (f"c1 * m_j * {R} * normalize(p_i - p_j)", -8.0, "pull to the other body, as distance"),
        ("c1 * along(v_i - v_j, p_i - p_j) * normalize(p_i - p_j)", -8.0,
         "drag between the bodies along their line (a dashpot), linear in speed"),
        ("c1 * normalize(v_i - v_j)", -8.0, "force along the relative velocity"),
        ("m_i * (Omega1^2 * (p_i - origin) + -2 * Omega1 * perp(v_i))", None,
         "a frame that turns (Coriolis and centrifugal forces)"),
        ("c1 * (v_i - wind)", -0.1, "drag against the wind, linear in speed"),
        ("c1 * norm(v_i - wind) * (v_i - wind)", -0.1, "drag against the wind, quadratic in speed"),
        ("c1 * (v_i - wind)", 0.1, "force along the v_i - wind"),
        ("c1 * normalize(p_i - p_c) * does_collide(s_i, p_i, s_j, p_j)", 1.0,
         "push from the other body at contact"),
    ],
)  # fmt: skip
def test_describe(law, value, name):
    assert describe(formula(law), value) == name


def test_a_spring_that_depends_on_speed_is_not_called_a_spring():
    """What tests/statistical/test_other_effects.py met: (r - l) / |v| named like Hooke's law."""
    hooke = describe(formula(f"c1 * ({R} - l_i) * normalize(p_i - p_j)"), -1.0)
    odd = describe(formula(f"c1 * ({R} - l_i) * inverse(norm(v_i)) * normalize(p_i - p_j)"), -1.0)
    assert odd != hooke


def test_constants_get_fresh_names():
    law = ForceLaw([Term(formula("c1 * v_i")), Term(formula("c3 * e_x"))], {"c1": 1.0, "c3": 1.0})
    assert fresh_name(law) == "c2"
    assert fresh_name(law, "s") == "s1"
    renamed = rename_constants(formula("c1 * norm(v_i) * v_i"), {"c1": "c7"})
    assert renamed.constants == ("c7",)


@pytest.mark.parametrize(
    "text",
    [
        "c1 * (m_i * inverse(m_i) * norm(v_i) * normalize(v_i))",
        "c1 * (norm(v_i) * normalize(v_i) * m_i^2 * inverse(m_i^2))",
        "c1 * v_i",
    ],
)
def test_no_rewriting_of_a_law_is_told_as_another(text):
    own = formula("c1 * (norm(v_i) * normalize(v_i))")
    other = formula("c1 * (m_i * v_i)")
    ties = (formula(text), other, formula("c1 * (m_i^2 * inverse(m_i) * v_i)"))
    proposal = Proposal(
        "law", "", Hypothesis(), 0.0, 1.0, formulas=(own,), ties=ties, n_dims=2
    )  # fmt: skip
    assert proposal.texts_of_ties == ("c1 * (m_i * v_i)",)


@pytest.mark.slow
def test_a_law_is_not_listed_as_one_that_cannot_be_told_from_itself():
    data = flights(0, linear_drag)
    report = close_loop(data, [WEIGHT], rng=np.random.default_rng(0), max_rounds=1, n_bootstrap=0)
    effect = report.rounds[0].effect
    value = effect.constants[0].value
    assert describe(effect.formula, value) == "drag, linear in speed"
    told = [e for e in effect.equivalents if "inverse(m_i)" in e or "inverse(q_i)" in e]
    assert not [e for e in told if "m_i * inverse(m_i)" in e or "q_i * inverse(q_i)" in e]


def test_a_power_whose_neighbours_are_not_excluded_is_told_with_its_interval():
    speed = {"of": "norm(v_i)", "stated": 1.0, "value": 1.5, "low": 1.2, "high": 1.8}
    drag = formula("c1 * norm(v_i) * normalize(v_i)")
    assert describe(drag, -1.0, exponents=[{**speed, "is_told": True}]) == "drag, linear in speed"
    loose = describe(drag, -1.0, exponents=[{**speed, "is_told": False}])
    assert loose == "drag, speed to the 1.5 (1.2 to 1.8)"
    across = formula("c1 * norm(v_i) * perp(normalize(v_i))")
    loose = describe(across, 2.0, exponents=[{**speed, "is_told": False}])
    assert loose == (
        "force across the velocity, to its left (magnetic, Magnus or Coriolis), speed to the 1.5 "
        "(1.2 to 1.8)"
    )
    distance = {"of": R, "stated": -2.0, "value": -1.4, "low": -1.6, "high": -1.2}
    pull = formula(f"c1 * inverse({R}^2) * normalize(p_i - p_j)")
    loose = describe(pull, -1.0, exponents=[{**distance, "is_told": False}])
    assert loose == "pull to the other body, distance to the −1.4 (−1.6 to −1.2)"
    # What a law rightly lacks is not told.
    absent = {**speed, "stated": 0.0, "low": -2.0, "is_told": False}
    assert describe(pull, -1.0, exponents=[absent]) == describe(pull, -1.0)


def test_a_power_that_the_data_leave_open_is_not_told_as_a_number():
    speed = {"of": "norm(v_i)", "stated": 2.0, "value": 7.6, "low": 0.15, "high": 15.0,
             "is_told": False, "term": "c1 * norm(v_i)^2 * normalize(v_i)"}  # fmt: skip
    told = describe(formula("c1 * norm(v_i)^2 * normalize(v_i)"), -1.0, exponents=[speed])
    assert told == "drag, its power of speed not told by these data"
    effect = SimpleNamespace(exponents=[speed], varies_with=())
    said = powers_sentence(SimpleNamespace(effect=effect))
    assert said == (
        "Powers that the data allow (90 %): speed to any power from 0.15 to 15, written as 2."
    )


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("ball left out[4, 20:21]", "a bad row: ball of 4, row 21"),
        ("red, 2 left out[run 3, 0:1]; all left out[b, 4:7]",
         "4 bad rows: red, 2 of run 3, row 1; all of b, rows 5 to 7"),
        ("; ".join(f"A left out[{k}, 1:2]" for k in range(6)),
         "6 bad rows: A of 0, row 2; A of 1, row 2; A of 2, row 2; and others in 3 places"),
    ],
)  # fmt: skip
def test_bad_rows_are_told_with_their_places(name, told):
    assert bad_rows(SimpleNamespace(name=name)) == told


@pytest.mark.parametrize("low, high, is_said", [(1e-4, 7e-4, False), (0.3, 0.5, True)])
def test_a_power_that_a_law_lacks_is_said_where_zero_is_far(low, high, is_said):
    power = {"of": "norm(v_i)", "stated": 0.0, "value": (low + high) / 2, "low": low, "high": high,
             "is_told": True, "term": "c1 * e_x"}  # fmt: skip
    effect = SimpleNamespace(exponents=[power], varies_with=())
    assert bool(powers_sentence(SimpleNamespace(effect=effect))) is is_said


@pytest.mark.parametrize(
    ("law", "name"),
    [
        ("c * (1 + sign(x_i - a)) * (1 - sign(x_i - b)) * v_i",
         "drag, linear in speed, between two places"),
        ("c * (1 + sign(x_i - a)) * v_i", "drag, linear in speed, beyond a threshold"),
        ("c * (1 + sign(t - a)) * (1 - sign(t - b)) * v_i",
         "drag, linear in speed, switched on and off in time"),
        ("c1 * (m_i * 0.5 * (1 - sign(t - t1)) * e_x)", "uniform push along x, up to an instant"),
        ("c * exp(-t / T) * perp(v_i)",
         "force across the velocity, linear in speed (magnetic, Magnus or Coriolis), fading with "
         "time"),
        ("c * inverse(1 + (norm(v_i) / u)^2) * v_i",
         "drag that weakens at high speed (an eddy brake)"),
        ("c * exp(-norm(p_i - origin) / H) * (norm(v_i) * v_i)",
         "drag, quadratic in speed, fading with the distance to the origin"),
        ("c * exp(-((x_i - h) / D)^2) * (x_i - h) * e_x",
         "force along x about a place, gone a length away (a dip or a bump)"),
        ("c * ((y_i - h)^2 + D^2)^-1.5 * (y_i - h) * e_y",
         "force along y about a place, gone a length away (a dip or a bump)"),
        ("c * exp(-norm(p_i - p_j) / L) * (v_i - v_j)",
         "force along the relative velocity, fading with a length"),
    ],
)  # fmt: skip
def test_forces_with_constants_inside_are_told_by_where_they_act(law, name):
    assert describe(formula(law)) == name


CENTRE = "(origin + centre_x1 * e_x + centre_y1 * e_y - p_i)"


@pytest.mark.parametrize(
    ("law", "name"),
    [
        (f"c1 * inverse(norm{CENTRE}) * perp(normalize{CENTRE})",
         "force round a point (a vortex), as distance⁻¹"),
        (f"c1 * norm{CENTRE}^n1 * perp(normalize{CENTRE})",
         "force round a point (a vortex), to a fitted power of distance"),
        (f"c1 * inverse(norm{CENTRE}) * normalize{CENTRE}", "force to a point, as distance⁻¹"),
        ("c1 * (1 - ((dot(p_i - origin, e_x) - h_x1) / D1)^2) * v_i",
         "drag that changes its sign a distance away from a place (self-excited, van der Pol)"),
        ("c1 * 0.5 * (1 - sign(dot(p_i - origin, e_x) - h_x1)) * "
         "(h_x1 - dot(p_i - origin, e_x)) * e_x",
         "spring along x on one side of a place (a bumper, a rubber band)"),
        ("c1 * 0.5 * ((1 - sign(dot(p_i - origin, e_x) - h_x1)) * "
         "(h_x1 - dot(p_i - origin, e_x)) + "
         "(1 + sign(dot(p_i - origin, e_x) - H_x1)) * (H_x1 - dot(p_i - origin, e_x))) * e_x",
         "springs along x at both ends (bumpers)"),
        ("c1 * (tanh((dot(p_i - origin, e_x) - h_x1) / D1) * e_x)",
         "spring along x that levels off"),
        ("c1 * (inverse(1 + abs(dot(p_i - origin, e_y) - h_y1) / D1) * "
         "(dot(p_i - origin, e_y) - h_y1) * e_y)", "spring along y that levels off"),
        (f"c1 * (m_i * tanh(norm{CENTRE} / D1) * normalize{CENTRE})",
         "spring to a point that levels off"),
        ("c1 * (tanh(norm(v_i) / u1) * normalize(v_i))",
         "friction that sets in over a range of speeds"),
        ("c1 * (exp(-(norm(v_i) / u1)^2) * normalize(v_i))",
         "friction at low speed alone (Stribeck)"),
        ("c1 * ((exp(2 * (h_x1 - dot(p_i - origin, e_x)) / D1) - "
         "exp((h_x1 - dot(p_i - origin, e_x)) / D1)) * e_x)",
         "force along x as of a bond (Morse)"),
        ("(a1 * cos(w1 * t) + b1 * sin(w1 * t)) * e_x", "push with a period along x"),
        ("(a1 * cos(w1 * t) + b1 * sin(w1 * t)) * dot(p_i - origin, e_x) * e_x",
         "force along x in proportion to x, with a period (an oscillating trap)"),
        ("(a1 * cos(q1 * dot(p_i - origin, e_y)) + b1 * sin(q1 * dot(p_i - origin, e_y))) * e_y",
         "force along y that repeats with y (a washboard, an egg crate)"),
    ],
)  # fmt: skip
def test_laws_with_constants_inside_are_named_by_what_they_do(law, name):
    assert describe(formula(law)) == name


def test_scenes_whose_constant_is_clearly_not_zero_are_named():
    group = [
        ConstantEstimate("c", value, value - error, value + error, "N", entity=name)
        for name, value, error in (("1", 0.1, 0.2), ("2", 1.0, 0.2), ("3", -0.1, 0.1))
    ]
    assert group_range("c[scene]", "N", group).endswith("clearly not zero: 2")
    assert "zero" not in group_range("c[scene]", "N", group[1:2])


def test_a_sense_alone_is_told_as_such():
    types = TYPES | {"spin": Type("scalar", Unit.of(s=-1))}
    term = parse_formula("c1 * (sign(spin) * perp(normalize(v_i)))", types)
    assert "with the sign of spin" in describe(term)
    push = parse_formula("c1 * (sign(spin) * e_y)", types)
    assert describe(push) == "uniform push along y, with the sign of spin"


@pytest.mark.parametrize(("strength", "way"), [(-2.9, "away from"), (2.9, "to")])
def test_the_way_of_a_force_with_constants_inside_is_told(strength, way):
    place = "(centre_x1, centre_y1)"
    (term,) = law_of(f"c * (exp(-norm({place} - p_i) / D) * normalize({place} - p_i))").terms
    expected = f"force {way} a point, fading with distance (exponential)"
    assert describe(term.formula, strength) == expected


def test_each_of_several_forces_is_told_with_the_powers_that_the_data_allow():
    drag, spring = "c1 * norm(v_i)^2 * normalize(v_i)", "c2 * (origin - p_i)"
    law = ForceLaw(tuple(Term(formula(text), is_declared=False) for text in (drag, spring)),
                   {"c1": -1.0, "c2": 3.0})  # fmt: skip
    speed = {"of": "norm(v_i)", "stated": 2.0, "value": 1.1, "low": 0.2, "high": 2.0}
    names = [SimpleNamespace(name=n, value=v) for n, v in law.constants.items()]
    effect = SimpleNamespace(
        code="law", constants=names, formula=None, law="both",
        exponents=({**speed, "term": to_text(law.terms[0].formula), "is_told": False},),
    )  # fmt: skip
    told, other = _parts(effect, law, "the other body")
    assert told == "drag, speed to the 1.1 (0.20 to 2.0)"
    assert other == "force along the line to origin"


def test_components_of_one_vector_are_told_as_one():
    pushes = [f"uniform push along {axis}" for axis in "xyz"]
    assert along_one_line(pushes, [2.0, -1.0, 2.0]) == (
        "uniform push along (0.667, −0.333, 0.667)",
    )
    assert along_one_line(pushes[:1], [2.0]) == ("uniform push along x",)
    assert along_one_line(["drag, linear in speed", pushes[1], pushes[0]], [-1.0, 3.0, 4.0]) == (
        "drag, linear in speed", "uniform push along (0.800, 0.600)",
    )  # fmt: skip
    assert along_one_line(["drag"] * 2, [-1.0, -2.0]) == ("drag", "drag")
    apart = ("force along x, x", "force along y, y")
    assert along_one_line(apart, [1.0, 1.0]) == apart


def test_times_that_are_off_are_told_with_their_rows():
    effect = SimpleNamespace(name="t -0.37 s[run 2, 229:]; t +0.05 s[run 3, 4:]")
    assert clock_jumps(effect) == (
        "times that are off by 0.37 s from row 230 of run 2 on, by -0.05 s from row 5 of run 3 on"
    )


def test_a_period_is_told_with_its_length_and_a_year_as_one():
    def effect(rate, unit):
        return SimpleNamespace(constants=(SimpleNamespace(name="w1", value=rate, unit=unit),))

    assert period(effect(2 * math.pi / 2.5, "1/s")) == ", every 2.500 s"
    assert period(effect(6.279, "1/yr")).startswith(", every 1.001 yr (a year")
    assert "parallax" in period(effect(1.991e-7, "1/s"))
    both = along_one_line([SWINGS + "x", SWINGS + "y"], [1.0, 2.0])
    assert both == ("push with a period along x and y",)


def test_a_power_far_beyond_first_order_is_not_told_as_a_number():
    speed = {"of": "norm(v_i)", "stated": 1.0, "value": -40.0, "low": -52.0, "high": -28.0,
             "is_told": False, "term": "c1 * v_i"}  # fmt: skip
    effect = SimpleNamespace(exponents=[speed], varies_with=())
    assert powers_sentence(SimpleNamespace(effect=effect)) == (
        "Powers that the data allow (90 %): speed to another power than is written, these data do "
        "not tell which."
    )


def numbers(unit, **values):
    return [SimpleNamespace(name=name, value=v, unit=unit) for name, v in values.items()]


def test_rods_and_rails_are_told_as_they_are_in_the_end():
    """A headline had the length that was seen, far outside of the interval below it."""
    name = "norm(p_bob - (0.6993, 0.872)) = 0.828"
    rod = SimpleNamespace(name=name, constants=numbers("cm", pivot_x1=69.1, pivot_y1=82.5, L1=87.9))
    told = "distance to (69.1, 82.5) cm is constant, 87.9 cm: a string or rod"
    assert constant_distance(rod) == told
    known = SimpleNamespace(name=name, constants=numbers("m", c1=1.0))  # nothing of it is fitted
    told = "distance to (0.699, 0.872) m is constant, 0.828 m: a string or rod"
    assert constant_distance(known) == told
    rail = SimpleNamespace(
        name="y_ball = 0.01732 + 0.004631 * x_ball + 0.7573 * x_ball^2",
        constants=numbers("m", rail_a1=0.02, rail_b1=-0.01, rail_c1=0.7167, c1=-7.0),
    )
    assert kept_curve(rail).endswith(": y = 0.02000 - 0.01000 * x + 0.7167 * x^2")
