"""Observations of minor planets and comets, in the lines of 80 columns of the Minor Planet Center.

What a line has where is told in its "Format for Optical Astrometric Observations": a number and a
provisional designation, marks, a date with parts of a day, right ascension and declination, a
magnitude, and the code of the observatory at its end.
"""

import re
from collections import Counter
from datetime import date

from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK

OF_OBSERVATIONS = (
    r"(?:[A-Z]{2}[A-Z\d] [^\n]*\n)*.{15}\d{4} \d\d [ \d]\d\.[\d ]{6}\d\d \d\d[ .][\d. ]{6}"
    r"[+-]\d\d \d\d[ .][\d. ]{5}.{21}\w{3}\s"
)
"""How such files begin; lines of who has observed may stand above."""
_ROW = re.compile(
    r"(.{4})(.)(.{5})(..)..[^Xx](\d{4}) (\d\d) ([ \d]\d\.[\d ]{6})(\d\d \d\d \d\d[.\d ]{4})"
    r"([+-]\d\d \d\d \d\d[.\d ]{3}).{21}(\w{3})\s*"
)
_BEFORE_MONTH = 1_721_423.5
"""Julian date of the day before that which Python counts as 0."""


def of_observations(text, path):
    """A table of dates, right ascensions and declinations, body by body, and notes.

    Left out are second lines, which say where a spacecraft or someone on the way was, what a radar
    saw, and what has been replaced (``X``).
    """
    lines = [line for line in text.splitlines() if len(line) > 15 and line[15].isdigit()]
    rows, codes = [], Counter()
    for row in filter(None, map(_ROW.fullmatch, lines)):
        number, kind, designation, end, year, month, day, ra, dec, code = row.groups()
        name = number + kind if number.strip() else kind + designation + end
        part = re.search(r"[a-z]+$", end)  # of a comet that has come apart
        name = name.strip().lstrip("0") + (f"-{part[0].upper()}" if part and number.strip() else "")
        days = date(int(year), int(month), 1).toordinal() + _BEFORE_MONTH + float(day)
        rows.append([name, repr(days), ra.strip(), dec.strip()])
        codes[code] += 1
    told = listed([f"{code} ({count})" for code, count in codes.most_common()], 8)
    note = (
        f"{CHECK}places are those that are seen from observatories ({told}): how the Earth "
        "moves these is not taken off; of JPL Horizons a vector table has places without that"
    )
    out = len(lines) - len(rows)
    more = (f"{out} line(s) are no places of the sky in h m s, or were replaced: left out",)
    return [["entity", "t (day)", "ra", "dec"], *rows], (note, *more * bool(out))
