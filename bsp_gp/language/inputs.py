"""The names that laws may use for what the data supply, and what each one is.

A property is ``<column>_i`` (of the receiver) or ``<column>_j`` (of the source), with the short
aliases below; positions, velocities, the contact point, lab axes and time have fixed names.
"""

from bsp_gp.language.operators import Type
from bsp_gp.units import DIMENSIONLESS, METRE, SECOND, SPEED

ALIASES = {
    "m": "mass", "mu": "friction", "q": "charge", "R": "radius", "k": "stiffness",
    "l": "rest_length",
}  # fmt: skip
"""Short name in laws -> column of entities.csv."""
SHORT = {column: alias for alias, column in ALIASES.items()}
STATE_INPUTS = {
    "p_i": Type("point", METRE), "p_j": Type("point", METRE), "p_c": Type("point", METRE),
    "origin": Type("point", METRE), "v_i": Type("vector", SPEED), "v_j": Type("vector", SPEED),
    "s_i": Type("shape"), "s_j": Type("shape"), "e_x": Type("vector"), "e_y": Type("vector"),
    "e_z": Type("vector"), "up": Type("vector"), "down": Type("vector"),
    "t": Type("scalar", SECOND),
}  # fmt: skip
"""Inputs that are no properties; `up` and `down` need a declared axis."""
DIRECTIONS = ("e_x", "e_y", "e_z", "up", "down")


def property_of(name):
    """Column and role of a property input: ``"m_j"`` -> ``("mass", "j")``; None if it is none."""
    stem, _, role = name.rpartition("_")
    if role not in ("i", "j") or not stem or name in STATE_INPUTS:
        return None
    return ALIASES.get(stem, stem), role


def input_types(property_units, *, vectors=(), n_dims=2, up=None, has_contact=True):
    """Types of every input that a data set supplies.

    Parameters
    ----------
    property_units : mapping of str to Unit
        Column -> unit.
    vectors : collection of str
        Columns that are vectors (``spin``).
    n_dims : int
        2 or 3; in 2-D there is no ``e_z``.
    up : str or None
        Declared vertical axis; without one ``up`` and ``down`` do not exist.
    has_contact : bool
        Whether contact points exist (some entity has an extent).
    """
    types = dict(STATE_INPUTS)
    if n_dims == 2:
        del types["e_z"]
    if up is None:
        del types["up"], types["down"]
    if not has_contact:
        del types["p_c"]
    for column, unit in property_units.items():
        type_ = Type("vector" if column in vectors else "scalar", unit or DIMENSIONLESS)
        for stem in {column, SHORT.get(column, column)}:
            for role in ("i", "j"):
                if f"{stem}_{role}" not in STATE_INPUTS:  # a position stays a position
                    types[f"{stem}_{role}"] = type_
    return types
