"""Tracks grown from where they are seen best, row by row, each row foreseen from those before.

Where rows are coarse a state between them cannot be read off the data: an orbit that is seen four
times in a turn may pass its centre between two of them. A few rows that lie close together begin;
then the track is predicted to the next rows, and fitted again with them.
"""

import numpy as np

from bsp_gp.fitting.least_squares import minimise
from bsp_gp.fitting.problem import Settings
from bsp_gp.fitting.shooting import Shooting, cut_windows
from bsp_gp.fitting.tracks import ChainNoise, TrackPoint, TrackProblem
from bsp_gp.physics.engine.flow import Flow

SEED_ROWS = 5
RANKS = 3
"""Pieces that are tried where a chain begins."""
GROWTH = 0.35
"""Rows that are foreseen at once, as a part of those that are fitted; fewer where the track is
lost with so many."""
LEADING = Settings(absolute=1e-2, max_linearised=15, last_steps=0)
CLEAR = 9.0
"""Mean square of changes of velocity, in that of their noise, from which a piece shows a force."""
UNSEEN = 1e5
"""Turn of a piece of which too few rows were seen, as of a track that is cut after two."""
ENOUGH = 2
"""Trials that follow their rows, after which no more are made."""
CALM = 1.5
"""Chains whose piece turns up to so many times as much as the calmest find the constants first."""
JOININGS = 3
"""Descents with the nodes joined in between, where one does not converge."""
COARSE = 0.01
"""Error of one interval on the way, in standard deviations of a position."""
MAX_STEPS = 150
"""Steps within one interval on the way: where it takes more, a track is lost."""
GOOD = 5.0
"""Standard deviations above its mean up to which chi-squared of a seed is that of noise."""
LOST = 1e3
"""Chi-squared per row from which a track that was followed before is lost."""


def seeds(chains, noise, rows, rank=0):
    """Where each chain begins: the piece of so many rows that turns least, or the next ones.

    Parameters
    ----------
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
    if size < 3:
        return np.full(n - size + 1, UNSEEN)
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
    turn = np.where(whole, turn, UNSEEN)
    return np.where(np.isfinite(turn), turn, 1e6)


def tried(climb, points, ranks):
    """Which starts and seeds follow the first rows best: (chi-squared, point, rank), best first."""
    out, seen, n_good = [], [], 0
    for rank in ranks:
        places = [_calmest(climb, k, rank) for k in range(len(climb.run.groups))]
        key = [(first.tolist(), stop.tolist()) for first, stop in places]
        if key in seen:
            continue
        seen.append(key)
        n_rows = _coordinates(climb, places)
        for number, point in enumerate(points):
            if out and (climb.run.is_over() or n_good >= ENOUGH):
                break
            nodes = [own.copy() for own in point.nodes]
            values, chisqr, _ = _fit_rows(climb, point.values, nodes, places, climb.ridge(point))
            out.append((chisqr, number, rank, TrackPoint(values, tuple(nodes))))
            n_good += chisqr < n_rows + GOOD * np.sqrt(2 * n_rows)
    out.sort(key=lambda trial: trial[:3])
    return [(chisqr, point, rank) for chisqr, _, rank, point in out]


def _coordinates(climb, places):
    """Coordinates that were seen in some rows."""
    count = 0
    for noise, (first, stop) in zip(climb.noises, places, strict=True):
        seen = np.isfinite(noise.variance)
        for s, (a, b) in enumerate(zip(first, stop, strict=True)):
            count += int(seen[a:b, s].sum())
    return count


def _calmest(climb, group, rank):
    """Seeds of the chains of a group that turn least; the others are empty."""
    chains, noise = climb.run.groups[group], climb.noises[group]
    first, stop, turn = seeds(chains, noise, SEED_ROWS, rank)
    return first, np.where(turn <= CALM * turn.min(), stop, first)


def grow(climb, point, rank=0):
    """Fit ever more rows of the calmest chains, then of the others, from `seeds` to the whole.

    Nodes behind a place where the track was lost are as they were.
    """
    run = climb.run
    nodes = [own.copy() for own in point.nodes]
    values, ridge = point.values, climb.ridge(point)
    places = [_calmest(climb, k, rank) for k in range(len(nodes))]
    followed, share = None, GROWTH
    while True:
        values, chisqr, _ = _fit_rows(climb, values, nodes, places, ridge)
        n_rows = sum(int((stop - first).sum()) for first, stop in places)
        is_lost = not chisqr < LOST * n_rows
        if is_lost and followed is not None:
            longest = max(int((stop - first).max()) for first, stop in followed[2])
            is_single = share * longest < 1
            values, kept, places = followed
            nodes, share = [own.copy() for own in kept], share / 2
        else:
            is_single = True
        if run.is_over() or (is_lost and is_single):
            return TrackPoint(values, tuple(nodes))
        if not is_lost:
            followed = values, [own.copy() for own in nodes], places
            share = min(2 * share, GROWTH)
        if not _is_whole(places, run.groups, begun=True):
            places = _foresee(climb, values, nodes, places, share)
        elif not _is_whole(places, run.groups, begun=False):
            followed = None
            _begin_next(climb, values, nodes, places)
        else:
            return TrackPoint(values, tuple(nodes))


def _is_whole(places, groups, begun):
    """Whether all rows are in, of all chains or of those that have begun."""
    for (first, stop), chains in zip(places, groups, strict=True):
        whole = (first == 0) & (stop == chains.lengths)
        if not np.all(whole | ((stop == first) & begun)):
            return False
    return True


def _begin_next(climb, values, nodes, places):
    """Put in seeds of the calmest chains that have not begun, as many as have: each where it fits.

    The constants are those that the chains before have found.
    """
    waiting, n_begun = [], 0
    for group, ((first, stop), chains, noise) in enumerate(
        zip(places, climb.run.groups, climb.noises, strict=True)
    ):
        turn = seeds(chains, noise, SEED_ROWS)[2]
        waiting += [(turn[s], group, s) for s in np.flatnonzero(first == stop)]
        n_begun += int((first < stop).sum())
    chosen = [(group, s) for _, group, s in sorted(waiting)[:n_begun]]
    best = {}
    for rank in range(RANKS):
        pieces = [
            seeds(chains, noise, SEED_ROWS, rank)[:2]
            for chains, noise in zip(climb.run.groups, climb.noises, strict=True)
        ]
        alone = [(np.zeros_like(f), np.zeros_like(f)) for f, _ in places]
        for group, s in chosen:
            alone[group][0][s], alone[group][1][s] = (each[s] for each in pieces[group])
        own = [part.copy() for part in nodes]
        *_, heights = _fit_rows(climb, values, own, alone, None, is_held=True)
        for group, s in chosen:
            if (group, s) not in best or heights[group, s] < best[group, s][0]:
                begun = alone[group][0][s], alone[group][1][s], own[group][..., s]
                best[group, s] = heights[group, s], *begun
    for (group, s), (_, first, stop, states) in best.items():
        nodes[group][..., s] = states
        places[group][0][s], places[group][1][s] = first, stop


def _fit_rows(climb, values, nodes, places, ridge, is_held=False):
    """Fit the rows between `places`: values, chi-squared, and that of every chain.

    Chains go by the numbers of their group and their own. Nodes are changed in place, constants
    stay where `is_held`; inf stands for what is not followed.
    """
    run = climb.run
    begun = [
        (number, *group)
        for number, group in enumerate(
            zip(run.motions, climb.noises, places, nodes, strict=True)
        )
        if (group[2][1] > group[2][0]).any()
    ]  # fmt: skip
    shootings, own = [], []
    for _, whole, noise, (first, stop), full in begun:
        chains = whole.chains
        cut = chains.cut(first, stop)
        coarse = np.maximum(climb.tolerance(chains, noise), COARSE * climb.sigma(noise))
        motion = whole.on(cut, run.law)
        flow = Flow(motion, coarse, max_steps=MAX_STEPS, is_over=run.is_over)
        rows = first + np.arange(cut.times.shape[0])[:, None]
        rows = np.clip(rows, 0, np.maximum(stop - 1, 0))
        chain = np.arange(chains.n_chains)
        variance = noise.variance[rows, chain] + np.square(noise.amplitude[rows, chain])
        variance[~np.isfinite(cut.times)] = np.nan
        shootings.append(Shooting(flow, ChainNoise(cut.times, variance), cut_windows(cut.lengths)))
        own.append(full[..., rows, chain])
    low, high = (values, values) if is_held else (run.low, run.high)
    problem = TrackProblem(shootings, (None,) * len(own), climb.coordinates, ridge)
    point = problem.upon(np.clip(values, low, high), tuple(own))
    problem = problem.with_meshes(point)
    for _ in range(JOININGS):
        minimum = minimise(
            problem, point, low=low, high=high, settings=LEADING, is_over=run.is_over
        )
        if minimum.code not in ("stalled", "limit") or minimum.linearised is None:
            break
        point = problem.settled(minimum.point, 2)  # gaps between nodes hold the descent up
    heights, seen = {}, minimum.linearised
    blocks = None if seen is None else problem.split(seen.by_block(seen.residual) + seen.rests)
    for k, ((number, _, _, (first, stop), full), new) in enumerate(
        zip(begun, minimum.point.nodes, strict=True)
    ):
        for s in range(len(first)):
            full[..., first[s] : stop[s], s] = new[..., : stop[s] - first[s], s]
            heights[number, s] = np.inf
        if blocks is not None:
            for block, s in enumerate(shootings[k].windows.chain.tolist()):
                heights[number, s] = float(blocks[k][block])
    return minimum.values, float(minimum.chisqr), heights


def _foresee(climb, values, nodes, places, share):
    """Put the nodes of the next rows, before and behind, where the track is predicted to be."""
    constants, _ = climb.coordinates.constants(values)
    out = []
    for flow, full, chains, (first, stop) in zip(
        climb.flows, nodes, climb.run.groups, places, strict=True
    ):
        flow.motion.set_constants(constants)
        first, stop = first.copy(), stop.copy()
        more = np.maximum(1, (share * (stop - first)).astype(int))
        for step in range(int(more.max())):
            for way in (1, -1):
                source = stop - 1 if way > 0 else first
                target = source + way
                has_begun = (step < more) & (stop > first)
                open_ = np.flatnonzero(has_begun & (target >= 0) & (target < chains.lengths))
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
