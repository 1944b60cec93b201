"""Kin of declared terms: a spring that stiffens, a pull to a centre that falls faster.

A grammar knows distances of bodies, speeds and axes. Which rest length or which centre a user has
in mind only the declared law says.
"""

from __future__ import annotations

from bsp_gp.language.formula import Call, Constant, Number, factors, product
from bsp_gp.language.inputs import property_of
from bsp_gp.loop.proposers.exponents import base_of, is_size
from bsp_gp.physics.force import fresh_name, split_linear

__all__ = ["kin_of"]

FURTHER = (2, 3)
"""Powers of what a declared term is linear in, beside its own."""
ABOUT_CENTRES = (-4, -3, -2, -1, 0, 1, 2, 3)
"""Powers of the distance to a declared centre."""


def kin_of(law):
    """Laws like the declared terms, to other powers.

    Parameters
    ----------
    law : ForceLaw

    Yields
    ------
    Formula
        With a constant in front; further constants are those of the declared terms.
    """
    name, found = fresh_name(law), {}
    for term in law.terms:
        if term.is_declared:
            _, rest = split_linear(term.formula)
            found |= dict.fromkeys([*_steeper(rest), *_about(rest)])
    for formula in found:
        yield Call("mul", Constant(name), formula)


def _steeper(rest):
    """A term that is linear in a stretch, or another signed size, to higher powers of that."""
    above, below = factors(rest)
    for k, part in enumerate(above):
        if not (_moves(part) and base_of(part) is part and not is_size(part)):
            continue
        for power in FURTHER:
            steep = Call("pow", part, Number(float(power)))
            steep = steep if power % 2 else Call("mul", Call("abs", part), part)
            top = product([steep, *above[:k], *above[k + 1 :]])
            yield Call("div", top, product(below)) if below else top


def _about(rest):
    """Forces to or from a centre that a term names, to other powers of the distance."""
    above, below = factors(rest)
    centred = [v for part in above + below for v in _ways(part)]
    if not centred:
        return
    way = centred[0]
    own = [p for p in above if _is_property(p)]
    for power in ABOUT_CENTRES:
        distance = [Call("pow", Call("norm", way), Number(float(power)))] if power else []
        yield product([*own, *distance, Call("normalize", way)])


def _ways(part):
    """Ways from a place to the body, in a factor of a term."""
    part = base_of(part)
    if isinstance(part, Call) and part.operator in ("norm", "normalize"):
        part = part.args[0]
    is_way = part.type.shape == "vector" and "p_i" in part.inputs
    if is_way and isinstance(part, Call) and part.operator in ("sub", "add"):
        if all(name in ("p_i", "origin") or name.startswith("e_") for name in part.inputs):
            yield part


def _moves(part):
    """Whether a factor is a number that changes with the motion."""
    moves = any(not property_of(name) and name != "t" for name in part.inputs)
    return moves and part.type.shape == "scalar"


def _is_property(part):
    return bool(part.inputs) and all(map(property_of, part.inputs)) and not part.constants
