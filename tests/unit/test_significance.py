import numpy as np
import pytest

from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.close import declared_law
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.significance import log_evidence, null_targets, p_value
from bsp_gp.search.exhaustive import search_exhaustive
from tests.throws import GRAVITY, throws


def test_p_value_counts_the_data_among_the_draws():
    null = np.arange(99.0)
    assert p_value([1000.0], [null]) == 1 / 100
    assert p_value([-1.0], [null]) == 1.0
    assert p_value([96.0], [null]) == 4 / 100  # 96, 97, 98 and the data
    assert p_value([5.0], [np.full(19, 5.0)]) == 1.0  # ties count against it


def test_p_value_takes_the_greatest_over_the_searches_draw_by_draw():
    first, second = np.array([0.0, 10.0, 0.0, 0.0]), np.array([10.0, 0.0, 0.0, 0.0])
    assert p_value([1.0, 5.0], [first, second]) == 3 / 5
    assert p_value([5.0, -np.inf], [first, second]) == 3 / 5


def test_log_evidence_is_the_profiled_gain_less_the_penalty():
    # 100 rows, half of the sum of squares explained: (n / 2) log 2 - (1 / 2) log n.
    assert log_evidence(0.5, 100, 1) == pytest.approx(50 * np.log(2) - 0.5 * np.log(100))
    assert log_evidence(0.0, 100, 3) == pytest.approx(-1.5 * np.log(100))
    shares = log_evidence([0.1, 0.2, 1.0, 1.5, -0.5], 50, 1)
    assert np.all(np.isfinite(shares))
    assert shares[0] < shares[1] < shares[2] == shares[3]
    assert shares[4] == log_evidence(0.0, 50, 1)


def test_log_evidence_puts_searches_with_more_constants_on_one_scale():
    """Under the null the gain of k useless constants is chi-squared: half of it is k / 2 nats."""
    rng = np.random.default_rng(0)
    n, k, draws = 200, 5, 2000
    columns = np.linalg.qr(rng.standard_normal((n, k)))[0]
    noise = rng.standard_normal((n, draws))
    shares = np.square(columns.T @ noise).sum(axis=0) / np.square(noise).sum(axis=0)
    gain = log_evidence(shares, n, 0)
    # To first order: sd of half a chi-squared is sqrt(k / 2).
    assert gain.mean() == pytest.approx(k / 2, abs=5 * np.sqrt(k / 2 / draws) + 0.1)
    assert np.mean(log_evidence(shares, n, k) > 0) < 0.01


@pytest.fixture(scope="module")
def regression():
    data = throws(n_scenes=4, n_times=25, sigma=0.01, noise=(0.01,))
    return observe(data, declared_law(data, [GRAVITY]), np.random.default_rng(0)).train_regression


def test_null_targets_are_white_on_the_valid_rows(regression):
    draws = null_targets(regression, np.random.default_rng(1), 400)
    valid = np.concatenate([batch.valid.ravel() for batch in regression.batches])
    assert draws.shape == (len(valid), 400)
    assert not draws[~valid].any()
    # 5 standard errors of a variance.
    assert draws[valid].var() == pytest.approx(1, abs=5 * np.sqrt(2 / (valid.sum() * 400)))


def test_p_value_is_exact_under_the_null(regression):
    """Of 300 residuals of pure noise a tenth has p <= 0.1, the search's selection included."""
    grammar = load_grammar("physics").masked({"m_i", "v_i", "e_x", "e_y"}, 2)[0]
    n_data, n_null = 300, 99
    draws = null_targets(regression, np.random.default_rng(2), n_data + n_null)
    nuisance = np.zeros((len(draws), 0))
    result = search_exhaustive(
        regression,
        grammar,
        kind="field",
        target=draws[:, 0],
        nuisance=nuisance,
        max_levels=6,
        null_targets=draws,
    )
    n = regression.n_rows
    gains = log_evidence(np.array(result.null_gains), n, 1)
    assert log_evidence(result.best.share, n, 1) == pytest.approx(gains[0], rel=1e-6)
    # One pool of simulated draws for all the data: the p-values stay exact on average; their
    # common error is that of the 90 % point of 99 draws, a Beta(90, 10) with sd 0.030.
    p = [p_value([gain], [gains[n_data:]]) for gain in gains[:n_data]]
    spread = np.sqrt(0.1 * 0.9 / n_data + 0.1 * 0.9 / n_null)
    assert np.mean(np.array(p) <= 0.1) == pytest.approx(0.1, abs=3 * spread)
    # With fresh draws for every tenth of the data there is no common error.
    fresh = [
        p_value([g], [np.delete(gains, k)[np.arange(k, k + n_null) % (len(gains) - 1)]])
        for k, g in enumerate(gains[:n_data])
    ]
    assert np.mean(np.array(fresh) <= 0.1) == pytest.approx(0.1, abs=3 * np.sqrt(0.09 / n_data))
