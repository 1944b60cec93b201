"""From a table and what is declared of it to a data set: the steps, in their order.

1. Columns: what is said of bodies within the table becomes the roster, and what stands in the place
   of places (velocities, angles, latitudes, right ascensions) becomes places x, y and z.
2. Units: those of the headings and those that are declared, as one conversion to SI.
3. Rows: SI numbers in the order of the file, of which copies, slips of the clock and held readings
   are left out, and recordings are told apart.
4. Scenes: rows by times and bodies, with what is declared of them beside.

A step takes a table, or rows, and gives back another one that has a note of what was done.
"""

import math
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from bsp_gp.data.apart import (
    below_each_other,
    may_be_below,
    recordings_apart,
    without_meetings,
)
from bsp_gp.data.assembly import (
    along_named_axis,
    axes_of,
    build_rows,
    build_scenes,
    inputs_of,
    unwrapped,
)
from bsp_gp.data.clock import check_declared_rate, clock_jumps
from bsp_gp.data.conversion import Conversion
from bsp_gp.data.dates import as_declared, with_unix_times
from bsp_gp.data.declaration import select_scenes
from bsp_gp.data.declared_noise import doubts_of_noise, noise_of_all, with_noise_of_bodies
from bsp_gp.data.extent import spans_the_sky
from bsp_gp.data.horizons import without_header
from bsp_gp.data.named_units import (
    half_said,
    units_of,
    with_angles,
    with_counted_angles,
    with_inputs,
    with_their_names,
    without_other_units,
)
from bsp_gp.data.notes import listed
from bsp_gp.data.on_maps import from_maps
from bsp_gp.data.polar import from_polar
from bsp_gp.data.properties import read_properties
from bsp_gp.data.property_columns import roster_within, unread_masses
from bsp_gp.data.rates import from_rates
from bsp_gp.data.roster import OWN_COLUMNS, read_roster
from bsp_gp.data.scene import PROPERTY_UNITS, SIGHT, Dataset
from bsp_gp.data.sight import instead_of_places, with_zeros_apart
from bsp_gp.data.sky import from_sky
from bsp_gp.data.stars import PRIMARY, read_stars, with_named_dates, with_primary
from bsp_gp.data.still import held_still
from bsp_gp.data.table import Table
from bsp_gp.data.twice import by_date, measures_at_once, without_copies, without_held, without_slips
from bsp_gp.data.unread import MOST_TOLD, require_renames, told_unused
from bsp_gp.errors import DataError


def assemble(table, roster, declaration, default_name):
    """Table and roster (a Table, a ready Roster, or None) to a Dataset."""
    if roster is None:
        roster, table = roster_within(below_each_other(table), declaration.units)
    require_renames(declaration, [t for t in (table, roster) if isinstance(t, Table)])
    table, declaration, input_notes, is_star = _with_places(table, declaration)
    tables = [t for t in (table, roster) if isinstance(t, Table)]
    axes_of(table, declaration)  # what is missing is told before its unit is
    conversion, units_notes = _conversion(tables, declaration, is_star)
    is_said = roster is not None and (
        not isinstance(roster, Table) or "dynamic" in roster.frame.columns
    )
    if isinstance(roster, Table):
        shares = [latent.share for latent in declaration.latents]
        roster = read_roster(roster, conversion, coded=shares)
    rows = build_rows(table, declaration, conversion, scene_name=default_name)
    rows = _tidied(rows, roster, conversion, "scene" in table)
    scenes, idle = build_scenes(rows, roster, without_track=(PRIMARY,) if is_star else ())
    scenes = tuple(with_primary(s, roster) for s in scenes) if is_star else scenes
    free = _free_of_the_sky(scenes, declaration, conversion.system)
    scenes, still = (scenes, ()) if is_said or is_star else held_still(scenes, free)
    if conversion.system.is_angle:
        scenes = tuple(map(unwrapped, scenes))
    clock = check_declared_rate(rows, declaration, conversion.time()) if "t" in table else ()
    clock += clock_jumps(rows, scenes, conversion.time())
    scenes = with_noise_of_bodies(scenes, declaration, conversion, rows.entity_names)
    train, test, split_note = split_of(declaration, rows.scene_names)
    latents, latent_units = _latents(declaration, conversion, rows, roster)
    notes = [
        *table.notes, *told_unused(table, inputs_of(table, declaration)), *units_notes,
        *input_notes, *rows.notes, *still, *(roster.notes if roster else ()), *idle, *clock,
        *doubts_of_noise(declaration, rows), *split_note, *_idle_velocities(table, declaration),
    ]  # fmt: skip
    n_dims, memory = scenes[0].n_dims, declaration.noise_memory
    return Dataset(
        name=declaration.name or default_name, scenes=scenes, train=train, test=test,
        units=_with_remedies(conversion.system, unread_masses(table)),
        property_units=latent_units | (roster.units if roster else {})
        | {name: unit for name, (_, unit) in rows.inputs.items()},
        up=_up(declaration, n_dims) or table.up,
        noise=noise_of_all(declaration, conversion, n_dims),
        noise_memory=None if memory is None else memory * conversion.time(),
        logged={name: (heading, unit) for name, (heading, _, unit) in rows.logged.items()},
        velocity=declaration.velocity, latents=latents, evaluation=declaration.evaluation,
        provenance=_provenance(tables, declaration), notes=tuple(notes),
        is_film=declaration.fps is not None or Path(table.file).suffix.lower() == ".trk",
        steps=_steps(table, declaration, conversion, n_dims),
    )  # fmt: skip


def _with_places(table, declaration):
    """The table with places x, y and z, whatever stands for them; its declaration, notes, is_star.

    Notes are of the inputs that laws name; places of stars are those of a companion as seen from
    its star.
    """
    table = without_header(with_unix_times(table, declaration.units), declaration)
    table = instead_of_places(as_declared(table, declaration.units), declaration)
    table, declaration, is_star = read_stars(with_named_dates(table, declaration), declaration)
    declaration = with_their_names(table, declaration)
    table, declaration = with_counted_angles(table, declaration)
    declaration, notes = with_inputs(table, declaration)
    table, declaration = from_rates(from_maps(table, declaration), declaration)
    table = without_other_units(with_zeros_apart(table, declaration), declaration)
    table, declaration = from_polar(table, with_angles(table, declaration))
    table, declaration = from_sky(table, declaration)
    return along_named_axis(table, declaration), declaration, notes, is_star


def _conversion(tables, declaration, is_star):
    """What makes SI of all columns of the table (the first one) and of the roster; notes of it."""
    table, declared = tables[0], declaration.units
    if "angle" in declared and not any("angle" in t for t in tables):
        rest = {kind: unit for kind, unit in declared.items() if kind != "angle"}
        declared = {"length": declared["angle"], **rest}
    units, notes = units_of(tables, declared)
    known = {*OWN_COLUMNS, *declaration.properties}
    known |= {latent.name for latent in declaration.latents}
    for each in tables:
        known |= {*each.columns, *each.units}
        known |= {column[:-2] for column in each.columns if column.endswith("_x")}
    notes += [] if is_star else half_said(table, units)
    conversion = Conversion(
        units, known, declaration.file or table.file, has_fps=declaration.fps is not None,
        may_be_half=not is_star, of_sight=declaration.velocity == SIGHT,
    )  # fmt: skip
    return conversion, notes


def _tidied(rows, roster, conversion, has_scenes):
    """Rows of which each body has one at a time, in scenes of bodies that are seen together."""
    for tidy in (without_copies, by_date, measures_at_once, without_slips, without_held):
        rows = tidy(rows)
    rows = rows if conversion.system.is_angle else may_be_below(rows)
    rows = recordings_apart(rows, roster, has_scenes)
    return without_meetings(rows) if roster is None else rows


def _idle_velocities(table, declaration):
    """A note of velocities that have no say."""
    is_used = declaration.velocity != "ignore" or declaration.first_velocity != "unknown"
    if is_used or not {"vx", "vy", "vz"} & set(table.columns):
        return []
    return ['velocity columns are not used; write [columns] velocity = "measured" if they were '
            "measured and are not differences of positions"]  # fmt: skip


def _steps(table, declaration, conversion, n_dims):
    """Per axis the step of the grid on which places were printed, SI; () without one."""
    steps = table.steps or dict(zip("xyz", declaration.steps, strict=False))
    steps = {axis: float(step * conversion.length(axis)) for axis, step in steps.items()}
    return tuple(steps.get(axis, 0.0) for axis in "xyz"[:n_dims]) if steps else ()


def _provenance(tables, declaration):
    """What is declared of it, how the file calls its columns, and digests of the files."""
    provenance, named = dict(declaration.provenance), tables[0].theirs
    theirs = [k if k == v else f"{k} = {v!r}" for k, v in named.items()]
    if theirs != list(named):
        provenance["columns"] = listed(theirs, MOST_TOLD)
    digests = {f"sha256 of {Path(t.file).name}": t.digest for t in tables if t.digest}
    return provenance | digests


def _free_of_the_sky(scenes, declaration, units):
    """Bodies of the sky whose masses are given."""
    if not spans_the_sky(scenes, units):
        return set()
    said = read_properties(declaration.properties).get("mass", {})
    bodies = [entity for scene in scenes for entity in scene.entities]
    return {body.name for body in bodies if body.name in said or "mass" in body.properties}


def _with_remedies(system, of_masses):
    """The units, and what to say where a mass turns out to be needed."""
    if not of_masses or "mass" in system.declared:
        return system
    return replace(system, remedies=MappingProxyType({"kg": of_masses}))


def split_of(declaration, names):
    """Names of the scenes to train on and of those held out, as declared, and a note."""
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
        numbers = {name: getattr(latent, name) for name in ("low", "high", "mean", "sd")}
        numbers = {name: value * scale for name, value in numbers.items() if math.isfinite(value)}
        values = tuple(value * scale for value in latent.values)
        latents.append(replace(latent, **numbers, values=values, entities=entities))
    return tuple(latents), {k: v for k, v in units.items() if k not in PROPERTY_UNITS}


def _up(declaration, n_dims):
    if declaration.up is not None and declaration.up.strip("-") not in "xyz"[:n_dims]:
        raise DataError(
            f"up is {declaration.up!r}, but the data have the axes {', '.join('xyz'[:n_dims])}",
            file=declaration.file, column="up",
        )  # fmt: skip
    return declaration.up
