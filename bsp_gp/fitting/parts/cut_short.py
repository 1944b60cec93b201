"""Tracks that are followed up to a close pass, and no further.

Two bodies that almost meet part in a direction that hangs on less than the errors of their rows: no
path under the true law leads through, or a thousand do. What came before tells the law as ever.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bsp_gp.fitting.parts.defects import Edit

__all__ = ["CutShort"]

LEAST_ROWS = 2
"""That are left of a track: they tell its state, and nothing of a law."""


@dataclass(frozen=True)
class CutShort(Edit):
    """Bodies that are followed in rows before one alone; beyond, they lead others as they did.

    Attributes
    ----------
    bodies : tuple of str
        Of one chain.
    """

    bodies: tuple = field(default=())

    @classmethod
    def at_turn(cls, chains, chain):
        """The chain cut where it turns most sharply.

        Parameters
        ----------
        chains : Chains
        chain : int

        Returns
        -------
        CutShort
        """
        n = int(chains.lengths[chain])
        times, places = chains.times[:n, chain], chains.observed[:n, chain]
        row = max(_sharpest_turn(times, places), LEAST_ROWS)
        return cls(
            chains.scenes[chain], row, bodies=chains.bodies[chain],
            n_left_out=int(np.isfinite(places[row:]).sum()),
            extent=float(np.nanmax(np.nanmax(places, axis=0) - np.nanmin(places, axis=0))),
        )  # fmt: skip

    def seen(self, dataset):
        """The rows as they are: what leads others is seen there as before."""
        return dataset

    def followed(self, groups):
        """Chains of which the bodies' own is cut.

        Parameters
        ----------
        groups : tuple of Chains

        Returns
        -------
        tuple of Chains
        """
        return tuple(map(self._cut, groups))

    def _cut(self, chains):
        owners = zip(chains.scenes, chains.bodies, strict=True)
        mine = np.array([owner == (self.scene, self.bodies) for owner in owners], dtype=bool)
        if not mine.any():
            return chains
        stop = np.where(mine, np.minimum(self.row, chains.lengths), chains.lengths)
        return chains.cut(np.zeros_like(stop), stop)

    def describe(self):
        return f"{', '.join(self.bodies)} followed[{self.scene}, :{self.row}]"


def _sharpest_turn(times, places):
    """The row at which velocity changes most from the step before to the step after."""
    with np.errstate(all="ignore"):
        steps = np.diff(places, axis=0) / np.diff(times)[:, None, None]
        turns = np.linalg.norm(np.diff(steps, axis=0), axis=-1)
    turns = np.nan_to_num(turns).max(axis=1, initial=0.0)
    return int(turns.argmax()) + 1 if turns.any() else 0
