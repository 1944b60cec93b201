"""Who is in which scene: ``entities.csv`` to `Entity` records."""

import math
import re
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from bsp_gp.data.scene import PROPERTY_UNITS, SHAPES, Entity

OWN_COLUMNS = ("entity", "scene", "shape", "radius", "width", "height", "dynamic")
ABSURD = 1e150
STATE_NAMES = {"p": "position", "v": "velocity", "s": "shape"}
"""What laws call so; a property of that name could not be told from it."""


@dataclass(frozen=True)
class Roster:
    """Entities by scene and name.

    Attributes
    ----------
    entities : tuple of Entity
        In file order.
    rows : dict of (scene name or None, entity name) to int
        None stands for every scene; a row that names its scene wins over one that does not.
    units : dict of str to Unit
        Of the properties.
    """

    entities: tuple[Entity, ...] = ()
    rows: dict = field(default_factory=dict)
    units: dict = field(default_factory=dict)
    file: str | None = None
    notes: tuple[str, ...] = ()

    def row(self, scene, name):
        """Index into `entities`, or None if the file does not have the entity there."""
        found = self.rows.get((scene, name))
        return self.rows.get((None, name)) if found is None else found


def read_roster(table, conversion, *, coded=()):
    """Make the roster from the table of ``entities.csv``.

    That is read with ``as_text=True``; text columns in `coded` (``share = COLUMN``) are kept as
    numbers 0, 1, … in order of appearance.
    """
    table.require(["entity"])
    reader = _RosterReader(table, conversion)
    names, scenes = reader.names("entity"), reader.names("scene", is_blank_allowed=True)
    rows = {}
    for k, key in enumerate(zip(scenes, names, strict=True)):
        if key in rows:
            reader.fail(f"entity {key[1]!r} is listed twice for the same scene", k, "entity")
        rows[key] = k
    is_dynamic = reader.dynamic()
    sizes = {c: reader.sizes(c) for c in ("radius", "width", "height")}
    shapes = reader.shapes(sizes)
    is_free = np.array([not shape.startswith("rect") for shape in shapes], dtype=bool)
    is_dynamic = np.where(np.isnan(is_dynamic), is_free, is_dynamic == 1)
    properties, units = reader.properties(coded)
    mass = properties.get("mass", np.full(len(names), math.nan))
    bad = is_dynamic & (mass <= 0)
    if bad.any():
        k = int(bad.argmax())
        reader.fail(
            f"mass of the dynamic entity {names[k]!r} must be positive, got {mass[k]:g}",
            k, "mass", "leave the cell empty if the mass is unknown, or set dynamic to 0",
        )  # fmt: skip
    lists = {
        name: list(map(tuple, value.tolist())) if value.ndim == 2 else value.tolist()
        for name, value in properties.items()
    }
    entities = tuple(
        Entity(
            names[k],
            shapes[k],
            *(float(sizes[c][k]) for c in ("radius", "width", "height")),
            is_static=not is_dynamic[k],
            properties={name: values[k] for name, values in lists.items()},
        )
        for k in range(len(names))
    )
    return Roster(entities, rows, units, table.file, (*table.notes, *reader.notes))


class _RosterReader:
    def __init__(self, table, conversion):
        self.frame = table.frame
        self.table = table
        self.conversion = conversion
        self.notes = []

    def fail(self, problem, k, column, remedy=None):
        self.table.fail(problem, column, remedy, row=k)

    def names(self, column, is_blank_allowed=False):
        if column not in self.frame:
            return [None] * len(self.frame)
        names = [None if pd.isna(v) else str(v).strip() or None for v in self.frame[column]]
        if not is_blank_allowed and None in names:
            self.fail("empty cell", names.index(None), column, "every row needs a name")
        return names

    def numbers(self, column):
        """The column as floats and a mask of the cells that are no numbers."""
        cells = self.frame[column]
        if not pd.api.types.is_numeric_dtype(cells):
            cells = cells.astype("string").str.strip().replace("", pd.NA)
            if self.table.decimal == ",":
                cells = cells.str.replace(",", ".", regex=False)
            exact = [_float(cell) for cell in cells]
            values = np.array([math.nan if v is None else v for v in exact], dtype=float)
            is_text = np.array([v is None for v in exact], dtype=bool)
        else:
            values = cells.to_numpy(dtype=float, na_value=math.nan)
            is_text = np.zeros(len(values), dtype=bool)
        bad = np.isinf(values) | (np.abs(values) > ABSURD)
        if bad.any():
            k = int(bad.argmax())
            self.fail(f"{values[k]:g} is not a usable number", k, column, "finite numbers only")
        return values, is_text

    def strict_numbers(self, column):
        values, is_text = self.numbers(column)
        if is_text.any():
            k = int(is_text.argmax())
            self.fail(
                f"expected a number, got {self.frame[column].iloc[k]!r:.40}", k, column,
                "leave the cell empty if it is unknown",
            )  # fmt: skip
        return values

    def dynamic(self):
        if "dynamic" not in self.frame:
            return np.full(len(self.frame), math.nan)
        values, is_text = self.numbers("dynamic")
        bad = is_text | ~(np.isnan(values) | (values == 0) | (values == 1))
        if bad.any():
            k = int(bad.argmax())
            got = self.frame["dynamic"].iloc[k]
            self.fail(f"dynamic must be 1 or 0, got {got!r:.40}", k, "dynamic")
        return values

    def sizes(self, column):
        if column not in self.frame:
            return np.full(len(self.frame), math.nan)
        values = self.strict_numbers(column) * self.conversion.length(column)
        if (values < 0).any():
            k = int((values < 0).argmax())
            self.fail(f"{column} must not be negative, got {values[k]:g}", k, column)
        return values

    def shapes(self, sizes):
        given = self.names("shape", is_blank_allowed=True)
        shapes = []
        for k, shape in enumerate(given):
            default = "point" if math.isnan(sizes["radius"][k]) else "disc"
            shape = shape or default
            if shape not in SHAPES:
                allowed = ", ".join(SHAPES)
                self.fail(f"shape must be one of {allowed}, got {shape!r:.40}", k, "shape")
            if shape.startswith("rect"):
                for side in ("width", "height"):
                    if math.isnan(sizes[side][k]):
                        self.fail(f"a {shape} needs a {side}", k, side)
            shapes.append(shape)
        return shapes

    def properties(self, coded):
        """Named arrays (n,) or (n, d) in SI, and their units."""
        further = [c for c in self.frame.columns if c not in OWN_COLUMNS]
        stems = vector_stems(further)
        components = {column for columns in stems.values() for column in columns}
        values, units = {}, {}
        for name in [c for c in further if c not in components] + list(stems):
            columns = stems.get(name, (name,))
            if not re.fullmatch(r"[A-Za-z_]\w*", name):
                self.notes.append(f"column {name!r} is not used: its name is no identifier")
                continue
            if name in STATE_NAMES:
                self.notes.append(
                    f"column {', '.join(map(repr, columns))} is not used: in laws {name}_i is "
                    f"the {STATE_NAMES[name]}; give the column another name"
                )
                continue
            arrays = [self.property_column(column, name, coded) for column in columns]
            if any(array is None for array in arrays):
                continue
            scale, unit, note = self.conversion.property(name, columns if name in stems else ())
            if note:
                self.notes.append(note)
            values[name] = scale * (np.stack(arrays, axis=1) if name in stems else arrays[0])
            units[name] = unit
        return values, units

    def property_column(self, column, name, coded):
        is_declared = {column, name} & (set(PROPERTY_UNITS) | set(self.conversion.declared))
        if is_declared:
            return self.strict_numbers(column)
        values, is_text = self.numbers(column)
        if not is_text.any():
            return values
        if column in coded:
            codes, labels = pd.factorize(self.frame[column])
            pairs = ", ".join(f"{k} = {label}" for k, label in enumerate(labels))
            self.notes.append(f"text column {column!r} is coded as numbers: {pairs}")
            return np.where(codes < 0, math.nan, codes.astype(float))
        if not np.isnan(values).all():
            return self.strict_numbers(column)
        self.notes.append(f"text column {column!r} of the entities is not used")
        return None


def _float(cell):
    """The number in a cell, nan for a blank one, None for a text."""
    if pd.isna(cell):
        return math.nan
    try:
        return float(cell)
    except ValueError:
        return None


def vector_stems(columns):
    """Stem -> component columns for every ``_x, _y[, _z]`` set."""
    stems = {}
    for column in columns:
        if column.endswith("_x") and column[:-2] and column[:-2] + "_y" in columns:
            axes = "xyz" if column[:-2] + "_z" in columns else "xy"
            stems[column[:-2]] = tuple(f"{column[:-2]}_{axis}" for axis in axes)
    return stems
