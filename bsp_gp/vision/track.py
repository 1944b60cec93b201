"""The noun of this room: where objects were in a video, how sure that is, and where it is not."""

from dataclasses import dataclass, field

import numpy as np


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
