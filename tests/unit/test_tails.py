"""Causes asked of rows whose noise has tails: what is left, and its noise, are as if normal."""

from functools import lru_cache

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.tangent import Tangent
from bsp_gp.fitting.weighing import as_normal
from bsp_gp.loop.close import close_loop
from tests.fitted_tracks import body, dataset_of, scene_of

SIGMA, DEGREES, DRAG = 0.004, 3.0, 0.05
TIMES = 0.01 * np.arange(120)
FALL = "9.81 [m/s^2] * m_i * (-1 * e_y)"


def throws(seed, drag=0.0, n_scenes=4):
    """Throws with a drag, tails of three degrees of freedom, and two rows far off in each."""
    rng, scenes = np.random.default_rng(seed), []
    for k in range(n_scenes):
        v = np.array([2.0 + k, 6.0 + 0.5 * k])
        fade = (1 - np.exp(-drag * TIMES)) / drag if drag else TIMES
        drop = 9.81 * (TIMES - fade) / drag if drag else 9.81 * TIMES**2 / 2
        places = np.stack([v[0] * fade, v[1] * fade - drop], axis=-1)
        places = places + SIGMA * rng.standard_t(DEGREES, places.shape)
        places[rng.choice(len(TIMES), 2, replace=False)] += 0.12 * rng.standard_normal((2, 2))
        scenes.append(scene_of(TIMES, (body("ball"),), places[:, None], name=f"throw {k}"))
    return dataset_of(scenes)


@lru_cache
def fitted(seed=0):
    dataset = throws(seed)
    return fit(Hypothesis.from_laws(dataset, [FALL]), dataset)


def test_the_residual_under_tails_is_as_if_normal():
    found = fitted()
    assert found.noise.degrees < 6
    plain = as_normal(found)
    assert np.isinf(plain.noise.degrees)
    seen = found.channels.seen
    raw, rest = (
        each.noise.whitener(found.channels).whiten(np.where(seen, each.residual, 0.0))[seen]
        for each in (found, plain)
    )
    assert np.abs(raw).max() > 15 and raw.std() > 1.5, "outliers, in units of the scale"
    # Of n rows the standard deviation is known to 1 / sqrt(2 n), of a bounded score better.
    assert rest.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * rest.size))
    assert np.abs(rest).max() < 4
    assert as_normal(plain) is plain


def test_outliers_are_no_cause():
    """Of five data sets without a cause no constant push shows; untamed, outliers make one."""
    chances = []
    for seed in range(5):
        tangent = Tangent(fitted(seed))
        columns = np.zeros((2, *tangent.fit.channels.seen.shape))
        for axis in (0, 1):
            own = tangent.fit.channels.axis == axis
            columns[axis][:, own] = TIMES[:, None] ** 2 / 2
        chances.append(tangent.score(columns).p_value)
    assert min(chances) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("drag", "verdict"), [(0.0, "nothing missing"), (DRAG, "effect adopted")])
def test_what_is_missing_is_told_from_tails(drag, verdict):
    report = close_loop(throws(7, drag), (FALL,), rng=0, n_bootstrap=0)
    assert report.verdict == verdict
    if drag:
        (strength,) = (c for c in report.constants if c.name.startswith("c"))
        assert strength.low < -DRAG < strength.high
