"""What a camera makes of the motion: noise on the positions of bodies that move."""

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import SettingsError


@dataclass(frozen=True)
class Observation:
    """Errors of measured positions.

    Parameters
    ----------
    noise : float, metres
        Standard deviation on each axis.
    memory : float, 0 to 1
        Correlation of one frame's error with the next one's: 0 is white, above it AR(1).
    outliers : float, 0 to 1
        Share of positions whose error is `outlier_factor` times as large.
    outlier_factor : float
    is_declared : bool
        Whether the data set says `noise`; otherwise its reader has to estimate it.
    """

    noise: float = 0.0
    memory: float = 0.0
    outliers: float = 0.0
    outlier_factor: float = 10.0
    is_declared: bool = True

    def __post_init__(self):
        for name, high in (("noise", math.inf), ("memory", 1), ("outliers", 1)):
            value = getattr(self, name)
            if not (0 <= value <= high and math.isfinite(value)) or (
                name == "memory" and value == 1
            ):
                raise SettingsError(f"{name} must not be negative or too large, got {value}")
        if not self.outlier_factor > 0:
            raise SettingsError(f"outlier_factor must be positive, got {self.outlier_factor}")

    def errors(self, shape, rng):
        """Draw errors of shape (T, N, 2), metres; the variance is the same in every frame."""
        errors = rng.standard_normal(shape)
        for k in range(1, shape[0] if self.memory else 0):
            errors[k] = self.memory * errors[k - 1] + math.sqrt(1 - self.memory**2) * errors[k]
        if self.outliers:
            is_outlier = rng.random(shape[:2]) < self.outliers
            errors = np.where(is_outlier[..., None], self.outlier_factor, 1.0) * errors
        return self.noise * errors
