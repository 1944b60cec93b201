"""Defects: swapped or lost tracks, single rows that are off, frames missing or repeated.

All but swaps are read off the residual by deletion: how much chi-squared falls if rows are left
out and the initial states of their chain are fitted again. What is left out is paid for.
"""

from dataclasses import dataclass

import numpy as np

from bsp_gp.data.parts import rows_of
from bsp_gp.fitting.channels import join
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.defects import LeftOut, Shifted
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.proposers.clocks import put_forward
from bsp_gp.loop.proposers.stuck import LEAST_KEPT, is_broken, stuck
from bsp_gp.loop.proposers.swaps import swaps
from bsp_gp.loop.proposers.untrimmed import ends_of, is_open

MOST_POINTS = 256
"""Rows of a track at which it may be lost or found again."""
MOST_NUMBERS = 2_000_000
"""In one work array."""
MOST_FRAMES = 4
"""That are missing or repeated at once."""
MOST_OFF, FEW_OFF = 0.05, 5
"""Part of the rows that may be off one by one, and how many may be of few."""
MOST_BREAKS = 64
"""Ends of tracks of which it is asked whether they break."""
WITHOUT_ENDS = ("lost_track", "untrimmed")
"""What leaves out so many rows on end that the rest may be no motion."""
MOVED, TINY = 12.0, np.finfo(float).tiny
"""Levels of the noise that what moves goes at the least; as many rows at rest scatter by less."""
FAR = ("swapped_tracks", "lost_track", "clock_jump", "untrimmed")
"""Beside which tracks were fitted that have little of the truth."""
DETERMINED = 1e-7
"""Least eigenvalue of what rows say of initial states, in that of all rows."""


class Defects:
    """Swapped and lost tracks, rows that are off, missing frames as a proposer."""

    name = "defects"
    asks_rows = True
    sees_places = True
    """Some defects show without a fit."""

    def propose(self, view):
        """The family of all rows and change-points."""
        if view.fit.is_failed:
            return self._family(view, [], [], np.zeros(2))
        windows, shifts, even, chains = [], {}, 0.0, list(chains_of(view))
        for chain in chains:
            for window in chain.windows():
                gains, best = window.gains()
                windows.append((window, gains))
                even = np.maximum(even, best)
            shifts.setdefault(chain.scene.name, []).append(chain)
        moved = [_shift(chains) for chains in shifts.values()]
        for *_, gains in moved:
            even = np.maximum(even, gains)
        return self._family(view, windows, moved, even, chains)

    def _family(self, view, windows, moved, even, chains=()):
        """The family, with what places tell without a fit."""
        n_tried = sum(len(w.first) for w, _ in windows) + sum(len(m[0].times) for m in moved)
        parts, excess, swapped, n_swaps = swaps(view)
        still, theirs, stands = stuck(view)
        closed, gained, jumps = put_forward(view)
        n_still = n_tried or rows_of(view.dataset.scenes)
        kinds = [
            ("swapped_tracks", parts, excess, n_swaps),
            ("lost_track", still, theirs, n_still),
            ("clock_jump", closed, gained, n_still),
        ]
        # What goes round in the sky is neither let go nor lands, and no film of it loses frames.
        asked = [] if view.is_sky else list(filter(is_open, chains))
        ends, bare, n_ends = _untrimmed(view, asked)
        if len(ends) > 1:  # one alone is a track that is lost
            kinds.append(("untrimmed", ends, bare, n_ends))
        if windows:
            kinds += [
                ("bad_row", *_rows(windows, n_tried), n_tried),
            ]
        if windows and not view.is_sky:
            kinds += [
                ("lost_track", *_lost(windows), n_tried),
                ("clock_jump", *_frames(moved), n_tried),
            ]
        kinds = [kind for kind in kinds if kind[1]]
        if any(code in WITHOUT_ENDS for code, *_ in kinds):
            kinds = [kind for kind in kinds if kind[0] not in WITHOUT_ENDS
                     or leave_motion(view.dataset, kind[1], view.scatter)]  # fmt: skip
        proposals = [proposal_of(view, *kind) for kind in kinds]
        proposals.sort(key=lambda p: -p.promise)
        gain = max(float(even[0]), swapped, stands, jumps)
        return Family(self.name, tuple(proposals), gain, 2, even[1:], n_tried=n_still)


@dataclass(eq=False)
class _Window:
    """Sets of rows of a body, or of all of a chain, each left out as one.

    ``sums`` turns what rows have, (..., T, k), into what the sets have, (..., K, k).
    """

    kind: str
    entity: str
    first: np.ndarray
    stop: np.ndarray
    sums: object
    chain: object
    used: np.ndarray

    def __post_init__(self):
        chain, own = self.chain, self.chain.local[:, :, self.used]
        seen = chain.seen[:, self.used]
        self.rank = self.sums(seen.sum(axis=1)[:, None].astype(float))[:, 0].astype(int)
        price = np.where(seen, np.log(chain.extent / chain.spread[:, self.used]), 0.0)
        self.price = self.sums((price - 0.5 * np.log(2 * np.pi) * seen).sum(axis=1)[:, None])[:, 0]
        q = len(own)
        taken = self.sums(np.einsum("itu,jtu->tij", own, own).reshape(-1, q * q))
        left = np.eye(q) - taken.reshape(-1, q, q)
        is_known = (np.linalg.eigvalsh(left)[:, :1] > DETERMINED).all(axis=1)
        self.is_able = (self.rank > 0) & is_known
        self.inverse = np.zeros_like(left)
        self.inverse[self.is_able] = np.linalg.inv(left[self.is_able])

    def gains(self):
        """Gains of the sets on the data, (K,), and the greatest as of pairs on all targets."""
        chain, own = self.chain, self.chain.local[:, :, self.used]
        targets = chain.targets[:, :, self.used]
        step, best, mine = max(MOST_NUMBERS // max(own.size, 1), 1), [], None
        for first in range(0, len(targets), step):
            part = targets[first : first + step]
            size = self.sums(np.square(part).sum(axis=2)[..., None])[..., 0]
            along = self.sums(np.einsum("itu,btu->bti", own, part))
            solved = np.swapaxes(along, 0, 1) @ self.inverse  # (K, b, q)
            gain = size + (np.swapaxes(solved, 0, 1) * along).sum(axis=2)
            gain = np.where(self.is_able, gain, 0.0)
            mine = gain[0] if mine is None else mine
            best.append(_even(gain, np.maximum(self.rank, 1)))
        return mine, np.concatenate(best)

    def part(self, k):
        """Set number k left out."""
        first, stop = int(self.first[k]), int(self.stop[k])
        return LeftOut(
            self.chain.scene.name, first, stop, self.entity,
            n_left_out=int(self.rank[k]), extent=self.chain.extent,
        )  # fmt: skip


def _even(gain, rank):
    """The least likely gain (B, K) of so many numbers (K,), as of two, (B,)."""
    # Which one: by cube roots, that are nearly normal (Wilson and Hilferty 1931).
    normal = (np.cbrt(gain / rank) - 1 + 2 / (9 * rank)) * np.sqrt(4.5 * rank)
    best = normal.argmax(axis=1)
    return as_pair(gain[np.arange(len(gain)), best], rank[best])


@dataclass(eq=False)
class _Chain:
    """Bodies of a scene whose initial states are fitted together; all (..., T, c).

    ``local`` are orthonormal whitened changes by initial states, ``targets`` the residual and
    draws of noise, ``moved`` whitened velocities.
    """

    scene: object
    names: np.ndarray
    local: np.ndarray
    targets: np.ndarray
    moved: np.ndarray
    seen: np.ndarray
    spread: np.ndarray

    def __post_init__(self):
        places = self.scene.positions
        low, high = np.nanmin(places, axis=(0, 1)), np.nanmax(places, axis=(0, 1))
        # Where nothing moves, noise is all that a scene shows.
        self.extent = float((high - low).max()) or float(np.max(self.spread))

    def windows(self):
        """Single rows, tails and heads of each body; rows of all bodies."""
        rows, names = np.arange(len(self.seen)), np.unique(self.names)
        count = int(self.seen.any(axis=1).nonzero()[0].max(initial=0)) + 1
        ends = np.arange(2, int(count * (1 - LEAST_KEPT)) + 1)  # a part is no single row
        ends = ends[:: -(-len(ends) // MOST_POINTS) or 1]
        starts, zero = count - ends, np.zeros_like(ends)

        def tails(values):
            return _later(values)[..., starts, :]

        def heads(values):
            return np.cumsum(values, axis=-2)[..., ends - 1, :]

        for name in names:
            used = self.names == name
            yield _Window("row", name, rows, rows + 1, lambda v: v, self, used)
            if len(ends):
                yield _Window("part", name, starts, zero + count, tails, self, used)
                yield _Window("part", name, zero, ends, heads, self, used)
        if len(names) > 1:
            yield _Window("row", "", rows, rows + 1, lambda v: v, self, self.names != "")

    def ends(self, name, heads, tails):
        """Heads and tails of a body left out together."""
        count = len(self.seen)

        def sums(values):
            total = np.concatenate(
                [np.zeros_like(values[..., :1, :]), np.cumsum(values, axis=-2)], axis=-2
            )
            return total[..., heads, :] + total[..., [count], :] - total[..., tails, :]

        return _Window("ends", name, heads, tails, sums, self, self.names == name)


def chains_of(view):
    """The chains of a view's fit, whose rows may be left out."""
    fit, tangent, channels = view.fit, view.tangent, view.fit.channels
    scenes = {scene.name: scene for scene in view.dataset.scenes}
    moved = join(np.moveaxis(n[1], (-2, -1), (0, 1)) for n in fit.nodes)
    moved = tangent.whitener.whiten(np.where(channels.seen, np.nan_to_num(moved), 0.0))
    names, first, height = np.array(channels.body_names), 0, len(channels.seen)
    targets = np.concatenate([tangent.residual[None], view.row_draws])
    for index, basis in zip(tangent.chains, tangent.own, strict=True):
        shape, stop = (-1, height, len(index)), first + height * len(index)
        yield _Chain(
            scenes[channels.scene_names[channels.scene[index[0]]]], names[channels.body[index]],
            basis.reshape(shape), targets[:, first:stop].reshape(shape), moved[:, index],
            tangent.whitener.seen[:, index], tangent.whitener.spread[:, index],
        )  # fmt: skip
        first = stop


def _shift(chains):
    """Time stamps off by whole frames from a row on: (scene, row, seconds, gains)."""
    scene, size, along = chains[0].scene, 0.0, 0.0
    for chain in chains:
        own = _later(np.einsum("itu,tu->ti", chain.local, chain.moved))
        size = size + _later(np.square(chain.moved).sum(axis=1)[:, None])[:, 0]
        size = size - np.square(own).sum(axis=1)
        along = along + _later((chain.targets * chain.moved).sum(axis=2)[..., None])[..., 0]
    n = len(scene.times)
    size, along = size[:n], along[:, :n]
    able = size > DETERMINED * size.max()
    able[0] = False
    step = float(np.median(np.diff(scene.times)))
    frames = np.round(np.where(able, along / np.where(able, size, 1.0), 0.0) / step)
    seconds = step * np.where(np.abs(frames) <= MOST_FRAMES, frames, 0.0)
    gain = 2 * seconds * along - np.square(seconds) * size
    k = int(np.argmax(gain[0]))
    return scene, k, float(seconds[0, k]), chains, gain.max(axis=1)


def _later(values):
    return np.flip(np.cumsum(np.flip(values, -2), axis=-2), -2)


# --- proposals ------------------------------------------------------------------------------------


def proposal_of(view, code, parts, gain, n_tried):
    """Parts at once; `gain` less what the rows that they leave out cost."""
    hypothesis = sum(parts, view.hypothesis)
    log_prior = -view.criteria.cause_nats - len(parts) * float(np.log(n_tried))
    text = "; ".join(part.describe() for part in parts)
    return Proposal(
        code, text, hypothesis, log_prior, float(gain), len(parts), kind="measurement",
        is_afresh=code in FAR,
    )  # fmt: skip


def leave_motion(dataset, parts, levels):
    """Whether parts leave some body a motion: of what stands still no law says anything.

    Parameters
    ----------
    levels : ndarray, shape (d,), metres
        Of the noise; nan = an axis along which nothing moves.
    """
    axes = np.isfinite(levels)
    found = [0.0]
    for scene in Hypothesis(tuple(parts)).seen(dataset).scenes:
        places = scene.positions[:, scene.dynamic][..., axes]
        is_seen = np.isfinite(places)
        low, high = np.where(is_seen, places, np.inf), np.where(is_seen, places, -np.inf)
        span = high.max(axis=0, initial=-np.inf) - low.min(axis=0, initial=np.inf)
        found.append(float((span / np.maximum(levels[axes], TINY)).max(initial=0.0)))
    return max(found) > MOVED


def _paid(window, gains):
    """Gains less what is paid for leaving rows out; -inf where that cannot be."""
    return np.where(window.is_able, gains - 2 * window.price, -np.inf)


def _rows(windows, n_tried):
    """All single rows that pay for being left out, or else the best one, and their gain.

    What a row gains more than those beside it is its own: what is missing elsewhere is smooth.
    Where that holds of many rows they are too coarse to be smooth, and none is told to be off.
    """
    found = []
    for window, gains in windows:
        if window.kind == "row":
            around = np.pad(np.where(window.is_able, gains, 0.0), 1)
            own = _paid(window, gains - np.maximum(around[:-2], around[2:]))
            found += [(own[k], k, window) for k in np.flatnonzero(np.isfinite(own))]
    found.sort(key=lambda entry: -entry[0])
    chosen, taken, total = [], set(), 0.0
    for paid, k, window in found:  # a row of all bodies and one of a body are one defect
        places = {(window.chain.scene.name, k, name) for name in window.chain.names[window.used]}
        if chosen and paid <= 2 * np.log(n_tried):
            break
        if not places & taken:
            chosen, taken, total = [*chosen, window.part(k)], taken | places, total + paid
    is_many = len(chosen) > max(MOST_OFF * len(found), FEW_OFF)
    return ([], -np.inf) if is_many else (chosen, total)


def _lost(windows):
    """The track that gains most by leaving out its end, or its beginning, and its gain.

    Of those that break where they are lost: what a law does not follow goes on smoothly.
    """
    found = []
    for window, gains in windows:
        if window.kind == "part":
            paid = _paid(window, gains)
            found += [(paid[k], window, k) for k in np.argsort(-paid)[:MOST_BREAKS].tolist()]
    found.sort(key=lambda entry: -entry[0])
    for paid, window, k in found[:MOST_BREAKS]:
        at = int(window.first[k] or window.stop[k])
        if paid > 0 and is_broken(window.chain.scene, window.entity, at):
            return [window.part(k)], paid
    return [], -np.inf


def _untrimmed(view, chains):
    """Both ends of all tracks that pay for being left out, their gain, and how many were tried."""
    parts, total, n_tried = [], 0.0, 0
    for chain in chains:
        for name in np.unique(chain.names):
            # Levels under a law that cannot follow tracks are of no use: these tell what noise is.
            heads, tails = ends_of(chain.scene, name, view.scatter)
            n_tried += len(heads)
            if not len(heads):
                continue
            window = chain.ends(name, heads, tails)
            paid = _paid(window, window.gains()[0])
            k = int(np.argmax(paid))
            if paid[k] > 0:
                n, seen = len(chain.scene.times), chain.seen[:, window.used].sum(axis=1)
                parts += [
                    LeftOut(chain.scene.name, a, b, str(name), n_left_out=int(seen[a:b].sum()),
                            extent=chain.extent)
                    for a, b in ((0, int(heads[k])), (int(tails[k]), n)) if b > a
                ]  # fmt: skip
                total += float(paid[k])
    return parts, total, n_tried


def _frames(moved):
    """Missing or repeated frames in the scene in which they gain most, and their gain."""
    scene, row, seconds, chains, gains = max(moved, key=lambda m: m[-1][0])
    lost = max(round(-seconds / float(np.median(np.diff(scene.times)))), 0)
    count = sum(int(chain.seen[row : row + lost].sum()) for chain in chains)
    part = Shifted(scene.name, row, seconds, n_left_out=count, extent=chains[0].extent)
    return [part] if seconds else [], gains[0]
