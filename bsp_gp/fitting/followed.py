"""Laws fitted to all tracks that they can follow, and to the others as far as they can."""

import math
import time

from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.cut_short import CutShort
from bsp_gp.fitting.parts.defects import LeftOut

PASSES = 3
"""Times that tracks are cut, at the most."""
NEAR = 10.0
"""Reduced chi-squared of the other tracks below which a fit goes on from where it was left."""


def followed(hypothesis, dataset, *, deadline=None, **settings):
    """The fit of a hypothesis to tracks as far as it can follow them.

    A track that it cannot follow at all, where it does all others - the close pass of two bodies, a
    collision - would hide what these tell.

    Parameters
    ----------
    deadline : float, optional
        Seconds for all together.
    **settings
        Of `fit`.

    Returns
    -------
    found : Fit
    hypothesis : Hypothesis
        With what is left out; as it was where that helps nothing.
    """
    end = math.inf if deadline is None else time.monotonic() + deadline
    first = found, hypothesis = fit(hypothesis, dataset, deadline=deadline, **settings), hypothesis
    for _ in range(PASSES):
        left = end - time.monotonic()
        if not found.lost or left <= 0:
            break
        hypothesis = cut_short(hypothesis, found)
        if found.chi2_others < NEAR:
            settings |= {"near": found, "starts": found.starts}
        found = fit(hypothesis, dataset, deadline=left, **settings)
    return first if found.is_failed else (found, hypothesis)


def cut_short(hypothesis, found):
    """The hypothesis with the tracks that its fit did not follow cut short."""
    return hypothesis + Hypothesis(found.lost)


def about_lost(hypothesis):
    """Which tracks are followed up to a row only, a note or none."""
    cut = {(p.scene, p.bodies): p for p in hypothesis.parts if isinstance(p, CutShort)}
    if not cut:
        return ()
    told = "; ".join(
        f"{', '.join(part.bodies)} in scene {part.scene} before row {part.row}"
        for part in cut.values()
    )
    return (
        f"{CHECK}no path under the law follows all of some tracks, as they do all others: used are "
        f"{told}; after it comes a close pass, or something that acts there alone",
    )


def about_ends(hypothesis, dataset):
    """At which ends of tracks rows are left out, a note or none."""
    scenes, told = {scene.name: scene for scene in dataset.scenes}, []
    for part in hypothesis.parts:
        # A single row is off by itself, and of several bodies a track is lost.
        is_end = type(part) is LeftOut and part.scene in scenes and part.stop - part.row > 1
        if not is_end or len(scenes[part.scene].dynamic) > 1:
            continue
        times = scenes[part.scene].times
        if part.row == 0 and part.stop < len(times):
            told.append(f"before {dataset.units.instant(times[part.stop])} in {part.scene!r}")
        elif part.row > 0 and part.stop >= len(times):
            told.append(f"after {dataset.units.instant(times[part.row - 1])} in {part.scene!r}")
    if not told:
        return ()
    return (
        f"{CHECK}something else moves the body at the ends, such as a hand, or what it strikes: "
        f"rows are left out {listed(told)}",
    )
