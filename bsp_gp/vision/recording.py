"""From a video to a folder: tracks of several objects joined, as a data set, a film and a page."""

import html
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bsp_gp.data.folder import fill_dataset
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.output.place import claim
from bsp_gp.units import UnitSystem
from bsp_gp.vision.annotate import write_annotated
from bsp_gp.vision.blobs import BlobSettings, track_blob
from bsp_gp.vision.calibration import Calibration
from bsp_gp.vision.colour import parse_colour
from bsp_gp.vision.disc_tracker import DiscTracker
from bsp_gp.vision.regions import mats, still_background
from bsp_gp.vision.smoothing import calibrated, smooth_track
from bsp_gp.vision.templates import track_point, track_template
from bsp_gp.vision.track import Track
from bsp_gp.vision.video import open_video

RECORDING = "recording"
SPECS = (
    "disc:COLOUR[:RADIUS] | patch:X,Y,W,H@FRAME | moving:X,Y,W,H@FRAME | "
    "template:X,Y,W,H@FRAME | point:X,Y@FRAME"
)


@dataclass(frozen=True)
class ObjectSpec:
    """One ``--object NAME=SPEC``: its name, method, and what the method needs."""

    name: str
    method: str
    colour: str = ""
    radius: float | None = None
    box: tuple = ()
    frame: int = 0


def parse_object(name, text):
    """Read a SPEC; SettingsError says which forms there are.

    >>> parse_object("ball", "disc:#ff0000:14").radius
    14.0
    """
    method, _, rest = text.partition(":")
    if method == "disc":
        colour, _, radius = rest.partition(":")
        parse_colour(colour)
        if radius and not (_is_number(radius) and float(radius) > 1):
            raise SettingsError(f"object {name!r}: the radius must be above 1 px, got {radius!r}")
        return ObjectSpec(name, method, colour, float(radius) if radius else None)
    match = re.fullmatch(r"([\d.,]+)@(\d+)", rest)
    numbers = match.group(1).split(",") if match else []
    wanted = {"patch": 4, "moving": 4, "template": 4, "point": 2}.get(method)
    if wanted is None or len(numbers) != wanted or not all(map(_is_number, numbers)):
        raise SettingsError(f"object {name!r}: expected {SPECS}, got {text[:60]!r}")
    values = tuple(float(v) if method == "point" else int(float(v)) for v in numbers)
    return ObjectSpec(name, method, box=values, frame=int(match.group(2)))


def _is_number(text):
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def track_video(video, specs, first=0, last=None, progress=None):
    """Track all objects of a video; their covariances are calibrated on the tracks themselves.

    `first` and `last` are frames, both included.
    """
    last = video.n_frames - 1 if last is None else last
    if not 0 <= first <= last - 2 or last >= video.n_frames:
        raise SettingsError(
            f"frames must be three or more of 0..{video.n_frames - 1}, got {first}..{last}"
        )
    names = [s.name for s in specs]
    if not specs or len(set(names)) != len(names):
        raise SettingsError("give every object a name of its own")
    tell = progress or (lambda text: None)
    parts = []
    discs = [s for s in specs if s.method == "disc"]
    if discs:
        tell(f"discs: {', '.join(s.name for s in discs)}")
        tracker = DiscTracker(
            video,
            {s.name: parse_colour(s.colour) for s in discs},
            {s.name: s.radius for s in discs},
        )
        parts.append(tracker.run(first, last))
    for spec in specs:
        if spec.method == "disc":
            continue
        tell(f"{spec.method}: {spec.name}")
        if spec.method in ("patch", "moving"):
            against = "background" if spec.method == "moving" else "surround"
            settings = BlobSettings(spec.box, spec.frame, against)
            parts.append(track_blob(video, spec.name, settings, first, last))
        else:
            follow = track_template if spec.method == "template" else track_point
            parts.append(follow(video, spec.name, spec.box, spec.frame, first, last))
    return calibrated(_joined(parts))


def _joined(parts):
    first = parts[0]
    arrays = ([getattr(p, name) for p in parts]
              for name in ("positions", "covariances", "rms", "seen"))  # fmt: skip
    return Track(
        tuple(n for p in parts for n in p.names), first.frames, first.fps,
        *(np.concatenate(each, axis=1) for each in arrays),
        tuple(r for p in parts for r in p.reasons),
        {k: v for p in parts for k, v in p.kinds.items()},
        {k: v for p in parts for k, v in p.radii.items()},
        "; ".join(dict.fromkeys(p.unit for p in parts)), any(p.lossy for p in parts),
    )  # fmt: skip


def to_dataset(video, track, calibration, regions=(), smooth=False):
    """The data set of a track: world coordinates, quoted errors, gaps left as gaps.

    Discs carry their radius; mats are static entities. With `smooth` the positions are those of
    the RTS smoother, in measured frames only.
    """
    positions, covariances = track.positions.copy(), track.covariances
    if smooth:
        for k, name in enumerate(track.names):
            known = np.isfinite(track.positions[:, k, 0])
            if known.sum() > 3:
                smoothed = smooth_track(track, name)
                positions[known, k] = smoothed.positions[known]
                covariances = covariances.copy()
                covariances[known, k] = smoothed.covariances[known]
    world = calibration.world(positions)
    spread = calibration.covariance(positions, covariances)
    sigma = np.sqrt(np.maximum(np.einsum("tnii->tni", spread), 0.0))
    middle = np.array([video.width / 2, video.height / 2])
    scale = float(np.sqrt(abs(np.linalg.det(calibration.jacobian(middle)))))
    entities = [_entity(track, name, scale) for name in track.names]
    still = []
    for k, region in enumerate(regions, 1):
        entities.append(
            Entity(f"mat{k}_{region.colour}", "rect_mat", width=region.width * scale,
                   height=region.height * scale, is_static=True)
        )  # fmt: skip
        still.append(calibration.world(np.array([region.x, region.y])))
    if still:
        fixed = np.broadcast_to(np.array(still), (len(world), len(still), 2))
        world = np.concatenate([world, fixed], axis=1)
        sigma = np.concatenate([sigma, np.zeros_like(fixed)], axis=1)
    sigma = np.where(np.isfinite(sigma), sigma, np.nan)
    seen = np.isfinite(world[:, : len(track.names)]).all(axis=2).any(axis=1)  # else no row at all
    if seen.sum() < 3:
        raise DataError(
            f"{', '.join(track.names)} was found in {int(seen.sum())} of {len(seen)} frames",
            file=video.path, remedy="mark it anew with --object, for instance as a pattern: "
            "NAME=template:X,Y,W,H@FRAME",
        )  # fmt: skip
    scene = Scene(
        video.path.stem, track.times[seen], world[seen], tuple(entities), sigma=sigma[seen]
    )
    units = {"time": "s", "length": calibration.unit}
    return Dataset(
        video.path.stem, (scene,), units=UnitSystem.from_declared(units), up="y",
        provenance={"source": f"tracked from {video.path.name}, {video.fps:g} frames a second"},
        is_film=True,
    )  # fmt: skip


def _entity(track, name, scale):
    radius = track.radii.get(name, math.nan)
    return Entity(name, "disc", radius=radius * scale) if math.isfinite(radius) else Entity(name)


def quality_page(video, track, calibration):
    """HTML of how good the track is: per object rms, sigma, gaps and why; one file, no scripts."""
    rows = []
    for k, name in enumerate(track.names):
        known = np.isfinite(track.positions[:, k, 0])
        sigma = track.sigma[:, k][known]
        rms = track.rms[:, k][np.isfinite(track.rms[:, k])]
        rows.append(
            f"<tr><td>{html.escape(name)}</td><td>{html.escape(track.kinds.get(name, ''))}</td>"
            f"<td>{known.sum()} of {len(known)}</td>"
            f"<td>{_told(np.median, sigma[:, 0])}</td><td>{_told(np.median, sigma[:, 1])}</td>"
            f"<td>{_told(np.median, rms)}</td><td>{_told(np.max, rms)}</td></tr>"
        )
    gaps = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{span}</td><td>{html.escape(reason)}</td></tr>"
        for name, span, reason in _spans(track.reasons)
    )
    missing = video.n_header - video.n_frames
    notes = [
        f"{video.n_frames} frames decoded"
        + (f" of {video.n_header} that the header promises" if missing > 0 else ""),
        f"{video.fps:g} frames a second, taken as evenly spaced",
        "lengths in pixels: no scale was given" if calibration.unit == "px"
        else f"lengths in {calibration.unit}",
    ]  # fmt: skip
    if math.isfinite(calibration.residual) and calibration.residual:
        notes.append(
            f"known points reproduced to {calibration.residual:.3g} {calibration.unit} rms"
        )
    return f"""<!doctype html><html lang="en"><meta charset="utf-8"><title>Track quality</title>
<style>body{{font:16px/1.4 sans-serif;max-width:60em;margin:2em auto;padding:0 1em}}
table{{border-collapse:collapse}}td,th{{border:1px solid #aaa;padding:.2em .6em;text-align:left}}
</style><h1>Track of {html.escape(video.path.name)}</h1>
<ul>{"".join(f"<li>{html.escape(n)}</li>" for n in notes)}</ul>
<table><tr><th>object</th><th>method</th><th>frames measured</th><th>median σ<sub>x</sub>, px</th>
<th>median σ<sub>y</sub>, px</th><th>median rms misfit</th><th>largest</th></tr>{
        "".join(rows)
    }</table>
<p>Rms misfit in {html.escape(track.unit)}. Standard errors are calibrated on the track itself.</p>
<h2>Frames without a position</h2>
{
        "<table><tr><th>object</th><th>frames</th><th>why</th></tr>" + gaps + "</table>"
        if gaps
        else "<p>None.</p>"
    }</html>
"""


def _told(of, values):
    return f"{of(values):.3g}" if len(values) else "–"


def _spans(reasons):
    """Runs of frames with one reason: (name, "a–b", reason)."""
    spans = []
    for frame, name, reason in sorted(reasons, key=lambda r: (r[1], r[0])):
        if spans and spans[-1][0] == name and spans[-1][3] == reason and spans[-1][2] == frame - 1:
            spans[-1][2] = frame
        else:
            spans.append([name, frame, frame, reason])
    return [(n, f"{a}" if a == b else f"{a}–{b}", r) for n, a, b, r in spans]


def write_recording(
    path, specs, out, *, fps=None, calibration=None, mat_colours=None, first=0, last=None,
    smooth=False, film=True, progress=None, overwrite=False,
):  # fmt: skip
    """Track a video and write a folder: ``data/`` (a data set), ``film.mp4``, ``quality.html``.

    Written whole or not at all; an older one gives way only if `overwrite` is set.
    """
    with claim(out, RECORDING, inputs=(path,), overwrite=overwrite) as place:
        video = open_video(path, fps)
        calibration = calibration or Calibration()
        track = track_video(video, specs, first, last, progress)
        regions = ()
        if mat_colours:
            picture, seen = still_background(video, track)
            colours = {name: parse_colour(c) for name, c in mat_colours.items()}
            regions = tuple(mats(picture, seen, colours))
        dataset = to_dataset(video, track, calibration, regions, smooth)
        with place.fill(RECORDING, overwrite) as fresh:
            (fresh / "data").mkdir()
            fill_dataset(dataset, fresh / "data")
            (fresh / "quality.html").write_text(quality_page(video, track, calibration), "utf-8")
            if film:
                write_annotated(video, track, fresh / "film.mp4", regions)
    return Path(out), track
