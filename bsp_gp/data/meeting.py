"""Bodies that seem to be at one point at times, since their places were rounded to whole pixels."""

import numpy as np
import pandas as pd

from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK

MOST, LEAST_ROWS = 0.25, 12
"""Part of the rows of a body in which it may be where another is, of so many at least."""
WHOLE = 1e-3
"""Part of a step that places may be off whole ones."""
LEAST_STEP = 1e-6
"""Part of the whole way that a step has at least; finer ones make no two places the same."""
_LISTED = 8


def without_meetings(rows):
    """Rows without those in which a body is where one before it is.

    No force between the two has a direction there, which rounding alone has made; where places
    were not rounded, or bodies meet often, nothing is left out.
    """
    if rows.may_meet or len(rows.entity_names) < 2:
        return rows
    order = np.argsort(rows.entity, kind="stable")
    where = pd.DataFrame(rows.positions).assign(scene=rows.scene, time=rows.times)
    is_met = np.zeros(len(rows.times), dtype=bool)
    is_met[order] = where.iloc[order].duplicated().to_numpy()
    if not is_met.any() or not all(map(_is_rounded, rows.positions.T)):
        return rows
    counts = np.bincount(rows.entity, minlength=len(rows.entity_names))
    met = np.bincount(rows.entity[is_met], minlength=len(counts))
    if (counts[met > 0] < LEAST_ROWS).any() or (met > MOST * counts).any():
        return rows
    each = [f"{rows.entity_names[k]!r} in {met[k]} of {counts[k]}" for k in np.flatnonzero(met)]
    note = (
        f"{CHECK}within the digits of the places another body is at the same point as "
        f"{listed(each)} row(s): there, these rows are gaps in its track (line "
        f"{listed(rows.lines[is_met], _LISTED)}); if they are one body that was measured twice, "
        "leave one of them out"
    )
    return rows.taken(np.flatnonzero(~is_met)).noted(note)


def _is_rounded(places):
    """Whether all places along an axis are whole steps apart."""
    known = np.unique(places[np.isfinite(places)])
    if len(known) < 2:
        return True
    step = np.diff(known).min()
    if step < LEAST_STEP * np.ptp(known):
        return False
    steps = (known - known[0]) / step
    return bool(np.abs(steps - np.round(steps)).max() < WHOLE)
