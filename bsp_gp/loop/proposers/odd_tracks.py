"""Laws of textbooks that explain all tracks but one, which hides them from a search by all."""

from itertools import combinations
from operator import itemgetter

import numpy as np

from bsp_gp.fitting.parts.cut_short import CutShort

LEAST_TRACKS = 4
"""Tracks of which one may be odd."""
MOST_OF_ALL = 0.5
"""Part of all that is missing that an odd track has, and more."""
LEFT = 0.02
"""Part of what is missing in the others that a law which explains them leaves beside noise."""


def without_odd_track(view, candidates, column_of):
    """The likeliest one or two of `candidates` for all tracks but that which misses most.

    A close pass, or a hand, in one of many may be more than all forces show in the others.

    Parameters
    ----------
    view : View
    candidates : sequence of Candidate
    column_of : callable
        ``column_of(formula)``: moments (n,) for each unit of a law's own constant.

    Returns
    -------
    chosen : tuple of Candidate
        Empty where no track is odd, none of them explains the others, or those that do explain the
        odd one too.
    amounts : ndarray, shape (len(chosen),)
    gain : float
        All that is missing in the odd track among it.
    cut : CutShort or None
        The odd track, as far as it is followed.
    """
    nothing = (), np.zeros(0), 0.0, None
    owners, of_row = _tracks(view.response.regression.batches)
    missing = np.bincount(of_row, np.square(view.left), len(owners))
    odd = int(missing.argmax())
    is_odd = len(owners) >= LEAST_TRACKS and missing[odd] > MOST_OF_ALL * missing.sum()
    if not (candidates and is_odd):
        return nothing
    every = view.beside(np.stack([column_of(c.formula) for c in candidates], axis=1))
    columns, left = every[of_row != odd], view.left[of_row != odd]
    found = []
    for size in (1, 2):
        for chosen in combinations(range(len(candidates)), size):
            amounts, gain = _explained(columns[:, chosen], left)
            if _is_explained(left, gain):
                cost = sum(candidates[k].complexity for k in chosen)
                found.append((0.5 * gain - cost, chosen, amounts, gain))
        if found:  # two only where none does alone
            break
    if not found:
        return nothing
    _, chosen, amounts, gain = max(found, key=itemgetter(0))
    if _is_explained(view.left, _explained(every[:, chosen], view.left)[1]):
        return nothing
    cut = _cut(view, *owners[odd])
    if cut is None:
        return nothing
    return tuple(candidates[k] for k in chosen), amounts, gain + float(missing[odd]), cut


def _explained(columns, left):
    """Amounts of some columns that explain most of what is left, and how much that is."""
    amounts = np.linalg.lstsq(columns, left, rcond=1e-10)[0]
    return amounts, float(left @ left - np.square(left - columns @ amounts).sum())


def _is_explained(left, gain):
    total = float(left @ left)
    return total - gain - len(left) < LEFT * total


def _tracks(batches):
    """Scene and bodies of every track, and the number of its track for every moment."""
    owners, numbers = {}, []
    for batch in batches:
        own = [
            owners.setdefault(owner, len(owners))
            for owner in zip(batch.scene_names, batch.bodies.receiver_names, strict=True)
        ]
        numbers.append(np.tile(own, len(batch.moments)))
    return list(owners), np.concatenate(numbers)


def _cut(view, scene, bodies):
    """A track that is followed up to its sharpest turn; None where it is no chain of its own."""
    for chains in view.fit.groups:
        for k, owner in enumerate(zip(chains.scenes, chains.bodies, strict=True)):
            if owner == (scene, bodies):
                scenes = {s.name: s for s in view.dataset.scenes}
                return CutShort.at_turn(chains, k, scenes[scene])
    return None
