"""A patch of the picture followed to a fraction of a pixel, and single points by optical flow."""

import cv2
import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.vision.track import NOWHERE, both_ways, last_frame, track_of, walk

LEAST_SCORE = 0.6  # normalised correlation below this is another thing
REACH = 40  # px: half-width of the searched window beyond the template
ITERATIONS = 15
WINDOW = (21, 21)  # px: what moves with a point


def _grey(image):
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)


def track_template(video, name, box, frame, first=0, last=None):
    """Follow the patch inside of `box` = (x, y, width, height) of one frame.

    Whole pixels by normalised correlation, the fraction by Gauss-Newton steps on the grey values
    (Lucas and Kanade 1981) with a free brightness and contrast.

    Raises
    ------
    SettingsError
        The box is not inside of the picture, or has no structure.
    """
    x, y, width, height = (int(v) for v in box)
    is_inside = min(x, y) >= 0 and x + width <= video.width and y + height <= video.height
    if not is_inside or min(width, height) < 5:
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

    found = walk(video, frame, first, last_frame(video, last), np.array([x, y]) + half, step)
    return track_of(video, name, found, "template", "grey levels", lossy=video.is_lossy)


def _refined(grey, patch, gx, gy, corner, half):
    height, width = patch.shape
    columns = np.stack([gx.ravel(), gy.ravel(), patch.ravel(), np.ones(patch.size)], axis=1)
    for _ in range(ITERATIONS):
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


def track_point(video, name, point, frame, first=0, last=None):
    """Follow one point by pyramidal Lucas-Kanade optical flow, checked forth and back.

    Errors add up from frame to frame: the covariance grows with the distance from `frame`.
    """

    def followed(images):
        known, place, n_steps = None, np.array(point, dtype=float), 0
        for index, image in images:
            grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
            if known is None:
                known = grey
                yield index, (place, np.eye(2) * 0.1**2, 0.0, "")
                continue
            old = place.astype(np.float32).reshape(1, 1, 2)
            new, good, _ = cv2.calcOpticalFlowPyrLK(known, grey, old, None, winSize=WINDOW)
            back, is_back, _ = cv2.calcOpticalFlowPyrLK(grey, known, new, None, winSize=WINDOW)
            gap = float(np.linalg.norm(back - old))
            if not (good[0, 0] and is_back[0, 0]) or gap > 1.0:
                yield index, (*NOWHERE, "the flow does not come back")
                continue
            known, place, n_steps = grey, new.reshape(2).astype(float), n_steps + 1
            yield index, (place, np.eye(2) * (0.1**2 * (1 + n_steps) + gap**2), gap, "")

    found = {}
    for images in both_ways(video, frame, first, last_frame(video, last)):
        found.update(followed(images))
    return track_of(video, name, found, "optical flow", "grey levels", lossy=video.is_lossy)
