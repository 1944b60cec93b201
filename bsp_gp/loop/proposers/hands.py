"""Ends of recordings at which something else moves the body: a hand, or what it strikes.

Rows at an end are left out that go on from one to the next as smoothly as a hand moves: so much
each of them costs, and not that it may lie anywhere. How many there are the track tells, whatever
moves the body (`bsp_gp.fitting.departures`), or else what is left of the law.
"""

import math

import numpy as np

from bsp_gp.data.noise import estimate_noise
from bsp_gp.fitting.departures import departures, going_on
from bsp_gp.fitting.parts.defects import LeftOut
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.proposers.defects import chains_of
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
        levels = np.array(estimate_noise(view.dataset).sigma)
        even, parts, gain, n_tried = np.zeros(1 + len(view.row_draws)), [], 0.0, 0
        for chain in () if view.is_astronomical else filter(is_open, chains_of(view)):
            track = _track(chain, levels)
            if track is None:
                continue
            places, errors = track
            n = len(places)
            told = departures(chain.scene.times, places, errors)
            rows = np.arange(LEAST, int(MOST_APART * n) + 1)
            n_tried += 2 * len(rows)
            for side in (0, 1):
                heads, tails = (rows, rows * 0 + n) if side == 0 else (rows * 0, n - rows)
                window = chain.ends(chain.names[0], heads, tails)
                gains, best = window.gains()
                even = np.maximum(even, best)
                extents = _extents(chain.scene.times, places, errors, side)[rows - 1]
                cost = window.price + window.rank * np.log(extents / chain.extent)
                paid = np.where(window.is_able, gains - 2 * cost, -np.inf)
                if told[side]:
                    k = np.searchsorted(rows, told[side])
                else:  # of few rows; what a law lacks all along would leave out half of a track
                    few = paid[rows <= FEW * n]
                    k = int(np.argmax(few)) if len(few) and not any(told) else 0
                    is_most = gains[k] > MOST * np.square(chain.targets[0]).sum()
                    paid[k] = paid[k] if len(few) and not any(told) and is_most else -np.inf
                if paid[k] > 0:
                    first, stop = int(heads[k]), int(tails[k])
                    first, stop = (0, first) if side == 0 else (stop, n)
                    parts.append(LeftOut(
                        chain.scene.name, first, stop, str(chain.names[0]),
                        n_left_out=int(window.rank[k]), extent=float(extents[k]),
                    ))  # fmt: skip
                    gain += float(paid[k])
        n_out = sum(part.n_left_out for part in parts)
        is_told = parts and n_out <= MOST_OUT * np.count_nonzero(view.tangent.whitener.seen)
        proposals = (_proposal(view, parts, gain, n_tried),) if is_told else ()
        return Family(self.name, proposals, float(even[0]), 2, even[1:], n_tried=n_tried)


def _track(chain, levels):
    """Places (T, a) along axes that have noise, and that; None where it is not all seen alone."""
    scene, names = chain.scene, np.unique(chain.names)
    axes = np.isfinite(levels)
    places = scene.positions[:, scene.names.index(names[0])][:, axes]
    is_alone = len(scene.dynamic) == 1  # else a pull of the other, near by, may be as abrupt
    is_whole = is_alone and np.isfinite(places).all() and scene.first is None
    is_usual = LEAST_ROWS <= len(places) <= MOST_ROWS
    return (places, levels[axes]) if is_whole and is_usual and axes.any() else None


def _extents(times, places, errors, side):
    """Extents in which rows at an end lie with the density that they have, (T - 2,), m."""
    sizes = going_on(times, places) if side == 0 else going_on(-times[::-1], places[::-1])
    return math.sqrt(2 * math.pi * math.e) * np.maximum(sizes, errors.min())


def _proposal(view, parts, gain, n_tried):
    hypothesis = sum(parts, view.hypothesis)
    log_prior = -view.criteria.cause_nats - len(parts) * float(np.log(n_tried))
    text = "; ".join(part.describe() for part in parts)
    return Proposal(
        "untrimmed", text, hypothesis, log_prior, gain, len(parts), kind="measurement",
        is_afresh=True,
    )  # fmt: skip
