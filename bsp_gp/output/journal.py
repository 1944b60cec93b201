"""Several results that belong together: all change, or after a kill the next run ends the change.

They are filled in one folder beside their places. A note in it, written when all are whole, says
what goes where; from then on the change is only ever carried on, never undone.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil

from bsp_gp.output.mark import MARK, file_digest, read_mark, strangers
from bsp_gp.output.replacing import clear, left_over, put_in_place

__all__ = ["NOTE", "carry_out", "finish", "write_note"]

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
    """Carry a change out that was decided on, or what is still to be done of it.

    Returns
    -------
    list of str
        What is not ours and was kept.
    """
    content = json.loads((staged / NOTE).read_text(encoding="utf-8"))
    kept = []
    for name, number in content["entries"].items():
        source, place = staged / name, target.with_name(name)
        if not name.startswith(target.name) or not os.path.lexists(source):
            continue  # it is in its place
        if source.lstat().st_ino != number:  # changed places with an older one already
            clear(source, place)
        elif source.is_dir():
            found = put_in_place(source, place)
            kept += found if place == target else [f"{name}/{each}" for each in found]
        else:
            os.replace(source, place)
    for name, digest in content["gone"].items():
        place = target.with_name(name)
        if name.startswith(target.name) and digest and _digest(place) == digest:
            kept += [f"{name}/{each}" for each in _take_away(place, staged / f"{name}.gone")]
    shutil.rmtree(staged)
    return kept


def _take_away(place, aside):
    if not place.is_dir():
        place.unlink()
        return []
    mark = read_mark(place)
    foreign = strangers(place, mark)
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
