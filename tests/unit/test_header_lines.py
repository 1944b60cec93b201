"""Headings and rows as people and programs set them: brackets, rules, padded titles."""

import numpy as np
import pytest

from bsp_gp import load_dataset
from bsp_gp.data.header_lines import names_in, ruled_names
from bsp_gp.errors import DataError
from tests.text_tables import written

T = np.arange(20) / 10
PLACE = np.round(np.cos(3 * T), 4)


def places(data):
    (scene,) = data.scenes
    return scene.times, scene.positions[:, 0, 0]


@pytest.mark.parametrize(
    "start, end, last", [("[", ";", "]"), ("a = [", ";", "];"), ("[", "", "]")]
)
def test_brackets_of_a_matrix_are_no_cells(tmp_path, start, end, last):
    rows = [f"   {k}   {t:.3f}   {x}{end}" for k, (t, x) in enumerate(zip(T, PLACE, strict=True))]
    rows[0] = f"{start} {rows[0]}"
    rows[-1] = f"{rows[-1].rstrip(';')}{last}"
    data = load_dataset(written(tmp_path, [" Sample   Time   Pos", "", *rows]))
    for found, true in zip(places(data), (T, PLACE), strict=True):
        np.testing.assert_allclose(found, true, atol=1e-12)
    assert any("brackets around the rows are left out, from line 3" in n for n in data.notes)


def test_every_row_in_brackets_as_numpy_prints_it(tmp_path):
    rows = [f" [{t:.3f} {x}]" for t, x in zip(T, PLACE, strict=True)]
    rows[0], rows[-1] = f"[{rows[0].strip()}", f"{rows[-1]}]"
    np.testing.assert_allclose(places(load_dataset(written(tmp_path, rows)))[1], PLACE)


def test_a_sign_of_a_comment_may_be_a_name(tmp_path):
    rows = [f"{k}\t{t}\t{x}" for k, (t, x) in enumerate(zip(T, PLACE, strict=True))]
    data = load_dataset(written(tmp_path, ["#\ttime(s)\tx", *rows]))
    np.testing.assert_allclose(places(data)[1], PLACE)
    assert "not used: #" in " ".join(data.notes)
    comment = load_dataset(written(tmp_path, ["# t x", *(row[row.index("\t") :] for row in rows)]))
    np.testing.assert_allclose(places(comment)[1], PLACE)


@pytest.mark.parametrize(
    "header, row, names",
    [
        (
            "Sample   Commanded Pos   Encoder 2 Pos",
            "1 2 3",
            ("Sample", "Commanded Pos", "Encoder 2 Pos"),
        ),
        ("Way (yds) height (ins) height", "1 2 3", ("Way (yds)", "height (ins)", "height")),
        ("time, height. Begins at ( 0,0 ) here", "0,1", ("time", "height. Begins at ( 0,0 ) here")),
        ("t x y", "1 2 3", ("t", "x", "y")),
        ("% t x", "1 2", ("t", "x")),
        ("the ball rolls", "1 2", ("the", "ball", "rolls")),
    ],
)
def test_names_are_as_many_as_columns_where_they_can_be(header, row, names):
    assert names_in([header, "", row], 0, "," if "," in row else None) == names


def test_names_of_several_words_are_named_by_the_caller(tmp_path):
    rows = [f"  {t:6.3f}      7        {x}" for t, x in zip(T, PLACE, strict=True)]
    path = written(tmp_path, ["  Time   Commanded Pos   Encoder 2 Pos", *rows])
    np.testing.assert_allclose(places(load_dataset(path, columns={"x": "Encoder 2 Pos"}))[1], PLACE)
    with pytest.raises(DataError, match="present are Time, Commanded Pos, Encoder 2 Pos"):
        load_dataset(path)


CATALOGUE = [
    "#--- Details", "------ ------- -", "               I", "               n", "       x       s",
    "t (d)  (au)    t", "------ ------- -",
]  # fmt: skip


def test_names_stand_above_a_rule(tmp_path):
    rows = [f"{t:6.2f} {x:7.4f} 1" for t, x in zip(T, PLACE, strict=True)]
    assert ruled_names([*CATALOGUE, *rows]) == (6, ("t (d)", "x (au)", "Inst"))
    data = load_dataset(written(tmp_path, [*CATALOGUE, *rows]))
    np.testing.assert_allclose(places(data)[0], 86400 * T)
    assert ruled_names(["words of any kind", "--- ---", "1 2"]) is None
    data = load_dataset(written(tmp_path, ["t x", "--- ---", *(row[:14] for row in rows)]))
    np.testing.assert_allclose(places(data)[1], PLACE)


TITLES = ["Observations,,,,,", "Source: a book,,,,,", '"put in, by hand",,,,,1582.9', ",,,,,"]


def test_padded_titles_are_no_header(tmp_path):
    rows = [f"a,{t},{x},,b,c" for t, x in zip(T, PLACE, strict=True)]
    path = written(tmp_path, [*TITLES, "Mark,Days since,Declination,Note,B,C", *rows])
    for columns in ({"t": "Days since", "x": "Declination"}, {"t": "2", "x": "3"}):
        np.testing.assert_allclose(places(load_dataset(path, columns=columns))[1], PLACE)
    with pytest.raises(DataError, match="present are Mark, Days since, Declination, Note"):
        load_dataset(path)


def test_a_remedy_for_rows_that_have_not_as_many_cells_as_the_header_works(tmp_path):
    rows = [f"{t},{x}" for t, x in zip(T, PLACE, strict=True)]
    path = written(tmp_path, ["t,x, which is right", *rows])
    with pytest.raises(DataError, match="by its number: columns="):
        load_dataset(path)
    np.testing.assert_allclose(places(load_dataset(path, columns={"t": "1", "x": "2"}))[1], PLACE)
