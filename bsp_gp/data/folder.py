"""Write a data set as a folder, whole or not at all, so that it reads back bit for bit."""

import math
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd

from bsp_gp.data.cells import safe_cell
from bsp_gp.data.declaration import toml_text
from bsp_gp.data.roster import OWN_COLUMNS
from bsp_gp.data.scene import PROPERTY_UNITS, Dataset
from bsp_gp.errors import OutputError
from bsp_gp.output.place import claim
from bsp_gp.units import OF_THE_SKY, UNCALIBRATED

TRAJECTORIES, ENTITIES, TOML = "trajectories.csv", "entities.csv", "dataset.toml"


def save_dataset(
    dataset: Dataset, folder: str | os.PathLike, overwrite: bool = False, *, kind: str = "data set"
) -> Path:  # fmt: skip
    """Write `dataset` as a folder that `load_dataset` reads back to the same numbers.

    Parameters
    ----------
    folder : path-like
        Created, with its parents.
    overwrite : bool
        Replace an older data set that was written there by `save_dataset`. What else is in the
        folder is kept.
    kind : str
        What is told of the data set; one of another kind is not replaced.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    OutputError
        If the folder exists, cannot be written, or the data cannot be said in the format.
    """
    with claim(folder, kind, overwrite=overwrite) as place:
        with place.fill(kind, overwrite) as fresh:
            fill_dataset(dataset, fresh)
    return Path(folder)


def fill_dataset(dataset, folder):
    """Write the files of a data set into an empty folder."""
    _trajectories(dataset).to_csv(folder / TRAJECTORIES, index=False, lineterminator="\n")
    _entities(dataset).to_csv(folder / ENTITIES, index=False, lineterminator="\n")
    (folder / TOML).write_text(toml_text(_declaration(dataset)), encoding="utf-8")


def _trajectories(dataset):
    has = {
        prefix: any(getattr(scene, attribute) is not None for scene in dataset.scenes)
        for prefix, attribute in (("", "positions"), ("v", "velocities"), ("s", "sigma"))
    }
    axes = "xyz"[: dataset.n_dims]
    is_begun = _initial(dataset)["velocity"] is not None
    pieces = []
    for scene in dataset.scenes:
        present = _present(scene)
        row, column = np.nonzero(present)
        names = np.array([_text(name) for name in scene.names], dtype=object)
        piece = {"scene": _text(scene.name), "t": scene.times[row], "entity": names[column]}
        blocks = {"": scene.positions, "v": scene.velocities, "s": scene.sigma}
        for prefix, block in blocks.items():
            for k, axis in enumerate(axes if has[prefix] else ""):
                piece[prefix + axis] = math.nan if block is None else block[row, column, k]
        if is_begun:
            piece |= _first_cells(scene, row, column, axes, piece)
        for name, values in scene.inputs.items():
            here = values[row, column]
            names_of = [name] if here.ndim == 1 else [f"{name}_{axis}" for axis in axes]
            piece |= zip(names_of, np.atleast_2d(here.T), strict=True)
        pieces.append(pd.DataFrame(piece))
    return pd.concat(pieces, ignore_index=True)


def _initial(dataset):
    """What ``[initial]`` says of the first rows of scenes."""
    firsts = [scene.first for scene in dataset.scenes if scene.first is not None]
    errors = [f.velocity_error[np.isfinite(f.velocity)] for f in firsts]
    errors = np.concatenate([np.zeros(0), *errors])
    velocity = None if not len(errors) else "measured" if errors.any() else "exact"
    if velocity == "measured" and not errors.all():
        raise OutputError("some first velocities are exact and others are not: no words for that")
    return {
        "position": "exact" if any(f.is_placed for f in firsts) else None, "velocity": velocity,
    }  # fmt: skip


def _first_cells(scene, row, column, axes, piece):
    """Velocities of the first row, and their errors where they have any, for a table."""
    blank = np.full((len(row), len(axes)), np.nan)
    out = {}
    for prefix, name in (("v", "velocity"), ("sv", "velocity_error")):
        values = blank.copy()
        if scene.first is not None:
            values[row == 0] = getattr(scene.first, name)[column[row == 0]]
        for key, own in zip((f"{prefix}{axis}" for axis in axes), values.T, strict=True):
            out[key] = np.where(np.isfinite(own), own, piece.get(key, own))
    return out


def _present(scene):
    """Which rows there are; complains about what the format has no words for."""
    known = np.isfinite(scene.positions)
    present = known.all(axis=2)
    where = f"scene {scene.name!r} cannot be saved"
    if (known.any(axis=2) != present).any():
        raise OutputError(f"{where}: a position is known on some axes only")
    if not present.any(axis=1).all():
        raise OutputError(f"{where}: at one of its times no entity has a position")
    if not present.any(axis=0).all():
        idle = scene.names[int(np.argmin(present.any(axis=0)))]
        raise OutputError(f"{where}: entity {idle!r} has no position at all")
    for block in (scene.velocities, scene.sigma):
        if block is not None and np.isfinite(block[~present]).any():
            raise OutputError(f"{where}: a velocity or sigma stands in a gap of the positions")
    return present


def _text(name):
    """The name as a cell."""
    if not name or name != name.strip() or any(mark in name for mark in "\r\n\0"):
        raise OutputError(f"the name {name!r} cannot be saved: it is blank or has blanks around it")
    return safe_cell(name)


def _entities(dataset):
    """One row per entity where every scene has the same, else one per scene and entity."""
    keys = [tuple(map(_key, scene.entities)) for scene in dataset.scenes]
    is_shared = all(key == keys[0] for key in keys)
    rows = []
    for scene in dataset.scenes[:1] if is_shared else dataset.scenes:
        for entity in scene.entities:
            row = {"entity": _text(entity.name)}
            if not is_shared:
                row["scene"] = _text(scene.name)
            row |= {"shape": entity.shape, "radius": entity.radius, "width": entity.width}
            row |= {"height": entity.height, "dynamic": int(not entity.is_static)}
            rows.append(row | _property_cells(entity))
    return pd.DataFrame(rows)


def _key(entity):
    sizes = (entity.radius, entity.width, entity.height)
    properties = sorted(entity.properties.items())
    return repr((entity.name, entity.shape, sizes, entity.is_static, properties))


def _property_cells(entity):
    cells = {}
    for name, value in entity.properties.items():
        if name in OWN_COLUMNS:
            raise OutputError(f"property {name!r} of {entity.name!r} clashes with a column")
        if np.ndim(value) == 0:
            cells[name] = float(value)
        elif len(value) in (2, 3):
            cells |= {f"{name}_{a}": float(v) for a, v in zip("xyz", value, strict=False)}
        else:
            raise OutputError(f"property {name!r} of {entity.name!r} has {len(value)} components")
    return cells


def _declaration(dataset):
    noise = dataset.noise
    split = {side: list(getattr(dataset, side)) for side in ("train", "test")}
    tables = {
        "name": dataset.name,
        "noise": None if noise is None else noise[0] if len(noise) == 1 else list(noise),
        "noise_memory": dataset.noise_memory,
        "steps": list(dataset.steps) or None,
        "units": _units(dataset),
        "axes": {"up": dataset.up},
        "columns": {"velocity": dataset.velocity},
        "initial": _initial(dataset),
        "split": split if dataset.train or dataset.test else {},
        "evaluation": asdict(dataset.evaluation),
        "latent": {latent.name: _latent(latent) for latent in dataset.latents},
        "provenance": {key: str(value) for key, value in dataset.provenance.items()
                       if not key.startswith("sha256 of ")},
    }  # fmt: skip
    return _without_none(tables)


def _without_none(table):
    return {
        key: _without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }


def _units(dataset):
    """Numbers in memory are SI, so these are SI units, or px, or nothing."""
    symbols = dataset.units.symbols
    units = {}
    is_told = symbols.get("m") in (*UNCALIBRATED, *OF_THE_SKY, "rad") or dataset.is_of_sight
    if is_told or "m" not in symbols:
        units["length"] = symbols.get("m", "m")
    for kind, base in (("time", "s"), ("mass", "kg")):
        if base not in symbols:
            units[kind] = base
    if "charge" in dataset.units.declared:
        units["charge"] = "C"
    stored = {p for scene in dataset.scenes for e in scene.entities for p in e.properties}
    stored |= {latent.name for latent in dataset.latents}
    for name in sorted(stored - set(PROPERTY_UNITS)):
        units[name] = dataset.property_units[name].text() if name in dataset.property_units else "1"
    inputs = {name: values for scene in dataset.scenes for name, values in scene.inputs.items()}
    for name, values in inputs.items():
        text = dataset.property_units[name].text()
        units |= dict.fromkeys(
            [name] if values.ndim == 2 else [f"{name}_{a}" for a in "xyz"[: values.shape[2]]], text
        )  # fmt: skip
    return units


def _latent(latent):
    table = {"prior": latent.prior, "share": latent.share}
    numbers = ("low", "high", "mean", "sd")
    table |= {k: getattr(latent, k) for k in numbers if math.isfinite(getattr(latent, k))}
    table |= {k: list(getattr(latent, k)) for k in ("entities", "values") if getattr(latent, k)}
    return table
