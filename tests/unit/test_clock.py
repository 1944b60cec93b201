"""Clocks that cannot be right: a declared rate beside other times."""

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError


def table(tmp_path, times):
    rows = "".join(f"{t!r},{k},{k * k}\n" for k, t in enumerate(times))
    (tmp_path / "trajectories.csv").write_text(f"t,x,y\n{rows}", encoding="utf-8")
    return tmp_path


def every(step, n=20):
    return [round(k * step, 9) for k in range(n)]


@pytest.mark.parametrize(
    ("declared", "times"),
    [
        ("fps = 30", every(0.1 / 3)),
        ("fps = 30", [round(k / 30, 2) for k in range(40)]),  # digits rounded
        ("fps = 29.97", every(1 / 30)),
        ("dt = 0.02", [0.0, 0.02, 0.04, 0.1, 0.12, 0.14, 0.3]),  # frames missing
    ],
)
def test_a_rate_that_agrees_with_the_times_is_no_news(tmp_path, declared, times):
    (tmp_path / "dataset.toml").write_text(f"{declared}\n", encoding="utf-8")
    assert load_dataset(table(tmp_path, times)).notes == ()


@pytest.mark.parametrize(
    ("declared", "times"),
    [
        ("fps = 30", every(0.1 / 4 * 1.05)),
        ("fps = 30", every(1 / 240)),
        ("dt = 0.04", every(0.02)),
        ("dt = 0.03", every(0.02)),
        ("fps = 30", every(33.4)),  # milliseconds, and nothing says so
    ],
)
def test_a_rate_that_contradicts_the_times_is_refused(tmp_path, declared, times):
    (tmp_path / "dataset.toml").write_text(f"{declared}\n", encoding="utf-8")
    with pytest.raises(DataError, match=rf"column t: .* contradicts {declared} .*leave out"):
        load_dataset(table(tmp_path, times))


def test_a_rate_given_as_an_argument_is_compared_as_well(tmp_path):
    path = table(tmp_path, every(0.02)) / "trajectories.csv"
    assert load_dataset(path, fps=50).notes == ()
    with pytest.raises(DataError, match="contradicts fps = 240"):
        load_dataset(path, fps=240, units={"length": "m", "time": "s"})


def test_times_in_another_unit_are_compared_in_seconds(tmp_path):
    path = table(tmp_path, every(20.0)) / "trajectories.csv"
    units = {"length": "m", "time": "ms"}
    assert load_dataset(path, fps=50, units=units).notes == ()
    assert load_dataset(path, dt=20, units=units).notes == ()
    with pytest.raises(DataError, match=r"are 20 apart, which contradicts dt = 25 \(25 a frame\)"):
        load_dataset(path, dt=25, units=units)


def test_the_scene_that_contradicts_is_named(tmp_path):
    rows = [f"{s},{k * step},{k},{k * k}\n" for s, step in (("a", 0.1), ("b", 0.13))
            for k in range(9)]  # fmt: skip
    (tmp_path / "trajectories.csv").write_text("scene,t,x,y\n" + "".join(rows), encoding="utf-8")
    with pytest.raises(DataError, match="line 11, column t: the times of scene 'b' are 0.13 apart"):
        load_dataset(tmp_path, fps=10)


def test_every_third_frame_is_told(tmp_path):
    (note,) = load_dataset(table(tmp_path, every(0.1)), fps=30).notes
    assert "up to 3 frames of fps = 30 apart" in note and "column t" in note
    assert np.isfinite(load_dataset(tmp_path).scenes[0].times).all()
