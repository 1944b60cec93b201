"""Vector tables of JPL Horizons as plain ones.

The layout is that of the Horizons manual (JPL, "Horizons on-line ephemeris system", vector tables
in CSV form): a preamble, a line of names, rows between ``$$SOE`` and ``$$EOE``.
"""

import re

__all__ = ["is_horizons", "plain_table"]

_BEGIN, _END = "$$SOE", "$$EOE"
_NAMES = ("JDTDB", "VX", "VY", "VZ", "X", "Y", "Z")
_UNITS = {"AU-D": ("au", "day"), "KM-S": ("km", "s"), "KM-D": ("km", "day")}


def is_horizons(text):
    """Whether a text is a table of Horizons that has names above its rows."""
    return f"\n{_BEGIN}" in text and f"\n{_END}" in text and "JDTDB" in text


def plain_table(text):
    """Header and rows of a vector table, with units, the body, and without what is no number.

    Returns
    -------
    str
        A table of tabs; the text as it was where its rows are not separated by commas.
    """
    above, rest = text.split(f"\n{_BEGIN}", 1)
    names = next((line for line in reversed(above.splitlines()) if "JDTDB" in line), "")
    names = [cell.strip() for cell in names.split(",")]
    if len(names) < 3:
        return text
    units = re.search(r"Output units\s*:\s*(\S+)", above)
    length, time = _UNITS.get(units[1].rstrip(",") if units else "", ("", ""))
    body = re.search(r"Target body name:\s*(.*?)\s*(?:\(|\{|$)", above, re.MULTILINE)
    kept = [k for k, name in enumerate(names) if name in _NAMES]
    own = {"J": "day", "V": f"{length}/{time}" if time else ""}
    header = []
    for name in (names[k] for k in kept):
        unit = own.get(name[0], length)
        header.append(f"{name} ({unit})" if unit else name)
    lines = ["\t".join(["entity", *header])]
    for line in rest.split(f"\n{_END}", 1)[0].splitlines()[1:]:
        cells = [cell.strip() for cell in line.split(",")]
        row = [cells[k] if k < len(cells) else "" for k in kept]
        lines.append("\t".join([body[1] if body else "body", *row]))
    return "\n".join(lines) + "\n"
