"""The Physics 101 clips: tracked from the full videos, and brought to the paper's units."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from common import reference_data, write_table
from scipy.ndimage import gaussian_filter1d

from bsp_gp.data.scene import Entity, Scene

# Where the block is in one frame of the full video (x, y, width, height, px), marked by hand.
MARKS = {
    "w_block_05-table-01": ((895, 455, 36, 36), 11, "background"),
    "w_block_05-table-02": ((876, 474, 30, 30), 10, "background"),
    "w_block_05-table-03": ((880, 408, 34, 34), 9, "background"),
    "w_block_05-table-04": ((912, 360, 24, 30), 7, "background"),
    "w_block_05-tight-01": ((975, 624, 30, 30), 30, "surround"),
    "w_block_05-tight-04": ((973, 630, 30, 30), 30, "surround"),
    "w_block_10-tight-01": ((972, 701, 40, 40), 30, "surround"),
    "w_block_10-tight-02": ((956, 685, 40, 40), 30, "surround"),
}
FIRST_FRAME = {"01": 8, "02": 7, "03": 5, "04": 3}  # of the trimmed fall clips in the full video
PAPER_DT, FPS = 0.1, 30.0


@dataclass(frozen=True, eq=False)
class Clip:
    """One clip: `frames` (T,) of the full video, `px` (T, 2) of the block, `cov` (T, 2, 2);
    `stored` (T, 2) is the paper's track in the same pixels, nan where it has none; `anchor` the
    fixed end of the spring (px) or None; `window` the paper's first and last frame."""

    name: str
    scenario: str
    mass: float
    frames: np.ndarray
    px: np.ndarray
    cov: np.ndarray
    stored: np.ndarray
    anchor: np.ndarray | None
    window: tuple


def clip_table():
    clips = pd.read_csv(reference_data("phys101") / "clips.csv")
    return clips[clips.used_by_paper == 1]


def load_clip(row, folder):
    """Track a clip (kept in `folder` as CSV) and read the paper's own track beside it."""
    name = row.clip.split("-Kinect")[0]
    path = folder / f"{name}.csv"
    if not path.is_file():
        _track(name, row.scenario, path)
    kept = pd.read_csv(path)
    frames = kept.frame.to_numpy()
    stored_file = reference_data("phys101", row.scenario) / f"{row.clip}.csv"
    stored = pd.read_csv(stored_file)
    scale = 2.0 if row.scenario == "fall" else 1.0
    offset = FIRST_FRAME[name[-2:]] if row.scenario == "fall" else 1
    disc = stored[stored.object == "disc"].set_index("frame")[["x_px", "y_px"]] * scale
    disc.index = disc.index + offset
    anchor = stored[stored.object == "spring"][["x_px", "y_px"]].mean().to_numpy()
    cov = np.zeros((len(kept), 2, 2))
    cov[:, 0, 0], cov[:, 1, 1], cov[:, 0, 1] = kept.vxx, kept.vyy, kept.vxy
    cov[:, 1, 0] = cov[:, 0, 1]
    return Clip(
        name, row.scenario, row.object_mass_g / 1000, frames, kept[["x", "y"]].to_numpy(), cov,
        disc.reindex(frames).to_numpy(), anchor if row.scenario == "spring" else None,
        (row.window_start_0based + offset, row.window_end_0based_inclusive + offset),
    )  # fmt: skip


def _track(name, scenario, path):
    from bsp_gp.vision.blobs import BlobSettings, track_blob
    from bsp_gp.vision.video import open_video

    box, frame, against = MARKS[name]
    video = open_video(reference_data("phys101", "videos", scenario) / f"{name}-Kinect_RGB_1.mp4")
    if scenario == "fall":
        first, last = FIRST_FRAME[name[-2:]], 14
        settings = BlobSettings(box, frame, against, reach=120, least=1500,
                                overshoot=1.8, cue="red-green")  # fmt: skip
    else:
        first, last = 18, 175
        settings = BlobSettings(box, frame, against, reach=120, least=1500)
    track = track_blob(video, "block", settings, first, last)
    cov = track.covariances[:, 0]
    frame = pd.DataFrame(
        {"frame": track.frames, "x": track.positions[:, 0, 0], "y": track.positions[:, 0, 1],
         "vxx": cov[:, 0, 0], "vyy": cov[:, 1, 1], "vxy": cov[:, 0, 1]}
    )  # fmt: skip
    write_table(frame, path)


def paper_smoothing(x):
    """The paper's: Gaussian over time (sigma 2, +-4 frames, edges repeated), the first two frames
    and the frames of greatest acceleration (above the 0.999 quantile) left as they are.

    With it, its own tracks give its published zero-force errors (5.05e-2 and 2.19e-2).
    """
    y = gaussian_filter1d(x, 2, axis=0, mode="nearest", truncate=2.0)
    size = np.linalg.norm(np.diff(x, n=2, axis=0), axis=1)
    y[:2] = x[:2]
    kept = np.flatnonzero(size > np.quantile(size, 0.999)) + 2
    y[kept] = x[kept]
    return y


def rts(x, covariances):
    """Kalman/RTS smoother of `bsp_gp.vision`, its powers found from the track itself."""
    from bsp_gp.vision.smoothing import calibrated, smooth_track
    from bsp_gp.vision.track import Track

    px = 100.0
    blank = np.ones((len(x), 1))
    track = Track(("block",), np.arange(len(x)), FPS, x[:, None] * px,
                  covariances[:, None] * px**2, blank, blank)  # fmt: skip
    return smooth_track(calibrated(track), "block").positions / px


def paper_scene(clip, source, smoothing="paper"):
    """A clip in the paper's units: px / -100 (fall: of the half-size picture), dt = 0.1 s.

    `source` is ``stored`` (the paper's track) or ``video`` (ours).
    """
    a, b = clip.window
    rows = (clip.frames >= a) & (clip.frames <= b)
    track = clip.stored if source == "stored" else clip.px
    divisor = -200.0 if clip.scenario == "fall" else -100.0
    x = track[rows] / divisor
    if clip.scenario == "fall":
        x[:, 0] = x[:, 0].mean()
    if smoothing == "paper":
        x = paper_smoothing(x)
    elif smoothing == "rts":
        x = rts(x, clip.cov[rows] / divisor**2)
    block = Entity("block", "disc", radius=0.2, properties={"mass": clip.mass})
    if clip.scenario == "fall":
        other = Entity("table", "rect_wall", width=10, height=1, is_static=True,
                       properties={"mass": 1.0})  # fmt: skip
        place = np.array([x[0, 0], -5.0])
    else:
        other = Entity("anchor", "point", is_static=True,
                       properties={"mass": 1.0, "rest_length": 5.1})  # fmt: skip
        place = clip.anchor / divisor
    positions = np.stack([x, np.broadcast_to(place, x.shape)], axis=1)
    return Scene(clip.name, PAPER_DT * np.arange(len(x)), positions, (block, other))
