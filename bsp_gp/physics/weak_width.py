"""The width of the test functions of the weak form, from the tracks alone.

What the test functions of one width see of the tracks is their whitened energy: about one for
every function that sees noise alone, more where there is a force. Of widths in a geometric series
the one with the greatest energy less 2 for every function is taken, which is Mallows' Cp (1973,
Technometrics 15, 661) of the motion in that space: the corner between signal and noise. Impulses,
which have energy at all frequencies, make it narrow by themselves.
"""

from dataclasses import dataclass

import numpy as np

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.scene import Entity, Scene
from bsp_gp.physics.weak_tracks import seen_through

RATIO = 2**0.5
"""Between the widths that are tried."""


@dataclass(frozen=True)
class Widths:
    """Reach of the test functions of a regression, and how it was chosen.

    Attributes
    ----------
    seconds : float
        At most the length of the longest track.
    rows : float
        The same in usual (median) time steps.
    spacing : float
        Between knots, s; 0: one test function for every row.
    n_functions : int
        Independent test functions of all tracks and axes: the rows that count.
    tried : tuple of (float, float)
        Spacing and criterion of every width tried; empty where the width was given.
    """

    seconds: float
    rows: float
    spacing: float
    n_functions: int
    tried: tuple = ()

    def text(self):
        """One line for a report."""
        how = "chosen by the energy above the noise" if self.tried else "as given"
        return (
            f"test functions of {self.seconds:.3g} s ({self.rows:.3g} rows), {how}: "
            f"{self.n_functions} independent ones"
        )


def choose_spacing(series, step, is_measured=False):
    """Choose the spacing of the knots; see the module.

    Parameters
    ----------
    series : list of tuple
        Tracks of a kind: times (T,), runs, sigma (T,), values (T, k).
    step : float
        Usual time step, s.
    is_measured : bool
        Whether the values are velocities.

    Returns
    -------
    spacing : float
        s; 0: one test function for every row.
    tried : tuple of (float, float)
        Spacing and criterion, less that of the narrowest.
    """
    longest = max((np.nanmax(times) - np.nanmin(times) for times, *_ in series), default=step)
    n_ratios = int(np.log(max(longest / 2 / step, 1.0)) / np.log(RATIO))
    candidates = [0.0, *(step * RATIO ** np.arange(1, n_ratios + 1)).tolist()]
    costs = np.zeros(len(candidates))
    for k, spacing in enumerate(candidates):
        for times, runs, sigma, values in series:
            seen = seen_through(times, runs, spacing, sigma, values, is_measured)
            costs[k] += 2.0 * seen.size - float(np.square(seen).sum())
    costs -= costs[0]
    best = int(np.flatnonzero(costs <= costs.min())[-1])
    return candidates[best], tuple(zip(candidates, costs.tolist(), strict=True))


def estimated_level(batches, is_measured=False):
    """Noise of the positions (or of the measured velocities) per axis, from the tracks."""
    scenes = []
    for batch in batches:
        values = batch.velocities if is_measured else batch.positions
        for s, index in np.ndindex(values.shape[1], values.shape[2]):
            rows = np.isfinite(values[:, s, index]).all(axis=-1) & np.isfinite(batch.times[:, s])
            if index in batch.bodies.receivers and rows.sum() >= 3:
                track = values[rows, s, index][:, None]
                body = (Entity("body"),)
                scenes.append(Scene(f"{len(scenes)}", batch.times[rows, s], track, body))
    # Without any track there is nothing to choose by, as the weak form will say.
    return np.array(estimate_noise(scenes).sigma) if scenes else np.array(1.0)
