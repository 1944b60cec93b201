"""Tracker's own files (.trk, XML): point masses, their frames, scale and axes.

Layout after Open Source Physics Tracker 5 and 6: a TrackerPanel with a video clip (start frame,
step size, number of steps), a clip control (``delta_t``, milliseconds per frame), a coordinate
system (origin in pixels, angle in degrees counter-clockwise, pixels per unit; where it moves, its
key frames alone are stored and each holds until the next) and tracks of the class PointMass whose
steps are in image pixels, y down. The world is X = (dx cos a + dy sin a) / sx and
Y = (dy cos a - dx sin a) / sy with dx = x - x0 and dy = y0 - y.

Tracks of other classes (particle models, centres of mass, tapes) are no measurements and left out.
Steps outside of the clip are kept by Tracker, but are no part of its own tables: left out too.
"""

import math
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pandas as pd

from bsp_gp.errors import DataError

MOST_BYTES = 100_000_000
DEFAULT_FPS = 30.0
DEFAULT_MASS = 1.0
SCALES = ("xscale", "yscale")


def read_trk(path):
    """Read the point masses of a .trk file.

    Returns
    -------
    frame : DataFrame
        Columns t (s), entity, x, y in the file's unit of length (`unit`), y up along the file's
        axes; frames without a step are left out, as gaps.
    about : dict
        unit (str, "px" where the scale was never set, or None), mass_unit (str or None), fps,
        masses (dict name -> mass or nan), notes (tuple of str).

    Raises
    ------
    DataError
        Not such a file; a DOCTYPE or an entity in it; no point mass with at least one step; a
        scale of zero; coordinates that are no numbers.
    """
    path = Path(path)
    root = _root(path)
    if not root.get("class", "").endswith("TrackerPanel"):
        raise DataError(
            f"not a Tracker file: its root is of the class {root.get('class')!r}", file=path,
            remedy="save the tab in Tracker as .trk, or export the table as text",
        )  # fmt: skip
    notes = []
    clip = _child(root, "videoclip")
    first = int(_number(clip, "startframe", 0, path))
    step = max(int(_number(clip, "stepsize", 1, path)), 1)
    count = int(_number(clip, "stepcount", 0, path)) or sys.maxsize
    start_ms = _number(clip, "starttime", 0.0, path)
    delta_ms = _number(_child(root, "clipcontrol"), "delta_t", math.nan, path)
    if not delta_ms > 0:  # picture sequences carry their own
        delta_ms = _number(_child(clip, "video"), "delta_t", math.nan, path)
    if not delta_ms > 0:
        delta_ms = 1000.0 / DEFAULT_FPS
        notes.append(f"{path.name} gives no time per frame; {DEFAULT_FPS:g} frames a second taken")
    axes = _Axes(_child(root, "coords"), path)
    rows, masses = [], {}
    for mass in _point_masses(root):
        name = _text(mass, "name") or f"mass{len(masses) + 1}"
        if name in masses:
            raise DataError(f"two tracks are called {name!r}", file=path, remedy="rename one")
        masses[name] = _number(mass, "mass", math.nan, path)
        for index, x, y in _steps(mass, path):
            if index < first or (index - first) % step or (index - first) // step >= count:
                continue  # not a step of the clip
            world = axes.world(index, x, y)
            rows.append((start_ms / 1000 + (index - first) * delta_ms / 1000, name, *world))
    if not rows:
        raise DataError("no point mass with a position in it", file=path,
                        remedy="track a Point Mass in Tracker before saving")  # fmt: skip
    frame = pd.DataFrame(rows, columns=["t", "entity", "x", "y"])
    frame = frame.sort_values(["entity", "t"], ignore_index=True)
    unit = _text(root, "length_unit")
    if axes.is_unscaled:
        unit = "px"
        notes.append(
            f"{path.name} has Tracker's first scale, one pixel per unit of length: it was never "
            "calibrated, and lengths are in pixels"
        )
    elif unit is None:
        notes.append(f"{path.name} names no unit of length")
    defaults = [name for name, value in masses.items() if value == DEFAULT_MASS]
    if defaults:
        notes.append(
            f"the mass of {', '.join(defaults)} is {DEFAULT_MASS:g}, which Tracker gives to every "
            "new point mass: check it"
        )
    return frame, {
        "unit": unit, "mass_unit": _text(root, "mass_unit"), "fps": 1000.0 / delta_ms,
        "masses": masses, "notes": tuple(notes),
    }  # fmt: skip


def _root(path):
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}", file=path) from error
    if len(data) > MOST_BYTES:
        raise DataError(f"larger than {MOST_BYTES // 10**6} MB, which no track needs", file=path)
    # Entities can blow a small file up without end; Tracker writes none.
    if re.search(rb"<!\s*(DOCTYPE|ENTITY)", data.replace(b"\0", b""), re.IGNORECASE):
        raise DataError("a DOCTYPE or an entity is not allowed in a Tracker file", file=path,
                        remedy="Tracker writes none; do not open files of unknown origin")
    try:
        return ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise DataError(f"not XML: {error}", file=path, row=error.position[0]) from error


def _child(node, name):
    """The property `name` of an object (its value object, if it has one), or None."""
    if node is None:
        return None
    for child in node:
        if child.tag == "property" and child.get("name") == name:
            inner = child.find("object")
            return child if inner is None else inner
    return None


def _text(node, name):
    child = _child(node, name)
    return None if child is None or child.text is None else child.text.strip() or None


def _number(node, name, default, path):
    text = _text(node, name)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DataError(f"{name} must be a number, got {text[:40]!r}", file=path)
    return value


class _Axes:
    """Origin, angle and scale, frame by frame where they are not fixed."""

    def __init__(self, coords, path):
        self.path = path
        self.frames = dict(_indexed(_child(coords, "framedata")))
        if not self.frames:
            raise DataError("it holds no axes (coords)", file=path)
        parts = ("fixedorigin", "fixedangle", "fixedscale")
        self.fixed = all(_text(coords, part) == "true" for part in parts)
        scales = {_number(n, s, 1.0, path) for n in self.frames.values() for s in SCALES}
        self.is_unscaled = scales == {1.0}

    def world(self, index, x, y):
        known = sorted(k for k in self.frames if k <= index) or sorted(self.frames)[:1]
        node = self.frames[0 if self.fixed and 0 in self.frames else known[-1]]
        x0, y0, angle = (_number(node, n, 0.0, self.path) for n in ("xorigin", "yorigin", "angle"))
        sx, sy = (_number(node, name, 1.0, self.path) for name in SCALES)
        if sx == 0 or sy == 0:
            raise DataError("a scale of zero pixels per unit", file=self.path)
        dx, dy, angle = x - x0, y0 - y, math.radians(angle)
        across = (dx * math.cos(angle) + dy * math.sin(angle)) / sx
        return across, (dy * math.cos(angle) - dx * math.sin(angle)) / sy


def _indexed(node):
    """Objects of a property array, with their indices from names like ``[12]``."""
    if node is None:
        return
    for child in node:
        match = re.fullmatch(r"\[(\d+)\]", child.get("name", ""))
        inner = child.find("object")
        if match and inner is not None:
            yield int(match.group(1)), inner


def _point_masses(root):
    tracks = _child(root, "tracks")
    for item in tracks if tracks is not None else ():
        inner = item.find("object")
        if inner is not None and inner.get("class", "").endswith("PointMass"):
            yield inner


def _steps(mass, path):
    for index, node in _indexed(_child(mass, "framedata")):
        x, y = _number(node, "x", np.nan, path), _number(node, "y", np.nan, path)
        if math.isfinite(x) and math.isfinite(y):
            yield index, x, y
