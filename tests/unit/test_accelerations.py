"""Tables of accelerations alone: places are sums of sums, of which errors add up twice."""

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

SIGMA, STEP, ZERO = 0.02, 0.02, 0.05


def swinging(rng, n=500):
    """Accelerations of a damped bob, x'' = -25 x - 0.1 x', of a sensor that shows more at rest."""
    t = np.arange(n) * STEP
    return t, ZERO + swung(t, 0.1, 25.0, 2, SIGMA, rng)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def table(rng):
    t, a = swinging(rng)
    return pd.DataFrame({"t (s)": t, "a (m/s^2)": a})


def test_second_differences_of_places_are_what_was_measured_less_what_is_shown_at_rest(table):
    data = Dataset.from_frames(table)
    (scene,) = data.scenes
    assert (data.velocity, data.n_sums) == ("unseen", 2)
    assert len(scene.times) == len(table) + 2
    np.testing.assert_allclose(scene.times[1:-1], table["t (s)"], atol=1e-12)
    gained = np.diff(scene.positions[:, 0, 0], 2) / STEP**2
    off = gained - (table["a (m/s^2)"] - ZERO)
    assert np.abs(off).max() < SIGMA
    assert abs(off.mean()) < 0.1 * SIGMA
    # What swings keeps to its middle, whatever drifts: the amplitude is 0.1 m.
    assert np.abs(scene.positions).max() < 0.12
    assert any("sums of accelerations" in note for note in data.notes)


def test_their_noise_is_that_of_accelerations(table):
    data = Dataset.from_frames(table)
    assert estimate_noise(data).sigma[0] / STEP**2 == pytest.approx(SIGMA, rel=0.15)


def test_constants_are_found_within_their_errors(table):
    data = Dataset.from_frames(table, units={"mass": "kg"}, properties={"mass": 1.0})
    found = fit(Hypothesis.from_laws(data, ("-k * (p_i - origin)", "-c * v_i")), data)
    assert found.status == "converged"
    values = dict(zip((p[0] for p in found.parameters), found.values, strict=True))
    errors = dict(zip(values, np.sqrt(np.diag(found.covariance)), strict=True))
    assert abs(values["k"] - 25.0) < 4 * errors["k"] < 0.1
    assert abs(values["c"] - 0.1) < 4 * errors["c"] < 0.02
    assert found.noise.levels[0] / STEP**2 == pytest.approx(SIGMA, rel=0.15)
    assert "m/s^2 (estimated); of accelerations" in found.noise.describe()


def test_what_rattles_as_it_rolls_is_not_bound_to_its_middle(rng):
    t = np.arange(600) * 0.01
    push = 1.0 * ((t > 0.5) & (t < 1.5)) - 0.2 * ((t > 1.5) & (t < 5.5))
    rattle = 0.8 * rng.standard_normal(len(t)) * ((t > 0.5) & (t < 5.5))
    shown = push + rattle + 0.002 * rng.standard_normal(len(t))
    frame = pd.DataFrame({"t": t, "ax": shown})
    (scene,) = Dataset.from_frames(frame, units={"ax": "m/s^2", "t": "s"}).scenes
    assert np.ptp(scene.positions[:, 0, 0]) > 1.0  # 3 m but for what errors add up to


def test_what_brakes_comes_to_rest(rng):
    t = np.arange(300) * STEP
    a = np.where((t > 1) & (t < 3), -3.0, 0.0) + ZERO + SIGMA * rng.standard_normal(len(t))
    later = t > 0.5  # on the way already
    data = Dataset.from_frames(pd.DataFrame({"t (s)": t, "a (m/s^2)": a})[later])
    (scene,) = data.scenes
    speed = np.diff(scene.positions[:, 0, 0]) / STEP
    assert abs(speed[-50:]).max() < 0.1
    assert speed[:20].mean() == pytest.approx(6.0, abs=0.2)


def test_units_of_accelerations_and_of_time_count(table):
    other = pd.DataFrame({
        "t (ms)": 1000 * table["t (s)"], "Acceleration (cm/s^2)": 100 * table["a (m/s^2)"],
    })  # fmt: skip
    one, two = (Dataset.from_frames(frame) for frame in (table, other))
    np.testing.assert_allclose(one.scenes[0].positions, two.scenes[0].positions, atol=1e-9)
    np.testing.assert_allclose(one.scenes[0].times, two.scenes[0].times, atol=1e-9)


@pytest.mark.parametrize("heading", ["Acceleration x (g)", "ax (g)", "Acc X (mg)"])
def test_accelerations_in_units_of_gravity_are_no_masses(table, heading):
    size = 9.80665e-3 if "mg" in heading else 9.80665
    other = pd.DataFrame({"t (s)": table["t (s)"], heading: table["a (m/s^2)"] / size})
    one, two = (Dataset.from_frames(frame) for frame in (table, other))
    np.testing.assert_allclose(one.scenes[0].positions, two.scenes[0].positions, atol=1e-9)


@pytest.mark.parametrize(
    "names",
    [
        [*(f"Linear Acceleration {axis} (m/s^2)" for axis in "xyz"), "Absolute (m/s^2)"],
        ["ax", "ay", "az", "norm"],
        [*(f"{axis} (m/s^2)" for axis in "xyz"), "Absolute (m/s^2)"],
    ],
)
def test_the_axis_along_which_all_moves_is_taken(tmp_path, rng, names):
    t, a = swinging(rng)
    rest = SIGMA * rng.standard_normal((2, len(t)))
    columns = [t, rest[0], rest[1], a, np.abs(a)]
    frame = pd.DataFrame(dict(zip(["Time (s)", *names], columns, strict=True)))
    frame.to_csv(tmp_path / "shaken.csv", index=False)
    units = {"length": "m"} if names[0] == "ax" else None
    data = load_dataset(tmp_path / "shaken.csv", units=units)
    gained = np.diff(data.scenes[0].positions[:, 0, 0], 2) / STEP**2
    assert np.abs(gained - (a - ZERO)).max() < SIGMA


def test_a_cart_that_rattles_does_not_move_along_what_shakes_it(tmp_path, rng):
    """It rolls along y, faster and faster and then slower, and is shaken up and down."""
    t = np.arange(500) * 0.01
    roll = np.where(t < 3, 1.0, -1.5) + 0.1 * rng.normal(size=500)
    columns = (0.1 * rng.normal(size=500), roll, 8.0 * rng.normal(size=500))
    names = [f"Linear Acceleration {axis} (m/s^2)" for axis in "xyz"]
    frame = pd.DataFrame({"Time (s)": t, **dict(zip(names, columns, strict=True))})
    data = Dataset.from_frames(frame)
    assert data.n_dims == 3
    assert np.argmax(np.ptp(data.scenes[0].positions[:, 0], axis=0)) == 1
    assert any("all axes are kept" in note for note in data.notes)
    data = Dataset.from_frames(frame, columns={"ax": names[1]})
    assert data.n_dims == 2 and not any("all axes are kept" in note for note in data.notes)


def test_several_that_swing_are_axes(tmp_path, rng):
    t, a = swinging(rng)
    other = np.roll(a, 40)
    names = ("Time (s)", "Acceleration x (m/s^2)", "Acceleration y (m/s^2)")
    frame = pd.DataFrame(dict(zip(names, (t, a, other), strict=True)))
    scene = Dataset.from_frames(frame).scenes[0]
    assert scene.n_dims == 2
    gained = np.diff(scene.positions[:, 0, 1], 2) / STEP**2
    assert np.abs(gained - (other - ZERO))[60:-60].max() < SIGMA


def test_which_is_the_acceleration_may_be_said(rng):
    t, a = swinging(rng)
    frame = pd.DataFrame({"t (s)": t, "sensor 1 (m/s^2)": a, "sensor 2 (m/s^2)": -a})
    with pytest.raises(DataError, match="several columns may be the acceleration"):
        Dataset.from_frames(frame)
    data = Dataset.from_frames(frame, columns={"ax": "sensor 2"})
    gained = np.diff(data.scenes[0].positions[:, 0, 0], 2) / STEP**2
    assert np.abs(gained + (a - ZERO)).max() < SIGMA


def test_a_saved_one_stays_what_it_is(tmp_path, table):
    data = Dataset.from_frames(table)
    save_dataset(data, tmp_path / "saved")
    again = load_dataset(tmp_path / "saved")
    assert again.n_sums == 2
    np.testing.assert_allclose(again.scenes[0].positions, data.scenes[0].positions, atol=1e-15)


def test_declared_noise_is_that_of_accelerations(table):
    data = Dataset.from_frames(table, noise=SIGMA)
    assert NoiseModel.of(data).levels[0] == pytest.approx(SIGMA * STEP**2)


def test_errors_that_add_up_twice_whiten_and_colour(rng):
    times = np.cumsum(rng.uniform(0.05, 0.15, 40))[:, None]
    variance = np.full((40, 2), 1e-6)
    variance[7, 1] = np.nan
    whitener = SummedWhitener(times, variance, Adding(0.1, 1.0, 2))
    draws = np.where(whitener.seen, rng.standard_normal((3, 40, 2)), 0.0)
    np.testing.assert_allclose(whitener.whiten(whitener.colour(draws)), draws, atol=1e-7)
    # Places that go straight on are nothing but a beginning.
    straight = whitener.whiten(2.0 + 3.0 * np.broadcast_to(times, variance.shape))
    assert np.abs(straight[2:]).max() < 1e-6


def test_drawn_errors_have_the_level(table, rng):
    data = Dataset.from_frames(table)
    found = fit(Hypothesis.from_laws(data, ("-k * (p_i - origin)", "-c * v_i")), data)
    errors = draw_noise(found.noise, found.channels, 3, rng)[:, :, 0]
    assert np.diff(errors, 2).std() == pytest.approx(found.noise.levels[0], rel=0.05)
    assert not errors[:, :2].any()


def carried(rng, names=("Acceleration x", "Acceleration y", "Acceleration z"), weight=9.6):
    """A telephone that is held flat, driven to and fro once along x, and held: times, headings."""
    t = np.arange(300) * STEP
    push = np.where((t > 1) & (t < 2), 3.0, 0.0) - np.where((t >= 2) & (t < 3), 3.0, 0.0)
    trembling = 0.1 * np.sin(9 * t + rng.uniform(0, 6, 3)[:, None]) * (t < 0.9)
    shown = np.stack([push + 0.5, np.full(300, 0.7), np.full(300, weight)]) + trembling
    shown += SIGMA * rng.standard_normal(shown.shape)
    return t, shown, [f"{name} (m/s^2)" for name in names]


def shown_by(t, shown, names):
    return pd.DataFrame(dict(zip(["t (s)", *names], [t, *shown], strict=True)))


@pytest.mark.parametrize("unit, size", [("m/s^2", 1.0), ("g", 9.80665), ("cm/s^2", 0.01)])
def test_gravity_is_taken_off_and_told(rng, unit, size):
    t, shown, _ = carried(rng)
    names = [f"Acceleration {axis} ({unit})" for axis in "xyz"]
    data = Dataset.from_frames(shown_by(t, shown / size, names))
    assert np.ptp(data.scenes[0].positions, axis=0).max() < 6.0  # not 9.6 * 6^2 / 2
    (note,) = [note for note in data.notes if "gravity" in note]
    assert "was taken off" in note and "9.6" in note and not note.startswith("check")


def test_gravity_is_taken_off_where_one_axis_alone_shows_the_motion(rng):
    t = np.arange(300) * STEP
    lift = np.where((t > 1) & (t < 2), 1.0, 0.0) - np.where((t > 4) & (t < 5), 1.0, 0.0)
    shown = np.stack([0 * t, 0 * t, 9.9 + lift]) + SIGMA * rng.standard_normal((3, 300))
    data = Dataset.from_frames(shown_by(t, shown, [f"a{axis} (m/s^2)" for axis in "xyz"]))
    assert data.scenes[0].n_dims == 1 or np.ptp(data.scenes[0].positions[:, 0, 1]) == 0
    assert np.ptp(data.scenes[0].positions[:, 0, 0]) == pytest.approx(3.0, abs=0.4)
    assert any("was taken off" in note and "9.9" in note for note in data.notes)


def test_a_sensor_that_turns_is_told(rng):
    t, shown, names = carried(rng)
    turn = np.clip(t - 3.5, 0, 1) * np.pi / 2
    shown = np.stack([shown[0], 9.7 * np.sin(turn), 9.7 * np.cos(turn)])
    data = Dataset.from_frames(shown_by(t, shown, names))
    (note,) = [note for note in data.notes if "gravity" in note]
    assert note.startswith("check: ") and "turn" in note and "cannot be trusted" in note


@pytest.mark.parametrize("case", ["small", "linear", "two axes"])
def test_nothing_is_said_where_gravity_is_not_in_accelerations(rng, case):
    t, shown, names = carried(rng, weight=0.1 if case == "small" else 9.7)
    if case == "linear":
        names = [f"Linear {name}" for name in names]
    if case == "two axes":
        shown, names = shown[:2], names[:2]
    data = Dataset.from_frames(shown_by(t, shown, names))
    assert not any("gravity" in note for note in data.notes)


@pytest.mark.parametrize("columns", [None, {f"a{axis}": f"gF{axis}" for axis in "xyz"}])
def test_forces_in_units_of_gravity_are_accelerations(tmp_path, rng, columns):
    t, shown, _ = carried(rng)
    table = shown_by(t, shown / 9.80665, [f"gF{axis}" for axis in "xyz"])
    table.assign(TgF=1.0).rename(columns={"t (s)": "time"}).to_csv(tmp_path / "g.csv", index=False)
    data = load_dataset(tmp_path / "g.csv", columns=columns)
    assert any("was taken off" in note and "9.6" in note for note in data.notes)
    assert np.ptp(data.scenes[0].positions, axis=0).max() < 6.0


def test_columns_of_accelerations_without_a_header_are_named_by_their_numbers(tmp_path, rng):
    t, shown, names = carried(rng)
    table = shown_by(t, shown, names).assign(clock=1.6e18)
    path = tmp_path / "bare.csv"
    table[["clock", *table.columns[:-1]]].to_csv(path, index=False, header=False)
    with pytest.raises(DataError, match="t=2 ax=3 ay=4 az=5 of accelerations"):
        load_dataset(path)
    data = load_dataset(path, columns={"t": "2", "ax": "3", "ay": "4", "az": "5"})
    assert data.velocity == "unseen" and any("gravity" in note for note in data.notes)


def test_an_acceleration_in_a_unit_of_velocities_is_asked_for(rng):
    t, a = swinging(rng)
    frame = pd.DataFrame({"t (s)": t, "Accel(m/s)": a})
    with pytest.raises(DataError, match="speaks of an acceleration, and m/s is a unit of velo"):
        Dataset.from_frames(frame)
    for unit, kind in (("m/s^2", "unseen"), ("m/s", "only")):
        assert Dataset.from_frames(frame, units={"Accel": unit}).velocity == kind
    of_sums = frame.set_axis(["t (s)", "Speed by accelerometer (m/s)"], axis=1)
    assert Dataset.from_frames(of_sums).velocity == "only"
