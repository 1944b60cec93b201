"""A data set as it was understood, before anything is run: in lines, and as a picture."""

import math

import numpy as np

from bsp_gp.data.conversion import size_of
from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.notes import listed
from bsp_gp.errors import DataError
from bsp_gp.inference.priors import prior_of
from bsp_gp.loop.told import Told
from bsp_gp.report.drawing import new_figure, panels_of, tidy
from bsp_gp.report.numbers import format_number, with_unit
from bsp_gp.units import DIMENSIONLESS, KILOGRAM, METRE, SECOND

MAX_PANELS = 6
FAR = 2.0
"""Times how long a recording takes, from which on its times are far from 0."""
_MAX_NAMES = 8


def data_text(dataset):
    """Say what was understood of a data set, line by line.

    Columns, units, scenes, bodies, inputs, axes, noise and notes.
    """
    names = list(dict.fromkeys(name for scene in dataset.scenes for name in scene.names))
    n_rows = sum(len(scene.times) for scene in dataset.scenes)
    lines = [
        f"{dataset.name}: {_counted(len(dataset.scenes), 'scene')}, "
        f"{_counted(len(names), 'body', 'bodies')}, {_counted(n_rows, 'row')}"
    ]
    columns = dataset.provenance.get("columns")
    lines += [f"Columns: {columns}"] if columns else []
    lines += [_units(dataset), *_scenes(dataset), f"Bodies: {listed(names, _MAX_NAMES)}"]
    if not dataset.is_of_sight:
        lines += [*_properties(dataset), *_inputs(dataset), *_first(dataset), _up(dataset)]
    lines += _motion(dataset)
    lines += [f"Note: {note}" for note in dataset.notes]
    return "\n".join(lines)


def columns_text(name, columns):
    """Say how the headings of a refused table were read, see `bsp_gp.data.glance.columns_of`."""
    known = [f"{c['ours']} = {c['theirs']!r}" for c in columns if c["ours"]]
    rest = [repr(c["theirs"]) for c in columns if not c["ours"]]
    lines = [f"{name}: columns as they are read: {', '.join(known) or 'none is known'}"]
    lines += [f"Not known: {', '.join(rest[:12])}"] if rest else []
    for c in columns[:12]:
        lines.append(f"  {c['theirs']}: {', '.join(c['rows'][:3])} ...")
    return "\n".join(lines)


def _counted(n, one, many=None):
    return f"{n:,} {one if n == 1 else many or one + 's'}"


def _units(dataset):
    declared = dataset.units.declared
    words = {"length": "velocity"} if dataset.is_of_sight else {}
    kinds = [f"{words.get(kind, kind)} in {declared[kind]}" for kind in ("length", "time", "mass")
             if kind in declared]  # fmt: skip
    if kinds:
        shown = [_told(dataset, unit)[1] for unit in (METRE, SECOND)]
        is_same = shown == [declared.get("length"), declared.get("time")]
        below = "" if is_same else f"; below, all are {', '.join(shown)}"
        return f"Units: {', '.join(kinds)}{below}"
    return "Units: none are given, so numbers stay as they are; give them with --units length=m " \
           "time=s"  # fmt: skip


def _told(dataset, unit):
    """Factor of numbers in a unit, and how it is told in the words of the data."""
    units = dataset.units
    return Told(units.declared, units.symbols).unit(units.text(unit))


def _scenes(dataset):
    out, (factor, unit) = [], _told(dataset, SECOND)
    for scene in dataset.scenes[:_MAX_NAMES]:
        times = factor * scene.times
        steps = np.diff(times)
        is_even = np.ptp(steps) <= 0.01 * np.median(steps)
        step = format_number(float(np.median(steps)), 4)
        first, last = (format_number(float(t), _digits(times)) for t in (times[0], times[-1]))
        out.append(
            f"Scene {scene.name}: {_counted(len(scene.times), 'row')}, t from "
            f"{first} to {with_unit(last, unit)}, "
            f"{'every' if is_even else 'mostly every'} {with_unit(step, unit)}"
        )
    left = len(dataset.scenes) - _MAX_NAMES
    return [*out, f"and {_counted(left, 'scene')} more"] if left > 0 else out


def _digits(times):
    """Digits of times: of dates, which are far from 0, as many as tell rows apart."""
    size, step = float(np.abs(times).max()), float(np.median(np.diff(times)))
    if size < FAR * np.ptp(times):
        return 4
    return int(np.clip(np.ceil(np.log10(size / step)) + 1, 4, 15))


def _properties(dataset):
    names = dataset.property_names
    unknown = [f"Unknown: {latent.name}{_of(latent.entities)}, prior {prior_of(latent).text()}"
               f"{'' if latent.share == 'entity' else f', shared: {latent.share}'}"
               for latent in dataset.latents]  # fmt: skip
    if names:
        given = dataset.provenance.get("properties")
        return [f"Properties: {', '.join(names)}{f' (given: {given})' if given else ''}", *unknown]
    if any(latent.name == "mass" for latent in dataset.latents):
        return ["Properties: none is known", *unknown]
    none = "Properties: none (no masses): constants are those per unit of mass"
    if dataset.units.is_calibrated(KILOGRAM):
        none = "Properties: none (no masses): every body is taken as 1 kg"
    none += "; masses are given with --property mass=0.3[kg]"
    return [none, *unknown]


def _inputs(dataset):
    """Measured inputs of laws, with their units and between what they are."""
    out = []
    for name in dict.fromkeys(name for scene in dataset.scenes for name in scene.inputs):
        values = [s.inputs[name].ravel() for s in dataset.scenes if name in s.inputs]
        values = np.concatenate(values)
        declared = dataset.units.declared
        unit = declared.get(name, declared.get(f"{name}_x", ""))
        factor = 1 / size_of(unit) if unit else 1.0
        if not unit:
            factor, unit = _told(dataset, dataset.property_units.get(name, DIMENSIONLESS))
        low, high = (format_number(factor * float(f(values)), 4) for f in (np.nanmin, np.nanmax))
        out.append(f"Input {name}: measured, from {low} to {with_unit(high, unit)}")
    return out


def _of(names):
    return f" of {listed(names, _MAX_NAMES)}" if names else ""


def _first(dataset):
    """What is known of first rows."""
    firsts = [scene.first for scene in dataset.scenes if scene.first is not None]
    known = ["places are exact"] if any(first.is_placed for first in firsts) else []
    errors = [first.velocity_error[np.isfinite(first.velocity)] for first in firsts]
    speeds = [first.velocity[np.isfinite(first.velocity)] for first in firsts]
    if any(len(each) for each in speeds):
        errors, speeds = np.concatenate(errors), np.concatenate(speeds)
        kind = "measured" if errors.any() else "exact" if speeds.any() else "zero"
        known.append(f"velocities are {kind}")
    return [f"First rows: {', '.join(known)}"] if known else []


def _up(dataset):
    if dataset.up:
        return f"Up: {dataset.up}"
    moving = [name for name in "xyz"[: dataset.n_dims] if _moves(dataset, "xyz".index(name))]
    axis = moving[0] if len(moving) == 1 else "y"
    return f"Up: not given; laws with up or down need it: --up {axis}, or --up=-{axis}"


def _moves(dataset, axis):
    return any(np.ptp(s.positions[:, k, axis][np.isfinite(s.positions[:, k, axis])]) > 0
               for s in dataset.scenes for k in s.dynamic
               if np.isfinite(s.positions[:, k, axis]).any())  # fmt: skip


def _motion(dataset):
    """Where bodies are, and the noise, axis by axis."""
    factor, length = _told(dataset, METRE)
    try:
        noise = estimate_noise(dataset)
    except DataError as error:
        return [f"Noise: {error}"]
    out = []
    for axis, name in enumerate("xyz"[: dataset.n_dims]):
        if not math.isfinite(noise.sigma[axis]):
            out += [] if dataset.is_of_sight else [f"Axis {name}: nothing moves along it"]
            continue
        values = [s.positions[:, s.dynamic, axis].ravel() for s in dataset.scenes]
        values = factor * np.concatenate(values)
        low, high = np.nanmin(values), np.nanmax(values)
        what = "Velocity" if dataset.is_of_sight else f"Axis {name}"
        out.append(
            f"{what}: from {format_number(float(low), 4)} to "
            f"{with_unit(format_number(float(high), 4), length)}, noise "
            f"{with_unit(format_number(factor * noise.sigma[axis], 2), length)} ({noise.source})"
        )
    return out


def data_figure(dataset):
    """Draw the tracks of the first scenes, a panel each."""
    scenes = dataset.scenes[:MAX_PANELS]
    n_rows = math.ceil(len(scenes) / 3)

    def draw(figure):
        for axes, scene in zip(panels_of(figure, len(scenes)), scenes, strict=True):
            dataset.plot(axes, scene=scene.name)
            tidy(axes)

    return new_figure(draw, 2.6 * n_rows)
