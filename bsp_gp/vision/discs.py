"""Discs of a known colour: found, and placed to a fraction of a pixel by their visible edge.

A disc is known by its colour F, the radius R of that colour and the width s of its edge; what
surrounds it is an outline of one colour, or the background. Pixels that another disc hides are
left out, so that a touching or half-hidden disc is placed by the arc that is seen, with a
covariance that is wide across the hidden direction.
"""

import itertools
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.special import erf

from bsp_gp.errors import DataError
from bsp_gp.vision.colour import coverage, is_colour

SCALE = 4  # the coarse search looks at every fourth pixel
SEARCH = 28  # px: how far from the predicted place a disc is looked for
MIN_SEEN = 0.12  # of the edge must be visible, otherwise the place is a gap
MIN_GAIN = 0.15  # of the disc's area must show its colour
MAX_RMS = 0.3  # rms misfit of coverage on the visible edge: more is no disc
_MOVED = 60  # sum of the changes of three channels from which on a pixel has moved
EDGE = 3.5  # half-widths of the edge used in the fit
EDGES = (0.35, 0.5, 0.7, 0.9, 1.2, 1.5, 2.0, 2.5)  # px: widths that are tried
SLACK = 2.5  # px: how far off the start of a fit may be
SECTORS = 4
MOST, LEAST = 12, 0.35  # discs of a kind that are looked for, and the share of one that shows
TOLERANCE = 90.0  # pixels nearer to the colour than this belong to it in the coarse search
ITERATIONS = 8
STEADY = 60.0  # median spread of an outline's colour, grey levels
MARGIN = 0.5  # px kept free around another disc, beyond three widths of the blurred edge


@dataclass(frozen=True)
class DiscKind:
    """What discs of one colour look like.

    Attributes
    ----------
    colour : ndarray, shape (3,)
        BGR of the fill.
    radius : float
        Of the fill, px.
    edge : float
        Standard deviation of the blurred edge, px.
    reach : float
        Radius up to which the disc hides what is behind it (with its outline), px.
    surround : ndarray, shape (3,), or None
        Colour of the outline; None: the background is what surrounds the disc.
    """

    colour: np.ndarray
    radius: float
    edge: float = 0.7
    reach: float = 0.0
    surround: np.ndarray | None = None


@dataclass(frozen=True)
class Placed:
    """Where a disc is: position and covariance (px), and how good the fit was.

    `clustering` is how many times wider the error is than independent pixel errors would make it
    (neighbouring pixels err together). `reason` is empty, or says why there is no position
    (which is nan then).
    """

    position: np.ndarray
    covariance: np.ndarray
    rms: float
    seen: float
    reason: str = ""
    clustering: float = 1.0


def gap(reason, rms=np.nan, seen=0.0):
    """No position, and why."""
    return Placed(np.full(2, np.nan), np.full((2, 2), np.nan), rms, seen, reason)


def _kernel(radius):
    reach = int(np.ceil(radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.clip(radius + 0.5 - np.hypot(x, y), 0, 1).astype(np.float32)


def _score(image, kind):
    """1 where pixels are of a disc's colour, -1 elsewhere."""
    return is_colour(image, kind.colour, TOLERANCE).astype(np.float32) * 2 - 1


def find_discs(image, kind):
    """Find the discs of one kind in one image, without knowing how many there are.

    The score of a place is the share of the disc's area that shows its colour, minus the share
    that shows something else; the best place is taken, its pixels are no longer counted, and
    so on.

    Returns
    -------
    list of (float, float)
        Centres, px, to a few pixels; best first.
    """
    score = _score(image[SCALE // 2 :: SCALE, SCALE // 2 :: SCALE], kind)
    kernel = _kernel(kind.radius / SCALE)
    area = kernel.sum()
    y, x = np.mgrid[: score.shape[0], : score.shape[1]]
    found = []
    while len(found) < MOST:
        gain = cv2.filter2D(score, -1, kernel, borderType=cv2.BORDER_CONSTANT)
        row, column = np.unravel_index(np.argmax(gain), gain.shape)
        if gain[row, column] < LEAST * area:
            break
        found.append((column * SCALE + SCALE // 2, row * SCALE + SCALE // 2))
        taken = np.hypot(x - column, y - row) < (kind.reach or kind.radius) / SCALE + 0.5
        score[taken] = np.minimum(score[taken], 0.0)
    return found


def follow(image, kind, predicted, others, search=SEARCH):
    """Coarse place of a disc near its predicted one.

    Parameters
    ----------
    image : ndarray, shape (h, w, 3)
    predicted : (float, float)
    others : sequence of (x, y, reach)
        Where the other discs are expected; their pixels count for nothing.
    search : int
        Half-width of the searched window, px, beyond the radius.

    Returns
    -------
    (float, float), float
        Best place, px, and the share of the disc's area that shows its colour there.
    """
    span = int(kind.radius) + search
    left, top = (int(np.floor(c)) - span for c in predicted)
    x0, y0 = max(left, 0), max(top, 0)
    patch = image[y0 : max(top + 2 * span + 1, 0) : SCALE, x0 : max(left + 2 * span + 1, 0) : SCALE]
    if patch.size == 0:
        return tuple(predicted), 0.0
    score = _score(patch, kind)
    y, x = np.mgrid[: score.shape[0], : score.shape[1]]
    y, x = y * SCALE + y0, x * SCALE + x0
    for cx, cy, reach in others:
        score[(x - cx) ** 2 + (y - cy) ** 2 < reach**2] = 0.0
    kernel = _kernel(kind.radius / SCALE)
    gain = cv2.filter2D(score, -1, kernel, borderType=cv2.BORDER_CONSTANT) / kernel.sum()
    far = np.hypot(x - predicted[0], y - predicted[1])
    best = np.unravel_index(np.argmax(gain - 1e-3 * far / search), gain.shape)
    return (float(x[best]), float(y[best])), float(gain[best])


def place(image, kind, start, others, behind=None):
    """Place a disc to a fraction of a pixel by least squares on the coverage of its edge.

    The model of the coverage at distance d from the centre is (1 - erf((d - R)/(s sqrt 2)))/2,
    a sharp edge blurred by a Gaussian; Gauss-Newton steps move the centre.

    Parameters
    ----------
    image, kind
    start : (float, float)
    others : sequence of (x, y, reach)
        Discs that may hide a part of this one (or be hidden by it).
    behind : ndarray, shape (h, w, 3), optional
        Background image; needed if `kind.surround` is None.

    Returns
    -------
    Placed
        The covariance is that of independent pixel errors; trackers rescale it by what the
        whole track shows (`bsp_gp.vision.smoothing.calibrated`).
    """
    centre = np.array(start, dtype=float)
    span = int(np.ceil(kind.radius + EDGE * kind.edge + SLACK))
    height, width = image.shape[:2]
    x0, y0 = (int(round(c)) - span for c in centre)
    box = (
        slice(max(y0, 0), min(y0 + 2 * span + 1, height)),
        slice(max(x0, 0), min(x0 + 2 * span + 1, width)),
    )
    patch = image[box]
    if patch.size == 0:
        return gap("left the picture")
    y, x = np.ogrid[box[0], box[1]]
    d0 = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2)
    near = np.abs(d0 - kind.radius) < EDGE * kind.edge + SLACK
    rows, columns = np.nonzero(near)
    px, py = columns + box[1].start, rows + box[0].start
    whole = near.sum()
    visible = np.ones(len(px), dtype=bool)
    for cx, cy, reach in others:
        visible &= (px - cx) ** 2 + (py - cy) ** 2 > (reach + MARGIN + 3 * kind.edge) ** 2
    px, py = px[visible], py[visible]
    if len(px) < MIN_SEEN * whole:
        return gap("hidden by another disc", seen=len(px) / whole)
    pixels = image[py, px][:, None]
    surround = kind.surround if kind.surround is not None else behind[py, px][:, None]
    measured = coverage(pixels, kind.colour, surround)[:, 0].astype(float)
    for _ in range(ITERATIONS):
        dx, dy = px - centre[0], py - centre[1]
        d = np.maximum(np.sqrt(dx * dx + dy * dy), 1e-9)  # the centre itself may be a pixel
        u = (d - kind.radius) / kind.edge
        used = np.abs(u) < EDGE
        slope = np.exp(-0.5 * u * u) / (np.sqrt(2 * np.pi) * kind.edge)
        residual = np.where(used, measured - 0.5 * (1 - erf(u / np.sqrt(2))), 0.0)
        gradient = np.stack([slope * dx / d, slope * dy / d]) * used
        information = gradient @ gradient.T
        half = 0.5 * np.trace(information)
        smallest = half - np.hypot(0.5 * (information[0, 0] - information[1, 1]), information[0, 1])
        if smallest < 0.02 * np.pi * kind.radius / (2 * np.sqrt(np.pi) * kind.edge):
            return gap("too little of the edge is seen", seen=len(px) / whole)
        step = np.linalg.solve(information, gradient @ residual)
        length = np.hypot(*step)
        centre = centre + step * min(1.0, 3.0 / max(length, 1e-12))
        if length < 1e-2:  # the next step would be its square
            break
    n = max(int(used.sum()), 3)
    rms = float(np.sqrt(np.sum(residual**2) / n))
    seen = len(px) / whole
    if np.hypot(*(centre - start)) > 10:
        return gap("the fit ran away", rms, seen)
    if rms > MAX_RMS:
        return gap("does not look like the disc", rms, seen)
    naive = rms**2 * np.linalg.inv(information)
    return Placed(centre, naive, rms, seen, "", _clustering(naive, gradient, residual, dx, dy))


def _clustering(naive, gradient, residual, dx, dy):
    """Ratio of the cluster-robust variance to that of independent pixels (White 1980).

    Clusters are sectors of the edge: errors of blur and compression run along it.
    """
    sector = np.floor((np.arctan2(dy, dx) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    sums = np.stack([np.bincount(sector, g * residual, SECTORS) for g in gradient])
    bread = np.linalg.inv(gradient @ gradient.T)
    robust = bread @ (sums @ sums.T) @ bread * SECTORS / (SECTORS - 2)
    return float(np.trace(robust) / max(np.trace(naive), 1e-12))


def _profile(images, kind, centres):
    """Median coverage and BGR at each distance from the centres, in half pixels."""
    bins = np.arange(0, kind.radius * 1.6 + 8, 0.5)
    samples = [[] for _ in bins]
    for image, centre in zip(images, centres, strict=True):
        x0, y0 = (max(int(c - bins[-1]), 0) for c in centre)
        near = image[y0 : y0 + 2 * int(bins[-1]) + 2, x0 : x0 + 2 * int(bins[-1]) + 2]
        y, x = np.mgrid[: near.shape[0], : near.shape[1]]
        d = np.hypot(x + x0 - centre[0], y + y0 - centre[1])
        inside = d < bins[-1] - 0.5
        index = np.round(d[inside] / 0.5).astype(int)
        pixels = near[inside]
        for k in range(len(bins)):
            samples[k].append(pixels[index == k])
    colours, spreads = np.full((len(bins), 3), np.nan), np.full(len(bins), np.nan)
    for k, parts in enumerate(samples):
        pixels = np.concatenate(parts).astype(float)
        if len(pixels):
            colours[k] = np.median(pixels, axis=0)
            spreads[k] = np.median(np.linalg.norm(pixels - colours[k], axis=1))
    return bins, colours, spreads


def _moving_colour(images):
    """What moves in images, as ``; what moves there is #rrggbb``; "" where nothing does."""
    if len(images) < 3:
        return ""
    stack = np.asarray(images, dtype=np.int16)
    still = np.median(stack, axis=0)
    moving = np.abs(stack - still).sum(axis=3) > _MOVED
    if not moving.any():
        return ""
    blue, green, red = np.median(stack[moving], axis=0).astype(int)
    return f"; what moves there is #{red:02x}{green:02x}{blue:02x}"


def calibrate_kind(images, colour, radius=None, behind=None):
    """Learn what the discs of one colour look like from sample images.

    Parameters
    ----------
    colour : ndarray, shape (3,)
        Approximate BGR.
    radius : float, optional
        Radius of the coloured part, px; found from round, free-standing patches if not given.
    behind : ndarray, optional
        Background image; used if the disc has no outline.

    Raises
    ------
    DataError
        No free-standing round patch of that colour in any image.
    """
    patches = []
    for k, image in enumerate(images):
        mask = is_colour(image, colour, TOLERANCE).astype(np.uint8)
        count, labels, stats, centroids = cv2.connectedComponentsWithStats(mask)
        for label in range(1, count):
            left, top, wide, high, area = stats[label]
            squareness = min(wide, high) / max(wide, high)
            fill = area / (np.pi / 4 * wide * high)
            if area > 50 and squareness > 0.93 and 0.93 < fill < 1.06:
                patches.append((k, centroids[label], np.sqrt(area / np.pi), labels == label))
    if radius is not None:
        patches = [p for p in patches if abs(p[2] - radius) < 0.15 * radius + 1]
    if not patches:
        blue, green, red = np.round(colour).astype(int)
        raise DataError(
            f"no free-standing round patch of the colour #{red:02x}{green:02x}{blue:02x}",
            remedy=f"give the radius in px, or another colour{_moving_colour(images)}; where that "
            "is its colour already, something that it touches (a rod) may look alike: mark it "
            "with moving:X,Y,W,H@FRAME",
        )
    typical = float(np.median([p[2] for p in patches]))
    patches = [p for p in patches if abs(p[2] - typical) < 0.05 * typical + 0.5]
    patches = patches[:: max(1, len(patches) // 12)]
    fill = np.median(
        np.concatenate([images[k][m][::7] for k, _, _, m in patches]).astype(float), axis=0
    ).astype(np.float32)
    kind = DiscKind(fill, typical)
    return _edge_fitted([images[p[0]] for p in patches], kind, [p[1] for p in patches], behind)


def _edge_fitted(images, kind, centres, behind):
    """Radius, edge width and outline from the mean profile of free-standing discs."""
    bins, colours, spreads = _profile(images, kind, centres)
    contrast = np.linalg.norm(colours - kind.colour, axis=1)
    # An outline is a ring of one colour (small spread) right outside of the fill, on all discs.
    ring = (bins > kind.radius + 1.5) & (bins < kind.radius * 1.35 + 6)
    beyond = np.median(behind.reshape(-1, 3), axis=0) if behind is not None else colours[-1]
    # A blurred edge without outline mixes fill and background; an outline lies off that line.
    along = (beyond - kind.colour) / max(np.linalg.norm(beyond - kind.colour), 1e-9)
    off = colours - kind.colour
    aside = np.linalg.norm(off - np.outer(off @ along, along), axis=1)
    aside = np.where(ring & (spreads < STEADY), aside, -1.0)
    surround, reach = None, kind.radius
    if aside.max() > 50:
        purest = int(np.argmax(aside))
        outline = colours[purest]
        same = np.linalg.norm(colours - outline, axis=1) < 60
        stop = bins[(bins > bins[purest]) & ~same]
        if len(stop):
            surround, reach = outline.astype(np.float32), float(stop[0])
    outside = surround if surround is not None else colours[np.argmax(bins > kind.radius + 5)]
    whole = max(np.linalg.norm(outside - kind.colour), 30.0)
    alpha = np.clip(1 - contrast / whole, 0, 1)
    use = (bins > kind.radius - 6) & (bins < min(reach if surround is not None else 1e9,
                                                kind.radius + 6))  # fmt: skip

    def loss(radius, edge):
        model = 0.5 * (1 - erf((bins[use] - radius) / (edge * np.sqrt(2))))
        return np.sum((alpha[use] - model) ** 2)

    radii = np.arange(kind.radius - 2, kind.radius + 2.01, 0.1).tolist()
    radius, edge = min(itertools.product(radii, EDGES), key=lambda each: loss(*each))
    return replace(kind, radius=radius, edge=edge, surround=surround, reach=max(reach, radius + 1))
