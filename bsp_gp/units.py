"""Physical units as exponents of the SI base units; text is read and converted at the boundary.

Inside the package every number is SI (or, where a data set is not calibrated, the data's own
unit in the place of the SI one), and a `Unit` is only a tuple of exponents: these are the types
of the grammar.
"""

import copyreg
import functools
import math
import re
from dataclasses import dataclass, field
from fractions import Fraction
from types import MappingProxyType

from bsp_gp.errors import UnitError


def _frozen(mapping):
    return MappingProxyType(mapping)


# They do not travel to worker processes by themselves.
copyreg.pickle(MappingProxyType, lambda mapping: (_frozen, (dict(mapping),)))
BASE = ("kg", "m", "s", "A", "K", "mol", "cd")
_DIMENSION = {
    "[mass]": 0, "[length]": 1, "[time]": 2, "[current]": 3, "[temperature]": 4, "[substance]": 5,
    "[luminosity]": 6,
}  # fmt: skip
_ALLOWED = re.compile(r"[A-Za-zµμ°ΩÅ☉⊙0-9_^*/().\-+ ]{1,60}")
_TOWER = re.compile(
    r"(\^|\*\*)[^ */]*(\^|\*\*)|(\^|\*\*)\s*[-+(]*\d{3,}|[eE]\d{3,}|\d\s*\(|\*\*.*\*\*"
)
"""Towers of powers and powers of three digits, which pint would compute at any cost."""
_RAISED = re.compile(r"[⁺⁻]?[⁰¹²³⁴-⁹]+")
_PLAIN = str.maketrans("⁺⁻⁰¹²³⁴⁵⁶⁷⁸⁹·⋅", "+-0123456789**")


@dataclass(frozen=True)
class Unit:
    """Exponents of (kg, m, s, A, K, mol, cd).

    Examples
    --------
    >>> speed = Unit.of(m=1, s=-1)
    >>> (speed**2).text()
    'm^2/s^2'
    """

    exponents: tuple[int | Fraction, ...] = (0,) * len(BASE)

    @classmethod
    def of(cls, **powers):
        """Build a unit from base units by name, e.g. ``Unit.of(m=1, s=-2)``."""
        unknown = set(powers) - set(BASE)
        if unknown:
            raise UnitError(f"base units must be among {', '.join(BASE)}, got {sorted(unknown)}")
        return cls(tuple(_rational(powers.get(base, 0)) for base in BASE))

    def __post_init__(self):
        # Units are compared and combined in the searches' inner loops, fractions are slow.
        object.__setattr__(self, "_hash", hash(self.exponents))

    def __hash__(self):
        return self._hash

    def __mul__(self, other):
        return _multiplied(self, other)

    def __truediv__(self, other):
        return _divided(self, other)

    def __pow__(self, power):
        return _raised(self, power)

    @property
    def is_dimensionless(self):
        return not any(self.exponents)

    def text(self, symbols=None):
        """Write the unit, e.g. ``kg m/s^2``; `symbols` renames base units (``{'m': 'px'}``)."""
        names = [(symbols or {}).get(base, base) for base in BASE]
        pairs = list(zip(names, self.exponents, strict=True))
        above = [_power_text(n, e) for n, e in pairs if e > 0]
        below = [_power_text(n, -e) for n, e in pairs if e < 0]
        if not above and not below:
            return "1"
        head = " ".join(above) or "1"
        if not below:
            return head
        return f"{head}/{below[0]}" if len(below) == 1 else f"{head}/({' '.join(below)})"

    def __str__(self):
        return self.text()


@functools.lru_cache(maxsize=4096)
def _multiplied(one, other):
    return Unit(tuple(a + b for a, b in zip(one.exponents, other.exponents, strict=True)))


@functools.lru_cache(maxsize=4096)
def _divided(one, other):
    return Unit(tuple(a - b for a, b in zip(one.exponents, other.exponents, strict=True)))


@functools.lru_cache(maxsize=4096)
def _raised(unit, power):
    power = _rational(power)
    return Unit(tuple(a * power for a in unit.exponents))


def _rational(value):
    """A power: an int where it is one (fast), otherwise a fraction."""
    value = Fraction(value).limit_denominator(64)
    return int(value) if value.denominator == 1 else value


def _power_text(name, power):
    if power == 1:
        return name
    return f"{name}^{power}" if power.denominator == 1 else f"{name}^({power})"


DIMENSIONLESS = Unit()
METRE, SECOND, KILOGRAM = Unit.of(m=1), Unit.of(s=1), Unit.of(kg=1)
SPEED = METRE / SECOND
FORCE = Unit.of(kg=1, m=1, s=-2)
ACCELERATION = Unit.of(m=1, s=-2)
GRAVITIES = {"g": 9.80665, "G": 9.80665, "mg": 9.80665e-3}
"""Units of accelerometers that elsewhere are others, m/s^2."""


_OF_THE_SKY = (
    "solar_mass = 1.98841e30 kg = Msun = M_sun", "earth_mass = 5.97217e24 kg = Mearth",
    "jupiter_mass = 1.89812e27 kg = Mjup", "microarcsecond = 1e-6 arcsecond = uas",
    "solar_radius = 6.957e8 m = Rsun = R_sun", "earth_radius = 6.3781e6 m = Rearth = R_earth",
    "jupiter_radius = 7.1492e7 m = Rjup = Rj = RJ = R_J = R_jup",
)  # fmt: skip
_RESPELT = {"AU": "au", "M☉": "Msun", "M⊙": "Msun", "R☉": "Rsun", "R⊙": "Rsun", "R⊕": "Rearth"}
"""pint takes the first for an absorbance, which nobody else does beside lengths."""
_RESPELLING = re.compile(r"\bAU\b|[MR][☉⊙]|R⊕")


@functools.lru_cache(maxsize=1)
def _registry():
    import pint  # imported here: it costs 0.3 s that `--help` need not pay

    registry = pint.UnitRegistry(cache_folder=None)
    for text in _OF_THE_SKY:
        registry.define(text)
    return registry


@functools.lru_cache(maxsize=512)
def parse_unit(text):
    """Read a unit such as ``km/s`` or ``kg m/s^2``.

    Parameters
    ----------
    text : str
        A product of powers of units known to pint, as ``m/s^2``, ``m/s²`` or ``m·s⁻²``; ``1``
        or an empty text is dimensionless.

    Returns
    -------
    scale : float
        The SI value of one such unit.
    unit : Unit
        Its exponents.

    Raises
    ------
    UnitError
        If the unit is unknown, not multiplicative (like °C), or of a non-SI dimension.
    """
    clean = _RAISED.sub(lambda power: f"^{power[0]}", text.strip()).translate(_PLAIN)
    clean = _RESPELLING.sub(lambda word: _RESPELT[word[0]], clean)
    if clean in ("", "1"):
        return 1.0, DIMENSIONLESS
    if not _ALLOWED.fullmatch(clean):
        raise UnitError(
            f"unit must be a product of powers of units such as m/s^2, got {text!r:.80}"
        )
    if _TOWER.search(clean):
        raise UnitError(f"unit {clean!r}: a power must be one number of at most two digits")
    if re.fullmatch(r"-?[\d.]+", clean):
        raise UnitError(f"unknown unit {clean!r}; write SI units such as m, s, kg, m/s^2")
    if (plain := _plain_unit(clean)) is not None:
        return plain
    if re.search(r"\b(px|pixels?)\b", clean):
        raise UnitError(
            "a pixel has no length in SI; give the length of one as the unit of length, as in "
            '--units "length=2.43 mm" (in dataset.toml, [units] length = "2.43 mm")'
        )
    base = _in_base_units(clean)
    if not 0 < float(base.magnitude) < float("inf"):
        raise UnitError(f"unit {clean!r} is too large or too small to be used")
    exponents = [0] * len(BASE)
    for dimension, power in base.dimensionality.items():
        if dimension not in _DIMENSION:
            raise UnitError(
                f"unit {clean!r} has the dimension {dimension}, which is not one of "
                f"{', '.join(BASE)}"
            )
        exponents[_DIMENSION[dimension]] = _rational(power)
    return float(base.magnitude), Unit(tuple(exponents))


_SI = {
    "m": METRE, "s": SECOND, "kg": KILOGRAM, "A": Unit.of(A=1), "N": FORCE,
    "C": Unit.of(A=1, s=1), "J": Unit.of(kg=1, m=2, s=-2),
}  # fmt: skip
_SCALED = {"km": (1000.0, "m"), "cm": (0.01, "m"), "mm": (0.001, "m"), "ms": (0.001, "s"),
           "g": (0.001, "kg")}  # fmt: skip
_FACTOR = rf"({'|'.join(_SI)})(?:\^(-?\d))?"
_BELOW = rf"(?:{_FACTOR}|\({_FACTOR}(?:[ *]{_FACTOR})*\))"
_PRODUCT = re.compile(rf"{_FACTOR}(?:[ *]{_FACTOR})*(?:/{_BELOW})?")


def _plain_unit(text):
    """The commonest units without pint, whose import costs as much as a small table; or None."""
    if text in _SCALED:
        scale, name = _SCALED[text]
        return scale, _SI[name]
    if not _PRODUCT.fullmatch(text):
        return None
    above, _, below = text.partition("/")
    unit = DIMENSIONLESS
    for name, power in re.findall(_FACTOR, above):
        unit *= _SI[name] ** int(power or 1)
    for name, power in re.findall(_FACTOR, below):
        unit /= _SI[name] ** int(power or 1)
    return 1.0, unit


def _in_base_units(text):
    from tokenize import TokenError

    import pint

    try:
        unit = _registry().parse_units(text)
        if not all(_registry()._units[str(name)].is_multiplicative for name in unit._units):
            raise UnitError(f"unit {text!r} has an offset; use a unit such as kelvin")
        return _registry().Quantity(1.0, unit).to_base_units()
    except (
        pint.PintError,
        AttributeError,
        ValueError,
        TypeError,
        SyntaxError,
        AssertionError,
        TokenError,
        KeyError,
        ArithmeticError,
    ) as error:
        # pint's parser lets these through for malformed text.
        raise UnitError(f"unknown unit {text!r}; write SI units such as m, s, kg, m/s^2") from error


ANGLES = dict.fromkeys(("rad", "radian", "radians", "radiant"), 1.0) | dict.fromkeys(
    "deg ° degree degrees grad grados grado gradi degré degrés degre degres graus grau graden"
    " grader".split(),
    math.pi / 180,
)
"""Units of angles in the place of lengths, in rad."""
UNCALIBRATED = {
    "px": "px", "pixel": "px", "pixels": "px", "arcsec": "arcsec", "arcseconds": "arcsec",
    "arcsecond": "arcsec", "mas": "arcsec",
}  # fmt: skip
"""Units in the place of lengths that no length in SI is known of, and what they are told in."""
OF_THE_SKY = ("arcsec", "mas", "uas", "arcmin", "milliarcsecond", "microarcsecond", "arcsecond")
"""Angles on the sky in the place of lengths: without a distance these are not calibrated."""


def is_speed(text):
    """Whether a text is a unit of velocities."""
    try:
        return parse_unit(text)[1] == SPEED
    except UnitError:
        return False


_KIND_BASE = {"length": "m", "time": "s", "mass": "kg", "charge": "A"}


@dataclass(frozen=True)
class UnitSystem:
    """What the numbers of a data set stand for.

    Attributes
    ----------
    declared : mapping of str to str
        Kind or column -> unit text as the user declared it (``length = "cm"``).
    symbols : mapping of str to str
        Base unit -> what to print in its place where the data are not calibrated
        (``{"m": "px"}``); numbers of such a kind are kept as they are.
    remedies : mapping of str to str
        Base unit -> what the data hold that may say it, and the option (a column that looks like
        a mass and is not used), for complaints.
    """

    declared: MappingProxyType = field(default_factory=lambda: MappingProxyType({}))
    symbols: MappingProxyType = field(default_factory=lambda: MappingProxyType({}))
    remedies: MappingProxyType = field(
        default_factory=lambda: MappingProxyType({}), compare=False, repr=False
    )

    @classmethod
    def from_declared(cls, declared):
        """Build from ``{"length": "cm", "time": "s", "mass": "kg"}``; missing kinds stay open."""
        symbols = {}
        for kind, base in _KIND_BASE.items():
            text = declared.get(kind)
            if text is None and kind != "charge":
                symbols[base] = kind
            elif text is not None and text.strip().lower() in UNCALIBRATED:
                symbols[base] = UNCALIBRATED[text.strip().lower()]
            elif kind == "length" and text is not None and text.strip() in OF_THE_SKY:
                symbols[base] = text.strip()
            elif kind == "length" and text is not None and text.strip().lower() in ANGLES:
                symbols[base] = "rad"
            elif kind == "length" and text is not None and is_speed(text):
                symbols[base] = text.strip()
        return cls(MappingProxyType(dict(declared)), MappingProxyType(symbols))

    @property
    def is_angle(self):
        """Whether angles stand in the place of places: rad for m."""
        return self.symbols.get("m") == "rad"

    @property
    def is_si(self):
        """Whether lengths and times are told in metres and seconds."""
        told = [self.declared.get(kind, "").strip() for kind in ("length", "time")]
        return told[0] == "m" and told[1] in ("s", "sec")

    def is_calibrated(self, unit):
        """Whether every base unit that occurs in `unit` is known in SI."""
        return all(
            not exponent or base not in self.symbols
            for base, exponent in zip(BASE, unit.exponents, strict=True)
        )

    def text(self, unit):
        """Write `unit` in the words of these data: ``px/s^2`` where lengths are pixels."""
        return unit.text(self.symbols)

    def instant(self, seconds):
        """Write an instant in the unit of the times as they were given: a Julian date in days."""
        declared = self.declared.get("time", "")
        scale = 1.0 if "s" in self.symbols or not declared else parse_unit(declared)[0]
        if scale == 1.0:
            return f"{seconds:.4g} {self.text(SECOND)}"
        return f"{seconds / scale:.9g} {declared}"
