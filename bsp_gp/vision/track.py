"""The noun of this room: where objects were in a video, how sure that is, and where it is not."""

from dataclasses import dataclass, field

import numpy as np

from bsp_gp.errors import SettingsError

NOWHERE = (np.full(2, np.nan), np.full((2, 2), np.nan), np.nan)
"""Place, covariance and rms of what is not found."""


@dataclass(frozen=True, eq=False)
class Track:
    """Positions of named objects in the frames of one video, in pixels (x right, y down).

    Attributes
    ----------
    frames : ndarray of int, shape (T,)
        Indices of decoded frames.
    positions : ndarray, shape (T, N, 2)
        nan where an object was not measured; nothing is filled in.
    covariances : ndarray, shape (T, N, 2, 2)
        Of the measured positions, px².
    rms : ndarray, shape (T, N)
        Residual of the tracker's own fit, in its own unit (see `unit`).
    seen : ndarray, shape (T, N)
        Share of the object that was visible, 0..1.
    reasons : tuple of (frame, name, reason)
        Why a position is missing.
    kinds : mapping of str to str
        How each object was tracked.
    radii : mapping of str to float
        Outer radius of each disc, px; nan where it has none.
    unit : str
        What `rms` counts.
    lossy : bool
        Whether the video is compressed with loss, whose errors last for several frames.
    """

    names: tuple[str, ...]
    frames: np.ndarray
    fps: float
    positions: np.ndarray
    covariances: np.ndarray
    rms: np.ndarray
    seen: np.ndarray
    reasons: tuple = ()
    kinds: dict = field(default_factory=dict)
    radii: dict = field(default_factory=dict)
    unit: str = "coverage"
    lossy: bool = True

    @property
    def times(self):
        """Times of the frames, shape (T,), seconds."""
        return self.frames / self.fps

    @property
    def sigma(self):
        """Standard errors per axis, shape (T, N, 2), px."""
        return np.sqrt(np.einsum("tnii->tni", self.covariances))

    def of(self, name):
        """Index of an object."""
        return self.names.index(name)


def last_frame(video, last):
    """The last frame that is looked at, whatever the caller asks for."""
    return video.n_frames - 1 if last is None else min(last, video.n_frames - 1)


def both_ways(video, frame, first, last):
    """Frames from `frame` backwards (kept in memory), then from it forwards."""
    if not first <= frame <= last:
        raise SettingsError(f"the frame must be {first}..{last}, got {frame}")
    yield reversed(list(video.frames(first, frame + 1)))
    yield video.frames(frame, last + 1)


def walk(video, frame, first, last, start, step):
    """What `step(image, predicted)` gives, both ways from a frame, by frame.

    That is a place, its covariance, rms and the reason where there is none ("" elsewhere), or more.
    """
    found = {}
    for images in both_ways(video, frame, first, last):
        place, velocity = np.array(start, dtype=float), np.zeros(2)
        for index, image in images:
            found[index] = step(image, place + velocity)
            new, _, _, reason, *_ = found[index]
            if reason:
                place = place + velocity
            else:
                velocity, place = new - place if index != frame else np.zeros(2), new
    return found


def track_of(video, name, found, kind, unit, *, lossy, seen=None):
    """The track of one object, of what `walk` found; `seen` (T,) is 1 where it was unless given."""
    frames = sorted(found)
    places, covariances, rms, reasons = zip(*(found[f][:4] for f in frames), strict=True)
    seen = [0.0 if reason else 1.0 for reason in reasons] if seen is None else seen
    return Track(
        (name,), np.array(frames), video.fps, np.array(places)[:, None],
        np.array(covariances)[:, None], np.array(rms)[:, None], np.array(seen)[:, None],
        tuple((f, name, r) for f, r in zip(frames, reasons, strict=True) if r), {name: kind},
        {name: float("nan")}, unit, lossy,
    )  # fmt: skip
