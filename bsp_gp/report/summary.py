"""The report as a few lines for a terminal."""

import textwrap

from bsp_gp.data.scene import CHECK
from bsp_gp.loop.outcome import LoopReport
from bsp_gp.report.first import plain_sentence
from bsp_gp.report.numbers import (
    format_constant,
    format_p,
    is_number,
    length_text,
)
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import (
    adopted_rounds,
    caveats,
    constant_groups,
    constant_lines,
    error_name,
    headline,
    hidden_sentence,
    noise_sentence,
    parting_sentence,
    powers_sentence,
    ratio_caution,
    worse_bodies,
)
from bsp_gp.report.traces import trace_sentence
from bsp_gp.units import is_speed

WIDTH = 100
_MAX_CONSTANTS = 8
_MAX_ROUNDS = 4
_MAX_CHECKS = 3


def summary_text(report: LoopReport, width: int = WIDTH) -> str:
    """Summarise a report in some twenty lines of whole sentences.

    Verdict, error before and after, what to check, law, constants, rounds, ties, notes; no newline
    at the end.

    Parameters
    ----------
    width : int
        Characters of a line, at most; sentences are wrapped and never cut.
    """
    report = page_of(report)
    notes = [*caveats(report), *report.notes]
    paragraphs = [
        (f"{report.dataset.get('name', 'data')}: {report.verdict}", ""),
        (" ".join(filter(None, plain_sentence(report))), ""),
        (headline(report)["text"], ""),
        (ratio_caution(report), ""),
        (worse_bodies(report), ""),
    ]
    checks = [note for note in notes if note.startswith(CHECK)][:_MAX_CHECKS]
    paragraphs += [(note.replace(CHECK, "Check: ", 1), "       ") for note in checks]
    is_of_sight = is_speed(report.dataset.get("symbols", {}).get("m", ""))
    law = report.law_text if is_of_sight else "F = " + report.law_text
    paragraphs += [("Law: " + law, "     "), *_constants(report)]
    paragraphs += [*_rounds(report), *_traced(report)]
    kept = adopted_rounds(report)[-2:]
    paragraphs += [*((powers_sentence(r), "  ") for r in kept), *_ties(report)]
    paragraphs += [(r.effect.dependence, "  ") for r in kept]
    # What is odd about the noise of the last model, and what may be hidden beside the law.
    paragraphs += [(noise_sentence(report.rounds[-1]), "  "), (hidden_sentence(report), "  ")]
    notes = [note for note in notes if not note.startswith(CHECK)]
    if notes:
        more = f" (more notes in the report: {len(notes) - 1})" if len(notes) > 1 else ""
        paragraphs.append((f"Note: {notes[0]}{more}", "      "))
    paragraphs.append((f"Stopped: {report.stop_reason}", ""))
    return "\n".join(line for text, indent in paragraphs for line in wrapped(text, width, indent))


def wrapped(text, width, indent):
    """Lines of a sentence, all of it; what follows the first is indented."""
    text = "".join(c if c.isprintable() else " " for c in str(text))
    return textwrap.wrap(text, max(width, 20), subsequent_indent=indent, drop_whitespace=True)


def _constants(report):
    if not report.constants:
        return []
    rows = constant_lines(report.constants, _MAX_CONSTANTS, "and {} more in the report")
    if len(report.constants) <= _MAX_CONSTANTS:
        shared, own = constant_groups(report.constants)
        each = [*shared, *(c for _, _, group in own for c in group)]
        rows = [f"{c.name}{f' of {c.entity}' * bool(c.entity)} = {format_constant(c)}"
                for c in each]  # fmt: skip
    return [("Constants (90 % intervals):", ""), *((f"  {row}", "    ") for row in rows)]


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
            if r.after is not None and is_number(r.after.rollout_rmse):
                sizes = (length_text(e.rollout_rmse, e.unit) for e in (r.before, r.after))
                text += f", held-out {error_name(r.after.unit)} {' → '.join(sizes)}"
        out.append((f"Round {r.number}: {text}", "  "))
    return out


def _traced(report):
    """Where the residual of the first traced round is: that of the declared model."""
    for r in report.rounds:
        if r.trace is not None and r.verdict != "the noise is not as assumed":
            return [(f"Traced in round {r.number}: {trace_sentence(r.trace)}", "  ")]
    return []


def _ties(report):
    for r in reversed(adopted_rounds(report) or report.rounds):
        if r.effect is not None and (r.effect.equivalents or r.effect.rewritten):
            n, rest = len(r.effect.equivalents), r.effect.rewritten
            text = (
                f"Not separable on these data: {n} other law{'s' if n > 1 else ''}, "
                f"the likeliest {r.effect.equivalents[0]}"
            ) if n else "No other law does as well"
            if r.undecided:
                text = f"Not separable on these data: {r.effect.name}, {', '.join(r.undecided)}"
            text += f"; and {rest}" if rest and n else f", but for {rest}" if rest else ""
            text = f"{text}. {parting_sentence(r.effect)}".rstrip(". ")
            return [(text, "  ")]
    return []
