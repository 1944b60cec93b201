"""Films of scenes whose every place is known: drawn with analytic edges, blurred and compressed.

A pixel is a square around whole-numbered coordinates: (0, 0) is the middle of the upper left one,
x points right and y down, as trackers have it. A disc covers of a pixel what its edge leaves of
it, so that the centre of gravity of what is drawn is the true centre to a hundredth of a pixel.
"""

import itertools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bsp_gp.errors import OutputError, SettingsError
from bsp_gp.output.place import claim

# Okabe and Ito's colours, red-green-blue, and greys for what does not move.
_COLOURS = np.array([
    (0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0), (86, 180, 233),
    (0, 0, 0),
], dtype=float)  # fmt: skip
_GREYS = {"rect_wall": (150.0, 150.0, 150.0), "rect_mat": (222.0, 222.0, 222.0)}
_ANCHOR = (90.0, 90.0, 90.0)
_MAX_PIXELS = 40_000_000
_PARTS = 4


@dataclass(frozen=True)
class Camera:
    """Where a film looks, straight on.

    Parameters
    ----------
    width, height : int, pixels
    scale : float, pixels per metre
    centre : (float, float), metres
        What lies in the middle of the picture.
    """

    width: int = 640
    height: int = 480
    scale: float = 1.0
    centre: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self):
        if min(self.width, self.height) < 8 or self.width * self.height > _MAX_PIXELS:
            raise SettingsError(
                f"a film must be from 8 pixels to {_MAX_PIXELS:,} pixels in all, "
                f"got {self.width} x {self.height}"
            )
        if not (self.scale > 0 and math.isfinite(self.scale)):
            raise SettingsError(f"scale of a camera must be positive, got {self.scale}")

    @classmethod
    def fitting(cls, scenes, width=640, height=480, margin=0.05):
        """A camera that sees all bodies that move, at all times, and anchors.

        Walls and mats may be cut off.
        """
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for scene in scenes:
            for k, entity in enumerate(scene.entities):
                if entity.shape.startswith("rect"):
                    continue
                size = entity.radius if entity.radius > 0 else 0.0
                low = np.minimum(low, np.nanmin(scene.positions[:, k], axis=0) - size)
                high = np.maximum(high, np.nanmax(scene.positions[:, k], axis=0) + size)
        if not np.all(np.isfinite(low)):
            raise SettingsError("nothing moves in these scenes, so no camera fits them")
        span = np.maximum(high - low, 1e-9 + 1e-3 * np.max(high - low))
        scale = (1 - 2 * margin) * float(np.min(np.array([width, height]) / span))
        return cls(width, height, scale, tuple(((low + high) / 2).tolist()))

    def pixels(self, positions):
        """Pixel coordinates (x right, y down) of places in metres, shape (..., 2)."""
        p = (np.asarray(positions, dtype=float) - self.centre) * (self.scale, -self.scale)
        return p + ((self.width - 1) / 2, (self.height - 1) / 2)


@dataclass(frozen=True)
class Look:
    """What a camera does to the picture.

    Parameters
    ----------
    exposure : float, 0 to 1
        Share of the time between frames that the shutter is open, around the frame's time.
    n_exposures : int
        Pictures added up for one frame where `exposure` is above 0.
    blur : float, pixels
        Standard deviation of the defocus.
    noise : float, grey levels
        Standard deviation on every pixel and colour.
    quality : int or None
        JPEG quality that every frame is compressed to, 1 to 100; None leaves it exact.
    least_radius : float, pixels
        Discs and anchors are drawn at least so large.
    background : int, grey level
        Not quite white, so that noise is not cut off.
    """

    exposure: float = 0.0
    n_exposures: int = 8
    blur: float = 0.0
    noise: float = 0.0
    quality: int | None = None
    least_radius: float = 3.0
    background: int = 240

    def __post_init__(self):
        if not 0 <= self.exposure <= 1:
            raise SettingsError(f"exposure must be from 0 to 1, got {self.exposure}")
        if self.n_exposures < 1 or min(self.blur, self.noise) < 0 or self.least_radius <= 0:
            problem = "n_exposures and least_radius must be positive, blur and noise >= 0"
            raise SettingsError(problem)
        if self.quality is not None and not 1 <= self.quality <= 100:
            raise SettingsError(f"quality must be from 1 to 100, got {self.quality}")
        if not 0 <= self.background <= 255:
            raise SettingsError(f"background must be from 0 to 255, got {self.background}")


def film_scene(scene, camera, look=None, *, rng):
    """Draw every frame of a scene.

    Parameters
    ----------
    scene : Scene
        In 2-D. Its velocities, if it has them, say where bodies are while the shutter is open.
    rng : numpy.random.Generator
        For the noise.

    Returns
    -------
    frames : iterator of ndarray, shape (height, width, 3), uint8, red-green-blue
    truth : ndarray, shape (T, N, 2), pixels
        Where every entity is, averaged over the exposure; nan where it is not seen.
    """
    look = look or Look()
    if scene.n_dims != 2:
        raise SettingsError(f"films are made of scenes in 2-D, scene {scene.name!r} is in 3-D")
    places = camera.pixels(_exposed(scene, look))
    frames = (_frame(scene.entities, now, camera, look, rng) for now in places)
    return frames, places.mean(axis=1)


def _exposed(scene, look):
    """Places while the shutter is open, shape (T, exposures, N, 2), metres."""
    p, times = scene.positions, scene.times
    if look.exposure == 0:
        return p[:, None]
    from scipy.interpolate import CubicHermiteSpline

    v = scene.velocities
    v = np.gradient(p, times, axis=0) if v is None else v
    fractions = (np.arange(look.n_exposures) + 0.5) / look.n_exposures - 0.5
    dt = np.gradient(times)
    when = times[:, None] + look.exposure * dt[:, None] * fractions
    inside = np.clip(when, times[0], times[-1])
    places = np.empty((*when.shape, *p.shape[1:]))
    for k in range(p.shape[1]):
        seen = np.isfinite(p[:, k]).all(axis=-1) & np.isfinite(v[:, k]).all(axis=-1)
        if seen.sum() < 2:
            places[:, :, k] = p[:, None, k]
            continue
        curve = CubicHermiteSpline(times[seen], p[seen, k], v[seen, k])
        slope = curve.derivative()(inside)
        places[:, :, k] = curve(inside) + slope * (when - inside)[..., None]
        places[~seen, :, k] = np.nan
    return places


def _frame(entities, places, camera, look, rng):
    import cv2

    picture = np.mean([_drawn(entities, now, camera, look) for now in places], axis=0)
    if look.blur:
        picture = cv2.GaussianBlur(picture, (0, 0), look.blur, borderType=cv2.BORDER_REPLICATE)
    if look.noise:
        picture = picture + look.noise * rng.standard_normal(picture.shape)
    picture = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    if look.quality is not None:
        how = [cv2.IMWRITE_JPEG_QUALITY, look.quality]
        ok, data = cv2.imencode(".jpg", picture[..., ::-1], how)
        if not ok:
            raise OutputError("OpenCV cannot write JPEG here")
        picture = cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]
    return np.ascontiguousarray(picture)


def _drawn(entities, places, camera, look):
    """One instant, shape (height, width, 3), grey levels; what does not move lies below."""
    picture = np.full((camera.height, camera.width, 3), float(look.background))
    moving = [k for k, entity in enumerate(entities) if not entity.is_static]

    def depth(k):
        return not entities[k].is_static, entities[k].shape != "rect_mat"

    for k in sorted(range(len(entities)), key=depth):
        entity, (x, y) = entities[k], places[k]
        if not (math.isfinite(x) and math.isfinite(y)):
            continue
        if entity.shape in _GREYS:
            half = camera.scale * entity.width / 2, camera.scale * entity.height / 2
            _paint(picture, x, y, *half, _rectangle, _GREYS[entity.shape])
        else:
            radius = camera.scale * entity.radius if entity.radius > 0 else 0.0
            radius = max(radius, look.least_radius)
            colour = _ANCHOR if entity.is_static else _COLOURS[moving.index(k) % len(_COLOURS)]
            _paint(picture, x, y, radius, radius, _disc, colour)
    return picture


def _paint(picture, x, y, half_width, half_height, coverage, colour):
    """Lay a shape over the picture, in the pixels near it only."""
    height, width = picture.shape[:2]
    x0, x1 = max(math.floor(x - half_width) - 1, 0), min(math.ceil(x + half_width) + 2, width)
    y0, y1 = max(math.floor(y - half_height) - 1, 0), min(math.ceil(y + half_height) + 2, height)
    if x0 >= x1 or y0 >= y1:
        return
    dx, dy = np.arange(x0, x1) - x, np.arange(y0, y1)[:, None] - y
    share = coverage(dx, dy, half_width, half_height)[..., None]
    part = picture[y0:y1, x0:x1]
    part += share * (np.asarray(colour) - part)


def _disc(dx, dy, radius, _):
    """Share of every pixel inside of a disc; its edge is taken as straight in parts of a pixel."""
    parts = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
    x, y = (dx[:, None] + parts).ravel(), (dy + parts).ravel()
    inside = np.clip(_PARTS * (radius - np.hypot(x, y[:, None])) + 0.5, 0.0, 1.0)
    return inside.reshape(len(dy), _PARTS, len(dx), _PARTS).mean(axis=(1, 3))


def _rectangle(dx, dy, half_width, half_height):
    """Share of every pixel inside of an upright rectangle, exactly."""

    def overlap(d, half):
        return np.clip(np.minimum(d + 0.5, half) - np.maximum(d - 0.5, -half), 0.0, 1.0)

    return overlap(dx, half_width) * overlap(dy, half_height)


def write_film(frames, path, fps, *, overwrite=False):
    """Write frames as a film, whole or not at all.

    Parameters
    ----------
    frames : iterable of ndarray, shape (height, width, 3), uint8, red-green-blue
    path : path-like
        Its ending chooses the codec: .mp4 (MPEG-4), .avi (Motion-JPEG), .mkv (FFV1, lossless).

    Raises
    ------
    OutputError
        If the file exists, or OpenCV cannot write it.
    """
    from bsp_gp.vision.video import VideoWriter

    path = Path(path)
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise OutputError(f"{path}: a film needs at least one frame")
    if path.exists() and not overwrite:
        raise OutputError(f"{path} exists already; choose another name, or overwrite")
    with VideoWriter(path, fps, first.shape[1::-1]) as film:
        for frame in itertools.chain((first,), frames):
            film.write(frame[..., ::-1])
    return path


def write_frames(frames, folder):
    """Write frames as PNG files ``0000.png`` ... into a folder, which must not exist yet."""
    import cv2

    folder = Path(folder)
    with claim(folder, "folder of frames") as place, place.fill("folder of frames") as fresh:
        for k, frame in enumerate(frames):
            is_good, data = cv2.imencode(".png", frame[..., ::-1])
            if not is_good:
                raise OutputError(f"{folder}: OpenCV cannot say frame {k} as PNG")
            (fresh / f"{k:04d}.png").write_bytes(data.tobytes())
    return folder
