"""What the page was given: one private folder for each data set, films and tables alike."""

import asyncio
import re
import secrets
import threading
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from bsp_gp.errors import DataError, SettingsError

FILMS = (".mp4", ".avi", ".mov", ".m4v", ".mkv", ".webm")
MAX_FILES = 200
MAX_BYTES = 4 * 2**30
_PART = re.compile(r"[^\\/:*?\"<>|\x00-\x1f\x7f]{1,120}")
_TOP = ("trajectories.csv", "entities.csv", "dataset.toml")


@dataclass
class Given:
    """One data set that was dropped.

    Attributes
    ----------
    folder : Path
        Ours; the files lie in its folder ``files``.
    loaded : tuple or None
        Options and the data set that was read with them last.
    glimpse : object
        What a first look at the file gave.
    looks : int
        How often a check was asked for; only the last one is of use.
    """

    key: str
    folder: Path
    n_bytes: int = 0
    n_files: int = 0
    loaded: tuple | None = None
    glimpse: object = None
    looks: int = 0
    looking: asyncio.Lock = field(default_factory=asyncio.Lock, repr=False)
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def files(self):
        return self.folder / "files"

    @property
    def tracked(self):
        """The data set that was tracked in a film, if it was."""
        return self.folder / "track"

    @property
    def path(self):
        """What the commands are given: the lone file, or the folder of the data set."""
        found = [p for p in sorted(self.files.rglob("*")) if p.is_file()]
        if not found:
            raise DataError("no file has come", remedy="drop a file, or a folder with tables")
        if len(found) == 1 and found[0].name not in _TOP[1:]:
            return found[0]
        for each in found:
            if each.name == _TOP[0]:
                return each.parent
        names = ", ".join(p.name for p in found[:5])
        raise DataError(
            f"several files have come ({names}), and none is {_TOP[0]}",
            remedy="drop one table, or the folder of a data set",
        )

    @property
    def is_film(self):
        return self.path.suffix.lower() in FILMS

    @property
    def data(self):
        """What is read as a data set: a film is so once it was tracked."""
        if not self.is_film:
            return self.path
        if not self.tracked.is_dir():
            raise DataError("this is a film", remedy="say what is to be followed in it first")
        return self.tracked

    def place(self, name):
        """Where a file of this name goes, inside of the folder whatever the name says.

        Raises
        ------
        DataError
            A name that is none, or too many files.
        """
        parts = PurePosixPath(name).parts
        fits = all(_PART.fullmatch(p) and p.strip(". ") and p[0] != "-" for p in parts)
        if not 1 <= len(parts) <= 6 or not fits:
            raise DataError(
                f"a file may not be called {name[:60]!r}", remedy="rename it: letters and digits"
            )
        if self.n_files >= MAX_FILES:
            raise DataError(f"a data set has at most {MAX_FILES} files", remedy="drop fewer")
        path = self.files.joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.n_files += 1
        return path

    def count(self, n_bytes):
        """Count bytes that came; DataError beyond what is read."""
        self.n_bytes += n_bytes
        if self.n_bytes > MAX_BYTES:
            raise DataError(
                f"more than {MAX_BYTES / 2**30:g} GB are not read here",
                remedy="give the file to bsp-gp in a terminal",
            )

    def dataset(self, options):
        """The data set as read with these options; kept until they change."""
        from dataclasses import replace

        from bsp_gp.data.tables import load_dataset

        with self.lock:
            key = repr((options, str(self.data)))
            if self.loaded is None or self.loaded[0] != key:
                rest = {k: v for k, v in options.items() if k != "up"}
                dataset = load_dataset(self.data, **rest)
                if options.get("up"):
                    dataset = replace(dataset, up=options["up"])
                self.loaded = (key, dataset)
            return self.loaded[1]


class Store:
    """Everything that was dropped, by key."""

    def __init__(self, folder):
        self.folder = Path(folder)
        self.given = {}

    def new(self):
        """Make room for another data set."""
        key = secrets.token_hex(8)
        given = Given(key, self.folder / key)
        given.files.mkdir(parents=True)
        self.given[key] = given
        return given

    def __getitem__(self, key):
        if key not in self.given:
            raise SettingsError("this data set is not here; drop it again")
        return self.given[key]
