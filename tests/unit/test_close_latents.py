"""The loop with unknown masses."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import LatentDeclaration
from bsp_gp.loop.close import close_loop
from tests.planted import GRAVITY, orbit_dataset

UNKNOWN = LatentDeclaration("mass", low=0.2, high=10.0, entities=("body1", "body2"))


def world(**settings):
    data = orbit_dataset(1, n_train=3, n_test=3, **settings)
    return replace(data, latents=(UNKNOWN,), noise=(0.01,))


def masses_of(report):
    """Values and 90 % intervals of unknown masses, by name."""
    out = {
        c.name: (c.value, c.low, c.high) for c in report.constants if c.name.startswith("mass[")
    }
    return out


def truths(data):
    return {
        f"mass[{s.name}:{e.name}]": e.mass
        for s in data.scenes[:3]
        for e in s.entities
        if e.name != "body0"
    }


@pytest.mark.slow
def test_unknown_masses_are_inferred_and_nothing_is_found_missing():
    data = world(n_times=40)
    report = close_loop(
        data, [GRAVITY], rng=np.random.default_rng(0), max_rounds=1, max_levels=3
    )
    assert report.verdict == "nothing missing"
    found = masses_of(report)
    true = truths(data)
    assert set(found) == set(true)
    # Independent of the recorded values: they serve scoring only.
    for name, (mean, low, high) in found.items():
        assert abs(mean - true[name]) < 2.5 * (high - low), name
    spread = [high - low for _, low, high in found.values()]
    assert np.median(spread) < 1.5  # the prior's interval is 8.8 wide


@pytest.mark.slow
def test_a_missing_drag_is_found_beside_unknown_masses():
    data = world(drag=0.05, n_times=40)
    report = close_loop(data, [GRAVITY], rng=np.random.default_rng(0), max_rounds=1)
    assert report.verdict == "effect adopted"
    found, true = masses_of(report), truths(data)
    for name, (mean, _, _) in found.items():
        assert mean == pytest.approx(true[name], rel=0.25), name
    assert report.total["ratio"].value < 0.2
