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

__all__ = ["grow", "seeds"]

SEED_ROWS = 5
GROWTH = 0.35
"""Rows that are foreseen at once, as a part of those that are fitted."""
LEADING = Settings(absolute=1e-2, max_linearised=15, last_steps=0)


def seeds(chains, rows, rank=0):
    """Where each chain begins: the piece of so many rows of the shortest span, or the next ones.

    Parameters
    ----------
    chains : Chains
    rows : int
    rank : int
        0 for the best piece, 1 for the best that shares no row with it, and so on.

    Returns
    -------
    first, stop : ndarray of int, shape (S,)
    """
    first, stop = [], []
    for s in range(chains.n_chains):
        n = int(chains.lengths[s])
        size = min(rows, n)
        times = chains.times[:n, s]
        seen = np.isfinite(chains.observed[:n, s]).all(axis=(1, 2))
        span = times[size - 1 :] - times[: n - size + 1]
        count = np.convolve(seen, np.ones(size), mode="valid")
        span = np.where(count >= size, span, span + times[-1] - times[0])
        for _ in range(rank):
            best = int(np.argmin(span))
            near = np.abs(np.arange(len(span)) - best) < size
            if near.all():
                break
            span = np.where(near, np.inf, span)
        best = int(np.argmin(span))
        first.append(best)
        stop.append(best + size)
    return np.array(first), np.array(stop)


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
        With nodes at all rows.
    """
    run = climb.run
    nodes = [own.copy() for own in point.nodes]
    values = point.values
    places = [seeds(chains, SEED_ROWS, rank) for chains in run.groups]
    whole = [chains.lengths for chains in run.groups]
    ridge = climb.ridge(point)
    while True:
        values = _fit_rows(climb, values, nodes, places, ridge)
        done = all(
            np.all((first == 0) & (stop == n))
            for (first, stop), n in zip(places, whole, strict=True)
        )
        if done or run.is_over():
            return TrackPoint(values, tuple(nodes))
        places = _foresee(climb, values, nodes, places)


def _fit_rows(climb, values, nodes, places, ridge):
    """Fit the rows between `places`; their nodes are changed in place."""
    run = climb.run
    shootings, own = [], []
    for chains, noise, (first, stop), full in zip(
        run.groups, climb.noises, places, nodes, strict=True
    ):
        cut = chains.cut(first, stop)
        flow = Flow(Motion(run.law, cut, run.parameters), climb.tolerance(chains, noise))
        rows = first + np.arange(cut.times.shape[0])[:, None]
        rows = np.minimum(rows, stop - 1)
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
    return minimum.values


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
