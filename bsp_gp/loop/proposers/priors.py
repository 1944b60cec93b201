"""What is known of laws before any data, beside what each of them costs in a grammar."""

from bsp_gp.language.formula import Call, Input, factors
from bsp_gp.language.render import to_text
from bsp_gp.physics.force import split_linear

AXES = ("e_x", "e_y", "e_z")


def cost_of(candidates):
    """Nats that laws cost together: components of one vector along axes are one cause."""
    costs: dict = {}
    for candidate in candidates:
        vector = vector_of(candidate)
        costs[vector] = max(costs.get(vector, 0.0), candidate.complexity)
    return sum(costs.values())


def vector_of(candidate):
    """Factors of a law, those that are axes of the laboratory as one."""
    above, below = factors(split_linear(candidate.formula)[1])
    words = ["" if isinstance(f, Input) and f.name in AXES else to_text(f) for f in above]
    return tuple(sorted(words)), tuple(sorted(map(to_text, below)))


def drives(formula, strength):
    """Whether a law of so much strength pushes a body on along its own velocity.

    What brakes is everywhere; what drives needs a motor, a wind or a hand.
    """
    above, _ = factors(split_linear(formula)[1])
    ways = (f.args[0] if isinstance(f, Call) and f.operator == "normalize" else f for f in above)
    return strength > 0 and any(isinstance(way, Input) and way.name == "v_i" for way in ways)
