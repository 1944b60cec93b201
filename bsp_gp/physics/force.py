"""Force laws: sums of terms, some declared and some found, and the accelerations they give."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from html import escape
from itertools import count
from types import MappingProxyType

import numpy as np

from bsp_gp.errors import LawError
from bsp_gp.language.formula import (
    Call,
    Constant,
    Input,
    Number,
    evaluate_with_gradient,
    factors,
    quotient,
    summands,
    walk,
)
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.physics.bodies import law_inputs, under
from bsp_gp.physics.dynamics import simulated_scene
from bsp_gp.physics.evaluation import PreparedLaw, Settling
from bsp_gp.units import BASE, FORCE, METRE, SPEED, Unit

HOLDING = ("constraint", "linkage", "wall")
"""Kinds of parts of what bodies do beside forces."""
FRAMING = (*HOLDING, "rail")
"""The same, with what a law is told without."""
_MASS = ("m_i", "mass_i")
PURE = ("exp", "log", "sin", "cos", "tanh", "bessel_k0", "bessel_k1")
"""Functions of pure numbers."""
COPY = " copy "
"""Between the name of a scene and the number of a simulated copy."""


def kind_of(formula):
    """Kind of a law: "pair" if it mentions the source j (or a contact with it), else "field"."""
    mentions = any(name.endswith("_j") or name == "p_c" for name in formula.inputs)
    return "pair" if mentions else "field"


def _drop_mass(formula):
    """The formula without a plain factor m_i, and whether there was exactly one to drop."""
    above, below = factors(formula)
    plain = [k for k, f in enumerate(above) if isinstance(f, Input) and f.name in _MASS]
    if len(plain) != 1:
        return formula, False
    rest = [f for k, f in enumerate(above) if k != plain[0]]
    if any(f.inputs & set(_MASS) for f in rest + below):
        return formula, False
    return quotient(rest, below), True


_ANGLES = tuple((re.compile(pattern), short) for pattern, short in (
    (r"\(x_([ij]) ([-+]) ([^()]+)\) / 1 \[rad\]", r"theta_\1 \2 \3"),
    (r"(?<!\w)\(\bx_([ij]) / 1 \[rad\]\)", r"theta_\1"),
    (r"\bx_([ij]) / 1 \[rad\]", r"theta_\1"),
    (r"(?<!\w)\(\bvx_([ij]) / 1 \[rad\]\)", r"omega_\1"),
    (r"\bvx_([ij]) / 1 \[rad\]", r"omega_\1"),
    (r" \* \(1 \[rad\] \* e_x\)", ""),
    (r"sign\(\(([^()]*)\) / 1 \[1/s\]\)", r"sign(\1)"),
    (r"sign\((omega_[ij]) / 1 \[1/s\]\)", r"sign(\1)"),
    (r"norm\((omega_[ij]|theta_[ij]) \* e_x\)", r"abs(\1)"),
))  # fmt: skip
"""How torques on angles are typed, in place of what they stand for."""


def _as_torques(text):
    for pattern, short in _ANGLES:
        text = pattern.sub(short, text)
    return text


@dataclass(frozen=True)
class Term:
    """One force of a law.

    Attributes
    ----------
    formula : Formula
        A vector; its constants are looked up in the law.
    kind : str
        "pair": summed over all sources; "field": acts on i alone.
    is_declared : bool
        True for terms that the user declared.
    """

    formula: object
    kind: str = ""
    is_declared: bool = False
    _accelerating: object = field(init=False, repr=False, compare=False)

    def __post_init__(self):
        if self.formula.type.shape != "vector":
            raise LawError(
                f"a force must be a vector, got a {self.formula.type.shape}: "
                f"{to_text(self.formula)}; multiply by a direction such as normalize(p_j - p_i)"
            )
        if not self.kind:
            object.__setattr__(self, "kind", kind_of(self.formula))
        object.__setattr__(self, "_accelerating", _drop_mass(self.formula))

    @property
    def needs_mass(self):
        """Whether the acceleration depends on the receiver's mass."""
        return not self._accelerating[1]

    @property
    def acceleration_formula(self):
        """Formula to evaluate; to be divided by the mass where `needs_mass`."""
        return self._accelerating[0]


@dataclass(frozen=True)
class Unseen:
    """A body without rows that forces move: constants of the law are its state at the first row.

    Attributes
    ----------
    places, speeds : tuple of str
        Names of the coordinates of its place and its velocity.
    strength : mapping of str to Unit
        Of the constants that are properties of the body.
    """

    entity: str
    places: tuple[str, ...]
    speeds: tuple[str, ...]
    strength: Mapping = field(default_factory=dict)

    @property
    def names(self):
        return (*self.places, *self.speeds)

    @property
    def units(self):
        """Units of its constants by name."""
        own = {**dict.fromkeys(self.places, METRE), **dict.fromkeys(self.speeds, SPEED)}
        return {**own, **self.strength}


@dataclass(frozen=True, repr=False)
class ForceLaw:
    """A sum of terms with the values of their constants.

    Attributes
    ----------
    constants : mapping of str to float, or to a mapping of entity name to float
        Every constant that the terms name. A mapping means one value per receiver, or, if the name
        ends in ``[scene]``, per scene. Who is not in it has none; of indexed names the mean.
    frame : tuple of Part
        Through what bodies are seen, and which of their properties are fitted; fits to tracks
        alone know of it (`bsp_gp.physics.engine.seen`, `bsp_gp.physics.engine.owners`).
    unseen : tuple of Unseen
        Bodies whose first states are constants (`bsp_gp.fitting.unseen`).
    up : str or None
        Axis that points up in the data of which a fit or a report has the law, for `simulate`.
    """

    terms: tuple[Term, ...] = ()
    constants: Mapping = field(default_factory=dict)
    frame: tuple = ()
    unseen: tuple[Unseen, ...] = ()
    up: str | None = field(default=None, compare=False)

    def __post_init__(self):
        object.__setattr__(self, "terms", tuple(self.terms))
        constants = {
            name: MappingProxyType(dict(value)) if isinstance(value, Mapping) else float(value)
            for name, value in self.constants.items()
        }
        object.__setattr__(self, "constants", MappingProxyType(constants))

    def __reduce__(self):
        plain = {
            name: dict(value) if isinstance(value, Mapping) else value
            for name, value in self.constants.items()
        }
        return (ForceLaw, (self.terms, plain, self.frame, self.unseen, self.up))

    @property
    def names(self):
        """Names of the free constants, in order of appearance, those of no term first."""
        seen = [name for part in (*self.frame, *self.unseen) for name in part.names]
        return tuple(dict.fromkeys(seen + [n for t in self.terms for n in t.formula.constants]))

    def with_constants(self, constants):
        """The same law with (some) constants changed."""
        return replace(self, constants={**self.constants, **constants})

    def with_values(self, parameters, values):
        """The law with constants given as (name, entity) pairs; entity "" = one for all."""
        constants = {}
        for (name, entity), value in zip(parameters, values, strict=True):
            if entity:
                constants.setdefault(name, dict(self.constants[name]))[entity] = float(value)
            else:
                constants[name] = float(value)
        return self.with_constants(constants)

    def plus(self, term, constants=None):
        """The law with one more term."""
        return replace(self.with_constants(constants or {}), terms=(*self.terms, term))

    def without(self, index):
        """The law without its term number `index`; constants that nothing names are dropped."""
        terms = self.terms[:index] + self.terms[index + 1 :]
        law = ForceLaw(terms, {}, self.frame, self.unseen)
        return law.with_constants({n: self.constants[n] for n in law.names if n in self.constants})

    def values(self, bodies):
        """Constants ready for evaluation in these scenes, by kind of term.

        Returns
        -------
        dict of str to dict
            ``{"field": {...}, "pair": {...}}``; per-entity constants become arrays (S, R) for
            field laws and (S, R, 1) for pair laws.
        """
        out = {"field": {}, "pair": {}}
        for name, value in self.constants.items():
            if isinstance(value, Mapping):
                scenes = bodies.scenes or ("",) * bodies.n_scenes
                array = np.array([
                    [entry(name, value, n, scene) for n in names]
                    for scene, names in zip(scenes, bodies.receiver_names, strict=True)
                ])  # fmt: skip
                out["field"][name], out["pair"][name] = array, array[..., None]
            else:
                out["field"][name] = out["pair"][name] = value
        return out

    def acceleration(self, bodies, positions, velocities, times, values=None):
        """Acceleration of every receiver.

        Parameters
        ----------
        positions, velocities : ndarray, shape (..., S, N, d), m and m/s
            Or of one scene, (..., 1, N, d), with which all scenes of `bodies` are evaluated.
        times : ndarray, shape (..., S) or (..., 1), s
        values : dict, optional
            Constants as `values` gives them, changed by the caller (a leading axis for many
            values at once).

        Returns
        -------
        ndarray, shape (..., S, R, d), m/s^2
        """
        return PreparedLaw(self, bodies, values).acceleration(positions, velocities, times)

    @property
    def constant_units(self):
        """Units of the constants of its terms, by name."""
        return {name: unit for term in self.terms for name, unit in constant_units(term).items()}

    @property
    def shared(self):
        """Constants with one value, by name."""
        return {k: v for k, v in self.constants.items() if not isinstance(v, Mapping)}

    def is_per_entity(self, term):
        """Whether a constant of the term has one value per receiver."""
        return any(
            isinstance(self.constants.get(n), Mapping) and not n.endswith("[scene]")
            for n in term.formula.constants
        )

    def __repr__(self):
        shared = self.shared
        own = [k for k in self.constants if k not in shared]
        lines = [f"ForceLaw: F_i = {self.text(digits=False)}"]
        lines += [f"  {', '.join(f'{k} = {v:.4g}' for k, v in shared.items())}"] if shared else []
        lines += [f"  one for every body or scene: {', '.join(own)}"] if own else []
        return "\n".join(lines)

    def _repr_html_(self):
        """The law for a notebook, which typesets it."""
        return f"<div>$${escape(self.latex(digits=False))}$$</div><pre>{escape(repr(self))}</pre>"

    def simulate(self, scene, states=None, times=None, *, up=None, substeps=16):
        """Motion under the law from any start, a Scene.

        Parameters
        ----------
        scene : Scene
            Its bodies; those that do not move keep their places.
        states : mapping of str to (position, velocity), optional
            Of the moving bodies, metres and metres/second; by default those with which the scene
            is known to begin, or those at the first rows.
        times : sequence of float, optional
            Seconds; by default those of the scene.
        up : str, optional
            Axis that points up, where the law needs it; by default that of the law.
        substeps : int
            Steps from one time to the next.
        """
        return simulated_scene(self, scene, states, times, up=up or self.up, substeps=substeps)

    predict = simulate

    def text(self, digits=True, units=None):
        """The law as text; with `digits`, constants are written as numbers."""
        values = self.shared if digits else {}
        parts = [to_text(t.formula, values, units or {}) for t in self.terms]
        parts = [re.sub(r"^--(?=\d)", "", part) for part in parts]  # minus a negative constant
        total = " + ".join(parts).replace("+ -", "- ") if parts else "0"
        total = _as_torques(total)
        held = (p for p in self.frame if p.kind in HOLDING)
        return ", ".join([total, *(p.describe() for p in held)])

    def latex(self, digits=True, units=None):
        values, parts = self.shared if digits else {}, []
        for term in self.terms:
            body = to_latex(term.formula, values, units or {})
            body = re.sub(r"^--(?=\d)", "", body)
            if term.kind == "pair":  # the sign stands before the sum
                sign, body = ("- ", body[1:].lstrip()) if body.startswith("-") else ("", body)
                body = rf"{sign}\sum_{{j\ne i}} {body}"
            parts.append(body)
        total = re.sub(r" \+ - ?", " - ", " + ".join(parts)) if parts else r"\mathbf{0}"
        return rf"\mathbf{{F}}_i = {total}"


def key_of(key, table):
    """What a scene or body is called in a table: simulated copies are what they are copies of.

    A body of all scenes, whichever these are, stands there with "" for a scene.
    """
    if key in table:
        return key
    if isinstance(key, tuple):
        own, of_all = (key[0].partition(COPY)[0], *key[1:]), ("", *key[1:])
        return of_all if own not in table and of_all in table else own
    return key.partition(COPY)[0]


def entry(name, table, body, scene):
    """The value of a constant that bodies or scenes have of their own."""
    if not name.endswith("]"):
        return table.get(body, np.nan)
    key = key_of(scene if name.endswith("[scene]") else body, table)
    return table[key] if key in table else float(np.mean(list(table.values())))


def tabled(law, scenes):
    """The law with entries of indexed constants for the bodies of some scenes, nan if not known."""
    keys = {
        "[scene]": [scene.name for scene in scenes],
        "[body]": dict.fromkeys(s.names[k] for s in scenes for k in s.dynamic),
    }
    tables = {}
    for name in ForceLaw(law.terms).names:
        for index, mine in keys.items():
            if name.endswith(index):
                old = law.constants.get(name)
                old = old if isinstance(old, Mapping) else {}
                tables[name] = {key: old.get(key, np.nan) for key in mine}
    return law.with_constants(tables)


def term_gradient(law, term, bodies, positions, velocities, times):
    """Acceleration of a term (..., S, R, d), and its exact derivatives by its scalar constants."""
    lookup = law_inputs(term.kind, under(law, bodies), positions, velocities, times)
    shape = (*positions.shape[:-2], len(bodies.receivers), bodies.n_dims)
    names = term.formula.constants
    value, gradient = evaluate_with_gradient(
        term.acceleration_formula, lookup, law.values(bodies)[term.kind], names
    )
    settling = Settling(term, bodies, law.is_per_entity(term))
    return settling(value, shape), {
        name: settling(slope, shape)
        for name, slope in gradient.items()
        if slope is not None
    }


def fresh_name(law, stem="c"):
    """A constant name that the law does not use."""
    return fresh_names(law, (stem,), stem)[stem]


def numbered(stem, taken):
    """The first of stem1, stem2, ... that is not taken."""
    return next(name for k in count(1) if (name := f"{stem}{k}") not in taken)


def fresh_names(law, names, stem=None):
    """New names for constants that the law does not use: their own or a stem, with numbers."""
    taken, out = {name.partition("[")[0] for name in law.names}, {}
    for name in names:
        own = name.rstrip("0123456789") if stem is None else stem
        out[name] = numbered(own, taken)
        taken.add(out[name])
    return out


def split_linear(formula):
    """The linear constant of a product, the one factor that occurs nowhere else, and the rest.

    The name is None if there is not exactly one.
    """
    return formula.once(_split)


def _split(formula):
    above, below = factors(formula)
    free = [k for k, f in enumerate(above) if isinstance(f, Constant)]
    for k in free:
        rest = above[:k] + above[k + 1 :]
        if all(above[k].name not in f.constants for f in rest + below):
            return above[k].name, quotient(rest, below)
    return None, formula


def constant_units(term):
    """Units of constants of a term: of what is added to a quantity, and of its linear constant.

    The linear constant turns the rest into a force; it is left out if the rest has other constants
    with open units.
    """
    units = _summand_units(term.formula) | added_units(term.formula) | _scale_units(term.formula)
    name, rest = split_linear(term.formula)
    if name is None:
        return units
    if rest.type.unit is None:
        rest = _with_units(rest, units)
    if rest.type.unit is None:
        return units
    return {**units, name: FORCE / rest.type.unit if isinstance(rest.type.unit, Unit) else FORCE}


def _summand_units(formula):
    """Units of constants that turn a summand of a force into what the others are, by name.

    Omega of ``m * (Omega^2 * (p - o) - 2 * Omega * perp(v))``.
    """
    above, below = factors(formula)
    sums = [f for f in above if isinstance(f, Call) and f.operator in ("add", "sub")]
    if len(sums) != 1:
        return {}
    others = quotient([f for f in above if f is not sums[0]], below).type.unit
    units = {}
    for part in summands(sums[0]) if isinstance(others, Unit) else ():
        up, down = factors(part)
        own = [f for f in up if isinstance(f, Constant)]
        up = [f for f in up if not isinstance(f, Constant)]
        turned = [f for f in up if isinstance(f, Call) and f.operator == "cross"]
        if len(turned) == 1 and not own:  # by a spin with constants as components
            spin, other = turned[0].args
            own = [f for f in map(_coordinate, summands(spin)) if isinstance(f, Constant)]
            up = [other if f is turned[0] else f for f in up]
        elif len(own) > 1:
            continue
        rest = quotient(up, down).type.unit
        if isinstance(rest, Unit):
            units |= dict.fromkeys((f.name for f in own), FORCE / others / rest)
    return units


def added_units(formula):
    """Units of constants that are added to a quantity, by name."""
    units = {}
    for node in walk(formula):
        if isinstance(node, Call) and node.operator in ("add", "sub"):
            for one, other in (node.args, node.args[::-1]):
                if not isinstance(other.type.unit, Unit):
                    continue
                for part in summands(one):  # those of X * e_x + Y * e_y
                    unit, part = other.type.unit, _coordinate(part)
                    if _is_square(part):  # L of r^2 + L^2
                        unit, part = unit ** Fraction(1, 2), part.args[0]
                    if isinstance(part, Constant):
                        units[part.name] = unit
    return units


def _is_square(formula):
    if not isinstance(formula, Call):
        return False
    is_second = formula.operator == "pow" and to_text(formula.args[1]) == "2"
    return is_second or formula.operator == "square"


def _scale_units(formula):
    """Units of constants that make a quantity a pure number: L of ``exp(-x / L)``, by name."""
    units = {}
    for node in walk(formula):
        if not isinstance(node, Call):
            continue
        if node.operator in PURE:
            units |= _scales(node.args[0])
        if node.operator in ("add", "sub"):
            for one, other in (node.args, node.args[::-1]):
                if isinstance(one, Number) and one.type.unit == Unit.of():
                    units |= _scales(other)
    return units


def _scales(formula):
    """Units of the constants by which an argument is a pure number, by name."""
    if not isinstance(formula, Call):
        return {}
    if formula.operator in ("neg", "abs", "square", "sqrt", "inverse", "pow"):
        return _scales(formula.args[0])
    if formula.operator in ("add", "sub"):  # less a phase
        return {**_scales(formula.args[0]), **_scales(formula.args[1])}
    if formula.operator not in ("div", "mul"):
        return {}
    (one, other), is_ratio = formula.args, formula.operator == "div"
    if not is_ratio and isinstance(one, Constant):
        one, other = other, one
    if not (isinstance(other, Constant) and isinstance(one.type.unit, Unit)):
        return {}
    return {other.name: one.type.unit if is_ratio else Unit.of() / one.type.unit}


def _with_units(formula, units):
    """The formula with numbers of known units in place of constants, for its own unit."""
    if isinstance(formula, Constant):
        return Number(1.0, units[formula.name]) if formula.name in units else formula
    if isinstance(formula, Call):
        return Call(formula.operator, *(_with_units(arg, units) for arg in formula.args))
    return formula


def _coordinate(formula):
    """X of ``X * e_x``, which has the unit of the place that it is added to."""
    if isinstance(formula, Call) and formula.operator == "mul":
        one, other = formula.args
        if isinstance(one, Constant) and other.type.unit == Unit.of():
            return one
    return formula


def needs_masses(law):
    """Whether a number or a constant of a law has kilograms in its unit, so that masses count.

    A law per unit mass, such as `9.81 [m/s^2] * m_i * down`, is the same for every mass.
    """
    kg = BASE.index("kg")
    units = []
    for term in law.terms:
        units += [n.type.unit for n in walk(term.formula) if isinstance(n, Number)]
    units += law.constant_units.values()
    return any(isinstance(unit, Unit) and unit.exponents[kg] for unit in units)
