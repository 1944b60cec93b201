"""The trace as a guide of the search: which inputs the leading channels speak of.

"order" lists laws that speak of them before others that fit as well; nothing else changes.
"restrict" searches these laws alone. What is found can then be compared with "off", always.
"""

from __future__ import annotations

import re
from dataclasses import replace

from bsp_gp.errors import SettingsError
from bsp_gp.language.inputs import SHORT, property_of
from bsp_gp.loop.attempts import TIE_BIC
from bsp_gp.loop.traced import Guidance

__all__ = ["GUIDES", "check_guide", "guided", "in_guided_order", "inputs_left_out", "ordered"]

GUIDES = ("off", "order", "restrict")
SMALL = 0.5
"""Greatest exponent, by its interval, at which a residual counts as independent of a quantity."""
_OF_SPEED = {"v_i", "v_j"}
_DIRECTIONS = {"e_x", "e_y", "e_z", "up", "down"}


def check_guide(guide):
    """Raise SettingsError unless this is a way to guide a search."""
    if guide not in GUIDES:
        raise SettingsError(f"guide must be one of {', '.join(GUIDES)}, got {guide!r}")


def inputs_left_out(trace, inputs):
    """The inputs that no leading channel needs.

    A direction is left out if it leads nowhere; speed, place, time and properties only if the
    residual was shown not to scale with them in any leading channel. The mass of the receiver
    always stays, since it makes an acceleration of a force.

    Parameters
    ----------
    trace : Trace
    inputs : collection of str
        Of the grammar.

    Returns
    -------
    tuple of str
        () where nothing of the trace can be said by a law, as for an unseen point alone.
    """
    kept = {name for channel in trace.leading for name in channel.inputs}
    if not kept:
        return ()
    free = _independent(trace)
    for name in inputs:
        if property_of(name):
            if name == "m_i" or _stem(name) not in free:
                kept.add(name)
        elif name in _DIRECTIONS:
            continue
        else:
            quantity = "speed" if name in _OF_SPEED else "time" if name == "t" else "distance"
            if quantity not in free:
                kept.add(name)
    return tuple(sorted(set(inputs) - kept))


def _stem(name):
    column, role = property_of(name)
    return f"{SHORT.get(column, column)}_{role}"


def _independent(trace):
    """Quantities whose exponent is known to be near zero in every leading channel."""
    found = {}
    for exponent in trace.exponents:
        near = (
            exponent.is_determined
            and not exponent.reason
            and exponent.low <= 0.0 <= exponent.high
            and max(-exponent.low, exponent.high) < SMALL
        )
        found.setdefault(exponent.variable, []).append(near)
    n = len({exponent.channel for exponent in trace.exponents})
    if n < len(trace.leading):
        return set()
    return {name for name, near in found.items() if all(near) and len(near) == n}


def guided(search, trace, guide):
    """The search to run, and how it was guided.

    Parameters
    ----------
    search : EffectSearch
    trace : Trace or None
    guide : str
        One of `GUIDES`.

    Returns
    -------
    search : EffectSearch
    guidance : Guidance
    """
    if guide == "off" or trace is None:
        note = "" if guide == "off" else "nothing was traced, so that the search was not guided"
        return search, Guidance("off", (), note)
    left_out = inputs_left_out(trace, sorted(search.usable_inputs()))
    if guide == "order":
        return search, Guidance("order", left_out, "the whole grammar was searched")
    narrow = search.without_inputs(left_out) if left_out else search
    if not narrow.kinds:
        return search, Guidance(
            "off", (), "no law of the grammar speaks of the leading channels: all were searched"
        )
    if narrow is search:
        return search, Guidance("restrict", (), "the leading channels leave no input out")
    note = "laws with these inputs were not searched; run again with guide off for all of them"
    return narrow, Guidance("restrict", left_out, note)


def in_guided_order(rows, guidance, *, law=lambda row: row, score=None):
    """Rows with those first that speak of leading channels, within ties only.

    Parameters
    ----------
    rows : sequence
    guidance : Guidance
    law : callable
        Text of the law of a row.
    score : callable, optional
        BIC of a row: only neighbours that differ by less than a tie are exchanged. Without it
        all rows tie.
    """
    left_out = set(guidance.left_out)
    if guidance.used != "order" or not left_out:
        return tuple(rows)

    def strays(row):
        return bool(left_out & set(re.findall(r"[A-Za-z_]\w*", law(row))))

    if score is None:
        return tuple(sorted(rows, key=strays))
    out, tied = [], []
    for row in rows:
        if tied and not abs(score(row) - score(tied[0])) < TIE_BIC:
            out += sorted(tied, key=strays)
            tied = []
        tied.append(row)
    return tuple(out + sorted(tied, key=strays))


def ordered(effect, rivals, guidance):
    """An effect's equals, and rivals, in guided order."""
    if effect is not None and effect.kind != "declared_term_change":
        effect = replace(effect, equivalents=in_guided_order(effect.equivalents, guidance))
    rivals = in_guided_order(
        rivals, guidance, law=lambda rival: rival.law, score=lambda rival: rival.delta_bic
    )
    return effect, rivals
