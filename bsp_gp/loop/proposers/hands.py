"""Ends of recordings at which something else moves the body: a hand, or what it strikes.

Rows at an end are left out that go on from one to the next as smoothly as a hand moves: so much
each of them costs, and not that it may lie anywhere. How many there are the track tells, whatever
moves the body (`bsp_gp.fitting.departures`), or else what is left of the law.
"""

import math

import numpy as np

from bsp_gp.fitting.departures import departures, going_on
from bsp_gp.fitting.hands import is_in_reach
from bsp_gp.fitting.parts.defects import LeftOut
from bsp_gp.loop.proposal import Family
from bsp_gp.loop.proposers.defects import chains_of, leave_motion, proposal_of
from bsp_gp.loop.proposers.untrimmed import is_open

LEAST_ROWS, MOST_ROWS = 16, 2_000
"""Of a recording that is asked: of longer ones a hand is a small part."""
LEAST, MOST_APART = 3, 0.5
"""Rows that are left out at one end, and the part of a track that may be."""
MOST_OUT = 0.5
"""Part of all rows that may be left out: what is as rough everywhere is the motion."""
FEW, MOST = 0.2, 0.3
"""Part of a track that may be left out by what the law leaves, and of that, which it makes."""


class Hands:
    """Rows at both ends, of all recordings at once, as a proposer."""

    name = "hands"
    asks_rows = True

    def propose(self, view):
        """The family of one: all ends that pay for being left out."""
        even, found, n_tried = np.zeros(1 + len(view.row_draws)), [], 0
        for chain in () if view.is_sky else filter(is_open, chains_of(view)):
            track = _track(chain, view.scatter)
            if track is None:
                continue
            told = departures(chain.scene.times, *track)
            for side in (0, 1):
                end = _End(chain, *track, side)
                even = np.maximum(even, end.even)
                n_tried += len(end.rows)
                k = end.told_by_track(told[side]) if any(told) else end.told_by_law()
                is_near = k is not None and is_in_reach(track[0], int(end.rows[k]), side)
                if is_near and end.paid[k] > 0:
                    found.append((end.part(k), float(end.paid[k])))
        n_out = sum(part.n_left_out for part, _ in found)
        is_told = found and n_out <= MOST_OUT * np.count_nonzero(view.tangent.whitener.seen)
        proposals = ()
        if is_told:
            parts, gains = zip(*found, strict=True)
            if leave_motion(view.dataset, parts, view.scatter):
                proposals = (proposal_of(view, "untrimmed", parts, sum(gains), n_tried),)
        return Family(self.name, proposals, float(even[0]), 2, even[1:], n_tried=n_tried)


class _End:
    """Rows at one end of a track, 0 or 1, left out as so many, `rows` (K,).

    `paid` is the chi-squared that is gained, less twice what they cost, nats, -inf where that
    cannot be; `even` the greatest gain on the data and on draws of noise, as of pairs, (1 + B,).
    """

    def __init__(self, chain, places, errors, side):
        times, n = chain.scene.times, len(places)
        self.chain, self.side, self.n = chain, side, n
        self.rows = np.arange(LEAST, int(MOST_APART * n) + 1)
        nothing = np.zeros_like(self.rows)
        ends = (self.rows, nothing + n) if side == 0 else (nothing, n - self.rows)
        self.window = chain.ends(chain.names[0], *ends)
        self._gains, self.even = self.window.gains()
        sizes = going_on(times, places) if side == 0 else going_on(-times[::-1], places[::-1])
        # Extents in which rows would lie with the density that they have.
        self._extents = math.sqrt(2 * math.pi * math.e) * np.maximum(sizes, errors.min())
        self._extents = self._extents[self.rows - 1]
        cost = self.window.price + self.window.rank * np.log(self._extents / chain.extent)
        self.paid = np.where(self.window.is_able, self._gains - 2 * cost, -np.inf)

    def told_by_track(self, count):
        """Which of `rows` are as many as the track says; None where it says none."""
        return int(np.searchsorted(self.rows, count)) if count else None

    def told_by_law(self):
        """Which leave least of the law; None where they are many, or do not make most of it.

        What a law lacks all along would leave out half of a track: the most that are asked are no
        end that was found.
        """
        few = self.paid[self.rows <= FEW * self.n]
        k = int(np.argmax(few)) if len(few) else 0
        if k + 1 >= len(few):
            return None
        is_most = self._gains[k] > MOST * np.square(self.chain.targets[0]).sum()
        return k if is_most else None

    def part(self, k):
        """Number k of `rows` left out."""
        count = int(self.rows[k])
        first, stop = (0, count) if self.side == 0 else (self.n - count, self.n)
        return LeftOut(
            self.chain.scene.name, first, stop, str(self.chain.names[0]),
            n_left_out=int(self.window.rank[k]), extent=float(self._extents[k]),
        )  # fmt: skip


def _track(chain, levels):
    """Places (T, a) along axes that have noise, and that; None where it is not all seen alone."""
    scene, names = chain.scene, np.unique(chain.names)
    axes = np.isfinite(levels)
    places = scene.positions[:, scene.names.index(names[0])][:, axes]
    is_alone = len(scene.dynamic) == 1  # else a pull of the other, near by, may be as abrupt
    is_whole = is_alone and np.isfinite(places).all() and scene.first is None
    is_usual = LEAST_ROWS <= len(places) <= MOST_ROWS
    return (places, levels[axes]) if is_whole and is_usual and axes.any() else None
