"""Lines of a table taken apart: cells of rows, and names of columns as people set them."""

import csv
import io
import re

COMMENT = re.compile(r"^\ufeff?(?:[#%!]|//)\s*")
_SENTENCE = re.compile(r"^\ufeff?(?:[#%!]+|//)\s*[^\W\d][\w ]*[:=](?:\s|$)")
"""A comment that says something, ``# Instruments: Keck, Lick``, ``# url = ...``: no names."""
_RULE = re.compile(r"\s*[-=]+(?:[\s|+]+[-=]+)*\s*")
_MOST_IN_RULES = 12
"""Lines between two rules that may be names of columns."""
_WIDE_GAP = re.compile(r"\s{2,}|\t")
_BEFORE_BRACKET = re.compile(r"\s+(?![(\[]|-\d)")
"""Nor before what a date counts from, ``JD -2,450,000``."""
_THOUSANDS = re.compile(r"(?<=[^\W\d])\s*[-−–]\s*\d{1,3}(?:,\d{3})+")
"""``JD - 2,450,000``."""
_OPEN, _CLOSED = "([{", ")]}"


def split_line(line, delimiter):
    """Cells of one line; the delimiter None is white space."""
    if delimiter is None:
        return tuple(line.split())
    return tuple(cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), []))


def tabbed(rows):
    """The text of a table with tabs; a row without cells is a blank line."""
    out = io.StringIO()
    csv.writer(out, delimiter="\t", lineterminator="\n").writerows(rows)
    return out.getvalue()


def is_rule(line):
    """Whether a line is drawn, and no names: ``-------- ----``."""
    return bool(line.strip()) and _RULE.fullmatch(line) is not None and len(line.strip()) > 1


def is_sentence(line):
    """Whether a comment says something of a key, and names no columns."""
    return _SENTENCE.match(line) is not None


def below(head, number):
    """The first line with something in it, and no rule, below another; below a comment no other."""
    lines = [line for line in head[number + 1 :] if line.strip() and not is_rule(line)]
    if COMMENT.match(head[number]):
        lines = [line for line in lines if not COMMENT.match(line)]
    return lines[0] if lines else ""


def header_cells(line, delimiter, said=()):
    """Names of a header; its mark is one of a comment, unless a name is said with it (%time)."""
    cells = split_line(line, delimiter)
    is_name = bool(cells) and cells[0] in said
    return cells if is_name else split_line(COMMENT.sub("", line), delimiter)


def names_in(head, number, delimiter, said=()):
    """Names of a header, as many as the row below has cells, where they can be told apart so.

    A sign of a comment may be the name of the first column (``#``, which counts rows). Names of
    several words stand apart by two blanks or more, or have a unit in brackets behind them, in
    which the sign between cells may stand too.
    """
    line, cells = head[number], header_cells(head[number], delimiter, said)
    count = len(split_line(below(head, number), delimiter))
    whole = split_line(line.lstrip("\ufeff"), delimiter)
    if len(cells) == count or count < 2:
        return cells
    if not cells[-1:] == ("",) or not has_row_of(head, number, delimiter, len(cells)):
        return _names_apart(line, cells, whole, count, delimiter)
    return cells  # rows further down have as many


def has_row_of(head, number, delimiter, n_cells):
    """Whether a line below another has so many cells."""
    return any(len(split_line(line, delimiter)) == n_cells for line in head[number + 1 :])


def _names_apart(line, cells, whole, count, delimiter):
    """Names of a line as many as a row has cells, where cells themselves are not."""
    if len(whole) == count and whole[0] in ("#", "%"):
        return whole
    bare = COMMENT.sub("", line).strip()
    if delimiter is None:
        found = [_WIDE_GAP.split(bare), _BEFORE_BRACKET.split(bare)]
        found += [[part for wide in found[0] for part in _BEFORE_BRACKET.split(wide)]]
    else:
        bare = _THOUSANDS.sub(lambda since: since[0].replace(",", ""), bare)
        found = [_outside_brackets(bare, delimiter)] if len(cells) > count else []
    return next((tuple(names) for names in found if len(names) == count), cells)


def _outside_brackets(line, delimiter):
    """Cells of a line, between signs that stand in no brackets."""
    depth, cells = 0, [""]
    for sign in line:
        depth = max(depth + (sign in _OPEN) - (sign in _CLOSED), 0)
        if sign == delimiter and not depth:
            cells.append("")
        else:
            cells[-1] += sign
    return [cell.strip().strip('"') for cell in cells]


def ruled_names(head):
    """Names that stand above a rule which tells columns apart, as catalogues of stars have them.

    Returns
    -------
    tuple of (int, tuple of str) or None
        The line of the rule, and a name for every part of it: of several lines between two rules
        the words above each other, or the letters of what is set upright.
    """
    for number, line in enumerate(head[:-1]):
        spans = [match.span() for match in re.finditer(r"\S+", line)]
        if number == 0 or not is_rule(line) or len(spans) < 2:
            continue
        if len(below(head, number).split()) != len(spans) or is_rule(head[number + 1]):
            continue
        first = next((k for k in range(number - 1, max(number - _MOST_IN_RULES, -1), -1)
                      if is_rule(head[k])), number - 2)  # fmt: skip
        lines = head[first + 1 : number]
        names = [_above([text[start:stop].strip() for text in lines]) for start, stop in spans]
        outside = [text for text in lines for word in re.finditer(r"\S+", COMMENT.sub("", text))
                   if not any(a < word.end() and word.start() < b for a, b in spans)]  # fmt: skip
        if all(names) and not outside:
            return number, tuple(names)
    return None


def _above(words):
    words = [word for word in words if word]
    return ("" if all(len(word) == 1 for word in words) else " ").join(words)
