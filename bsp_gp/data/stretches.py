"""Recordings of very many turns, followed in stretches.

A prediction of a hundred turns is out of step as soon as the law lacks anything, and tells nothing
then but that. Stretches of some turns, each from a state of its own, show what is lacking as
tracks do; of what all rows tell, only the phase from one stretch to the next is not used.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK, Evaluation

MOST_TURNS, TURNS = 40, 12
"""Turns up to which a recording is followed as a whole, and turns of a stretch, about."""
LEAST_ROWS = 60
"""Rows of a stretch."""
LEAST_PART = 3
"""Rows of a part that is cut out of a recording."""
BEYOND, SHARE = 3.0, 0.05
"""Standard deviations, and part of the widest, by which a track goes to either side in a turn."""


def in_stretches(dataset):
    """The data set with recordings of very many turns cut into stretches, and a note of it."""
    if not may_be_cut(dataset, most_sums=1):
        return dataset
    sigma = np.array(estimate_noise(dataset).sigma)
    edges, told = {}, []
    for scene in dataset.scenes:
        turns = _turns(scene, sigma)
        count = min(round(turns / TURNS), len(scene.times) // LEAST_ROWS)
        if turns > MOST_TURNS and count > 1:
            ends = np.linspace(0, len(scene.times), count + 1).round().astype(int)
            edges[scene.name] = ends[1:-1].tolist()
            told.append(f"{turns} turns of {scene.name!r} in {count}")
    if not told:
        return dataset
    note = (
        f"{CHECK}so many turns are followed in stretches, each from a state of its own "
        f"({listed(told)}): their phase from one stretch to the next is not used"
    )

    return cut_at(dataset, edges, note)


def may_be_cut(dataset, most_sums=0):
    """Whether recordings may be followed in parts.

    Not where rows are counted (`Evaluation`), where what was measured was added up more than so
    many times, in the sky, where small forces add up over many turns, or where properties are
    unknown.
    """
    is_plain = dataset.evaluation == Evaluation() and dataset.n_sums <= most_sums
    return is_plain and not dataset.latents and not is_of_the_sky(dataset)


def cut_at(dataset, edges, note):
    """The data set with scenes in parts, each from a state of its own.

    Parameters
    ----------
    edges : dict of str to list of int
        First rows of the parts of a scene, without that of the first part. Parts of one row or two,
        as between jumps of two bodies that meet, are left out: no state is told by them.
    note : str
        That says so.
    """
    parts = {
        scene.name: tuple(
            replace(scene.rows(a, b), name=f"{scene.name}/{k}", part_of=scene.name)
            for k, (a, b) in enumerate(pairwise([0, *rows, len(scene.times)]), 1)
            if b - a >= LEAST_PART
        ) if (rows := edges.get(scene.name)) else (scene,)
        for scene in dataset.scenes
    }  # fmt: skip

    def named(scenes):
        return tuple(part.name for name in scenes for part in parts[name])

    return replace(
        dataset, scenes=tuple(part for own in parts.values() for part in own),
        train=named(dataset.train), test=named(dataset.test), notes=(*dataset.notes, note),
    )  # fmt: skip


def _turns(scene, sigma):
    """How often the body that does so most goes to and fro along an axis."""
    most = 0
    for axis in np.flatnonzero(np.isfinite(sigma)):
        for k in scene.dynamic:
            places = scene.positions[:, k, axis]
            places = places[np.isfinite(places)]
            if len(places):
                away = places - np.median(places)
                beyond = max(BEYOND * sigma[axis], SHARE * np.abs(away).max())
                sides = np.sign(away[np.abs(away) > beyond])
                most = max(most, int((np.diff(sides) != 0).sum()) // 2)
    return most
