"""Words that notes on data have in common."""

import re

LISTED = 3
"""Things of a kind that a note names."""


def listed(names, most=LISTED):
    """The first of some names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(str, names[:most])) + more


def quoted(name):
    """A name of a column as an option takes it."""
    mark = "'" if '"' in name else '"'
    return name if re.fullmatch(r"\w+", name) else f"{mark}{name}{mark}"
