"""The covariance of coordinates whose noise the law carries from one to another."""

import numpy as np
import pytest

from bsp_gp.loop.felt_noise import _factor


def test_a_covariance_that_rounding_left_without_rank_has_a_factor():
    felt = np.random.default_rng(0).standard_normal((10, 3)) * np.logspace(-1, 12, 10)[:, None]
    covariance = felt @ felt.T
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(covariance)
    factor = _factor(covariance, 3)
    size = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.isfinite(np.linalg.inv(factor)).all()
    assert np.max(np.abs(factor @ factor.T - covariance) / size) < 1e-12
