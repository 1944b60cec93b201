"""What the page's one script shows: tracks to step through, and what is left against anything."""

import base64
import hashlib
import json
from importlib.resources import files

import numpy as np

from bsp_gp.report.drawing import AFTER, BEFORE, scaled, time_scaled
from bsp_gp.report.numbers import pretty_unit
from bsp_gp.report.tracks import drawn_axes, pick_overlays

_MAX_TRACKS = 24
_MAX_TIMES = 200
_MAX_POINTS = 1500
_DIGITS = 5
_SCALES = {"t": "time", "speed": "speed", "distance": "distance to the nearest body"}
_SIZES = {
    "before": "size", "before_along": "along the motion", "before_across": "across the motion",
}  # fmt: skip


def script():
    """The script of the page, of ours and without a library."""
    return files("bsp_gp.report").joinpath("templates", "explore.js").read_text("utf-8")


def script_digest():
    """By which the page allows this script and no other."""
    digest = hashlib.sha256(script().encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"


def exploration(report, units, has_after):
    """Tracks and residuals for the script, or None where there are none.

    ``text`` is JSON that no element ends, ``has_left`` whether it holds residuals.

    Parameters
    ----------
    units : (str, str, str)
        Of lengths, accelerations and times.
    has_after : bool
        Whether a law was adopted.
    """
    length, acceleration, time = units
    tracks = [
        _track(overlay, length, time, has_after)
        for overlay in pick_overlays(report.overlays, _MAX_TRACKS)
    ]
    left = _left(report.residuals, length, acceleration, time, has_after)
    if not tracks:
        return None
    data = {"tracks": tracks, "left": left, "colours": [BEFORE, AFTER]}
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return {"text": text.replace("<", "\\u003c"), "has_left": left is not None}


def _track(overlay, length, time, has_after):
    """One track in the plane in which most of its motion is."""
    axes = drawn_axes(overlay)
    times = np.asarray(overlay.times, float)
    rows = np.unique(np.linspace(0, len(times) - 1, min(len(times), _MAX_TIMES)).astype(int))
    observed = np.asarray(overlay.observed, float)
    models = [np.asarray(overlay.declared, float)]
    models += [np.asarray(overlay.adopted, float)] if has_after else []
    factor, unit = scaled(length, observed[:, axes])
    errors = [np.linalg.norm(model - observed, axis=-1) for model in models]
    error_factor, error_unit = scaled(length, *errors)
    t_factor, t_unit = time_scaled(time, times)
    return {
        "name": f"{overlay.scene}: {overlay.entity}" if overlay.scene else str(overlay.entity),
        "axes": ["xyz"[k] for k in axes], "unit": pretty_unit(unit),
        "t": _short(times[rows] * t_factor), "t_unit": pretty_unit(t_unit),
        "observed": [_short(observed[rows, k] * factor) for k in axes],
        "models": [[_short(model[rows, k] * factor) for k in axes] for model in models],
        "errors": [_short(error[rows] * error_factor) for error in errors],
        "error_unit": pretty_unit(error_unit),
    }  # fmt: skip


def _left(table, length, acceleration, time, has_after):
    """What is left of the acceleration, and every number of its rows; None without any."""
    if table is None or not len(table):
        return None
    table = table.iloc[:: max(1, -(-len(table) // _MAX_POINTS))]
    pairs = {name: (name, name.replace("before", "after")) for name in _SIZES if name in table}
    sizes = []
    for name, words in _SIZES.items():
        columns = [np.asarray(table[c], float) for c in pairs.get(name, ())][: 1 + has_after]
        if columns and np.isfinite(columns[0]).any():
            factor, unit = scaled(acceleration, *columns)
            values = [_short(c * factor) for c in columns]
            sizes.append({"name": words, "unit": pretty_unit(unit), "values": values})
    units = {"t": time, "speed": f"{length}/{time}" if length else "", "distance": length}
    against = []
    for name in table.columns:
        if name.startswith(("before", "after")) or table[name].dtype.kind not in "fiu":
            continue
        values = np.asarray(table[name], float)
        if np.unique(values[np.isfinite(values)]).size < 2:
            continue
        rescale = time_scaled if name == "t" else scaled
        factor, unit = rescale(units.get(name, ""), values)
        against.append({
            "name": _SCALES.get(name, str(name)), "unit": pretty_unit(unit),
            "values": _short(values * factor),
        })  # fmt: skip
    return {"sizes": sizes, "against": against} if sizes and against else None


def _short(values):
    """Numbers of a few digits, None where there is none."""
    return [float(f"{v:.{_DIGITS}g}") if np.isfinite(v) else None for v in values]
