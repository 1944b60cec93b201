"""From the units of a file to SI, column by column."""

import re
import tokenize
from functools import lru_cache

from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.data.words import unit_words
from bsp_gp.errors import DataError, UnitError
from bsp_gp.units import (
    ANGLES,
    DIMENSIONLESS,
    OF_THE_SKY,
    UNCALIBRATED,
    Unit,
    UnitSystem,
    is_speed,
    parse_unit,
)

_WORD_UNITS = unit_words() | {
    word: "rad" if size == 1.0 else "deg" for word, size in ANGLES.items()
}
"""Units as people write them out, in the languages whose headings are known."""
KINDS = ("length", "time", "mass", "charge", "velocity")
_PIXEL = re.compile(r"\b(?:px|pixels?|arcsec(?:ond)?s?|mas)\b", re.IGNORECASE)
"""In the place of a length, see `bsp_gp.units.UNCALIBRATED`."""
_MAS = re.compile(r"\bmas\b", re.IGNORECASE)
_NUMBERED = re.compile(
    r"\s*((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?:\s+|(?=[^\W\d_]))(.+)"
)
LENGTH, TIME = Unit.of(m=1), Unit.of(s=1)
_EXAMPLES = {"time": ("s", "--fps 25 where it counts frames"),
             "length": ("m", '"px" if the picture is not calibrated')}  # fmt: skip
COLUMN_KINDS = {"t": "time"} | {
    f"{prefix}{axis}": kind
    for axis in "xyz"
    for prefix, kind in (("", "length"), ("s", "length"), ("v", "velocity"), ("sv", "velocity"))
}
"""Kind of unit of the columns of a trajectory table."""


def is_unit(text):
    """Whether `text` reads as a unit (``px`` included)."""
    return unit_of(text) is not None


@lru_cache(maxsize=1 << 12)
def unit_of(text):
    """The unit that `text` stands for (that of metres for ``px``); None if it is no unit."""
    try:
        return _scale(text)[1]
    except UnitError:
        return None


def size_of(text):
    """What one of a unit is in SI, pixels in the place of metres; UnitError if it is none."""
    return _scale(text)[0]


def is_inertia(name, text, system):
    """Whether a mass is told in kg m^2: where places are angles, inertia stands in its place."""
    return name == "mass" and system.is_angle and unit_of(text) == Unit.of(kg=1, m=2)


def ratio_of(one, other):
    """How many of a unit another one is, as 0.001 mas of an arcsec; None if they differ in kind."""
    if one.strip() == other.strip():
        return 1.0
    read = parse_unit if {one.strip(), other.strip()} <= set(OF_THE_SKY) else _scale
    try:
        (scale, unit), (of, kind) = read(one.strip()), read(other.strip())
    except UnitError:
        return None
    is_alike = unit == kind and bool(_PIXEL.search(one)) == bool(_PIXEL.search(other))
    return scale / of if is_alike else None


def _as_written(text):
    """A unit that is written out as its symbol; others as they are."""
    return _WORD_UNITS.get(text.strip().lower(), text)


def _scale(text):
    """Value of one `text` in SI with pixels in the place of metres; ``0.17 um`` is one unit."""
    number = _NUMBERED.fullmatch(text)
    factor, rest = (float(number.group(1)), number.group(2)) if number else (1.0, text)
    try:
        rest = _as_written(rest)
        factor *= 1e-3 if _MAS.search(rest) else 1.0
        scale, unit = parse_unit(_PIXEL.sub("m", rest))
    except (AssertionError, tokenize.TokenError) as error:  # pint, on "m/" and on "m("
        raise UnitError(f"unknown unit {text!r}; write SI units such as m, s, kg") from error
    return factor * scale, unit


class Conversion:
    """Scales and units of the columns of one data set.

    Parameters
    ----------
    declared : mapping of str to str
        ``[units]``: kind (`KINDS`) or column -> unit. One unit may carry a number: with
        ``length = "0.17 um"`` one count of the file is 0.17 µm.
    columns : iterable of str
        Every column there is, for the check of the keys.
    file : str
        What to name in complaints.
    has_fps : bool
        Times come from a frame rate, so they are seconds.
    may_be_half : bool
        One of length and time may be missing, and is told as such.
    of_sight : bool
        Velocities stand in the place of places, and lengths have their unit.

    Attributes
    ----------
    system : UnitSystem
    """

    def __init__(
        self, declared, columns, file=None, has_fps=False, may_be_half=True, of_sight=False
    ):  # fmt: skip
        columns = set(columns)
        self.declared = {key: _as_written(text) for key, text in declared.items()}
        self.file, self.of_sight = file, of_sight
        unknown = sorted(set(self.declared) - set(KINDS) - columns)
        if unknown:
            self._fail(f"[units] has {unknown[0]!r}, which is neither a kind ({', '.join(KINDS)}) "
                       f"nor a column ({', '.join(sorted(columns))})")  # fmt: skip
        kinds = dict(self.declared)
        axis = "x" if "x" in columns else "y"  # motion along y alone has no x
        for kind, column in (("length", axis), ("time", "t")):
            if kind not in kinds and column in kinds:
                kinds[kind] = kinds[column]
        if has_fps and "length" in kinds:
            kinds.setdefault("time", "s")
        missing = [kind for kind in ("time", "length") if kind not in kinds]
        if len(missing) == 1 and not may_be_half:
            (kind,), (example, other) = missing, _EXAMPLES[missing[0]]
            self._fail(f"[units] gives no unit of {kind}",
                       remedy=f'add {kind} = "{example}", or --units {kind}={example} (or {other})')
        self._kinds = kinds
        self.system = UnitSystem.from_declared(kinds)
        self.is_pixels = self.system.symbols.get("m") in UNCALIBRATED.values()
        for kind in ("time", "mass", "charge"):
            if _PIXEL.search(kinds.get(kind, "")):
                self._fail(f"the unit of {kind} must not be px, got {kinds[kind]!r}", kind)

    def _fail(self, problem, column=None, remedy=None):
        raise DataError(problem, file=self.file, column=column, remedy=remedy)

    def _read(self, key, text, expected=None):
        try:
            scale, unit = _scale(text)
        except UnitError as error:
            raise DataError(f"[units]: {error}", file=self.file, column=key) from error
        if _PIXEL.search(text) and not self.is_pixels:
            self._fail(f"unit {text!r} has no length in SI, but other lengths have", key,
                       'give every length in one system; length = "px" means not calibrated')
        if expected is not None and unit != expected:
            self._fail(f"the unit must be one of {expected}, got {text!r} ({unit})", key)
        return scale, unit

    def time(self):
        """Scale of the column t (and of `dt`)."""
        text = self.declared.get("t", self._kinds.get("time"))
        return 1.0 if text is None else self._read("t", text, TIME)[0]

    def length(self, column):
        """Scale of a column that holds lengths."""
        text = self.declared.get(column, self._kinds.get("length"))
        if text is not None and text.strip() in OF_THE_SKY and self.system.symbols.get("m"):
            own = self.system.symbols["m"]
            return parse_unit(text.strip())[0] / parse_unit(own)[0] if own in OF_THE_SKY else 1.0
        if self.system.is_angle and text is not None and text.strip().lower() in ANGLES:
            return ANGLES[text.strip().lower()]
        if text is None or (self.of_sight and is_speed(text)):
            return 1.0
        return self._read(column, text, LENGTH)[0]

    def velocity(self, column):
        """Scale of a column of velocities: its own unit, else length/time."""
        text = self.declared.get(column, self.declared.get("velocity"))
        if text is not None:
            return self._read(column, text, LENGTH / TIME)[0]
        return self.length(column[-1]) / self.time()

    def property(self, name, columns=()):
        """Scale, unit and (where the unit was not declared) a note for one property.

        Parameters
        ----------
        name : str
            The property; for a vector its stem.
        columns : tuple of str
            Columns of a vector's components.
        """
        texts = {self.declared[key] for key in (name, *columns) if key in self.declared}
        if len(texts) > 1:
            self._fail(f"components of {name!r} have different units {sorted(texts)}", name)
        expected = PROPERTY_UNITS.get(name)
        if texts and is_inertia(name, text := next(iter(texts)), self.system):
            return self._read(name, text)[0], expected, None
        if texts:
            return *self._read(name, texts.pop(), expected), None
        if expected is None:
            note = f"column {name!r} has no declared unit: read as a pure number"
            return 1.0, DIMENSIONLESS, note
        if expected == LENGTH:
            return self.length(name), expected, None
        scales = {
            kind: self._read(kind, self._kinds[kind])[0] if kind in self._kinds else 1.0
            for kind in ("time", "mass", "charge")
        }
        if name in scales:
            return scales[name], expected, None
        is_plain = scales["time"] == 1.0 and scales["mass"] == 1.0
        if not expected.is_dimensionless and not is_plain:
            problem = f"column {name!r} has no unit of its own"
            self._fail(problem, name, f'add {name} = "{expected}"')
        return 1.0, expected, None
