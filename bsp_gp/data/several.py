"""Several files of one motion as one data set: every file is a scene, or keeps its own."""

import os
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from bsp_gp.data import arrays, gps
from bsp_gp.data.folder import ENTITIES, TRAJECTORIES
from bsp_gp.data.scene import CHECK, Dataset
from bsp_gp.errors import DataError

TABLES = (
    ".csv", ".txt", ".tsv", ".dat", ".trk", ".parquet", ".pq", ".jsonl", ".ndjson",
    *arrays.ENDINGS, *gps.ENDINGS,
)  # fmt: skip
"""Endings of files that may be recordings."""

_REMEDY = "files given together need the same columns and units; convert it, or leave it out"


def name_of_several(paths):
    """What the names of some files begin with alike, or the first one's name."""
    stems = [Path(path).stem for path in paths]
    common = os.path.commonprefix(stems).rstrip(" _-.#([")
    return common if len(common) > 1 else f"{stems[0]}-and-{len(stems) - 1}-more"


def tables_of(path):
    """The tables of a folder that holds nothing else, as people count; () of all others."""
    path = Path(path)
    if not path.is_dir():
        return ()
    files = [file for file in path.iterdir() if not file.name.startswith(".")]
    is_table = all(file.is_file() and file.suffix.lower() in TABLES for file in files)
    own = {TRAJECTORIES, Path(TRAJECTORIES).with_suffix(".parquet").name, ENTITIES}
    if not files or not is_table or own & {file.name for file in files}:
        return ()
    return tuple(sorted(files, key=lambda file: _counted(file.name)))


def _counted(name):
    """A key by which clip10 comes after clip9."""
    return [int(part) if part.isdigit() else part.lower() for part in re.split(r"(\d+)", name)]


def joined(datasets, paths):
    """One data set of several, of which each comes from one of the paths.

    A file of one scene gives its name to it; scenes of a file with several keep theirs, after that
    of the file where another file has the same.

    Raises
    ------
    DataError
        If columns or units differ; names the file.
    """
    first = datasets[0]
    for dataset, path in zip(datasets[1:], paths[1:], strict=True):
        _require_alike(first, dataset, paths[0], path)
    stems = [Path(path).stem for path in paths]
    bodies = _bodies_of(datasets, stems)
    if bodies:
        return _side_by_side(datasets, bodies, paths)
    if len(set(stems)) < len(stems):
        stems = [f"{Path(path).resolve().parent.name} {Path(path).stem}" for path in paths]
    names = [[scene.name for scene in d.scenes] if len(d.scenes) > 1 else [stem]
             for d, stem in zip(datasets, stems, strict=True)]  # fmt: skip
    counts = Counter(name for each in names for name in each)
    taken = [[name if counts[name] == 1 else f"{stem} {name}" for name in each]
             for stem, each in zip(stems, names, strict=True)]  # fmt: skip
    flat = [name for each in taken for name in each]
    if len(set(flat)) < len(flat):
        twice = next(name for name in flat if flat.count(name) > 1)
        raise DataError(f"two files give a scene {twice!r}", remedy="give every file once")
    scenes, notes, sides, provenance = [], {}, {"train": [], "test": []}, {}
    for dataset, new, stem in zip(datasets, taken, stems, strict=True):
        of_old = dict(zip((scene.name for scene in dataset.scenes), new, strict=True))
        scenes += [replace(s, name=of_old[s.name]) for s in dataset.scenes]
        for side, chosen in sides.items():
            chosen += [of_old[name] for name in getattr(dataset, side)]
        for note in dataset.notes:
            notes.setdefault(note, []).append(stem)
        provenance = {**dataset.provenance, **provenance}
    told = [note if len(of) == len(stems) else f"{', '.join(of)}: {note}"
            for note, of in notes.items()]  # fmt: skip
    return Dataset(
        name_of_several(paths), tuple(scenes), tuple(sides["train"]), tuple(sides["test"]),
        first.units, {k: v for d in datasets for k, v in d.property_units.items()}, first.up,
        first.noise, first.velocity, first.latents, first.evaluation, provenance, tuple(told),
        first.noise_memory, {k: v for d in reversed(datasets) for k, v in d.logged.items()},
        any(d.is_film for d in datasets),
        max((d.steps for d in datasets), key=lambda steps: sum(steps)),
    )  # fmt: skip


def _bodies_of(datasets, stems):
    """Names of the bodies of one recording that some files hold, one each; () where they do not.

    Tracker writes a file for every mass: its name says so, or its title, and all have one clock.
    """
    scenes = [dataset.scenes[0] for dataset in datasets]
    is_lone = all(len(d.scenes) == 1 and len(d.scenes[0].entities) == 1 for d in datasets)
    if len(datasets) < 2 or not is_lone:
        return ()
    times = scenes[0].times
    off = SAME_CLOCK * float(np.median(np.diff(times)))
    is_one_clock = all(
        len(s.times) == len(times) and np.abs(s.times - times).max() < off for s in scenes
    )
    is_plain = not any(s.inputs or s.first or s.velocities is not None for s in scenes)
    for names in ([s.names[0] for s in scenes], stems):
        if len(set(names)) == len(names) and all(map(_MASS.search, names)):
            return tuple(names) if is_one_clock and is_plain else ()
    return ()


_MASS = re.compile(r"(?:^|[\W_])(?:mass|masse|masa|massa)[\W_]*\w{1,2}(?:$|[\W_])", re.IGNORECASE)
"""``mass_A``, ``masse 1``, as Tracker calls them in its languages."""
SAME_CLOCK = 0.01
"""Part of a step up to which times are the same."""


def _side_by_side(datasets, names, paths):
    """One data set of files that hold a body each of one recording."""
    first, scenes = datasets[0], [dataset.scenes[0] for dataset in datasets]
    entities = tuple(
        replace(scene.entities[0], name=name) for scene, name in zip(scenes, names, strict=True)
    )
    sigma = [s.sigma for s in scenes]
    logs = {
        name: np.concatenate([s.logs[name] for s in scenes], axis=1)
        for name in first.logged if all(name in s.logs for s in scenes)
    }
    scene = replace(
        scenes[0], name=name_of_several(paths), entities=entities,
        positions=np.concatenate([s.positions for s in scenes], axis=1),
        sigma=None if any(s is None for s in sigma) else np.concatenate(sigma, axis=1), logs=logs,
    )  # fmt: skip
    told = dict.fromkeys(note for dataset in datasets for note in dataset.notes)
    note = (
        f"{CHECK}files of one clock that are called after masses are bodies of one recording: "
        f"{', '.join(names)}; where they are recordings, call them otherwise"
    )
    logged = {name: about for name, about in first.logged.items() if name in logs}
    return replace(first, name=scene.name, scenes=(scene,), notes=(*told, note), logged=logged)


def _require_alike(first, other, path, file):
    """DataError about the first thing in which two data sets differ."""
    here, there = dict(other.units.declared), dict(first.units.declared)
    for kind in dict.fromkeys((*there, *here)):
        if here.get(kind) != there.get(kind):
            raise DataError(
                f"{kind} is in {here.get(kind, 'no unit')}, and in {there.get(kind, 'no unit')} in "
                f"{Path(path).name}", file=file, column=kind, remedy=_REMEDY,
            )  # fmt: skip
    for what, one, two in zip(_ALIKE, _build(other), _build(first), strict=True):
        if one != two:
            raise DataError(
                f"{what} are {one or 'none'}, and {two or 'none'} in {Path(path).name}", file=file,
                remedy=_REMEDY,
            )  # fmt: skip


_ALIKE = ("axes", "measured inputs", "properties of bodies", "other declarations")


def _build(dataset):
    """What must be the same in all files, in words."""
    missing = {axis for axis in "xyz" for note in dataset.notes
               if note.startswith(f"there is no column {axis!r}")}  # fmt: skip
    axes = [axis for axis in "xyz"[: dataset.n_dims] if axis not in missing]
    inputs = sorted({name for scene in dataset.scenes for name in scene.inputs})
    rest = [f"up = {dataset.up}" if dataset.up else "", f"noise = {dataset.noise}"]
    rest += [f"velocity = {dataset.velocity}", f"noise_memory = {dataset.noise_memory}"]
    rest += [f"latent {latent.name}" for latent in dataset.latents]
    return tuple(
        ", ".join(filter(None, each)) for each in (axes, inputs, dataset.property_names, rest)
    )
