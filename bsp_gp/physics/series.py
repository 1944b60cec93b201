"""Measured inputs of laws: numbers that were logged beside the tracks, at any instant.

Between rows they are interpolated along straight lines; before the first and after the last row
they keep their values. A log may be late: what it says of an instant acts that much later.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Series:
    """The inputs of some scenes.

    Attributes
    ----------
    curves : dict of (str, str, str) to (ndarray, ndarray)
        Name of an input, scene and body -> times (n,) and values (n,) or (n, d).
    delays : mapping of str to float, s
        By how much inputs act later than they were logged, by name; the others act at once.
    """

    curves: dict
    delays: Mapping = field(default_factory=dict)

    @classmethod
    def of(cls, scenes):
        """Those of all bodies of some scenes."""
        curves = {}
        for scene in scenes:
            for name, values in scene.inputs.items():
                for k, body in enumerate(scene.names):
                    seen = np.isfinite(values[:, k].reshape(len(scene.times), -1)).all(axis=1)
                    curves[name, scene.name, body] = scene.times[seen], values[seen, k]
        return cls(curves)

    @property
    def names(self):
        return tuple(dict.fromkeys(name for name, _, _ in self.curves))

    def at(self, name, scenes, bodies, times):
        """Values of an input, (..., S, R) or (..., S, R, d); nan of bodies that have none.

        Parameters
        ----------
        scenes : sequence of str, length S
        bodies : sequence of sequence of str, S x R
        times : ndarray, shape (..., S), or (..., 1), s
        """
        times = np.broadcast_to(times, (*np.shape(times)[:-1], len(scenes)))
        columns = [
            np.stack([self.along(name, scene, body, times[..., s]) for body in bodies[s]], axis=-1)
            for s, scene in enumerate(scenes)
        ]  # (d?, ..., R) each
        out = np.stack(columns, axis=-2)
        return out if self._size(name) == 0 else np.moveaxis(out, 0, -1)

    def along(self, name, scene, body, times):
        """Values of an input of one body, (...) or (d, ...)."""
        size = self._size(name)
        curve = self.curves.get((name, scene, body))
        if curve is None or not len(curve[0]):
            return np.full((*(size,) * (size > 0), *np.shape(times)), np.nan)
        return interpolated(times - self.delays.get(name, 0.0), *curve)

    def rate(self, name, scene, body, times):
        """Slopes of an input of one body by the time, (...) or (d, ...)."""
        curve = self.curves.get((name, scene, body))
        if curve is None or not len(curve[0]):
            return np.full_like(self.along(name, scene, body, times), np.nan)
        known, values = curve
        at = np.searchsorted(known, times - self.delays.get(name, 0.0))
        flat = np.zeros((1, *values.shape[1:]))  # before the first and after the last row
        steps = np.diff(known).reshape(-1, *(1,) * (values.ndim - 1))
        slopes = np.concatenate([flat, np.diff(values, axis=0) / steps, flat])[at]
        return np.moveaxis(slopes, -1, 0) if values.ndim > 1 else slopes

    def under(self, law):
        """The inputs as late as a law with values has them."""
        late = late_inputs(law)
        if not late:
            return self
        return replace(self, delays={name: law.constants[late[name]] for name in late})

    def _size(self, name):
        """Components of a vector; 0 of a number."""
        values = next(v for (own, _, _), (_, v) in self.curves.items() if own == name)
        return 0 if values.ndim == 1 else values.shape[1]


def late_inputs(law):
    """Names of the constants by which inputs of a law are late, by input."""
    return {name: part.names[0] for part in law.frame if part.kind == "log" for name in part.inputs}


def interpolated(times, known, values):
    """Values at some times by straight lines, (...) or (d, ...)."""
    if values.ndim == 1:
        return np.interp(times, known, values)
    return np.stack([np.interp(times, known, column) for column in values.T])
