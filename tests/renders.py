"""Small videos with known sub-pixel truth: discs with an outline, mats, walls; blur, compression.

Rendered by coverage: each pixel's share of a disc is found on a fine grid, so that a centre at a
fraction of a pixel is truly there.
"""

import cv2
import numpy as np

BGR = {"red": (0, 0, 255), "blue": (255, 0, 0), "yellow": (0, 255, 255)}


def disc_share(shape, centre, radius, fine=8):
    """Share of each pixel that a disc covers, shape (h, w)."""
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    d = np.hypot(x - centre[0], y - centre[1])
    share = (d < radius).astype(float)
    rows, columns = np.nonzero(np.abs(d - radius) < 1.5)
    fine_x = columns[:, None, None] + offsets[None, None, :] - centre[0]
    fine_y = rows[:, None, None] + offsets[None, :, None] - centre[1]
    share[rows, columns] = (fine_x**2 + fine_y**2 < radius**2).mean(axis=(1, 2))
    return share


def frame(shape, discs, mats=(), radius=14, outline=3, wall=0):
    """One image: discs = [(colour, (x, y)), ...] drawn in order, mats = [(bgr, l, t, r, b)]."""
    image = np.full((*shape, 3), 250.0)
    for bgr, left, top, right, bottom in mats:
        image[top:bottom, left:right] = bgr
    if wall:
        image[:wall] = image[-wall:] = 0
        image[:, :wall] = image[:, -wall:] = 0
    for colour, centre in discs:
        for bgr, r in (((0, 0, 0), radius + outline), (BGR[colour], radius)):
            share = disc_share(shape, centre, r)[..., None]
            image = image * (1 - share) + np.array(bgr, dtype=float) * share
    return image


def write_video(path, images, fps=50.0, blur=0.0, noise=0.0, rng=None):
    """Lossless for .mkv, compressed for .mp4; blur (sd, px) and noise (sd, grey levels) added."""
    from bsp_gp.vision.video import VideoWriter

    height, width = images[0].shape[:2]
    with VideoWriter(path, fps, (width, height)) as out:
        for image in images:
            if blur:
                image = cv2.GaussianBlur(image, (0, 0), blur)
            if noise:
                image = image + rng.normal(0, noise, image.shape)
            out.write(np.clip(np.round(image), 0, 255))
    return path


def bouncing(n_frames, n_discs, size, reach, rng, speed=4.0):
    """Equal discs that collide elastically in a box: positions (T, N, 2) and pair contacts."""
    low, high = reach + 1, size - reach - 1
    while True:
        p = rng.uniform(low, high, (n_discs, 2))
        gaps = [np.hypot(*(p[i] - p[j])) for i in range(n_discs) for j in range(i)]
        if not gaps or min(gaps) > 2.3 * reach:
            break
    v = rng.normal(0, speed, (n_discs, 2))
    places, contacts, fine = [p.copy()], [], 20
    for t in range(n_frames - 1):
        for _ in range(fine):
            p += v / fine
            v = np.where((p < low) & (v < 0) | (p > high) & (v > 0), -v, v)
            for i in range(n_discs):
                for j in range(i):
                    d = p[i] - p[j]
                    r = np.hypot(*d)
                    closing = (v[i] - v[j]) @ d
                    if r < 2 * reach and closing < 0:
                        change = closing * d / r**2
                        v[i] -= change
                        v[j] += change
                        contacts.append((t, i, j))
        places.append(p.copy())
    return np.array(places), contacts
