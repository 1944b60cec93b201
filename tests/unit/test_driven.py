"""Driven bodies between their rows: all curves at once are what scipy's are one by one."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from bsp_gp.physics.engine.driven import Driven


def test_all_curves_at_once_are_those_of_scipy_one_by_one():
    rng = np.random.default_rng(0)
    times = np.sort(rng.uniform(0, 10, (30, 3)), axis=0)
    phase = np.arange(1, 3)[:, None] * times[:, :, None, None] + np.arange(2)
    track = np.sin(phase)  # (T, S, D, d)
    track[:, 1, 1] = track[0, 1, 1]  # at rest
    track[5:25, 0, 0] = np.nan
    track[3:, 2, 0] = np.nan  # three rows: straight on between them
    driven = Driven(SimpleNamespace(driven=track, driven_times=times, driven_velocities=None))
    at, chain = rng.uniform(-1, 11, 300), rng.integers(0, 3, 300)
    (places, velocities), pulls = driven.at(at, chain), driven.pull(at, chain)
    for s in range(3):
        for k in range(2):
            rows = np.flatnonzero(np.isfinite(track[:, s, k]).all(axis=1))
            mine, t = chain == s, times[rows, s]
            degree = 5 if len(rows) > 5 else 1
            curve = make_interp_spline(t, track[rows, s, k], k=degree)
            inside = np.clip(at[mine], t[0], t[-1])
            slope = curve(inside, nu=1)
            expected = curve(inside) + slope * (at[mine] - inside)[:, None]
            assert places[k][:, mine].T == pytest.approx(expected, abs=1e-10)
            assert velocities[k][:, mine].T == pytest.approx(slope, abs=1e-10)
            if degree == 5:
                is_in = (inside == at[mine])[:, None]
                expected = np.where(is_in, curve(inside, nu=2), 0.0)
                assert pulls[k][:, mine].T == pytest.approx(expected, abs=1e-8)
