"""A source that no track shows, with the pull of known laws.

It is at rest, moves straight on, or is a body that the law moves like the others.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.data.scene import Entity
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.unseen import MARK, with_entity
from bsp_gp.language.formula import Call, Constant, Input, Number, substitute, walk
from bsp_gp.language.inputs import STATE_INPUTS, property_of
from bsp_gp.language.operators import Type
from bsp_gp.physics.force import Term
from bsp_gp.units import DIMENSIONLESS, Unit

__all__ = ["HiddenBody", "HiddenSource", "body_pull", "pull_of", "unit_pull"]

SECOND = Unit.of(s=1)


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
    strength : str
        Name of its strength.
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
        priors = {name: (m, self.size) for name, m in zip(self.places, self.middle, strict=True)}
        priors |= dict.fromkeys(self.speeds, (0.0, self.speed))
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
    of_source = {node for node in inputs if _role(node.name) == "j"}
    if any(node.name in ("s_i", "s_j", "p_c") for node in inputs) or len(of_source) > 1:
        return None
    if any(node.type.shape != "scalar" for node in of_source):
        return None
    if not of_source:
        return Call("mul", Constant(strength), term.formula), ""
    (own,) = of_source
    return substitute(term.formula, {own: Constant(strength)}), property_of(own.name)[0]


def pull_of(term, strength, places, speeds=(), epoch=0.0):
    """A pair term as it acts from one unseen source; None if it cannot.

    Parameters
    ----------
    term, strength
        As of `unit_pull`.
    places, speeds : sequence of str
        Names of the coordinates at `epoch`, and of the components of the velocity.
    epoch : float, s

    Returns
    -------
    Term or None
        A field term.
    """
    found = unit_pull(term, strength)
    if found is None:
        return None
    place, velocity = _vector(places), _vector(speeds) if speeds else _still(len(places))
    if speeds:
        late = Call("sub", Input("t", STATE_INPUTS["t"]), Number(epoch, SECOND))
        place = Call("add", place, Call("mul", late, velocity))
    origin = Input("origin", STATE_INPUTS["origin"])
    replaced = {
        Input("p_j", STATE_INPUTS["p_j"]): Call("add", origin, place),
        Input("v_j", STATE_INPUTS["v_j"]): velocity,
    }
    return Term(substitute(found[0], replaced), "field")


def body_pull(term, strength):
    """What an unseen body of this strength pulls beyond what the term has it pull, a pair term."""
    pull, _ = unit_pull(term, strength)
    mark = Input(f"{MARK}_j", Type("scalar"))
    return Term(Call("mul", mark, Call("sub", pull, term.formula)), "pair")


def _role(name):
    known = property_of(name)
    return known[1] if known else ""


def _vector(names):
    """The vector with these constants as coordinates."""
    parts = [
        Call("mul", Constant(name), Input(f"e_{axis}", Type("vector")))
        for name, axis in zip(names, "xyz", strict=False)
    ]
    total = parts[0]
    for part in parts[1:]:
        total = Call("add", total, part)
    return total


def _still(n_dims):
    speed = Number(0.0, STATE_INPUTS["v_j"].unit)
    return Call("mul", speed, Input("e_x", Type("vector")))
