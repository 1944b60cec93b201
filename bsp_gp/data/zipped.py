"""A table in a ZIP archive, as phyphox and others export it beside what they know of the device."""

import contextlib
import lzma
import re
import struct
import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from bsp_gp.data import arrays, gps
from bsp_gp.data.notes import listed
from bsp_gp.errors import DataError

BEGIN = b"PK\x03\x04"
MAX_PACKED, MAX_UNPACKED = 128 * 2**20, 512 * 2**20
"""Bytes of an archive, whose list of files is held in memory, and of the table in it."""
_TABLES = (
    ".csv", ".txt", ".tsv", ".dat", ".json", ".jsonl", ".ndjson", ".xlsx", ".xls", ".ods",
    *arrays.ENDINGS, *gps.ENDINGS,
)  # fmt: skip
_BESIDE = frozenset("meta metadata __macosx".split())
"""Folders of what is known of a recording, and is none."""
_ABOUT = re.compile(r"(?i)(?:read[\s_-]?me|liesmich|licen[sc]e|copying|about)\b.*")
_BOOKS = frozenset(("[Content_Types].xml", "mimetype"))
_LISTED = 6
_DAMAGED = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, OSError, EOFError, ValueError,
    OverflowError, NotImplementedError, RuntimeError,
)  # fmt: skip
"""What archives whose bytes are wrong raise."""


def is_zip(path):
    """Whether a file is a ZIP archive, by its content."""
    with path.open("rb") as stream:
        return stream.read(len(BEGIN)) == BEGIN and zipfile.is_zipfile(path)


def is_book(path):
    """Whether an archive is a workbook, or a document of another office program."""
    with _archive(path) as archive:
        return bool(_BOOKS & set(archive.namelist()))


@contextlib.contextmanager
def unpacked(path):
    """The one table of an archive as a file of its own, which goes with the context.

    Yields
    ------
    path : Path
    note : str

    Raises
    ------
    DataError
        There is none or are several, or it is too large, locked or damaged.
    """
    with _archive(path) as archive, tempfile.TemporaryDirectory() as folder:
        member, beside = _table_of(archive, path)
        # Names in archives may lead anywhere: the last part alone is used.
        name = re.sub(r"[^\w.() +-]", "_", PurePosixPath(member.filename).name)[-80:]
        file = Path(folder) / name
        try:
            _unpack(archive, member, file, path)
        except _DAMAGED as bad:
            raise DataError(
                f"{member.filename!r} in this ZIP archive cannot be unpacked ({bad})", file=path,
                remedy="unpack it with another program, and give the table",
            ) from None  # fmt: skip
        more = f"; not read: {listed(beside)}" if beside else ""
        yield file, f"{path.name} is a ZIP archive: {member.filename!r} in it is read{more}"


@contextlib.contextmanager
def _archive(path):
    if path.stat().st_size > MAX_PACKED:
        raise DataError(
            f"the file is a ZIP archive of {path.stat().st_size / 2**20:.0f} MB; at most "
            f"{MAX_PACKED / 2**20:.0f} MB are read", file=path,
            remedy="unpack it, and give the table in it",
        )  # fmt: skip
    try:
        archive = zipfile.ZipFile(path)
    except _DAMAGED as error:
        raise DataError(
            f"the file is a ZIP archive that cannot be read ({error})", file=path,
            remedy="save it anew, or unpack it and give the table in it",
        ) from None  # fmt: skip
    with archive:
        yield archive


def _table_of(archive, path):
    """The entry that is the table, and names of the others."""
    entries = [e for e in archive.infolist() if not e.is_dir()]
    entries = [e for e in entries if not PurePosixPath(e.filename).name.startswith(".")]
    able = [e for e in entries if PurePosixPath(e.filename).suffix.lower() in _TABLES]
    plain = [e for e in able if not _BESIDE & {*PurePosixPath(e.filename.lower()).parts[:-1]}]
    tables = [e for e in plain if not _ABOUT.fullmatch(PurePosixPath(e.filename).name)]
    tables = tables or plain or able
    if not tables:
        held = listed([repr(e.filename) for e in entries], _LISTED) or "nothing"
        raise DataError(
            f"the file is a ZIP archive without a table in it; it holds {held}", file=path,
            remedy="unpack it, and give what is in it",
        )  # fmt: skip
    if len(tables) > 1:
        raise DataError(
            f"the file is a ZIP archive with {len(tables)} tables: "
            f"{listed([repr(e.filename) for e in tables], _LISTED)}", file=path,
            remedy="unpack it, and give one of them; or give a folder that holds nothing but "
            "recordings of one motion, each of which is a scene",
        )  # fmt: skip
    (member,) = tables
    return member, [repr(e.filename) for e in entries if e is not member]


def _unpack(archive, member, file, path):
    """Write an entry to a file, of which what it says of its size is not believed."""
    if member.flag_bits & 1:
        raise DataError(
            f"{member.filename!r} in this ZIP archive is locked by a password", file=path,
            remedy="unpack it, and give the table",
        )  # fmt: skip
    left = MAX_UNPACKED
    with archive.open(member) as packed, file.open("wb") as out:
        while chunk := packed.read(1 << 20):
            left -= len(chunk)
            if left < 0:
                raise DataError(
                    f"{member.filename!r} in this ZIP archive has more than "
                    f"{MAX_UNPACKED / 2**20:.0f} MB", file=path,
                    remedy="unpack it, and give the table, or a part of it",
                )  # fmt: skip
            out.write(chunk)
