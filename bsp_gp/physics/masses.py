"""Masses and other properties that a law needs, known or not."""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import DataError, LawError, in_python
from bsp_gp.language.render import to_text
from bsp_gp.physics.evaluation import unknown_receivers
from bsp_gp.units import KILOGRAM

NO_MASS = "no mass is known: constants are per unit mass of the body that moves"
"""Note on a data set without any mass."""
ONE_KILOGRAM = "no mass is given: every body is taken as 1 kg"
"""How such a note begins where the data say what a unit of mass is."""


def has_masses(dataset):
    """Whether any body that moves has a mass."""
    return any(np.isfinite(e.mass) for s in dataset.scenes for e in s.entities if not e.is_static)


def are_units(dataset):
    """Whether every body that moves has a mass of one: constants are per unit mass."""
    return all(e.mass == 1.0 for s in dataset.scenes for e in s.entities if not e.is_static)


def is_of_no_mass(note):
    """Whether a note says that no mass is known."""
    return note == NO_MASS or note.startswith(ONE_KILOGRAM)


def are_assumed(dataset):
    """Whether nobody gave masses, and those of a data set stand for them."""
    return any(map(is_of_no_mass, dataset.notes))


def without_masses(dataset):
    """The note on a data set without any mass."""
    if not dataset.units.is_calibrated(KILOGRAM):
        return NO_MASS
    return in_python(
        f"{ONE_KILOGRAM}, and constants with kg or N in their units are those of such a body; "
        "give the mass with --property mass=0.3[kg]"
    )


def with_usable_masses(dataset, counts=True):
    """Where no dynamic entity has a mass, every mass is one: constants are per unit mass.

    It is the same object where a mass is known; else it has a note.

    Parameters
    ----------
    counts : bool
        Whether the mass makes a difference, as far as the law is known.

    Raises
    ------
    DataError
        If nothing is dynamic.
    """
    dynamic = [e for s in dataset.scenes for e in s.entities if not e.is_static]
    if not dynamic:
        raise DataError(
            "no entity is dynamic: there is no motion to explain",
            remedy="set dynamic to 1 for the bodies that move",
        )
    if has_masses(dataset):
        return dataset
    scenes = tuple(with_unit_masses(scene) for scene in dataset.scenes)
    note = without_masses(dataset) if counts else NO_MASS
    return replace(dataset, scenes=scenes, notes=(*dataset.notes, note))


def with_unit_masses(scene):
    """The scene with a mass of one where none of its dynamic entities has any."""
    if any(np.isfinite(e.mass) for e in scene.entities if not e.is_static):
        return scene
    return replace(scene, entities=tuple(_unit_mass(e) for e in scene.entities))


def _unit_mass(entity):
    if entity.is_static or np.isfinite(entity.mass):
        return entity
    return replace(entity, properties={**entity.properties, "mass": 1.0})


def check_properties(batches, law):
    """A pooled term must be able to act on every body that moves.

    Raises
    ------
    LawError
        If a term needs a property that is unknown.
    """
    for batch in batches:
        mass = batch.bodies.column("mass")[:, batch.bodies.receivers]
        for term in law.terms:
            lost = unknown_receivers(term, batch.bodies) | (term.needs_mass & np.isnan(mass))
            if lost.any():
                s, r = np.argwhere(lost)[0]
                raise LawError(
                    f"declared law {to_text(term.formula)} needs a property of "
                    f"{batch.bodies.receiver_names[s][r]!r} that is unknown; give it in "
                    "entities.csv, or leave the body out"
                )
