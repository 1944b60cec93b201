"""Several results that belong together: all change, or none; after a kill the next run goes on.

They are filled in one folder beside their places. A note in it, written when all are whole, says
what goes where; from then on only what the system refuses turns the change back.
"""

import contextlib
import json
import os
import shutil

from bsp_gp.output import replacing
from bsp_gp.output.mark import MARK, file_digest, read_mark, strangers
from bsp_gp.output.replacing import clear, left_over, prepare

NOTE = ".bsp_gp-note"


def write_note(staged, target, gone):
    """Decide on the change: folders and files in `staged` go beside `target`, `gone` goes away.

    Parameters
    ----------
    staged : Path
        Its entries are named as their places.
    target : Path
        The first of the places.
    gone : iterable of Path
        Older results, of which there is no new one.
    """
    names = sorted(os.listdir(staged), key=lambda name: (name != target.name, name))
    content = {
        "entries": {name: os.lstat(staged / name).st_ino for name in names},
        "gone": {path.name: _digest(path) for path in gone},
    }
    part = staged / f"{NOTE}-part"
    part.write_text(json.dumps(content), encoding="utf-8")
    os.replace(part, staged / NOTE)


def _digest(path):
    return file_digest(path / MARK if path.is_dir() else path)


def carry_out(staged, target):
    """Carry a change out that was decided on, or the rest of it; what is not ours and was kept.

    Raises
    ------
    OSError
        If the system refuses a step; those before it are taken back then.
    """
    content = json.loads((staged / NOTE).read_text(encoding="utf-8"))
    entries = {n: k for n, k in content["entries"].items() if n.startswith(target.name)}
    gone = {n: d for n, d in content["gone"].items() if n.startswith(target.name)}
    kept, done = [], []
    try:
        for name, number in entries.items():
            source, place = staged / name, target.with_name(name)
            if os.path.lexists(source) and source.lstat().st_ino == number:
                found = prepare(source, place)
                kept += found if place == target else [f"{name}/{each}" for each in found]
                step = source, place, staged / f"{name}.old"
                _change(*step)
                done.append(step)
        for name, digest in gone.items():
            place = target.with_name(name)
            if digest and _digest(place) == digest:
                kept += [f"{name}/{each}" for each in _take_away(place, staged / f"{name}.gone")]
    except OSError:
        for each in reversed(done):
            _change_back(*each)
        (staged / NOTE).unlink()
        raise
    for name in entries:
        for old in (staged / name, staged / f"{name}.old"):
            if old.is_dir():
                clear(old, target.with_name(name))
    shutil.rmtree(staged)
    return kept


def _change(source, place, aside):
    """Give a new file or folder its place; an older one is then where it was, or aside."""
    if os.path.lexists(place) and not replacing.exchange(source, place):
        os.rename(place, aside)
    if not os.path.lexists(place):
        try:
            os.rename(source, place)
        except OSError:
            if os.path.lexists(aside):
                os.rename(aside, place)
            raise


def _change_back(source, place, aside):
    if os.path.lexists(aside):
        if os.path.lexists(place):
            os.rename(place, source)
        os.rename(aside, place)
    elif not os.path.lexists(source):
        os.rename(place, source)
    else:
        replacing.exchange(source, place)


def _take_away(place, aside):
    """Move an older result away; where it holds what is not ours, delete what is, and tell."""
    foreign = strangers(place, mark := read_mark(place)) if place.is_dir() else []
    if not foreign:
        os.rename(place, aside)
        return []
    for name in (*mark.files, MARK):
        if name not in foreign and not os.path.isabs(name) and ".." not in name.split("/"):
            (place / name).unlink(missing_ok=True)
    return foreign


def finish(target):
    """End or clear away the changes that killed runs began, with the lock of `target` held."""
    for staged in left_over(target, "set-"):
        if (staged / NOTE).is_file():
            carry_out(staged, target)
        else:
            with contextlib.suppress(OSError):  # it is only in the way
                shutil.rmtree(staged)
