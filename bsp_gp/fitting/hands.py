"""Recordings that begin in somebody's hand, or end in it.

A hand that throws a body, or catches it, moves it by forces as large as those of the law, which
change from row to row and end at once. A force of some form near the place where that happened, or
a kick, would explain it; but what acts there is no law. A thrust that is constant until it ends is
left to the search.

Pieces of a few rows, each from a state of its own, tell what acceleration the law lacks there.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK
from bsp_gp.fitting.rests import may_lose_ends
from bsp_gp.fitting.snippets import snippets_under

PIECES = (7, 9, 11, 13, 15, 18, 21, 25, 31)
"""Rows of a piece; the fewest that show accelerations well enough."""
LEAST, MOST_ROWS, MOST_PIECES = 4, 2_000, 4_000
"""Pieces, one behind the other, that a recording has at least, its rows at most, and pieces of all
recordings: what is longer takes long, and hardly shows a hand."""
OVERLAP = 4
"""Pieces of which each row is in."""
CLEAR, SHARE = 8.0, 0.5
"""Errors of the acceleration that a hand gives, and its part of what bodies have all along."""
TIMES, CALM, LEVEL = 6.0, 3.0, 1.5
"""Times what the law lacks along the middle of a recording, by which that falls, and ratio of what
it lacks in neighbouring pieces from which on it falls no further."""
MOSTLY = 0.5
"""Part of the pieces in a hand in which the law lacks as much."""
MOST_LED = 0.5
"""Part of a recording that may be in a hand at one end."""
MOST_WAY = 1 / 3
"""Part of the whole way that a body may go in a hand: rockets go most of theirs by a motor, and
until a parachute opens."""
VARIES, CHANCE = 0.08, 1e-6
"""Spread of the acceleration that a hand gives, in its mean, and the chance of it."""
FEW = 3
"""Pieces in a hand, below which it is not asked whether it changes."""
MOVED = 10.0
"""Errors of a place by which a body moves that is not at rest."""
REST = 0.5
"""Part of the usual acceleration below which a body is held, or lies on something."""


@dataclass(frozen=True)
class _Series:
    """Accelerations of bodies, and those that a law lacks, of pieces about rows (K,).

    Both of shape (K, a), m/s^2, with their error, and what is usual.
    """

    rows: np.ndarray
    found: np.ndarray
    lacks: np.ndarray
    error: float
    usual: float


def without_hands(dataset, law):
    """The data set without rows at its ends at which a hand moves bodies, with a note; or None.

    Scenes of one moving body alone; nothing is done where rows are counted (`Evaluation`), where
    velocities are data, or in the sky. Constants of the law, as it is declared, are fitted to the
    middle halves of the scenes.
    """
    if not may_lose_ends(dataset):
        return None
    levels = np.array(estimate_noise(dataset).sigma)
    pieces = {scene.name: _pieces(scene, levels) for scene in dataset.scenes}
    pieces = {name: found for name, found in pieces.items() if found is not None}
    n_pieces = sum(OVERLAP * len(scene.times) // pieces[scene.name][0] for scene in dataset.scenes
                   if scene.name in pieces)  # fmt: skip
    if not 0 < n_pieces <= MOST_PIECES:
        return None
    series = _lacking(dataset, law, pieces, levels)
    scenes, told, at = [], [], dataset.units.instant
    for scene in dataset.scenes:
        found = series.get(scene.name)
        count = len(scene.times)
        half = 0 if found is None else pieces[scene.name][0] // 2
        first = 0 if found is None else _led(found, found.rows, half, count)
        last = 0 if found is None else _led(found, count - 1 - found.rows, half, count)
        first, last = _near(scene, levels, first, last)
        if (first or last) and _is_still(scene.rows(first, count - last), levels):
            first = last = 0  # what slides until it stops is in nobody's hand
        scenes.append(scene.rows(first, count - last) if first or last else scene)
        ends = [f"{first} before {at(scene.times[first])}"] if first else []
        ends += [f"{last} after {at(scene.times[count - 1 - last])}"] if last else []
        told += [f"{' and '.join(ends)} in {scene.name!r}"] if ends else []
    if not told:
        return None
    note = (
        f"{CHECK}something that changes all the time, and ends at once, moves the body at the "
        f"ends: a hand that throws or catches it? These rows are left out ({listed(told)}); "
        f"--all-rows keeps them"
    )
    return replace(dataset, scenes=tuple(scenes), notes=(*dataset.notes, note))


def _near(scene, levels, first, last):
    """Rows at both ends in a hand, none where these go so far that no arm reaches there."""
    places, ends = _places(scene, levels), enumerate((first, last))
    return tuple(n_rows if is_in_reach(places, n_rows, side) else 0 for side, n_rows in ends)


def _places(scene, levels):
    """Of the moving body, along axes along which anything moves, (T, a)."""
    return scene.positions[:, scene.dynamic[0]][:, np.isfinite(levels)]


def is_in_reach(places, n_rows, side):
    """Whether rows (n_rows,) at the beginning (0) or end (1) of places (T, a) go no long way."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    own = steps[:n_rows] if side == 0 else steps[len(steps) - n_rows :]
    return bool(np.nansum(own) < MOST_WAY * np.nansum(steps))


def _is_still(scene, levels):
    """Whether the moving body of a scene stays where it is."""
    still = np.ptp(_places(scene, levels), axis=0) < MOVED * levels[np.isfinite(levels)]
    return bool(still.all())


def _pieces(scene, levels):
    """Rows of a piece of a scene, and the accelerations that are usual; None without such."""
    if len(scene.dynamic) != 1 or scene.first is not None:
        return None
    places = _places(scene, levels)
    if not np.isfinite(places).all() or scene.sigma is not None:
        return None
    if len(scene.times) > MOST_ROWS:
        return None
    step = float(np.median(np.diff(scene.times)))
    for rows in PIECES:
        if len(scene.times) < LEAST * rows:
            return None
        error = _error(levels, rows, step)
        bends = np.stack([
            _bend(scene.times[a : a + rows], places[a : a + rows])
            for a in range(0, len(scene.times) - rows + 1, rows)
        ])  # fmt: skip
        usual = float(np.median(np.linalg.norm(bends, axis=1)))
        if CLEAR * error < SHARE * usual:
            return rows, usual
    return None


def _bend(times, places):
    """Acceleration of the parabola nearest to places (T,) or (T, a)."""
    return 2 * np.polyfit(times - times.mean(), places, 2)[0]


def _error(levels, rows, step):
    """Of an acceleration that a parabola through some rows tells, along all axes together."""
    return float(np.linalg.norm(levels[np.isfinite(levels)])) * np.sqrt(720.0 / rows**5) / step**2


def _lacking(dataset, law, pieces, levels):
    """What a law lacks along scenes, by name; its constants are those of their middle halves.

    Without forces it lacks all.
    """
    own = [scene for scene in dataset.scenes if scene.name in pieces]
    centres = {}
    for scene in own:
        rows = pieces[scene.name][0]
        firsts = range(0, len(scene.times) - rows + 1, max(rows // OVERLAP, 1))
        centres[scene.name] = np.array(firsts) + rows // 2
    out, axes, columns = {}, np.flatnonzero(np.isfinite(levels)), {}
    if law.terms or law.frame or law.unseen:
        middle = [scene.rows(len(scene.times) // 4, 3 * len(scene.times) // 4) for scene in own]
        middle = replace(dataset, scenes=tuple(middle), train=(), test=())
        found = snippets_under(law, middle, _snippets(own, pieces, centres))
        if found is None:
            return {}
        channels = found.channels
        columns = {
            (channels.scene_names[scene], axis): found.residual[:, column]
            for column, (scene, axis) in enumerate(zip(channels.scene, channels.axis, strict=True))
        }
    for scene in own:
        rows, usual = pieces[scene.name]
        step = float(np.median(np.diff(scene.times)))
        lacks, whole = np.zeros((2, len(centres[scene.name]), len(axes)))
        places = _places(scene, levels)
        for k, centre in enumerate(centres[scene.name]):
            first = centre - rows // 2
            times = scene.times[first : first + rows]
            whole[k] = _bend(times, places[first : first + rows])
            if columns:
                left = [columns[f"{scene.name} {first}", axis][:rows] for axis in axes]
                lacks[k] = _bend(times, np.stack(left, axis=1))
            else:
                lacks[k] = whole[k]
        error = _error(levels, rows, step)
        out[scene.name] = _Series(centres[scene.name], whole, lacks, error, usual)
    return out


def _snippets(scenes, pieces, centres):
    """Rows of scenes about centres as scenes, each called by the first of them."""
    return [
        replace(scene.rows(first, first + rows), name=f"{scene.name} {first}")
        for scene in scenes for rows, _ in [pieces[scene.name]]
        for first in (centres[scene.name] - rows // 2).tolist()
    ]  # fmt: skip


def _led(series, rows, half, count):
    """Rows from an end on (that from which rows are counted) that a hand moves."""
    order = np.argsort(rows)
    rows, lacks, whole = rows[order], series.lacks[order], series.found[order]
    size = np.linalg.norm(lacks, axis=1)
    inner = (rows >= count // 4) & (rows <= 3 * count // 4)
    usual = float(np.median(size[inner]))
    high = max(TIMES * usual, CLEAR * series.error, SHARE * series.usual)
    bad = np.flatnonzero((size > high) & (rows < MOST_LED * count))
    if not len(bad):
        return 0
    last = int(bad[-1])
    levelled = size[:-1] <= LEVEL * size[1:] + 3 * series.error
    after = np.flatnonzero(levelled & (np.arange(len(size) - 1) > last))
    if not len(after) or rows[after[0]] - rows[last] > 2 * half + 2:
        return 0
    first = int(after[0])
    if size[first] > np.median(size[bad]) / CALM:  # it fades: that is a force
        return 0
    later = (rows >= rows[first]) & (rows <= count // 2)
    if np.mean(size[: last + 1] > high) < MOSTLY or (size[later] > high).any():
        return 0
    inside = rows <= rows[first] - 2 * half  # other pieces have rows on both sides
    if inside.sum() < FEW:  # what is over so soon is no thrust
        return int(rows[first]) - half // 2
    at_rest = float(np.median(np.linalg.norm(whole[inside], axis=1))) < REST * series.usual
    is_led = at_rest or _varies(lacks[inside], series.error)
    return int(rows[first]) - half // 2 if is_led else 0


def _varies(lacks, error):
    """Whether accelerations change, in direction or size, as those of no constant thrust do."""
    mean = lacks.mean(axis=0)
    spread = np.square(lacks - mean).sum()
    dof = lacks.size / OVERLAP
    chance = stats.chi2.sf(spread / error**2 * lacks.shape[1] / OVERLAP, dof)
    return chance < CHANCE and spread > VARIES**2 * len(lacks) * (mean @ mean)
