"""Tables of dates, velocities and errors as observers keep them, with and without names."""

import re

import numpy as np
import pytest

from bsp_gp import load_dataset
from bsp_gp.errors import DataError
from tests.text_tables import rows, written

NIGHTS = np.array([0.3, 2.1, 2.4, 7.9, 8.2, 21.5, 22.7, 40.4, 41.1, 60.8, 75.2, 90.6])
SPEEDS = np.round(30 * np.cos(NIGHTS), 2)
ERRORS = np.round(1.2 + 0.1 * np.sin(NIGHTS), 2)
KEYS = ["# telescope = MADE UP", "# url = http://example.org/a?b&c"]


def by_numbers(text):
    """What is proposed in each ``columns={...}`` of a complaint."""
    return [dict(re.findall(r'"(\w+)": "(\d+)"', own))
            for own in re.findall(r"columns=({[^}]*})", text)]  # fmt: skip


@pytest.mark.parametrize("zero", [2450000, 50000, 1400])
@pytest.mark.parametrize("above", [[], KEYS, ["! made up", "// by nobody, at all"]])
def test_dates_velocities_and_errors_without_names_are_asked_for_as_such(tmp_path, zero, above):
    path = written(tmp_path, [*above, *rows(zero + NIGHTS, SPEEDS, ERRORS, mark="  ")], "a.vels")
    with pytest.raises(DataError, match="by its number") as caught:
        load_dataset(path)
    first, *more = by_numbers(str(caught.value))
    assert first == {"t": "1", "rv": "2", "srv": "3"}
    data = load_dataset(path, columns=first)
    assert data.is_of_sight
    assert data.scenes[0].sigma[:, 0, 0] == pytest.approx(ERRORS)
    for each in more:
        assert len(load_dataset(path, columns=each).scenes[0].times) == 12


def test_a_clock_beside_small_positive_places_stays_one(tmp_path):
    lines = rows(np.arange(12) / 10, SPEEDS, ERRORS, mark=" ")
    data = load_dataset(written(tmp_path, ["# key = value", "# other = thing", *lines], "a.txt"))
    assert data.scenes[0].positions[:, 0, 1] == pytest.approx(ERRORS)


def test_errors_that_are_proposed_are_never_negative(tmp_path):
    lines = rows(2003.4 + NIGHTS / 9, SPEEDS, -SPEEDS, ERRORS, ERRORS, mark="\t")
    with pytest.raises(DataError) as caught:
        load_dataset(path := written(tmp_path, lines, "a.txt"))
    (named,) = by_numbers(str(caught.value))
    data = load_dataset(path, columns=named, units={"t": "yr"})
    assert data.scenes[0].sigma[:, 0] == pytest.approx(np.stack([ERRORS, ERRORS], axis=1))


def test_commas_of_a_comment_part_no_rows_and_its_words_name_no_other_columns(tmp_path):
    lines = rows(2450000 + NIGHTS, SPEEDS, ERRORS, mark=" ")
    path = written(tmp_path, ["# data from Nobody et al., A&A 1, 2 (2011)", *lines], "a.rv")
    with pytest.raises(DataError, match="rows have 3 columns") as caught:
        load_dataset(path)
    assert load_dataset(path, columns=by_numbers(str(caught.value))[0]).is_of_sight
    lines = rows(NIGHTS, SPEEDS, ERRORS, mark=" \t")
    path = written(tmp_path, ["#JD -2,450,000 \tV (m/s) sigma(m/s)", *lines], "b.txt")
    data = load_dataset(path)
    assert data.is_of_sight and data.scenes[0].sigma[:, 0, 0] == pytest.approx(ERRORS)
    assert np.ptp(data.scenes[0].times) == pytest.approx(86400 * np.ptp(NIGHTS))
    path = written(tmp_path, ["JD - 2,450,000,RV (m/s),sigma", *rows(NIGHTS, SPEEDS, ERRORS)])
    assert load_dataset(path).is_of_sight


@pytest.mark.parametrize("title", [[], ["Made up (Nobody et al. 2023)"]])
@pytest.mark.parametrize("date", ["jdb", "rjd", "BJD-2450000"])
def test_names_above_a_rule_are_the_header_whatever_stands_above(tmp_path, title, date):
    head = [*title, f"{date}\tvrad\tsvrad\trv_drift\tother", "---\t----\t-----\t--\t--"]
    lines = rows(55000 + NIGHTS, 12 + SPEEDS / 1000, ERRORS / 1000, NIGHTS % 1, NIGHTS % 3,
                 mark="\t")  # fmt: skip
    data = load_dataset(written(tmp_path, [*head, *lines], "a.rdb"))
    assert data.is_of_sight and data.units.declared["length"] == "km/s"
    assert data.scenes[0].sigma[:, 0, 0] == pytest.approx(ERRORS / 1000)
    assert any("'vrad' is read as velocities" in note for note in data.notes)


def test_units_between_names_and_a_rule_are_no_names(tmp_path):
    lines = rows(2450000 + NIGHTS, SPEEDS, ERRORS, mark="\t")
    head = ["BJD\tRV\te_RV", "d\tm/s\tm/s", "-------\t---------\t------"]
    data = load_dataset(written(tmp_path, [*head, *lines], "a.txt"))
    assert data.is_of_sight and data.units.declared["length"] == "m/s"


def test_what_a_spectrograph_drifts_by_is_no_velocity_of_a_star(tmp_path):
    lines = rows(55000 + NIGHTS, NIGHTS % 1, 26 + SPEEDS / 1000, ERRORS / 1000, NIGHTS)
    data = load_dataset(written(tmp_path, ["bjd,biss,vrad0,ccfnoise,rv_drift", *lines]))
    assert any("'vrad0' is read as velocities" in note for note in data.notes)
    assert data.scenes[0].sigma[:, 0, 0] == pytest.approx(ERRORS / 1000)


def test_columns_of_texts_are_not_proposed_as_numbers(tmp_path):
    ids = [f"ID{k}" for k in range(40)]
    lines = rows(range(1, 41), ids, range(900, 860, -1), np.sin(np.arange(40) / 9).round(3),
                 [0] * 40, range(40))  # fmt: skip
    with pytest.raises(DataError) as caught:
        load_dataset(path := written(tmp_path, lines))
    named = by_numbers(str(caught.value))[0]
    assert named == {"t": "1", "x": "4"} and load_dataset(path, columns=named)


def test_a_comment_of_some_names_proposes_the_clock_of_the_rows(tmp_path):
    time = np.arange(40) / 100
    lines = rows(time, np.cos(time).round(4), *[np.sin(9 * time).round(4)] * 3, mark="\t")
    with pytest.raises(DataError, match="rows have 5 columns") as caught:
        load_dataset(path := written(tmp_path, ["# Columns: t y", "#", *lines], "a.txt"))
    named = by_numbers(str(caught.value))[0]
    assert named["t"] == "1" and len(load_dataset(path, columns=named).scenes[0].times) == 40


def test_dates_in_several_columns_are_not_proposed_as_times(tmp_path):
    lines = rows([2018] * 6, [6, 6, 7, 7, 7, 8], [23, 28, 1, 17, 18, 2], range(6), SPEEDS[:6],
                 mark=" ")  # fmt: skip
    with pytest.raises(DataError, match="several columns into one, dates as"):
        load_dataset(written(tmp_path, lines, "a.txt"))


def test_readings_of_an_accelerometer_that_were_written_again_are_left_out(tmp_path):
    time = 10 * np.arange(300)
    shown = [np.sin(time / 90).round(3), np.cos(time / 70).round(3), 9.8 + np.sin(time / 50)]
    lines = rows(time, *shown)
    lines[100:100] = [lines[99]] * 20
    data = load_dataset(written(tmp_path, lines, "Accelerometer.csv"))
    assert data.velocity == "unseen" and data.scenes[0].n_dims == 3
    assert any("left out: 20, in line 101" in note for note in data.notes)
    named = {"t": "1", "ax": "2", "ay": "3", "az": "4"}
    assert len(load_dataset(written(tmp_path, lines, "b.csv"), columns=named).scenes) == 1
