"""Several starts: which minimum is the lowest, and how many of the starts lead there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.fitting.least_squares import minimise
from bsp_gp.fitting.problem import Settings

__all__ = ["multistart"]

_FITS = ("converged", "at_bound")


def multistart(problem, starts, *, settings=None, **options):
    """The lowest of the minima that several starts lead to, and how many of them agree on it.

    Parameters
    ----------
    problem : Problem
    starts : iterable of points
    settings : Settings, optional
    **options
        Of `minimise`.

    Returns
    -------
    Minimum
        The lowest, even if it has not converged: a higher one that has is no minimum to believe
        in. `n_agree` counts the converged starts with its chi-squared (within 1e-3, of one
        variance or of itself) and its values (within a tenth of a standard error, or six digits),
        unknowns that are not determined left out.
    """
    settings = settings or Settings()
    minima = [minimise(problem, start, settings=settings, **options) for start in starts]
    best = min(minima, key=lambda m: (m.chisqr, m.status not in _FITS))
    if best.linearised is None:
        return replace(best, n_starts=len(minima), n_agree=0)
    agreeing = [m for m in minima if m.status in _FITS and _agree(m, best, settings)]
    if agreeing:
        best = min(agreeing, key=lambda m: m.chisqr)
    return replace(best, n_starts=len(minima), n_agree=len(agreeing))


def _agree(minimum, best, settings):
    """Whether a minimum is the best one, as far as the errors of the best tell."""
    with np.errstate(all="ignore"):
        rounding = 1e-28 * np.sum(np.square(best.jacobian * best.values))
        is_known = settings.absolute > 0  # the noise: chi-squared counts its variances
        unit = 1.0 if is_known else best.chisqr / max(np.subtract(*best.jacobian.shape), 1)
        if minimum.chisqr - best.chisqr > 1e-3 * max(best.chisqr, float(is_known)) + rounding:
            return False
        lengths = np.sqrt(np.sum(np.square(best.jacobian), axis=0))
        lengths = np.where(lengths > 0, lengths, 1.0)
        inverse = np.linalg.pinv(best.jacobian / lengths, rcond=settings.rank)
        errors = np.sqrt(unit * np.sum(np.square(inverse), axis=1)) / lengths
        allowed = np.maximum(0.1 * errors, 1e-6 * np.abs(best.values))
        same = np.abs(minimum.values - best.values) <= allowed
        return bool(np.all(same | best.undetermined))
