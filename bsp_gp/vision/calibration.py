"""From pixels to the world: scale, origin, axes, or a homography from known points of a plane."""

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

from bsp_gp.errors import SettingsError


@dataclass(frozen=True, eq=False)
class Calibration:
    """A map of the picture's plane to world coordinates, x to the right and y up.

    Attributes
    ----------
    matrix : ndarray, shape (3, 3)
        Homography: world (X, Y, 1) ~ matrix @ (x, y, 1), pixels with y down.
    unit : str
        Of world lengths; "px" if the scale is not known.
    residual : float
        Root mean square distance of the known points from their images, world units; nan if the
        map was not fitted.
    """

    matrix: np.ndarray = field(default_factory=lambda: np.diag([1.0, -1.0, 1.0]))
    unit: str = "px"
    residual: float = math.nan

    @classmethod
    def from_scale(cls, px_per_unit, unit="m"):
        """Scale in pixels per unit, the origin at the first pixel.

        Raises
        ------
        SettingsError
            If the scale is not positive.
        """
        if not (math.isfinite(px_per_unit) and px_per_unit > 0):
            raise SettingsError(f"the scale must be positive pixels per unit, got {px_per_unit}")
        return cls(np.diag([1.0, -1.0, px_per_unit]), unit)

    @classmethod
    def from_points(cls, pixels, world, unit="m"):
        """Fit known points: two give a similarity, three or more of a plane a homography (four).

        Parameters
        ----------
        pixels, world : array-like, shape (n, 2)

        Raises
        ------
        SettingsError
            Fewer than two points, three, or points in a line.
        """
        pixels, world = np.asarray(pixels, dtype=float), np.asarray(world, dtype=float)
        if pixels.shape != world.shape or pixels.ndim != 2 or pixels.shape[1] != 2:
            raise SettingsError("known points must be pairs x,y=X,Y")
        if len(pixels) == 2:
            a, b = ((p[1, 0] - p[0, 0]) + 1j * (p[1, 1] - p[0, 1]) for p in (pixels, world))
            a = a.conjugate()  # y of the picture points down
            if abs(a) == 0 or abs(b) == 0:
                raise SettingsError("the two known points are at one place")
            turn = b / a
            matrix = np.diag([0.0, 0.0, 1.0])
            matrix[:2, :2] = [[turn.real, turn.imag], [turn.imag, -turn.real]]
            matrix[:2, 2] = world[0] - matrix[:2, :2] @ pixels[0]
            return cls(matrix, unit, 0.0)
        if len(pixels) < 4:
            problem = "give two known points (scale and axes) or four and more (a tilted plane)"
            raise SettingsError(f"{problem}, got {len(pixels)}")
        matrix, _ = cv2.findHomography(pixels, world)
        if matrix is None or np.linalg.matrix_rank(pixels - pixels.mean(axis=0)) < 2:
            raise SettingsError("the known points lie in one line")
        result = cls(matrix, unit)
        off = np.linalg.norm(result.world(pixels) - world, axis=1)
        return cls(matrix, unit, float(np.sqrt(np.mean(off**2))))

    def world(self, pixels):
        """World coordinates of points, shape (..., 2); nan stays nan."""
        mapped = self._mapped(pixels)
        return mapped[..., :2] / mapped[..., 2:]

    def _mapped(self, pixels):
        pixels = np.asarray(pixels, dtype=float)
        return np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1) @ self.matrix.T

    def jacobian(self, pixels):
        """Derivatives of the world coordinates by the pixels, shape (..., 2, 2)."""
        mapped = self._mapped(pixels)
        w = mapped[..., 2:]
        xy = mapped[..., :2] / w
        return (self.matrix[:2, :2] - xy[..., :, None] * self.matrix[2, :2]) / w[..., None]

    def covariance(self, pixels, covariances):
        """Covariances of world coordinates from those of pixels, shape (..., 2, 2)."""
        j = self.jacobian(pixels)
        return j @ covariances @ np.swapaxes(j, -1, -2)
