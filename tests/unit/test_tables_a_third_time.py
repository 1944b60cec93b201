"""Layouts of files that strangers have published: excerpts of what they have in common, once more.

The first two are in ``test_tables_of_strangers.py`` and ``test_tables_once_more.py``.
"""

import numpy as np

from bsp_gp import load_dataset
from tests.text_tables import rows, written

NIGHTS = np.round(2450000 + np.cumsum(1 + 9 * np.random.default_rng(1).random(12)), 3)
SPEEDS = np.round(30 * np.cos(NIGHTS / 9), 2)


def test_plain_names_below_comments_are_the_header_though_rows_hold_words(tmp_path):
    comments = ["# Retrieved from https://made.up/data", "# L = Lick", "# JD-0 RV sigma Telescope"]
    own = rows(NIGHTS, SPEEDS, [1.5] * 12, ["L", "K"] * 6, mark=" ")
    data = load_dataset(written(tmp_path, [*comments, "JD   RV   e_RV Observatory", *own]))
    assert data.is_of_sight
    assert [scene.name for scene in data.scenes] == ["L", "K"]  # each has a zero of its own
    assert not any("decimal years" in note for note in data.notes)


def test_julian_dates_with_numbers_of_years_are_told(tmp_path):
    years = np.round(1998.9 + (NIGHTS - NIGHTS[0]) / 9, 5)
    path = written(tmp_path, ["JD,RV,e_RV", *rows(years, SPEEDS, [1.5] * 12)])
    (told,) = [note for note in load_dataset(path).notes if "decimal years" in note]
    assert told.startswith("check:") and 'units={"t": "yr"}' in told
    assert not any("decimal years" in n for n in load_dataset(path, units={"t": "yr"}).notes)


def test_markers_that_qualisys_lost_are_gaps_and_not_at_the_origin(tmp_path):
    head = ["NO_OF_FRAMES\t9", "NO_OF_MARKERS\t2", "FREQUENCY\t10", "MARKER_NAMES\tone\ttwo"]
    body = [f"{190 + k}.5\t457.9\t0.000\t" + ("0.000\t0.000\t0.000" if k < 3 else f"{k}.1\t5\t4")
            for k in range(9)]  # fmt: skip
    data = load_dataset(written(tmp_path, [*head, *body], "q.tsv"))
    places = data.scenes[0].positions
    assert np.isnan(places[:3, 1]).all() and not np.isnan(places[3:, 1]).any()
    assert not np.isnan(places[:, 0]).any()
    assert any("gaps: two (3)" in note for note in data.notes)
