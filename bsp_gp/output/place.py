"""The place that a result goes to: checked and locked before the work, filled whole after it."""

import contextlib
import os
import threading
from contextlib import contextmanager
from pathlib import Path

from bsp_gp.errors import OutputError
from bsp_gp.output.journal import finish
from bsp_gp.output.lock import take_lock
from bsp_gp.output.mark import MARK, mark_folder, read_mark
from bsp_gp.output.replacing import discard, new_folder, put_in_place, recover, sibling

_HELD: dict = {}
"""Places that this process holds, by path; who holds one may claim it again further in."""


class Place:
    """A folder that is ours to write, from `claim`.

    Attributes
    ----------
    path : Path
        Absolute, without symbolic links.
    kept : list of str
        What is not ours in it and was left there when an older result was replaced.
    """

    def __init__(self, path):
        self.path = path
        self.kept = []
        self.holder = threading.get_ident()

    @contextmanager
    def fill(self, kind, overwrite=False):
        """Write the folder whole or not at all: a new one, which takes its place at the end.

        An older result of this kind may give way if `overwrite` is set.

        Yields
        ------
        Path
            An empty folder.

        Raises
        ------
        OutputError
            If something cannot be written; what was there is there.
        """
        with told(self.path):
            fresh = new_folder(self.path)
            try:
                yield fresh
                mark_folder(fresh, kind)
                require_free(self.path, kind, overwrite)
                self.kept += put_in_place(fresh, self.path)
            finally:
                discard(fresh)


@contextmanager
def claim(folder, kind, *, inputs=(), overwrite=False):
    """Hold the place of a result, from before the work until after it is written.

    Parameters
    ----------
    folder : path
        Its parents are made where they are missing.
    kind : str
        Of the result, such as "report": only an older one of the same kind is ever replaced.
    inputs : iterable of path or None
        What the work reads: the place may not be, hold, or lie in any of them.
    overwrite : bool
        Whether an older result may be replaced.

    Yields
    ------
    Place

    Raises
    ------
    OutputError
        If the place cannot be used, holds what is not ours, or another process is writing there.
    """
    with contextlib.ExitStack() as stack:
        with told(folder):
            target = _absolute(folder)
            place = _HELD.get(target)
            if place is None or place.holder != threading.get_ident():
                place = stack.enter_context(_held(target, inputs))
            require_free(target, kind, overwrite)
        yield place


@contextmanager
def _held(target, inputs):
    _require_folder(target)
    for path in inputs:
        if path is not None:
            _require_apart(target, Path(path))
    with _parents(target), _locked(target) as place:
        yield place


@contextmanager
def whole_file(path):
    """Write a file whole or not at all: the path to write to, which takes its place at the end.

    What is there already is replaced; whether it may be is for the caller to check.

    Yields
    ------
    Path
        Beside it, with the same ending.

    Raises
    ------
    OutputError
        If it cannot be written, or another process is writing it.
    """
    path = Path(path)
    part = path.with_name(f".{path.stem}.bsp-gp-part{path.suffix}")
    with told(path):
        lock = take_lock(sibling(path, "lock"), path)
        try:
            yield part
            os.replace(part, path)
        finally:
            with contextlib.suppress(OSError):
                part.unlink()
            lock.release()


@contextmanager
def told(path):
    """What the system refuses, as one sentence."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(f"{path}: cannot be written ({reason}); choose another --out") from error


def _absolute(folder):
    try:
        return Path(folder).expanduser().resolve()
    except RuntimeError:  # Python < 3.13
        raise OutputError(
            f"{folder}: its symbolic links go round in a circle; choose another --out"
        ) from None


@contextmanager
def _locked(target):
    lock = take_lock(sibling(target, "lock"), target)
    try:
        if lock.is_real:  # else nothing is known to be left over
            recover(target)
            finish(target)
        _HELD[target] = Place(target)
        yield _HELD[target]
    finally:
        _HELD.pop(target, None)
        lock.release()


@contextmanager
def _parents(target):
    """Make the folders above; those that stay empty are taken away again."""
    missing = [p for p in target.parents if not p.exists()]
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        for path in missing:
            with contextlib.suppress(OSError):
                path.rmdir()


def _require_folder(target):
    """Refuse what can never hold a result, whatever is in it."""
    if Path.cwd().is_relative_to(target):
        raise OutputError(
            f"{target}: a result needs a folder of its own, and this is or holds the current one; "
            "choose another --out"
        )
    above = next(p for p in (target, *target.parents) if _is_there(p))
    if not above.is_dir():
        what = "is a file" if above == target else f"{above} is a file"
        raise OutputError(f"{target}: {what}, not a folder; choose another --out")
    parent = target.parent if above == target else above
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{target}: {parent} is not writable; choose another --out")


def _is_there(path):
    """Whether something is at a path; complains of links in a circle and of unreadable places."""
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return os.path.islink(path)
    return True


def _require_apart(target, path):
    """Refuse a place that is an input, holds one, or lies in one, by whatever names."""
    for one in _real_paths(path):
        if target == one or _is_within(target, one) or _is_within(one, target):
            how = "is" if target == one else "lies in" if _is_within(target, one) else "holds"
            raise OutputError(
                f"{target}: {how} the input {path}, which is never written to; choose another --out"
            )


def _real_paths(path):
    """Where an input really is, and where what it links to is."""
    paths = [path]
    with contextlib.suppress(OSError):
        if path.is_dir():
            paths += [p for p in path.iterdir() if p.is_symlink()]
    out = []
    for each in paths:
        with contextlib.suppress(OSError, RuntimeError):
            out.append(each.expanduser().resolve())
    return out


def _is_within(path, folder):
    """Whether a folder is a path or above it: by name, and by what the system says it is."""
    if path.is_relative_to(folder):
        return True
    try:
        known = os.stat(folder)
    except OSError:
        return False
    for above in (path, *path.parents):
        with contextlib.suppress(OSError):
            if os.path.samestat(os.stat(above), known):
                return True
    return False


def require_free(target, kind, overwrite=False):
    """Refuse a folder with anything in it but an older result that may be replaced."""
    if not os.path.lexists(target):
        return
    if not target.is_dir():
        raise OutputError(f"{target}: is a file, not a folder; choose another --out")
    names = sorted(n for n in os.listdir(target) if n != f"{MARK}-part")
    if not names:
        return
    mark = read_mark(target)
    if mark is None:
        raise OutputError(
            f"{target}: holds other files ({', '.join(names[:5])}), which are never overwritten; "
            "choose another --out"
        )
    if mark.kind != kind:
        raise OutputError(
            f"{target}: holds a {mark.kind} and not a {kind}, so it is not overwritten; choose "
            "another --out"
        )
    if not overwrite:
        raise OutputError(
            f"{target}: exists already; pass --overwrite to replace this {kind}, or choose "
            "another --out"
        )
