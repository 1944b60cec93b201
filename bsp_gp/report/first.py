"""The first screen of a report: what a reader takes away without the rest, in 120 words."""

import re

from bsp_gp.language.inputs import SHORT
from bsp_gp.report.numbers import format_constant, format_number, is_number
from bsp_gp.report.sentences import adopted_rounds, constant_groups, force_text, verdict_parts
from bsp_gp.report.typeset import to_svg

_MAX_CONSTANTS = 2
LEAST = 0.01
"""Probability that is worth telling: shares of a large class say nothing."""
PERCENT = 0.01, 100.0
"""Shares of the declared force that say more than newtons."""
LONGEST = 60
"""Letters of a law that the first screen quotes."""
_SYMBOLS = {
    r"m_i": "its mass", r"m_j": "mass of {other}", r"\mathbf{v}_i": "its velocity",
    r"\hat{\mathbf{v}}_i": "direction of motion", r"\mathbf{v}_{ij}": "relative velocity",
    r"{r}_{ij}": "distance", r"{r}_{ji}": "distance",
    r"\hat{\mathbf{r}}_{ij}": "direction to {other}",
    r"\hat{\mathbf{r}}_{ji}": "direction away from {other}", r"\hat{\mathbf{u}}": "upwards",
    r"\mu_i": "its friction", r"\mu_j": "friction of {other}",
} | {f"{short}_{role}": f"its {column}" if role == "i" else f"{column} of {{other}}"
     for column, short in SHORT.items() if len(short) == 1 and short != "m"
     for role in "ij"}  # fmt: skip
"""What stands for what in a typeset law."""


def plain_sentence(report):
    """The outcome in a sentence, with what sections of their own have to say in a clause."""
    sentence, detail = verdict_parts(report)
    adopted = adopted_rounds(report)
    clauses = [extra["headline"] for extra in report.extras if extra.get("headline")]
    if clauses and adopted:
        return f"{sentence[:-1]}; {', and '.join(clauses)}.", detail
    parts = [part for r in adopted for part in r.effect.parts]
    told = f"They are: {'; '.join(parts)}." if parts else ""
    beside = [force for r in adopted for force in r.effect.beside]
    also = f"What acts on it under way: {'; '.join(beside)}." if beside else ""
    return sentence, " ".join(filter(None, (told, also, detail)))


def legend(report):
    """Symbols of the law that need a word, as (drawing, words)."""
    out = []
    other = report.dataset.get("partner") or "the other body"
    for symbol, words in _SYMBOLS.items():
        known = re.search(rf"(?<![\w\\]){re.escape(symbol)}(?!\w)", report.law_latex)
        drawn = to_svg(symbol) if known else None
        if drawn:
            out.append((drawn, words.format(other=other)))
    return out


def told_constants(report):
    """The constants that all bodies share, if they are few, as texts."""
    shared, _ = constant_groups(report.constants)
    if len(shared) > _MAX_CONSTANTS:
        return []
    return [f"{c.name} = {format_constant(c)}" for c in shared]


def else_sentence(report):
    """How probable the name is, and what else it could be; "" where nothing was found."""
    rounds = adopted_rounds(report) or [r for r in report.rounds if r.effect is not None][-1:]
    if not rounds:
        return ""
    effect = rounds[-1].effect
    out = []
    if is_number(effect.probability) and effect.probability >= LEAST:
        share = format_number(100 * effect.probability, 2)
        out.append(f"Probability of this form: {share} %{_none_of_these(rounds[-1])}.")
    n = len(effect.equivalents)
    if n and len(effect.equivalents[0]) <= LONGEST:
        more = f" (and {n - 1} more)" if n > 1 else ""
        out.append(f"These data do not tell it from {effect.equivalents[0]}{more}.")
    elif n:
        out.append(f"These data do not tell it from {n} other form{'s' * (n > 1)}, listed below.")
    elif out:
        doubt = "" if effect.is_fact else "; that its form is the true one is not shown"
        out.append(f"Nothing else that was tried does as well{doubt}.")
    out += [effect.dependence] if rounds[-1].adopted and effect.dependence else []
    return " ".join(out)


def _none_of_these(round_):
    """How probable it is that the cause is none that is listed; "" if hardly."""
    if not round_.unlisted >= LEAST:
        return ""
    return f"; of none that is listed: {format_number(100 * round_.unlisted, 2)} %"


def bound_sentence(report):
    """How much may still be hidden beside the final law, in the words that say most."""
    bound = report.bound
    if bound is None or not is_number(bound.force):
        return ""
    size = force_text(bound)
    if is_number(bound.percent) and PERCENT[0] <= bound.percent <= PERCENT[1]:
        size = f"{format_number(bound.percent, 2)} % of the declared one"
    return f"A constant force of up to {size} may still hide."
