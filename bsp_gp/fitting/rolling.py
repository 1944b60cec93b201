"""Tracks that a law gives from known initial states.

Every row is given a state from the data first; then all intervals are integrated at once and the
states are corrected, by the derivatives of all intervals together, until each follows from the one
before (Newton's method on the joints). Where that fails - motion that runs away or is chaotic -
shorter stretches are taken, down to one row after the other.
"""

from copy import copy

import numpy as np

from bsp_gp.fitting.starts import first_nodes
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion

JOINED = 1e-3
"""Largest correction of a place at which a stretch is joined, in errors that it may have."""
MOST_PASSES = 12
SLOWEST = 0.3
"""Least factor by which a correction must shrink after the first few."""


def roll(law, chains, first, tolerance, paper_steps=False):
    """Roll a law out over all rows of some chains.

    States (2, R, d, T, S) at every row are inf from where a motion leaves the range of numbers.

    Parameters
    ----------
    first : ndarray, shape (2, R, d, S)
        States at the first row.
    tolerance : ndarray, shape (S,), metres
        Error that a whole track may have.
    """
    flow = flow_of(law, chains, tolerance, paper_steps)
    nodes = first_nodes(chains)
    nodes[..., 0, :] = first
    nodes = flow.held(nodes)
    last = chains.times.shape[0] - 1
    row, length = 0, 1 if paper_steps else max(last, 1)
    while row < last:
        stop = min(row + length, last)
        leg = _leg(flow, nodes, row, stop)
        if not leg.n_intervals:  # every track has ended, or run away
            break
        if stop - row > 1:
            joined = _joined(leg, nodes, row, stop, tolerance)
            if joined is None:
                length = max(length // 4, 1)
                continue
            nodes = joined
        else:
            _one_row(leg, nodes)
        row, length = stop, length if paper_steps else 2 * length
    with np.errstate(invalid="ignore"):
        lost = ~np.isfinite(nodes).all(axis=(0, 1, 2)) & np.isfinite(chains.times)
    lost = np.logical_or.accumulate(lost, axis=0)
    return np.where(lost, np.inf, nodes)


def flow_of(law, chains, tolerance, paper_steps=False):
    """A law with values, ready to move chains; parameters as of `roll`."""
    motion = Motion(law, chains, ())
    motion.set_constants(np.zeros(0))
    return Flow(motion, tolerance / np.maximum(chains.lengths, 1), paper_steps)


def _leg(flow, nodes, row, stop):
    """The intervals of some rows, of chains that have not run away."""
    leg = copy(flow)
    alive = np.isfinite(nodes[..., row, :]).all(axis=(0, 1, 2))
    mine = (flow.row >= row) & (flow.row < stop) & alive[flow.chain]
    leg.row, leg.chain = flow.row[mine], flow.chain[mine]
    leg.start, leg.length = flow.start[mine], flow.length[mine]
    for s in np.flatnonzero(~alive):
        nodes[..., row + 1 : stop + 1, s] = np.nan
    return leg


def _one_row(leg, nodes):
    """Put the next row's states where the motion comes to, in place; nan where it does not."""
    here, there = (leg.row, leg.chain), (leg.row + 1, leg.chain)
    if leg.paper_steps:
        ends, _ = leg.run(nodes, leg.mesh(nodes), slopes=False)
    else:
        with np.errstate(all="ignore"):
            ends = leg.advance(nodes[(..., *here)], leg.chain, leg.start, leg.start + leg.length)
    nodes[(..., *there)] = np.where(np.isfinite(ends), ends, np.nan)


def _joined(leg, nodes, row, stop, tolerance):
    """Nodes of which each follows from the one before; None if that is not achieved."""
    n = leg.n_state
    number = np.full(leg.chains.times.shape, -1)
    number[leg.row, leg.chain] = np.arange(leg.n_intervals)
    before, mesh = np.inf, None
    has_jumps = bool(leg.has_events or leg.motion.walls)  # whose instants belong to their steps
    nodes = nodes.copy()
    for count in range(MOST_PASSES):
        with np.errstate(all="ignore"):
            if mesh is None or has_jumps:
                mesh = leg.mesh(nodes)
            if not mesh.is_complete:
                return None
            ends, moved = leg.run(nodes, mesh)
        gaps = (ends - nodes[..., leg.row + 1, leg.chain]).reshape(n, -1).T
        change = np.zeros((stop - row + 1, nodes.shape[-1], n))
        for k in range(stop - row):
            chain = np.flatnonzero(number[row + k] >= 0)
            at = number[row + k, chain]
            with np.errstate(all="ignore"):
                change[k + 1, chain] = (moved[at] @ change[k, chain, :, None])[..., 0] + gaps[at]
        if not np.isfinite(change).all():
            return None
        shaped = np.moveaxis(change, -1, 0).reshape(*nodes.shape[:3], stop - row + 1, -1)
        nodes[..., row : stop + 1, :] += shaped
        nodes = leg.held(nodes)
        size = float((np.abs(shaped[0]).max(axis=(0, 1)) / tolerance).max())
        if size <= JOINED:  # with steps chosen where the tracks were before
            finer = None if has_jumps else leg.mesh(nodes)
            if has_jumps or mesh.is_as_fine_as(finer):
                return nodes
            mesh, before = finer, np.inf
            continue
        if count > 2 and size > SLOWEST * before:
            # What is left is rounding, or there is no way there.
            return nodes if size <= 1.0 else None
        before = size
    return None
