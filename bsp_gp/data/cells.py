"""Texts in CSV files that a spreadsheet shows and does not run.

A cell that begins with = + - or @ is a formula to a spreadsheet, and a formula can send what
stands beside it elsewhere; a line that begins with # is none of the table. An apostrophe before it
makes it a text; our own reader takes it off again. So that every name survives, names that have
such an apostrophe get one more.
"""

import re

import pandas as pd

_FORMULA = re.compile(r"'*([=+\-@\t\r]|\s*#)")
_MARKED = re.compile(r"''*([=+\-@\t\r]|\s*#)")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def safe_cell(value):
    """A cell as it is written: a text that would be run gets an apostrophe, numbers never do.

    >>> safe_cell("=1+1"), safe_cell("-c * v_i"), safe_cell("-0.5"), safe_cell(-0.5)
    ("'=1+1", "'-c * v_i", '-0.5', -0.5)
    """
    if isinstance(value, str) and _FORMULA.match(value) and not _NUMBER.fullmatch(value):
        return f"'{value}"
    return value


def plain_cell(value):
    """The text that `safe_cell` was given.

    >>> plain_cell("'=1+1"), plain_cell("'tis"), plain_cell("-0.5")
    ('=1+1', "'tis", '-0.5')
    """
    return value[1:] if isinstance(value, str) and _MARKED.match(value) else value


def safe_table(frame):
    """A new DataFrame for `to_csv`: texts of cells, header and index as `safe_cell` has them."""
    texts = [c for c in frame.columns if not pd.api.types.is_numeric_dtype(frame[c])]
    frame = frame.assign(**{str(c): frame[c].map(safe_cell) for c in texts})
    if not pd.api.types.is_numeric_dtype(frame.index):
        frame = frame.set_axis(frame.index.map(safe_cell), axis=0)
    return frame.set_axis(list(map(safe_cell, frame.columns)), axis=1)
