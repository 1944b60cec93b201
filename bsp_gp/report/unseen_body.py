"""An unseen body in words: how strong it is, where, and what is known of its motion."""

import re

from bsp_gp.report.companion import companion_of
from bsp_gp.report.numbers import format_number, format_value, with_unit

_MOTIONS = {
    "at rest": "an unseen body at rest", "moving": "an unseen body that moves straight on",
    "under the law": "an unseen body that the law moves with the others",
    "on a circle": "an unseen body on a circle",
    "at rest, seen aslant": "an unseen body at rest about which the orbit is inclined to the sky",
}  # fmt: skip
_MOVES = {
    "at rest": "at rest", "moving": "moving straight on",
    "under the law": "moved by the law as the others are", "on a circle": "moving on a circle",
}  # fmt: skip


def name_of(effect):
    """Words for a hidden body that was fitted, told in the units of the data."""
    details = effect.details
    if not details:
        return companion_of(effect)
    known = {c.name: c for c in effect.constants}
    names = [name for name in details["names"] if name in known]
    n_dims = len(details["centre"])
    if len(names) < n_dims + 1:
        return effect.name
    strength, places = known[names[-1]], [known[name] for name in names[:n_dims]]
    size = format_value(strength.value, strength.low, strength.high, strength.unit)
    what = f"of {size}" if details.get("property") == "mass" else f"of strength {size}"
    if details.get("is_share") and not details.get("property"):
        what = f"{size} times as strong as {details.get('beside') or 'what is seen'},"
    coordinates = ", ".join(format_value(place.value, place.low, place.high) for place in places)
    where = f"at {with_unit(f'({coordinates})', places[0].unit)}"
    if "seen_at" in details:
        seen = ", ".join(format_number(x, 3) for x in details["seen_at"])
        where += f" in the plane of the orbit, seen at {with_unit(f'({seen})', places[0].unit)}"
    if details["motion"] != "at rest":
        where += f" at t = {_time(details)}"
    return f"an unseen body {what} {where}, {_motion(effect)}"


def _time(details):
    """When the place holds."""
    return with_unit(f"{details.get('epoch', 0.0):.6g}", details.get("time_unit", "s"))


def _motion(effect):
    others = {text.partition(":")[0] for text in effect.equivalents} & set(_MOVES)
    own = effect.details["motion"]
    if others - {own}:
        rivals = " and ".join(_MOVES[other] for other in sorted(others - {own}))
        return f"{_MOVES[own]} (how it moves is not told by these data: {rivals} fits as well)"
    return _MOVES.get(own, own)


def rivals_of(equivalents):
    """What is not told apart, hidden bodies in words."""
    return tuple(_told(text) for text in equivalents)


def _told(text):
    if text.endswith("of a companion"):
        shapes = {"cos": "on a circle", "Kepler": "on an ellipse"}
        told = " and another ".join(shapes[of] for of in re.findall(r" (cos|Kepler)\(", text))
        return f"an unseen companion {told}{' beside a steady change' * ('trend' in text)}"
    return _MOTIONS.get(text.partition(":")[0], text)
