"""The report as a few lines for a terminal."""

from __future__ import annotations

import textwrap

from bsp_gp.data.scene import CHECK
from bsp_gp.report.numbers import format_constant, format_number, format_p, format_value, with_unit
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import (
    caveats,
    constant_groups,
    group_range,
    headline,
    hidden_sentence,
    noise_sentence,
    powers_sentence,
    ratio_caution,
    verdict_sentence,
)
from bsp_gp.report.traces import trace_sentence

__all__ = ["format_number", "format_value", "summary_text"]

WIDTH = 100
MAX_LINES = 25
_MAX_CONSTANTS = 5
_MAX_ROUNDS = 4
_MAX_CHECKS = 3


def summary_text(report):
    """Summarise a report in at most 25 lines of at most 100 characters.

    Parameters
    ----------
    report : LoopReport

    Returns
    -------
    str
        Verdict, error before and after, what to check, law, constants, rounds, ties, notes; no
        newline at the end.
    """
    report = page_of(report)
    lines = _wrapped(f"{report.dataset.get('name', 'data')}: {report.verdict}", 1)
    lines += _wrapped(verdict_sentence(report), 4)
    lines += _wrapped(headline(report)["text"], 2)
    lines += _wrapped(ratio_caution(report), 1)
    notes = [*caveats(report), *report.notes]
    for note in [note for note in notes if note.startswith(CHECK)][:_MAX_CHECKS]:
        lines += _wrapped(note.replace(CHECK, "Check: ", 1), 3, indent="       ")
    lines += _wrapped("Law: F = " + report.law_text, 3, indent="     ")
    lines += _constants(report)
    lines += _rounds(report)
    lines += _traced(report)
    lines += _powers(report)
    lines += _ties(report)
    lines += _noise(report)
    notes = [note for note in notes if not note.startswith(CHECK)]
    if notes:
        more = f" (more notes in the report: {len(notes) - 1})" if len(notes) > 1 else ""
        lines += _wrapped(f"Note: {notes[0]}{more}", 2, indent="      ")
    lines += _wrapped(f"Stopped: {report.stop_reason}", 1)
    return "\n".join(lines[:MAX_LINES])


def _wrapped(text, max_lines, indent=""):
    text = "".join(c if c.isprintable() else " " for c in str(text))
    return textwrap.wrap(
        text, WIDTH, subsequent_indent=indent, max_lines=max_lines, placeholder=" …"
    )


def _constants(report):
    shared, own = constant_groups(report.constants)
    rows = [f"{c.name} = {format_constant(c)}" for c in shared]
    rows += [group_range(*group) for group in own]
    if not rows:
        return []
    if len(rows) > _MAX_CONSTANTS:
        n_left = len(rows) - _MAX_CONSTANTS + 1
        rows = [*rows[: _MAX_CONSTANTS - 1], f"… and {n_left} more in the report"]
    out = ["Constants (90 % intervals):"]
    for row in rows:
        out += _wrapped("  " + row, 1)
    return out


def _rounds(report):
    out = []
    for r in report.rounds[-_MAX_ROUNDS:]:
        if r.effect is None:
            text = f"{r.verdict} ({format_p(r.missing.p_value)})"
        else:
            state = "adopted" if r.adopted else "seen, not adopted"
            if r.removed:
                state = "adopted, and taken back"
            text = f"{r.effect.name}: {state} ({format_p(r.effect.p_value)})"
            if r.after is not None:
                text += (
                    f", rollout error {format_number(r.before.rollout_rmse)} → "
                    f"{with_unit(format_number(r.after.rollout_rmse), r.after.unit)}"
                )
        out += _wrapped(f"Round {r.number}: {text}", 1)
    return out


def _traced(report):
    """Where the residual of the first traced round is: that of the declared model."""
    for r in report.rounds:
        if r.trace is not None:
            return _wrapped(f"Traced in round {r.number}: {trace_sentence(r.trace)}", 3, "  ")
    return []


def _noise(report):
    """What is odd about the noise, and how much may be hidden, beside the last model."""
    last = report.rounds[-1]
    return _wrapped(noise_sentence(last), 2, "  ") + _wrapped(hidden_sentence(last), 2, "  ")


def _powers(report):
    """Of the last two laws that were adopted."""
    kept = [r for r in report.rounds if r.adopted and not r.removed]
    return [line for r in kept[-2:] for line in _wrapped(powers_sentence(r), 2, "  ")]


def _ties(report):
    rounds = [r for r in report.rounds if r.adopted and not r.removed] or report.rounds
    for r in reversed(rounds):
        if r.effect is not None and r.effect.equivalents:
            n = len(r.effect.equivalents)
            text = (
                f"Not separable on these data: {n} other law{'s' if n > 1 else ''}, "
                f"the likeliest {r.effect.equivalents[0]}"
            )
            if r.undecided:
                text = f"Not separable on these data: {r.effect.name}, {', '.join(r.undecided)}"
            return _wrapped(text, 2, indent="  ")
    return []
