"""A source that no track shows, at rest or moving straight on, with the pull of known laws."""

from __future__ import annotations

from dataclasses import dataclass, replace

from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.language.formula import Call, Constant, Input, Number, substitute, walk
from bsp_gp.language.inputs import STATE_INPUTS, property_of
from bsp_gp.language.operators import Type
from bsp_gp.physics.force import Term
from bsp_gp.units import Unit

__all__ = ["HiddenSource", "pull_of"]

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
    """

    places: tuple = ()
    speeds: tuple = ()
    middle: tuple = ()
    size: float = 1.0
    speed: float = 1.0

    @property
    def parameters(self):
        """Strength, place and velocity."""
        priors = {name: (m, self.size) for name, m in zip(self.places, self.middle, strict=True)}
        priors |= dict.fromkeys(self.speeds, (0.0, self.speed))
        return tuple(replace(p, prior=priors.get(p.name)) for p in super().parameters)


def pull_of(term, strength, places, speeds=(), epoch=0.0):
    """A pair term as it acts from one unseen source; None if it cannot.

    Parameters
    ----------
    term : Term
        Between visible bodies.
    strength : str
        Name of the constant that stands for the one property of the source that the term names.
    places, speeds : sequence of str
        Names of the coordinates at `epoch`, and of the components of the velocity.
    epoch : float, s

    Returns
    -------
    Term or None
        A field term. None where the term asks for the extent or several properties of a source.
    """
    inputs = {node for node in walk(term.formula) if isinstance(node, Input)}
    of_source = {node for node in inputs if _role(node.name) == "j"}
    if any(node.name in ("s_i", "s_j", "p_c") for node in inputs) or len(of_source) > 1:
        return None
    if any(node.type.shape != "scalar" for node in of_source):
        return None
    replaced = dict.fromkeys(of_source, Constant(strength))
    place, velocity = _vector(places), _vector(speeds) if speeds else _still(len(places))
    if speeds:
        late = Call("sub", Input("t", STATE_INPUTS["t"]), Number(epoch, SECOND))
        place = Call("add", place, Call("mul", late, velocity))
    origin = Input("origin", STATE_INPUTS["origin"])
    replaced[Input("p_j", STATE_INPUTS["p_j"])] = Call("add", origin, place)
    replaced[Input("v_j", STATE_INPUTS["v_j"])] = velocity
    formula = substitute(term.formula, replaced)
    if not of_source:
        formula = Call("mul", Constant(strength), formula)
    return Term(formula, "field")


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
