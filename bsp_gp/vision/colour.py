"""Colour models: how much of each pixel is of an object's colour, and the background behind it."""

import re

import cv2
import numpy as np

from bsp_gp.errors import SettingsError

NAMED = ("black", "blue", "brown", "green", "orange", "purple", "red", "white", "yellow")
"""Colours that a complaint names."""


def parse_colour(text):
    """BGR of a name of CSS or of ``#rrggbb``; SettingsError for anything else."""
    from matplotlib.colors import CSS4_COLORS

    code = CSS4_COLORS.get(text.lower(), text)
    if re.fullmatch(r"#[0-9a-fA-F]{6}", code):
        red, green, blue = (int(code[k : k + 2], 16) for k in (1, 3, 5))
        return np.array([blue, green, red], dtype=np.float32)
    raise SettingsError(
        f"a colour must be #rrggbb or one of {', '.join(NAMED)} or another name of CSS, "
        f"got {text!r}"
    )


def is_colour(image, colour, tolerance):
    """Pixels within `tolerance` (Euclidean, 0..441) of a BGR colour: bool, shape (h, w)."""
    difference = cv2.absdiff(image, np.full_like(image, np.round(colour)))
    squares = difference.astype(np.int32)
    squares *= squares
    return squares.sum(axis=2) < tolerance**2


def coverage(image, colour, surround):
    """Share of each pixel that is covered by an object of one colour, (h, w), float32, 0..1.

    A pixel on an edge is a mixture a F + (1 - a) O of the object's colour F and what surrounds
    it, O; hence |I - F| = (1 - a) |O - F|, which is solved for a.

    Parameters
    ----------
    image : ndarray, shape (h, w, 3), uint8
    colour, surround : ndarray, shape (3,) or (for surround) (h, w, 3)
        F and O, BGR.
    """
    colour = np.asarray(colour, dtype=np.float32)
    difference = image.astype(np.float32) - colour
    distance = np.sqrt(np.einsum("ijk,ijk->ij", difference, difference))
    apart = np.asarray(surround, dtype=np.float32) - colour
    whole = np.sqrt(np.sum(apart * apart, axis=-1))
    # A background of nearly the object's own colour tells nothing: such pixels count as empty.
    return np.clip(1.0 - distance / np.maximum(whole, 30.0), 0.0, 1.0)


def background(images, hidden=None):
    """Median image of a fixed camera, leaving out the pixels that objects hide.

    Parameters
    ----------
    images : sequence of ndarray, shape (h, w, 3), uint8
    hidden : sequence of bool ndarray, shape (h, w), optional
        True where a tracked object hides the background in that image.

    Returns
    -------
    image : ndarray, shape (h, w, 3), uint8
    seen : bool ndarray, shape (h, w)
        False where no image shows the background.
    """
    stack = np.stack(images)
    if hidden is None:
        return np.median(stack, axis=0).astype(np.uint8), np.ones(stack.shape[1:3], dtype=bool)
    covered = np.stack(hidden)
    seen = ~covered.all(axis=0)
    plain = np.median(stack, axis=0).astype(np.uint8)
    # Only pixels hidden at least once need the slower median of a part of the images.
    rows, columns = np.nonzero(covered.any(axis=0) & seen)
    values = stack[:, rows, columns].astype(np.float32)
    values[covered[:, rows, columns]] = np.nan
    plain[rows, columns] = np.nanmedian(values, axis=0).round().astype(np.uint8)
    return plain, seen
