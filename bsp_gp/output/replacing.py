"""One folder in the place of another in a single step, and the tidying up after a killed run.

A new folder is filled beside the place that it is for, under a name that ends in its own number
(inode). Then the two change names in one step, where the system can do so (Linux); elsewhere the
older one steps aside and comes back if the next step fails. So a folder under the name of a new
one whose number is another is the older one, already replaced.
"""

import contextlib
import ctypes
import errno
import filecmp
import os
import shutil
import sys

from bsp_gp.output.mark import MARK, read_mark, strangers, write_mark

_AT_FDCWD, _EXCHANGE = -100, 2
_CANNOT_EXCHANGE = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}
_CANNOT_LINK = {
    errno.EPERM, errno.EXDEV, errno.EMLINK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP,
    errno.EACCES,
}  # fmt: skip


def sibling(target, what):
    """The hidden name beside a target that stands for `what`."""
    return target.with_name(f".{target.name}.bsp-gp-{what}")


def new_folder(target, what="new"):
    """Make the empty folder that is to take the place of `target`."""
    raw = sibling(target, f"{what}-p{os.getpid()}")
    raw.mkdir()
    try:
        named = sibling(target, f"{what}-{raw.stat().st_ino}")
        raw.rename(named)
    except BaseException:
        raw.rmdir()
        raise
    return named


def is_new(folder):
    """Whether a folder is still the one that its name says, and not one that it replaced."""
    return folder.name.endswith(f"-{folder.stat().st_ino}")


def discard(folder):
    """Delete a folder of `new_folder` that was not put in its place."""
    with contextlib.suppress(OSError):
        if is_new(folder):
            shutil.rmtree(folder)


def put_in_place(fresh, target):
    """Give a filled and marked folder its place; what was kept, by its path in the target.

    Parameters
    ----------
    fresh : Path
        Of `new_folder`.
    target : Path
        Missing, an empty folder, or one with a mark, whose files give way. Whatever else it holds
        is there as well afterwards, and at every moment.
    """
    if not os.path.lexists(target):
        os.rename(fresh, target)
        return []
    if not os.listdir(target):
        os.rmdir(target)  # refuses if it was filled just now
        os.rename(fresh, target)
        return []
    kept = prepare(fresh, target)
    old = _swap(fresh, target)
    with contextlib.suppress(OSError):  # the new result is there; the next run clears up
        clear(old, target)
    return kept


def prepare(fresh, target):
    """Have what is not ours in `target` in `fresh` as well, and that on the disk; what that is."""
    if not target.is_dir():
        return []
    mark = read_mark(target)
    if mark is not None and not (target / MARK).exists():  # a report from before there were marks
        write_mark(target, mark)
    kept = [_carry(target, name, fresh) for name in strangers(target, mark)]
    shutil.copymode(target, fresh)
    _flush(fresh)
    return kept


def _swap(fresh, target):
    """Let two folders change places; where the older one is then."""
    if exchange(fresh, target):
        return fresh
    old = sibling(target, f"old-{target.stat().st_ino}")
    os.rename(target, old)
    try:
        os.rename(fresh, target)
    except BaseException:
        os.rename(old, target)
        raise
    return old


def exchange(one, other):
    """Swap two names in one step; False where the system cannot."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):  # another C library, or one from before 2018
        return False
    code = call(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _EXCHANGE)
    if code == 0:
        return True
    number = ctypes.get_errno()
    if number in _CANNOT_EXCHANGE:
        return False
    raise OSError(number, os.strerror(number), os.fspath(other))


def left_over(target, what):
    """What runs that were killed left beside `target` under the names of `what`."""
    start = sibling(target, what).name
    return [target.with_name(n) for n in sorted(os.listdir(target.parent)) if n.startswith(start)]


def recover(target):
    """Bring back or clear away what a killed run left beside `target`, whose lock is held."""
    for path in left_over(target, "old-"):
        if not os.path.lexists(target):
            os.rename(path, target)
    for path in (*left_over(target, "old-"), *left_over(target, "new-")):
        with contextlib.suppress(OSError):  # it is only in the way
            if is_new(path) and ".bsp-gp-new-" in path.name or not (path / MARK).is_file():
                shutil.rmtree(path)  # it never was in its place
            elif target.is_dir() or not strangers(path, read_mark(path)):
                clear(path, target)


def clear(old, target):
    """Delete a folder that was replaced; what is not ours, and not in `target` yet, moves there."""
    # Where the mark is gone, that was done already, and the deleting was cut short.
    for name in strangers(old, read_mark(old)) if (old / MARK).is_file() else ():
        place, is_there = _place_for(old / name, target, name)
        if not is_there:
            place.parent.mkdir(parents=True, exist_ok=True)
            os.rename(old / name, place)
    shutil.rmtree(old)


def _carry(source, name, folder):
    """Have one file of `source` in `folder` too; its name there."""
    place, is_there = _place_for(source / name, folder, name)
    if is_there:
        return place.relative_to(folder).as_posix()
    place.parent.mkdir(parents=True, exist_ok=True)
    if name.endswith("/"):
        place.mkdir()
        return f"{place.relative_to(folder).as_posix()}/"
    try:
        os.link(source / name, place, follow_symlinks=False)
    except OSError as error:
        if error.errno not in _CANNOT_LINK:
            raise
        shutil.copy2(source / name, place, follow_symlinks=False)
    return place.relative_to(folder).as_posix()


def _place_for(path, folder, name):
    """The first free of NAME, NAME.kept, NAME.kept2, ..., or where the same thing is already."""
    place, count = folder / name, 1
    while os.path.lexists(place):
        if _is_same(path, place):
            return place, True
        place = folder / f"{name.rstrip('/')}.kept{count if count > 1 else ''}"
        count += 1
    return place, False


def _is_same(one, other):
    if one.is_symlink() or other.is_symlink():
        both = one.is_symlink() and other.is_symlink()
        return both and os.readlink(one) == os.readlink(other)
    if one.is_dir():
        return other.is_dir()
    if os.path.samefile(one, other):
        return True
    return one.is_file() and other.is_file() and filecmp.cmp(one, other, shallow=False)


def _flush(folder):
    """Have a folder on the disk before another gives way to it: a power cut may come as well."""
    for path in (*folder.rglob("*"), folder):
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            continue
        try:
            handle = os.open(path, os.O_RDONLY)
        except OSError:  # not readable by us, or a folder on Windows
            continue
        try:
            os.fsync(handle)
        except OSError as error:
            if error.errno not in _CANNOT_EXCHANGE:
                raise
        finally:
            os.close(handle)
