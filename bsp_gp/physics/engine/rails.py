"""Axes along which something holds all bodies where they are: a rail, a table."""


def rails_of(law):
    """Axes along which no force of a law moves a body, tuple of int."""
    return tuple(axis for part in law.frame if part.kind == "rail" for axis in part.axes)
