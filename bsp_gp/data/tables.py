"""Data sets as folders and lone tables: in (`load_dataset`), and out again (`save_dataset`).

A folder holds ``trajectories.csv``, and if there is more to say ``entities.csv`` and
``dataset.toml``. Whatever cannot be used is an error that names file, line, column and remedy,
or a note in `Dataset.notes`; nothing is dropped silently.
"""

import dataclasses
import glob
import hashlib
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd

from bsp_gp.data.apart import below_each_other, may_be_below, recordings_apart
from bsp_gp.data.assembly import (
    along_named_axis,
    axes_of,
    build_rows,
    build_scenes,
    inputs_of,
    unwrapped,
)
from bsp_gp.data.clock import check_declared_rate, clock_jumps
from bsp_gp.data.conversion import COLUMN_KINDS, KINDS, Conversion, ratio_of
from bsp_gp.data.counted import with_counted_angles
from bsp_gp.data.dates import since_1970
from bsp_gp.data.declaration import Declaration, read_declaration, select_scenes
from bsp_gp.data.extent import spans_the_sky
from bsp_gp.data.folder import ENTITIES, TOML, TRAJECTORIES, save_dataset
from bsp_gp.data.formats import long_table, read_table
from bsp_gp.data.headings import (
    bodies_beside,
    headings,
    is_angle,
    is_angle_name,
    is_ignored,
    one_blank,
)
from bsp_gp.data.horizons import without_header
from bsp_gp.data.logged import named_of
from bsp_gp.data.meeting import without_meetings
from bsp_gp.data.notes import quoted
from bsp_gp.data.on_maps import from_maps
from bsp_gp.data.polar import POLAR_ALIASES, from_polar
from bsp_gp.data.polar_words import plain_words
from bsp_gp.data.properties import LEFT_OUT, read_properties, with_properties
from bsp_gp.data.property_columns import unread_masses, with_properties_by_words
from bsp_gp.data.rates import from_rates
from bsp_gp.data.records import told_of_record
from bsp_gp.data.roster import OWN_COLUMNS, Roster, read_roster, roster_within
from bsp_gp.data.scene import CHECK, PROPERTY_UNITS, SIGHT, Dataset, Entity
from bsp_gp.data.several import joined, tables_of
from bsp_gp.data.sight import instead_of_places, with_zeros_apart
from bsp_gp.data.sky import from_sky
from bsp_gp.data.stars import PRIMARY, read_stars, with_named_dates, with_primary
from bsp_gp.data.still import held_still
from bsp_gp.data.table import Table, less
from bsp_gp.data.trk import read_trk
from bsp_gp.data.twice import (
    by_date,
    measures_at_once,
    without_copies,
    without_held,
    without_slips,
)
from bsp_gp.data.uncalibrated import without_other_units
from bsp_gp.data.wide import groups_of
from bsp_gp.errors import DataError, MissingDependencyError, UnitError, in_python
from bsp_gp.output.mark import read_mark
from bsp_gp.units import Unit, parse_unit

__all__ = ["dataset_from_frames", "load_dataset", "save_dataset"]

_IN_SECONDS = "times are in seconds since"
"""What a note of dates says, where no other unit is declared."""
MAX_COLUMNS = 12
"""Columns whose meaning is told."""


def load_dataset(
    path: str | os.PathLike | Sequence[str | os.PathLike], *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None, fps: float | None = None, dt: float | None = None,
    train: str | Sequence[str] | None = None, test: str | Sequence[str] | None = None,
    properties: Mapping | None = None, sky: Mapping[str, str] | None = None,
    uses: Sequence[str] = (),
) -> Dataset:  # fmt: skip
    """Read a data set folder, or a lone delimited file, or several as recordings of one motion.

    Parameters
    ----------
    path : path-like, or sequence of them
        A folder with ``trajectories.csv`` (or ``.parquet``), or a text file (CSV, a Tracker
        export, a trackpy table). Of several (``run*.csv``), or of a folder of tables, every file is
        a scene that is called like it, or keeps its scenes; see `bsp_gp.data.several.joined`.
    units : mapping of str to str, optional
        Kind or column -> unit, on top of ``[units]``: ``{"length": "cm", "time": "s"}``.
        ``"px"`` keeps pixels; ``"0.17 um"`` says what one count is.
    columns : mapping of str to str, optional
        Our name of a column -> its name in the file, e.g. ``{"x": "X_cm"}``, or its number from 1
        where there is no header, ``{"x": "3"}``; of bodies side by side ``{"red_x": "X1",
        "red_y": "Y1", "blue_x": "X2", ...}``; and ``velocity="measured"`` if the velocity columns
        are data in their own right.
    fps, dt : float, optional
        Frames per second, or time per frame in the unit of time, where the file counts frames or
        every row is one.
    train, test : str or list of str, optional
        Names, globs or ranges ``a..b`` of scenes, in place of ``[split]``.
    properties : mapping of str to float, str or mapping, optional
        Property -> number for all bodies, or body -> number: ``{"mass": 0.3}``, ``{"mass":
        "305.8[g]"}``, ``{"mass": {"star1": 1.2, "star2": 0.8}}``; in place of what the data say.
    sky : mapping of str to str, optional
        How far it is: ``{"distance": "8.2 kpc"}`` or ``{"parallax": "379.2 mas"}``.
    uses : sequence of str, optional
        Names in the laws to come. Further columns of these names are measured inputs, as those
        with a unit in `units` are, if their headings tell the unit: ``Force (N)``.

    Returns
    -------
    Dataset
        Numbers are SI where units were declared, else as in the file.

    Raises
    ------
    DataError
        Whatever is wrong with the data, with file, line, column and remedy.
    """
    reading = {"units": units, "columns": columns, "fps": fps, "dt": dt, "properties": properties,
               "sky": sky, "uses": uses}  # fmt: skip
    if isinstance(path, str | os.PathLike) and _is_pattern(path):
        path = [path]
    if isinstance(path, str | os.PathLike):
        folder, paths = Path(path), list(tables_of(path))
    else:
        folder, paths = None, [Path(name) for each in path for name in _matching(each)]
        if not paths:
            raise DataError("no file is given; at least one is needed")
    if folder is not None and not paths:
        dataset = _loaded(folder, train=train, test=test, **reading)
    else:
        dataset = joined([_loaded(each, **reading) for each in paths], paths)
        if folder is not None:
            dataset = dataclasses.replace(dataset, name=folder.resolve().name)
        if train is not None or test is not None:
            said = Declaration(file="arguments").override(train=train, test=test)
            sides = _split(said, [scene.name for scene in dataset.scenes])
            notes = (*dataset.notes, *sides[2])
            dataset = dataclasses.replace(dataset, train=sides[0], test=sides[1], notes=notes)
    return with_properties(named_of(dataset, uses), properties)


def _is_pattern(path):
    """Whether a path stands for several, as where a shell does not expand it."""
    return any(mark in str(path) for mark in "*?[") and not os.path.lexists(path)


def _matching(path):
    """The files that a pattern stands for, in order; a plain path as it is."""
    found = sorted(glob.glob(str(path))) if _is_pattern(path) else []
    return found or [path]


def _loaded(path, **reading):
    """One file or folder, without what is said of properties beside it."""
    try:
        return _read(path, **reading)
    except DataError as error:
        raise told_of_record(error, path) from None


def _read(path, *, units, columns, fps, dt, properties, sky, uses=(), train=None, test=None):
    """One file or folder; errors speak of lines of the table that is made of it."""
    if path.is_dir():
        path = _data_of_recording(path)
        trajectories = path / TRAJECTORIES
        packed = trajectories.with_suffix(".parquet")
        if packed.is_file() and not trajectories.is_file():
            trajectories = packed
        if not trajectories.is_file():
            present = ", ".join(sorted(p.name for p in path.iterdir())[:10]) or "nothing"
            raise DataError(
                f"the folder has no {TRAJECTORIES}; it holds {present}", file=path,
                remedy=f"name the table of positions {TRAJECTORIES}, or give the file itself",
            )  # fmt: skip
        toml = path / TOML
        declaration = read_declaration(toml) if os.path.lexists(toml) else Declaration()
        entities = path / ENTITIES
    elif path.suffix.lower() == ".trk" and path.is_file():
        if sky is not None:
            raise DataError("a Tracker file shows no sky", file=path, remedy="leave out sky")
        return _from_tracker(path, units=units, fps=fps, dt=dt, train=train, test=test)
    elif path.suffix.lower() == ".trz" and path.is_file():
        raise DataError(
            "a zipped Tracker project cannot be read as it is",
            file=path,
            remedy="unzip it (it is a ZIP file) and give the .trk file inside",
        )
    elif path.is_file():
        trajectories, entities, declaration = path, None, Declaration()
    else:
        raise DataError("there is no such file or folder", file=path, remedy="check the path")
    declaration = declaration.override(
        units=units, columns=columns, fps=fps, dt=dt, train=train, test=test,
        properties=properties, sky=sky, uses=uses,
    )  # fmt: skip
    if trajectories.suffix.lower() in (".parquet", ".pq"):
        table = _read_parquet(trajectories, declaration.columns)
    else:
        renames = {**declaration.kept_names, **declaration.columns}
        table = read_table(trajectories, rename=renames)
    roster = None
    if entities is not None and os.path.lexists(entities):
        roster = read_table(entities, rename=declaration.columns, as_text=True)
    name = path.resolve().name if path.is_dir() else path.stem
    return _assemble(table, roster, declaration, name)


def _data_of_recording(folder):
    """The data set in a folder that `track` made of a film; other folders as they are."""
    try:
        mark = read_mark(folder)
    except OSError:
        return folder
    return folder / "data" if mark is not None and mark.kind == "recording" else folder


def _read_parquet(path, rename):
    try:
        frame = pd.read_parquet(path)
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: reading Parquet needs pyarrow: pip install pyarrow, or save it as CSV"
        ) from error
    except (OSError, ValueError) as error:
        raise DataError(f"this is no Parquet file that can be read: {error}", file=path) from error
    table = _frame_table(frame, rename, "frames")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return dataclasses.replace(table, file=str(path), digest=digest)


def _from_tracker(path, *, units, fps, dt, train, test):
    """A data set of a Tracker file; time and axes are its own, the rest may be declared."""
    if fps is not None or dt is not None:
        raise DataError("a Tracker file has its own times", file=path, remedy="leave out fps or dt")
    frame, about = read_trk(path)
    own = {"time": "s"}
    own |= {k: v for k, v in (("length", about["unit"]), ("mass", about["mass_unit"])) if v}
    tracked = [name for name in about["masses"] if name in set(frame["entity"])]
    entities = pd.DataFrame({"entity": tracked})
    masses = [about["masses"][name] for name in tracked]  # in the file's unit
    if any(mass > 0 for mass in masses):
        entities["mass"] = [mass if mass > 0 else math.nan for mass in masses]
    dataset = dataset_from_frames(
        frame, entities, name=path.stem, units=own | dict(units or {}), up="y", train=train,
        test=test, provenance={"source": f"Tracker file {path.name}"},
    )  # fmt: skip
    return dataclasses.replace(dataset, notes=(*dataset.notes, *about["notes"]))


def dataset_from_frames(
    frames, entities=None, *, name="frames", units=None, columns=None, fps=None, dt=None,
    train=None, test=None, up=None, noise=None, provenance=None, properties=None,
):  # fmt: skip
    """Make a data set of DataFrames with the columns of ``trajectories.csv``.

    Parameters
    ----------
    frames : DataFrame or mapping of str to DataFrame
        Long tables (those of trackpy too), or tables with bodies side by side (``red_x, red_y,
        blue_x, blue_y``); a mapping gives the names of the scenes.
    entities : DataFrame or sequence of Entity, optional
        The content of ``entities.csv``.
    name, up, noise, provenance
        As in ``dataset.toml``.
    units, columns, fps, dt, train, test, properties
        As for `load_dataset`. Where headings do not say which column is the place of which body,
        ``columns`` does, as ``BODY_x`` and ``BODY_y`` with names of your own.

    Examples
    --------
    >>> import pandas as pd
    >>> df = pd.DataFrame({"t": [0, 1, 2], "P1": [0, 1, 2], "P2": [0, 0, 0], "Q1": [9, 8, 7],
    ...                    "Q2": [5, 5, 5]})
    >>> dataset_from_frames(
    ...     df, columns={"red_x": "P1", "red_y": "P2", "blue_x": "Q1", "blue_y": "Q2"},
    ...     units={"length": "cm", "time": "s", "mass": "g"},
    ...     properties={"mass": {"red": 69.3, "blue": 127.9}},
    ... ).scenes[0].names
    ('red', 'blue')
    """
    noise = noise.tolist() if hasattr(noise, "tolist") else noise  # of numpy
    declaration = Declaration(
        name=name, up=up, provenance=dict(provenance or {}), file="arguments"
    ).override(units=units, columns=columns, fps=fps, dt=dt, train=train, test=test, noise=noise,
               properties=properties)  # fmt: skip
    if isinstance(frames, Mapping):
        if not frames:
            raise DataError("frames is an empty mapping; at least one scene is needed")
        pieces = [_checked_frame(f).assign(scene=str(k)) for k, f in frames.items()]
        frames = pd.concat(pieces, ignore_index=True)
    table = _frame_table(_checked_frame(frames), declaration.columns, "frames")
    if entities is None or isinstance(entities, pd.DataFrame):
        roster = entities
        if entities is not None:
            roster = _frame_table(entities, declaration.columns, "entities")
    else:
        roster = _roster_of(tuple(entities))
    return with_properties(_assemble(table, roster, declaration, name), properties)


def _checked_frame(frame):
    if not isinstance(frame, pd.DataFrame):
        raise DataError(f"frames must be a DataFrame or a mapping of them, got {type(frame)}")
    return frame


def _frame_table(frame, rename, what):
    if frame.empty:
        raise DataError("the table has no rows", file=what)
    found = headings(frame.columns, rename, is_track=what == "frames")
    plain = frame.set_axis(range(frame.shape[1]), axis=1).set_axis(range(1, len(frame) + 1), axis=0)
    is_track = what == "frames"
    return long_table(
        plain, found, [h.unit for h in found], groups_of(found, file=what, is_track=is_track),
        file=what, as_text=not is_track,
    )  # fmt: skip


def _roster_of(entities):
    if not all(isinstance(entity, Entity) for entity in entities):
        raise DataError("entities must be a DataFrame or a sequence of Entity")
    rows = {(None, entity.name): k for k, entity in enumerate(entities)}
    if len(rows) < len(entities):
        raise DataError("two entities have one name", file="entities")
    return Roster(entities, rows, {}, "entities", ())


def _assemble(table, roster, declaration, default_name):
    """Table and roster (a Table, a ready Roster, or None) to a Dataset."""
    if roster is None:
        table = below_each_other(table)
        table = with_properties_by_words(table, declaration.units)
        roster, table = roster_within(table, declaration.units)
    _require_renames(declaration, [t for t in (table, roster) if isinstance(t, Table)])
    table = without_header(_since_1970(table, declaration.units), declaration)
    table = _dates_as_declared(table, declaration.units)
    table = instead_of_places(table, declaration)
    table, declaration, is_star = read_stars(with_named_dates(table, declaration), declaration)
    declaration = _with_their_names(table, declaration)
    table, declaration = with_counted_angles(table, declaration)
    declaration, input_notes = _with_inputs(table, declaration)
    table = from_maps(table, declaration)
    table, declaration = from_rates(table, declaration)
    table = with_zeros_apart(table, declaration)
    table = without_other_units(table, declaration)
    declaration = _with_angles(table, declaration)
    table, declared = from_polar(
        table, declaration.units, start=declaration.angle_from or "x",
        sense=declaration.angle_turns or "counter-clockwise",
    )  # fmt: skip
    table, declared = from_sky(table, declared, declaration.sky)
    table = along_named_axis(table, declaration)
    tables = [t for t in (table, roster) if isinstance(t, Table)]
    if "angle" in declared and not any("angle" in t.frame for t in tables):
        declared = {"length": declared["angle"], **{k: v for k, v in declared.items()
                                                    if k != "angle"}}  # fmt: skip
    axes_of(table, declaration)  # what is missing is told before its unit is
    units, units_notes = _units_of(tables, declared)
    units_notes += _about_unit_of_x(table, units)
    known = {*OWN_COLUMNS, *declaration.properties}
    known |= {latent.name for latent in declaration.latents}
    for each in tables:
        known |= set(each.frame.columns) | {str(c)[:-2] for c in each.frame if str(c)[-2:] == "_x"}
    known |= {unit for t in tables for unit in t.units}
    units_notes += [] if is_star else _half_said(table, units)
    conversion = Conversion(
        units, known, declaration.file or table.file, has_fps=declaration.fps is not None,
        may_be_half=not is_star, of_sight=declaration.velocity == SIGHT,
    )  # fmt: skip
    is_said = roster is not None and (
        not isinstance(roster, Table) or "dynamic" in roster.frame.columns
    )
    if isinstance(roster, Table):
        shares = [latent.share for latent in declaration.latents]
        roster = read_roster(roster, conversion, coded=shares)
    rows = build_rows(table, declaration, conversion, scene_name=default_name)
    rows, copied = without_copies(rows)
    rows, put = by_date(rows)
    rows, twice = measures_at_once(rows)
    rows, slips = without_slips(rows)
    rows, held = without_held(rows)
    again = () if conversion.system.is_angle else may_be_below(rows)
    rows, apart = recordings_apart(rows, roster, "scene" in table.frame.columns)
    rows, met = without_meetings(rows) if roster is None else (rows, ())
    scenes, idle = build_scenes(rows, roster, without_track=(PRIMARY,) if is_star else ())
    scenes = with_primary(scenes, roster) if is_star else scenes
    free = _free_of_the_sky(scenes, declaration, conversion.system)
    scenes, still = (scenes, ()) if is_said or is_star else held_still(scenes, free)
    if conversion.system.is_angle:
        scenes = tuple(map(unwrapped, scenes))
    has_times = "t" in table.frame.columns
    clock = check_declared_rate(rows, declaration, conversion.time()) if has_times else ()
    clock += clock_jumps(rows, scenes, conversion.time())
    scenes = _with_noise_of_bodies(scenes, declaration, conversion, rows.entity_names)
    train, test, split_note = _split(declaration, rows.scene_names)
    latents, latent_units = _latents(declaration, conversion, rows, roster)
    notes = [
        *table.notes,
        *_unused(table, inputs_of(table, declaration)),
        *units_notes,
        *input_notes,
        *rows.notes,
        *copied,
        *put,
        *twice,
        *slips,
        *held,
        *again,
        *apart,
        *met,
        *still,
        *(roster.notes if roster else ()),
        *idle,
        *clock,
        *_noise_notes(declaration, rows),
        *split_note,
    ]
    has_velocity = {"vx", "vy", "vz"} & set(table.frame.columns)
    is_used = declaration.velocity != "ignore" or declaration.first_velocity != "unknown"
    if has_velocity and not is_used:
        notes.append(
            'velocity columns are not used; write [columns] velocity = "measured" if they were '
            "measured and are not differences of positions"
        )
    n_dims = scenes[0].n_dims
    steps = table.steps or dict(zip("xyz", declaration.steps, strict=False))
    steps = {axis: float(step * conversion.length(axis)) for axis, step in steps.items()}
    steps = tuple(steps.get(axis, 0.0) for axis in "xyz"[:n_dims]) if steps else ()
    provenance = dict(declaration.provenance)
    theirs = [k if k == v else f"{k} = {v!r}" for k, v in table.theirs.items()]
    if theirs != list(table.theirs):
        more = f" and {len(theirs) - MAX_COLUMNS} more" if len(theirs) > MAX_COLUMNS else ""
        provenance["columns"] = ", ".join(theirs[:MAX_COLUMNS]) + more
    for each in tables:
        if each.digest:
            provenance[f"sha256 of {Path(each.file).name}"] = each.digest
    return Dataset(
        name=declaration.name or default_name,
        scenes=scenes,
        train=train,
        test=test,
        units=_with_remedies(conversion.system, unread_masses(table)),
        property_units={
            **latent_units,
            **(roster.units if roster else {}),
            **{name: unit for name, (_, unit) in rows.inputs.items()},
        },
        up=_up(declaration, n_dims) or table.up,
        noise=_noise(declaration, conversion, n_dims),
        noise_memory=_noise_memory(declaration, conversion),
        logged={name: (heading, unit) for name, (heading, _, unit) in rows.logged.items()},
        velocity=declaration.velocity,
        latents=latents,
        evaluation=declaration.evaluation,
        provenance=provenance,
        notes=tuple(notes),
        is_film=declaration.fps is not None or Path(table.file).suffix.lower() == ".trk",
        steps=steps,
    )


def _with_remedies(system, of_masses):
    """The units, and what to say where a mass turns out to be needed."""
    if not of_masses or "mass" in system.declared:
        return system
    return dataclasses.replace(system, remedies=MappingProxyType({"kg": of_masses}))


_DRIVES = frozenset("torque tau drehmoment force kraft thrust throttle pwm duty motor".split())
"""Words of columns that say what drives a body."""
_HEADINGS = frozenset("heading attitude yaw bow azimuth orientation kurs cap rumbo".split())
"""Words of columns that say how a body is turned."""


def _unused(table, inputs):
    """A note of what is not read of a table, and of what of it may be an input."""
    unused = {name: theirs for name, theirs in table.unused.items() if name not in inputs}
    names = list(unused.values())
    able = [theirs for name, theirs in unused.items() if name in table.frame]  # of bodies none is
    able = [theirs for theirs in able if theirs.isidentifier()]
    more = f" and {len(names) - MAX_COLUMNS} more" if len(names) > MAX_COLUMNS else ""
    note = [f"not used: {', '.join(names[:MAX_COLUMNS])}{more}"] if names else []
    where = [name for name in able if plain_words(name) & _HEADINGS]
    if where:
        note.append(
            f"column {where[0]} may say how the body is turned: --units {where[0]}=deg makes it an "
            "input of laws, which may then act along and across the body's own axis"
        )
    driving = [n for n in able if plain_words(n.rstrip("0123456789")) & _DRIVES]
    if driving:
        note.append(
            f"column {driving[0]} may drive the motion: --units {driving[0]}=UNIT makes it an "
            "input of laws"
        )
    return note + _left_out_bodies(table, inputs)


def _left_out_bodies(table, inputs):
    """A note of columns that are not used and look like the places of more bodies, and the remedy.

    It is one of those that `with_properties` tells again where a body is missed.
    """
    taken = {*inputs, *table.renamed}  # or left out by the caller
    unused = {name: theirs for name, theirs in table.unused.items() if name not in taken}
    found = bodies_beside(unused, table.units) if "entity" not in table.frame.columns else {}
    if not found:
        return []
    columns = [column for axes in found.values() for column in axes.values()][:MAX_COLUMNS]
    own = {axis: table.heading(axis) for axis in table.axes}
    sides = {"ONE": own, "OTHER": next(iter(found.values()))}
    options = " ".join(f"{body}_{axis}={quoted(column)}" for body, axes in sides.items()
                       for axis, column in sorted(axes.items()))  # fmt: skip
    return [
        in_python(f"{LEFT_OUT}{', '.join(map(repr, columns))}; bodies side by side are named "
                  f"--columns {options}, with names of yours for ONE and OTHER")
    ]  # fmt: skip


def _with_their_names(table, declaration):
    """The declaration with units under our names that are declared under those of the file."""
    used = [(name, theirs) for name, theirs in table.theirs.items() if name in table.frame]
    ours = {theirs: name for name, theirs in (*table.unused.items(), *used)}
    ours |= {re.sub(r"\s*[\[(].*", "", theirs).strip(): name for name, theirs in used}
    taken = {*table.frame.columns, *KINDS}
    ours = ours if "t" in taken or "time" in declaration.units else {**ours, "t": "time"}
    return dataclasses.replace(declaration, units={
        ours.get(one_blank(name), name) if name not in taken else name: unit
        for name, unit in declaration.units.items()
    })  # fmt: skip


def _with_inputs(table, declaration):
    """The declaration with the units of further columns that laws name; notes of these.

    A law that names a column means it: it would be a constant to be fitted otherwise.
    """
    named = [n for n in table.unused if n in table.frame and n not in declaration.units]
    named = [n for n in named if {n, re.sub("_[xyz]$", "", n)} & set(declaration.uses)]
    told = {name: table.units[name] for name in named if name in table.units}
    notes = [
        f"laws name {name!r}: a measured input, in {unit} as its heading has it"
        for name, unit in told.items()
    ]
    notes += [
        f"laws name {name!r}, and so is a column called that is not used: --units {name}=UNIT "
        "makes it an input of laws"
        for name in named if name not in told
    ]  # fmt: skip
    units = {**told, **declaration.units}
    return dataclasses.replace(declaration, units=units), list(map(in_python, notes))


def _about_unit_of_x(table, units):
    """A note of axes that have none where x has a unit, which is then theirs."""
    if "x" not in units or "length" in units:
        return []
    more = [axis for axis in "yz" if axis in table.frame and axis not in units]
    told = f"{' and '.join(more)} without a unit: taken as that of x, {units['x']}"
    return [told] if more else []


def _since_1970(table, units):
    """Unix times, whatever they count, in seconds since the first."""
    if "t" not in table.frame.columns or table.is_dated:
        return table
    if not table.is_numeric("t"):
        return table
    said = units.get("t", units.get("time", table.units.get("t", "")))
    found = since_1970(table.frame["t"].to_numpy(dtype=float), said)
    if found is None:
        return table
    times, unit = found
    table = dataclasses.replace(
        table.assigned(t=times), units={**table.units, "t": "s"}, is_dated=True
    )
    return table.noted(f"times count {unit} since 1970: they are in seconds since the first")


def _dates_as_declared(table, units):
    """Times that were dates in the unit that is declared: they are in none of their own."""
    text = units.get("t", units.get("time"))
    if not table.is_dated or text is None:
        return table
    try:
        scale, unit = parse_unit(text)
    except UnitError:  # told where all units are read
        return table
    if unit != Unit.of(s=1):
        return table
    frame = table.frame.assign(t=table.frame["t"] / scale)
    notes = tuple(note.replace(_IN_SECONDS, f"times are in {text} since") for note in table.notes)
    return dataclasses.replace(table, frame=frame, units={**table.units, "t": text}, notes=notes)


def _with_angles(table, declaration):
    """The declaration with the unit that angles are declared in under their own names."""
    own = {
        name: unit for name, unit in declaration.units.items()
        if name not in table.frame and is_angle(unit) and _names_angles(table, name)
    }  # fmt: skip
    theirs = table.theirs.get("x", "")
    known = {*declaration.units, *table.units}
    if not own and is_angle_name(theirs) and not known & {"x", "length"}:
        clock = "" if known & {"t", "time"} else " t=s"
        table.fail(
            f"{theirs!r} is an angle in an unknown unit", theirs,
            f"declare it: --units {quoted(theirs)}=rad{clock}, or {quoted(theirs)}=deg, or "
            f"of counts of an encoder what one is, {quoted(theirs)}=rev/4000",
        )  # fmt: skip
    if not own or "x" not in table.frame:
        return declaration
    if len(set(own.values())) > 1:
        raise DataError(
            f"angles must be in one unit, got {own}", file=declaration.file or table.file,
            column=list(own)[1], remedy="convert one of the columns",
        )  # fmt: skip
    units = less(declaration.units, own) | {"length": next(iter(own.values()))}
    return dataclasses.replace(declaration, units=units)


def _names_angles(table, name):
    """Whether a name is that of a column, or stands for several: theta for theta1 and theta2."""
    several = re.compile(rf"{re.escape(name)}[\s_-]?\w+")
    return name in table.present or (
        is_angle_name(name) and any(map(several.fullmatch, table.present))
    )


def _free_of_the_sky(scenes, declaration, units):
    """Bodies of the sky whose masses are given."""
    if not spans_the_sky(scenes, units):
        return set()
    said = read_properties(declaration.properties).get("mass", {})
    bodies = [entity for scene in scenes for entity in scene.entities]
    return {body.name for body in bodies if body.name in said or "mass" in body.properties}


_ARBITRARY, _ON_EARTH = ("au", "a.u."), ("s", "ms", "min")
"""Units of lengths, arbitrary ones beside such of times: no orbit is told in these."""


def _units_of(tables, declared):
    """Units of the headers and the declared ones, which win, with notes where the two differ."""
    units, notes = {}, []
    for column, text in ((c, text) for table in tables for c, text in table.units.items()):
        kind = COLUMN_KINDS.get(column, column)
        if column in declared or kind not in declared:
            units[column] = text
        elif ratio_of(text, declared[kind]) != 1.0:
            notes.append(f"{column} is in {declared[kind]!r} as declared, not in {text!r}")
    said = {**units, **declared}
    time = None if any(t.is_dated for t in tables) else said.get("t", said.get("time"))
    for column in [c for c, text in units.items() if text.lower() in _ARBITRARY]:
        if time in _ON_EARTH and COLUMN_KINDS.get(column, column) == "length":
            notes.append(
                f"{CHECK}{column} is in {units[column]!r} with times in {time!r}: taken as "
                "arbitrary units, told as px; if astronomical ones, --units length=au"
            )
            units[column] = "px"
    return units | declared, notes


def _half_said(table, units):
    """A note where the unit of lengths or that of times is told, and not both."""
    has_length, has_time = ({"length", *"xyz"} & set(units), bool({"time", "t"} & set(units)))
    if bool(has_length) == has_time or "t" not in table.frame.columns:
        return []
    kind, unit = ("length", "m") if has_time else ("time", "s")
    return [in_python(
        f"{CHECK}no unit of {kind} is given: {kind}s stay numbers of the file, told in "
        f"'{kind}'; --units {kind}={unit} says what they are in"
    )]  # fmt: skip


def _require_renames(declaration, tables):
    found = frozenset().union(*(table.renamed for table in tables))
    for ours, theirs in declaration.columns.items():
        if POLAR_ALIASES.get(ours, ours) not in found:
            present = [column for table in tables for column in table.present]
            is_out = is_ignored(theirs, present)
            what = ours if is_out else theirs
            options = "ONE_OF_THESE=ignore" if is_out else f"{ours}=ONE_OF_THESE"
            raise DataError(
                f"[columns] {ours} = {theirs!r}: there is no column {what!r}; "
                f"present are {', '.join(present)}",
                file=declaration.file or tables[0].file,
                column=ours,
                remedy=f"write --columns {options}; the only other key is velocity "
                "(measured or ignore)",
            )


def _split(declaration, names):
    sides = {
        side: select_scenes(getattr(declaration, side), names, what=side, file=declaration.file)
        for side in ("train", "test")
    }
    overlap = [name for name in sides["train"] if name in set(sides["test"])]
    if overlap:
        raise DataError(
            f"scenes {', '.join(overlap[:5])} are both in train and in test",
            file=declaration.file, remedy="a held-out scene must not be trained on",
        )  # fmt: skip
    note = ()
    for side, other in (("train", "test"), ("test", "train")):
        if sides[side] and not sides[other]:
            chosen = set(sides[side])
            sides[other] = tuple(name for name in names if name not in chosen)
            if sides[other]:
                note = (f"only {side} was declared; the other scenes are {other}",)
            break
    return sides["train"], sides["test"], note


def _scaled(latent, names, scale):
    """Numbers of a declaration in SI; those that are not given stay so."""
    values = {name: getattr(latent, name) for name in names}
    return {name: value * scale for name, value in values.items() if math.isfinite(value)}


def _latents(declaration, conversion, rows, roster):
    latents, units = [], {}
    columns = {name for e in (roster.entities if roster else ()) for name in e.properties}
    for latent in declaration.latents:
        if latent.share not in ("entity", "all", *columns):
            raise DataError(
                f"share in [latent.{latent.name}] must be entity, all or a column of entities.csv "
                f"({', '.join(sorted(columns)) or 'there is none'}), got {latent.share!r}",
                file=declaration.file,
            )
        scale, unit, _ = conversion.property(latent.name)
        units[latent.name] = unit
        entities = select_scenes(
            latent.entities, rows.entity_names, what=f"entities of latent {latent.name}",
            file=declaration.file,
        )  # fmt: skip
        changes = {
            **_scaled(latent, ("low", "high", "mean", "sd"), scale),
            "values": tuple(value * scale for value in latent.values),
            "entities": entities,
        }
        latents.append(dataclasses.replace(latent, **changes))
    return tuple(latents), {k: v for k, v in units.items() if k not in PROPERTY_UNITS}


def _up(declaration, n_dims):
    if declaration.up is not None and declaration.up.strip("-") not in "xyz"[:n_dims]:
        raise DataError(
            f"up is {declaration.up!r}, but the data have the axes {', '.join('xyz'[:n_dims])}",
            file=declaration.file, column="up",
        )  # fmt: skip
    return declaration.up


def _noise(declaration, conversion, n_dims):
    """Noise of all bodies; None where each has its own."""
    if declaration.noise is None or isinstance(declaration.noise, Mapping):
        return None
    return _levels(declaration.noise, "noise", declaration, conversion, n_dims)


def _noise_notes(declaration, rows):
    """That declared noise of all bodies has no say where points quote errors of their own."""
    if declaration.noise is None or rows.sigma is None or not np.isfinite(rows.sigma).any():
        return ()
    if isinstance(declaration.noise, Mapping):
        return ()  # fills what is not quoted
    return (
        f"{CHECK}noise is declared and points quote errors of their own (columns sx, sy, sz): the "
        "quoted ones count, on every axis that has any",
    )


def _levels(values, what, declaration, conversion, n_dims):
    if len(values) not in (1, n_dims):
        raise DataError(
            f"{what} must be one number or one per axis ({n_dims}), got {len(values)}",
            file=declaration.file, column="noise",
        )  # fmt: skip
    return tuple(value * conversion.length("x") for value in values)


def _with_noise_of_bodies(scenes, declaration, conversion, names):
    """Scenes whose points quote the noise declared for their body, where they quote none."""
    if not isinstance(declaration.noise, Mapping):
        return scenes
    of_bodies = {}
    for pattern, values in declaration.noise.items():
        found = select_scenes((pattern,), names, what="[noise]", file=declaration.file)
        what = f"noise of {pattern}"
        levels = _levels(values, what, declaration, conversion, scenes[0].n_dims)
        for name in found:
            if name == pattern or name not in of_bodies:
                of_bodies[name] = levels
    changed = []
    for scene in scenes:
        sigma = np.full(scene.positions.shape, np.nan) if scene.sigma is None else scene.sigma
        sigma = sigma.copy()
        for k in scene.dynamic:
            if scene.names[k] not in of_bodies:
                raise DataError(
                    f"[noise] has nothing for {scene.names[k]!r}", file=declaration.file,
                    column="noise", remedy='add it, or "*" for all the others',
                )  # fmt: skip
            own = np.where(np.isnan(scene.positions[:, k]), np.nan, of_bodies[scene.names[k]])
            sigma[:, k] = np.where(np.isnan(sigma[:, k]), own, sigma[:, k])
        changed.append(dataclasses.replace(scene, sigma=sigma))
    return tuple(changed)


def _noise_memory(declaration, conversion):
    if declaration.noise_memory is None:
        return None
    return declaration.noise_memory * conversion.time()
