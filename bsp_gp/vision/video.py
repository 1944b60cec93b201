"""Frames of a video file, in order, with their times; opened and closed in one place."""

import contextlib
import math
import os
from dataclasses import dataclass
from pathlib import Path

# FFmpeg and OpenCV write what they think of a damaged film to stderr, past Python; what could be
# decoded is counted here and told. FFmpeg reads this variable when the first video is opened.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import cv2  # noqa: E402
import numpy as np  # noqa: E402

from bsp_gp.errors import DataError, OutputError  # noqa: E402
from bsp_gp.output.place import whole_file  # noqa: E402

# Silent; OpenCV 5 has it in another place than OpenCV 4.10.
getattr(cv2.utils, "logging", cv2).setLogLevel(0)

MAX_FPS = 100_000.0
LOSSLESS = ("FFV1", "HFYU", "FFVH", "PNG ", "MPNG", "DIB ", "RGBA", "ULRG")


@dataclass(frozen=True)
class Video:
    """A video file that can be read from its start any number of times.

    Attributes
    ----------
    fps : float
        Frames a second as the header says (or as the user declared); frames are taken to be
        evenly spaced, which is what decoded frames of a constant-rate file are.
    width, height : int
        Pixels.
    n_frames : int
        Frames that could be *decoded*; the header's count is often wrong.
    n_header : int
        Frames that the header promises.
    codec : str
        Four letters.
    """

    path: Path
    fps: float
    width: int
    height: int
    n_frames: int
    n_header: int
    codec: str = ""

    @property
    def is_lossy(self):
        """Whether the codec loses information (anything that is not known to be lossless)."""
        return self.codec.upper() not in LOSSLESS

    def frames(self, start=0, stop=None, wanted=None):
        """Yield ``(index, image)``; images are BGR, uint8, shape (height, width, 3).

        `wanted` (a set of indices) spares converting the other frames.

        The file is always decoded from its first frame: seeking in compressed video is not
        exact in OpenCV.
        """
        capture = _capture(self.path)
        try:
            index = 0
            while stop is None or index < stop:
                if index < start or (wanted is not None and index not in wanted):
                    if not capture.grab():
                        break
                else:
                    found, image = capture.read()
                    if not found:
                        break
                    yield index, image
                index += 1
        finally:
            capture.release()

    def sample(self, n):
        """About `n` evenly spaced frames as ``(indices, images)``."""
        wanted = set(np.linspace(0, self.n_frames - 1, n).round().astype(int).tolist())
        kept = list(self.frames(0, self.n_frames, wanted))
        return np.array([k for k, _ in kept], dtype=int), [image for _, image in kept]

    @property
    def times(self):
        """Times of the decoded frames, shape (n_frames,), seconds."""
        return np.arange(self.n_frames) / self.fps


def open_video(path, fps=None):
    """Open a video and count the frames that can be decoded; `fps` if the header's is wrong.

    Raises
    ------
    DataError
        No such file, no decodable frame, or no usable frame rate.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError("no such video file", file=path)
    capture = _capture(path)
    try:
        if not capture.isOpened():
            raise DataError(
                "not a video that OpenCV can decode", file=path,
                remedy="convert it, e.g. ffmpeg -i IN -c:v libx264 OUT.mp4",
            )  # fmt: skip
        rate = float(capture.get(cv2.CAP_PROP_FPS)) if fps is None else float(fps)
        size = [int(capture.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
        promised = int(max(capture.get(cv2.CAP_PROP_FRAME_COUNT), 0))
        code = int(capture.get(cv2.CAP_PROP_FOURCC))
        codec = code.to_bytes(4, "little", signed=code < 0).decode("latin-1")
        count = 0
        while capture.grab():
            count += 1
    finally:
        capture.release()
    if count == 0:
        raise DataError("no frame could be decoded", file=path)
    if not (math.isfinite(rate) and 0 < rate <= MAX_FPS):
        raise DataError(
            f"frame rate must be positive and finite, got {rate:g}", file=path,
            remedy="give the true one: --fps",
        )  # fmt: skip
    return Video(path, rate, size[0], size[1], count, promised, codec)


def _capture(path):
    """A reader of a film: FFmpeg where OpenCV has it, whose complaints can be turned off."""
    has_ffmpeg = cv2.CAP_FFMPEG in cv2.videoio_registry.getStreamBackends()
    return cv2.VideoCapture(str(path), cv2.CAP_FFMPEG if has_ffmpeg else cv2.CAP_ANY)


class VideoWriter:
    """Write frames to a video, whole or not at all (a ``with`` statement ends it).

    Parameters
    ----------
    path : path
        ``.mp4`` (codec mp4v), ``.avi`` (MJPG) or ``.mkv`` (FFV1, lossless).
    fps : float
    size : (int, int)
        Width and height in pixels.

    Raises
    ------
    OutputError
        The codec is missing, the folder is not writable, or the ending is unknown.
    """

    CODECS = {".mp4": "mp4v", ".avi": "MJPG", ".mkv": "FFV1"}

    def __init__(self, path, fps, size):
        self.path, self.fps, self.size = Path(path), float(fps), tuple(size)
        if self.path.suffix.lower() not in self.CODECS:
            raise OutputError(
                f"a film must end in one of {', '.join(self.CODECS)}, got {self.path.name!r}"
            )
        self.n_written = 0

    def write(self, image):
        """Append one BGR image, uint8, shape (height, width, 3)."""
        self._writer.write(np.ascontiguousarray(image, dtype=np.uint8))
        self.n_written += 1

    def __enter__(self):
        code = cv2.VideoWriter_fourcc(*self.CODECS[self.path.suffix.lower()])
        with contextlib.ExitStack() as stack:
            self._part = stack.enter_context(whole_file(self.path))
            self._writer = cv2.VideoWriter(str(self._part), code, self.fps, self.size)
            stack.callback(self._writer.release)
            if not self._writer.isOpened():
                raise OutputError(f"cannot write a film to {self.path}")
            self._open = stack.pop_all()
        return self

    def __exit__(self, kind, error, trace):
        with self._open:
            if kind is not None:
                raise error
            self._writer.release()
            self._require_whole()

    def _require_whole(self):
        """OpenCV does not tell when the disk is full; the film itself does."""
        film = cv2.VideoCapture(str(self._part))
        n_there = int(film.get(cv2.CAP_PROP_FRAME_COUNT)) if film.isOpened() else 0
        film.release()
        if n_there < self.n_written:
            raise OutputError(
                f"{self.path}: only {n_there} of {self.n_written} frames could be written; is "
                "the disk full?"
            )
