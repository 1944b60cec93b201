"""A law fitted to the training scenes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bsp_gp.physics.force import ForceLaw

__all__ = ["Fit", "clipped"]


@dataclass(frozen=True, eq=False)
class Fit:
    """A law fitted to the training scenes.

    Attributes
    ----------
    law : ForceLaw
    parameters : tuple of (name, entity)
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        Scaled by the misfit where that is above one.
    chisqr : float
        Whitened sum of squares of what the fit minimised (positions, or accelerations).
    n_rows : int
    n_effective : float
        Rows discounted for the autocorrelation of the residual.
    jacobian : ndarray
        Of the regression, for joint refits.
    residual : ndarray
        Whitened residual of the regression.
    whole : RolloutFit or None
        The fit to whole tracks, on noisy data.
    converged : bool
    dof : float
        Degrees of freedom behind the level of the noise, or of the misfit where that is greater;
        inf where the level was quoted or declared and nothing but noise is left.
    """

    law: ForceLaw
    parameters: tuple
    values: np.ndarray
    covariance: np.ndarray
    chisqr: float
    n_rows: int
    n_effective: float
    jacobian: np.ndarray
    residual: np.ndarray
    is_exact: bool = False
    whole: object = None
    converged: bool = True
    dof: float = np.inf

    def bic(self, n_effective=None):
        """Bayesian information criterion with the noise level profiled out, nats times two.

        On exact data a residual below the numerical floor counts as at the floor, so that
        rounding is never taken for evidence.
        """
        n = n_effective or self.n_effective
        per_row = max(self.chisqr / self.n_rows, 1.0 if self.is_exact else 1e-300)
        return n * np.log(per_row) + len(self.parameters) * np.log(max(n, 2.0))

    @property
    def intervals(self):
        """90 % half-widths of the constants, shape (k,).

        Student's t where the level of the noise was estimated: its own uncertainty counts.
        """
        from scipy.stats import t as student_t  # a slow import

        return student_t.ppf(0.95, self.dof) * np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def clipped(law, bounds):
    """Start values inside the bounds."""
    constants = {}
    for name, (low, high) in (bounds or {}).items():
        value = law.constants[name]
        if hasattr(value, "items"):
            constants[name] = {k: float(np.clip(v, low, high)) for k, v in value.items()}
        else:
            constants[name] = float(np.clip(value, low, high))
    return law.with_constants(constants)
