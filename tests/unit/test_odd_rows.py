"""Rows of tables that are no rows of a recording, and recordings without headings or clocks."""

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.units import Unit

T = np.arange(12)
PLAIN = "".join(f"{0.1 * k:g},{k * k},{2 * k}\n" for k in T)
UNITS = {"length": "m", "time": "s"}


def loaded(tmp_path, text, **said):
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    return load_dataset(path, units=said.pop("units", UNITS), **said)


def test_rows_that_were_taken_out_by_a_mark_are_told(tmp_path):
    lines = ("t,x,y\n" + PLAIN).splitlines()
    lines[6] = "# " + lines[6] + ",a bad one, as it seems"
    found = loaded(tmp_path, "\n".join(lines))
    assert len(found.scenes[0].times) == 11
    assert any("begin with #: " in note or "no rows: 1, the first is 7" in note
               for note in found.notes)  # fmt: skip


def test_a_line_behind_a_comment_is_told_by_its_own_number(tmp_path):
    lines = ("t,x,y\n" + PLAIN).splitlines()
    lines[4], lines[8] = "# nothing", "0.7,abc,1"
    with pytest.raises(Exception, match="line 9"):
        loaded(tmp_path, "\n".join(lines))


def test_titles_above_rows_without_headings_are_passed_over(tmp_path):
    found = loaded(tmp_path, "Beats\n39.2\n" + PLAIN, columns={"t": "1", "x": "2", "y": "3"})
    np.testing.assert_allclose(found.scenes[0].times, 0.1 * T)
    np.testing.assert_allclose(found.scenes[0].positions[:, 0], np.stack([T * T, 2 * T], axis=1))


def test_rows_below_a_table_that_have_no_time_are_left_out(tmp_path):
    found = loaded(tmp_path, "t,x,y\n" + PLAIN + "NA,46.0,11.0\n,22.1,7.2\n")
    assert len(found.scenes[0].times) == 12
    assert any("2 row(s) without a time" in note for note in found.notes)


def test_a_time_that_is_missing_within_a_table_is_a_fault(tmp_path):
    lines = ("t,x,y\n" + PLAIN).splitlines()
    lines[5] = ",16,8"
    with pytest.raises(Exception, match="line 6"):
        loaded(tmp_path, "\n".join(lines))


def test_a_lone_column_of_speeds_is_timed_by_its_frames(tmp_path):
    text = "".join(f"{10 - 0.1 * k:g}\n" for k in range(20))
    found = loaded(tmp_path, text, columns={"vx": "1"}, fps=2, units={"velocity": "m/s"})
    assert found.velocity == "only"
    steps = np.diff(found.scenes[0].positions[:, 0, 0])
    np.testing.assert_allclose(steps, 0.5 * (10 - 0.1 * np.arange(20)), rtol=1e-6)


def test_steps_that_grow_as_a_wheel_slows_down_are_no_gaps(tmp_path):
    times = np.cumsum(0.07 * np.exp(np.arange(200) / 80))
    speeds = 5 * np.exp(-np.arange(200) / 80)
    rows = "".join(f"{t:.6f},{v:.6f}\n" for t, v in zip(times, speeds, strict=True))
    found = loaded(tmp_path, "t (s),vx (m/s)\n" + rows, units={})
    assert sum(len(scene.times) for scene in found.scenes) == 201
    cut = np.delete(times, np.s_[100:140])
    rows = "".join(f"{t:.6f},1.0\n" for t in cut)
    assert len(loaded(tmp_path, "t (s),vx (m/s)\n" + rows, units={}).scenes) == 2


def test_bodies_along_one_axis_may_read_the_same(tmp_path):
    """Each from the zero of a sensor of its own."""
    rows = "".join(f"{0.1 * k:g},{k},{10 - k}\n" for k in T)
    found = loaded(tmp_path, "t,red_x,blue_x\n" + rows)
    assert len(found.scenes[0].entities) == 2


def test_places_in_au_beside_seconds_are_in_arbitrary_units(tmp_path):
    found = loaded(tmp_path, "t (s),x (au),y (au)\n" + PLAIN, units={})
    assert any("arbitrary" in note for note in found.notes)
    assert not found.units.is_calibrated(Unit.of(m=1))
    days = loaded(tmp_path, "t (d),x (au),y (au)\n" + PLAIN, units={})
    assert days.units.is_calibrated(Unit.of(m=1))
