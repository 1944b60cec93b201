"""Velocities along the line of sight: how they are read, and the companions that they show."""

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, Parameter
from bsp_gp.fitting.law_fit import constant_estimates
from bsp_gp.fitting.parts.orbits import AnyAngle, Orbit, Trend
from bsp_gp.inference.priors import Prior
from bsp_gp.loop.aliases import has_alias
from bsp_gp.loop.close import close_loop
from bsp_gp.report.summary import summary_text
from bsp_gp.report.unseen_body import rivals_of

DAY = 86400.0
NAMES = ("P", "K", "longitude", "e", "omega")


@pytest.fixture
def rng():
    return np.random.default_rng(20)


def orbit(values, epoch=0.0):
    """An orbit of a period in days."""
    return Orbit(tuple(Parameter(name) for name in NAMES[: len(values)]), epoch)


def velocities(times, *orbits):
    """Velocities at times in days, m/s."""
    total = np.zeros(len(times))
    for values in orbits:
        own = dict(zip(NAMES, (values[0], *values[1:]), strict=False))
        total += orbit(values).added(times, own)[0]
    return total


def observed(rng, count, span, *orbits, error=2.0):
    """Dates at night in seasons, velocities and their errors."""
    days = np.sort(rng.choice(np.flatnonzero(np.arange(span) % 365 < 220), count, replace=False))
    dates = days + rng.normal(0.4, 0.08, count)
    return dates, velocities(dates, *orbits) + rng.normal(0, error, count), np.full(count, error)


def write(path, dates, speeds, errors, heading="BJD,RV (m/s),e_RV", more=""):
    rows = [
        f"{2450000 + d:.5f},{v:.3f},{e:.2f}{more}"
        for d, v, e in zip(dates, speeds, errors, strict=True)
    ]
    path.write_text("\n".join([heading, *rows]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("values", [(7.0, 2.0, 0.4), (7.0, 2.0, 0.4, 0.6, 1.1)])
def test_slopes_of_an_orbit(values):
    times, names = np.linspace(0, 30, 50), NAMES[: len(values)]
    part, known = orbit(values, 3.0), dict(zip(NAMES, values, strict=False))
    slopes = part.added(times, known)[1]
    for name, slope in zip(names, slopes, strict=True):
        step = 1e-6
        ends = (part.added(times, {**known, name: known[name] + way})[0] for way in (step, -step))
        after, before = ends
        np.testing.assert_allclose(slope, (after - before) / (2 * step), atol=1e-6)


def test_an_ellipse_without_eccentricity_is_a_circle():
    times = np.linspace(0, 30, 50)
    np.testing.assert_allclose(
        velocities(times, (7.0, 2.0, 0.4, 0.0, 1.1)), velocities(times, (7.0, 2.0, 0.4)), atol=1e-12
    )


def test_a_trend_is_steady():
    part = Trend((Parameter("trend1"),), 5.0)
    value, slopes = part.added(np.array([5.0, 7.0]), {"trend1": 3.0})
    assert value.tolist() == [0.0, 6.0] and slopes.tolist() == [[0.0, 2.0]]
    bent = Trend((Parameter("trend1"), Parameter("bend1")), 5.0)
    value, slopes = bent.added(np.array([5.0, 7.0]), {"trend1": 3.0, "bend1": 0.5})
    assert value.tolist() == [0.0, 7.0] and slopes.tolist() == [[0.0, 2.0], [0.0, 2.0]]
    assert bent.describe() == "trend1 t + bend1 t^2 / 2"


def test_rivals_are_told_with_all_of_their_companions():
    texts = (
        "v = V + K1 cos(2 pi t / P1) of a companion",
        "v = V + K1 Kepler(2 pi t / P1) of a companion + K2 cos(2 pi t / P2) of a companion",
        "v = V + trend1 t + K1 Kepler(2 pi t / P1) of a companion",
    )  # fmt: skip
    assert rivals_of(texts) == (
        "an unseen companion on a circle",
        "an unseen companion on an ellipse and another on a circle",
        "an unseen companion on an ellipse beside a steady change",
    )


def test_what_is_read(tmp_path, rng):
    dates, speeds, errors = observed(rng, 20, 400, (30.0, 20.0, 1.0))
    file = write(tmp_path / "star.csv", dates, speeds, errors)
    data = load_dataset(file)
    (scene,) = data.scenes
    assert data.is_of_sight
    np.testing.assert_allclose(scene.positions[:, 0, 0], speeds, atol=1e-3)
    np.testing.assert_allclose(scene.sigma[:, 0, 0], errors)
    np.testing.assert_allclose(np.diff(scene.times), np.diff(dates) * DAY, atol=1.0)


def test_names_of_the_caller_and_instruments(tmp_path, rng):
    dates, speeds, errors = observed(rng, 20, 400, (30.0, 20.0, 1.0))
    rows = [f"{d:.5f} {v:.3f} {e} {'AB'[k % 2]}"
            for k, (d, v, e) in enumerate(zip(dates + 2450000, speeds, errors, strict=True))]
    file = tmp_path / "star.txt"
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    data = load_dataset(file, columns={"t": "1", "rv": "2", "srv": "3", "scene": "4"})
    assert data.is_of_sight and [scene.name for scene in data.scenes] == ["A", "B"]
    named = write(tmp_path / "named.csv", dates, speeds, errors, "time,mnvel,errvel,tel", ",k")
    assert load_dataset(named).is_of_sight
    assert any("m/s is taken" in note for note in load_dataset(named).notes)


def test_few_rows_of_an_instrument_are_left_out(tmp_path, rng):
    dates, speeds, errors = observed(rng, 12, 400, (30.0, 20.0, 1.0))
    rows = [f"{d + 2450000:.5f},{v:.3f},{e},{'old' if k < 2 else 'new'}"
            for k, (d, v, e) in enumerate(zip(dates, speeds, errors, strict=True))]
    file = tmp_path / "star.csv"
    file.write_text("\n".join(["BJD,RV (km/s),e_RV,inst", *rows]) + "\n", encoding="utf-8")
    data = load_dataset(file)
    assert [scene.name for scene in data.scenes] == ["new"]
    assert any("old (2)" in note for note in data.notes)
    assert data.units.symbols["m"] == "km/s"


def test_two_velocities_are_asked_for(tmp_path):
    file = tmp_path / "double.csv"
    file.write_text("JD,RV1 rv,RV2 rv\n2450000.1,1,2\n2450001.2,3,1\n2450003.4,2,4\n", "utf-8")
    with pytest.raises(DataError, match="say which is meant|several columns"):
        load_dataset(file)


def test_a_companion_on_an_ellipse(tmp_path, rng):
    dates, speeds, errors = observed(rng, 70, 1500, (97.3, 40.0, 1.0, 0.45, 2.0))
    file = write(tmp_path / "star.csv", dates, speeds + 12.0, errors)
    report = close_loop(load_dataset(file), "nothing", rng=rng, n_bootstrap=0)
    found = {c.name: c for c in report.constants}
    assert report.verdict == "effect adopted"
    assert sum(r.adopted for r in report.rounds) == 1
    period, size, shape = (found[name] for name in ("P1", "K1", "e1"))
    assert abs(period.value / DAY - 97.3) < 1.5 * (period.high - period.low) / DAY
    assert abs(size.value - 40.0) < 1.5 * (size.high - size.low)
    assert abs(shape.value - 0.45) < 1.5 * (shape.high - shape.low)
    text = " ".join(summary_text(report).split())
    assert "unseen companion with a period of 97." in text and "velocity error" in text


def test_a_period_is_above_zero_and_a_velocity_may_be_nothing(tmp_path, rng):
    # What has become superfluous is told by that.
    dates, speeds, errors = observed(rng, 40, 300, (250.0, 0.4, 1.0))
    data = load_dataset(write(tmp_path / "star.csv", dates, speeds, errors))
    part = Orbit((
        Parameter("P1", low=9 * DAY, high=2e3 * DAY, start=250 * DAY,
                  prior=Prior("log_uniform", 9 * DAY, 2e3 * DAY)),
        Parameter("K1", low=0.0, high=1e6, start=0.4, prior=Prior("log_uniform", 1e-3, 1e6)),
        Parameter("longitude1", start=1.0, prior=AnyAngle()),
    ), float(data.scenes[0].times.mean()))  # fmt: skip
    bare = Hypothesis.from_laws(data, [])
    found = fit(bare + Hypothesis((part,)), data)
    period, size, _ = constant_estimates(found, data)
    assert size.high - size.value == pytest.approx(size.value - size.low)
    assert size.low < 0
    assert period.low > 0
    assert period.high / period.value == pytest.approx(period.value / period.low, rel=1e-6)


def test_heavy_tails_of_the_errors_count_beside_a_companion(tmp_path, rng):
    # Weights of rows were those of all that a star moves, not of what an orbit leaves of that.
    dates, speeds, errors = observed(rng, 120, 700, (51.4, 900.0, 0.8, 0.42, 0.4), error=20.0)
    speeds += 40.0 * rng.standard_t(2, len(dates))
    data = load_dataset(write(tmp_path / "star.csv", dates, speeds, errors))
    report = close_loop(data, "nothing", rng=rng, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert [c.name for c in report.constants] == ["P1", "K1", "longitude1", "e1", "omega1"]
    size = report.constants[1]
    assert abs(size.value - 900.0) < 1.5 * (size.high - size.low) < 60.0


def test_a_companion_far_out_bends_the_velocities(tmp_path, rng):
    dates, _, errors = observed(rng, 90, 3000)
    since = (dates - (dates[0] + dates[-1]) / 2) / 1000.0
    speeds = -30.0 * since - 8.0 * since**2 + rng.normal(0, 2.0, len(dates))
    data = load_dataset(write(tmp_path / "star.csv", dates, speeds, errors))
    report = close_loop(data, "nothing", rng=rng, n_bootstrap=0)
    known = {c.name: c for c in report.constants}
    assert set(known) == {"trend1", "bend1"}
    trend, bend = known["trend1"], known["bend1"]
    assert abs(trend.value + 30.0 / (1000 * DAY)) < 1.5 * (trend.high - trend.low)
    assert abs(bend.value + 16.0 / (1000 * DAY) ** 2) < 1.5 * (bend.high - bend.low)


def test_a_companion_beside_a_trend_is_one(tmp_path, rng):
    # A second one had been told whose period was three times the recording.
    dates, speeds, errors = observed(rng, 80, 1400, (269.7, 50.0, 1.0, 0.36, 2.0))
    speeds -= 0.1 * (dates - dates.mean())
    data = load_dataset(write(tmp_path / "star.csv", dates, speeds, errors))
    report = close_loop(data, "nothing", rng=rng, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    names = [c.name for c in report.constants]
    assert sorted(names) == ["K1", "P1", "e1", "longitude1", "omega1", "trend1"]
    assert "beside a velocity that goes on changing" in " ".join(summary_text(report).split())


def test_two_companions_each_of_which_hides_the_other(tmp_path, rng):
    dates, speeds, errors = observed(rng, 60, 1300, (11.75, 25.0, 1.0), (103.7, 30.0, 4.0))
    file = write(tmp_path / "star.csv", dates, speeds, errors)
    report = close_loop(load_dataset(file), "nothing", rng=rng, n_bootstrap=0)
    periods = sorted(c.value / DAY for c in report.constants if c.name.startswith("P"))
    assert len(periods) == 2
    np.testing.assert_allclose(periods, [11.75, 103.7], rtol=0.02)


def test_a_star_is_followed_as_a_whole(tmp_path, rng):
    """Forty turns had been cut into stretches, each with a zero of its own."""
    dates = np.arange(300.0)
    speeds = velocities(dates, (7.3, 30.0, 1.0)) + rng.normal(0, 0.5, 300)
    rows = [f"{2450000 + d:.1f},{v:.3f}" for d, v in zip(dates, speeds, strict=True)]
    file = tmp_path / "star.csv"
    file.write_text("\n".join(["JD,RV (km/s)", *rows]) + "\n", encoding="utf-8")
    report = close_loop(load_dataset(file), "nothing", rng=rng, n_bootstrap=0)
    assert not any("turns" in note for note in report.dataset["notes"])
    (period,) = (c for c in report.constants if c.name == "P1")
    assert period.value / DAY == pytest.approx(7.3, abs=0.001)
    assert report.law_text.startswith("v = V + K1 cos")


def test_noise_alone_has_no_companion(tmp_path, rng):
    dates, speeds, errors = observed(rng, 50, 900, error=3.0)
    report = close_loop(
        load_dataset(write(tmp_path / "star.csv", dates, speeds, errors)), "nothing", rng=rng,
        n_bootstrap=0,
    )
    assert report.verdict == "nothing missing"


@pytest.mark.parametrize(("size", "is_alike"), [(2.5, True), (40.0, False)])
def test_a_slight_companion_of_a_star_seen_once_a_night_has_two_periods(
    rng, tmp_path, size, is_alike
):  # fmt: skip
    """Of TOI-560 half a turn of the star, 6.1 d, was a companion of 1.1952 d, as a fact."""
    dates, speeds, errors = observed(rng, 60, 700, (6.12, size, 0.4))
    data = load_dataset(write(tmp_path / "star.csv", dates, speeds, errors))
    middle = float(data.scenes[0].times.mean())
    part = Orbit((
        Parameter("P1", low=5 * DAY, high=7 * DAY, start=6.12 * DAY),
        Parameter("K1", low=0.0, high=1e3, start=size),
        Parameter("longitude1", start=0.4 + 2 * np.pi * middle / DAY / 6.12, prior=AnyAngle()),
    ), middle)  # fmt: skip
    found = fit(Hypothesis.from_laws(data, []) + Hypothesis((part,)), data)
    assert found.values[1] == pytest.approx(size, abs=1.5)
    assert has_alias(found, found.law.frame[-1], 16.0) is is_alike
