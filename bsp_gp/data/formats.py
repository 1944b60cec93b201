"""Delimited text as programs export it: delimiter, decimal sign, titles and units are sniffed.

Read here: plain CSV, exports of Tracker and of loggers, of one run or body or of several side by
side, workbooks, and long tables of trackpy. The result is one `Table` whatever the dialect was.
"""

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from bsp_gp.data.cells import plain_cell
from bsp_gp.data.conversion import TIME, unit_of
from bsp_gp.data.dates import seconds_of
from bsp_gp.data.headings import (
    GUESS,
    LITERAL,
    NUMBER_COLUMNS,
    TEXT_COLUMNS,
    UNKNOWN,
    has_place,
    is_body,
    is_height,
    is_id,
    is_run_column,
    is_time_name,
    number_columns,
    run_of,
    told,
)
from bsp_gp.data.notes import quoted
from bsp_gp.data.polar import POLAR_COLUMNS
from bsp_gp.data.polar_words import is_position_angle
from bsp_gp.data.sniffing import DELIMITER_NAMES, sniff, split_line
from bsp_gp.data.sources import open_source
from bsp_gp.data.steps import with_even_clocks, with_sums_of_steps
from bsp_gp.data.table import Table
from bsp_gp.data.untimed import COUNTED, IN_TURN, rows_as_frames, with_bodies_in_turn
from bsp_gp.data.wide import as_recordings, groups_of, stack
from bsp_gp.errors import DataError

_NAN = ["", "nan", "NaN", "NAN", "NA", "N/A", "null", ".", "...", "…", "-", "–", "--", "---"]
_NO_NUMBER = [*_NAN, "X", "x", "?", "*", "na", "n/a", "n.a.", "#N/A", "NULL", "None", "none"]
"""What stands for no value where a number is expected."""
_HEAD_LINES, _MOST_LINES = 60, 10_000
"""Lines from which a layout is guessed; and those that are looked at where columns without names
are told."""
_BY_NUMBER = ", or say which column is which by its number: --columns t=1 x=2"


def read_table(path, *, rename=None, as_text=False):
    """Read a delimited file, with a header or with numbers alone.

    `rename` maps our name of a column to its name in the file. `as_text` leaves every cell a text
    (for ``entities.csv``, whose columns are the user's own).

    Raises
    ------
    DataError
        Whatever is wrong with the file, with its line and column.
    """
    source = open_source(Path(path), (rename or {}).values())
    path = source.path
    head = source.head(_HEAD_LINES)
    plain = source.without_brackets(head)
    source, head = plain, head if plain is source else plain.head(_HEAD_LINES)
    marks = ("entity",) if as_text else ("t", "frame")
    try:
        layout = sniff(
            head, dict(rename or {}), marks, path, whole=lambda: source.head(_MOST_LINES)
        )
        layout, within = _runs_in_sheets(layout, source)
        source = source.without_comments(head[: layout.data_line])
        source = _without_idle_ends(source, layout, head)
        short = _require_even_rows(source, layout, head)
    except csv.Error as error:  # such as a cell of more than 131,072 characters
        raise DataError(
            f"the rows cannot be told apart: {error}",
            file=path, remedy="is it a table, with one row per time and entity?",
        ) from None  # fmt: skip
    line = layout.header_line + 1 or None
    titles = () if as_text else layout.title_cells
    groups = groups_of(layout.headings, titles, file=path, line=line, is_track=not as_text)
    frame = _read_frame(source, layout, as_text)
    if within is not None:
        frame[0] = frame[0] + frame[within].map(lambda cell: f" {cell}".removesuffix(".0"))
    return long_table(
        frame, layout.headings, layout.units, groups, file=path, title=_title(layout, head),
        line=line, as_text=as_text, digest=source.digest, decimal=layout.decimal,
        notes=(*source.notes, *layout.notes, *short),
    )  # fmt: skip


def _runs_in_sheets(layout, source):
    """The layout where each sheet has several recordings, and which column tells these apart.

    The caller names it, or its words do; it counts together with the name of the sheet.
    """
    found = [*layout.headings]
    if not source.is_of_sheets or found[0].name != "scene":
        return layout, None
    said = [k for k, h in enumerate(found[1:], 1) if h.is_renamed and h.name == "scene"]
    own = said or [k for k, h in enumerate(found) if h.sure == UNKNOWN and is_run_column(h.stem)]
    if len(own) != 1:
        return layout, None
    (k,) = own
    found[0] = replace(found[0], is_renamed=bool(said), theirs=f"sheet, {found[k].theirs}")
    found[k] = replace(found[k], name="", ignored=found[k].theirs, sure=GUESS)
    return replace(layout, headings=tuple(found)), k


def long_table(
    frame, found, units, groups, *, file, title="", line=None, as_text=False, digest="",
    decimal=".", notes=(),
):  # fmt: skip
    """Make the table of a frame whose columns are called by their positions.

    Parameters
    ----------
    frame : DataFrame
        Its index counts lines.
    units : sequence of str
        Of every column.
    file, title, line, as_text, digest, decimal, notes
        What else is known of the file; `line` is that of the header, `title` all that is above.
    """
    if frame.empty:
        raise DataError(
            "the file has a header but no rows", file=file, row=line,
            remedy="one row per time and entity is needed",
        )  # fmt: skip
    found, groups = _without_wrong_errors(frame, found, groups)
    dated, frames, untimed = False, None, ""
    if not as_text:
        found = found if groups else _with_rising_clock(frame, found)
        found = _with_named_recordings(frame, found)
        frame, found, steps = with_sums_of_steps(frame, found)
        frame, dates, dated = _without_dates(frame, [h.name for h in found])
        notes = (*notes, *steps, *dates)
        names = {h.name for h in found}
        rates = {f"{kind}{axis}" for kind in "va" for axis in "xyz"}
        has_motion = has_place(found) or names & rates
        if not {"t", "frame"} & names and has_motion:
            found = found if groups else with_bodies_in_turn(frame, found)
            frames, untimed = rows_as_frames(frame, found)
    names = [h.name for h in found]
    if groups:
        clocks = [k for k, name in enumerate(names) if name == "t"]
        frame, even = with_even_clocks(frame, clocks)
        notes = (*notes, *even)
        if any(h.body for h in found):  # and no title above says whose they are
            groups = as_recordings(frame, groups)
        used = {k for group in groups for k in group.columns.values()}
        rest = [h for k, h in enumerate(found) if k not in used or h.sure == UNKNOWN]
        frame = stack(frame, groups, file)
    else:
        rest = [h for h in found if h.sure == UNKNOWN]
        kept = [k for k, name in enumerate(names) if name and names.count(name) == 1]
        frame = frame[kept].set_axis([names[k] for k in kept], axis=1)
    if frames is not None:
        frame = frame.assign(frame=frames[frame.index].to_numpy())
        notes = (*notes, IN_TURN if "entity" in names and not groups else COUNTED)
    is_named = {"entity", "scene"} & set(frame.columns)
    if title and any(h.name == "t" and h.sure != LITERAL for h in found) and not run_of(title):
        title = ""  # of Tracker it is the name of the mass; of others, anything
    if not (groups or as_text):
        frame, found = _with_bodies(frame, found)
        rest = [h for h in found if h.sure == UNKNOWN]
        frame, even = with_even_clocks(frame, ["t"] if "t" in frame.columns else [])
        notes = (*notes, *even)
    run = run_of(title)
    if run and "scene" not in is_named:
        frame, title = frame.assign(scene=run), ""
    frame, apart = _without_untracked(frame, found)
    notes = (*notes, *apart)
    for column in (c for c in TEXT_COLUMNS if c in frame.columns):
        frame[column] = frame[column].map(plain_cell)
    of_names = {n: u for n, u in zip(names, units, strict=True) if u and n in frame.columns}
    unused = {} if as_text else {h.name or h.theirs: h.of_any_run for h in rest if h.theirs}
    is_upright = any(map(is_height, found))
    return Table(
        frame=frame, units=of_names | ({"t": "s"} if dated else {}),
        renamed=frozenset(h.ignored or (f"{h.body}_{h.name}" if h.body else h.name)
                          for h in found if h.is_renamed or h.ignored),
        file=str(file), digest=digest, title=title or None, decimal=decimal,
        notes=(*notes, *filter(None, [told(found)])),
        theirs={f"{h.name} of {h.body}" if h.body else h.name: h.theirs
                for h in sorted(reversed(found), key=_place) if h.sure != UNKNOWN and h.name},
        present=tuple(h.theirs for h in found if h.theirs), up="y" if is_upright else None,
        unused=unused, untimed=untimed, is_dated=dated,
    )  # fmt: skip


def _without_wrong_errors(frame, found, groups):
    """Headings and groups without errors that were guessed, where one is not above 0."""
    guessed = [k for k, h in enumerate(found) if h.sure == GUESS and h.name in ("sx", "sy", "sz")]
    if not any((pd.to_numeric(frame[k], errors="coerce") <= 0).any() for k in guessed):
        return found, groups
    found = [replace(h, name=h.stem or h.theirs, sure=UNKNOWN, body="") if k in guessed else h
             for k, h in enumerate(found)]  # fmt: skip
    return found, tuple(
        replace(g, columns={n: k for n, k in g.columns.items() if k not in guessed}) for g in groups
    )


def _with_rising_clock(frame, found):
    """Headings where the time is one of several that may be it: dates, or what has a unit of it.

    What rises in every row comes first, then what tells its unit, then what has the most values.
    Dates under a plain name stay the time unless they repeat, or lack in rows.
    """
    own = [k for k, h in enumerate(found) if h.name in ("t", "frame")]
    free = [k for k, h in enumerate(found) if h.sure == UNKNOWN and not h.ignored]
    is_text = [frame[k].dtype.kind not in "fiub" for k in range(len(found))]
    named = own or [k for k in free if is_time_name(found[k].name)]
    is_settled = any(found[k].is_renamed or not is_text[k] or _rise(frame[k]) > 0 for k in own)
    if is_settled or not named or {"entity", "scene"} & {h.name for h in found}:
        return found
    able = {k for k in free if is_text[k] or unit_of(found[k].unit) == TIME} | {*named} - {*own}
    rises = {k: rise for k in able if (rise := _rise(frame[k])) >= (1 if own else 0)}
    if not rises:
        return found
    best = min(rises, key=lambda k: (-rises[k], not found[k].unit, -frame[k].nunique()))
    found = [replace(h, name=h.stem or h.theirs, sure=UNKNOWN) if k in own else h
             for k, h in enumerate(found)]  # fmt: skip
    return [replace(h, name="t", sure=GUESS) if k == best else h for k, h in enumerate(found)]


def _with_named_recordings(frame, found):
    """Texts under a word for frames or films, beside a clock, as names of recordings."""
    names = [h.name for h in found]
    if "t" not in names or "scene" in names:
        return found
    is_text = [frame[k].dtype.kind not in "fiub" for k in range(len(found))]
    return [
        replace(h, name="scene")
        if h.name == "frame" and h.sure == GUESS and is_text[k]
        and pd.to_numeric(frame[k], errors="coerce").isna().all() else h
        for k, h in enumerate(found)
    ]  # fmt: skip


def _rise(cells):
    """Whether numbers, or dates, are in all rows and go up: 1 in each, 0 if never down, else -1."""
    read = None if cells.dtype.kind in "fiu" else seconds_of(cells)
    values = pd.to_numeric(cells, errors="coerce").to_numpy(float) if read is None else read[0]
    steps = np.diff(values)
    return 1 if (steps > 0).all() else 0 if (steps >= 0).all() and steps.any() else -1


def _with_bodies(frame, found):
    """Where rows share their times, the column that tells them apart is that of bodies."""
    clock = "t" if "t" in frame.columns else "frame"
    if "entity" in frame.columns or clock not in frame.columns:
        return frame, found
    keys = [name for name in ("scene", clock) if name in frame.columns]
    if not frame.duplicated(keys).any():
        return frame, found
    again = frame[clock].diff() == 0  # next to each other, they are no recordings one by one
    able = [
        h for h in found
        if h.sure == UNKNOWN and h.name in frame.columns
        and not frame.duplicated([*keys, h.name]).any() and frame[h.name].notna().all()
        and (_names_bodies(h, frame) or (again.any() and frame[h.name].dtype.kind not in "fiub"))
    ]  # fmt: skip
    named = [h for h in able if _names_bodies(h, frame)]
    # Names of double stars tell pairs apart, which have each its own primary.
    is_star = any(h.name == "angle" and is_position_angle(h.theirs) for h in found)
    named = named or ([] if is_star else able)
    if len(named) != 1:
        return frame, found
    (heading,) = named
    frame = frame.rename(columns={heading.name: "entity"})
    new = [replace(h, name="entity", sure=GUESS) if h is heading else h for h in found]
    return frame, new


def _without_untracked(frame, found):
    """Rows without those that a tracker has put into no track (``TRACK_ID`` None), and a note."""
    theirs = [h.theirs for h in found if h.name == "entity" and h.sure != UNKNOWN]
    if "entity" not in frame or not any(re.fullmatch(r"(?i)track[\s_]?id", t) for t in theirs):
        return frame, ()
    is_none = frame["entity"].astype(str).str.strip().str.lower().isin(("none", ""))
    if is_none.nunique() < 2:
        return frame, ()
    note = f"{theirs[0]} is None in {int(is_none.sum())} row(s), which are of no track: left out"
    return frame[~is_none], (note,)


def _names_bodies(heading, frame):
    """Whether a heading speaks of bodies, or of numbers of what is followed, not of rows."""
    is_counted = is_id(heading.name) and 2 * frame[heading.name].nunique() <= len(frame)
    return is_counted or is_body(heading.name)


def _place(heading):
    order = (*TEXT_COLUMNS, *NUMBER_COLUMNS, *POLAR_COLUMNS)
    return order.index(heading.name) if heading.name in order else len(order)


def _title(layout, head):
    """The single title line above the header, without what programs put before the name.

    Below that of a body, which Tracker writes, no row of units stands.
    """
    cells = [cell for cell in layout.title_cells if cell]
    is_named = layout.data_line == 2 or any(map(run_of, cells))
    is_second = (layout.header_line == 1 and is_named) or head[0].startswith("Vernier Format")
    if len(cells) != 1 or not is_second:
        return ""
    title = cells[0] if run_of(cells[0]) else re.sub(r"^#?\s*(?:name:)?\s*", "", cells[0])
    return title[:60]


def _without_dates(frame, names):
    """Dates in columns of times as seconds since the first of them all, and a note of it."""
    dated = [k for k, n in enumerate(names) if n == "t" and frame[k].dtype.kind not in "fiub"]
    if not dated:
        return frame, [], False
    cells = pd.concat([frame[k] for k in dated], ignore_index=True)
    read = seconds_of(cells)
    if read is None:
        return frame, [], False
    frame = frame.copy()
    for key, values in zip(dated, np.split(read[0], len(dated)), strict=True):
        frame[key] = values
    return frame, [f"times are in seconds since {read[1]}"], True


def _require_even_rows(source, layout, head):
    """Notes of short rows; names the first row whose number of cells differs.

    Rows may lack cells at their ends that mean nothing to us. Of what is cut off in the middle of a
    line the last cell that is there may be a part of a number: one row alone that ends with what is
    used is refused, unless the caller leaves out all that it lacks; and so are all rows, whose
    header may have a comma in a name. A file that adds up is not scanned.
    """
    if layout.delimiter is None or _adds_up(source, layout, head):
        return ()
    n_cells, n_used = len(layout.names), _n_used(layout)
    is_left = all(h.ignored for h in layout.headings[n_used:])
    short, cut, is_ever = [], [], False
    with source.open(newline="") as stream:
        for line, row in enumerate(csv.reader(stream, delimiter=layout.delimiter), start=1):
            is_row = line > layout.data_line and any(cell.strip() for cell in row)
            is_ever = is_ever or (is_row and n_used < len(row) <= n_cells)
            if not is_row or len(row) == n_cells:
                continue
            if not n_used <= len(row) < n_cells:
                _refuse_uneven(source, layout, head, line, len(row))
            short.append(line)
            if len(row) == n_used and not is_left:
                cut.append(line)
    if len(cut) == 1 or (cut and not is_ever):
        _refuse_uneven(source, layout, head, cut[0], n_used)
    told = f"rows lack cells at their ends, which are not used: {len(short)}, the first is line"
    return (f"{told} {short[0]}",) if short else ()


def _without_idle_ends(source, layout, head):
    """The source without a delimiter at the end of rows that have nothing behind it, and a note."""
    mark, n_cells = layout.delimiter, len(layout.names)
    if mark is None or _adds_up(source, layout, head):
        return source
    lines = source.head(None)
    idle = [k for k in range(layout.data_line, len(lines))
            if not lines[k].rpartition(mark)[2].strip()
            and len(split_line(lines[k], mark)) == n_cells + 1]  # fmt: skip
    if not idle:
        return source
    for k in idle:
        lines[k] = lines[k][: lines[k].rindex(mark)]
    return source.with_text(
        "\n".join(lines), f"rows end with a {DELIMITER_NAMES[mark]} and nothing behind it: "
        f"{len(idle)}, the first is line {idle[0] + 1}"
    )  # fmt: skip


def _adds_up(source, layout, head):
    """Whether there are as many delimiters as rows with all their cells have."""
    n_cells = len(layout.names)
    mark, counts = layout.delimiter.encode(), source.counts
    above = head[: layout.data_line]
    n_marks = counts[mark] - sum(line.count(layout.delimiter) for line in above)
    n_rows = counts[b"\n"] - len(above)
    if counts[b'"'] or n_marks not in (n_rows * (n_cells - 1), (n_rows + 1) * (n_cells - 1)):
        return False
    first = head[layout.data_line : layout.data_line + 1]
    return not first or len(split_line(first[0], layout.delimiter)) == n_cells


def _n_used(layout):
    """How many cells of a row have all that is used; more than there are where nothing is known."""
    known = [k for k, h in enumerate(layout.headings) if h.sure != UNKNOWN]
    return max(known, default=len(layout.names)) + 1


def _refuse_uneven(source, layout, head, line, count):
    """DataError about a row with so many cells, and what it lacks."""
    n_cells, has_header = len(layout.names), layout.header_line >= 0
    first = "the header" if has_header else "the first row"
    rows = [split_line(text, layout.delimiter) for text in head[layout.data_line :] if text.strip()]
    by_number = _BY_NUMBER * (has_header and len(set(map(len, rows))) == 1 < len(rows[0]))
    if set(map(len, rows[line - 1 - layout.data_line :])) == {1} and line > 2:
        by_number = (
            f"; of one column of numbers below {line - 1} lines of settings, evenly spaced, say "
            "how many there are in a second: --columns x=1 --fps 25"
        )
    lacking = [h.theirs or str(k + 1) for k, h in enumerate(layout.headings)][count:]
    told = f": it lacks {', '.join(lacking)}" if lacking else ""
    options = " ".join(f"{quoted(name)}=ignore" for name in lacking)
    is_idle = has_header and _n_used(layout) <= count < n_cells
    left = f"; what it lacks is not used: --columns {options} leaves it out" if is_idle else ""
    raise DataError(
        f"this row has {count} cells, {first} has {n_cells} "
        f"({DELIMITER_NAMES[layout.delimiter]} between them){told}",
        file=source.path, row=line,
        remedy=f"every row needs as many cells as {first}{left}{by_number}",
    )  # fmt: skip


def _read_frame(source, layout, as_text):
    """The rows, columns called by their positions; numbers where they are expected."""
    names, keys = layout.names, range(len(layout.names))
    numeric = [k for k in keys if not as_text and names[k] in number_columns(names)]
    text = [k for k in keys if as_text or names[k] in TEXT_COLUMNS]
    options = {
        "sep": r"\s+" if layout.delimiter is None else layout.delimiter, "names": list(keys),
        "header": None, "skiprows": layout.data_line, "skip_blank_lines": False,
        "skipinitialspace": True, "keep_default_na": False, "na_values": {
            key: [""] if key in text else _NO_NUMBER if key in numeric else _NAN for key in keys
        },
        "decimal": layout.decimal, "encoding": source.encoding, "low_memory": False,
        "compression": None,  # it was read as text so far, whatever its name ends in
    }  # fmt: skip
    if tuple(map(int, re.findall(r"\d+", pd.__version__)[:2])) < (3, 1):
        options["float_precision"] = "round_trip"  # later versions are exact without being asked
    frame = _parse(source, options, numeric, text, names)
    for key in set(keys) - {*text} if layout.decimal == "," else ():
        frame[key] = _with_points(frame[key])
    frame.index = range(layout.data_line + 1, layout.data_line + 1 + len(frame))
    return frame[~frame.isna().all(axis=1)] if frame.isna().all(axis=1).any() else frame


def _with_points(cells):
    """A column of texts as numbers, where some have a comma and some, such as 0.0, a point."""
    if pd.api.types.is_numeric_dtype(cells) or cells.isna().all():
        return cells
    numbers = pd.to_numeric(cells.str.replace(",", "."), errors="coerce")
    return cells if (numbers.isna() & cells.notna()).any() else numbers.astype(float)


def _parse(source, options, numeric, text, names):
    dtypes = dict.fromkeys(numeric, "float64") | dict.fromkeys(text, str)
    try:
        return pd.read_csv(source.for_pandas, dtype=dtypes, **options)
    except pd.errors.EmptyDataError:
        return pd.DataFrame(columns=options["names"])
    except pd.errors.ParserError as error:
        line = re.search(r"line (\d+)", str(error))
        raise DataError(
            f"the rows cannot be told apart: {str(error).strip()}",
            file=source.path, row=int(line.group(1)) if line else None,
            remedy="every row needs as many cells as the header, and quotes must close",
        ) from error  # fmt: skip
    except (ValueError, OverflowError):
        return _parse_slowly(source, options, numeric, names)


def _parse_slowly(source, options, numeric, names):
    """Read all cells as text to find the one that is no number; dates are left as they are."""
    options = {k: v for k, v in options.items() if k not in ("decimal", "float_precision")}
    decimal_comma = "," if options["sep"] != "," else None
    frame = pd.read_csv(source.for_pandas, dtype=str, **options)
    for column in numeric:
        cells = frame[column].str.replace("\u2212", "-", regex=False)  # a minus of typesetters
        cells = cells.where(~cells.str.strip().isin(_NO_NUMBER))
        if names[column] == "t" and seconds_of(cells) is not None:
            frame[column] = cells
            continue
        plain = cells.str.replace(decimal_comma, ".", regex=False) if decimal_comma else cells
        numbers = pd.to_numeric(plain, errors="coerce").astype(float)
        bad = (numbers.isna() & cells.notna()).to_numpy()
        if names[column] == "frame" and bad.all() and "t" in names:
            continue  # names of films
        if bad.any():
            row = int(bad.argmax())
            remedy = "write numbers like 1.5 or 2e-3, without units; leave a gap's row out"
            if names[column] == "t":
                remedy += "; write dates as 2024-01-31T12:00:00"
            raise DataError(
                f"expected a number, got {cells.iloc[row]!r:.40}", file=source.path,
                row=options["skiprows"] + 1 + row, column=names[column], remedy=remedy,
            )  # fmt: skip
        frame[column] = numbers
    return frame
