"""Quantities of tracks that stay what they are: a distance, a line, a curve that is kept to."""

import math
from dataclasses import dataclass
from string import ascii_lowercase

import numpy as np
from scipy.optimize import least_squares

CONSTANT = 3.0
"""Deviations of a constant quantity, in those that its changes from row to row tell of noise."""
NEARLY = 0.01
"""Part of the way of a body that swings up to which its distance from a point is about constant:
bobs leave their plane, and cameras look aslant."""
STEEP = 20.0
"""Slope of a curve from which it is one of the other coordinate."""
ARC = 30.0
"""Deviations from a line from which an arc that does not come back is one about a point."""
BENT = 3.0
"""Deviations from a line, in the same, from which a track is one about a point."""
CLOSER = 0.9
"""Part of what a circle leaves below which another curve follows a track better: a piece of a
circle is nearly a parabola, and strings are commoner than rails of that form."""
MOVED = 10.0
"""The same of the way between two bodies that have moved about each other."""
UNEVEN = 0.2
"""Standard deviation of a speed, in its mean, that no round orbit has."""
CURVED, WRITTEN = tuple(range(2, 13)), 4
"""Degrees of curves along which bodies may go, and the highest that is written in powers of a
place; beyond, in powers of the way from the middle of the track in its half width."""
COMES_BACK = 0.5
"""Part of the way along a curve that a body must come back."""
NARROW, DIPS = 0.05, 0.5
"""Part of the extent of a track within which it keeps to a curve; part of its rows where this bends
upwards, if it is in a dip."""
LEAST_ROWS = 12
EXACT = 1e-7
"""Part of the extent below which deviations are rounding."""


@dataclass(frozen=True)
class Kept:
    """A quantity that stays constant, as the constraint `text` with places for names says.

    `level` is that of the noise, told by changes from row to row, and `spread` how far the quantity
    is off what it is kept at, root mean square, metres. `is_sole`: nothing else would keep it; an
    orbit may be round, at an even speed. `normal` is across a line or plane; `way` is whither a
    weight pulls that keeps the body swinging.
    """

    code: str
    text: str
    pair: tuple
    stems: tuple
    values: tuple
    level: float
    spread: float
    is_sole: bool = False
    normal: tuple | None = None
    way: tuple = ()


def tracks_of(dataset):
    """Seen places of every body, one array (T, d) per scene, nan where it is not seen."""
    out = {}
    for scene in dataset.scenes:
        for k, name in enumerate(scene.names):
            out.setdefault(name, {})[scene.name] = scene.positions[:, k]
    return out


def alone(name, tracks, up=""):
    """The line or curve along which, or the point about which a body moves; or None.

    Parameters
    ----------
    tracks : dict of str to ndarray, shape (T, d)
        By scene.
    up : str
        The declared vertical, ``"y"`` or ``"-y"``; none = not declared.
    """
    places = np.concatenate(list(tracks.values()))
    seen = np.isfinite(places).all(axis=1)
    if seen.sum() < LEAST_ROWS:
        return None
    middle = places[seen].mean(axis=0)
    axes = np.linalg.svd(places[seen] - middle, full_matrices=False)[2]
    line = {key: (p - middle) @ axes[-1] for key, p in tracks.items()}
    bend, level = deviation(line)
    if _is_constant(bend, level, places[seen]):
        names = "xyz"[: len(middle)]
        text = " + ".join(f"{axes[-1][k]:.6g} * {x}_i" for k, x in enumerate(names)) + " = {0}"
        values = (float(middle @ axes[-1]),)
        return Kept("wire", text, (name, ""), ("b",), values, level, bend, normal=tuple(axes[-1]))
    curve = _along_a_curve(name, tracks, up) if len(middle) == 2 else None
    centre, radius = _sphere(places[seen])
    spread, level = deviation({k: np.linalg.norm(p - centre, axis=1) for k, p in tracks.items()})
    if not _swings(tracks, axes[0]) and bend < ARC * level:
        return None  # of a track that is thrown, noise makes an arc
    is_about = spread <= NEARLY * np.ptp(places[seen], axis=0).max() and _swings(tracks, axes[0])
    is_about &= spread < CLOSER * bend  # a circle that follows a track as a line does is none
    if bend < BENT * level or not (is_about or _is_constant(spread, level, places[seen])):
        return curve if bend > BENT * level else None
    stems = tuple(f"pivot_{axis}" for axis in "xyz"[: len(centre)])
    point = ", ".join(f"{{{k}}}" for k in range(len(centre)))
    text = f"norm(p_i - ({point})) = {{{len(centre)}}}"
    values = (*centre.tolist(), radius)
    rod = Kept("rod", text, (name, ""), (*stems, "L"), values, level, spread, _is_uneven(tracks),
               way=tuple((middle - centre).tolist()))  # fmt: skip
    is_better = curve is not None and curve.spread < CLOSER * spread
    return curve if is_better else rod


def _swings(tracks, axis):
    """Whether a body comes back along a direction, as what is thrown does not."""
    rows = [p[np.isfinite(p).all(axis=1)] @ axis for p in tracks.values()]
    return any(len(own) > 1 and _gone_back(own) > COMES_BACK * np.ptp(own) for own in rows)


def _along_a_curve(name, tracks, up):
    """The curve in a plane, one coordinate as a polynomial of the other, that a body goes along.

    None where there is none, and where nothing comes back along it: what is thrown flies along a
    parabola as well. It does not fly through a dip.
    """
    for of, along in ((1, 0), (0, 1)):
        rows = [p[np.isfinite(p).all(axis=1)] for p in tracks.values()]
        places = np.concatenate(rows)
        swept = float(np.ptp(places[:, along]))
        back = max(_gone_back(own[:, along]) for own in rows if len(own) > 1)
        comes_back, may_dip = back > COMES_BACK * swept, up[-1:] == "xy"[of]
        extent = float(np.ptp(places, axis=0).max())
        found = []  # (spread beside the numbers of the curve, spread, level, curve)
        for degree in CURVED if comes_back or may_dip else ():
            if 2 * (degree + 1) > len(places):
                break
            curve = np.polynomial.Polynomial.fit(places[:, along], places[:, of], degree)
            slope = curve.deriv()
            if np.abs(slope(places[:, along])).max() > STEEP:
                break
            left = {
                key: (p[:, of] - curve(p[:, along])) / np.hypot(1.0, slope(p[:, along]))
                for key, p in tracks.items()
            }
            spread, level = deviation(left)
            lift = slope.deriv()(places[:, along]) * (-1 if up.startswith("-") else 1)
            is_held = comes_back or np.mean(lift > 0) > DIPS
            is_narrow = spread < NARROW * extent
            if is_held and is_narrow and _is_constant(spread, level, places):
                beside = spread / math.sqrt(1 - (degree + 1) / len(places))
                found.append((beside, spread, level, curve))
        if found:  # the simplest of those that follow the track about as well as any
            most = max(min(one[0] for one in found) / CLOSER, EXACT * extent)
            return _kept_curve(name, of, *next(one for one in found if one[0] <= most)[1:])
    return None


def _kept_curve(name, of, spread, level, curve):
    """A body that is kept to a curve of one coordinate, a polynomial of the other."""
    place, plain, degree = f"{'yx'[of]}_i", curve.convert(), curve.degree()
    if degree > WRITTEN:
        low, high = curve.domain.tolist()
        middle, half = (float(f"{n:.4g}") for n in ((low + high) / 2, (high - low) / 2))
        place = f"(({place} - {middle!r} [m]) / ({half!r} [m]))"
        plain = curve.convert(domain=(middle - half, middle + half))
    terms = ["{0}", f"{{1}} * {place}", *(f"{{{k}}} * {place}^{k}" for k in range(2, degree + 1))]
    stems = tuple(f"rail_{k}" for k in ascii_lowercase[: degree + 1])
    return Kept(
        "wire", f"{'xy'[of]}_i = " + " + ".join(terms), (name, ""), stems,
        tuple(plain.coef.tolist()), level, spread, True,
        way=tuple(float(k == of) for k in (0, 1)),
    )  # fmt: skip


def _gone_back(places):
    """How far a coordinate comes back from the farthest that it had reached, on either side."""
    ways = (places, -places)
    return min(float((np.maximum.accumulate(way) - way).max()) for way in ways)


def together(one, other, tracks, is_still=False):
    """The distance of two bodies, if it stays constant.

    `is_still`: no force moves the other: it is a nail that the one hangs from.
    """
    shared = [key for key in tracks[one] if key in tracks[other]]
    if not shared:
        return None
    gaps = {key: np.linalg.norm(tracks[one][key] - tracks[other][key], axis=1) for key in shared}
    moves = np.concatenate([tracks[one][key] - tracks[other][key] for key in shared])
    moves = moves[np.isfinite(moves).all(axis=1)]
    if len(moves) < LEAST_ROWS:
        return None
    spread, level = deviation(gaps)
    if np.ptp(moves, axis=0).max() < MOVED * level or not _is_constant(spread, level, moves):
        return None
    ways = {key: tracks[one][key] - tracks[other][key] for key in shared}
    values = (float(np.linalg.norm(moves, axis=1).mean()),)
    return Kept(
        "rod", "norm(p_i - p_j) = {0}", (one, other), ("L",), values, level, spread,
        _is_uneven(ways), way=tuple(moves.mean(axis=0).tolist()) if is_still else (),
    )  # fmt: skip


def _sphere(places):
    """Centre and radius of the circle or sphere that places lie on best."""
    matrix = np.column_stack([2 * places, np.ones(len(places))])
    start = np.linalg.lstsq(matrix, np.square(places).sum(axis=1), rcond=None)[0][:-1]

    def left(centre):
        distance = np.linalg.norm(places - centre, axis=1)
        return distance - distance.mean()

    centre = least_squares(left, start).x
    return centre, float(np.linalg.norm(places - centre, axis=1).mean())


def deviation(series):
    """Root mean square of deviations from the mean, and what noise makes of it."""
    rows = [values[np.isfinite(values)] for values in series.values()]
    mean = np.concatenate(rows).mean()
    spread = np.sqrt(np.mean(np.square(np.concatenate(rows) - mean)))
    steps = np.concatenate([np.diff(values, 3) for values in rows])
    level = np.sqrt(np.mean(np.square(steps)) / 20) if len(steps) else spread
    return float(spread), float(level)


def _is_constant(spread, level, places):
    return spread <= max(CONSTANT * level, EXACT * float(np.ptp(places, axis=0).max()))


def _is_uneven(series):
    """Whether a body goes about a point at anything but a constant speed, as an orbit might."""
    seen = (p[np.isfinite(p).all(axis=1)] for p in series.values())
    steps = [np.diff(p, axis=0) for p in seen]
    speed = np.linalg.norm(np.concatenate(steps), axis=1)
    level = np.concatenate([np.diff(own, 2, axis=0) for own in steps])
    noise = 2 * np.square(level).mean() / 20 if len(level) else 0.0  # of a step, along its way
    return bool(max(speed.var() - noise, 0.0) > (UNEVEN * speed.mean()) ** 2)
