"""A solid object of any shape, followed by its chromaticity: background subtraction and contour.

Chromaticity (colour without brightness) separates an object from its own shadow and from motion
blur better than colour does. The outline of the object is the convex hull of the pixels that are
nearer to its chromaticity than to that of what is behind it; its position is the centroid of that
hull. The covariance comes from how far the centroid moves with the threshold, and from the
calibration of the whole track (`bsp_gp.vision.smoothing`).
"""

from dataclasses import dataclass

import cv2
import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.vision.colour import background
from bsp_gp.vision.track import Track

THRESHOLDS = (0.4, 0.5, 0.6)
DARK = 40.0  # mean of the three channels: darker pixels have no colour
CLOSE = 2.0  # coverage above this overshoots the object's colour: something else


@dataclass(frozen=True)
class BlobSettings:
    """How one object is told from the rest.

    Attributes
    ----------
    box : (int, int, int, int)
        x, y, width, height of a rectangle inside of the object, px.
    frame : int
        Frame in which the rectangle is drawn.
    against : str
        ``background``: each pixel is compared with the median of the video there (the object
        must move away); ``surround``: with the median chromaticity of a ring around it.
    blur : float
        Standard deviation of the smoothing before colours are compared, px.
    least : float
        Least area of the object, px²; smaller patches are no object.
    reach : float
        How far from its predicted place the object is looked for, px.
    contrast : float
        Least summed difference of the three channels from the background.
    overshoot : float
        Coverage beyond which a pixel is of something else (a hand).
    cue : str
        ``all``: the whole chromaticity; ``red-green``: red minus green over brightness alone,
        which tells wood from paper and from skin.
    """

    box: tuple
    frame: int
    against: str = "background"
    blur: float = 2.0
    least: float = 200.0
    reach: float = 150.0
    contrast: float = 14.0
    overshoot: float = CLOSE
    cue: str = "all"

    def __post_init__(self):
        if self.against not in ("background", "surround"):
            raise SettingsError(f"against must be background or surround, got {self.against!r}")
        if self.cue not in ("all", "red-green"):
            raise SettingsError(f"cue must be all or red-green, got {self.cue!r}")
        if len(self.box) != 4 or min(self.box[2:]) < 2:
            raise SettingsError(f"the box must be x, y, width, height, got {self.box}")


def chromaticity(image, cue="all"):
    """Colour over brightness, shape (h, w, 3) (or (h, w, 1)), and the brightness, shape (h, w)."""
    image = image.astype(np.float32)
    brightness = image.mean(axis=2)
    if cue == "red-green":
        image = image[..., 2:3] - image[..., 1:2]
    return image / (brightness[..., None] + 10.0), brightness


def _square(size):
    return np.ones((size, size), np.uint8)


def _coverage(image, own, behind, settings):
    """Share of the way from what is behind to the object's chromaticity, shape (h, w)."""
    colour, brightness = chromaticity(image, settings.cue)
    apart = own - behind
    share = np.einsum("ijk,ijk->ij", colour - behind, np.broadcast_to(apart, colour.shape))
    share = share / np.maximum(np.sum(np.broadcast_to(apart, colour.shape) ** 2, axis=2), 4e-4)
    return np.where(brightness > DARK, share, 0.0)


def _outline(share, threshold, overshoot, near, settings):
    """Convex hull of the patch nearest to `near`: moments, or None."""
    # A hand: patches beyond the object's colour, with their softer rim.
    other = cv2.morphologyEx((share > overshoot).astype(np.uint8), cv2.MORPH_OPEN, _square(7))
    mask = ((share > threshold) & (cv2.dilate(other, _square(9)) == 0)).astype(np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _square(7))
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _square(15))
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(mask)
    best, choice = None, None
    for label in range(1, count):
        area = stats[label][4]
        far = np.hypot(*(centroids[label] - near))
        if area >= settings.least and far < settings.reach:
            score = area * np.exp(-0.5 * (far / (0.5 * settings.reach)) ** 2)
            if best is None or score > best:
                best, choice = score, label
    if choice is None:
        return None
    contours, _ = cv2.findContours(
        (labels == choice).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    hull = cv2.convexHull(max(contours, key=len))
    moments = cv2.moments(hull)
    if moments["m00"] <= 0:
        return None
    centre = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    return centre, moments["m00"], hull


def _outlines(image, near, own, other, behind, settings):
    """Outlines of the object at all thresholds, in a window around `near`; None where none is."""
    span = settings.reach + 2 * np.sqrt(settings.box[2] * settings.box[3])
    height, width = image.shape[:2]
    left, top = (
        int(np.clip(c - span, 0, n - 2)) for c, n in zip(near, (width, height), strict=True)
    )
    right, bottom = (
        int(np.clip(c + span, a + 2, n))
        for c, a, n in zip(near, (left, top), (width, height), strict=True)
    )
    window = np.s_[top:bottom, left:right]
    patch = cv2.GaussianBlur(image[window], (0, 0), settings.blur)
    share = _coverage(patch, own, other[window] if other.ndim == 3 else other, settings)
    if behind is not None:
        change = cv2.absdiff(patch, behind[window]).astype(np.int32).sum(axis=2)
        share = np.where(change > settings.contrast, share, 0.0)
    corner = np.array([left, top], dtype=float)
    found = [_outline(share, t, settings.overshoot, near - corner, settings) for t in THRESHOLDS]
    return [None if f is None else (f[0] + corner, f[1], f[2] + corner) for f in found]


def track_blob(video, name, settings, first=0, last=None):
    """Follow one object through frames ``first..last``.

    Returns
    -------
    Track
        `rms` is the scatter of the centroid over the thresholds (px), `seen` the area over its
        median.

    Raises
    ------
    SettingsError
        The frame or the box lies outside of the video.
    """
    last = video.n_frames - 1 if last is None else min(last, video.n_frames - 1)
    if not first <= settings.frame <= last:
        raise SettingsError(f"the frame of the box must be {first}..{last}, got {settings.frame}")
    behind = None
    if settings.against == "background":
        behind, _ = background(video.sample(min(24, video.n_frames))[1])
    image = next(picture for _, picture in video.frames(settings.frame, settings.frame + 1))
    x, y, width, height = settings.box
    inside = image[y : y + height, x : x + width]
    if inside.size == 0:
        raise SettingsError(f"the box {settings.box} lies outside of the picture")
    channels = 1 if settings.cue == "red-green" else 3
    own = np.median(chromaticity(inside, settings.cue)[0].reshape(-1, channels), axis=0)
    if settings.against == "background":
        behind = cv2.GaussianBlur(behind, (0, 0), settings.blur)
        other = chromaticity(behind, settings.cue)[0]
    else:
        ring = image[max(y - 2 * height, 0) : y + 3 * height, max(x - 3 * width, 0) : x + 4 * width]
        other = np.median(chromaticity(ring, settings.cue)[0].reshape(-1, channels), axis=0)
    start = np.array([x + width / 2, y + height / 2])
    found = {}
    # Only the frames before the marked one are kept in memory, to be run through backwards.
    before = reversed(list(video.frames(first, settings.frame + 1)))
    for images in (before, video.frames(settings.frame, last + 1)):
        place, velocity = start, np.zeros(2)
        for frame, picture in images:
            outlines = _outlines(picture, place + velocity, own, other, behind, settings)
            found[frame] = outlines
            if outlines[1] is not None:
                new = outlines[1][0]
                velocity = new - place if frame != settings.frame else np.zeros(2)
                place = new
            else:
                place = place + velocity
    return _gathered(video, name, found)


def _gathered(video, name, found):
    frames = sorted(found)
    positions = np.full((len(frames), 1, 2), np.nan)
    covariances = np.full((len(frames), 1, 2, 2), np.nan)
    rms = np.full((len(frames), 1), np.nan)
    area = np.full(len(frames), np.nan)
    reasons = []
    for k, frame in enumerate(frames):
        if found[frame][1] is None:
            reasons.append((frame, name, "no patch of its colour near its predicted place"))
            continue
        centres = np.array([o[0] for o in found[frame] if o is not None])
        positions[k, 0] = found[frame][1][0]
        off = centres - positions[k, 0]
        rms[k, 0] = np.sqrt(np.mean(np.sum(off**2, axis=1)))
        area[k] = found[frame][1][1]
        covariances[k, 0] = np.eye(2) * (0.2**2) + off.T @ off / max(len(off) - 1, 1)
    known = area[np.isfinite(area)]
    typical = float(np.median(known)) if len(known) else 1.0
    seen = (area / (typical or 1.0))[:, None]
    return Track(
        (name,), np.array(frames), video.fps, positions, covariances, rms, np.minimum(seen, 1.0),
        tuple(reasons), {name: "patch of one chromaticity"}, {name: float("nan")}, "px",
    )  # fmt: skip
