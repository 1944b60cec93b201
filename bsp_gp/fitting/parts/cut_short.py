"""Tracks that are followed up to a close pass, and no further.

Two bodies that almost meet part in a direction that hangs on less than the errors of their rows: no
path under the true law leads through, or a thousand do. What came before tells the law as ever.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.fitting.jumps import scatter
from bsp_gp.fitting.parts.defects import Edit

LEAST_ROWS, LEAST_SEEN = 2, 8
"""Rows that are left of a track (they tell its state, and nothing of a law), and those of which a
turn is told."""
WIDTHS, SURE = (2, 4, 8, 16), 8.0
"""Rows on each side by which a change of velocity is told, and errors from which it is one."""


@dataclass(frozen=True)
class CutShort(Edit):
    """Bodies of a chain that are followed in rows before one alone; beyond, they lead as before."""

    bodies: tuple = field(default=())

    @classmethod
    def at_turn(cls, chains, chain, scene):
        """The bodies of a chain cut where they turn most sharply.

        What is left out may lie anywhere in the extent of their scene.
        """
        n = int(chains.lengths[chain])
        times, places = chains.times[:n, chain], chains.observed[:n, chain]
        turns = [_sharpest_turn(times, places[:, r]) for r in range(places.shape[1])]
        row = max(max(turns)[1], LEAST_ROWS)
        seen = scene.positions[:, scene.dynamic].reshape(-1, scene.n_dims)
        seen = seen[np.isfinite(seen).all(axis=1)]
        extent = float(np.ptp(seen, axis=0).max()) if len(seen) else 0.0
        return cls(
            chains.scenes[chain], row, bodies=chains.bodies[chain],
            n_left_out=int(np.isfinite(places[row:]).sum()), extent=extent or 1.0,
        )  # fmt: skip

    def seen(self, dataset):
        """The rows as they are: what leads others is seen there as before."""
        return dataset

    def followed(self, groups):
        """Chains of which the bodies' own is cut."""
        return tuple(map(self._cut, groups))

    def _cut(self, chains):
        """Chains that end there; of those with other bodies as well, these are seen no more."""
        stop, observed = chains.lengths.copy(), chains.observed
        for s, (scene, bodies) in enumerate(zip(chains.scenes, chains.bodies, strict=True)):
            mine = [r for r, body in enumerate(bodies) if body in self.bodies]
            if scene != self.scene or not mine:
                continue
            if len(mine) == len(bodies):
                stop[s] = min(self.row, stop[s])
            else:
                observed = observed.copy() if observed is chains.observed else observed
                observed[self.row :, s, mine] = np.nan
        if observed is not chains.observed:
            chains = replace(chains, observed=observed)
        if np.array_equal(stop, chains.lengths):
            return chains
        return chains.cut(np.zeros_like(stop), stop)

    def describe(self):
        return f"{', '.join(self.bodies)} followed[{self.scene}, :{self.row}]"


def _sharpest_turn(times, places):
    """How surely the velocity of a body (T, d) changes at a row, and the row: (sureness, row).

    By as few rows on each side as show a change above the errors of the rows; what bends all the
    time changes most over many.
    """
    rows = np.flatnonzero(np.isfinite(places).all(axis=1))
    t, x = times[rows], places[rows]
    best = 0.0, 0
    if len(rows) < LEAST_SEEN or not np.ptp(x, axis=0).any():
        return best
    error = scatter(x)
    for width in WIDTHS:
        if 2 * width > len(rows) + 1:
            break
        slopes, errors = _slopes(t, x, width)
        turn = slopes[width - 1 :] - slopes[: len(slopes) - width + 1]
        sure = error * np.hypot(errors[width - 1 :], errors[: len(errors) - width + 1])
        surely = np.linalg.norm(turn, axis=1) / sure
        k = int(surely.argmax())
        best = max(best, (float(surely[k]), int(rows[k + width - 1])))
        if best[0] > SURE:
            break
    return best


def _slopes(t, x, width):
    """Velocities over so many rows, (n, d), and their errors in those of a place, (n,)."""
    window = np.lib.stride_tricks.sliding_window_view
    t, x = window(t, width), window(x, width, axis=0)  # (n, w), (n, d, w)
    t = t - t.mean(axis=1, keepdims=True)
    size = np.square(t).sum(axis=1)
    return np.einsum("nw,ndw->nd", t, x) / size[:, None], 1 / np.sqrt(size)
