"""Tables of velocities alone: places are their sums, of which errors add up."""

import numpy as np
import pandas as pd
import pytest

from bsp_gp import Dataset, load_dataset, save_dataset
from bsp_gp.data.noise import estimate_noise
from bsp_gp.errors import DataError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.noise_model import NoiseModel
from bsp_gp.fitting.simulated import draw_noise
from bsp_gp.fitting.whitening import Adding, SummedWhitener
from tests.sensors import swung

SIGMA, STEP = 0.01, 0.04


def swinging(rng, n=400):
    """Velocities of a damped bob: x'' = -5 x - 0.1 x', with noise."""
    t = np.arange(n) * STEP
    return t, swung(t, 0.2, 5.0, 1, SIGMA, rng)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_rows_at_the_end_that_have_no_time_are_left_out():
    """Of two clocks side by side one is a row shorter."""
    times, v = np.append(np.arange(40) * STEP, np.nan), np.append(np.cos(np.arange(40)), np.nan)
    data = Dataset.from_frames(pd.DataFrame({"t (s)": times, "v (m/s)": v}))
    assert len(data.scenes[0].times) == 41  # places are between and beyond velocities
    assert any("without a time" in note for note in data.notes)


@pytest.fixture
def table(rng):
    t, v = swinging(rng)
    return pd.DataFrame({"t (s)": t, "v (m/s)": v})


def test_places_are_sums_between_the_rows(table):
    data = Dataset.from_frames(table)
    (scene,) = data.scenes
    assert data.velocity == "only"
    assert len(scene.times) == len(table) + 1
    np.testing.assert_allclose(scene.times[1:-1], table["t (s)"][1:] - STEP / 2)
    added = np.diff(scene.positions[:, 0, 0]) / STEP
    np.testing.assert_allclose(added, table["v (m/s)"], atol=1e-12)
    assert abs(scene.positions[:, 0, 0].mean()) < 1e-12
    assert any("errors add up" in note for note in data.notes)


def test_their_noise_is_that_of_velocities(table):
    sigma = estimate_noise(Dataset.from_frames(table)).sigma[0]
    assert sigma / STEP == pytest.approx(SIGMA, rel=0.1)


def test_constants_are_found_within_their_errors(table):
    data = Dataset.from_frames(table, units={"mass": "kg"}, properties={"mass": 1.0})
    found = fit(Hypothesis.from_laws(data, ("-k * (p_i - origin)", "-c * v_i")), data)
    assert found.status == "converged"
    values = dict(zip((p[0] for p in found.parameters), found.values, strict=True))
    errors = dict(zip(values, np.sqrt(np.diag(found.covariance)), strict=True))
    assert abs(values["k"] - 5.0) < 4 * errors["k"] < 0.05
    assert abs(values["c"] - 0.1) < 4 * errors["c"] < 0.05
    level = found.noise.levels[0] / STEP
    assert level == pytest.approx(SIGMA, rel=0.12)
    assert "m/s (estimated); of velocities" in found.noise.describe()


@pytest.mark.parametrize("unit, scale", [("km/h", 3.6), ("cm/s", 100.0)])
def test_units_of_velocities_count(table, unit, scale):
    other = pd.DataFrame({"t [min]": table["t (s)"] / 60, f"v ({unit})": scale * table["v (m/s)"]})
    one, two = (Dataset.from_frames(frame) for frame in (table, other))
    np.testing.assert_allclose(one.scenes[0].positions, two.scenes[0].positions, atol=1e-9)
    np.testing.assert_allclose(one.scenes[0].times, two.scenes[0].times, atol=1e-9)


def test_one_axis_of_a_gyroscope_is_an_angle(tmp_path, rng):
    t, v = swinging(rng)
    names = ["Time (s)", *(f"Gyroscope {axis} (rad/s)" for axis in "xyz"), "Absolute (rad/s)"]
    rest = SIGMA * rng.standard_normal((2, len(t)))
    frame = pd.DataFrame(dict(zip(names, [t, rest[0], v, rest[1], np.abs(v)], strict=True)))
    frame.to_csv(tmp_path / "gyro.csv", index=False)
    data = load_dataset(tmp_path / "gyro.csv")
    assert data.units.is_angle
    assert "Gyroscope y" in data.provenance["columns"]


def test_columns_of_two_axes_and_of_runs(rng):
    t = np.arange(20) * 0.1
    frame = pd.DataFrame({
        "run": np.repeat([1, 2], 20), "t": np.tile(t, 2), "vx": 1.0, "vy": np.tile(-9.81 * t, 2),
    })  # fmt: skip
    data = Dataset.from_frames(frame)
    assert [scene.name for scene in data.scenes] == ["1", "2"]
    fallen = np.diff(data.scenes[1].positions[:, 0, 1])
    np.testing.assert_allclose(fallen, -0.981 * t, atol=1e-12)


def test_gaps_part_a_track_and_wild_rows_are_told(table):
    table.loc[100, "v (m/s)"] += 1.0
    table = table.drop(index=range(200, 210))
    data = Dataset.from_frames(table)
    assert [scene.name for scene in data.scenes] == ["part 1", "part 2"]
    notes = " ".join(data.notes)
    assert "far off their neighbours are left out: 1, in line 101" in notes
    assert "behind a gap" in notes


def test_several_columns_that_may_be_the_velocity_are_asked_for(table):
    table["u (m/s)"] = 0.1
    table = table.rename(columns={"v (m/s)": "w (m/s)"})
    with pytest.raises(DataError, match="several columns may be the velocity: w .m/s., u"):
        Dataset.from_frames(table)
    assert Dataset.from_frames(table, columns={"vx": "w (m/s)"}).velocity == "only"


def test_a_saved_data_set_is_the_same(table, tmp_path):
    data = Dataset.from_frames(table)
    save_dataset(data, tmp_path / "saved")
    again = load_dataset(tmp_path / "saved")
    assert again.velocity == "only"
    np.testing.assert_array_equal(again.scenes[0].positions, data.scenes[0].positions)


def test_errors_that_add_up_are_whitened_and_drawn(rng):
    times = np.array([[0.0], [0.1], [0.2], [0.4], [0.5]])
    variance = np.full((5, 1), 0.04)
    variance[3] = np.nan
    whitener = SummedWhitener(times, variance, Adding(0.1, 50.0))
    errors = np.array([[3.0], [3.4], [3.0], [7.0], [3.6]])
    expected = [3 / 50, 2.0, -2.0, 0.0, 0.6 / (0.2 * np.sqrt(3))]
    np.testing.assert_allclose(whitener.whiten(errors)[:, 0], expected, atol=1e-12)
    white = rng.standard_normal((3, 5, 1)) * whitener.seen
    np.testing.assert_allclose(whitener.whiten(whitener.colour(white)), white, atol=1e-9)


def test_drawn_errors_are_white_once_whitened(table, rng):
    data = Dataset.from_frames(table, units={"mass": "kg"}, properties={"mass": 1.0})
    found = fit(Hypothesis.from_laws(data, ("-k * (p_i - origin)", "-c * v_i")), data)
    model = NoiseModel.of(data)
    drawn = draw_noise(model, found.channels, 5, rng)[..., :1]
    channels = found.channels.only(np.arange(found.channels.seen.shape[1]) < 1)
    white = model.whitener(channels).whiten(np.nan_to_num(drawn))[:, 1:, 0]
    assert white.std() == pytest.approx(1.0, abs=0.1)
    lag = (white[:, 1:] * white[:, :-1]).mean()
    assert abs(lag) < 4 / np.sqrt(white.size)


def two_bodies(rng):
    t = np.arange(40) * 0.1
    frame = pd.DataFrame({"t": np.tile(t, 2), "entity": np.repeat(["a", "b"], 40), "v (m/s)": 1.0})
    frame["v (m/s)"] += SIGMA * rng.standard_normal(80)
    return frame


def test_a_velocity_that_one_body_lacks_is_left_out_for_all(rng):
    whole = two_bodies(rng)
    data = Dataset.from_frames(whole.drop(index=60), units={"t": "s"})  # b at 2 s
    assert np.isfinite(data.scenes[0].positions).all()
    assert np.isfinite(NoiseModel.of(data).adding.begin)


def test_places_are_not_overridden_by_velocities():
    polar = pd.DataFrame({"t": np.arange(5.0), "distance": 1.0, "angle": 0.1, "v (m/s)": 2.0})
    units = {"angle": "rad", "length": "m", "time": "s"}
    assert Dataset.from_frames(polar, units=units).velocity == "ignore"
    other = pd.DataFrame({"t": np.arange(5.0), "P1 (m)": 1.0, "v (m/s)": 2.0})
    with pytest.raises(DataError, match="column 'x'"):
        Dataset.from_frames(other)
    ways = pd.DataFrame({"t": np.arange(5.0), "latitude": np.linspace(1, 1.1, 5),
                         "longitude": np.linspace(2, 2.1, 5), "speed": 3.0})  # fmt: skip
    assert Dataset.from_frames(ways, units={"time": "s"}).velocity == "ignore"


def test_a_row_with_a_time_that_was_is_left_out_and_told(table):
    table.loc[5, "t (s)"] = table.loc[3, "t (s)"]
    data = Dataset.from_frames(table)
    assert any("at a time that was are left out: 1, in line 6" in note for note in data.notes)


@pytest.mark.parametrize("change", [dict.fromkeys(range(5, 95, 3), time) for time in (0.0, 0.1)])
def test_times_of_velocities_must_increase(table, change):
    for row, time in change.items():
        table.loc[row, "t (s)"] = time
    with pytest.raises(DataError, match="times must increase from velocity to velocity"):
        Dataset.from_frames(table)


def test_errors_of_velocities_are_of_the_rows_that_add_them(table):
    frame = table.iloc[:30].assign(sv=0.01).rename(columns={"v (m/s)": "vx (m/s)", "sv": "svx"})
    frame.loc[10, "svx"] = 1.0
    data = Dataset.from_frames(frame)
    sigma = data.scenes[0].sigma[:, 0, 0]
    np.testing.assert_allclose(sigma[11], STEP, rtol=1e-9)  # behind the row: what it added
    np.testing.assert_allclose(np.delete(sigma, 11), 0.01 * STEP, rtol=1e-9)


def test_declared_noise_is_that_of_velocities(table):
    data = Dataset.from_frames(table, noise=0.02)
    assert data.noise[0] == pytest.approx(0.02 * STEP)


def test_velocities_in_pixels_have_the_time_of_their_own_unit(table):
    frame = pd.DataFrame({"t (ms)": 1000 * table["t (s)"], "v (px/s)": table["v (m/s)"]})
    data = Dataset.from_frames(frame, units={"length": "px"})
    plain = Dataset.from_frames(table)
    np.testing.assert_allclose(data.scenes[0].positions, plain.scenes[0].positions, atol=1e-9)


def test_frames_without_a_rate_are_asked_for(table):
    frame = table.rename(columns={"t (s)": "frame"})
    with pytest.raises(DataError, match="column 'x'|how long a frame"):
        Dataset.from_frames(frame)


def test_tracks_that_are_too_short_are_named(rng):
    frame = two_bodies(rng).rename(columns={"entity": "scene"}).iloc[:43]
    data = Dataset.from_frames(frame, units={"t": "s"})
    assert any("fewer than 4 velocities are left out: b" in note for note in data.notes)


@pytest.mark.parametrize(
    "names", [("Speed (m/s)", "sigma_Speed (m/s)"), ("v (m/s)", "err_v (m/s)")]
)
def test_the_error_of_a_velocity_is_no_second_one(table, names):
    frame = table.set_axis(["t (s)", names[0]], axis=1).assign(**{names[1]: SIGMA})
    data = Dataset.from_frames(frame)
    assert NoiseModel.of(data).sources[0] == "quoted"
    assert estimate_noise(data).sigma[0] == pytest.approx(SIGMA * STEP)
    assert any("is taken as the error of the velocity" in note for note in data.notes)


@pytest.mark.parametrize("heading", ["hdop", "quality", "fit (m/s)"])
def test_what_says_how_sure_a_place_is_or_is_a_fit_is_no_error_of_a_velocity(table, heading):
    """A column of hdop had been taken for the error of the speed beside it, in m/s."""
    frame = table.set_axis(["t (s)", "Speed (m/s)"], axis=1).assign(**{heading: 1.1})
    data = Dataset.from_frames(frame)
    assert NoiseModel.of(data).sources[0] == "estimated"
    assert not any("error of the velocity" in note for note in data.notes)


def test_a_time_that_is_absurdly_far_off_is_no_crash():
    t = np.arange(14.0)
    t[9:] += 1e20
    with pytest.raises(DataError, match="times must increase"):
        Dataset.from_frames(pd.DataFrame({"t (s)": t, "v (m/s)": np.cos(np.arange(14.0))}))
    t = np.append(1e-9 * np.arange(9), 1e20 * np.arange(1, 9))
    Dataset.from_frames(pd.DataFrame({"t (s)": t, "v (m/s)": np.cos(np.arange(17.0))}))


def test_what_is_shaken_for_a_while_is_no_error_and_a_lone_value_is(rng):
    t = np.arange(600) * STEP
    shaken = np.where((t > 8) & (t < 13), 0.1, 0.01)
    v = np.sin(t / 2) + shaken * rng.standard_normal(600)
    v[100] += 0.8
    (note,) = [note for note in read(t, v).notes if "far off" in note]
    assert "left out: 1, in line 101" in note


def read(t, v):
    return Dataset.from_frames(pd.DataFrame({"t (s)": t, "v (m/s)": v}))


@pytest.mark.parametrize("heading", ["RPM", "motor_rpm", "Speed (rpm)", "Drehzahl (U/min)"])
def test_turns_a_minute_are_rates_at_which_something_turns(heading):
    t = np.arange(60) * 0.1
    data = Dataset.from_frames(pd.DataFrame({"t (s)": t, heading: np.full(60, 30.0) + t}))
    assert data.units.is_angle and data.velocity == "only"
    way = np.ptp(data.scenes[0].positions)
    assert way == pytest.approx(2 * np.pi * (30 + t.mean()) / 60 * 6, rel=1e-6)
    beside = pd.DataFrame({"t (s)": t, "x (m)": np.cos(t), heading: 30.0 + t})
    assert Dataset.from_frames(beside).velocity == "ignore"


def test_counts_a_minute_are_no_turns():
    t = np.arange(60) * 0.1
    with pytest.raises(DataError, match="no column 'x'"):
        Dataset.from_frames(pd.DataFrame({"t (s)": t, "counts (1/min)": np.cos(t)}))
