"""A part of the rows of long recordings, in which what acts is looked for first."""

from dataclasses import replace

import numpy as np

from bsp_gp.data.scene import CHECK
from bsp_gp.data.stretches import cut_at, may_be_cut

MOST_ROWS = 3000
"""Rows of a part, of all bodies that move; where there are more than twice as many one is taken."""
LONG, WINDOW = 1300, 600
"""Rows from which a recording is taken in windows, and rows of one."""
LEAST_SCENES = 5
"""Scenes of a part."""
MOST_SHARE = 0.5
"""Part of all rows from which a part is no quicker look at them."""


def part_of(dataset):
    """A data set of some of the scenes, or of windows of them, spread evenly; None of few rows.

    None as well where recordings may not be cut, or where it is declared what is held out.
    """
    n_bodies = max((len(scene.dynamic) for scene in dataset.scenes), default=1)
    n_rows = rows_of(dataset.scenes)
    is_declared = bool(dataset.train or dataset.test)
    if is_declared or n_rows <= 2 * MOST_ROWS or not may_be_cut(dataset):
        return None
    edges = {
        scene.name: list(range(WINDOW, len(scene.times) - WINDOW // 2, WINDOW))
        for scene in dataset.scenes if len(scene.times) > LONG
    }  # fmt: skip
    cut = cut_at(dataset, edges, "") if edges else dataset
    longest = n_bodies * max(len(scene.times) for scene in cut.scenes)
    wanted = max(LEAST_SCENES, MOST_ROWS // longest)
    if wanted >= len(cut.scenes):
        return None
    chosen = np.unique(np.linspace(0, len(cut.scenes) - 1, wanted).round().astype(int))
    scenes = tuple(cut.scenes[k] for k in chosen)
    n_few = rows_of(scenes)
    if n_few > MOST_SHARE * n_rows:
        return None
    note = f"{CHECK}there was time for {n_few:,} of {n_rows:,} rows, in {len(scenes)} parts"
    return replace(cut, scenes=scenes, notes=(*dataset.notes, note))


def rows_of(scenes):
    """Rows of all bodies that move."""
    return sum(len(scene.times) * len(scene.dynamic) for scene in scenes)
