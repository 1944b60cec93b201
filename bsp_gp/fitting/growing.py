"""Tracks grown from where they are seen best, row by row, each row foreseen from those before.

Where rows are coarse a state between them cannot be read off the data: an orbit that is seen four
times in a turn may pass its centre between two of them. A few rows that lie close together begin;
then the track is predicted to the next rows, and fitted again with them.
"""

from __future__ import annotations

import numpy as np

from bsp_gp.fitting.flow import Flow
from bsp_gp.fitting.least_squares import minimise
from bsp_gp.fitting.motion import Motion
from bsp_gp.fitting.problem import Settings
from bsp_gp.fitting.shooting import Shooting, cut_windows
from bsp_gp.fitting.tracks import ChainNoise, TrackPoint, TrackProblem

__all__ = ["grow", "seeds", "tried"]

SEED_ROWS = 5
GROWTH = 0.35
"""Rows that are foreseen at once, as a part of those that are fitted."""
LEADING = Settings(absolute=1e-2, max_linearised=15, last_steps=0)
CLEAR = 9.0
"""Mean square of changes of velocity, in that of their noise, from which a piece shows a force."""
CALM = 1.5
"""Chains whose piece turns up to so many times as much as the calmest find the constants first."""
LOST = 1e3
"""Chi-squared per row from which a track that was followed before is lost."""


def seeds(chains, noise, rows, rank=0):
    """Where each chain begins: the piece of so many rows that turns least, or the next ones.

    Parameters
    ----------
    chains : Chains
    noise : ChainNoise
    rows : int
    rank : int
        0 for the best piece, 1 for the best that shares no row with it, and so on.

    Returns
    -------
    first, stop : ndarray of int, shape (S,)
    turn : ndarray, shape (S,)
        Change of the velocity from row to row, in velocities.
    """
    first, stop, turns = [], [], []
    for s in range(chains.n_chains):
        n = int(chains.lengths[s])
        size = min(rows, n)
        score = _turns(chains, noise, s, n, size)
        for _ in range(rank):
            near = np.abs(np.arange(len(score)) - int(np.argmin(score))) < size
            if near.all():
                break
            score = np.where(near, np.inf, score)
        best = int(np.argmin(score))
        first.append(best)
        stop.append(best + size)
        turns.append(float(score[best]))
    return np.array(first), np.array(stop), np.array(turns)


def _turns(chains, noise, s, n, size):
    """How much each piece of a chain turns from row to row; pieces that show no force behind."""
    times, x = chains.times[:n, s], chains.observed[:n, s].reshape(n, -1)
    variance = noise.variance[:n, s].reshape(n, -1)
    steps = np.diff(times)[:, None]
    velocity, error = np.diff(x, axis=0) / steps, (variance[1:] + variance[:-1]) / steps**2
    change, wrong = np.square(np.diff(velocity, axis=0)), error[1:] + error[:-1]
    seen = np.isfinite(x).all(axis=1)

    def mean(values, width):
        total = np.concatenate([[0.0], np.cumsum(np.nansum(values, axis=1))])
        return (total[width:] - total[:-width]) / width

    changes, errors = mean(change, size - 2), mean(wrong, size - 2)
    sizes = mean(np.square(velocity), size - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        turn = np.sqrt(changes / sizes)
        turn = np.where(changes > CLEAR * errors, turn, 10.0 + np.sqrt(errors / changes))
    whole = np.convolve(seen, np.ones(size), mode="valid") >= size
    turn = np.where(whole, turn, 100.0)
    return np.where(np.isfinite(turn), turn, 1e6)


def tried(climb, points, ranks):
    """Which starts and seeds follow the first rows best: (chi-squared, point, rank), best first."""
    out = []
    for rank in ranks:
        for number, point in enumerate(points):
            if out and climb.run.is_over():
                break
            nodes = [own.copy() for own in point.nodes]
            places = [_calmest(climb, k, rank) for k in range(len(nodes))]
            values, chisqr = _fit_rows(climb, point.values, nodes, places, climb.ridge(point))
            out.append((chisqr, number, rank, TrackPoint(values, point.nodes)))
    out.sort(key=lambda trial: trial[:3])
    return [(chisqr, point, rank) for chisqr, _, rank, point in out]


def _calmest(climb, group, rank):
    """Seeds of the chains of a group that turn least; the others are empty."""
    chains, noise = climb.run.groups[group], climb.noises[group]
    first, stop, turn = seeds(chains, noise, SEED_ROWS, rank)
    return first, np.where(turn <= CALM * turn.min(), stop, first)


def grow(climb, point, rank=0):
    """Fit ever more rows of every chain, from a seed to the whole.

    Parameters
    ----------
    climb : Climb
    point : TrackPoint
        Constants to begin with, and nodes read off the data.
    rank : int
        Which seeds, see `seeds`.

    Returns
    -------
    TrackPoint
        With nodes at all rows; those behind a place where the track was lost as they were.
    """
    run = climb.run
    nodes = [own.copy() for own in point.nodes]
    values = point.values
    places = [
        seeds(chains, noise, SEED_ROWS, rank)[:2]
        for chains, noise in zip(run.groups, climb.noises, strict=True)
    ]
    ridge = climb.ridge(point)
    while True:
        values, chisqr = _fit_rows(climb, values, nodes, places, ridge)
        n_rows = sum(int((stop - first).sum()) for first, stop in places)
        is_done = all(
            np.all((first == 0) & (stop == chains.lengths))
            for (first, stop), chains in zip(places, run.groups, strict=True)
        )
        if is_done or run.is_over() or not chisqr < LOST * n_rows:
            return TrackPoint(values, tuple(nodes))
        places = _foresee(climb, values, nodes, places)


def _fit_rows(climb, values, nodes, places, ridge):
    """Fit the rows between `places`; their nodes are changed in place.

    Returns
    -------
    values : ndarray, shape (k,)
    chisqr : float
    """
    run = climb.run
    shootings, own = [], []
    for chains, noise, (first, stop), full in zip(
        run.groups, climb.noises, places, nodes, strict=True
    ):
        cut = chains.cut(first, stop)
        flow = Flow(Motion(run.law, cut, run.parameters), climb.tolerance(chains, noise))
        rows = first + np.arange(cut.times.shape[0])[:, None]
        rows = np.clip(rows, 0, np.maximum(stop - 1, 0))
        chain = np.arange(chains.n_chains)
        variance = noise.variance[rows, chain] + np.square(noise.amplitude[rows, chain])
        variance[~np.isfinite(cut.times)] = np.nan
        shootings.append(Shooting(flow, ChainNoise(cut.times, variance), cut_windows(cut.lengths)))
        own.append(full[..., rows, chain])
    point = TrackPoint(values, tuple(own))
    problem = TrackProblem(shootings, (None,) * len(own), climb.coordinates, ridge)
    problem = problem.with_meshes(point)
    low, high = climb.box
    minimum = minimise(problem, point, low=low, high=high, settings=LEADING, is_over=run.is_over)
    for full, new, chains, (first, stop) in zip(
        nodes, minimum.point.nodes, run.groups, places, strict=True
    ):
        for s in range(chains.n_chains):
            full[..., first[s] : stop[s], s] = new[..., : stop[s] - first[s], s]
    return minimum.values, float(minimum.chisqr)


def _foresee(climb, values, nodes, places):
    """Put the nodes of the next rows, before and behind, where the track is predicted to be."""
    constants, _ = climb.coordinates.constants(values)
    out = []
    for flow, full, chains, (first, stop) in zip(
        climb.flows, nodes, climb.run.groups, places, strict=True
    ):
        flow.motion.set_constants(constants)
        first, stop = first.copy(), stop.copy()
        more = np.maximum(1, (GROWTH * (stop - first)).astype(int))
        for step in range(int(more.max())):
            for way in (1, -1):
                source = stop - 1 if way > 0 else first
                target = source + way
                open_ = np.flatnonzero(
                    (step < more) & (target >= 0) & (target < chains.lengths)
                )
                if not len(open_):
                    continue
                row, goal = source[open_], target[open_]
                state = flow.advance(
                    full[..., row, open_], open_, chains.times[row, open_],
                    chains.times[goal, open_],
                )  # fmt: skip
                good = np.isfinite(state).all(axis=(0, 1, 2))
                full[..., goal[good], open_[good]] = state[..., good]
                if way > 0:
                    stop[open_] += 1
                else:
                    first[open_] -= 1
        out.append((first, stop))
    return out
