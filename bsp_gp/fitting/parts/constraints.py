"""Constraints: a rod to a point or a body, a wire, a plane; what bodies keep to whatever pulls.

A string is none of them: it is a force while it is taut, and nothing else.
"""

import re
from dataclasses import dataclass
from itertools import product

import numpy as np

from bsp_gp.data.conversion import Conversion
from bsp_gp.errors import LawError, UnitError
from bsp_gp.fitting.hypothesis import Numbered, Parameter
from bsp_gp.language.formula import Call, Constant, Input, Number, evaluate, substitute
from bsp_gp.language.inputs import STATE_INPUTS, property_of
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, added_units
from bsp_gp.units import METRE, SECOND, Unit

MOST_ROWS, MOST_STARTS = 400, 36
"""Rows of a body that constants are first guessed from, and from how many values."""
_POINT = re.compile(r"(?<![A-Za-z0-9_])\(([^()]*,[^()]*)\)")
_STATE = re.compile(r"\b([pxyz])_([A-Za-z]\w*)\b")
STIFF = 3.0
"""Radians that a bob on a string, stretched, would swing from row to row: it stretches by less than
rows tell, and steps are not much shorter than they."""
LOOSE = 0.1
"""What a length counts by which a string is too long to be taut, in that by which it is too
short."""
_KEPT = ("p_i", "p_j", "t", "e_x", "e_y", "e_z", "up", "down", "origin")


@dataclass(frozen=True)
class Constraint(Numbered):
    """A quantity that bodies keep at zero.

    Attributes
    ----------
    formula : Formula
        The quantity, of places p_i, p_j and the time.
    pairs : tuple of (str, str)
        The bodies that keep to it: i, a body that forces move, and j or "".
    is_coupling : bool
        Whether it passes forces between bodies that forces move.
    """

    text: str
    formula: object
    pairs: tuple
    numbers: tuple = ()
    is_coupling: bool = False
    kind = "constraint"

    def describe(self):
        return self.text


def read_constraint(dataset, text, pairs=None, numbers=None):
    """Read a typed constraint, ``norm(p_i - (0, 1.2)) = L``.

    Parameters
    ----------
    text : str
        An equation between places. Points are written as their coordinates, in the unit of the
        data; names in them, and elsewhere, are fitted. ``x_i, y_i, z_i`` are coordinates;
        ``p_NAME`` is the place of a body by name, with ``_`` for what is no letter or digit in it.
    pairs : sequence of (str, str), optional
        The bodies i and j ("" = none) that it is on, where the text does not say it.
    numbers : mapping of str to float, optional
        Where its names begin, if that is known, SI; else where the rows keep to it best.

    Raises
    ------
    LawError
        If it is none, or does not say which bodies it is on.
    """
    sides = text.split("=")
    if len(sides) != 2 or "<" in text or ">" in text:
        raise LawError(
            f"a constraint must be one equation such as 'norm(p_i - (0, 1.2)) = 0.8', or a string "
            f"such as 'norm(p_i - (0, 1.2)) <= 0.8', got {text!r}"
        )
    formula, axes, pairs = _read(dataset, text, sides, pairs)
    moving, _ = _names(dataset)
    coupling = tuple(pair for pair in pairs if pair[1] in moving)
    lone = [e.name for s in dataset.scenes for e in s.entities if not np.isfinite(e.mass)]
    if any(set(pair) & set(lone) for pair in coupling):
        raise LawError(
            f"constraint {text!r} passes forces between moving bodies, whose masses must be known; "
            "give them a column mass in entities.csv"
        )
    if numbers is None:
        numbers = _kept_best(dataset, formula, pairs, axes)
    numbers = _parameters(dataset, formula, axes, numbers)
    return Constraint(text.strip(), formula, pairs, numbers, bool(coupling))


def freed_of(dataset, part, point, length):
    """Constraints with names in the place of numbers that were typed: fewest names first.

    Each with its numbers where the rows keep to it best, and what was typed, by name, SI.

    Parameters
    ----------
    point : sequence of str
        Names for the coordinates of its point, where it has one of numbers.
    length : str
        A name for its length, where that is a number.
    """
    points = _POINT.findall(part.text)
    known = [p.strip() for found in points for p in found.split(",")]
    right = part.text.split("=")[1].strip()
    metres = metres_of(dataset, "x")
    ways = [{}]
    if _is_number(right) and float(right):
        ways.append({length: right})
    if len(points) == 1 and all(map(_is_number, known)):
        own = dict(zip(point, known, strict=True))
        ways += [own | way for way in ways]
    out = []
    for way in ways[1:]:
        text = part.text
        if len(way) > 1:
            text = _POINT.sub(f"({', '.join(point)})", text)
        if length in way:
            text = f"{text.split('=')[0].strip()} = {length}"
        typed = {name: float(value) * metres for name, value in way.items()}
        out.append((read_constraint(dataset, text, part.pairs), typed))
    return sorted(out, key=lambda pair: len(pair[1]))


def is_string(text):
    """Whether a typed constraint is a string, a distance that is not exceeded."""
    return "<=" in text


def read_string(dataset, text):
    """Read ``norm(p_i - (0, 1.2)) <= L``: a string, which pulls while it is taut.

    It is stiff for the rows, and critically damped: what a bob has of speed along it is lost where
    it becomes taut.

    Returns
    -------
    term : Term
    starts : dict of str to float
        Where its constants begin, SI.

    Raises
    ------
    LawError
        If it is none, or is not on all bodies that forces move.
    """
    sides = text.split("<=")
    formula, axes, pairs = _read(dataset, text, sides, None) if len(sides) == 2 else (None,) * 3
    way = formula.args[0] if isinstance(formula, Call) and formula.operator == "sub" else None
    if not (isinstance(way, Call) and way.operator == "norm"):
        raise LawError(
            f"{text!r} must be a distance that is not exceeded, as in 'norm(p_i - (0, 1.2)) <= L' "
            "or 'norm(p_i - p_j) <= L'"
        )
    for scene in dataset.scenes:
        both = {name for pair in pairs if set(pair) <= {"", *scene.names} for name in pair}
        if not set(scene.names) <= both:
            raise LawError(
                f"{text!r}: scene {scene.name!r} has bodies that are not on the string "
                f"({', '.join(sorted(set(scene.names) - both))}); leave them out, or write it for "
                "all bodies with p_i and a point"
            )
    steps = [np.diff(scene.times) for scene in dataset.scenes]
    rate = STIFF / float(np.median(np.concatenate(steps)))
    is_pair = "p_j" in formula.inputs
    types = dataset_types(dataset)
    speed = Input("v_i", types["v_i"])
    mass = Input("m_i", types["m_i"])
    if is_pair:
        speed = Call("sub", speed, Input("v_j", types["v_j"]))
    is_coupled = any(other in _names(dataset)[0] for _, other in pairs)
    if is_coupled:
        other = Input("m_j", types["m_j"])
        mass = Call("div", Call("mul", mass, other), Call("add", mass, other))
    along = Call("normalize", way.args[0])
    lag = Number(2.0 / rate, SECOND, f"{2.0 / rate:.6g} [s]")
    pull = Call("add", formula, Call("mul", lag, Call("dot", speed, along)))
    taut = Call("add", Number(1.0), Call("sign", formula))
    stiffness = Number(-(rate**2) / 2, Unit.of(s=-2), f"{-(rate**2) / 2:.6g} [1/s^2]")
    size = Call("mul", Call("mul", stiffness, mass), Call("mul", taut, pull))
    numbers = _kept_best(dataset, formula, pairs, axes, is_least=True)
    return Term(Call("mul", size, along), is_declared=True), numbers


def _read(dataset, text, sides, pairs):
    """What is kept at zero, which constants are coordinates by axis, and the bodies i and j."""
    moving, fixed = _names(dataset)
    sides, roles = _with_roles(text, sides, moving, fixed)
    formula, axes = _difference(dataset, text, sides)
    return formula, axes, tuple(pairs or _pairs(dataset, text, formula, roles))


def _names(dataset):
    """Names of bodies that forces move, and of the others."""
    moving, fixed = {}, {}
    for scene in dataset.scenes:
        for k, name in enumerate(scene.names):
            (moving if k in scene.dynamic else fixed)[name] = None
    return tuple(moving), tuple(name for name in fixed if name not in moving)


def _with_roles(text, sides, moving, fixed):
    """The sides with i and j in the place of names of bodies, and who these are."""
    known = {_typed(name): name for name in (*fixed, *moving)}
    known |= {name: name for name in (*fixed, *moving)}
    found = dict.fromkeys(
        known[m[2]] for side in sides for m in _STATE.finditer(side)
        if m[2] in known and m[2] not in "ij"
    )  # fmt: skip
    found = sorted(found, key=lambda name: name in fixed)
    if len(found) > 2 or (found and found[0] in fixed):
        raise LawError(
            f"constraint {text!r} must name one or two bodies, one of which forces move; "
            f"it names {', '.join(found)}"
        )
    role = dict(zip(found, "ij", strict=False))

    def shown(match):
        letter, name = match[1], role.get(known.get(match[2]), match[2])
        if name not in ("i", "j"):
            return match[0]
        return f"p_{name}" if letter == "p" else f"dot(p_{name} - origin, e_{letter})"

    sides = [_STATE.sub(shown, side) for side in sides]
    return sides, (found[0], found[1] if len(found) > 1 else "") if found else None


def _typed(name):
    """A name of a body as it is typed: ``mass A`` of Tracker is ``mass_A``."""
    return re.sub(r"\W", "_", name)


def _difference(dataset, text, sides):
    """What the equation keeps at zero, and which of its constants are coordinates, by axis.

    Bare coordinates and lengths are in the unit of the data.
    """
    types, literals, axes = dataset_types(dataset), {}, {}
    if any(len(scene.entities) > 1 for scene in dataset.scenes):
        types |= {"p_j": STATE_INPUTS["p_j"]}
    types |= {"origin": STATE_INPUTS["origin"]}
    metres = metres_of(dataset, "x")

    def length(digits):
        name = f"literal{len(literals)}"
        value = float(digits) * metres
        literals[Constant(name)] = Number(value, METRE, f"{value:.6g} [m]")
        return name

    def point(match):
        parts = [part.strip() for part in match[1].split(",")]
        if len(parts) != dataset.n_dims:
            raise LawError(
                f"constraint {text!r}: a point has {dataset.n_dims} coordinates here, got "
                f"({match[1]})"
            )
        axes.update((part, k) for k, part in enumerate(parts) if part.isidentifier())
        parts = [length(part) if _is_number(part) else part for part in parts]
        each = [f"({c}) * e_{axis}" for c, axis in zip(parts, "xyz", strict=False)]
        return f"(origin + {' + '.join(each)})"

    formulas = []
    for side in sides:
        side = _POINT.sub(point, side)
        bare = side.strip()
        formulas.append(
            parse_formula(length(bare) if _is_number(bare) and float(bare) else side, types,
                          units=dataset.units)
        )  # fmt: skip
    try:
        formula = substitute(Call("sub", *formulas), literals)
    except UnitError as error:
        if not (isinstance(formulas[1], Number) and formulas[1].value == 0):
            raise LawError(f"constraint {text!r}: {error}") from None
        formula = substitute(formulas[0], literals)
    if formula.type.shape != "scalar":
        raise LawError(
            f"constraint {text!r} must be between numbers, got {formula.type.shape}s; write a "
            "distance norm(p_i - p_j) or a coordinate x_i, y_i"
        )
    strange = sorted(n for n in formula.inputs if n not in _KEPT and property_of(n) is None)
    if strange or "p_i" not in formula.inputs:
        raise LawError(
            f"constraint {text!r} must be on the place p_i of a body"
            + (f", and cannot name {strange[0]}" if strange else "")
        )
    if any("[" in name for name in formula.constants):
        raise LawError(
            f"constraint {text!r}: a constant for each body or scene is not there yet; give it as "
            "a column of entities.csv, and write its name with _i"
        )
    return formula, axes


def metres_of(dataset, axis):
    """The unit in which coordinates along an axis were given, m."""
    declared = dict(dataset.units.declared)
    return Conversion(declared, declared).length(axis)


def _is_number(text):
    return re.fullmatch(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", text) is not None


def _pairs(dataset, text, formula, roles):
    """Which bodies keep to it, by name."""
    if roles is not None:
        return (roles,)
    has_other = any(name == "p_j" or name.endswith("_j") for name in formula.inputs)
    found = {}
    for scene in dataset.scenes:
        moving = [scene.names[k] for k in scene.dynamic]
        fixed = [name for name in scene.names if name not in moving]
        if not has_other:
            found |= dict.fromkeys((name, "") for name in moving)
        elif len(fixed) == 1:
            found |= dict.fromkeys((name, fixed[0]) for name in moving)
        elif not fixed and len(moving) == 2:
            found[tuple(moving)] = None
        elif moving:
            raise LawError(
                f"constraint {text!r} does not say which bodies of scene {scene.name!r} it is "
                f"between: name them, as in p_{_typed(moving[0])} - "
                f"p_{_typed((fixed or moving[1:])[0])}"
            )
    return tuple(found)


# --- where constants begin ------------------------------------------------------------------------


def extent_of(dataset):
    """Middle of all places of a data set, and the largest of their extents, m."""
    places = np.concatenate([s.positions.reshape(-1, s.n_dims) for s in dataset.scenes])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    return (low + high) / 2, float(np.max(high - low)) or 1.0


def _kept_best(dataset, formula, pairs, axes, is_least=False):
    """Constants by which the rows keep to it best, name -> value; those of `axes` are coordinates.

    With `is_least` rows may as well be below zero.
    """
    from scipy.optimize import least_squares  # a slow import

    names = formula.constants
    if not names:
        return {}
    rows = [_inputs(formula, scene, pair) for scene in dataset.scenes for pair in pairs]
    rows = [row for row in rows if row is not None]
    middle, size = extent_of(dataset)

    def left(values):
        known = dict(zip(names, values, strict=True))
        parts = [np.broadcast_to(evaluate(formula, r, known), r["t"].shape) for r in rows]
        out = np.nan_to_num(np.concatenate(parts), nan=1e6, posinf=1e6, neginf=-1e6)
        return np.where(out < 0, LOOSE * out, out) if is_least else out

    choices = [
        [middle[axes[n]] + k * size for k in (0, 1, -1)] if n in axes else
        [k * size for k in (1, 0.1, -1, 10)]
        for n in names
    ]  # fmt: skip
    best = None
    for start in list(product(*choices))[:MOST_STARTS]:
        found = least_squares(left, start, x_scale=size)
        if best is None or found.cost < best.cost * (1 - 1e-9):
            best = found
    return dict(zip(names, best.x.tolist(), strict=True))


def _parameters(dataset, formula, axes, values):
    """Constants of a constraint that begin at values, and are as large as what is seen."""
    middle, size = extent_of(dataset)
    units = added_units(formula)
    return tuple(
        Parameter(
            name, "", METRE if name in axes else units.get(name), start=float(values[name]),
            prior=(float(middle[axes[name]]) if name in axes else size, size),
        )
        for name in formula.constants
    )  # fmt: skip


def left_by(dataset, part):
    """What the rows leave of a constraint at its numbers, m, one array for each scene and pair."""
    known = {p.name: p.start for p in part.numbers}
    rows = [_inputs(part.formula, s, pair) for s in dataset.scenes for pair in part.pairs]
    return [
        np.broadcast_to(evaluate(part.formula, row, known), row["t"].shape)
        for row in rows if row is not None
    ]  # fmt: skip


def _inputs(formula, scene, pair):
    """Inputs of the rows of a pair of bodies; None where the scene does not have it."""
    if any(name and name not in scene.names for name in pair):
        return None
    index = {role: scene.names.index(name) for role, name in zip("ij", pair, strict=True) if name}
    places = {role: scene.positions[:, k] for role, k in index.items()}
    seen = np.flatnonzero(np.all([np.isfinite(p).all(axis=1) for p in places.values()], axis=0))
    if len(seen) > MOST_ROWS:
        seen = seen[np.linspace(0, len(seen) - 1, MOST_ROWS).astype(int)]
    out = {"t": scene.times[seen], "origin": np.zeros(scene.n_dims)}
    out |= {f"e_{axis}": unit for axis, unit in zip("xyz", np.eye(scene.n_dims), strict=False)}
    out |= {f"p_{role}": p[seen] for role, p in places.items()}
    for name in formula.inputs:
        if property_of(name):
            column, role = property_of(name)
            out[name] = scene.entities[index[role]].properties.get(column, np.nan)
    return out
