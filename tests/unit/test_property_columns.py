"""Headings of masses and of horizontal distances as pupils and programs write them."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.headings import headings, property_of_words
from bsp_gp.data.tables import dataset_from_frames
from bsp_gp.errors import DataError, LawError
from bsp_gp.language.parse import parse_formula


def throws(**columns):
    n = 12
    t = np.tile(np.arange(6) * 0.1, 2)
    rows = {"Versuch": np.repeat([1, 2], 6), "Zeit in s": t, "Weite in m": 3 * t,
            "Höhe in m": t - t**2, **columns}  # fmt: skip
    return pd.DataFrame(rows, index=range(n))


@pytest.mark.parametrize(
    "heading",
    ["Masse in g", "Masse (g)", "mass in g", "m / g", "masse (g)", "masa (g)",
     "Masse der Kugel in g", "total mass (g)", "Gewicht in g", "poids (g)"],
)  # fmt: skip
def test_a_mass_with_its_unit_is_the_mass_of_the_body(heading):
    dataset = dataset_from_frames(throws(**{heading: [50.0] * 6 + [80.0] * 6}))
    assert [s.entities[0].mass for s in dataset.scenes] == pytest.approx([0.05, 0.08])
    assert dataset.units.declared["mass"] == "g"
    is_told = any(repr(heading) in note and "ignore" in note for note in dataset.notes)
    assert is_told == (not heading.lower().startswith("mass "))


@pytest.mark.parametrize(
    ("heading", "unit"), [("Gewicht", "N"), ("Masse", "m"), ("m", "m"), ("Massenzahl", "g")]
)
def test_what_has_another_unit_is_no_mass(heading, unit):
    assert property_of_words(heading, unit) == ""


def test_a_mass_that_changes_is_none():
    dataset = dataset_from_frames(throws(**{"Masse in g": np.arange(12.0)}))
    assert dataset.property_names == ()
    assert any("not used: Masse in g" in note for note in dataset.notes)


def test_who_needs_a_mass_is_told_of_the_column_that_may_be_it():
    dataset = dataset_from_frames(throws(Masse=[50.0] * 12))
    assert dataset.property_names == ()
    with pytest.raises(LawError, match=r"'Masse', which is not used, looks like one.*columns="):
        parse_formula("2 [kg/m] * v_i", {}, units=dataset.units)
    known = dataset_from_frames(
        throws(Masse=[50.0] * 12), columns={"mass": "Masse"}, units={"mass": "g"}
    )
    assert known.scenes[0].entities[0].mass == pytest.approx(0.05)
    assert not known.units.remedies


def test_a_column_is_left_out_where_the_note_says_how():
    rows = throws(**{"Masse in g": [50.0] * 12})
    assert dataset_from_frames(rows, columns={"Masse in g": "ignore"}).property_names == ()


@pytest.mark.parametrize(
    ("across", "upwards"),
    [("Weite (m)", "Höhe (m)"), ("Wurfweite in m", "Fallhöhe in m"),
     ("Horizontal distance (m)", "Height (m)"), ("distance horizontale (m)", "hauteur (m)"),
     ("distancia horizontal (m)", "altura (m)"), ("Entfernung (m)", "vertikale Position (m)"),
     ("Strecke (m)", "Höhe (m)"), ("x-Richtung (m)", "y-Richtung (m)")],
)  # fmt: skip
def test_distances_across_and_heights(across, upwards):
    assert [h.name for h in headings(["t (s)", across, upwards])] == ["t", "x", "y"]


def test_two_words_for_the_same_are_not_guessed():
    with pytest.raises(DataError):
        dataset_from_frames(throws(**{"Entfernung in m": np.arange(12.0)}))
