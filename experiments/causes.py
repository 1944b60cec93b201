"""What the loop tells of, compared with the truth of a made world: by codes and laws, not words."""

from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from bsp_gp.errors import BspError
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.language.formula import Call
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types, stack
from bsp_gp.physics.force import ForceLaw, Term

PERIOD = 0.5
"""Of every periodic push, s."""
SAME_FORM = 1e-5
"""Laws are of one form if their accelerations on the true motion are parallel to this part."""
LAWS = {
    "linear drag": "c * v_i", "quadratic drag": "c * norm(v_i) * v_i", "uniform wind": "c * e_x",
    "perpendicular": "c * perp(v_i)", "magnetic": "c * charge_i * perp(v_i)",
    "spring to a point": "c * (p_j - p_i)", "attraction": "c * m_i * m_j * normalize(p_j - p_i)",
    "pair force": "c * charge_i * charge_j / norm(p_i - p_j)^2 * normalize(p_i - p_j)",
    "friction on a mat": "c * is_on(s_i, p_i, s_j, p_j) * m_i * mu_j * normalize(v_i)",
    "inelastic contact": "c * along(v_i - v_j, p_i - p_j) * normalize(p_i - p_j) "
                         "* does_collide(s_i, p_i, s_j, p_j)",
    "friction": "c * m_i * normalize(v_i)",
    "tilted camera": "c * m_i * e_x", "wrong scale or clock": "c * m_i * e_y",
}  # fmt: skip
"""What may be taken for an effect, where the data have what it names."""
ADDED = ("law", "period", "contact", "collision")
"""Codes of causes whose text is the force that they add."""
CHANGED = ("exponent", "number")
"""Codes of causes whose text is the declared term with another number, or says which that is."""


@dataclass(frozen=True)
class Cause:
    """A cause that a round tells of, or what it cannot tell from it.

    Attributes
    ----------
    code : str
    text : str
    constants : dict of str to float
        Fitted ones, SI; none where nothing was fitted.
    """

    code: str
    text: str
    constants: dict = field(default_factory=dict)

    @property
    def law(self):
        """The force that it adds, or that stands in the place of a declared one; "" for others."""
        if self.text.startswith("exponent of "):
            base, _, term = self.text.removeprefix("exponent of ").partition(" in ")
            return f"({base})^n * ({term})"
        if self.text.startswith("numbers of "):
            changed = self.text.removeprefix("numbers of ").split(" and ")
            return " + ".join(f"s{k} * ({text})" for k, text in enumerate(changed))
        if self.text.startswith("number of "):
            return f"s * ({self.text.removeprefix('number of ')})"
        return self.text if self.code in (*ADDED, *CHANGED) else ""

    def __str__(self):
        return f"{self.code}: {self.text}"


def causes_of(done):
    """What a round tells of, the likeliest first; noise of another kind is no cause.

    Parameters
    ----------
    done : RoundRecord

    Returns
    -------
    list of Cause
    """
    effect = done.effect
    if effect is None or effect.code == "noise":
        return []
    codes = {row["law"]: row["code"] for row in done.hypotheses}
    known = {c.name: c.value for c in effect.constants if not c.entity}
    others = [Cause(codes.get(text, "law"), text) for text in effect.equivalents]
    return [Cause(effect.code, effect.law or effect.name, known), *others]


def is_adopted(done):
    """Whether a round has adopted something that is missing; noise of another kind is not."""
    return done.adopted and done.effect.code != "noise"


def declared_law(dataset, texts):
    """The declared laws, constants at 1."""
    law = read_law(dataset, texts)
    return law.with_constants(dict.fromkeys(law.names, 1.0))


def start_of(name, usual):
    """Where a constant begins: a frequency at the true one, from afar it would not be found."""
    return 2 * np.pi / PERIOD if name.startswith("w") else usual


class Judge:
    """Compares laws with what was undeclared, along the true motion."""

    def __init__(self, dataset, truth, declared):
        self.dataset, self.declared = dataset, declared_law(dataset, declared)
        scenes = [truth.scene(k) for k in range(len(truth.scenes))]
        moving = scenes[0].dynamic
        (self.batch,) = stack(scenes, dataset.up, "measured")
        self.true = truth.accelerations()[:, :, moving].ravel()
        self.missing = self.true - truth.accelerations(of_declared=True)[:, :, moving].ravel()

    def of_law(self, law):
        """The same for a law in the place of the truth."""
        judge = copy(self)
        judge.true = self.acceleration(law)
        judge.missing = judge.true - (self.true - self.missing)
        return judge

    def acceleration(self, law):
        """Accelerations of a law along the true motion, one vector."""
        b = self.batch
        value = law.acceleration(b.bodies, b.positions, b.velocities, b.times)
        return np.moveaxis(value, 1, 0).ravel()

    def refitted(self, law):
        """The law with the constants that come nearest to the truth; None if it is another form.

        A law has the form of the truth if with some constants it leaves next to nothing of what
        was undeclared.
        """
        parameters = _parameters(law)

        def left(values):
            return self.true - self.acceleration(law.with_values(parameters, values))

        if not parameters:
            found, size = law, np.square(left(())).sum()
        else:
            values = (law.constants[n][e] if e else law.constants[n] for n, e in parameters)
            start = np.fromiter(values, float)
            scale = np.maximum(np.abs(start), 1e-9)
            with np.errstate(all="ignore"):
                if not np.isfinite(left(start)).all():
                    return None
                fit = least_squares(left, start, method="lm", x_scale=scale)
            found, size = law.with_values(parameters, fit.x), 2 * fit.cost
        return found if size < SAME_FORM * (self.missing @ self.missing) else None

    def is_found(self, law):
        """Whether a law has the form of the truth and no term but those that it takes."""
        new = [term for term in law.terms if not term.is_declared]
        without = (replace(law, terms=tuple(t for t in law.terms if t is not term)) for term in new)
        return self.refitted(law) is not None and all(self.refitted(w) is None for w in without)

    def is_form(self, cause):
        """Whether the declared law and a cause, or its law in that one's place, is the truth.

        Of two laws at once, both must be needed.
        """
        terms, start = self.terms(cause)
        if not terms:
            return False
        alone, beside = ForceLaw(terms, start), self.declared
        for term in terms:
            beside = beside.plus(term, start)
        return any(self.is_found(law) for law in (alone, beside))

    def terms(self, cause):
        """Terms of the law of a cause and where its constants begin; none where it is no law."""
        try:
            formula = parse_formula(
                cause.law, dataset_types(self.dataset), units=self.dataset.units
            )
        except BspError:
            return (), {}
        own = set(formula.constants)
        start = {n: 0.0 if n.startswith("n") else start_of(n, 1.0) for n in own}
        start.update((n, value) for n, value in cause.constants.items() if n in own)
        return tuple(Term(part) for part in _addends(formula)), start

    def name_of(self, law):
        """The name in `LAWS` of the form of a law, or "another law"."""
        judge = self.of_law(law)
        names = (name for name, text in LAWS.items() if judge.is_form(Cause("law", text)))
        return next(names, "another law")


def _addends(formula):
    if isinstance(formula, Call) and formula.operator == "add":
        return [part for side in formula.args for part in _addends(side)]
    return [formula]


def _parameters(law):
    """Free constants of a law as (name, entity) pairs."""
    out = []
    for name in law.names:
        value = law.constants[name]
        out += [(name, entity) for entity in value] if hasattr(value, "items") else [(name, "")]
    return tuple(out)
