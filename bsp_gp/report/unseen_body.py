"""An unseen body in words: how strong it is, where, and what is known of its motion."""

from __future__ import annotations

from bsp_gp.report.numbers import format_value, is_number, rounded, with_unit

__all__ = ["name_of", "rivals_of"]

_MOTIONS = {
    "at rest": "an unseen body at rest", "moving": "an unseen body that moves straight on",
    "under the law": "an unseen body that the law moves with the others",
    "on a circle": "an unseen body on a circle",
}  # fmt: skip


def name_of(effect):
    """Words for a hidden body that was fitted.

    Parameters
    ----------
    effect : SimpleNamespace
        Of `page_of`, told in the units of the data.
    """
    details = effect.details
    if not details:
        return effect.name
    known = {c.name: c for c in effect.constants}
    names = [name for name in details["names"] if name in known]
    n_dims = len(details["centre"])
    if len(names) < n_dims + 1:
        return effect.name
    strength, places = known[names[-1]], [known[name] for name in names[:n_dims]]
    size = format_value(strength.value, strength.low, strength.high, strength.unit)
    what = f"of {size}" if details.get("property") == "mass" else f"of strength {size}"
    coordinates = ", ".join(map(_coordinate, places))
    when = "" if details["motion"] == "at rest" else " then"
    return (
        f"an unseen body {what} at {with_unit(f'({coordinates})', places[0].unit)}{when}, "
        f"{_motion(effect)}"
    )


def _coordinate(place):
    value, low, high, power = rounded(place.value, place.low, place.high)
    if not is_number(place.low) or power:
        return f"{value}{power}"
    half = (place.high - place.low) / 2
    decimals = len(value.partition(".")[2])
    return f"{value} ± {half:.{decimals}f}"


def _motion(effect):
    others = {text.partition(":")[0] for text in effect.equivalents} & set(_MOTIONS)
    own = effect.details["motion"]
    if others - {own}:
        return f"its motion undetermined ({own} fits, and so does {' or '.join(sorted(others))})"
    return own if own == "at rest" else {"moving": "moving straight on"}.get(own, own)


def rivals_of(equivalents):
    """What is not told apart, hidden bodies in words."""
    return tuple(_MOTIONS.get(text.partition(":")[0], text) for text in equivalents)
