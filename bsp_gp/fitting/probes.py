"""Forces that know no physics, to see what of a residual is noise and what a law may yet explain.

The noise of a fit is read off the *pure error*: the residual less all that a force of a common
shape could have done to the track (along the axes, along and across the velocity, towards a point,
each constant and slowly varying in time). Otherwise what a wrong law leaves would be taken for
noise, or for noise with a memory (LOOP §5). Probes are terms like all others, so that their columns
come from the same routine.
"""

import numpy as np

from bsp_gp.language.formula import Call, Constant, Input, Number
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.operators import Type
from bsp_gp.physics.engine.lowering import ORIGIN
from bsp_gp.physics.force import Term
from bsp_gp.units import KILOGRAM, SECOND

PROBE = "probe "
"""Names of the strengths of probes begin so: no constant of a law has a blank."""
ROWS_PER_PROBE = 3.0
"""Coordinates seen that a chain must have for each column that is taken out of them."""
WAVES = (0, 1, 2)
"""Half waves over a recording by which a force varies."""


def probe_terms(groups, is_moving, is_held=False):
    """As many probes along axes (d,) that move as the shortest tracks can bear, the slowest first.

    They are forces per unit mass, each with one constant of its own.

    Parameters
    ----------
    is_held : bool
        Whether constraints hold bodies: then forces along and across a radius are too much alike.
    """
    begin = min(float(np.nanmin(c.times)) for c in groups)
    span = max(float(np.nanmax(c.times)) for c in groups) - begin
    shapes = _shapes(is_moving, is_held)
    count = int(min(_room(chains) for chains in groups) / ROWS_PER_PROBE)
    waves = WAVES[: count // len(shapes)]  # all shapes of a wave or none
    return [
        _term(f"{PROBE}{wave} {k}", shape, wave, begin, span)
        for wave in waves
        for k, shape in enumerate(shapes)
    ]


def _shapes(is_moving, is_held):
    """Vectors of the common shapes."""
    velocity = Input("v_i", STATE_INPUTS["v_i"])
    place = Input("p_i", STATE_INPUTS["p_i"])
    shapes = [velocity]
    if not is_held:
        shapes.append(Call("sub", place, Input(ORIGIN, STATE_INPUTS["p_i"])))
    shapes += [
        Input(f"e_{axis}", Type("vector"))
        for axis, moves in zip("xyz", is_moving, strict=False)
        if moves
    ]
    if len(is_moving) == 2 and all(is_moving) and not is_held:
        shapes.append(Call("perp", velocity))
    return shapes


def _term(name, shape, wave, begin, span):
    strength = Call("mul", Constant(name), Input("m_i", Type("scalar", KILOGRAM)))
    if wave:
        late = Call("sub", Input("t", STATE_INPUTS["t"]), Number(begin, SECOND))
        angle = Call("mul", Number(np.pi * wave / span, SECOND**-1), late)
        strength = Call("mul", strength, Call("cos", angle))
    return Term(Call("mul", strength, shape), "field")


def _room(chains):
    """Coordinates seen in the poorest chain beyond its initial state."""
    seen = np.isfinite(chains.observed).sum(axis=(0, 2, 3))
    return float(seen.min() - 2 * chains.n_moving * chains.n_dims)
