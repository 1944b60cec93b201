"""Five visible discs, and a heavy one at rest that no camera sees; made by scipy's DOP853."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.split import choose_split
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.proposers.hidden import Hidden
from bsp_gp.units import UnitSystem

GRAVITY = "1 [m^3/kg/s^2] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
UNITS = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
ALPHA = 0.01
HIDDEN_MASS = 5.0
BOX = 5.0
NEAREST = 0.5
"""Tracks on which two bodies come nearer are drawn anew: a camera sees discs, not singularities."""


def discs(seed, hidden=True, *, noise=0.01, n_times=100, duration=4.0, n_dims=2):
    """One scene of five discs that attract one another, for four seconds.

    Parameters
    ----------
    seed : int
    hidden : bool
        Whether a body of `HIDDEN_MASS` kg at rest pulls them as well.
    noise : float
        Standard deviation of the positions, as a part of the width of the scene.

    Returns
    -------
    dataset : Dataset
    place : ndarray, shape (d,)
    """
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, duration, n_times)
    while True:
        masses = rng.uniform(0.2, 1.0, 5)
        place = rng.uniform(-BOX, BOX, n_dims)
        start = np.stack([rng.uniform(-BOX, BOX, (5, n_dims)), rng.uniform(-1, 1, (5, n_dims))])
        p = _tracks(start, place, np.append(masses, HIDDEN_MASS if hidden else 0.0), times)
        if p is not None:
            break
    p = p + noise * np.ptp(p, axis=(0, 1)).max() * rng.standard_normal(p.shape)
    entities = [
        Entity(f"disc{k}", "disc", radius=0.1, properties={"mass": m}) for k, m in enumerate(masses)
    ]
    return Dataset(f"discs {seed}", (Scene("film", times, p, entities),), units=UNITS), place


class Sought(NamedTuple):
    """What a search for a hidden body says.

    Attributes
    ----------
    is_claimed : bool
    p_value : float
        Of everything that was tried.
    error : float
        Of the place, in posterior standard deviations; nan where nothing stood out.
    gap : float
        Of the place, metres.
    """

    is_claimed: bool
    p_value: float
    error: float
    gap: float


def sought(seed, hidden):
    """Look for a hidden body in the scene of a seed, without other proposers to compare with."""
    dataset, place = discs(seed, hidden)
    split_rng, rng = np.random.default_rng(seed).spawn(2)
    train = replace(dataset, scenes=choose_split(dataset, split_rng).learned, train=(), test=())
    hypothesis = Hypothesis.from_laws(train, [GRAVITY])
    (done,) = run_rounds(hypothesis, train, [Hidden()], rng=rng, max_rounds=1)
    p_value, details = done.table.p_value, done.details
    if not details:
        return Sought(False, p_value, np.nan, np.nan)
    spread = np.array(details["draws"])[:, :2].std(axis=0)
    gap = np.linalg.norm(np.array(details["best"][:2]) - place)
    error = gap / np.linalg.norm(spread)
    return Sought(done.decision.is_adopted, float(p_value), float(error), float(gap))


def _tracks(start, place, pulls, times):
    """Positions (T, N, d), or None where two bodies come too near."""

    def gaps(p):
        gap = np.vstack([p, place])[None] - p[:, None]
        return gap, np.linalg.norm(gap, axis=-1) + np.eye(len(p), len(p) + 1)

    def motion(t, state):
        p, v = state.reshape(start.shape)
        gap, r = gaps(p)
        a = np.einsum("j,ijd->id", pulls, gap / r[..., None] ** 3)
        return np.concatenate([v.ravel(), a.ravel()])

    def nearness(t, state):
        _, r = gaps(state.reshape(start.shape)[0])
        return (r + 1e9 * np.eye(*r.shape)).min() - NEAREST

    nearness.terminal = True
    if nearness(0.0, start.ravel()) < 0:
        return None
    track = solve_ivp(
        motion, (0, times[-1]), start.ravel(), method="DOP853", t_eval=times, rtol=1e-10,
        atol=1e-10, events=nearness,
    )  # fmt: skip
    if track.status != 0:
        return None
    return track.y.T.reshape(len(times), *start.shape)[:, 0]
