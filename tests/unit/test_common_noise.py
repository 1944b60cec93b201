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
from bsp_gp.loop.rows import more_under
from bsp_gp.loop.table import Row
from bsp_gp.loop.turn import Turn
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
    more = more_under(base, found(4.0, (1.0, 0.5)))  # the likeliest is twice as much
    assert more == pytest.approx(200 * (1.5 - math.log(2)))
    height = [-100 * 4 / s**2 - 200 * math.log(s) for s in np.linspace(1, 4, 301)]
    assert more == pytest.approx(max(height) - height[0])


def test_it_has_no_more_than_the_law_without_the_cause():
    more = more_under(noise(1.5, 1.5), found(9.0, (1.0, 1.0)))
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
    assert more_under(base, fit) == 0.0


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
    more = more_under(replace(model, levels=(0.8, 0.8)), tailed)
    larger = replace(model, levels=(0.8, 0.8))
    exact = log_likelihood(larger, fitted.channels, fitted.residual) - tailed.log_likelihood
    assert more == pytest.approx(exact)
    assert more < 0.5 * tailed.chisqr / 2


def wandering(size):
    """A fit of nothing to a body that wanders smoothly by so much, beside noise of 0.1."""
    rng, times = np.random.default_rng(6), np.arange(200.0)
    places = size * np.sin(times / 9)[:, None] + 0.1 * rng.standard_normal((200, 2))
    scene = Scene("a", times, places[:, None], (Entity("ball"),))
    data = Dataset("swing", (scene,), units=SI)
    return fit(Hypothesis.from_laws(data, []), data)


@pytest.mark.parametrize(("size", "is_likelier"), [(0.5, True), (2.0, False)])
def test_what_leaves_less_is_told_under_the_noise_of_the_likeliest(size, is_likelier):
    """Two circles were an ellipse: what they left was noise with a memory, and what it left not."""
    strict, wide = wandering(size), wandering(1.0)
    known = replace(
        strict.noise, levels=(0.1, 0.1), correlated=0.0, degrees=math.inf, speed_growth=0.0
    )
    lax = replace(known, levels=(0.8, 0.8), correlated=0.98, correlation_time=9.0)
    fits = {
        k: replace(f, noise=n, log_likelihood=log_likelihood(n, f.channels, f.residual))
        for k, f, n in ((1, strict, known), (2, wide, lax))
    }
    assert fits[1].log_likelihood < fits[2].log_likelihood
    rows = [
        Row(k, "orbit", str(k), "orbits", "converged", ll - 20.0, -3.0, ll, 4, left=left)
        for k, ll, left in (
            (0, -1e5, 9.0), (1, fits[1].log_likelihood, size), (2, fits[2].log_likelihood, 1.0)
        )
    ]  # fmt: skip
    turn = SimpleNamespace(rows=rows, fits=fits)
    Turn.share_noise(turn)
    _, first, second = turn.rows
    assert (first.log_posterior > second.log_posterior) == is_likelier
    assert second is rows[2]
    if is_likelier:
        under = log_likelihood(lax, strict.channels, strict.residual)
        assert first.log_likelihood == pytest.approx(under)
        assert first.log_evidence == pytest.approx(under - 20.0)
