"""Gravity in what an accelerometer shows: at rest it shows that, and no acceleration of a body."""

from dataclasses import dataclass

import numpy as np

from bsp_gp.data.scene import CHECK
from bsp_gp.data.words import folded, words_for

GRAVITY = 9.81
"""What an accelerometer shows at rest, m/s^2."""
OFF = 0.06
"""Part by which the usual size of what a sensor shows may be off gravity."""
QUIET = 0.03
"""Part of the usual size within which a row shows hardly anything but gravity."""
TURNED, OFTEN = 20.0, 0.97
"""Degrees by which the direction of gravity may differ from the usual one, in so many rows."""
_WITHOUT = words_for("without_gravity")


@dataclass(frozen=True)
class Pull:
    """Gravity in a track.

    Attributes
    ----------
    usual : ndarray
        What is usually shown along the three axes, m/s^2.
    is_turned : bool
        Whether its direction is another at times.
    """

    usual: np.ndarray
    is_turned: bool


def pull_in(shown, headings):
    """Gravity in what three axes of a sensor show, (n, 3) in m/s^2; None where it is not in it."""
    if shown.shape[1:] != (3,) or any(is_without(text) for text in headings):
        return None
    shown = shown[np.isfinite(shown).all(axis=1)]
    if not len(shown):
        return None
    size = np.linalg.norm(shown, axis=1)
    middle, usual = float(np.median(size)), np.median(shown, axis=0)
    if abs(middle / GRAVITY - 1) > OFF:
        return None
    quiet = shown[np.abs(size / middle - 1) < QUIET]
    whole = float(np.linalg.norm(usual))
    is_along = quiet @ usual >= np.cos(np.radians(TURNED)) * whole * np.linalg.norm(quiet, axis=1)
    is_turned = abs(whole / middle - 1) > 2 * OFF or is_along.mean() < OFTEN
    return Pull(usual, bool(is_turned))


def is_without(heading):
    """Whether a heading says that gravity was taken off already: ``Linear Acceleration x``."""
    text = folded(heading)
    return bool(set(text.split()) & _WITHOUT) or "without g" in text or "ohne g" in text


def told_off(usual, headings, who=""):
    """A note that gravity was taken off: `usual` (m/s^2), by the columns that show it."""
    each = ", ".join(f"{v:.2f} in {text!r}" for v, text in zip(usual, headings, strict=True))
    return (
        f"gravity is in the accelerations{_of(who)}, and was taken off: what is shown at rest or "
        f"usually, {each} (m/s^2), together {float(np.linalg.norm(usual)):.2f} m/s^2"
    )


def told_turned(who=""):
    """A note that gravity is in accelerations and cannot be taken off."""
    return (
        f"{CHECK}gravity is in the accelerations{_of(who)} and its direction changes, since what "
        "measures them turns: it cannot be taken off, and places that are sums of them cannot be "
        "trusted; keep the sensor from turning, take rows in which it does not turn, or record "
        "accelerations without gravity (phyphox: 'Acceleration (without g)')"
    )


def _of(who):
    return f" of {who}" if who else ""
