"""Properties of bodies that are said beside the data: ``--property mass=0.3058[kg]``."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace

from bsp_gp.data.conversion import Conversion, is_inertia
from bsp_gp.data.roster import OWN_COLUMNS, STATE_NAMES
from bsp_gp.data.scene import CHECK, PROPERTY_UNITS
from bsp_gp.errors import DataError, UnitError
from bsp_gp.units import UnitSystem, parse_unit

_VALUE = re.compile(
    r"(?:(?P<body>.+?)\s*:)?\s*(?P<number>[^:\[\]]+?)\s*(?:\[(?P<unit>[^\[\]]*)\])?"
)
LEFT_OUT = f"{CHECK}columns that are not used look like places of another body: "
"""How a note of such columns begins."""
_KINDS = {"mass": "kg", "charge": "C"}
"""Kinds of unit that are called like a property, and the one of SI."""


def read_properties(said):
    """What is said of properties, checked.

    Parameters
    ----------
    said : mapping of str to float, str or mapping, or None
        Property -> one number for all bodies, a text such as ``"0.3058"``, ``"305.8[g]"`` or
        ``"star1:1.2,star2:0.8"``, or a mapping of bodies to numbers or texts.

    Returns
    -------
    dict of str to dict
        Property -> body (None = all) -> (number, its unit or "").
    """
    out = {}
    for name, value in (said or {}).items():
        if not re.fullmatch(r"[A-Za-z_]\w*", name) or name in (*OWN_COLUMNS, *STATE_NAMES):
            raise DataError(
                f"{name!r} cannot be given as a property", column=name,
                remedy="a property is a name such as mass, charge or mu; shapes, radii and what "
                "does not move stand in entities.csv",
            )  # fmt: skip
        if isinstance(value, Mapping):
            parts = [f"{body}:{number}" for body, number in value.items()]
        else:
            parts = str(value).split(",")
        out[name] = {}
        for part in parts:
            body, number = _read(name, part)
            if body in out[name]:
                raise DataError(f"{name} of {body or 'all bodies'} is given twice", column=name)
            out[name][body] = number
    return out


def _read(name, text):
    match = _VALUE.fullmatch(text.strip())
    try:
        value = float(match["number"]) if match else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DataError(
            f"{name}={text.strip()[:60]}: expected a number", column=name,
            remedy=f'write --property {name}=0.3, {name}=300[g], or body by body '
            f'{name}="star1:1.2,star2:0.8"',
        )  # fmt: skip
    return match["body"], (value, (match["unit"] or "").strip())


def with_properties(dataset, said):
    """The data set with properties said beside it (`read_properties`), in place of its own.

    Raises
    ------
    DataError
        If there is no such body, or scene of one moving body, or a unit does not fit.
    """
    found = read_properties(said)
    if not found:
        return dataset
    bodies = list(dict.fromkeys(name for scene in dataset.scenes for name in scene.names))
    lone = {scene.name for scene in dataset.scenes if len(scene.dynamic) == 1} - set(bodies)
    values, units = {}, dict(dataset.property_units)
    declared = dict(dataset.units.declared)
    for name, of_bodies in found.items():
        for body in (b for b in of_bodies if b is not None and b not in (*bodies, *lone)):
            left_out = [n.removeprefix(CHECK) for n in dataset.notes if n.startswith(LEFT_OUT)]
            raise DataError(
                f"{name} is given for {body!r}, and there is no such body; present are "
                f"{', '.join(bodies[:20])}", column=name,
                remedy="; ".join(["correct the name", *left_out]),
            )  # fmt: skip
        own = next((unit for _, unit in of_bodies.values() if unit), "")
        if name in _KINDS and own and name not in declared:
            if name in dataset.property_names and None not in of_bodies:
                raise DataError(
                    f"{name} is given in {own!r}, and the data do not say in what unit others are",
                    column=name, remedy=f"declare it: --units {name}={own}",
                )  # fmt: skip
            declared[name] = _KINDS[name]  # so forces are told in newtons and not in g m/s^2
        values[name] = {}
        for body, (number, unit) in of_bodies.items():
            scale, units[name] = _scale(name, unit, declared, dataset.units)
            values[name][body] = number * scale
    made = {}

    def changed(entity, scene):
        owner = scene.name if scene.name in lone and not entity.is_static else None
        key = id(entity), owner if any(owner in each for each in values.values()) else None
        if key not in made:  # scenes share their bodies
            new = dict(entity.properties)
            for name, of_bodies in values.items():
                each = (of_bodies.get(told) for told in (entity.name, owner, None))
                value = next((v for v in each if v is not None), None)
                if value is not None:
                    new[name] = value
            made[key] = replace(entity, properties=new)
        return made[key]

    told = "; ".join(f"{name} = {_told(of_bodies)}" for name, of_bodies in found.items())
    return replace(
        dataset, units=UnitSystem.from_declared(declared), property_units=units,
        scenes=tuple(
            replace(s, entities=tuple(changed(e, s) for e in s.entities)) for s in dataset.scenes
        ),
        provenance={**dataset.provenance, "properties": told},
    )  # fmt: skip


def _scale(name, unit, declared, system):
    if not unit:
        return Conversion(declared, {*declared, name}).property(name)[:2]
    try:
        scale, read = parse_unit(unit)
    except UnitError as error:
        raise DataError(f"{name}: {error}", column=name) from None
    expected = PROPERTY_UNITS.get(name)
    if is_inertia(name, unit, system):
        return scale, expected
    if expected is not None and read != expected:
        raise DataError(f"the unit of {name} must be one of {expected}, got {unit!r}", column=name)
    return scale, read


def _told(of_bodies):
    return ", ".join(
        f"{number:g}{f' {unit}' if unit else ''}{f' of {body}' if body else ''}"
        for body, (number, unit) in of_bodies.items()
    )
