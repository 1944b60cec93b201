"""The few lines of words in what ``print(report)`` says.

Reports are of the loop, words of this room: whoever imports this module teaches reports to speak.
The package itself does, where it hands out `close_loop` and `load_report`.
"""

from bsp_gp.loop.outcome import LoopReport
from bsp_gp.report.numbers import format_number, is_number
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import adopted_rounds, constant_lines

MAX_CONSTANTS = 3
MAX_RIVALS = 2
LONGEST = 150
"""Letters of a line, at most."""


def brief_lines(report):
    """Lines on what was found, its constants and what is not told apart from it.

    Lists of one line at the most, of `MAX_CONSTANTS`, and of one.
    """
    page = page_of(report)
    return _found(page), _constants(page), _rivals(page)


def _found(page):
    seen = [r for r in page.rounds if r.effect is not None]
    rounds = adopted_rounds(page)
    names = [_named(r.effect) for r in rounds or seen[-1:]]
    if not names:
        return []
    return [_short(f"{'found' if rounds else 'seen, not adopted'}{'; '.join(names)}")]


def _named(effect):
    name = ": ".join(filter(None, (effect.name, " and ".join(effect.parts))))
    if not is_number(effect.probability):
        return f": {name}"
    return f" (probability {format_number(100 * effect.probability, 2)} %): {name}"


def _constants(page):
    lines = constant_lines(page.constants, MAX_CONSTANTS, "and {} more constants")
    return [f"  {_short(line)}" for line in lines]


def _rivals(page):
    effects = [r.effect for r in reversed(adopted_rounds(page))]
    effect = next((e for e in effects if e.equivalents or e.rewritten), None)
    if effect is None:
        return []
    others = effect.equivalents
    told = [_short(other, LONGEST // MAX_RIVALS - 20) for other in others[:MAX_RIVALS]]
    told += [f"{len(others) - MAX_RIVALS} more"] if len(others) > MAX_RIVALS else []
    told += [effect.rewritten] if effect.rewritten else []
    return [f"these data do not tell it from {'; '.join(told)}"]


def _short(text, most=LONGEST):
    return text if len(text) <= most else text[: most - 2] + " …"


LoopReport.words = brief_lines
