"""Regions that do not move: the arena inside its walls, and coloured mats, as rectangles.

Mats may lie over one another and under the walls: a rectangle may run on, unseen, under pixels of
another mat, so each colour is explained by the fewest rectangles that hold all of its pixels and
that show another mat's pixels, at most, besides.
"""

import itertools
from dataclasses import dataclass

import cv2
import numpy as np

from bsp_gp.vision.colour import background, is_colour

FILLED = 0.985  # share of a rectangle that must be its own (or another mat's) colour
SPECK = 60  # px²: less is no mat
TOLERANCE, OF_WALLS = 60.0, 90.0  # of colours of mats and of walls
N_SAMPLES = 24  # frames of which the background is made


@dataclass(frozen=True)
class Region:
    """A static rectangle: centre and size in px, its colour's name and how sure it is.

    `hidden` is the share of its area that cannot be seen (under another mat or a wall).
    """

    colour: str
    x: float
    y: float
    width: float
    height: float
    hidden: float = 0.0

    @property
    def box(self):
        """``(left, top, right, bottom)``, px."""
        half_width, half_height = self.width / 2, self.height / 2
        return (self.x - half_width, self.y - half_height, self.x + half_width,
                self.y + half_height)  # fmt: skip


def still_background(video, track):
    """Background image of a tracked video, discs left out; see `colour.background`."""
    indices, images = video.sample(N_SAMPLES)
    rows = {int(f): k for k, f in enumerate(track.frames)}
    hidden = []
    for index, image in zip(indices, images, strict=True):
        mask = np.zeros(image.shape[:2], dtype=np.uint8)
        row = rows.get(int(index))
        for k, name in enumerate(track.names):
            reach = np.nan_to_num(track.radii.get(name, 0.0))  # a point has no known size
            if row is not None and np.all(np.isfinite(track.positions[row, k])):
                centre = tuple(int(round(c)) for c in track.positions[row, k])
                cv2.circle(mask, centre, int(np.ceil(reach + 4)), 255, -1)
        hidden.append(mask > 0)
    return background(images, hidden)


def arena(image):
    """Inner rectangle of black walls along the border of the picture; None without such."""
    walls = is_colour(image, np.zeros(3, dtype=np.float32), OF_WALLS)
    edge = np.concatenate([walls[0], walls[-1], walls[:, 0], walls[:, -1]])
    if edge.mean() < 0.9:
        return None
    rows = np.nonzero(walls.mean(axis=1) < 0.8)[0]
    columns = np.nonzero(walls.mean(axis=0) < 0.8)[0]
    if not len(rows) or not len(columns):
        return None
    return _region("arena", columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)


def _region(colour, left, top, right, bottom, hidden=0.0):
    # Pixel k covers k - 1/2 .. k + 1/2, as the trackers count.
    middle = (left + right - 1) / 2, (top + bottom - 1) / 2
    return Region(colour, *middle, float(right - left), float(bottom - top), hidden)


def mats(image, seen, colours, inside=None):
    """Rectangles of the given colours in a background image.

    Parameters
    ----------
    image : ndarray, shape (h, w, 3)
        Background without moving objects.
    seen : bool ndarray, shape (h, w)
        False where the background was never seen.
    colours : mapping of str to ndarray, shape (3,)
    inside : Region, optional
        Only this part of the picture.
    """
    masks = {}
    for name, colour in colours.items():
        mask = (is_colour(image, colour, TOLERANCE) & seen).astype(np.uint8)
        masks[name] = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8)) > 0
    if inside is not None:
        left, top, right, bottom = (int(round(v + 0.5)) for v in inside.box)
        for mask in masks.values():
            mask[:top] = mask[bottom:] = False
            mask[:, :left] = mask[:, right:] = False
    found = []
    for name, mask in masks.items():
        others = ~seen
        for other, theirs in masks.items():
            if other != name:
                others = others | cv2.dilate(theirs.astype(np.uint8), np.ones((7, 7))).astype(bool)
        for part in _parts(mask, others):
            found += [_region(name, *box, hidden) for box, hidden in _cover(part, others)]
    return found


def _parts(mask, others):
    """Connected patches; two in line across another mat are one mat seen on both sides."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return _merged([labels == k for k in range(1, count) if stats[k][4] > SPECK], others)


def _merged(parts, others):
    for a, b in itertools.combinations(range(len(parts)), 2):
        both = parts[a] | parts[b]
        left, top, right, bottom = _bounds(both)
        if (both | others)[top:bottom, left:right].mean() > FILLED:
            rest = [p for k, p in enumerate(parts) if k not in (a, b)]
            return _merged([*rest, both], others)
    return parts


def _bounds(mask):
    rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
    return columns[0], rows[0], columns[-1] + 1, rows[-1] + 1


def _steps(profile, smallest=8):
    """Places where the outline of a patch jumps: its sides and the corners between mats."""
    edges = np.nonzero(np.abs(np.diff(profile.astype(int))) >= smallest)[0] + 1
    kept = []
    for edge in edges:
        if not kept or edge - kept[-1] > 3:
            kept.append(int(edge))
    return kept


def _cover(part, others):
    """The fewest rectangles (one or two) that hold a patch: list of (box, hidden share)."""
    left, top, right, bottom = _bounds(part)
    allowed = part | others
    whole = np.s_[top:bottom, left:right]
    if allowed[whole].mean() > FILLED:
        return [((left, top, right, bottom), 1 - part[whole].mean())]
    xs = sorted({left, right, *_steps(part.sum(axis=0))})
    ys = sorted({top, bottom, *_steps(part.sum(axis=1))})
    total = part.sum()
    boxes = []
    for x0, x1 in itertools.combinations(xs, 2):
        for y0, y1 in itertools.combinations(ys, 2):
            area = (x1 - x0) * (y1 - y0)
            if area > SPECK and np.count_nonzero(allowed[y0:y1, x0:x1]) > 0.97 * area:
                boxes.append((x0, y0, x1, y1))
    best, choice = -np.inf, None
    for a, b in itertools.combinations(boxes, 2):
        union = np.zeros_like(part)
        for x0, y0, x1, y1 in (a, b):
            union[y0:y1, x0:x1] = True
        gain = (union & part).sum() / total - 1e-4 * (union & ~part).sum() / total
        if gain > best:
            best, choice = gain, (a, b)
    if choice is None or best < 0.9:
        return [((left, top, right, bottom), 1 - part[whole].mean())]
    return [(box, 1 - part[box[1] : box[3], box[0] : box[2]].mean()) for box in choice]
