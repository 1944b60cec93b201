"""Defects of recordings: rows that are not what their labels say, undone before anything is fitted.

What is left out is not explained by the rest of a hypothesis: it may lie anywhere in what the scene
shows, with the same density, so that its evidence stays comparable.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.fitting.hypothesis import Part


@dataclass(frozen=True)
class Edit(Part):
    """A change of the rows of one scene.

    Attributes
    ----------
    row : int
        The first that is changed.
    n_left_out : int
        Coordinates that a fit would have used and is not shown.
    extent : float, m
        Of what the scene shows.
    """

    scene: str
    row: int
    n_left_out: int = field(default=0, kw_only=True)
    extent: float = field(default=1.0, kw_only=True)
    kind = "instrument"

    @property
    def log_density(self):
        return -self.n_left_out * math.log(self.extent)

    def edited(self, scene):
        """The scene with the defect undone."""
        raise NotImplementedError

    def seen(self, dataset):
        """The rows with the defect undone; scenes that lack the row are left alone."""

        def has_it(scene):
            return scene.name == self.scene and self.row < len(scene.times)

        scenes = tuple(self.edited(s) if has_it(s) else s for s in dataset.scenes)
        return replace(dataset, scenes=scenes)


@dataclass(frozen=True)
class Swapped(Edit):
    """From a row on, two bodies bear each other's names."""

    first: str
    second: str

    def edited(self, scene):
        pair = [scene.names.index(self.first), scene.names.index(self.second)]

        def exchanged(values):
            values = np.array(values)
            values[self.row :, pair] = values[self.row :, pair[::-1]]
            return values

        return _with_tracks(scene, exchanged)

    def describe(self):
        return f"{self.first}, {self.second} swapped[{self.scene}, {self.row}:]"


@dataclass(frozen=True)
class LeftOut(Edit):
    """Rows of a body, or of all, that show something else.

    Attributes
    ----------
    stop : int
        The first row that is good again.
    entity : str
        "" = all bodies that forces move.
    """

    stop: int
    entity: str

    def edited(self, scene):
        bodies = [scene.names.index(self.entity)] if self.entity else scene.dynamic

        def blanked(values):
            values = np.array(values)
            values[self.row : self.stop, bodies] = np.nan
            return values

        return _with_tracks(scene, blanked)

    def describe(self):
        return f"{self.entity or 'all'} left out[{self.scene}, {self.row}:{self.stop}]"


@dataclass(frozen=True)
class Resting(LeftOut):
    """Rows of a body that has come to rest on a wall: of these the place is told, and no more.

    Bounces that cannot be seen have led there, and no law of flight acts.

    Attributes
    ----------
    error : float, m
        Of a coordinate there.
    """

    error: float = field(default=1.0, kw_only=True)

    @property
    def log_density(self):
        return -self.n_left_out * math.log(self.error * math.sqrt(2 * math.pi * math.e))

    def describe(self):
        return f"{self.entity} lies still[{self.scene}, {self.row}:]"


@dataclass(frozen=True)
class Shifted(Edit):
    """From a row on time stamps are off: frames are missing or too many, or a clock was put on."""

    seconds: float

    def edited(self, scene):
        after = np.arange(len(scene.times)) >= self.row
        times = scene.times + np.where(after, self.seconds, 0.0)
        # Of frames that were repeated only the first is kept.
        half = float(np.median(np.diff(scene.times))) / 2
        kept = ~after | (times > scene.times[self.row - 1] + half)
        shorter = {n: v if v is None else v[kept] for n, v in _tracks(scene).items()}
        logged = {name: values[kept] for name, values in scene.inputs.items()}
        return replace(scene, times=times[kept], inputs=logged, **shorter)

    def describe(self):
        return f"t {self.seconds:+.4g} s[{self.scene}, {self.row}:]"


def _with_tracks(scene, change):
    """The scene with everything that was measured row by row changed."""
    return replace(scene, **{n: v if v is None else change(v) for n, v in _tracks(scene).items()})


def _tracks(scene):
    return {name: getattr(scene, name) for name in ("positions", "velocities", "sigma")}
