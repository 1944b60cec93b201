"""What a report tells, compared by code and by law and not by words."""

from bsp_gp.language.canonical import canonical_key
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types


def is_law(effect, text, data):
    """Whether an effect is this law, however it is written."""
    if effect is None or effect.formula is None:
        return False
    law = parse_formula(text, dataset_types(data), units=data.units)
    one, other = (canonical_key(each, data.n_dims) for each in (effect.formula, law))
    return one == other


def adopted(report):
    """Effects of the rounds that adopted one."""
    return [r.effect for r in report.rounds if r.adopted]


def within(constant, value, n=4):
    """Whether an estimate is within so many standard errors."""
    return abs(constant.value - value) < n * (constant.high - constant.low) / 2 / 1.645
