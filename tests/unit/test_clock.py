"""Clocks that cannot be right: a declared rate beside other times, and times that jump."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.scene import Dataset
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError
from bsp_gp.fitting.law_fit import fit_law


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
        ("fps = 30", [round(k / 30, 2) for k in range(25)]),  # digits rounded
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


def falling(times, g=9.81, rng=None, sigma=1e-3):
    x = np.stack([0.8 * times, 3 + 2 * times - g / 2 * times**2], axis=1)
    return x if rng is None else x + sigma * rng.standard_normal(x.shape)


def orbiting(times):
    return np.stack([np.cos(2 * times), 0.5 * np.sin(2 * times)], axis=1)


def bouncing(times, period=0.7):
    phase = (times + 0.2) % period
    return np.stack([0.5 * times, 4.9 * phase * (period - phase)], axis=1)


def resting(times):
    return np.zeros((len(times), 2))


def table_of(clock, **tracks):
    """A table of bodies at times of a clock, right or not."""
    pieces = [
        pd.DataFrame({"t": clock, "entity": name, "x": p[:, 0], "y": p[:, 1]})
        for name, p in tracks.items()
    ]
    return Dataset.from_frames(pd.concat(pieces), units={"length": "m", "time": "s"}, up="y")


def jumping(times, row, size):
    return times + np.where(np.arange(len(times)) >= row, size, 0.0)


TIMES = 0.02 * np.arange(40)


@pytest.mark.parametrize("size", [10.0, 0.1, -0.015])
@pytest.mark.parametrize("row", [10, 20, 30])
def test_a_clock_that_jumps_while_the_ball_falls_on_is_told(size, row):
    x = falling(TIMES, rng=np.random.default_rng(row), sigma=2e-4)
    (note,) = table_of(jumping(TIMES, row, size), ball=x).notes
    assert f"the clock of scene 'frames' seems to jump by {size:g}" in note
    assert f"from t = {TIMES[row - 1]:.9g} to {TIMES[row] + size:.9g} (line {row + 1})" in note


def test_a_jump_stands_among_the_notes_of_a_fit(tmp_path):
    x = falling(TIMES, rng=np.random.default_rng(0))
    frame = pd.DataFrame({"t": 1e3 * jumping(TIMES, 15, 10.0), "x": x[:, 0], "y": x[:, 1]})
    frame.to_csv(tmp_path / "ball.csv", index=False)
    units = {"length": "m", "time": "ms"}
    data = load_dataset(tmp_path / "ball.csv", units=units)
    text = fit_law(data, ["-g * m_i * e_y"], rng=np.random.default_rng(0)).text()
    assert "Note: check: the clock of scene 'ball' seems to jump by 1e+04: from t = 280 to" in text


@pytest.mark.parametrize("motion", [falling, orbiting, bouncing, resting])
@pytest.mark.parametrize("n_missing", [1, 3, 12, 200])
def test_rows_that_are_missing_are_no_jump(motion, n_missing):
    """While nobody looked the body went on: it is somewhere else after the gap, or at rest."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        times = np.delete(0.02 * np.arange(60 + n_missing), 20 + seed + np.arange(n_missing))
        x = motion(times)
        assert table_of(times, a=x + 1e-3 * rng.standard_normal(x.shape)).notes == ()
    notes = table_of(times, a=motion(times)).notes  # noise-free
    assert notes == () or (motion is resting and "nothing moves" in notes[0])


def test_a_body_that_was_somewhere_else_makes_it_a_gap():
    rng = np.random.default_rng(0)
    clock = jumping(TIMES, 20, 1.0)
    jumped = falling(TIMES, rng=rng)
    still = np.ones((40, 2)) + 1e-3 * rng.standard_normal((40, 2))
    said = [note for note in table_of(clock, a=jumped, b=still).notes if "clock" in note]
    assert len(said) == 1
    assert table_of(clock, a=jumped, b=1 + orbiting(clock)).notes == ()


def test_uneven_times_and_short_tracks_are_left_alone():
    rng = np.random.default_rng(0)
    uneven = np.cumsum(rng.uniform(0.005, 0.04, 60))
    assert table_of(uneven, a=falling(uneven, rng=rng)).notes == ()
    assert table_of(jumping(TIMES[:16], 8, 1.0), a=falling(TIMES[:16])).notes == ()
