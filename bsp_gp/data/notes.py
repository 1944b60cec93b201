"""Words that notes on data have in common."""

LISTED = 3
"""Things of a kind that a note names."""


def listed(names, most=LISTED):
    """The first of some names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(str, names[:most])) + more
