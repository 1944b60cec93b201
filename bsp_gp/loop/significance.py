"""Question 5, first half: whether noise alone could have made the search find as much.

Under the declared model the whitened residual is white noise. Drawing it anew and running the
same search on the draws (the regressors kept) gives the distribution of the best law's share of
the sum of squares, selection over all laws included. The share does not depend on the noise
level, so an estimated level does not spoil the p-value (a Monte-Carlo test: Besag and Clifford
1989).
"""

from __future__ import annotations

import numpy as np

__all__ = ["N_NULL", "log_evidence", "null_targets", "p_value"]

N_NULL = 299


def null_targets(regression, rng, n_draws=N_NULL):
    """Simulated whitened residuals, shape (n, n_draws): white noise on the valid rows."""
    valid = np.concatenate([batch.kept.ravel() for batch in regression.batches])
    draws = rng.standard_normal((n_draws, len(valid))).T
    return draws * valid[:, None]


def log_evidence(share, n_rows, n_constants):
    """Gain in log-likelihood (noise level profiled out) less the BIC penalty, nats.

    One scale for searches with one constant and with a constant per entity.
    """
    share = np.clip(np.asarray(share, dtype=float), 0.0, 1.0 - 1e-15)
    return -0.5 * n_rows * np.log1p(-share) - 0.5 * n_constants * np.log(max(n_rows, 2))


def p_value(observed, null):
    """Monte-Carlo p-value of the greatest evidence over all searches.

    Parameters
    ----------
    observed : sequence of float
        Best evidence of each search on the data.
    null : sequence of ndarray, shape (B,) each
        Best evidence of each search on the same simulated draws.
    """
    best = np.max(observed)
    worst = np.max(np.stack(null), axis=0)
    # So put that what is not a number is never significant.
    return float((1 + np.sum(~(worst < best))) / (1 + len(worst)))
