from fractions import Fraction

import pytest

from bsp_gp import units
from bsp_gp.errors import UnitError
from bsp_gp.units import ACCELERATION, DIMENSIONLESS, FORCE, Unit, UnitSystem, parse_unit


def test_arithmetic():
    speed = Unit.of(m=1, s=-1)
    assert speed / Unit.of(s=1) == ACCELERATION
    assert ACCELERATION * Unit.of(kg=1) == FORCE
    assert (speed**2) ** Fraction(1, 2) == speed
    assert (speed / speed).is_dimensionless
    assert speed / speed == DIMENSIONLESS
    assert hash(speed**2) == hash(Unit.of(m=2, s=-2))


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        (DIMENSIONLESS, "1"),
        (FORCE, "kg m/s^2"),
        (Unit.of(s=-1), "1/s"),
        (Unit.of(kg=-1, m=3, s=-2), "m^3/(kg s^2)"),
        (Unit.of(m=Fraction(1, 2)), "m^(1/2)"),
    ],
)
def test_text_round_trip(unit, text):
    assert str(unit) == text
    assert parse_unit(text) == (1.0, unit)


@pytest.mark.parametrize(
    ("text", "scale", "unit"),
    [
        ("cm", 0.01, Unit.of(m=1)),
        (" km/h ", 1 / 3.6, Unit.of(m=1, s=-1)),
        ("m/s²", 1.0, ACCELERATION),
        ("cm·s⁻²", 0.01, ACCELERATION),
        ("N/cm", 100.0, Unit.of(kg=1, s=-2)),
        ("g", 1e-3, Unit.of(kg=1)),
        ("C", 1.0, Unit.of(A=1, s=1)),
        ("deg", 0.017453292519943295, DIMENSIONLESS),
        ("", 1.0, DIMENSIONLESS),
    ],
)
def test_parse(text, scale, unit):
    got_scale, got_unit = parse_unit(text)
    assert got_scale == pytest.approx(scale, rel=1e-14)
    assert got_unit == unit


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("furlongz", "unknown unit"),
        pytest.param("°C", "offset"),
        ("__import__('os')", "product of powers"),
        pytest.param("m/", "unknown unit"),
        pytest.param("m(", "unknown unit"),
        ("EUR", "unknown unit"),
        ("m" * 100, "product of powers"),
    ],
)
def test_bad_units(text, expected):
    with pytest.raises(UnitError, match=expected):
        parse_unit(text)
    with pytest.raises(UnitError, match="base units must be among"):
        Unit.of(feet=1)


def test_unit_systems():
    si = UnitSystem.from_declared({"length": "cm", "time": "s", "mass": "kg"})
    assert si.text(FORCE) == "kg m/s^2"
    assert si.is_calibrated(FORCE)
    pixels = UnitSystem.from_declared({"length": "px", "time": "s"})
    assert pixels.text(ACCELERATION) == "px/s^2"
    assert not pixels.is_calibrated(ACCELERATION)
    assert pixels.is_calibrated(Unit.of(s=1))
    assert UnitSystem.from_declared({}).text(FORCE) == "mass length/time^2"


@pytest.mark.parametrize(
    "text",
    ["m", "kg", "cm", "km", "mm", "ms", "g", "N", "C", "J", "m/s", "m/s^2", "kg m/s^2", "kg*m",
     "N/m", "kg/s", "s^-2", "N*m^2/kg^2", "kg m^2 s^-2", "N m^2/C^2"],
)  # fmt: skip
def test_the_commonest_units_are_what_pint_makes_of_them(text):
    quantity = units._in_base_units(text)
    scale, unit = units._plain_unit(text)
    assert scale == float(quantity.magnitude)
    powers = {units._DIMENSION[name]: power for name, power in quantity.dimensionality.items()}
    assert unit.exponents == tuple(powers.get(k, 0) for k in range(len(units.BASE)))
    assert units._plain_unit(f"{text}/s s") is None  # what others may read otherwise is pint's


@pytest.mark.parametrize(
    ("declared", "said"),
    [({}, "2.125e+11 time"), ({"time": "s"}, "2.125e+11 s"), ({"time": "day"}, "2459490.74 day"),
     ({"time": "ms"}, "2.125e+14 ms")],
)  # fmt: skip
def test_an_instant_is_told_as_times_were_given(declared, said):
    """A row of a table by days was far off "at t = 2.125e+11"."""
    assert UnitSystem.from_declared(declared).instant(212_500_000_000.0) == said
