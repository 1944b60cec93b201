"""The intuitive-physics movies, from mp4 to arrays: discs, mats, walls. No truth is read here."""

import json
from dataclasses import dataclass

import numpy as np
from common import reference_data, whole

COLOURS = ("red", "blue", "yellow")
MATS = {"green": "#9acd32", "purple": "#8b008b", "brown": "#a52a2a"}
N_SCENES = 6


@dataclass(frozen=True, eq=False)
class Movie:
    """One tracked movie; px and frames (80 a second), y down as in the picture.

    positions : (T, N, 2), nan = not seen; colours : colour of each disc; radii : (N,) outer
    radius; mats : (colour, left, top, right, bottom, hidden share); arena : (left, top, right,
    bottom).
    """

    name: str
    positions: np.ndarray
    colours: tuple
    radii: np.ndarray
    mats: tuple
    arena: tuple
    fps: float

    @property
    def world(self):
        return int(self.name.split("_")[0].removeprefix("world"))


def scene_names():
    return [f"world{w}_{s}" for w in range(1, 11) for s in range(1, N_SCENES + 1)]


def video_path(name):
    return reference_data("ullman", "videos") / f"{name}.mp4"


def track_movie(name):
    """Track one movie from its mp4."""
    from bsp_gp.vision.colour import parse_colour
    from bsp_gp.vision.disc_tracker import DiscTracker
    from bsp_gp.vision.regions import arena, mats, still_background
    from bsp_gp.vision.video import open_video

    video = open_video(video_path(name))
    track = DiscTracker(video, {c: parse_colour(c) for c in COLOURS}).run()
    picture, seen = still_background(video, track)
    walls = arena(picture)
    regions = mats(picture, seen, {c: parse_colour(h) for c, h in MATS.items()}, walls)
    return Movie(
        name, track.positions, tuple(n.rstrip("0123456789") for n in track.names),
        np.array([track.radii[n] for n in track.names]),
        tuple((r.colour, *map(float, r.box), float(r.hidden)) for r in regions),
        tuple(map(float, walls.box)), video.fps,
    )  # fmt: skip


def load_movie(name, folder):
    """The tracked movie, from the cache in `folder` if it was tracked before."""
    path = folder / f"{name}.npz"
    if path.is_file():
        with np.load(path, allow_pickle=False) as kept:
            about = json.loads(str(kept["about"]))
            return Movie(
                name, kept["positions"], tuple(about["colours"]), kept["radii"],
                tuple(map(tuple, about["mats"])), tuple(about["arena"]), about["fps"],
            )  # fmt: skip
    movie = track_movie(name)
    about = {"colours": movie.colours, "mats": movie.mats, "arena": movie.arena, "fps": movie.fps}
    with whole(path) as part:
        np.savez(part, positions=movie.positions, radii=movie.radii, about=json.dumps(about))
    return movie
