"""The published protocol on measured falls (see the README beside the data)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.loop.close import close_loop
from bsp_gp.report.naming import describe
from tests.told import adopted

pytestmark = [
    pytest.mark.long,
    pytest.mark.xfail(reason="the figures of these falls are to be measured anew", strict=False),
]

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
WEIGHT = "9.81 [m/s^2] * m_i * down"


@pytest.fixture(scope="module")
def reports(shared_data):
    """Train on one drop of every ball, predict the other; both ways."""
    folder = shared_data / "measured" / "ball_drops"
    ways = (("*_drop1", "*_drop2"), ("*_drop2", "*_drop1"))
    return [
        close_loop(
            load_dataset(folder, train=train, test=test),
            [WEIGHT],
            rng=np.random.default_rng(0),
            seed=0,
        )
        for train, test in ways
    ]


def endpoints(report, model):
    """End-point error of every ball but the bowling ball, one of whose drops is too short."""
    row = 41
    return [
        abs(getattr(o, model)[row, 1] - o.observed[row, 1])
        for o in report.overlays
        if "bowling" not in o.scene
    ]


def test_twenty_predictions(reports):
    ends = [end for report in reports for end in endpoints(report, "adopted")]
    before = [end for report in reports for end in endpoints(report, "declared")]
    print("median", np.median(ends), "mean", np.mean(ends), "before", np.median(before))
    assert len(ends) == 20
    # The median is that of starts known by twelve rows: 0.1 where they are fitted on all.
    assert np.median(ends) <= 1.05
    assert np.mean(ends) <= 1.05
    # Gravity alone, from the README: an independent fit, initial states under white noise. Here
    # the noise has a memory, and they differ a little.
    assert np.median(before) == pytest.approx(6.10, abs=0.3)
    assert np.mean(before) == pytest.approx(7.34, abs=0.3)


def test_the_law_is_named(reports):
    for report in reports:
        (effect,) = [e for e in adopted(report) if e.code == "law"]
        assert describe(effect.formula, -1.0) == "drag, linear in speed"
        assert not set(report.dataset["train"]) & set(report.dataset["test"])


def test_training_drops_alone_choose_the_same_law(reports, shared_data, monkeypatch):
    """The first 70 % of each against the rest: no other drop has a part in it."""
    monkeypatch.syspath_prepend(EXPERIMENTS)
    from ball_drops import in_time

    for report in reports:
        sides = {side: tuple(report.dataset[side]) for side in ("train", "test")}
        dataset = replace(load_dataset(shared_data / "measured" / "ball_drops"), **sides)
        found = close_loop(in_time(dataset), [WEIGHT], rng=np.random.default_rng(0), max_rounds=1)
        assert adopted(found)[-1].law == adopted(report)[-1].law


def test_no_ball_is_pushed_forward(reports):
    for report in reports:
        constants = adopted(report)[-1].constants
        assert len(constants) == 11
        assert all(c.value <= 0 for c in constants)
        by_ball = {c.entity: c.value for c in constants}
        # The light ones are braked more, in acceleration; the volleyball's is per unit mass.
        assert by_ball["volleyball"] < -0.1


def test_the_unknown_mass_is_said(reports):
    for report in reports:
        assert any("volleyball" in note for note in report.dataset["notes"])
        (c,) = [c for c in adopted(report)[-1].constants if c.entity == "volleyball"]
        assert "per unit mass" in c.unit
