"""Periods that are one to who looks at a star once a day.

A sine that is seen at one hour of the night is also one whose rate is less or more by a turn a day
(Dawson & Fabrycky 2010): where such a rate follows velocities nearly as well, which of the two
periods it is stays open.
"""

import numpy as np

from bsp_gp.data.ephemeris import DAY_S
from bsp_gp.fitting.parts.orbits import Orbit
from bsp_gp.loop.proposers.orbits import SIDEREAL_DAY

N_NEAR = 41
"""Rates within a turn of the recording on either side of one, at which it is looked for."""


def has_alias(found, orbit, separation):
    """Whether another period that looks alike follows velocities nearly as well.

    Parameters
    ----------
    found : Fit
        Of velocities along the line of sight.
    orbit : Orbit
        One of its law; all others stay as they are.
    separation : float
        Chi-squared up to which it does.
    """
    channels, law = found.channels, found.law
    whitener = found.noise.whitener(channels)
    times = np.where(channels.seen, channels.times, orbit.epoch)
    zeros = [np.broadcast_to(channels.scene == s, times.shape) for s in np.unique(channels.scene)]

    def whitened(rows):
        rows = np.where(channels.seen, np.nan_to_num(np.stack(rows)), 0.0)
        return whitener.whiten(rows).reshape(len(rows), -1)

    velocity = found.residual + orbit.added(times, law.constants)[0]
    (target,) = whitened([velocity])

    def left(rate):
        harmonics = (1,) if orbit.is_circle else (1, 2)
        angles = [n * rate * (times - orbit.epoch) for n in harmonics]
        basis = whitened([*map(np.cos, angles), *map(np.sin, angles), *zeros]).T
        return np.square(target - basis @ np.linalg.lstsq(basis, target, rcond=None)[0]).sum()

    own = [part for part in law.frame if isinstance(part, Orbit)]
    rates = {part: 2 * np.pi / law.constants[part.names[0]] for part in own}
    rate, turn = rates.pop(orbit), 2 * np.pi / np.ptp(times[channels.seen])
    near = turn * np.linspace(-1.0, 1.0, N_NEAR)
    least = min(left(rate + step) for step in near)
    days = 2 * np.pi / np.array([SIDEREAL_DAY, DAY_S])
    others = np.abs([rate + way * day for day in days for way in (-1, 1)])
    others = [r for r in others if r > 2 * turn and min(
        (abs(r - known) for known in rates.values()), default=np.inf
    ) > turn]  # fmt: skip
    return any(left(r + step) - least < separation for r in others for step in near)
