"""A hypothesis is a machine that makes recordings: world + instrument + noise (LOOP §1)."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from bsp_gp.errors import LawError
from bsp_gp.fitting.frames import expanded
from bsp_gp.fitting.noise_model import NoiseModel
from bsp_gp.language.bare import bare_number, with_bare_unit
from bsp_gp.language.formula import Call, Constant, Input, Number, substitute
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.radian import RADIAN
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import FRAMING, ForceLaw, Term, tabled
from bsp_gp.units import ACCELERATION, FORCE, Unit

NOTHING = "nothing"
"""What is declared where bodies move on as they are."""


@dataclass(frozen=True)
class Parameter:
    """A number of a part that is fitted.

    Attributes
    ----------
    entity : str
        The body that it belongs to; "" = one for all.
    unit : Unit or None
        None where it cannot be said.
    low, high : float
        Bounds, SI.
    start : float
        Where a fit begins, SI; nan = found from the data.
    prior : tuple of float, Prior or None
        Centre and scale of where it is likely (Cauchy), or a distribution as those of
        `bsp_gp.inference.priors`; None: by what it does in the law.
    """

    name: str
    entity: str = ""
    unit: object = None
    low: float = -math.inf
    high: float = math.inf
    start: float = math.nan
    prior: object = None

    @property
    def pull(self):
        """Mean and width of the normal that its prior is within its bounds; inf = it is flat."""
        if not hasattr(self.prior, "pull") or self.prior.is_logarithmic:
            return 0.0, math.inf
        return self.prior.pull

    def width(self, value):
        """Standard deviation of its prior, for a logarithmic one in terms of a value; or inf."""
        if not hasattr(self.prior, "spread"):
            return math.inf
        return self.prior.spread * (abs(value) if self.prior.is_logarithmic else 1.0)


@dataclass(frozen=True)
class Part:
    """One part of a hypothesis.

    A part says what kind it is ("world", "instrument" or "noise"), which parameters it has, and
    describes itself.
    """

    kind = ""
    is_coupling = False
    """Whether it passes forces between bodies that forces move."""
    log_density = 0.0
    """Of what it leaves unexplained of the rows, nats."""

    @property
    def parameters(self):
        """What of it is fitted, tuple of Parameter."""
        return ()

    def seen(self, dataset):
        """The rows as the rest of the hypothesis has to explain them."""
        return dataset

    def followed(self, groups):
        """The chains as the rest of the hypothesis has to follow them, tuple of Chains."""
        return groups

    def describe(self):
        raise NotImplementedError


class Numbered(Part):
    """A part with a field `numbers`, the tuple of Parameter that is fitted of it."""

    @property
    def names(self):
        return tuple(p.name for p in self.numbers)

    @property
    def parameters(self):
        return self.numbers

    def at(self, values):
        """The part at other values, mapping of name to number."""
        numbers = (replace(p, start=float(values[p.name])) for p in self.numbers)
        return replace(self, numbers=tuple(numbers))


class Valued(Part):
    """A part with a field `values`, where a fit of the numbers `names` begins."""

    def at(self, values):
        """The part at other values, mapping of name to number."""
        return replace(self, values=tuple(float(values[name]) for name in self.names))


@dataclass(frozen=True)
class Forces(Part):
    """Forces that add up.

    Attributes
    ----------
    paper_steps : bool or None
        Whether the motion was made by the paper's symplectic Euler steps from row to row. None:
        on exact data both are tried, else the motion is continuous.
    """

    law: ForceLaw
    paper_steps: bool | None = None
    kind = "world"
    is_one_cause = False
    """Whether its terms stand and fall together."""

    @property
    def parameters(self):
        units = self.law.constant_units
        held = {p.name: p for part in self.law.frame for p in part.parameters}
        at = {name: self.law.constants.get(name, math.nan) for name in held}
        out = [p if math.isnan(at[p.name]) else replace(p, start=at[p.name]) for p in held.values()]
        for name in self.law.names:
            if name in held:
                continue
            value = self.law.constants.get(name, math.nan)
            table = value if hasattr(value, "items") else {"": math.nan}
            out += [Parameter(name, k, units.get(name), start=v) for k, v in table.items()]
        return tuple(out)

    def describe(self):
        return f"F_i = {self.law.text(digits=False)}"


@dataclass(frozen=True)
class Positions(Part):
    """The instrument shows where bodies are."""

    kind = "instrument"

    def describe(self):
        return "positions are measured"


@dataclass(frozen=True)
class TrackNoise(Part):
    """Errors of positions.

    Attributes
    ----------
    model : NoiseModel
        What is known of them; the rest is estimated under the hypothesis.
    is_given : bool
        Whether the noise has the parts of the model and no others; their sizes are estimated.
    is_all : bool
        Whether all that the laws leave is noise: it is then told from that alone, and not beside
        forces that know no physics, unless these take off more than that noise lets expect.
    """

    model: NoiseModel
    is_given: bool = False
    is_all: bool = False
    kind = "noise"

    @property
    def parameters(self):
        return tuple(p for p in self.model.parameters if p.is_free)

    def describe(self):
        return self.model.describe()


@dataclass(frozen=True)
class Hypothesis:
    """Parts that together make recordings; hypotheses add up part by part."""

    parts: tuple[Part, ...] = field(default=())

    @classmethod
    def from_laws(cls, dataset, laws, *, noise=None, paper_steps=None):
        """Forces seen as positions with the noise that the data set declares.

        Parameters
        ----------
        laws : ForceLaw or sequence of str
            Constants of a ForceLaw are where a fit begins; texts are one force each, as for
            ``--law``.
        paper_steps : bool, optional
            See `Forces`.

        Raises
        ------
        LawError
            If a text is no force.
        """
        law = laws if isinstance(laws, ForceLaw) else read_law(dataset, laws)
        law = tabled(law, dataset.scenes)
        model = noise if noise is not None else NoiseModel.of(dataset)
        return cls((Forces(law, paper_steps), Positions(), TrackNoise(model)))

    def __add__(self, other):
        """Both together; a later part of noise replaces an earlier one."""
        more = other.parts if isinstance(other, Hypothesis) else (other,)
        kept = self.parts
        if any(part.kind == "noise" for part in more):
            kept = tuple(part for part in kept if part.kind != "noise")
        return Hypothesis((*kept, *more))

    @property
    def law(self):
        """All forces in one law, and through what they are seen."""
        terms, constants, frame, unseen = [], {}, [], []
        for part in self.parts:
            if isinstance(part, Forces):
                terms += part.law.terms
                constants.update(part.law.constants)
                frame += part.law.frame
                unseen += part.law.unseen
            elif part.kind in FRAMING or part.kind != "noise" and part.parameters:
                constants.update({p.name: p.start for p in part.parameters})
                frame.append(part)
        return ForceLaw(tuple(terms), constants, tuple(frame), tuple(unseen))

    @property
    def paper_steps(self):
        """See `Forces`; the first part that says it."""
        said = [p.paper_steps for p in self.parts if isinstance(p, Forces)]
        return next((s for s in said if s is not None), None)

    @property
    def noise(self):
        return next(part.model for part in self.parts if isinstance(part, TrackNoise))

    @property
    def has_given_noise(self):
        """Whether the parts of the noise are given."""
        return any(part.is_given for part in self.parts if isinstance(part, TrackNoise))

    @property
    def leaves_noise(self):
        """Whether all that its laws leave is noise."""
        return any(part.is_all for part in self.parts if isinstance(part, TrackNoise))

    @property
    def parameters(self):
        """Everything that is fitted and is no noise, tuple of Parameter.

        A constant that several parts share is one.
        """
        found: dict = {}
        for part in self.parts:
            for p in part.parameters if part.kind != "noise" else ():
                found.setdefault((p.name, p.entity), p)
        return tuple(found.values())

    def followed(self, groups):
        """The chains as its laws have to follow them, tuple of Chains."""
        for part in self.parts:
            groups = part.followed(groups)
        return groups

    @property
    def log_density(self):
        """Of all that its parts leave unexplained of the rows, nats."""
        return sum(part.log_density for part in self.parts)

    def own(self, values):
        """Those of some values, bounds or starts by name that belong to its parameters."""
        names = {p.name for p in self.parameters}
        return {name: value for name, value in (values or {}).items() if name in names}

    def seen(self, dataset):
        """The rows with all edits of the parts, one after the other."""
        for part in self.parts:
            dataset = part.seen(dataset)
        return dataset

    def describe(self):
        return "\n".join(part.describe() for part in self.parts)


def read_law(dataset, texts: Sequence[str]):
    """Read typed laws; LawError names the text that is wrong.

    Terms are declared; constants are nan until they are fitted.

    Parameters
    ----------
    texts : str or sequence of str
        One force each, e.g. ``"9.81 [m/s^2] * m_i * down"``, or a constraint, an equation such as
        ``"norm(p_i - (0, 1.2)) = L"``, or a string, ``"norm(p_i - (0, 1.2)) <= L"``. Named
        constants are fitted. ``"nothing"`` is no force: uniform motion.
    """
    # Parts themselves:
    from bsp_gp.fitting.parts.constraints import is_string, read_constraint, read_string
    from bsp_gp.fitting.parts.linkage import is_linkage, read_linkage
    from bsp_gp.fitting.parts.walls import is_wall, read_wall

    types = dataset_types(dataset)
    is_angle, terms, frame = dataset.units.is_angle, [], []
    begun: dict = {}
    texts = [texts] if isinstance(texts, str) else list(texts)
    forces = []
    for text in texts:
        if is_wall(text):
            frame.append(read_wall(dataset, text))
        elif is_linkage(text):
            frame.append(read_linkage(dataset, text))
        elif is_string(text):
            term, known = read_string(dataset, text)
            terms.append(term)
            begun |= known
        elif "=" in text:
            frame.append(read_constraint(dataset, text))
        else:
            forces.append(text)
    if NOTHING in (told := [text.strip().lower() for text in forces]):
        if len(told) > 1:
            raise LawError(f"{NOTHING!r} means that no force is declared: leave out the others")
        forces = []
    for text in forces:
        text = expanded(text, dataset.n_dims)
        formula = read_torque(text, types, dataset.units) if is_angle else None
        formula = formula or _read_force(text, types, dataset)
        terms.append(Term(formula, is_declared=True))
    law = ForceLaw(tuple(terms), {}, tuple(frame))
    begun = {name: begun.get(name, math.nan) for name in law.names}
    return tabled(law.with_constants(begun), dataset.scenes)


def _read_force(text, types, dataset):
    """A force, or an acceleration, which is one for each unit of mass.

    A number without a unit has that which the law needs, if the data are in SI: there is no other.
    """
    formula = parse_formula(text, types, units=dataset.units)
    unit = formula.type.unit
    if unit is None or unit == FORCE:
        return formula
    mass = Input("m_i", types["m_i"])
    if unit == ACCELERATION:
        return Call("mul", mass, formula)
    has_mass = "mass" in dataset.property_names
    needed = (FORCE if has_mass or unit.exponents[0] else ACCELERATION) / unit
    number = bare_number(formula, unit)
    if number is None or not dataset.units.is_si:
        as_in = "9.81 [m/s^2]" if number is None else f"{number.text} [{needed}]"
        raise LawError(
            f"law {text!r} has the unit {unit}, but a force has {FORCE}; "
            f"give its number a unit, as in {as_in}"
        )
    formula = with_bare_unit(formula, number, needed)
    return formula if formula.type.unit == FORCE else Call("mul", mass, formula)


def read_torque(text, types, units):
    """A law of an angle: ``theta_i`` and ``omega_i`` are it and its rate, and scalars are torques.

    Those of another arm are ``theta_j`` and ``omega_j``; ``abs(omega_i)`` is the size of a rate.
    The column of an angle is often called x: ``x_i`` is ``theta_i``, and so is ``theta`` alone.

    What stands for a mass is the moment of inertia.
    """
    units_of = {
        Constant("radian"): RADIAN, Constant("hertz"): Number(1.0, Unit.of(s=-1), "1 [1/s]")
    }  # fmt: skip
    text = re.sub(r"\bsign\(([^()]*\bomega_[ij][^()]*)\)", r"sign((\1) / hertz)", text)
    text = re.sub(r"\btheta\b", "theta_i", re.sub(r"\bx_([ij])\b", r"theta_\1", text))
    size = r"\b(?:abs|norm)\(([^()]*\b(?:omega|theta)_[ij][^()]*)\)"
    text = re.sub(size, r"norm((\1) * e_x)", text)
    for name, shown in (("theta", "(p_{} - origin)"), ("omega", "v_{}")):
        for role in "ij":
            place = f"(dot({shown.format(role)}, e_x) / radian)"
            text = re.sub(rf"\b{name}_{role}\b", place, text)
    types = {**types, "origin": STATE_INPUTS["origin"]}
    formula = substitute(parse_formula(text, types, units=units), units_of)
    if formula.type.shape == "scalar":
        formula = Call("mul", formula, Call("mul", RADIAN, Input("e_x", types["e_x"])))
    return formula


def declared_law(dataset, texts: Sequence[str]):
    """Read typed laws, see `read_law`, with constants at 1 until they are fitted."""
    law = read_law(dataset, texts)
    return law.with_constants({
        name: dict.fromkeys(value, 1.0) if hasattr(value, "items") else 1.0
        for name, value in law.constants.items()
    })  # fmt: skip
