"""A source that no track shows, with the pull of known laws.

It is at rest, moves straight on, or is a body that the law moves like the others.
"""

from dataclasses import dataclass, field, replace
from functools import partial, reduce
from typing import NamedTuple

import numpy as np

from bsp_gp.data.scene import Entity
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.unseen import MARK, with_entity
from bsp_gp.language.formula import Call, Constant, Input, Number, substitute, walk
from bsp_gp.language.inputs import STATE_INPUTS, property_of
from bsp_gp.language.operators import Type
from bsp_gp.physics.force import Term
from bsp_gp.units import DIMENSIONLESS, SECOND

HELD = 4.0
"""Width of the normal that holds a place or a speed, in the scale of its prior."""
P_I, P_J, V_I, V_J, ORIGIN = (
    Input(name, STATE_INPUTS[name]) for name in ("p_i", "p_j", "v_i", "v_j", "origin")
)


class Anywhere(NamedTuple):
    """The Cauchy prior of what may be far away, in which a descent is held by a wide normal.

    Far sources show by their tide alone, strength over distance cubed: without it they would run
    away along that valley for ever.
    """

    centre: float
    scale: float

    @property
    def is_logarithmic(self):
        """It is one of numbers, as `Parameter.pull` asks."""
        return False

    @property
    def pull(self):
        """Mean and width of that normal, which does nothing where data decide."""
        return self.centre, HELD * self.scale


@dataclass(frozen=True)
class HiddenSource(Forces):
    """Forces of an unseen source.

    Attributes
    ----------
    places, speeds : tuple of str
        Names of its coordinates, and of the components of its velocity (none: at rest).
    middle : tuple of float, metres
    size, speed : float
        Extent of the data and typical speed: what is far, and fast.
    between : tuple of Term
        Forces between visible bodies by which it acts.
    epoch : float, s
        When it is at its place.
    """

    places: tuple = ()
    speeds: tuple = ()
    middle: tuple = ()
    size: float = 1.0
    speed: float = 1.0
    strength: str = ""
    between: tuple = ()
    epoch: float = 0.0
    is_one_cause = True

    @property
    def motion(self):
        """How it moves: "at rest" or "moving"."""
        return "moving" if self.speeds else "at rest"

    def track(self, fit, times):
        """Where a fit has it at the rows of a scene, (T, d)."""
        states = np.array([[fit.law.constants[n] for n in (*self.places, *self.speeds)]])
        place, speed = np.split(states, [len(self.places)], axis=1)
        return place + (times[:, None] - self.epoch) * (speed if self.speeds else 0.0)

    @property
    def column(self):
        """The property by which it acts; "" where it has a strength of its own."""
        return unit_pull(self.between[0], self.strength)[1]

    def unit(self, dataset):
        """Unit of its strength in a data set."""
        return dataset.property_units.get(self.column, DIMENSIONLESS)

    @property
    def parameters(self):
        """Strength, place and velocity; constants of the law that the pull has are not its own."""
        priors = {
            name: Anywhere(m, self.size) for name, m in zip(self.places, self.middle, strict=True)
        }
        priors |= dict.fromkeys(self.speeds, Anywhere(0.0, self.speed))
        own = {self.strength, *priors}
        return tuple(
            replace(p, prior=priors.get(p.name)) for p in super().parameters if p.name in own
        )


@dataclass(frozen=True)
class HiddenBody(HiddenSource):
    """An unseen body that the law moves with the bodies that are seen.

    Attributes
    ----------
    properties : mapping of str to float
        Of the body: the one that is its strength where the fit begins. Only a force on it that
        depends on this property of its own takes it from here.
    """

    properties: dict = field(default_factory=dict)
    motion = "under the law"

    def track(self, fit, times):
        """Where a fit has it at the rows of a scene, (T, d)."""
        (body,), (chains,), (nodes,) = self.law.unseen, fit.groups, fit.nodes
        return nodes[0, chains.bodies[0].index(body.entity), :, : len(times), 0].T

    def seen(self, dataset):
        """The rows with a body more that they do not show."""
        (body,) = self.law.unseen
        entity = Entity(body.entity, properties={**self.properties, MARK: 1.0})
        return replace(
            dataset,
            scenes=tuple(with_entity(s, entity, values={MARK: 0.0}) for s in dataset.scenes),
        )


def unit_pull(term, strength):
    """A pair term with a constant for the property of its source, and that property's column.

    Parameters
    ----------
    term : Term
        Between visible bodies.
    strength : str
        Name of the constant that stands for the one property of the source that the term names.

    Returns
    -------
    (Formula, str) or None
        "" where the constant is a factor of its own. None where the term asks for the extent or
        several properties of a source.
    """
    inputs = {node for node in walk(term.formula) if isinstance(node, Input)}
    of_source = {node for node in inputs if (property_of(node.name) or ())[1:] == ("j",)}
    if any(node.name in ("s_i", "s_j", "p_c") for node in inputs) or len(of_source) > 1:
        return None
    if any(node.type.shape != "scalar" for node in of_source):
        return None
    if not of_source:
        return Call("mul", Constant(strength), term.formula), ""
    (own,) = of_source
    return substitute(term.formula, {own: Constant(strength)}), property_of(own.name)[0]


def beside_origin(pull):
    """A pull as it is seen from a body at the origin, which the source pulls as well, a formula.

    Places in a table of a companion are those from its primary, and the frame of a primary that is
    pulled is accelerated: a companion moves by the difference. The pull has to be as heavy as its
    receiver is (gravity), since of what the primary is nothing is asked.
    """
    return Call("sub", pull, about_origin(pull)[0])


def about_origin(formula):
    """What the other body, and what the receiver itself, does to one at rest at the origin."""
    there = {P_I: ORIGIN, V_I: _still()}
    swapped = {P_J: P_I, V_J: V_I}
    for node in walk(formula):
        known = property_of(node.name) if isinstance(node, Input) else None
        if known and known[1] == "j":
            swapped[node] = Input(f"{node.name[:-2]}_i", node.type)
    return substitute(formula, there), substitute(formula, {**there, **swapped})


def pull_of(term, strength, places, speeds=(), epoch=0.0, is_relative=False):
    """A pair term as it acts from one unseen source, a field term; None if it cannot.

    Parameters
    ----------
    places, speeds : sequence of str
        Names of the coordinates at `epoch`, and of the components of the velocity.
    is_relative : bool
        Whether places are those from a body that is pulled too, see `beside_origin`.
    """
    found = unit_pull(term, strength)
    if found is None:
        return None
    place, velocity = _vector(places), _vector(speeds) if speeds else _still()
    if speeds:
        late = Call("sub", Input("t", STATE_INPUTS["t"]), Number(epoch, SECOND))
        place = Call("add", place, Call("mul", late, velocity))
    pull = beside_origin(found[0]) if is_relative else found[0]
    return Term(substitute(pull, {P_J: Call("add", ORIGIN, place), V_J: velocity}), "field")


def body_pulls(term, strength, is_declared=True, is_relative=False):
    """What an unseen body of this strength brings beyond a pair term, tuple of Term.

    Parameters
    ----------
    is_declared : bool
        Whether bodies pull each other by the term, the unseen one as if it were like the others.
    is_relative : bool
        Whether places are those from a body at rest at the origin that is pulled too: the unseen
        body then goes round both, and where no property tells how much bodies pull, only the one
        at the origin pulls it (companions are taken to be light).
    """
    pull, column = unit_pull(term, strength)
    acts, feels = (Input(f"{MARK}_{role}", Type("scalar")) for role in "ji")
    seen = pull
    if is_relative:
        # Of the body at the origin itself this would be 0/0, where it does not act.
        still = Call("mul", Call("sub", Number(1.0, DIMENSIONLESS), acts), Call("sub", P_I, ORIGIN))
        there = {P_I: ORIGIN, V_I: _still(), P_J: Call("add", P_J, still)}
        seen = Call("sub", pull, substitute(pull, there))
    pair = Call("mul", acts, Call("sub", seen, term.formula) if is_declared else seen)
    if not is_relative:
        return (Term(pair, "pair"),)
    about = {P_J: ORIGIN, V_J: _still()}
    own = Call("neg", about_origin(pull)[1])
    if is_declared and not column:
        pair = Call("sub", pair, Call("mul", feels, term.formula))
        own = Call("add", own, substitute(term.formula, about))
    return Term(pair, "pair"), Term(Call("mul", feels, own), "field")


def _vector(names):
    """The vector with these constants as coordinates."""
    parts = (
        Call("mul", Constant(name), Input(f"e_{axis}", Type("vector")))
        for name, axis in zip(names, "xyz", strict=False)
    )
    return reduce(partial(Call, "add"), parts)


def _still():
    speed = Number(0.0, STATE_INPUTS["v_j"].unit)
    return Call("mul", speed, Input("e_x", Type("vector")))
