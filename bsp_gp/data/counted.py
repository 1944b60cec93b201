"""Angles in counts of an encoder, where the caller says what one of them is."""

import math
import re
from dataclasses import replace

from bsp_gp.data.headings import is_angle_name
from bsp_gp.data.words import words_for
from bsp_gp.units import ANGLES

_TURNS = words_for("whole_turn")
_NUMBER = r"((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)"
_COUNT = re.compile(rf"(?:{_NUMBER}\s*)?([^\W\d_]+|°)\s*(?:/\s*{_NUMBER})?")
"""``0.09 deg``, ``rev/4000``, ``2 rev / 8192``."""


def count_of(text):
    """What one count of such a unit is: a number and a unit of angles; None for any other unit.

    >>> count_of("0.09 deg"), count_of("rev/4000")[1], count_of("deg"), count_of("0.17 um")
    ((0.09, 'deg'), 'rad', None, None)
    """
    match = _COUNT.fullmatch(text.strip().lower())
    if match is None:
        return None
    times, word, parts = match.groups()
    if word in ANGLES and (times or parts):
        size, unit = 1.0, word
    elif word in _TURNS:
        size, unit = 2 * math.pi, "rad"
    else:
        return None
    number = float(times or 1) / float(parts or 1) if float(parts or 1) else 0.0
    return (number * size, unit) if number else None


def with_counted_angles(table, declaration):
    """The table with angles in the place of their counts, and the declaration with their unit."""
    frame, units, notes = table.frame, dict(declaration.units), []
    is_flat = "y" not in frame and "z" not in frame
    for name, text in declaration.units.items():
        count = count_of(text)
        stands_for_x = name in ("x", "length") or (name not in frame and is_angle_name(name))
        column = name if name == "angle" and name in frame else "x" if stands_for_x else ""
        if count is None or column not in frame or (column == "x" and not is_flat):
            continue
        own = [c for c in (column, f"s{column}") if c in frame]
        frame = frame.assign(**{c: count[0] * table.numbers(c) for c in own})
        units[name] = count[1]
        notes.append(f"{table.heading(column)!r} counts {text}: it is read in {count[1]}")
    if not notes:
        return table, declaration
    return replace(table, frame=frame).noted(*notes), replace(declaration, units=units)
