"""Where the text of a table comes from: a text file in its encoding, or a sheet of a workbook."""

import codecs
import contextlib
import csv
import hashlib
import io
import itertools
import re
from dataclasses import dataclass, replace
from pathlib import Path

from bsp_gp.data import arrays, gps, molecules
from bsp_gp.data.header_lines import tabbed
from bsp_gp.data.headings import is_run
from bsp_gp.data.notes import listed
from bsp_gp.data.preambles import has_preamble, without_preamble
from bsp_gp.data.records import ENDINGS as RECORDS
from bsp_gp.data.records import as_table
from bsp_gp.data.words import n_known_words
from bsp_gp.data.zipped import is_book, is_zip, unpacked
from bsp_gp.errors import DataError, MissingDependencyError

MAX_BYTES = 4 * 2**30
MAX_ROWS = 20_000_000
_MARKS = (b",", b";", b"\t", b"\n", b'"', b"#")
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0e-\x1f\x7f]")
_UTF_8 = re.compile(rb"[\xc2\xc3][\x80-\xbf]|\xe2[\x80-\xbf]{2}")
"""Letters and signs of the West in UTF-8."""
_OWN_FORMATS = {
    ".cmbl": "a file of Logger Pro; there, choose File > Export As > CSV",
    ".gambl": "a file of Graphical Analysis; there, choose Export > CSV",
    ".cap": "a file of Capstone; there, choose File > Export Data",
    ".spklab": "a file of SPARKvue; there, choose Export Data",
    ".phyphox": "an experiment of phyphox; there, choose Export Data > CSV",
    ".labx": "a file of CASSY Lab 2; there, choose File > Export as a text (.txt)",
    ".c3d": "a binary file of motion capture; export it there as .trc or CSV",
}
"""What other programs keep for themselves, and how to get a table out of them."""
_ENCODINGS = ("cp1252", "cp1250", "cp1251", "gb18030", "big5", "shift_jis", "euc_kr", "cp1253",
              "mac_roman", "cp437")  # fmt: skip
_HEAD_BYTES = 1 << 14
_NUMBER = re.compile(r"[-+\d.,eE]+")
_OPENED = re.compile(r"(?:\w+\s*=\s*)?[\[(]+\s*[-+]?\.?\d[-+\d.,;eE\s\])]*")
"""The first row of a matrix: ``[ 0 0.0 2;``, ``data = [1, 2``, ``[[0.1 0.2]``."""
_OPENING = re.compile(r"(?:\w+\s*=\s*)?[\[(]+")
_WORKBOOKS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")


@dataclass(frozen=True)
class Source:
    """A table as text.

    Attributes
    ----------
    digest : str
        SHA-256 of the file.
    counts : dict of bytes to int
        How often delimiters occur.
    text : str or None
        The whole text, where the file is not text itself.
    is_of_sheets : bool
        Whether its first column, ``scene``, is made of the names of sheets.
    """

    path: Path
    digest: str
    counts: dict
    encoding: str = "utf-8-sig"
    text: str | None = None
    notes: tuple[str, ...] = ()
    is_of_sheets: bool = False

    def open(self, newline=None):
        """A stream of the text."""
        if self.text is not None:
            return io.StringIO(self.text, newline=newline)
        return self.path.open(encoding=self.encoding, newline=newline)

    def head(self, count):
        """The first lines, without their ends; all of them where `count` is None."""
        with self.open() as stream:
            return [line.rstrip("\n") for line in itertools.islice(stream, count)]

    def read(self):
        """The whole text."""
        with self.open() as stream:
            return stream.read()

    def with_text(self, text, *notes):
        """The same with another text, and notes of it."""
        _require_rows(self.path, text.count("\n"))
        return replace(self, text=text, counts=_counts(text), notes=(*self.notes, *notes))

    @property
    def for_pandas(self):
        return self.path if self.text is None else io.StringIO(self.text)

    def without_brackets(self, head):
        """The same without the brackets of a matrix around its rows, as MATLAB and numpy print it.

        They are told by `head`, the first lines.
        """
        first = next((k for k, line in enumerate(head) if _OPENED.fullmatch(line.strip())), None)
        if first is None:
            return self
        lines = self.read().split("\n")
        last = next((k for k in range(len(lines) - 1, first, -1) if lines[k].strip()), first)
        if "]" not in lines[last]:
            return self
        for k in range(first, last + 1):
            line = lines[k].strip().removesuffix(",").rstrip(" \t;])")
            lines[k] = line[_OPENING.match(line).end() :] if _OPENING.match(line) else line
        note = f"brackets around the rows are left out, from line {first + 1} on"
        return self.with_text("\n".join(lines), note)

    def without_comments(self, above):
        """The same with blank lines for comments (#) below the header, where few lines are; a note.

        Rows that someone has taken out of a table so are no rows. `above` are the lines down to the
        header.
        """
        if self.counts[b"#"] <= sum(line.count("#") for line in above):
            return self  # the text is read once more only where there are some
        first = len(above)
        lines = self.read().split("\n")
        found = [k for k in range(first, len(lines)) if lines[k].lstrip().startswith("#")]
        if not found or 2 * len(found) > len(lines) - first:
            return self
        for k in found:
            lines[k] = ""
        note = f"lines that begin with # are no rows: {len(found)}, the first is {found[0] + 1}"
        return self.with_text("\n".join(lines), note)


def open_source(path, names=()):
    """The source of a table.

    `names` are columns that the caller knows: where only the file's own header has them, what a
    program wrote is not turned into a plain table.

    Raises
    ------
    DataError
        If there is no file, it is too large, or it is no text.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError("there is no such file", file=path, remedy="check the path")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise DataError(
            f"the file has {size / 2**30:.1f} GB; at most {MAX_BYTES / 2**30:g} GB are read",
            file=path, remedy="split it into several data sets",
        )  # fmt: skip
    if path.suffix.lower() in _OWN_FORMATS:
        raise DataError(
            "this format is not read", file=path,
            remedy=f"it is {_OWN_FORMATS[path.suffix.lower()]}, and give that file",
        )  # fmt: skip
    if path.suffix.lower() in _WORKBOOKS:
        return _workbook(path)
    if path.suffix.lower() in arrays.ENDINGS:
        rows, notes = arrays.as_table(path)
        return Source(path, _digest(path.read_bytes()), {}).with_text(tabbed(rows), *notes)
    if is_zip(path):
        return _workbook(path) if is_book(path) else _of_archive(path, names)
    source = _with_joined_angles(_text_file(path, names))
    kind = path.suffix.lower()
    rows_of = _ROWS_OF.get(kind)
    if kind in molecules.ENDINGS and molecules.is_of_frames(source.head(3)):
        rows_of = molecules.of_xyz
    if rows_of is not None:
        rows, notes = rows_of(source.read(), path)
        return source.with_text(tabbed(rows), *notes)
    if kind in RECORDS or _begins_as_records(source):
        return source.with_text(as_table(source.read(), path))
    return source


_ROWS_OF = {**dict.fromkeys(gps.ENDINGS, gps.of_xml), gps.OF_GLIDERS: gps.of_igc}
"""What reads files of an ending: text and path to rows and notes."""


def _digest(content):
    return hashlib.sha256(content).hexdigest()


def _of_archive(path, names):
    """The source of the one table in an archive."""
    with unpacked(path) as (file, note):
        try:
            if is_zip(file) and not is_book(file):
                raise DataError("it is a ZIP archive itself", remedy="unpack both")
            source = open_source(file, names)
            text = source.read()
        except DataError as error:
            raise DataError(
                error.problem, file=f"{path}, {file.name} in it", row=error.row,
                column=error.column, remedy=error.remedy,
            ) from None  # fmt: skip
    digest = _digest(path.read_bytes())
    return Source(path, digest, _counts(text), text=text, notes=(note, *source.notes))


def _begins_as_records(source):
    """Whether a text of another ending is JSON all the same."""
    with source.open() as stream:
        return stream.read(200).lstrip()[:2] in ('{"', "[{", "[\n", "{\n")


def _text_file(path, names):
    """SHA-256, encoding and counts of delimiters, after the checks that need every byte."""
    digest = hashlib.sha256()
    decoder = codecs.getincrementaldecoder("utf-8")()
    counts = dict.fromkeys(_MARKS, 0)
    is_blank = True
    bad_line = None
    with path.open("rb") as stream:
        for number, chunk in enumerate(_chunks(stream)):
            if number == 0 and chunk.startswith(_UTF_16):
                return _utf_16(path, names)
            if b"\x00" in chunk:
                _fail_encoding(path, None, "UTF-16")
            digest.update(chunk)
            try:
                if bad_line is None:
                    decoder.decode(chunk)
            except UnicodeDecodeError as error:
                bad_line = counts[b"\n"] + error.object[: error.start].count(b"\n") + 1
            body = chunk.removeprefix(codecs.BOM_UTF8) if number == 0 else chunk
            is_blank = is_blank and not body.strip()
            for mark in counts:
                counts[mark] += chunk.count(mark)
    try:
        decoder.decode(b"", final=bad_line is None)
    except UnicodeDecodeError:
        _fail_encoding(path, counts[b"\n"] + 1)
    if is_blank:
        raise DataError("the file is empty", file=path, remedy="a header and rows are needed")
    _require_rows(path, counts[b"\n"])
    if bad_line is None:
        return _told_apart(Source(path, digest.hexdigest(), counts), names)
    encoding = _encoding_by_words(path) or ("cp1252" if _is_windows(path) else "")
    if not encoding:
        _fail_encoding(path, bad_line)
    told = f"{encoding}, by its words"
    told = "Windows-1252, as Excel writes it" if encoding == "cp1252" else told
    note = f"{path.name} is not UTF-8: read as {told}"
    return _told_apart(Source(path, digest.hexdigest(), counts, encoding, notes=(note,)), names)


_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def _utf_16(path, names):
    """The source of a file in UTF-16 that says so by its first bytes, as Windows writes it."""
    content = path.read_bytes()
    try:
        text = content.decode("utf-16").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        _fail_encoding(path, line, "UTF-16")
    if "\x00" in text:
        _fail_encoding(path, None, "UTF-32")
    if not text.strip():
        raise DataError("the file is empty", file=path, remedy="a header and rows are needed")
    _require_rows(path, text.count("\n"))
    return _told_apart(Source(path, _digest(content), _counts(text), text=text), names)


def _counts(text):
    return {mark: text.count(mark.decode()) for mark in _MARKS}


def _told_apart(source, names):
    """The source itself, or the plain table below the preamble of a program."""
    source = _without_numbered_names(source, names)
    with source.open() as stream:
        head = stream.read(_BEGIN)
        if not has_preamble(head):
            return source
        text = head + stream.read()
    plain, notes = without_preamble(text, source.path)
    header = plain.split("\n", 1)[0].split("\t")
    own = set(names) - {*header, *(cell.rpartition(" (")[0] for cell in header)}
    if plain == text or own and any(own <= _cells_of(line) for line in text.splitlines()[:_HEADER]):
        return source
    return source.with_text(plain, *notes)


_NUMBERED = re.compile(r'("?Column\d+"?[,;\t]?)+\s*')


def _without_numbered_names(source, names):
    """The source with a blank line for ``Column1,Column2``, which Excel puts above what it loads.

    Below it stand a program's or the table's own names, or the caller's (`names`) do.
    """
    first, second = [*source.head(2), "", ""][:2]
    is_row = any(_NUMBER.fullmatch(cell) and re.search(r"\d", cell) for cell in _cells_of(second))
    if is_row or not _NUMBERED.fullmatch(first):
        return source
    if {*names} & _cells_of(first):
        return source
    note = "line 1 (Column1, Column2 ...) is of a spreadsheet, and names nothing"
    return source.with_text(source.read().removeprefix(first), note)


_ANGLES = {("RAh", "RAm", "RAs"): "ra", ("DE-", "DEd", "DEm", "DEs"): "dec"}
"""Columns of one angle side by side, as tables of the CDS have them."""


def _with_joined_angles(source):
    """The source with one column in the place of those that are one angle, and a note."""
    head, parts = source.head(_HEADER), next(iter(_ANGLES))
    told = (k for k, line in enumerate(head) if parts[0] in line)  # a few, if any
    number = next((k for k in told if _cells_of(_bare(head[k])) >= {*parts}), None)
    if number is None:
        return source
    mark = max("\t,;", key=head[number].count)
    with source.open(newline="") as stream:
        rows = [*csv.reader(stream, delimiter=mark)]
    for parts, name in _ANGLES.items():
        names, n = [_bare(cell).strip() for cell in rows[number]], len(parts)
        k = next((k for k in range(len(names)) if tuple(names[k : k + n]) == parts), None)
        for row in rows[number:] if k is not None else ():
            signed = ["".join(row[k : k + n - 2]).strip(), *row[k + n - 2 : k + n]]
            row[k : k + n] = [" ".join(signed).strip() if row is not rows[number] else name]
    out = io.StringIO()
    csv.writer(out, delimiter=mark, lineterminator="\n").writerows(rows)
    return source.with_text(out.getvalue(), f"columns such as {', '.join(parts)} are one angle")


def _bare(text):
    """A text without what stands in round brackets."""
    return re.sub(r"\s*\([^()]*\)", "", text)


_BEGIN = 2000
"""Characters by which the files of programs are known."""
_HEADER = 60
"""Lines among which the names of the columns are looked for."""


def _cells_of(line):
    return {cell.strip() for mark in "\t,;" for cell in line.split(mark)}


def _encoding_by_words(path):
    """The encoding in which most words of the first lines are words of headings; "" without any.

    Only letters outside of ASCII tell them apart.
    """
    with path.open("rb") as stream:
        head = b"\n".join(stream.read(_HEAD_BYTES).split(b"\n")[:_HEADER])
    counts = {}
    for encoding in _ENCODINGS:
        with contextlib.suppress(UnicodeDecodeError):
            counts[encoding] = n_known_words(head.decode(encoding))
    best = max(counts, key=counts.get, default="")
    return best if counts.get(best) and _reads(path, best) else ""


def _chunks(stream):
    """What a stream has, a part at a time."""
    while chunk := stream.read(1 << 22):
        yield chunk


def _reads(path, encoding):
    """Whether a whole file is text in an encoding."""
    try:
        with path.open(encoding=encoding) as stream:
            return sum(1 for _ in _chunks(stream)) > 0
    except UnicodeDecodeError:
        return False


def _is_windows(path):
    """Whether all bytes are letters and signs of Windows-1252, and none looks like UTF-8."""
    with path.open("rb") as stream:
        is_odd = any(_CONTROL.search(chunk) or _UTF_8.search(chunk) for chunk in _chunks(stream))
    return not is_odd and _reads(path, "cp1252")


def _require_rows(path, n_rows):
    if n_rows > MAX_ROWS:
        raise DataError(
            f"the file has {n_rows:,} rows; at most {MAX_ROWS:,} are read",
            file=path, remedy="thin it out or split it into several data sets",
        )  # fmt: skip


def _fail_encoding(path, line, name="WINDOWS-1252"):
    raise DataError(
        "the text is not UTF-8", file=path, row=line,
        remedy=f"save it as 'CSV UTF-8', or convert it: iconv -f {name} -t UTF-8 in > out",
    )  # fmt: skip


def _workbook(path):
    """The first sheet of a workbook that has rows, as text with tabs."""
    try:
        from python_calamine import CalamineError, CalamineWorkbook
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: reading a workbook needs python-calamine: pip install python-calamine, or "
            "save it as CSV UTF-8"
        ) from error
    try:
        content = path.read_bytes()
        with CalamineWorkbook.from_filelike(io.BytesIO(content)) as book:
            names = book.sheet_names
            sheets = {n: _rows(path, book.get_sheet_by_name(n).to_python()) for n in names}
    except (CalamineError, ValueError, OSError) as error:
        raise DataError(
            f"this is no workbook that can be read ({error})", file=path,
            remedy="save it as .xlsx anew, or as CSV UTF-8",
        ) from error  # fmt: skip
    filled = [title for title, rows in sheets.items() if rows]
    if not filled:
        raise DataError("the workbook is empty", file=path, remedy="a header and rows are needed")
    whole, sheets = sheets, _with_headers(sheets, filled)
    made = f"no header: columns read as {', '.join(sheets[filled[0]][0])}"
    alike = _with_one_header(sheets, filled)
    rows = sheets[filled[0]]
    if len(alike) > 1:  # recordings, each called like its sheet
        rows = [["scene", *rows[0]], *([n, *row] for n in alike for row in sheets[n][1:])]
    text = tabbed(rows)
    unread = [title for title in filled if title not in (alike or filled[:1])]
    told = listed(list(map(repr, unread)))
    notes = (f"of {path.name} the sheet {filled[0]!r} is read, not {told}",) if unread else ()
    if len(alike) > 1:
        more = f", not {told}" if unread else ""
        notes = (f"{len(alike)} sheets of {path.name} with one header are recordings{more}",
                 *[made] * (whole is not sheets))  # fmt: skip
    return Source(path, _digest(content), _counts(text), text=text, notes=notes,
                  is_of_sheets=len(alike) > 1)  # fmt: skip


def _with_headers(sheets, filled):
    """Sheets called after runs, of numbers alone, with the headings that such a table gets.

    What stands beside the numbers, and is none, is a legend.
    """
    bare = {title: _without_legend(rows) for title, rows in sheets.items()}
    widths = {len(row) for title in filled for row in bare[title]}
    is_bare = len(filled) > 1 and all(map(is_run, filled)) and widths <= {2, 3, 4}
    cells = [cell for title in filled for row in bare[title] for cell in row]
    if not (is_bare and len(widths) == 1 and all(map(_NUMBER.fullmatch, cells))):
        return sheets
    header = ["t", "x", "y", "z"][: widths.pop()]
    return {title: [header, *rows] if rows else rows for title, rows in bare.items()}


def _without_legend(rows):
    """Rows up to the first column without a number, where none behind it has one."""
    are_numbers = [[bool(_NUMBER.fullmatch(cell)) for cell in row] for row in rows]
    has_numbers = list(map(any, zip(*are_numbers, strict=True)))
    width = has_numbers.index(False) if False in has_numbers else len(has_numbers)
    return rows if any(has_numbers[width:]) else [row[:width] for row in rows]


def _with_one_header(sheets, filled):
    """Names of the sheets whose first rows are names, the same in all; those of the first one."""
    header = [sheets[title][0] for title in filled]
    names = [cell for cell in header[0] if cell]
    is_named = len(names) > 1 and not any(map(_NUMBER.fullmatch, names))
    alike = [title for title, row in zip(filled, header, strict=True) if row == header[0]]
    has_own = any(cell.strip().lower() in ("scene", "run") for cell in names)
    return alike if is_named and not has_own else []


def _rows(path, cells):
    """Rows of cells as texts, all of one length, without empty ones at the end."""
    _require_rows(path, len(cells))
    rows = [[_cell(cell) for cell in row] for row in cells]
    while rows and not any(rows[-1]):
        rows.pop()
    width = max((k + 1 for row in rows for k, cell in enumerate(row) if cell), default=0)
    return [[*row, *[""] * width][:width] for row in rows]


def _cell(value):
    if hasattr(value, "isoformat"):
        return value.isoformat()
    if isinstance(value, float):  # as are all numbers of a sheet
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return str(value).replace("\n", " ").strip()
