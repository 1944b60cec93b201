"""What the headings of a table mean: our names of its columns, their units, whose they are.

A heading is our own word (``x``), a plain one (``Time``, ``x-position``), or one from which the
meaning is guessed (``Höhe``, ``Versuch``); guesses are told. It may carry a unit, the run it
belongs to (``Run 1: Time (s)``, ``Time (s) Run #2``) and the body (``star1_x``, ``x2``).
"""

import re
import unicodedata
from dataclasses import dataclass, replace
from functools import lru_cache

from bsp_gp.data.conversion import LENGTH, TIME, is_unit, unit_of
from bsp_gp.data.polar import POLAR_ALIASES, POLAR_COLUMNS, is_polar
from bsp_gp.data.polar_words import (
    date_unit,
    error_of,
    is_angle_word,
    is_bare_error,
    is_far,
    is_julian,
    is_of_sky,
    is_position_angle,
)
from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.data.sky import HOURS, SKY_COLUMNS, SKY_NUMBERS, is_sky
from bsp_gp.data.words import apart, folded, plain_signs, words_for
from bsp_gp.errors import in_python
from bsp_gp.units import ACCELERATION, ANGLES, GRAVITIES, OF_THE_SKY

NUMBER_COLUMNS = (
    "t", "frame", "x", "y", "z", "vx", "vy", "vz", "sx", "sy", "sz", "svx", "svy", "svz",
)  # fmt: skip
TEXT_COLUMNS = ("scene", "entity")
ALIASES = {
    "particle": "entity", "object": "entity", "track": "entity", "targetname": "entity",
    "ra": "ra", "dec": "dec",
    "sra": "sra", "sdec": "sdec", "right_ascension": "ra", "right ascension": "ra",
    "declination": "dec", "epoch": "t", "jdtdb": "t", "jd_tdb": "t", "x_value": "t",
    **POLAR_ALIASES,
}  # fmt: skip
LITERAL, WORD, GUESS, UNKNOWN = range(4)
"""How sure the meaning of a heading is."""
_WITH_UNIT = re.compile(
    r"(.*?)\s*[(\[{<]\s*(?:in\s+|en\s+)?([^()\[\]{}<>]*?)(?:[\s-]+(?:agl|asl|amsl|msl))?\s*[)\]}>]",
    re.IGNORECASE,
)
"""``Zeit (in s)``, ``Altitude (ft-AGL)``."""
_AFTER_MARK = re.compile(r"(.+?)(?:\s*[/,]\s*|\s+(?:in|-|–)\s+|_)[(\[]?([^()\[\]_]+)[)\]]?")
"""``t / s``, ``t in s``, ``t - s``, ``t, s``, ``t_s``, ``v / (m/s)``: then comes a unit."""
_AFTER_LAST_MARK = re.compile(_AFTER_MARK.pattern.replace(".+?", ".+", 1))
"""``s_A1 / m``."""
_PATH = re.compile(r"[a-zA-Z]\w{2,}(?:\.[a-zA-Z]\w{2,})+")
_SUBSCRIPT = re.compile(r"_\{([^{}]+)\}")
"""``x_{mass A}``, as Tracker and TeX write it."""
_TEX = re.compile(r"\$|\\(?=[A-Za-z])")
"""What TeX has around a name: ``$\\theta$``."""
_AXIS_IN_BRACKETS = re.compile(r"(.*\w)\s*[(\[]\s*([xyz])\s*[)\]](.*)", re.IGNORECASE)
"""``LFHD (x)``: no unit is called so."""
_RUN = rf"(?:data ?set|latest|latest run|{'|'.join(sorted(words_for('run') - {'take'}))})"
_RUN_NAME = re.compile(rf"{_RUN}\s*(?:#|nr\.?|no\.?)?\s*\d+")
_RUN_BEFORE = re.compile(r"([^:\d][^:]*?)\s*:\s*(\S.*)")
_RUN_AFTER = re.compile(rf"(.*[^\s,;(])[\s,;]+\(?({_RUN_NAME.pattern})\)?(\s*[(\[][^)\]]*[)\]])?")
"""Of headings without capitals and accents."""
_BODY_BEFORE = re.compile(r"(.*[^\s_.:-])[\s_.:-]+([vs]?[xyz]|t)", re.IGNORECASE)
_UNGLUED = re.compile(r"^([xyzXYZ])([a-zA-Z]{3,})$")
"""``Xearth``: a body behind its axis."""
_CAMEL = re.compile(r"(\w*[a-z0-9])([A-Z][a-z]+)")
"""``cartPos``."""
_COUNTED = re.compile(r"([^\W\d_]+?)[\s_.-]?(\d+|(?<![A-Z])[A-W])")
"""``pos1``, ``xA``."""
_GLUED_PLACE = re.compile(
    r"(pos(?:ition)?|coord|loc|p|c|t)([xyz])|([xyz])(pos(?:ition)?|coord|loc)", re.IGNORECASE
)
"""A place in one word, ``px`` of robots, ``cx`` of centres, ``tx`` of translations, ``xpos``."""
_LABELLED = re.compile(r"(.+?)[\s_.:-]+([xyz])[\s_.-]+([^\W\d]+)", re.IGNORECASE)
"""A body, its axis, and what of it: ``Objekt 1 x-Koordinate``."""
_OF_WHOM = re.compile(r"([xyz])[\s_.-]+([^\W\d]+)\s+(?:for|of|von|de|du|di|del|da)\s+(\S.*)", re.I)
"""An axis, what of it, and whose: ``x-coordinate for point mass 1``."""
_PRECISION = re.compile(r"(.*\S)\s*[(\[]\s*(?:±|\+/-|\+-)\s*[\d.,]+[^()\[\]]*[)\]]")
"""How sure a column is, behind its name: ``Time (s) (± 0.01 s)``."""
_BODY_AFTER = re.compile(
    r"([vs]?[xyz]|t)(?:[\s_.-]+(\w.*)|(\d+|(?<=[xyz])(?-i:[A-W])))", re.IGNORECASE
)
"""``x_red``, ``x2``, ``xA``."""


_TIME_WORDS, _PLACE_WORDS = words_for("time"), words_for("place")
_AXIS_WORDS = words_for("axis")
"""Beside a symbol: ``x-Richtung``."""
_MAP_WORDS = words_for("north")
_FROM_WHERE = re.compile(r"\s+(?:of|from)\s+(?:the\s+)?(?:launch|start|origin|home)\b.*", re.I)
"""``Position East of launch``."""
RADIAL_NAMES = words_for("radial")
INSTRUMENTS = words_for("instrument")
_SPEED_WORDS = words_for("speed") | RADIAL_NAMES
_ACCELERATION_WORDS = words_for("acceleration")
_ERROR_WORDS = words_for("error")
_DOUBT_WORDS = _ERROR_WORDS | words_for("doubt")
_PLACES = ("x", "y", "z")
_ON_SKY = {"ra", "dec"}
_ERROR_MARK = (
    r"(?:error|err|sigma|σ|stddev|stdev|std|sd|uncertainty|unc|fehler|unsicherheit|erreur|±)"
)
_ERROR_OF = re.compile(rf"{_ERROR_MARK}(?:of)?(.*)|(.+?){_ERROR_MARK}")
"""Whose error a heading is, without blanks; ``dx``, ``e_x`` and ``u_x`` are other things too."""
_ANGLE = re.compile(rf"(?:{'|'.join(sorted(words_for('angle')))})[\s_-]?(\w*)")
"""An angle, and whose it is: ``theta``, ``phi1``, ``angle_upper``."""
_DOTTED = re.compile(
    rf"(?:[a-z]|pos|{'|'.join(sorted(words_for('angle')))})[\s_]?\d*[\s_]?d?dot[\s_]?\d*"
)
"""A rate, as it is named after Newton's dots: ``x_dot``, ``thetaddot``, ``theta1_dot``."""
_BEFORE_ANGLE = r"(.+?)(?:\s*/\s*|\s+in\s+|_)(\S+)"
"""An angle, a mark, and its unit."""
_BARE_ANGLES = frozenset(("rad", "radians", "deg", "degrees", "°"))
"""Units of angles that stand alone for an angle."""
_COUNT_WORDS = words_for("count")
_INPUT = re.compile(r"[ab]\d|&[a-z]")
"""Of an interface, as in ``s_A1``, and signs for Greek letters as CASSY writes them, ``&b_A1``."""
_GLUED = re.compile(
    r"(t|time|zeit)(days?|secs?|seconds|msec|hours|years?)"
    r"|(angle|winkel|theta|phi|alpha)(deg|degrees|rad)", re.IGNORECASE
)  # fmt: skip
"""A name with its unit behind it: ``tdays``, ``Angledeg``."""
_G_FORCE = re.compile(r"gF[xyz]|TgF")
"""What a phone's accelerometer shows in units of gravity, as Physics Toolbox names it."""
_OFFSET = re.compile(
    r"(?:d|delta|δ|∆|rel)(ra|dec)l?(?:off|offset)?|(ra|dec)l?(?:off|offset|rel)", re.IGNORECASE
)
"""An offset on the sky: ``DeltaR.A.``, ``dDec``, ``raoff``."""
_SHORT_BESIDE = words_for("beside_short")
_PROCESSED_WORDS = words_for("processed")
_BODY_WORDS = words_for("body")
_OF_WORDS = words_for("of") | _BODY_WORDS
_OF_LOGGERS = words_for("of_loggers")
_COURSES = words_for("course")
_CLOCK_UNITS = {
    "ms": "ms", "msec": "ms", "millis": "ms", "millis()": "ms", "milliseconds": "ms",
    "sec": "s", "secs": "s", "seconds": "s", "sekunden": "s", "seconds_elapsed": "s",
}  # fmt: skip
"""Columns of loggers that are called by their unit alone, and are the time."""
IGNORE = "ignore"
BY_WORDS = "columns read by their words"
"""How a note of guesses begins."""
_ON_THE_SKY = HOURS | frozenset(ANGLES) | frozenset(OF_THE_SKY)
"""Units of places on the sky."""
_GUESSES = {
    "t": words_for("date"),
    "frame": words_for("frame"),
    "scene": words_for("run") | words_for("recording"),
    "entity": words_for("entity"),
    "y": words_for("height"),
    "x": _PLACE_WORDS | words_for("distance"),
}  # fmt: skip
"""Words that may mean a column of ours where no plainer heading does; counting words may stand
beside those of scenes, bodies and frames."""
_UNIT_OF = PROPERTY_UNITS | {
    name: {"t": TIME, "v": LENGTH / TIME}.get(name[0], LENGTH)
    for name in NUMBER_COLUMNS if name != "frame"
}  # fmt: skip


@dataclass(frozen=True)
class Heading:
    """One column.

    Attributes
    ----------
    name : str
        Ours, or that of the file where it means nothing to us.
    unit : str
        Of the header; may be empty.
    theirs : str
        As in the file.
    stem : str
        Of that, what stands before the unit.
    sure : int
        `LITERAL`, `WORD`, `GUESS` or `UNKNOWN`.
    run, body : str
        Whose the column is; may be empty.
    is_renamed : bool
        The caller named it.
    ignored : str
        What the caller called it who wants it left out; such a heading has no name.
    """

    name: str
    unit: str = ""
    theirs: str = ""
    stem: str = ""
    sure: int = UNKNOWN
    run: str = ""
    body: str = ""
    is_renamed: bool = False
    ignored: str = ""

    @property
    def owner(self):
        return self.run, self.body

    @property
    def of_any_run(self):
        """What the file calls it, but for the run: ``Force (N)`` of ``Run 1: Force (N)``."""
        return _run_of(self.theirs)[1] if self.run else self.theirs


def number_columns(names):
    """Columns that hold numbers in a table with these columns, a tuple of str."""
    more = POLAR_COLUMNS if is_polar(names) else SKY_NUMBERS if is_sky(names) else ()
    return NUMBER_COLUMNS + more


def is_frame_name(text):
    """Whether a heading speaks of numbers of frames."""
    return _guess(text) == "frame"


def is_time_name(text):
    """Whether a heading may be that of a clock."""
    return _guess(text) == "t" or text.lower() in _CLOCK_UNITS


def is_run_column(text):
    """Whether a heading may tell recordings apart."""
    return _guess(text) == "scene"


def is_run(text):
    """Whether `text` is the name of a run, such as ``Run #1``."""
    return _RUN_NAME.fullmatch(folded(text.strip())) is not None


def is_angle(text):
    """Whether `text` is a unit of angles."""
    return text.strip().lower() in ANGLES


def is_angle_name(text):
    """Whether a heading speaks of an angle."""
    return _ANGLE.fullmatch(folded(text.strip())) is not None


def run_of(title):
    """The run that a title names, itself or at its end as in ``Position, Ch 1, Run #1``; or ""."""
    match = re.search(rf"(?:^|,\s*)({_RUN_NAME.pattern})\s*$", folded(title))
    return title[slice(*match.span(1))] if match else ""


def is_acceleration(text):
    """Whether a heading speaks of an acceleration."""
    is_symbol = re.fullmatch(r"(?:a|acc|accel)[\s_]?[xyz](?:_g)?", text.strip().lower()) is not None
    is_symbol = is_symbol or _G_FORCE.fullmatch(text.strip()) is not None
    return is_symbol or bool(words_of(text) & _ACCELERATION_WORDS)


def is_rate(text):
    """Whether a heading speaks of what a gyroscope measures."""
    words = words_of(text) - {""}
    is_angular = words <= {"angular", "velocity", "speed", "rate", "x", "y", "z"}
    return bool(words & {"gyroscope", "gyroskop", "gyro"}) or ("angular" in words and is_angular)


def is_no_place(text):
    """Whether a heading speaks of what is measured beside a motion, or has a unit of its own."""
    words = words_of(text)
    plain = {word if word in _SHORT_BESIDE else word.rstrip("0123456789%") for word in words} - {""}
    is_short = bool(plain & _SHORT_BESIDE) and all(
        word in _SHORT_BESIDE or len(word) == 1 for word in plain
    )
    is_named = is_short or bool((words | plain) & words_for("beside"))
    return is_named or re.search(r"[)\]}>]$", text.strip()) is not None


def property_of_words(text, unit=""):
    """The property of bodies that a heading speaks of, and its unit agrees with; or ""."""
    words = words_of(text) - {""} - _COUNT_WORDS - _OF_WORDS
    of_unit = unit_of(unit) if unit else None
    for name in ("mass", "charge"):
        known = words_for(name) | (words_for(f"{name}_with_unit") if unit else frozenset())
        if words and words <= known and (not unit or of_unit == PROPERTY_UNITS[name]):
            return name
    return ""


def is_body(text):
    """Whether a heading may name bodies."""
    words = words_of(text) - {""} - _COUNT_WORDS
    return bool(words) and words <= _GUESSES["entity"] | _BODY_WORDS


def is_id(text):
    """Whether a heading is that of the numbers or names that a tracker gives to what it follows."""
    words = words_of(text) - {""}
    return words <= {"id", "ids", "trackid", "objectid"} and bool(words)


def is_error(text):
    """Whether a heading speaks of an error, a fit or a speed, which is no place of a body."""
    no_place = _ERROR_WORDS | _SPEED_WORDS | _ACCELERATION_WORDS | words_for("no_place")
    return _is_dotted(text) or bool(words_of(text) & no_place)


def _is_dotted(text):
    return _DOTTED.fullmatch(folded(text.strip())) is not None


def is_rate_of(text):
    """Whether a heading speaks of a speed, ``pendVel``, an acceleration, or an error."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)
    return is_error(words) or re.fullmatch(r"(?:.*[\W_])?[va][xyz]", text.lower()) is not None


def is_doubt(text):
    """Whether a heading says how sure a place is, or in what state what measures it."""
    return bool(words_of(text) & _DOUBT_WORDS)


def is_error_of(text, of):
    """Whether a heading is that of the error of another: ``sigma_RV`` beside ``RV``, or ``err``."""
    if text.startswith("e_") and _letters(text[2:]) == _letters(of):  # as in catalogues of stars
        return True
    match = _ERROR_OF.fullmatch(_letters(text))
    return match is not None and (match[1] or match[2] or "") in ("", _letters(of))


def is_own_speed(text):
    """Whether a heading speaks of how fast the body itself is, and of nothing else's speed."""
    words = words_of(text) - {""}
    rest = words - _SPEED_WORDS - words_for("whose_speed") - _OF_WORDS
    is_symbol = re.fullmatch(r"v[\s_]?[xyzrt]?", text.strip().lower()) is not None
    return is_symbol or (bool(words & _SPEED_WORDS) and not rest)


def is_count(text):
    """Whether a heading counts rows."""
    return (words_of(text) - {""}) <= _COUNT_WORDS | words_for("row")


@lru_cache(maxsize=1 << 14)  # a wide table is asked about its headings again and again
def words_of(text):
    """The words of a heading, folded, a frozenset of str."""
    words = re.split(r"[\s_\-()\[\]/]+", folded(apart(text)))
    return frozenset(word.rstrip(".") for word in words)


def has_place(found):
    """Whether headings say where something is."""
    names = {h.name for h in found}
    return bool(names & {"x", "y"}) or is_polar(names) or is_sky(names)


def headings(cells, rename=None, *, is_track=True):
    """Read a header.

    Parameters
    ----------
    rename : mapping of str to str, optional
        Our name -> the file's name, which may or may not occur. ``NAME_x`` is the x of body NAME.
        A column of one run stands for that of every run, unless that of another is named too.
    is_track : bool
        Whether it is a table of positions, in which words may be guessed.
    """
    cells = [one_blank(_TEX.sub("", str(cell).strip().strip('"').strip())) for cell in cells]
    ignored = [one_blank(k) for k, v in (rename or {}).items() if is_ignored(v, cells)]
    back = {one_blank(_TEX.sub("", v)): POLAR_ALIASES.get(k, k) for k, v in (rename or {}).items()
            if one_blank(k) not in ignored}  # fmt: skip
    back = _of_every_run(back) if is_track else back
    found = [_read(cell, back, is_track, ignored) for cell in cells]
    if is_track:
        found = _without_sensors(_as_said(found))
        found = _with_glued_places(_with_bodies(found))
        found = _with_polar_errors(_turned(_with_kept_angles(found)))
        found = _with_counted_places(_with_angles(found))
        found = _with_dates(found)
        found = _without_courses([_guessed(h, {f.name for f in found}) for h in found])
        found = _above_maps(found)
        found = _with_far_on_sky(found)
        found = _with_errors(_with_clock(found))
    return tuple(_settled(_with_one_unit(found) if is_track else found))


def one_blank(text):
    """A name of a column with one blank where there are more, as it is told."""
    return " ".join(text.split())


def _with_glued_places(found):
    """``px, py, pz`` as places, where no column is one by a plainer name: the first such set.

    One letter before an axis is a place only if both x and y have it.
    """
    if any(h.name in _PLACES for h in found):
        return found
    sets = {}
    for h in found:
        match = _GLUED_PLACE.fullmatch(h.name) if h.sure == UNKNOWN and not h.ignored else None
        if match and (not h.unit or unit_of(h.unit) == LENGTH):
            word, axis = match[1] or match[4], match[2] or match[3]
            sets.setdefault(word.lower(), {})[axis.lower()] = h
    able = (own for word, own in sets.items() if len(word) > 1 or {"x", "y"} <= set(own))
    axes = next(able, {})
    names = {id(h): axis for axis, h in axes.items()}
    return [replace(h, name=names[id(h)], sure=WORD) if id(h) in names else h for h in found]


def _without_courses(found):
    """Of a vehicle ``track`` is where it goes, and ``pitch`` how it is turned."""
    if not any(words_of(h.theirs) & words_for("vehicle") for h in found):
        return found
    return [
        replace(h, name=h.stem, sure=UNKNOWN)
        if h.name in TEXT_COLUMNS and not h.is_renamed and folded(h.stem) in _COURSES else h
        for h in found
    ]


def _above_maps(found):
    """Beside a way to the north heights are z."""
    is_map = [h.name == "y" and bool(words_of(h.theirs) & _MAP_WORDS) for h in found]
    if not any(is_map) or any(h.name == "z" for h in found):
        return found
    return [
        replace(h, name="z", sure=GUESS)
        if (is_height(h) and not north) or (h.sure == UNKNOWN and words_of(h.name) == {"up"}) else h
        for h, north in zip(found, is_map, strict=True)
    ]  # fmt: skip


def _as_said(found):
    """Beside places that the caller names: no others of these names, and none of other owners.

    Of whose places the caller leaves out nothing else is taken for a place.
    """
    said = [h for h in found if h.is_renamed and _of_body(h).name in _PLACES]
    names = {_of_body(h).name for h in said}
    owners = {_run_of(plain_signs(h.theirs))[0] for h in said}
    plain = [_read(h.theirs, {}, True) for h in found if h.ignored]
    left = {h.run for h in plain if h.name in _PLACES}
    out = []
    for h in found:
        if h.run in left and h.sure == UNKNOWN and not is_run(h.run):
            h = replace(h, name=h.stem, run="")
        is_owned = bool(h.run) and not is_run(h.run)
        is_twice = not h.run and h.name in names and h.sure != UNKNOWN
        if not said or h.is_renamed or h.ignored or not (is_owned or is_twice):
            out.append(h)
        elif h.run in owners and h.sure != UNKNOWN and h.name not in names:
            out.append(replace(h, run=""))
        elif h.stem == h.name:  # it is called as ours is
            out.append(Heading("", h.unit, h.theirs, ignored=h.theirs))
        else:
            out.append(replace(h, name=h.stem, sure=UNKNOWN, run=""))
    return out


def _without_sensors(found):
    """Beside a place by its words, ``X [g], Y [g], Z [g]`` are an accelerometer's."""
    own = [h for h in found if h.name in _PLACES and h.unit and not h.is_renamed]
    units = {"m/s^2" if h.unit in GRAVITIES else h.unit for h in own}
    is_sensor = len(own) > 1 and len(units) == 1 and unit_of(*units) == ACCELERATION
    if not is_sensor or len(own) < sum(h.name in _PLACES for h in found):
        return found
    if not any(h.sure == UNKNOWN and _guess(h.name) in ("x", "y") and h.unit
               and unit_of(h.unit) == LENGTH for h in found):  # fmt: skip
        return found
    return [replace(h, name=h.theirs, sure=UNKNOWN) if h in own else h for h in found]


def _of_every_run(back):
    """What the caller names, without the run, unless the same is named of several runs."""
    parts = {theirs: _run_of(theirs) for theirs in back}
    plain = {rest if is_run(run) else theirs: theirs for theirs, (run, rest) in parts.items()}
    return {new: back[old] for new, old in plain.items()} if len(plain) == len(back) else back


def _with_clock(found):
    """The only column with a unit of time as the time, where there is no other."""
    clocks = [h for h in found if h.sure == UNKNOWN and not h.ignored and h.unit
              and unit_of(h.unit) == TIME]  # fmt: skip
    if len(clocks) != 1 or any(h.name in ("t", "frame") for h in found):
        return found
    return [replace(h, name="t", sure=GUESS) if h is clocks[0] else h for h in found]


def _with_far_on_sky(found):
    """Beside right ascension and declination: how far it is, and no place of its own."""
    is_placed = any(h.name in _PLACES and (h.sure < GUESS or h.is_renamed) for h in found)
    if not is_sky(h.name for h in found if h.name not in _PLACES) or is_placed:
        return found
    far = [
        h for h in found
        if not (h.is_renamed or h.ignored) and words_of(h.stem or h.name) <= words_for("far")
        and (not h.unit or unit_of(h.unit) == LENGTH) and h.unit not in OF_THE_SKY
    ]  # fmt: skip
    if len(far) != 1 or any(h.name == "distance" for h in found if h not in far):
        return found
    return [replace(h, name="distance", sure=GUESS) if h is far[0] else h for h in found]


def is_height(heading):
    """Whether a column means heights, so that its axis points up."""
    is_guess = heading.name == "y" and heading.sure == GUESS and not heading.body
    return is_guess and not words_of(heading.theirs) & _MAP_WORDS


def is_ignored(text, cells):
    """Whether `text`, in the place of a column's name, means that it is to be left out."""
    return text.strip() == IGNORE and IGNORE not in cells


def _read(cell, back, is_track, ignored=()):
    """A heading by its own words, without guesses."""
    plain = plain_signs(cell)
    if is_track and cell not in back and (match := _PRECISION.fullmatch(plain)):
        plain = match[1]
    run, rest = _run_of(plain) if is_track else ("", plain)
    if cell in back:
        run, rest = "", rest if is_run(run) else cell
    if rest not in back:
        rest = _AXIS_IN_BRACKETS.sub(r"\1 \2\3", _SUBSCRIPT.sub(r" \1", rest))
    stem, unit = _split_unit(rest, back, is_track)
    unit = "g" if not unit and _G_FORCE.fullmatch(stem) else unit
    unit = "rpm" if not unit and is_track and "rpm" in words_of(stem) else unit
    bare = re.sub(r"\s*[(\[{<].*$", "", rest)  # before what is no unit that we know
    for text in (cell, rest, stem, bare):
        if text in ignored:
            return Heading("", unit, cell, ignored=text)
    if cell in back and cell == f"{stem}_{unit}":
        stem, unit = cell, ""  # the caller took it for a name
    for text in (cell, rest, stem):
        if text in back:
            return Heading(back[text], unit, cell, stem, LITERAL, run, is_renamed=True)
    ours, sure = _our_name(stem)
    if ours == "t" and unit and unit_of(unit) not in (None, TIME):
        ours, sure = cell, UNKNOWN  # ``T (C)`` is a temperature
    return Heading(ours, unit, cell, cell if run else stem, sure, run)


def _run_of(cell):
    """Run and the rest of ``Run 1: Time (s)``, ``Time (s) Run #1`` or ``Time Run #1 (s)``."""
    cell = unicodedata.normalize("NFC", cell)  # as long as it is folded
    match = _RUN_BEFORE.fullmatch(cell)
    if match:
        return match[1], match[2]
    match = _RUN_AFTER.fullmatch(folded(cell))
    if not match:
        return "", cell
    before, run, unit = (cell[slice(*match.span(k))] for k in (1, 2, 3))
    return run, before + unit


def _split_unit(cell, back, is_track):
    """Name and unit of one cell of a header; without a unit (cell, "").

    After a mark that other names have too (``/``, ``in``, ``_``), only what fits the column counts.
    """
    match = _WITH_UNIT.fullmatch(cell)
    if match and match[1] and not match[1].endswith("/") and is_unit(match[2]):
        return match[1], match[2]
    if match and match[2].lower() in words_for("clock") and match[1] not in back:
        return match[1], ""
    for match in filter(None, (mark.fullmatch(cell) for mark in (_AFTER_MARK, _AFTER_LAST_MARK))):
        stem = match[1].strip()
        name = back.get(cell, back.get(stem, _our_name(stem)[0]))
        if is_track and name in SKY_COLUMNS and match[2].strip().lower() in _ON_THE_SKY:
            return stem, match[2].strip()
        if is_track and name not in _UNIT_OF:
            name = _guess(stem) or _of_body(Heading(stem, match[2].strip(), cell)).name
        if name in _UNIT_OF and unit_of(match[2]) == _UNIT_OF[name]:
            return stem, match[2].strip()
        if is_track and property_of_words(stem, match[2].strip()):
            return stem, match[2].strip()
        if is_track and is_acceleration(stem) and match[2].strip() == "g":
            return stem, "g"
        is_turn = is_angle_word(stem) or (is_track and _guess(stem) == "x")
        is_turn = is_turn and match[2].strip().lower() in ANGLES
        if is_track and (is_turn or (is_far(stem) and is_of_sky(match[2]))):
            return stem, match[2].strip()
    glued = _GLUED.fullmatch(cell) if is_track and cell not in back else None
    return (glued[1] or glued[3], glued[2] or glued[4]) if glued else (cell, "")


@lru_cache(maxsize=1 << 12)
def _our_name(name):
    """Our name of a column that people call ``Time``, ``Zeit t``, ``x-position`` or ``v_x``."""
    lower = name.lower()
    if lower in NUMBER_COLUMNS + TEXT_COLUMNS:
        return lower, LITERAL
    words = re.split(r"[\s_.-]+", folded(apart(name)))
    symbols = [word for word in words if word in ("t", "x", "y", "z")]
    about = {word for word in words if word not in symbols}
    is_time = about <= _TIME_WORDS or (symbols == ["t"] and about <= _PLACE_WORDS)
    if about and is_time and symbols in ([], ["t"]):
        return "t", WORD
    if about and len(symbols) == 1 and symbols != ["t"]:
        if about <= _PLACE_WORDS | _AXIS_WORDS:
            return symbols[0], WORD
        if about <= _SPEED_WORDS:
            return f"v{symbols[0]}", WORD
    offset = _OFFSET.fullmatch(_letters(name))
    if offset:
        return "x" if (offset[1] or offset[2]) == "ra" else "y", WORD
    return (ALIASES[lower], WORD) if lower in ALIASES else (name, UNKNOWN)


@lru_cache(maxsize=1 << 12)
def _guess(name):
    """What a heading may mean by its words; None for nothing."""
    if _PATH.fullmatch(name):  # ``update Time`` of ``CUSTOM.updateTime``
        name = _CAMEL.sub(r"\1 \2", name.rpartition(".")[2])
    name = _FROM_WHERE.sub("", name)
    words = {word for word in words_of(name) - {""} if not _INPUT.fullmatch(word)}
    if any(len(word) > 1 for word in words - _OF_LOGGERS):
        words -= _OF_LOGGERS
    for ours, known in (("y", words_for("upright") | _MAP_WORDS), ("x", {"east"})):
        if words & known and words - known <= _PLACE_WORDS:
            return ours
    for ours, known in _GUESSES.items():
        counted = words - _COUNT_WORDS if ours in ("scene", "entity", "frame") else words
        if counted and counted <= known:
            return ours
    return None


def _turned(found):
    """Where no column is a place: a distance and an angle, or an angle alone in that of x."""
    names = [h.name for h in found]
    if any(h.name in ("x", "y", "z") and h.sure < GUESS for h in found) or is_sky(names):
        return found
    far, angles = ([h for h in found if h.name == name] for name in ("distance", "angle"))
    far = far if "angle" in names or any(h.sure < GUESS for h in far) else []
    far = far or [h for h in found if h.sure == UNKNOWN and is_far(h.name)]
    angles = angles if far and angles else [
        h for h in found if h.sure == UNKNOWN and is_angle_word(h.name)
        and (h.unit.lower() in ANGLES or (far and not h.unit))
    ]  # fmt: skip
    owners = [h.owner for h in angles]
    if len(set(owners)) != len(owners) or (far and (len(far), owners) != (1, [("", "")])):
        return found
    names = {id(h): "angle" if far else "x" for h in angles} | {id(h): "distance" for h in far}
    return [
        replace(h, name=names[id(h)], sure=min(h.sure, GUESS)) if id(h) in names else h
        for h in found
    ]


def _with_polar_errors(found):
    """Beside a distance and an angle: their errors."""
    if not is_polar(h.name for h in found):
        return found
    out = []
    for h in found:
        of = error_of(h.name) if h.sure == UNKNOWN else None
        if h.sure == UNKNOWN and out and out[-1].name in ("distance", "angle"):
            of = out[-1].name if is_bare_error(h.name) else of
        out.append(replace(h, name=f"s{of}", sure=GUESS) if of else h)
    return out


def _with_errors(found):
    """Beside the places of a body: their errors, if every one of them has a column of its own."""
    known = [h for h in found if h.sure != UNKNOWN and h.name in _PLACES]
    places = {(h.run, text): h for h in known for text in (_plain(h), f"{h.body}{h.name}".lower())}
    errors, axes_of_plot = {}, _errors_of_plot(found, known)
    for before, h in zip([None, *found], found, strict=False):
        is_free = h.sure == UNKNOWN and not (h.is_renamed or h.ignored)
        match = _ERROR_OF.fullmatch(_plain(h)) if is_free else None
        if not match:
            continue
        text = match[1] or match[2]
        place = _place_of(places, h.run, text) if text else before if before in known else None
        if text in axes_of_plot:
            place = known[0] if text == "y" else None
        if place and (not h.unit or unit_of(h.unit) == unit_of(place.unit or "m")):
            errors.setdefault(place.owner, {}).setdefault(f"s{place.name}", []).append(h)
    of = {}
    for owner, own in errors.items():
        axes = {h.name for h in found if h.owner == owner and h.sure != UNKNOWN}
        if set(own) == {f"s{axis}" for axis in axes & {*_PLACES}} and not axes & set(own):
            of |= {id(each[0]): (name, owner[1]) for name, each in own.items() if len(each) == 1}
    return [
        replace(h, name=of[id(h)][0], body=of[id(h)][1], sure=GUESS) if id(h) in of else h
        for h in found
    ]


def _errors_of_plot(found, known):
    """Names of axes where errors are those of what is plotted: of x, the time, and of y.

    The one place has another name than these there.
    """
    free = [_ERROR_OF.fullmatch(_plain(h)) for h in found if h.sure == UNKNOWN]
    texts = {match[1] or match[2] for match in free if match}
    is_other = len(known) == 1 and _plain(known[0]) not in ("x", "y")
    return ("x", "y") if is_other and {"x", "y"} <= texts else ()


def _place_of(places, run, text):
    """The place that is called so, or of which that is the beginning: ``Dist`` of ``Distance``."""
    if (run, text) in places or len(text) < 3:
        return places.get((run, text))
    begun = {id(h): h for (own, name), h in places.items() if own == run and name.startswith(text)}
    return next(iter(begun.values())) if len(begun) == 1 else None


def _plain(heading):
    """The letters of a heading, without its run and its unit at the end."""
    text = heading.of_any_run
    return _letters(text) if heading.unit else re.sub(r"[\s_.-]", "", text).lower()


def _letters(text):
    """The letters of a heading without a unit in brackets at its end."""
    text = re.sub(r"\s*[(\[{<][^()\[\]{}<>]*[)\]}>]$", "", text)
    return re.sub(r"[\s_.-]", "", text).lower()


def _with_dates(found):
    """A column of years, and beside places on the sky any of dates, where none is a time."""
    names = {h.name for h in found}
    is_dated = any(h.name == "t" or (h.sure == UNKNOWN and _guess(h.name) == "t") for h in found)
    if is_dated:
        return found
    if not (is_polar(names) or is_sky(names)):  # "day" may count recordings
        told = [(h, date_unit(h.name) if h.sure == UNKNOWN else None) for h in found]
        return [
            replace(h, name="t", unit=h.unit or unit, sure=GUESS)
            if unit == "yr" or is_julian(h.name) else h for h, unit in told
        ]  # fmt: skip
    k = next((k for k, h in enumerate(found) if date_unit(h.name) is not None), None)
    return [replace(h, name="t", sure=GUESS) if j == k else h for j, h in enumerate(found)]


def _guessed(heading, names):
    """A heading nothing plainer stands for, by its words; a distance beside an angle stays one.

    Beside right ascension and declination nothing is guessed to be a place.
    """
    if heading.sure != UNKNOWN or (heading.name.lower() == "distance" and "angle" in names):
        return heading
    unit = _CLOCK_UNITS.get(heading.name.lower())
    if unit and not heading.unit and "t" not in names:
        return replace(heading, name="t", unit=unit, sure=GUESS)
    ours = _guess(heading.name)
    is_other = ours is None or (ours in _PLACES and _ON_SKY <= names)
    return heading if is_other else replace(heading, name=ours, sure=GUESS)


def _with_bodies(found):
    """``star1_x``, ``x_star1`` and ``x2`` as columns of bodies, where there is no plain x or y.

    Beside right ascension and declination they are offsets of something, ``sat_X``.
    """
    found = _with_own_clocks(_with_body_of_run(found))
    if _ON_SKY <= {h.name for h in found} and not any(h.is_renamed for h in found):
        return found
    if any(h.name in ("x", "y") and h.sure < GUESS and not h.body for h in found):
        return found
    letters = _letters_of_bodies(found)
    out = [_of_body(h, letters) for h in found]
    named = {h.body for h in out if h.is_renamed and h.body and h.name in _PLACES}
    if named:  # they are the only ones
        out = [h if h.is_renamed or h.body in named else old
               for h, old in zip(out, found, strict=True)]  # fmt: skip
    axes = {}
    for h in out:
        if h.body and h.name in "xyz":
            axes.setdefault(h.owner, set()).add(h.name)
    kinds = {frozenset(has) for has in axes.values()}
    is_numbered = all(body.isdecimal() for _, body in axes)
    # x1, x2 alone may be two bodies on a line or the two coordinates of one: y1, y2 are bodies, and
    # so are those with units, as measuring programs write them.
    has_units = any(h.unit for h in out if h.body)
    is_doubtful = is_numbered and kinds == {frozenset("x")} and not has_units
    if len(kinds) != 1 or (len(*kinds) == 1 and (is_doubtful or len(axes) < 2)):
        # ``Light spot x / mm``: what is alone, with the unit of a place, is no body beside others.
        lone = len(axes) == 1 and not is_numbered
        return [
            h if h.is_renamed else replace(h, body="") if lone and h.body and h.unit else old
            for h, old in zip(out, found, strict=True)
        ]
    return out


def _letters_of_bodies(found):
    """Letters behind axes, ``x_A, y_A, x_B, y_B``, that are bodies though they name units as well.

    Where two of them have the same axes, more than one; ``x_m`` beside ``x_px`` is a length.
    """
    axes = {}
    for h in found:
        after = re.fullmatch(r"([xyz])[\s_.-]([A-Za-z])", h.name) if h.sure == UNKNOWN else None
        if after and not h.unit and unit_of(after[2]) != LENGTH:
            axes.setdefault(after[2], set()).add(after[1])
    kinds = set(map(frozenset, axes.values()))
    is_each = len(axes) > 1 and len(kinds) == 1 and len(*kinds) > 1
    return frozenset(axes) if is_each else frozenset()


def _with_own_clocks(found):
    """``Time A, Pos A, Time B, Pos B`` as columns of bodies that have each its clock."""
    out = []
    for h in found:
        *words, label = re.split(r"[\s_.-]+", h.name.strip()) if h.sure == UNKNOWN else [""]
        said = {word.lower() for word in words}
        name = "t" if said and said <= _TIME_WORDS else "x" if said and said <= _PLACE_WORDS else ""
        out.append(replace(h, name=name, body=label, sure=GUESS) if name and label else h)
    names = {}
    for h, old in zip(out, found, strict=True):
        if h is not old:
            names.setdefault(h.body, []).append(h.name)
    is_each = len(names) > 1 and all(sorted(own) == ["t", "x"] for own in names.values())
    return out if is_each and not {"t", "x", "y"} & {h.name for h in found} else found


def _with_body_of_run(found):
    """Beside ``blue puck X`` the one owner of ``Red puck: X`` is a body too, and no recording."""
    runs = {h.run for h in found if h.run}
    plain = [h for h in found if h.name in ("x", "y") and h.sure < GUESS]
    if len(runs) != 1 or is_run(*runs) or not all(h.run for h in plain):
        return found
    others = {h.name for h in map(_of_body, found) if h.body}
    if not plain or {h.name for h in plain} != others & {"x", "y", "z"}:
        return found
    return [replace(h, run="", body=h.run, sure=GUESS) if h.run else h for h in found]


def bodies_beside(table_columns, units):
    """Bodies whose places columns that are not used may be, each with its columns.

    `table_columns` maps names of columns that mean nothing to us to what the file calls them,
    `units` to theirs.

    Returns
    -------
    dict of str to dict of str to str
        Body -> axis -> column of the file; of bodies with a column x and a column y.
    """
    out = {}
    for name, theirs in table_columns.items():
        h = _of_body(Heading(_UNGLUED.sub(r"\1_\2", name), units.get(name, ""), theirs))
        if h.body and h.name in "xyz" and not words_of(h.body) & _PROCESSED_WORDS:
            out.setdefault(h.body, {})[h.name] = theirs
    return {body: axes for body, axes in out.items() if {"x", "y"} <= set(axes)}


def numbered_places(texts):
    """Headings ``x1, x2`` or ``pos1, pos2``, of bodies on one line."""
    found = {text: _COUNTED.fullmatch(text.strip()) for text in texts}
    return [t for t, of in found.items() if of and folded(of[1]) in _PLACE_WORDS | {"x"}]


def _with_counted_places(found):
    """``x1, x2`` or ``Position 1, Position 2`` as bodies on a line, where no column is a place.

    ``x1, x2, x3`` are as often the coordinates of one body, and are asked for.
    """
    names = numbered_places([h.name for h in found if h.sure == UNKNOWN and not h.ignored])
    own = [h for h in found if h.name in names and (not h.unit or unit_of(h.unit) == LENGTH)]
    stems = {folded(_COUNTED.fullmatch(h.name.strip())[1]) for h in own}
    is_asked = stems == {"x"} and len(own) == 3
    if has_place(found) or len(own) < 2 or len(stems) > 1 or is_asked:
        return found
    return [
        replace(h, name="x", body=_COUNTED.fullmatch(h.name.strip())[2], sure=GUESS)
        if h in own else h for h in found
    ]  # fmt: skip


def _with_kept_angles(found):
    """Angles whose unit is declared under a whole name, ``angle_deg``, where nothing is a place.

    Beside places such a name is kept: it is that of an input.
    """
    if has_place(found) or any(_guess(h.name) in ("x", "y") for h in found if h.sure == UNKNOWN):
        return found
    return [
        _read(h.theirs, {}, True)
        if h.is_renamed and h.name == h.theirs and is_angle_name(h.name) else h
        for h in found
    ]  # fmt: skip


def _with_angles(found):
    """``theta``, or ``phi1`` and ``phi2``, as coordinates of bodies, where no column is a place."""
    if has_place(found) or any(_guess(h.name) in ("x", "y") for h in found if h.sure == UNKNOWN):
        return found
    out = [_as_angle(h) for h in found]
    named = [frozenset(words_of(h.body)) for h in out]
    out = [  # of one that was smoothed, or made noisy, the plain one is it
        old if words & _PROCESSED_WORDS and words - _PROCESSED_WORDS in named else h
        for h, old, words in zip(out, found, named, strict=True)
    ]
    angles = [(h.run, h.body) for h, old in zip(out, found, strict=True) if h is not old]
    bodies = {body for _, body in angles}
    if not angles:
        return _with_only_angle(found)
    if len(set(angles)) < len(angles):
        return found
    if len(bodies) == 1:
        return [replace(h, body="") if h.body in bodies else h for h in out]
    return _with_clocks_of_angles(out, bodies)


def _with_clocks_of_angles(found, bodies):
    """``t1, theta1, t2, theta2`` as bodies that have each its clock."""
    own = {f"t{number[0]}": body for body in bodies if (number := re.findall(r"\d+$", body))}
    clocks = [h for h in found if h.sure == UNKNOWN and h.name.lower() in own]
    if len(clocks) < len(bodies) or len(own) < len(bodies) or any(h.name == "t" for h in found):
        return found
    return [
        replace(h, name="t", body=own[h.name.lower()], sure=GUESS) if h in clocks else h
        for h in found
    ]  # fmt: skip


def _with_only_angle(found):
    """The only column beside the clock, if its unit is one of angles: ``roll (deg)``."""
    bare = [h for h in found if h.sure == UNKNOWN and not (h.unit or h.ignored or h.is_renamed)
            and h.name.lower() in _BARE_ANGLES]  # fmt: skip
    told = [h for h in found if h.unit and unit_of(h.unit) != TIME]
    if len(bare) == 1 and not told:  # the heading is a unit, and nothing else
        return [replace(h, name="x", unit=h.name, sure=GUESS) if h is bare[0] else h for h in found]
    if len(told) != 1 or told[0].sure != UNKNOWN or not is_angle(told[0].unit):
        return found
    if is_error(told[0].name) or told[0].is_renamed or told[0].ignored:
        return found
    return [replace(h, name="x", sure=GUESS) if h is told[0] else h for h in found]


def _as_angle(heading):
    """A column such as ``phi1`` as the coordinate of a body of that name."""
    if heading.sure != UNKNOWN or heading.body:
        return heading
    stem, unit = heading.name.strip(), heading.unit
    cuts = [cut for mark in (_BEFORE_ANGLE, r"(.+)_([^_]+)") if (cut := re.fullmatch(mark, stem))]
    cut = next((cut for cut in cuts if is_angle(cut[2])), None)
    if not unit and cut:
        stem, unit = cut[1], cut[2]
    match = _ANGLE.fullmatch(folded(stem))
    if not match or _is_dotted(stem) or is_error(match[1]) or (unit and not is_angle(unit)):
        return heading
    return replace(heading, name="x", unit=unit, body=stem, sure=GUESS)


def _of_body(heading, letters=frozenset()):
    """As a column of a body; `letters` are bodies, whatever units they name."""
    if heading.sure != UNKNOWN and not heading.is_renamed:
        return heading
    text, unit = heading.name, heading.unit
    if not unit and (cut := re.fullmatch(r"(.+)_([^_]+)", text)) and unit_of(cut[2]) == LENGTH:
        text, unit = cut[1], cut[2]
    text = _without_place_words(text)
    before, after = _BODY_BEFORE.fullmatch(text), _BODY_AFTER.fullmatch(text)
    axis, body = (before[2], before[1]) if before else ("", "")
    if after and not before:
        axis, body = after[1], after[2] or after[3]
    is_length = not unit or unit_of(unit) == _UNIT_OF[axis.lower()] if axis else False
    # Beside a unit a name is none itself: `A_x [AU]` is a star's place; `A_x` is anything.
    is_apart = body.isdecimal() or (after and after[3] and not before)
    is_apart = is_apart or (after and body in letters)
    names_unit = not (unit or heading.is_renamed or is_apart) and is_unit(body)
    is_turn = bool({*re.split(r"[\W_]+", body.lower())} & words_for("turn"))
    if not body or not is_length or is_error(body) or names_unit or is_turn:
        return heading
    return replace(heading, name=axis.lower(), unit=unit, body=body, sure=GUESS)


def _without_place_words(text):
    """``Objekt 1 x-Koordinate`` as ``Objekt 1 x``, and ``ball x velocity`` as ``ball vx``.

    A place in one word with whose it is, ``cartPos``, is that along a line; of ``x-coordinate of
    mass 1`` the body stands behind.
    """
    match = _CAMEL.fullmatch(text)
    if match and folded(match[2]) in _PLACE_WORDS:
        return f"{match[1]} x"
    label = _LABELLED.fullmatch(text)
    whose = None if label else _OF_WHOM.fullmatch(text)
    body, axis, word = label.groups() if label else whose.group(3, 1, 2) if whose else [""] * 3
    if not re.search(r"\w", body):
        return text
    word = folded(word)
    mark = "" if word in _PLACE_WORDS else "v" if word in _SPEED_WORDS else None
    return text if mark is None else f"{body} {mark}{axis}"


def _with_one_unit(found):
    """Of a velocity in several units, ``vz (ft/s), vz (m/s)``, the first, or the one named."""
    own = {}
    for h in found:
        if h.sure == LITERAL and h.name[:1] == "v":
            own.setdefault((h.owner, h.name), []).append(h)
    again = set()
    for alike in own.values():
        units = {h.unit for h in alike}
        if len(units) == len(alike) > 1 and len(set(map(unit_of, units))) == 1:
            kept = next((h for h in alike if h.is_renamed), alike[0])
            again |= {id(h) for h in alike if h is not kept}
    return [replace(h, name="", ignored=h.theirs) if id(h) in again else h for h in found]


def _settled(found):
    """Of several columns of one owner that may be the same, the plainest is it.

    Two words from which the same is guessed say nothing; a word may come again, as in tables of
    several runs side by side.
    """
    words = {}
    for h in found:
        if h.sure != UNKNOWN:
            sures = words.setdefault((h.owner, h.name), {})
            sures.setdefault(h.sure, []).append(h.theirs.lower())
    for h in found:
        sures = words.get((h.owner, h.name), {})
        alike = sures.get(h.sure, [])
        is_it = h.sure == min(sures, default=UNKNOWN) != UNKNOWN
        if is_it and h.sure == WORD:
            is_it = h.theirs.lower() == alike[0]
        elif is_it and h.sure == GUESS:
            is_it = len(set(alike)) == 1 or _is_in_first_unit(h, found)
            if not is_it and _is_in_first_unit(next(f for f in found if _is_like(f, h)), found):
                h = replace(h, name="", ignored=h.theirs)  # the same once more
                is_it = True
        if h.run and h.sure == UNKNOWN:
            is_it = h.name.isidentifier()  # a log of that run
        yield h if is_it else replace(h, name=h.stem, sure=UNKNOWN, run="", body="")


def _is_like(one, other):
    return (one.owner, one.name, one.sure) == (other.owner, other.name, other.sure)


def _is_in_first_unit(heading, found):
    """Whether columns that may be the same are one in several units, and this is the first."""
    own = [h for h in found if _is_like(h, heading)]
    units = {unit_of(h.unit) if h.unit else None for h in own}
    is_one = len({folded(h.stem) for h in own}) == 1 and len(units) == 1 and None not in units
    return is_one and own[0] is heading


def told(found):
    """A note of what was guessed, empty without; and which option names another."""
    guessed = [h for h in reversed(found) if h.sure == GUESS and h.name and not h.is_renamed]
    guesses = list({(h.name, h.body): h for h in guessed}.values())[::-1]
    if not guesses:
        return ""
    ours = {h.name: h for h in found}
    is_star = is_polar(ours) and (
        is_position_angle(ours["angle"].theirs) or is_of_sky(ours["distance"].unit)
    )  # fmt: skip
    back = {name: alias for alias, name in POLAR_ALIASES.items()} if is_star else {}
    listed = ", ".join(
        f"{h.theirs!r} as {back.get(h.name, h.name)}" + (f" of {h.body}" if h.body else "")
        for h in guesses[:12]
    )
    names = dict.fromkeys(back.get(h.name, h.name) for h in guesses if not h.body)
    options = " ".join(f"{name}=NAME" for name in names) or "BODY_x=NAME BODY_y=NAME"
    return in_python(f"{BY_WORDS}: {listed}; if one is not that, say which is: --columns {options}")
