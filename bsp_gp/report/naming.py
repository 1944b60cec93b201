"""Names of forces in plain words."""

import math
import re

from bsp_gp.data.conversion import is_unit
from bsp_gp.language.formula import Call, Constant, Number, factors, quotient
from bsp_gp.language.inputs import STATE_INPUTS, property_of
from bsp_gp.language.render import to_text
from bsp_gp.loop.outcome import is_open
from bsp_gp.physics.force import split_linear
from bsp_gp.report.codes import CAUSES
from bsp_gp.report.numbers import format_number, format_value, pretty_unit, with_unit
from bsp_gp.units import parse_unit

_DIRECTIONS = {
    "v_i": "velocity",
    "v_i - v_j": "relative velocity",
    "p_i - p_j": "line to the other body",
    "p_i - p_c": "line to the contact point",
}


MOST_ROWS = 4
"""Places of bad rows that are named."""
_POWERS = {1: "linear", 2: "quadratic", 3: "cubic"}


def describe(formula, value=None, other="the other body", exponents=(), is_bred=False):
    """Name a term in plain words: "drag, linear in speed", "pull to the other body, as distance⁻²".

    `other` is the name of the body that acts. Of `exponents`, as an effect has them, those whose
    neighbours the data do not exclude are told with their interval in place of the textbook's:
    "drag, speed to the 1.5 (1.2 to 1.8)". A function that was bred has no name of a form.
    """
    if is_bred and split_linear(formula)[1].constants:
        return _bred_phrase(formula, other)
    plain, words = _without_time(formula)
    if words:
        return ", ".join([describe(plain, value, other, exponents), *words])
    direction, conditions, powers = _parts(formula)
    is_along = direction is not None and to_text(direction) == "normalize(v_i)"
    rubs = is_along and set(powers) <= {"m_i"}  # and on nothing else it depends
    loose = [e for e in exponents if not e.get("is_told", True)
             and (e["stated"] or rubs and e["of"] == "norm(v_i)")]  # fmt: skip
    powers = {n: power for n, power in powers.items() if n not in {e["of"] for e in loose}}
    if _OBLATE.search(to_text(formula)):
        phrase = "pull of an oblate centre (its flattening, about z)"
    elif _SINE.search(to_text(split_linear(formula)[1])):
        phrase = SINE
    elif split_linear(formula)[1].constants:
        phrase = _inner_phrase(direction, formula, powers, value, bool(loose))
        if value is not None and value < 0:
            phrase = re.sub(r"^force to a point", "force away from a point", phrase)
            phrase = re.sub(r"^spring to a rest point", "push away from a point", phrase)
        if value is not None and value > 0:
            phrase = re.sub("^spring (along .) to a rest", r"push \1 away from a", phrase)
            phrase = re.sub("^drag that (weakens|levels)", r"forward push that \1", phrase)
    else:
        condition = conditions[-1] if conditions else None
        phrase = _phrase(direction, condition, powers, value, bool(loose))
        if any(not e["stated"] for e in loose):
            phrase = re.sub("^drag", "friction", phrase)
    phrase = ", ".join([phrase, *map(_loose, loose)])
    phrase = re.sub(r"\^1(?![\d.])", "", phrase.replace(" * ", " times "))
    return pretty_unit(phrase).replace("the other body", other)


_FADING = re.compile(r"^exp\(-.* / \w+\)$")
"""What is left after a time."""


def _without_time(formula):
    """A term without factors by which its strength changes in time, and words for these."""
    constant, rest = split_linear(formula)
    above, below = factors(rest)
    timed = [f for f in above if f.constants and f.inputs == {"t"} and "cos" not in to_text(f)]
    plain = [f for f in above if f not in timed]
    words = {to_text(f): _time_word(to_text(f)) for f in timed}
    if not plain or None in words.values():
        return formula, ()
    if set(words.values()) == {"from an instant on", "up to an instant"}:
        words = {"": "switched on and off in time"}
    first = [Constant(constant)] if constant else []
    return quotient([*first, *plain], below), tuple(dict.fromkeys(words.values()))


def _time_word(text):
    """What a factor does that changes in time; None where that has no name of its own."""
    if _FADING.search(text):
        return "fading with time"
    return next((word for mark, word in _SWITCHED if mark in text), None)


FARTHEST = 4.0
"""Powers from the one in the law up to which an estimate to first order reaches."""


def _loose(e):
    value, low, high = (format_number(e[key], 2) for key in ("value", "low", "high"))
    word = size_name(e["of"])
    if is_untold(e):
        return f"its power of {word} not told by these data"
    return f"{word} to the {value} ({low} to {high})"


def is_untold(exponent):
    """Whether the data leave a power so open that its best value says nothing."""
    return is_beyond(exponent) or is_open(exponent)


def is_beyond(exponent):
    """Whether a power is so far from the one in the law that no first order tells which it is."""
    is_other = not exponent["low"] <= exponent["stated"] <= exponent["high"]
    return is_other and abs(exponent["value"] - exponent["stated"]) > FARTHEST


_OBLATE = re.compile(r"norm\((p_i - \w+)\)\^-5 \* \(\(1 - 5 \* .* \* \(\1\) \+ 2 \* ")
SWINGS = "push with a period along "
SINE = "what drives an angle back as its sine (a weight on an arm, a pendulum)"
_SINE = re.compile(r"^(?:m_i \* )?sin\(([xyz])_i / 1 \[rad\]\) (?:\* m_i )?\* e_\1$")
YEAR = 0.02
"""Part of a year by which a period may differ from one to be told as a year."""
_TURNS = r"cos\(\w+ \* (?:t|\(t - [^()]*\))\).*sin\(\w+ \* (?:t|\(t - [^()]*\))\).*"
_WHOLE = (
    (_TURNS + r"\* ([xyz])_i \* e_\1$",
     "force along {0} in proportion to {0}, with a period (an oscillating trap)"),
    (_TURNS + r"e_([xyz])$", SWINGS + "{}"),
    (r"cos\(\w+ \* ([xyz])_i\).*\* e_\1$",
     "force along {0} that repeats with {0} (a washboard, an egg crate)"),
    (r"Omega\d*(?:_x\d*)?\b.*v_i\)", "a frame that turns (Coriolis and centrifugal forces)"),
    (r"norm\(v_i - .*u_\w+ \* e_.*\) \* \(v_i - ", "drag in a wind, quadratic in speed"),
    (r"inverse\(1 \+ \(norm\(v_i\) / \w+\)\^2\) \* v_i$",
     "drag that weakens at high speed (an eddy brake)"),
    (r"inverse\(1 \+ norm\(v_i\) / \w+\) \* v_i$", "drag that levels off at high speed"),
    (r"^\(([xyz])_i - \w+\)\^2 \* v_i$",
     "drag, linear in speed, as the square of the way along {0} from a place"),
    (r"^\(([xyz])_i - \w+\) \* e_\1$", "spring along {0} to a rest point"),
    (r"^(?:m_i \* )?\(([xyz])_i - \w+\)\^3 (?:\* m_i )?\* e_\1$",
     "spring along {0} that hardens or softens, cubic in its stretch"),
    (r"^(?:m_i \* )?abs\(([xyz])_i - \w+\) \* \(\1_i - \w+\) (?:\* m_i )?\* e_\1$",
     "spring along {0} that hardens or softens, quadratic in its stretch"),
    (r"^(?:\w+ \* )?abs\(([xyz])_i\)\^w\d* \* sign\(\1_i\) \* e_\1$",
     "force along {0}, to a fitted power of {0}"),
    (r"^(?:\w+ \* )?tanh\(norm\(v_i\) / \w+\) \* normalize\(v_i\)$",
     "friction that sets in over a range of speeds"),
    (r"^(?:\w+ \* )?exp\(-\(norm\(v_i\) / \w+\)\^2\) \* normalize\(v_i\)$",
     "friction at low speed alone (Stribeck)"),
    (r"^\(exp\(.*([xyz])_i.* - exp\(.*\1_i.*\) \* e_\1$",
     "force along {0} as of a bond (Morse)"),
    (r"^(?:tanh|inverse\(1 \+ abs)\(+([xyz])_i - \w+\).* / D.* e_\1$",
     "spring along {0} that levels off"),
    (r"^(?:\w+ \* )?tanh\(norm\(.*centre_.* \* normalize", "spring to a point that levels off"),
    (r"^sin\(\(([xyz])_i - \w+\) / 1 \[rad\]\) \* e_\1$", SINE),
    (r"^sin\(\(([xyz])_i - .* \* e_\1$", "force along {0}, as the sine of {0}"),
    (r"^(?:exp\(-|\().*\(([xyz])_i - \w+\).* \* \(\1_i - \w+\) \* e_\1$",
     "force along {0} about a place, gone a length away (a dip or a bump)"),
    (r"^(?:0\.5 \* )?\(1 [-+] sign\(([xyz])_i - \w+\)\)"
     r" \* \(*(?:\w+ - \1_i|\1_i - \w+)\) \* e_\1\)?$",
     "spring along {0} on one side of a place (a bumper, a rubber band)"),
    (r"^(?:0\.5 \* )?\(1 \+ sign\((L\d*) - (norm\(p_i - p_j\))\)\) \* \(\1 - \2\) \* normalize",
     "springy push of bodies that touch, nearer than a distance"),
    (r"^(?:0\.5 \* )?\(\(1 - sign\(([xyz])_i - \w+\)\) .*\(1 \+ sign\(\1_i - \w+\)\) .*\) \* e_\1$",
     "springs along {0} at both ends (bumpers)"),
    (r"^\(1 - \(\([xyz]_i - .*\^2\) \* v_i$",
     "drag that changes its sign a distance away from a place (self-excited, van der Pol)"),
    (r"norm\(.*centre_.*\)\^n\d* \* perp\(",
     "force round a point (a vortex), to a fitted power of distance"),
    (r"norm\(.*centre_.*\)\^n\d* \* normalize",
     "force to a point, to a fitted power of distance"),
    (r"^(?:\w+ \* )?\(norm\(.*centre_.*\) - D\d*\) \* normalize\(",
     "spring of some length to a post"),
    (r"^(?:\w+ \* )?\(norm\(.*centre_.*\^-\d\.5 \* \(",
     "force to a point, softened within a length (as of a place beneath)"),
    (r"^(?:\w+ \* )?exp\(-\(norm\(.*centre_.* \* \(",
     "force to a point, gone a length away (a dip or a bump)"),
    (r"exp\(-\(?norm\(.*centre_.* \* normalize",
     "force to a point, fading with distance (exponential)"),
)  # fmt: skip
"""Texts of laws with constants inside that have a name of their own."""

BEYOND = "beyond a threshold"
_SWITCHED = (
    ("1 + sign(t", "from an instant on"), ("1 - sign(t", "up to an instant"),
    ("sign(t", "switched in time"),
)  # fmt: skip
_INNER = (
    ("sign(", BEYOND),
    ("bessel_k1(", "screened in two dimensions (K1 of distance over a length)"),
    ("exp(-norm(p_i - origin", "fading with the distance to the origin"),
    ("cos(", "alternating with a period"),
    ("exp(", "fading with a length"), ("^-1.5", "softened within a length"),
    ("inverse(1 +", "levelling off"), ("^n", "to a fitted power of {}"), ("", "less a length"),
)  # fmt: skip
"""Marks of factors with a constant inside, and what they do."""


def _inner_phrase(direction, formula, powers, value=None, is_loose=False):
    """Name a term with constants inside: "spring to a point", "force along e_x, fading ..."."""
    rest = split_linear(formula)[1]
    for mark, phrase in _WHOLE:
        found = re.search(mark, to_text(rest))
        if found:
            return phrase.format(*found.groups())
    above, below = factors(rest)
    inside = [f for f in (*above, *below) if f.constants and f.type.shape != "vector"]
    of_bodies = [f for f in inside if all(map(property_of, f.inputs))]
    inner = [to_text(f) for f in inside if f not in of_bodies]
    text = to_text(direction)
    is_place = "centre_" in text
    powers = {
        "norm(p_i - p_j)" if "centre_" in name else name: power
        for name, power in powers.items() if "centre_" in name or name not in inner
    }  # fmt: skip
    words = [_inner_word(each) for each in inner if "centre_" not in each]
    if words.count(BEYOND) == 2:
        words[words.index(BEYOND)] = "between two places"
        words.remove(BEYOND)
    bare = text.removeprefix("normalize(").removesuffix(")")
    if is_place and not powers and not inner:
        return "spring to a rest point"
    point = "round a point (a vortex)" if text.startswith("perp(") else "to a point"
    way = bare[2:] if bare.startswith("e_") else f"the {_DIRECTIONS.get(bare, bare)}"
    along = point if is_place else f"along {way}"
    is_fitted = any("fitted power" in word for word in words)
    is_plain = not (set(powers) - {"norm(v_i)", "m_i"} or is_fitted)
    if text in ("v_i", "normalize(v_i)") and is_plain:
        total = powers.get("norm(v_i)", 0) + (text == "v_i")
        kind = "drag" if total else "friction"
        kind = "forward push" if value is not None and value > 0 else kind
        told = [kind] if is_loose else [f"{kind}, {_in_speed(total)}"]
        return ", ".join(dict.fromkeys([*told, *words]))
    if any(each.startswith("centre_") for each in inner):
        return f"spring to a line or plane across {text}"
    if of_bodies:
        words.append("times " + " ".join(map(to_text, of_bodies)))
    return ", ".join(dict.fromkeys([f"force {along}{_scaling(powers)}", *words]))


def _bred_phrase(formula, other):
    """Name a force by what its strength is a function of: "force along x, a function of x"."""
    above, below = factors(split_linear(formula)[1])
    (direction,) = (to_text(f) for f in above if f.type.shape == "vector")
    inside = " ".join(to_text(f) for f in (*above, *below) if f.constants)
    of = next(word for mark, word in _VARIABLES if re.search(mark, inside))
    of = re.search(of, inside)[0][0] if of == _AXIS else of
    way = direction.removeprefix("normalize(").removesuffix(")")
    way = way[2:] if way.startswith("e_") else f"the {_DIRECTIONS.get(way, way)}"
    return f"force along {way}, a function of {of} of no listed form".replace(
        "the other body", other
    )


_AXIS = r"[xyz]_i"
_VARIABLES = (
    (r"norm\(p_i - p_j\)", "distance"), (r"norm\(v_i\)", "speed"), (_AXIS, _AXIS), ("", "time"),
)  # fmt: skip
"""What a function that was bred is one of, by what stands in it."""


def _inner_word(text):
    """What a factor with a constant inside does."""
    word = next(word for mark, word in _INNER if mark in text)
    return word.format("speed" if "v_" in text else "distance")


_BUMPERS = re.compile(
    r"\(\(1 - sign\(([xyz])_i - (\w+)\)\) .*\(1 \+ sign\(\1_i - (\w+)\)\) .*\) \* e_\1"
)


def between_bumpers(effect):
    """Two springs at both ends that reach past each other: "" where they do not.

    Between the two places both act: there the stiffness is another one, and may be none at all.
    """
    found = _BUMPERS.search(effect.law or "")
    known = {c.name: c for c in effect.constants}
    if not found or not {found[2], found[3]} <= set(known):
        return ""
    high, low = known[found[2]], known[found[3]]
    if not high.value > low.value:
        return ""
    places = " and ".join(format_number(c.value, 3) for c in (low, high))
    return (
        f"another stiffness along {found[1]} between {with_unit(places, high.unit)} (a dead band, "
        "where none is left there)"
    )


def change(code, name, constants=()):
    """How a declared term has to change: "another number in 9.81 [m/s^2] * m_i * down: −18.7 %".

    Parameters
    ----------
    code : str
        One of `CAUSES`.
    name : str
        As the loop calls it.
    constants : sequence
        With `value`, `low` and `high`, as far as they are known.
    """
    if code in ("wind", "belt"):
        size = f", {pretty_unit(_vector(constants))}" if constants else ""
        return f"{CAUSES[code]}{size}"
    c = constants[0] if len(constants) == 1 else None
    if found := re.fullmatch(r"numbers? of (.+?)(?:, within its last digit)?", name):
        by = f": by {format_value(100 * c.value, 100 * c.low, 100 * c.high)} %" if c else ""
        return f"another number in {found[1]}{by}"
    if found := re.fullmatch(r"exponent of (.+?) in (.+)", name):
        by = ""
        if c is not None:
            by = f", {'higher' if c.value > 0 else 'lower'} by "
            by += format_value(abs(c.value), *sorted((abs(c.low), abs(c.high))))
        size = size_name(found[1])
        return f"another power of {size} in {found[2]}{by}"
    if found := re.fullmatch(r"(.+), of what was \w+ ago", name):
        ago = with_unit(format_value(c.value, c.low, c.high), c.unit) if c else "some time"
        return f"{found[1]} as it was {ago} ago: {CAUSES[code]}"
    if code in CAUSES and code not in ("number", "exponent"):
        more = " (or masses other than told)" if code == "constant_per_body" else ""
        return f"{CAUSES[code]} in {name}{more}"
    return name


def of_scenes(code, names):
    """What an instrument did in some scenes: "a wrong scale of lengths in scene run2"."""
    axis = "[xyz]_" if code == "drift" else ""
    found = (re.fullmatch(f"{code}_{axis}(.+)", name) for name in names)
    scenes = list(dict.fromkeys(match[1] for match in found if match))
    where = f" in scene {scenes[0]}" if len(scenes) == 1 else " in each scene" if scenes else ""
    return f"{CAUSES[code]}{where}"


def _vector(constants):
    """Components with their unit: "(0.967, 0.521) m/s"."""
    text = ", ".join(format_number(c.value, 3) for c in constants)
    return with_unit(f"({text})" if len(constants) > 1 else text, constants[0].unit)


def along_one_line(phrases, values):
    """Forces that differ in nothing but their axis told as one: "uniform push along (0.8, 0.6)"."""
    found: dict = {}
    for phrase, value in zip(phrases, values, strict=True):
        axis = re.match(r"(?:uniform push|force) along ([xyz])\b", phrase)
        if axis is None or value is None:
            found[phrase, "", len(found)] = {}
        else:
            key = phrase[: axis.start(1)], phrase[axis.end() :], -1
            found.setdefault(key, {})[axis[1]] = value
    told = []
    swings = [phrase for phrase in phrases if phrase.startswith(SWINGS)]
    if len(swings) > 1 and len(swings) == len(phrases):  # one rate, an amplitude along every axis
        return (SWINGS + " and ".join(phrase[len(SWINGS) :] for phrase in swings),)
    for (before, behind, _), parts in found.items():
        size = math.hypot(*parts.values())
        axes = "".join(parts)
        if len(parts) > 1 and size > 0:
            ways = (parts.get(axis, 0.0) / size for axis in ("xyz" if "z" in parts else "xy"))
            axes = f"({', '.join(format_number(way, 3) for way in ways)})"
        told.append(before + axes + behind)
    return tuple(told)


def period(effect):
    """How long a period is, ", every 1.002 yr"; and of what it may be the period, if that shows."""
    rate = next((c for c in effect.constants if re.fullmatch(r"w\d+", c.name)), None)
    unit = rate.unit.removeprefix("1/") if rate and rate.unit.startswith("1/") else ""
    if not is_unit(unit) or not rate.value > 0:
        return ""
    size, year = 2 * math.pi / rate.value, parse_unit("yr")[0] / parse_unit(unit)[0]
    is_year = abs(size / year - 1) < YEAR
    if is_year or size > year:
        size, unit = size / year, "yr"
    more = " (a year, as the way of the earth round the sun shows: parallax)" if is_year else ""
    return f", every {with_unit(format_number(size, 4), unit)}{more}"


def constant_distance(effect):
    """A rod in plain words: "distance to (0.02, 1.61) m is constant, 0.800 m: a string or rod".

    Its numbers are those of the constants in the end; where they are none, as it was seen.
    """
    unit, (between, length) = effect.constants[0].unit, effect.name.rsplit(" = ", 1)
    known = {c.name.rstrip("0123456789"): c for c in effect.constants}
    size = with_unit(format_number(float(length), 3), unit)
    if "L" in known:
        size = with_unit(format_number(known["L"].value, 3), known["L"].unit)
    place = re.search(r"\(([^()]*,[^()]*)\)", between)
    if place:
        pivot = [known[name] for name in ("pivot_x", "pivot_y", "pivot_z") if name in known]
        seen = [float(x) for x in place[1].split(",")]
        if len(pivot) == len(seen):
            unit, seen = pivot[0].unit, [c.value for c in pivot]
        to = f"to ({', '.join(format_number(x, 3) for x in seen)}) {unit}"
    else:
        first, second = between.removeprefix("norm(p_").removesuffix(")").split(" - p_", 1)
        to = f"of {first} and {second}"
    return f"distance {to} is constant, {size}: a string or rod"


def kept_curve(effect):
    """A line, curve or plane that is kept to; a curve with its equation: "y = 0.7 * x^2"."""
    if "^" not in effect.name:
        return CAUSES["wire"]
    equation = re.sub(r"\b([xyz])_\w+", r"\1", effect.name)
    left, _, right = equation.partition(" = ")
    if "/" in right:  # in powers of a way from the middle
        along = "x" if left == "y" else "y"
        return f"{CAUSES['wire']}, {left} as a polynomial of degree {right.count(' + ')} in {along}"
    terms = right.split(" + ")
    rail = [c for c in effect.constants if c.name.startswith("rail_")]
    if len(rail) == len(terms):  # in the end, and not as it was seen
        values = (format_number(c.value, 4).replace("−", "-") for c in rail)
        terms = [
            " * ".join([value, *term.split(" * ")[1:]])
            for value, term in zip(values, terms, strict=True)
        ]
    equation = f"{left} = {' + '.join(terms)}".replace("+ -", "- ")
    return f"a curve that is kept to, a wire or rail: {equation}"


def inclination(effect):
    """In plain words: how much the plane of an orbit is inclined, and how it lies.

    x is to the east and y to the north; the mirror image of the plane looks alike.
    """
    known = {c.name: c for c in effect.constants}
    slope, node = (
        [math.degrees(v) for v in (known[n].value, known[n].low, known[n].high)]
        for n in ("inclination", "node")
    )
    by = format_value(*slope, "deg")
    nodes = format_number((90.0 - node[0]) % 180.0, 3)
    return (
        f"an orbit whose plane is inclined to the sky by {by}, its line of nodes at a position "
        f"angle of {nodes} deg"
    )


def ripple(effect):
    """A force that comes back along its axis: with its period; along an angle, how often a turn."""
    number = next((c for c in effect.constants if re.fullmatch(r"q\d*", c.name)), None)
    if number is None or not number.low > 0:
        return CAUSES["ripple"]
    if number.unit != "1/rad":
        unit = re.sub(r"^1/", "", number.unit)
        ends = (2 * math.pi / v for v in (number.value, number.high, number.low))
        return f"{CAUSES['ripple']}, every {format_value(*ends, unit)}"
    times = max(round(number.value), 1)
    if not number.low <= times <= number.high:
        turn = 2 * math.pi / number.value
        return f"a torque that comes back along the angle, every {turn:.4g} rad"
    often = {1: "once", 2: "twice"}.get(times, f"{times} times")
    return f"a torque that comes back {often} a turn" + " (out of balance)" * (times == 1)


def bad_rows(effect):
    """In plain words, rows counted from 1: "2 bad rows: ball of 4, row 21; ball of 3, row 1"."""
    every = re.findall(r"(?:^|; )(.+?) left out\[(.+?), (\d+):(\d+)\]", effect.name)
    told, count = [], 0
    for body, scene, first, stop in every:
        first, stop = int(first) + 1, int(stop)
        count += stop - first + 1
        rows = f"row {first}" if stop == first else f"rows {first} to {stop}"
        told.append(f"{body} of {scene}, {rows}")
    if len(told) > MOST_ROWS:
        told[MOST_ROWS - 1 :] = [f"and others in {len(told) - MOST_ROWS + 1} places"]
    what = "a bad row" if count == 1 else f"{count} bad rows"
    return f"{what}: {'; '.join(told)}" if told else CAUSES["bad_row"]


def clock_jumps(effect):
    """In plain words, rows counted from 1: "times that are off by -0.05 s from row 21 of 2 on"."""
    every = re.findall(r"t ([+-]\S+) s\[(.+?), (\d+):\]", effect.name)
    told = [f"by {-float(by):.4g} s from row {int(row) + 1} of {scene} on"
            for by, scene, row in every]  # fmt: skip
    return f"times that are off {', '.join(told)}" if told else CAUSES["clock_jump"]


def _parts(formula):
    """Direction, conditions and powers of the scalar factors of a term."""
    _, rest = split_linear(formula)
    above, below = factors(rest)
    direction, conditions, powers = None, [], {}
    for sign, parts in ((1, above), (-1, below)):
        for part in parts:
            if part.type.shape == "vector":
                direction = part
            elif part.type.shape == "bool":
                conditions.append(part)
            else:
                _add_powers(part, sign, powers)
    return direction, conditions, powers


def _add_powers(part, sign, powers):
    power = sign
    while isinstance(part, Call) and part.operator in ("square", "inverse", "pow"):
        if part.operator == "square":
            power *= 2
        elif part.operator == "inverse":
            power *= -1
        elif isinstance(part.args[1], Number):
            power *= part.args[1].value
        else:
            break
        part = part.args[0]
    if isinstance(part, Number):
        return
    if isinstance(part, Call) and part.operator in ("mul", "div"):
        above, below = factors(part)
        for s, inner in ((power, above), (-power, below)):
            for p in inner:
                _add_powers(p, s, powers)
        return
    powers[to_text(part)] = powers.get(to_text(part), 0) + power


def _phrase(direction, condition, powers, value, is_loose=False):
    text = to_text(direction) if direction is not None else ""
    if "p_j - p_i" in text:  # the same line, the other way
        text, value = text.replace("p_j - p_i", "p_i - p_j"), None if value is None else -value
    if text == "p_i - p_j":
        length = "norm(p_i - p_j)"
        text, powers = f"normalize({text})", powers | {length: powers.get(length, 0) + 1}
    where = ""
    if condition is not None:
        where = " while on the mat" if "is_on" in to_text(condition) else " at contact"
    speed = powers.get("norm(v_i)", 0) or powers.get("norm(v_i - v_j)", 0)
    distance = powers.get("norm(p_i - p_j)", 0)
    radial = any("along(" in name for name in powers)
    # A function of the velocity that is no power, such as an operator of one's own.
    has_own = any(name not in _WORDS and "v_i" in _input_names(name) for name in powers)
    extension = [p for name, p in powers.items() if name.startswith("norm(p_i - p_j) - ")]
    if text in ("normalize(v_i)", "v_i") and not distance and not radial:
        brakes = value is None or value <= 0
        if is_loose:
            return f"{'drag' if brakes else 'forward push'}{where}"
        total = speed + (1 if text == "v_i" else 0)
        kind = "drag" if brakes else "forward push"
        if has_own:
            return kind + _scaling(powers | ({"norm(v_i)": total} if total else {})) + where
        places = {name: power for name, power in powers.items() if re.fullmatch("[xyz]_i", name)}
        where = _scaling(places) + _in_columns(powers) + where
        if total == 0:
            return f"{'friction' if brakes else kind} of constant size{where}"
        return f"{kind}, {_POWERS.get(total, f'power {total:g}')} in speed{where}"
    if text.startswith("perp(normalize(v_i") or text.startswith("cross(") or text == "perp(v_i)":
        across = f"force across the velocity{_side(text, powers, value)}"
        if has_own and not radial:
            return f"{across}{_scaling(powers)}{where}"
        rest = {name: p for name, p in powers.items() if name not in _SPEEDS}
        total = speed + (re.fullmatch(r"perp\(v_i\)|cross\(\w+, v_i\)", text) is not None)
        size = "" if is_loose else f", {_in_speed(total)}"
        kinds = "magnetic, Magnus or Coriolis" if is_loose or total == 1 else "magnetic or Magnus"
        return f"{across}{size}{_scaling(rest)} ({kinds}){where}"
    if text in ("up", "down"):
        return f"uniform push along the vertical{_scaling(powers)}{where}"
    if text in ("e_x", "e_y", "e_z"):
        own, size = f"v{text[-1]}_i", f"abs(v{text[-1]}_i)"
        if powers.get(own, 0) % 2 == 1:  # of the sign of the velocity
            total = powers[own] + powers.get(size, 0) + speed
            kind = "drag" if value is None or value <= 0 else "forward push"
            rest = {n: p for n, p in powers.items() if n not in (own, size, *_SPEEDS)}
            return f"{kind} along {text[-1]}, {_in_speed(total)}{_scaling(rest)}{where}"
        is_spring = {**powers, "m_i": 1} == {f"{text[-1]}_i": 1, "m_i": 1}
        if is_spring and value is not None:
            kind, way = ("spring", "to") if value < 0 else ("push", "away from")
            return f"{kind} along {text[-1]} {way} the origin{where}"
        is_placed = any(set(_input_names(name)) & {"x_i", "y_i", "z_i"} for name in powers)
        is_even = not (is_placed or set(powers) & {*_SPEEDS, *_COMPONENTS})
        verb = f"uniform push along {text[-1]}" if is_even else f"force along {text[-1]}"
        verb = "torque" if any(_ANGLE.search(name) for name in powers) else verb
        return verb + _scaling(powers) + where
    if re.fullmatch(r"perp\((?:normalize\()?p_i - p_\w+\)*", text):
        return f"force across the line to the other body{_scaling(powers)}{where}"
    if text.startswith("normalize(p_i - p"):
        verb = "force along the line to the other body"
        if value is not None:
            verb = "push from the other body" if value > 0 else "pull to the other body"
        own = {name: power for name, power in powers.items() if "along(" in name}
        if list(own.values()) == [1] and not (distance or speed) and (value is None or value <= 0):
            return f"drag between the bodies along their line (a dashpot), linear in speed{where}"
        if extension == [1] and not (distance or speed or radial):
            return f"spring towards the other body{where}"
        return verb + _scaling(powers) + where
    inner = text.removeprefix("normalize(").removesuffix(")")
    if (stream := re.fullmatch(r"v_i - ([A-Za-z]\w*)", inner)) and stream[1] != "v_j":
        total = powers.get(f"norm({inner})", 0) + (text == inner)
        if set(powers) <= {f"norm({inner})"} and not is_loose and (value is None or value <= 0):
            power = _POWERS.get(total, f"power {total:g}")
            return f"drag against the {stream[1]}, {power} in speed{where}"
    if axis := _own_axis(inner):
        return f"force {axis}{_scaling(powers)}{where}"
    centre = re.fullmatch(rf"p_i - {_PLACE}|{_PLACE} - p_i", inner)
    if centre:
        return f"force along the line to {centre[1] or centre[2]}{_scaling(powers)}{where}"
    along = _DIRECTIONS.get(inner, text or "a fixed direction")
    return f"force along the {along}" + _scaling(powers) + where


_PLACE = r"(origin|\([^()]*\)|\w+)"


def _in_speed(power):
    return f"{_POWERS.get(power, f'power {power:g}')} in speed" if power else "of constant size"


def _side(text, powers, value):
    """To which side of the velocity a force across it points, where its sign alone tells."""
    signed = {word for name in powers for word in _input_names(name) if property_of(word)}
    is_flat = text.startswith("perp(") and not (signed - {"m_i", "m_j", "mass_i", "mass_j"})
    if value is None or not is_flat:
        return ""
    return f", to its {'left' if value > 0 else 'right'}"


_SPEEDS = {"norm(v_i)": "speed", "norm(v_i - v_j)": "relative speed"}
_COMPONENTS = {f"v{a}_i": f"speed along {a}" for a in "xyz"} | {
    f"abs(v{a}_i)": f"|speed along {a}|" for a in "xyz"
}
_ANGLE = re.compile(r"[xyz]_i / 1 \[rad\]")
"""An angle in a law's text."""
_WORDS = {"norm(p_i - p_j)": "distance", **_SPEEDS, **_COMPONENTS}


def _scaling(powers):
    words, senses = [], []
    for name, power in powers.items():
        if sense := re.fullmatch(r"sign\(([A-Za-z]\w*)\)", name):
            senses.append(f", with the sign of {sense[1]}")
            continue
        is_property = any(property_of(word) for word in _input_names(name))
        if re.fullmatch("[xyz]_i", name):
            words.append(name[0] + (f"^{power:g}" if power != 1 else ""))
            continue
        if _ANGLE.search(name):
            words.append(_ANGLE.sub("angle", name) + (f"^{power:g}" if power != 1 else ""))
            continue
        if is_property and "norm" not in name and name not in _WORDS:
            continue
        axis = _own_axis(name) if name.startswith("along(v_i, ") else ""
        radial = f"speed {axis}" if axis else "radial speed"
        label = _WORDS.get(name, radial if name.startswith("along(") else None)
        label = label or ("|radial speed|" if name.startswith("abs(along(") else size_name(name))
        words.append(label if power == 1 else f"{label}^{power:g}")
    return (f", as {' * '.join(words)}" if words else "") + "".join(senses)


def _in_columns(powers):
    """In proportion to what was logged: ", proportional to the square of the logged column 'I'"."""
    out = ""
    for name, power in powers.items():
        is_name = re.fullmatch(r"[A-Za-z]\w*", name) is not None
        if not is_name or name in {*STATE_INPUTS, *_COMPONENTS} or property_of(name):
            continue
        of = {1: "", 2: "the square of ", -1: "the inverse of "}.get(power, f"power {power:g} of ")
        out += f", proportional to {of}the logged column {name!r}"
    return out


def _own_axis(text):
    """How a direction lies to the axis that a measured angle gives a body; "" for others."""
    if found := re.search(r"cos\((\w+)\) \* e_x \+ sin\(\1\) \* e_y", text):
        return f"along the axis of {found[1]}"
    if found := re.search(r"cos\((\w+)\) \* e_y - sin\(\1\) \* e_x", text):
        return f"across the axis of {found[1]}"
    return ""


def size_name(name):
    """What a size is called: "speed", or of one that a declared law names "distance", "stretch"."""
    if name in _WORDS:
        return _WORDS[name]
    if found := re.fullmatch(r"dot\(normalize\(v_i\), e_([xyz])\)", name):
        return f"cosine of its angle to {found[1]}"
    bare = name.removeprefix("abs(").removesuffix(")") if name.startswith("abs(") else name
    if re.fullmatch(rf"norm\((?:p_i - {_PLACE}|{_PLACE} - p_i|.*centre_.* - p_i)\)", name):
        return "distance"
    if re.match(r"norm\([^()]*(?:\([^()]*\))?[^()]*\) - ", bare):
        return "stretch" if bare == name else "|stretch|"
    return f"({name})" if " - " in name or " + " in name else name


def _input_names(text):
    return re.findall(r"[A-Za-z_]\w*", text)
