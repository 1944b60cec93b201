"""Causes that do not explain all are not judged by the less noise that is told beside them."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.student import log_likelihood
from bsp_gp.loop.loop import _more_under
from tests.throws import SI


def noise(*levels, is_free=True):
    return SimpleNamespace(
        levels=levels, is_free=np.full(len(levels), is_free), degrees=math.inf
    )  # fmt: skip


def found(chi2_red, levels, is_failed=False, is_free=True):
    return SimpleNamespace(
        noise=noise(*levels, is_free=is_free), chisqr=200.0 * chi2_red, n_rows=200,
        is_failed=is_failed,
    )  # fmt: skip


def test_more_noise_is_no_likelier_than_the_likeliest():
    base = noise(4.0, 2.0)
    more = _more_under(base, found(4.0, (1.0, 0.5)))  # the likeliest is twice as much
    assert more == pytest.approx(200 * (1.5 - math.log(2)))
    height = [-100 * 4 / s**2 - 200 * math.log(s) for s in np.linspace(1, 4, 301)]
    assert more == pytest.approx(max(height) - height[0])


def test_it_has_no_more_than_the_law_without_the_cause():
    more = _more_under(noise(1.5, 1.5), found(9.0, (1.0, 1.0)))
    assert more == pytest.approx(100 * 9 * (1 - 1.5**-2) - 200 * math.log(1.5))


@pytest.mark.parametrize(
    ("base", "fit"),
    [
        (noise(4.0), found(1.0, (1.0,))), (noise(1.0), found(4.0, (2.0,))),
        (noise(4.0), found(4.0, (1.0,), is_failed=True)),
        (noise(4.0), found(4.0, (1.0,), is_free=False)),
    ],
)  # fmt: skip
def test_nothing_is_gained_where_all_is_explained_or_the_noise_known(base, fit):
    assert _more_under(base, fit) == 0.0


def test_under_tails_more_noise_is_no_quadratic_form():
    """Of a misfit under Student's t it had been thousands of nats."""
    rng = np.random.default_rng(4)
    scene = Scene("a", np.arange(300.0), rng.standard_normal((300, 1, 2)), (Entity("ball"),))
    data = Dataset("rest", (scene,), units=SI)
    fitted = fit(Hypothesis.from_laws(data, []), data)
    model = replace(fitted.noise, degrees=4.0, levels=(0.2, 0.2))
    tailed = replace(
        fitted, noise=model, chisqr=float(np.square(fitted.residual / 0.2).sum()),
        log_likelihood=log_likelihood(model, fitted.channels, fitted.residual),
    )  # fmt: skip
    more = _more_under(replace(model, levels=(0.8, 0.8)), tailed)
    larger = replace(model, levels=(0.8, 0.8))
    exact = log_likelihood(larger, fitted.channels, fitted.residual) - tailed.log_likelihood
    assert more == pytest.approx(exact)
    assert more < 0.5 * tailed.chisqr / 2
