"""Kin of declared terms: a spring that stiffens, a pull to a centre that falls faster, a hoop.

A grammar knows distances of bodies, speeds and axes. Which rest length or which centre a user has
in mind only the declared law says; and that a friction is another one in another direction (the
grain of a lawn, the ribs of a carpet) is a matter of that friction.
"""

from bsp_gp.language.formula import Call, Constant, Input, Number, factors, product, quotient
from bsp_gp.language.inputs import STATE_INPUTS, property_of
from bsp_gp.loop.proposers.exponents import base_of, is_size
from bsp_gp.loop.proposers.sums import is_property
from bsp_gp.physics.force import fresh_name, split_linear

_VELOCITY = Input("v_i", STATE_INPUTS["v_i"])
_MOTION = Call("normalize", _VELOCITY)
_AXES = ("e_x", "e_y", "e_z")
_OTHERS = {"sin": "cos", "cos": "sin"}
FURTHER = (2, 3)
"""Powers of what a declared term is linear in, beside its own."""
ABOUT_CENTRES = (-4, -3, -2, -1, 0, 1, 2, 3)
"""Powers of the distance to a declared centre."""


def kin_of(law, n_dims, logged=()):
    """Laws like the declared terms, to other powers, or of another strength in some direction.

    Parameters
    ----------
    n_dims : int
    logged : sequence of Input
        Columns with which the strength of every term, declared or found, may vary.

    Yields
    ------
    Formula
        With a constant in front; further constants are those of the declared terms.
    """
    name, found = fresh_name(law), {}
    for term in law.terms:
        rest = _without_numbers(split_linear(term.formula)[1])
        if term.is_declared:
            found |= dict.fromkeys(
                [*_steeper(rest), *_about(rest), *_aside(rest, n_dims), *_turned(rest)]
            )
        found |= dict.fromkeys(_with_columns(rest, logged))
    for formula in found:
        yield Call("mul", Constant(name), formula)


def _without_numbers(rest):
    """A product without its plain numbers: its own constant is another one."""
    above, below = ([p for p in side if not isinstance(p, Number)] for side in factors(rest))
    return quotient(above, below)


def _steeper(rest):
    """A term that is linear in a stretch, or another signed size, to higher powers of that."""
    above, below = factors(rest)
    for k, part in enumerate(above):
        if not (_moves(part) and base_of(part) is part and not is_size(part)):
            continue
        for power in FURTHER:
            steep = Call("pow", part, Number(float(power)))
            steep = steep if power % 2 else Call("mul", Call("abs", part), part)
            yield quotient([steep, *above[:k], *above[k + 1 :]], below)


def _turned(rest):
    """A term in the sine of something to the cosine, the other way round, and to their product.

    A weight that hangs aslant, a hoop that is spun about its vertical axis.
    """
    above, below = factors(rest)
    for k, part in enumerate(above):
        if isinstance(part, Call) and part.operator in _OTHERS and _moves(part):
            other = Call(_OTHERS[part.operator], *part.args)
            kept = [*above[:k], *above[k + 1 :]]
            yield quotient([other, *kept], below)
            yield quotient([part, other, *kept], below)


def _with_columns(rest, logged):
    """A term in proportion to a column that was logged, to its square, and against it."""
    for column in (each for each in logged if each.name not in rest.inputs):
        for scale in (column, Call("square", column), Call("inverse", column)):
            yield Call("mul", scale, rest)


def _about(rest):
    """Forces to or from a centre that a term names, to other powers of the distance."""
    above, below = factors(rest)
    centred = [v for part in above + below for v in _ways(part)]
    if not centred:
        return
    way = centred[0]
    own = [p for p in above if is_property(p)]
    for power in ABOUT_CENTRES:
        distance = [Call("pow", Call("norm", way), Number(float(power)))] if power else []
        yield product([*own, *distance, Call("normalize", way)])


def _aside(rest, n_dims):
    """A brake of another strength in some direction of motion, or along some line."""
    above, below = factors(rest)
    if below or n_dims < 2 or not any(part in (_VELOCITY, _MOTION) for part in above):
        return
    cosines = [Call("dot", _MOTION, Input(axis, STATE_INPUTS[axis])) for axis in _AXES[:n_dims]]
    for cosine in cosines:
        yield product([cosine, rest])
    for k, cosine in enumerate(cosines[:-1]):  # all squares together are one
        yield product([cosine, cosine, rest])
        for other in cosines[k + 1 :]:
            yield product([cosine, other, rest])


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
