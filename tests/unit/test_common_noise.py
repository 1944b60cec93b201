"""Causes that do not explain all are not judged by the less noise that is told beside them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.loop.loop import _more_under


def noise(*levels, is_free=True):
    return SimpleNamespace(levels=levels, is_free=np.full(len(levels), is_free))


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
