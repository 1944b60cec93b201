"""A patch of the picture followed to a fraction of a pixel, and single points by optical flow."""

import cv2
import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.vision.track import Track

LEAST_SCORE = 0.6  # normalised correlation below this is another thing
REACH = 40  # px: half-width of the searched window beyond the template


def _grey(image):
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)


def _both_ways(video, frame, first, last):
    """Frames from `frame` backwards (kept in memory), then from it forwards."""
    if not first <= frame <= last:
        raise SettingsError(f"the frame must be {first}..{last}, got {frame}")
    yield reversed(list(video.frames(first, frame + 1)))
    yield video.frames(frame, last + 1)


def _walk(video, frame, first, last, start, step):
    """Run `step(image, predicted) -> (place, covariance, rms, reason)` both ways from `frame`."""
    found = {}
    for images in _both_ways(video, frame, first, last):
        place, velocity = np.array(start, dtype=float), np.zeros(2)
        for index, image in images:
            result = step(image, place + velocity)
            found[index] = result
            if result[3]:
                place = place + velocity
            else:
                velocity = result[0] - place if index != frame else np.zeros(2)
                place = result[0]
    return found


def _track(video, name, found, kind):
    frames = sorted(found)
    rows = [found[f] for f in frames]
    reasons = tuple((f, name, r[3]) for f, r in zip(frames, rows, strict=True) if r[3])
    return Track(
        (name,), np.array(frames), video.fps, np.array([[r[0]] for r in rows]),
        np.array([[r[1]] for r in rows]), np.array([[r[2]] for r in rows]),
        np.array([[0.0 if r[3] else 1.0] for r in rows]), reasons, {name: kind},
        {name: float("nan")}, "grey levels", video.is_lossy,
    )  # fmt: skip


NOWHERE = (np.full(2, np.nan), np.full((2, 2), np.nan), np.nan)


def track_template(video, name, box, frame, first=0, last=None):
    """Follow the patch inside of `box` = (x, y, width, height) of one frame.

    Whole pixels by normalised correlation, the fraction by Gauss-Newton steps on the grey values
    (Lucas and Kanade 1981) with a free brightness and contrast.

    Raises
    ------
    SettingsError
        The box is not inside of the picture, or has no structure.
    """
    last = video.n_frames - 1 if last is None else min(last, video.n_frames - 1)
    x, y, width, height = (int(v) for v in box)
    if (
        min(x, y) < 0
        or x + width > video.width
        or y + height > video.height
        or min(width, height) < 5
    ):
        raise SettingsError(f"the box must lie in the picture and be 5 px or more, got {box}")
    images = list(video.frames(frame, frame + 1))
    if not images:
        raise SettingsError(f"there is no frame {frame}")
    whole = _grey(images[0][1])
    patch = whole[y : y + height, x : x + width]
    if patch.std() < 2:
        raise SettingsError("the box holds one colour only; nothing there can be followed")
    gy, gx = np.gradient(patch)
    half = np.array([(width - 1) / 2, (height - 1) / 2])

    def step(image, predicted):
        grey = _grey(image)
        left, top = np.round(predicted - half - REACH).astype(int)
        x0, y0 = max(left, 0), max(top, 0)
        window = grey[y0 : max(top, 0) + height + 2 * REACH, x0 : max(left, 0) + width + 2 * REACH]
        if window.shape[0] < height or window.shape[1] < width:
            return (*NOWHERE, "left the picture")
        score = cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED)
        row, column = np.unravel_index(np.argmax(score), score.shape)
        if score[row, column] < LEAST_SCORE:
            return (*NOWHERE, "does not look like the template")
        corner = np.array([x0 + column, y0 + row], dtype=float)
        return _refined(grey, patch, gx, gy, corner, half)

    found = _walk(video, frame, first, last, np.array([x, y]) + half, step)
    return _track(video, name, found, "template")


def _refined(grey, patch, gx, gy, corner, half, iterations=15):
    height, width = patch.shape
    columns = np.stack([gx.ravel(), gy.ravel(), patch.ravel(), np.ones(patch.size)], axis=1)
    for _ in range(iterations):
        shift = np.array([[1.0, 0.0, corner[0]], [0.0, 1.0, corner[1]]], dtype=np.float32)
        now = cv2.warpAffine(
            grey, shift, (width, height), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        )
        # now(p) = a T(p + d) + b, to first order: unknowns a d, a, b
        solution, *_ = np.linalg.lstsq(columns, now.ravel(), rcond=None)
        step = -solution[:2] / max(abs(solution[2]), 0.2) * np.sign(solution[2])
        corner = corner + np.clip(step, -2, 2)
        if np.hypot(*step) < 2e-3:
            break
    left = now.ravel() - columns @ solution
    variance = left @ left / max(len(left) - 4, 1)
    covariance = variance * np.linalg.inv(columns.T @ columns)[:2, :2] / solution[2] ** 2
    return corner + half, covariance, float(np.sqrt(variance)), ""


def track_point(video, name, point, frame, first=0, last=None, window=21):
    """Follow one point by pyramidal Lucas-Kanade optical flow, checked forth and back.

    Errors add up from frame to frame: the covariance grows with the distance from `frame`.
    """
    last = video.n_frames - 1 if last is None else min(last, video.n_frames - 1)
    state = {}

    def step(image, predicted):
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        if "image" not in state or state["turn"]:
            state.update(image=grey, place=np.array(point, dtype=float), turn=False, n=0)
            return state["place"], np.eye(2) * 0.1**2, 0.0, ""
        old = state["place"].astype(np.float32).reshape(1, 1, 2)
        size = (window, window)
        new, good, _ = cv2.calcOpticalFlowPyrLK(state["image"], grey, old, None, winSize=size)
        back, good_back, _ = cv2.calcOpticalFlowPyrLK(grey, state["image"], new, None, winSize=size)
        gap = float(np.linalg.norm(back - old))
        if not (good[0, 0] and good_back[0, 0]) or gap > 1.0:
            return (*NOWHERE, "the flow does not come back")
        state["n"] += 1
        state.update(image=grey, place=new.reshape(2).astype(float))
        return state["place"], np.eye(2) * (0.1**2 * (1 + state["n"]) + gap**2), gap, ""

    found = {}
    for images in _both_ways(video, frame, first, last):
        state["turn"] = True
        for index, image in images:
            found[index] = step(image, None)
    return _track(video, name, found, "optical flow")
