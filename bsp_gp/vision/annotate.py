"""A film in which a tracked video shows what was tracked: outlines, names, tails, gaps."""

import cv2
import numpy as np

from bsp_gp.vision.video import VideoWriter

PALETTE = ((0, 0, 0), (180, 60, 0), (0, 110, 0), (150, 0, 150), (0, 80, 180), (90, 90, 90))
TAIL = 25  # frames


def annotate_frame(image, track, row, regions=()):
    """Draw row `row` of a track on a copy of its frame.

    Crosses are the measured positions with an ellipse of three standard errors (at least two
    pixels wide, to be seen); a name in brackets says that the object was not measured here.
    """
    picture = image.copy()
    for region in regions:
        left, top, right, bottom = (int(round(v)) for v in region.box)
        cv2.rectangle(picture, (left, top), (right, bottom), (0, 0, 0), 1, cv2.LINE_AA)
        _write(picture, region.colour, (left + 3, top + 14), 0.4, (0, 0, 0))
    for k, name in enumerate(track.names):
        colour = PALETTE[k % len(PALETTE)]
        tail = track.positions[max(row - TAIL, 0) : row + 1, k]
        tail = tail[np.isfinite(tail[:, 0])]
        if len(tail) > 1:
            cv2.polylines(picture, [np.round(tail).astype(np.int32)], False, colour, 1, cv2.LINE_AA)
        place = track.positions[row, k]
        if not np.isfinite(place[0]):
            if len(tail):
                _label(picture, f"({name})", tail[-1], colour)
            continue
        x, y = (int(round(v)) for v in place)
        cv2.drawMarker(picture, (x, y), colour, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
        values, vectors = np.linalg.eigh(track.covariances[row, k])
        size = tuple(int(round(max(3 * np.sqrt(max(v, 0.0)), 2))) for v in values)
        angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        cv2.ellipse(picture, (x, y), size, angle, 0, 360, colour, 1, cv2.LINE_AA)
        radius = track.radii.get(name, float("nan"))
        if np.isfinite(radius):
            cv2.circle(picture, (x, y), int(round(radius)), colour, 1, cv2.LINE_AA)
        _label(picture, name, place, colour)
    _write(picture, f"{track.frames[row]}", (6, picture.shape[0] - 8), 0.5, (0, 0, 255))
    return picture


def _write(picture, text, spot, size, colour, width=1):
    cv2.putText(picture, text, spot, cv2.FONT_HERSHEY_SIMPLEX, size, colour, width, cv2.LINE_AA)


def _label(picture, text, place, colour):
    spot = (int(round(place[0])) + 8, int(round(place[1])) - 8)
    _write(picture, text, spot, 0.45, (255, 255, 255), 3)
    _write(picture, text, spot, 0.45, colour)


def write_annotated(video, track, path, regions=()):
    """Write the annotated film, whole or not at all; it plays at 25 frames a second at most."""
    rows = {int(f): k for k, f in enumerate(track.frames)}
    first, last = int(track.frames[0]), int(track.frames[-1])
    with VideoWriter(path, min(video.fps, 25.0), (video.width, video.height)) as film:
        for index, image in video.frames(first, last + 1):
            if index in rows:
                film.write(annotate_frame(image, track, rows[index], regions))
