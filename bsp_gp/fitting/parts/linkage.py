"""Arms that hang on one another, as a part of a hypothesis: a double pendulum in angles."""

import re
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from bsp_gp.errors import LawError
from bsp_gp.fitting.hypothesis import Numbered, Parameter
from bsp_gp.units import DIMENSIONLESS, KILOGRAM

_TEXT = re.compile(r"linked\(\s*([^\s(),]+)\s*,\s*([^\s(),]+)\s*\)")
WINDOW, DEGREE = 9, 4
"""Rows and degree of the polynomials that couplings are first guessed from."""
MOST = 0.9
"""Product of two couplings below which their arms surely have an inertia."""


@dataclass(frozen=True)
class Linkage(Numbered):
    """Two arms, one of which hangs on the other.

    Attributes
    ----------
    couplings : tuple of (str, str)
        Of the constants by which each feels the other: C over its moment of inertia where that is
        not known, else C, which both share.
    """

    text: str
    pair: tuple
    couplings: tuple
    numbers: tuple = ()
    kind = "linkage"
    is_coupling = True

    def describe(self):
        return self.text


def is_linkage(text):
    """Whether a typed law is one."""
    return re.match(r"\s*linked\s*\(", text) is not None


def read_linkage(dataset, text):
    """Read ``linked(upper, lower)``: of two angles, the arms of which hang on one another.

    Raises
    ------
    LawError
    """
    match = _TEXT.fullmatch(text.strip())
    moving = dict.fromkeys(s.names[k] for s in dataset.scenes for k in s.dynamic)
    named = match.groups() if match else ()
    if not dataset.units.is_angle or len(set(named) & set(moving)) != 2:
        raise LawError(
            f"{text!r} must name two arms whose angles were measured, as in linked(upper, lower); "
            f"moving bodies are {', '.join(moving)}, their coordinates are "
            + ("angles" if dataset.units.is_angle else "no angles: give them in rad or deg")
        )
    inertia = {
        name: all(np.isfinite(s.entities[s.names.index(name)].mass)
                  for s in dataset.scenes if name in s.names) for name in named
    }  # fmt: skip
    first = [_guess(dataset, *pair) for pair in (named, named[::-1])]
    size = np.sqrt(abs(np.prod(first)) / MOST)
    first = [value / max(size, 1.0) for value in first]
    if all(inertia.values()):
        masses = [next(s.entities[s.names.index(n)].mass for s in dataset.scenes if n in s.names)
                  for n in named]  # fmt: skip
        start = float(np.mean(np.multiply(first, masses)))
        name, unit = "_".join(("coupling", *named)), KILOGRAM
        return Linkage(
            text.strip(), named, (name, name),
            (Parameter(name, "", unit, start=start, prior=(0.0, float(np.mean(masses)))),),
        )  # fmt: skip
    names = tuple(f"coupling_{name}" for name in named)
    numbers = tuple(
        Parameter(name, "", DIMENSIONLESS, start=float(value), prior=(0.0, 1.0))
        for name, value in zip(names, first, strict=True)
    )
    return Linkage(text.strip(), named, names, numbers)


def _guess(dataset, mine, other):
    """How an arm feels the other, from rows: beside its weight and a drag of its own."""
    left, right = [], []
    for scene in dataset.scenes:
        if mine not in scene.names or other not in scene.names or len(scene.times) <= WINDOW:
            continue
        step = float(np.median(np.diff(scene.times)))
        both = [scene.positions[:, scene.names.index(name), 0] for name in (mine, other)]
        (q, w, a), (q2, w2, a2) = (
            [savgol_filter(angle, WINDOW, DEGREE, deriv=k, delta=step) for k in range(3)]
            for angle in both
        )
        gap = q - q2
        felt = -(np.cos(gap) * a2 + np.sin(gap) * w2**2)
        left.append(a)
        right.append(np.column_stack([felt, np.sin(q), np.cos(q), w]))
    if not left:
        return 0.3
    left, right = np.concatenate(left), np.concatenate(right)
    seen = np.isfinite(left) & np.isfinite(right).all(axis=1)
    if seen.sum() < 10:
        return 0.3
    return float(np.linalg.lstsq(right[seen], left[seen], rcond=None)[0][0])
