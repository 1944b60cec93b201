"""Delimited text as programs export it: delimiter, decimal sign, titles and units are sniffed.

Read here: plain CSV, exports of Tracker (one mass or several side by side) and of loggers, and
long tables of trackpy. The result is one `Table` whatever the dialect was.
"""

from __future__ import annotations

import codecs
import csv
import hashlib
import re
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from bsp_gp.data.cells import plain_cell
from bsp_gp.data.sniffing import (
    DELIMITER_NAMES,
    TEXT_COLUMNS,
    number_columns,
    sniff,
    split_line,
)
from bsp_gp.errors import DataError

__all__ = ["Table", "read_table"]

MAX_BYTES = 4 * 2**30
MAX_ROWS = 20_000_000
_NAN = ["", "nan", "NaN", "NAN", "NA", "N/A", "null"]
_HEAD_LINES = 60


@dataclass(frozen=True)
class Table:
    """A delimited file as read.

    Attributes
    ----------
    frame : pandas.DataFrame
        Known columns under our names; the index is the line number in the file.
    units : dict of str to str
        Units found in the header.
    renamed : frozenset of str
        The renames of the caller that applied.
    file : str
    digest : str
        SHA-256 of the file.
    title : str or None
        The single title line above the header (Tracker writes the name of the mass there).
    decimal : str
    notes : tuple of str
    """

    frame: pd.DataFrame
    units: dict = field(default_factory=dict)
    renamed: frozenset = frozenset()
    file: str | None = None
    digest: str = ""
    title: str | None = None
    decimal: str = "."
    notes: tuple[str, ...] = ()


def read_table(path, *, rename=None, as_text=False):
    """Read a delimited file with a header.

    Parameters
    ----------
    path : path-like
    rename : mapping of str to str, optional
        Our name of a column -> its name in the file.
    as_text : bool
        Leave every cell a text (for ``entities.csv``, whose columns are the user's own).

    Returns
    -------
    Table

    Raises
    ------
    DataError
        Whatever is wrong with the file, with its line and column.
    """
    path = Path(path)
    digest, counts = _inspect(path)
    with path.open(encoding="utf-8-sig", newline=None) as stream:
        head = [line.rstrip("\n") for _, line in zip(range(_HEAD_LINES), stream, strict=False)]
    marks = ("entity",) if as_text else ("t", "frame")
    try:
        layout = sniff(head, dict(rename or {}), marks, path)
        _require_even_rows(path, layout, head, counts)
    except csv.Error as error:  # such as a cell of more than 131,072 characters
        raise DataError(
            f"the rows cannot be told apart: {error}",
            file=path, remedy="is it a table, with one row per time and entity?",
        ) from None  # fmt: skip
    groups = () if as_text else _mass_groups(layout, path)
    frame, notes = _read_frame(path, layout, groups, as_text)
    frame, notes = _drop_unnamed(frame, notes)
    if frame.empty:
        raise DataError(
            "the file has a header but no rows", file=path, row=layout.header_line + 1,
            remedy="one row per time and entity is needed",
        )  # fmt: skip
    for column in (c for c in TEXT_COLUMNS if c in frame.columns):
        frame[column] = frame[column].map(plain_cell)
    if groups:
        frame = _stack_masses(frame, groups, path)
    cells = [cell for cell in layout.title_cells if cell]
    has_title = layout.header_line == 1 and len(cells) == 1 and not groups
    title = re.sub(r"^#?\s*(?:name:)?\s*", "", cells[0])[:60] if has_title else None
    return Table(
        frame=frame,
        units=layout.units,
        renamed=layout.renamed,
        file=str(path),
        digest=digest,
        title=title or None,
        decimal=layout.decimal,
        notes=tuple(notes),
    )


def _inspect(path):
    """SHA-256 and counts of delimiters, after the checks that need every byte."""
    if not path.is_file():
        raise DataError("there is no such file", file=path, remedy="check the path")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise DataError(
            f"the file has {size / 2**30:.1f} GB; at most {MAX_BYTES / 2**30:g} GB are read",
            file=path, remedy="split it into several data sets",
        )  # fmt: skip
    digest = hashlib.sha256()
    decoder = codecs.getincrementaldecoder("utf-8")()
    counts = dict.fromkeys((b",", b";", b"\t", b"\n", b'"'), 0)
    is_blank = True
    with path.open("rb") as stream:
        while chunk := stream.read(1 << 22):
            if chunk[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in chunk:
                _fail_encoding(path, None, "UTF-16")
            try:
                decoder.decode(chunk)
            except UnicodeDecodeError as error:
                _fail_encoding(path, counts[b"\n"] + chunk[: error.start].count(b"\n") + 1)
            digest.update(chunk)
            is_blank = is_blank and not chunk.replace(b"\xef\xbb\xbf", b"").strip()
            for mark in counts:
                counts[mark] += chunk.count(mark)
    try:
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        _fail_encoding(path, counts[b"\n"] + 1)
    if is_blank:
        raise DataError("the file is empty", file=path, remedy="a header and rows are needed")
    n_rows = counts[b"\n"]
    if n_rows > MAX_ROWS:
        raise DataError(
            f"the file has {n_rows:,} rows; at most {MAX_ROWS:,} are read",
            file=path, remedy="thin it out or split it into several data sets",
        )  # fmt: skip
    return digest.hexdigest(), counts


def _fail_encoding(path, line, name="WINDOWS-1252"):
    raise DataError(
        "the text is not UTF-8", file=path, row=line,
        remedy=f"save it as 'CSV UTF-8', or convert it: iconv -f {name} -t UTF-8 in > out",
    )  # fmt: skip


def _require_even_rows(path, layout, head, counts):
    """Name the first row whose number of cells differs; a file that adds up is not scanned."""
    if layout.delimiter is None:
        return
    n_cells = len(layout.names)
    mark = layout.delimiter.encode()
    above = head[: layout.data_line]
    n_marks = counts[mark] - sum(line.count(layout.delimiter) for line in above)
    n_rows = counts[b"\n"] - len(above)
    if counts[b'"'] == 0 and n_marks in (n_rows * (n_cells - 1), (n_rows + 1) * (n_cells - 1)):
        first = head[layout.data_line : layout.data_line + 1]
        if not first or len(split_line(first[0], layout.delimiter)) == n_cells:
            return
    with path.open(encoding="utf-8-sig", newline="") as stream:
        for line, row in enumerate(csv.reader(stream, delimiter=layout.delimiter), start=1):
            if line <= layout.data_line or not any(cell.strip() for cell in row):
                continue
            if len(row) != n_cells:
                raise DataError(
                    f"this row has {len(row)} cells, the header has {n_cells} "
                    f"({DELIMITER_NAMES[layout.delimiter]} between them)",
                    file=path, row=line, remedy="every row needs as many cells as the header",
                )  # fmt: skip


def _mass_groups(layout, path):
    """Column positions and a name for every mass of a side-by-side export, else ()."""
    names = layout.names
    where = {name: [k for k, n in enumerate(names) if n == name] for name in ("t", "x", "y", "z")}
    n_groups = len(where["x"])
    if n_groups < 2 or len(where["y"]) != n_groups or len(where["t"]) not in (1, n_groups):
        return ()
    if "entity" in names or len(where["z"]) not in (0, n_groups):
        return ()
    own_time = len(where["t"]) == n_groups
    starts = where["t"] if own_time else where["x"]
    titles = [cell for cell in layout.title_cells if cell]
    groups = []
    for k in range(n_groups):
        stop = starts[k + 1] if k + 1 < n_groups else len(names)
        label = next((c for c in layout.title_cells[starts[k] : stop] if c), None)
        if len(titles) == n_groups:
            label = titles[k]
        columns = {axis: where[axis][k] for axis in ("x", "y", "z") if where[axis]}
        columns["t"] = where["t"][k if own_time else 0]
        groups.append((re.sub(r"^#?\s*", "", label) if label else f"mass_{k + 1}", columns))
    labels = [label for label, _ in groups]
    if len(set(labels)) != len(labels):
        raise DataError(f"two masses have one name: {labels}", file=path, row=layout.header_line)
    return tuple(groups)


def _read_frame(path, layout, groups, as_text):
    names = layout.names
    if groups:
        keys = [f"{name}.{k}" for k, name in enumerate(names)]
    else:
        duplicated = sorted({n for n in names if n and names.count(n) > 1})
        if duplicated:
            raise DataError(
                f"the header names {duplicated[0]!r} twice", file=path,
                row=layout.header_line + 1, column=duplicated[0],
                remedy="every column needs a name of its own",
            )  # fmt: skip
        keys = [name or f"Unnamed: {k}" for k, name in enumerate(names)]
    numeric = [
        key for key, name in zip(keys, names, strict=True)
        if not as_text and name in number_columns(names)
    ]  # fmt: skip
    text = [k for k, n in zip(keys, names, strict=True) if as_text or n in TEXT_COLUMNS]
    options = {
        "sep": r"\s+" if layout.delimiter is None else layout.delimiter,
        "names": keys,
        "header": None,
        "skiprows": layout.data_line,
        "skip_blank_lines": False,
        "skipinitialspace": True,
        "keep_default_na": False,
        "na_values": {key: [""] if key in text else _NAN for key in keys},
        "decimal": layout.decimal,
        "encoding": "utf-8-sig",
        "compression": None,  # it was read as text so far, whatever its name ends in
        "low_memory": False,
    }
    if _pandas_version() < (3, 1):
        options["float_precision"] = "round_trip"  # later versions are exact without being asked
    frame = _parse(path, options, numeric, text)
    frame.index = range(layout.data_line + 1, layout.data_line + 1 + len(frame))
    frame = frame[~frame.isna().all(axis=1)] if frame.isna().all(axis=1).any() else frame
    notes = [
        f"{path.name}: column {name!r} is not used"
        for name in names
        if not as_text and name and name not in number_columns(names) + TEXT_COLUMNS
    ]
    return frame, notes


def _pandas_version():
    return tuple(int(part) for part in re.findall(r"\d+", pd.__version__)[:2])


def _parse(path, options, numeric, text):
    dtypes = dict.fromkeys(numeric, "float64") | dict.fromkeys(text, str)
    try:
        return pd.read_csv(path, dtype=dtypes, **options)
    except pd.errors.EmptyDataError:
        return pd.DataFrame(columns=options["names"])
    except pd.errors.ParserError as error:
        line = re.search(r"line (\d+)", str(error))
        raise DataError(
            f"the rows cannot be told apart: {str(error).strip()}",
            file=path, row=int(line.group(1)) if line else None,
            remedy="every row needs as many cells as the header, and quotes must close",
        ) from error  # fmt: skip
    except (ValueError, OverflowError):
        return _parse_slowly(path, options, numeric)


def _parse_slowly(path, options, numeric):
    """Read all cells as text to find the one that is no number."""
    options = {k: v for k, v in options.items() if k not in ("decimal", "float_precision")}
    decimal_comma = "," if options["sep"] != "," else None
    frame = pd.read_csv(path, dtype=str, **options)
    for column in numeric:
        cells = frame[column].where(frame[column].str.strip() != "")  # blanks are no value
        plain = cells.str.replace(decimal_comma, ".", regex=False) if decimal_comma else cells
        numbers = pd.to_numeric(plain, errors="coerce").astype(float)
        bad = (numbers.isna() & cells.notna()).to_numpy()
        if bad.any():
            row = int(bad.argmax())
            raise DataError(
                f"expected a number, got {cells.iloc[row]!r:.40}",
                file=path, row=options["skiprows"] + 1 + row, column=column.split(".")[0],
                remedy="write numbers like 1.5 or 2e-3, without units; leave a gap's row out",
            )  # fmt: skip
        frame[column] = numbers
    return frame


def _drop_unnamed(frame, notes):
    for column in [c for c in frame.columns if str(c).startswith("Unnamed: ")]:
        if frame[column].notna().any():
            notes = [*notes, "a column without a name is not used"]
        frame = frame.drop(columns=column)
    return frame, notes


def _stack_masses(frame, groups, path):
    """One long table from masses side by side; a mass without coordinates is absent there."""
    pieces = []
    for label, columns in groups:
        keys = {f"{axis}.{k}": axis for axis, k in columns.items()}
        piece = frame[list(keys)].rename(columns=keys)
        axes = [axis for axis in columns if axis != "t"]
        piece = piece[~piece[axes].isna().all(axis=1)]
        pieces.append(piece.assign(entity=label))
    stacked = pd.concat(pieces)
    if stacked.empty:
        raise DataError("no mass has any coordinates", file=path)
    return stacked
