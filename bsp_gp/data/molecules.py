"""Frames of particles as programs of molecular dynamics and N-body programs write them (``.xyz``).

A frame is a line with the number of particles, a line that says anything, and a line for each
particle: a name, x, y, z and maybe more. The times stand in the second line (``t=0.1``,
``Time = 0.1 ps``); without them frames are counted (``step = 20``, or one after another).
"""

import re
from collections import Counter

import numpy as np

from bsp_gp.data.conversion import is_unit
from bsp_gp.data.scene import CHECK
from bsp_gp.errors import DataError

ENDINGS = (".xyz", ".exyz")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
_TIME = re.compile(rf"(?i)\b(?:t|time)\s*[=:]\s*({_NUMBER})\s*(\w+)?")
_STEP = re.compile(r"(?i)\b(?:time_?step|step|frame|iter(?:ation)?|i)\s*[=:]\s*(\d+)")
_ROW = re.compile(rf"\s*(\S+)\s+({_NUMBER})\s+({_NUMBER})\s+({_NUMBER})(?:\s.*)?")
_REMEDY = "give a table with the columns t, entity, x, y, z"
JUMP, LEAST_JUMPS = 0.7, 2
"""Part of the size of a box that no particle goes in a step, and such steps that are told."""
_PLAIN = "species:S:1:pos:R:3"
"""How columns of the extended format must begin."""


def is_of_frames(lines):
    """Whether lines begin with a number of particles, a comment and the first particle."""
    return (
        len(lines) > 2 and re.fullmatch(r"\s*\d+\s*", lines[0]) is not None
        and _ROW.fullmatch(lines[2]) is not None
    )  # fmt: skip


def of_xyz(text, path):
    """Rows of time (or frame), particle and place as rows, the header first, and notes.

    Particles of one name are numbered.

    Raises
    ------
    DataError
        If a frame is no such, or has other particles than the first.
    """
    lines, at, frames = text.splitlines(), 0, []
    while at < len(lines) and lines[at].strip():
        count = lines[at].strip()
        rows = [_ROW.fullmatch(line) for line in lines[at + 2 : at + 2 + int(count or 0)]] if (
            count.isdecimal()
        ) else []  # fmt: skip
        if not rows or len(rows) < int(count) or None in rows:
            raise DataError(
                "this is no frame: a number of particles, a line of comment, and so many rows of "
                "a name and x, y, z", file=path, row=at + 1, remedy=_REMEDY,
            )  # fmt: skip
        frames.append((lines[at + 1], [row.groups() for row in rows]))
        at += 2 + int(count)
    named = [row[0] for row in frames[0][1]]
    if any([row[0] for row in rows] != named for _, rows in frames):
        raise DataError("frames have other particles than the first", file=path, remedy=_REMEDY)
    if "Properties=" in frames[0][0] and _PLAIN not in frames[0][0]:
        raise DataError(f"columns are not {_PLAIN}", file=path, row=2, remedy=_REMEDY)
    head, clock = _clock([comment for comment, _ in frames])
    places = [[re.sub("[dD]", "e", cell) for row in rows for cell in row[1:]] for _, rows in frames]
    rows, names = [[head, "entity", "x", "y", "z"]], _told_apart(named)
    for time, own in zip(clock, places, strict=True):
        rows += [[time, name, *own[3 * k : 3 * k + 3]] for k, name in enumerate(names)]
    notes = (f"frames of particles: {len(frames)}", *_jumps(np.array(places, dtype=float)))
    return rows, notes


def _jumps(places):
    """A note of places (frames, 3 particles) that go from one end of a box to the other at once."""
    axes = places.reshape(len(places), -1, 3)
    size = np.ptp(axes, axis=(0, 1))
    count = int((np.abs(np.diff(axes, axis=0)) > JUMP * size).sum())
    return (
        f"{CHECK}{count} step(s) go from one end of the box to the other: with periodic boundaries "
        "no track is one; write places that are not wrapped",
    )[: count >= LEAST_JUMPS]  # fmt: skip


def _clock(comments):
    """The heading of times, or of frames, and theirs as texts."""
    times = [_TIME.search(comment) for comment in comments]
    if all(times):
        unit = times[0][2] or ""
        return f"t ({unit})" if is_unit(unit) else "t", [found[1] for found in times]
    steps = [_STEP.search(comment) for comment in comments]
    if all(steps):
        return "frame", [found[1] for found in steps]
    return "frame", [str(k) for k in range(len(comments))]


def _told_apart(names):
    """Names of which those that come again are numbered."""
    counts, seen = Counter(names), Counter()
    out = []
    for name in names:
        seen[name] += 1
        out.append(f"{name}{seen[name]}" if counts[name] > 1 else name)
    return out
