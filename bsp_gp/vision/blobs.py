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
from bsp_gp.vision.track import NOWHERE, last_frame, track_of, walk

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
    """Centre and area of the convex hull of the patch nearest to `near`, or None."""
    # A hand: patches beyond the object's colour, with their softer rim.
    other = cv2.morphologyEx((share > overshoot).astype(np.uint8), cv2.MORPH_OPEN, _square(7))
    mask = ((share > threshold) & (cv2.dilate(other, _square(9)) == 0)).astype(np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _square(7))
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _square(15))
    count, labels, stats, centroids = cv2.connectedComponentsWithStats(mask)
    scores = {}
    for label in range(1, count):
        area = stats[label][4]
        far = np.hypot(*(centroids[label] - near))
        if area >= settings.least and far < settings.reach:
            scores[label] = area * np.exp(-0.5 * (far / (0.5 * settings.reach)) ** 2)
    if not scores:
        return None
    choice = max(scores, key=scores.get)
    contours, _ = cv2.findContours(
        (labels == choice).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    hull = cv2.convexHull(max(contours, key=len))
    moments = cv2.moments(hull)
    if moments["m00"] <= 0:
        return None
    return np.array([moments["m10"], moments["m01"]]) / moments["m00"], moments["m00"]


def _outlines(image, near, own, other, behind, settings):
    """Outlines of the object at all thresholds, in a window around `near`; None where none is."""
    span = settings.reach + 2 * np.sqrt(settings.box[2] * settings.box[3])
    size = np.array(image.shape[1::-1])
    corner = np.clip(near - span, 0, size - 2).astype(int)
    right, bottom = np.clip(near + span, corner + 2, size).astype(int)
    window = np.s_[corner[1] : bottom, corner[0] : right]
    patch = cv2.GaussianBlur(image[window], (0, 0), settings.blur)
    share = _coverage(patch, own, other[window] if other.ndim == 3 else other, settings)
    if behind is not None:
        change = cv2.absdiff(patch, behind[window]).astype(np.int32).sum(axis=2)
        share = np.where(change > settings.contrast, share, 0.0)
    found = [_outline(share, t, settings.overshoot, near - corner, settings) for t in THRESHOLDS]
    return [None if f is None else (f[0] + corner, f[1]) for f in found]


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
    last = last_frame(video, last)
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

    def step(picture, predicted):
        outlines = _outlines(picture, predicted, own, other, behind, settings)
        if outlines[1] is None:
            return (*NOWHERE, "no patch of its colour near its predicted place", np.nan)
        place, area = outlines[1]
        off = np.array([outline[0] for outline in outlines if outline is not None]) - place
        covariance = np.eye(2) * (0.2**2) + off.T @ off / max(len(off) - 1, 1)
        return place, covariance, np.sqrt(np.mean(np.sum(off**2, axis=1))), "", area

    start = np.array([x + width / 2, y + height / 2])
    return _gathered(video, name, walk(video, settings.frame, first, last, start, step))


def _gathered(video, name, found):
    area = np.array([found[frame][4] for frame in sorted(found)])
    known = area[np.isfinite(area)]
    typical = float(np.median(known)) if len(known) else 1.0
    seen = np.minimum(area / (typical or 1.0), 1.0)
    kind = "patch of one chromaticity"
    return track_of(video, name, found, kind, "px", lossy=True, seen=seen)
