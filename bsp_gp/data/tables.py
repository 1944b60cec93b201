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
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from bsp_gp.data.declaration import Declaration, read_declaration
from bsp_gp.data.folder import ENTITIES, TOML, TRAJECTORIES, save_dataset
from bsp_gp.data.formats import long_table, read_table
from bsp_gp.data.headings import headings
from bsp_gp.data.logged import named_of
from bsp_gp.data.properties import with_properties
from bsp_gp.data.reading import assemble, split_of
from bsp_gp.data.records import told_of_record
from bsp_gp.data.roster import Roster
from bsp_gp.data.scene import Dataset, Entity
from bsp_gp.data.several import joined, tables_of
from bsp_gp.data.trk import read_trk
from bsp_gp.data.wide import groups_of
from bsp_gp.errors import DataError, MissingDependencyError
from bsp_gp.output.mark import read_mark

__all__ = ["dataset_from_frames", "load_dataset", "save_dataset"]


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
            sides = split_of(said, [scene.name for scene in dataset.scenes])
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
        raise DataError("a zipped Tracker project cannot be read as it is", file=path,
                        remedy="unzip it (it is a ZIP file) and give the .trk file inside")
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
    return assemble(table, roster, declaration, name)


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
    roster = entities
    if isinstance(entities, pd.DataFrame):
        roster = _frame_table(entities, declaration.columns, "entities")
    elif entities is not None:
        roster = _roster_of(tuple(entities))
    return with_properties(assemble(table, roster, declaration, name), properties)


def _checked_frame(frame):
    if not isinstance(frame, pd.DataFrame):
        raise DataError(f"frames must be a DataFrame or a mapping of them, got {type(frame)}")
    return frame


def _frame_table(frame, rename, what):
    if frame.empty:
        raise DataError("the table has no rows", file=what)
    is_track = what == "frames"
    found = headings(frame.columns, rename, is_track=is_track)
    plain = frame.set_axis(range(frame.shape[1]), axis=1).set_axis(range(1, len(frame) + 1), axis=0)
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
