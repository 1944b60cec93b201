"""Recordings in which a body was hit, or let go: followed in parts, where a law lacks more.

A kick alone is found like any other cause. Beside a law that lacks a force as well it explains
little, and any smooth force much: each then hides the other. Where a track shows that its velocity
jumps, whatever the law, its parts are followed each from a state of its own.
"""

from itertools import chain

import numpy as np

from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK
from bsp_gp.data.stretches import cut_at, may_be_cut
from bsp_gp.fitting.fit import MISFIT
from bsp_gp.fitting.kinks import kinks
from bsp_gp.loop.proposers.walls import is_foreseen, jumps_in, walls_at
from bsp_gp.physics.engine.constrained import constraints_of
from bsp_gp.physics.engine.walls import walls_of
from bsp_gp.units import Unit

VELOCITY, SECOND = Unit.of(m=1, s=-1), Unit.of(s=1)
MOST = 4
"""Kinks of a recording, at the most: what is kicked all the time is pushed."""


def in_parts(dataset, found):
    """The data set with recordings cut where a velocity jumps, and a check that says where.

    Parameters
    ----------
    dataset : Dataset
    found : Fit
        Of the declared law, which lacks something.

    Returns
    -------
    Dataset or None
        None where nothing is cut: where the law foresees the jumps, where bodies meet, or jump
        all the time.
    """
    law = found.law
    if not may_be_cut(dataset) or constraints_of(law) or walls_of(law):
        return None
    edges, told = {}, []
    for scene in dataset.scenes:
        own = {k: _unforeseen(scene, k, found) for k in scene.dynamic}
        own = {k: some for k, some in own.items() if some}
        if not own:
            continue
        if len(own) > 1 or max(map(len, own.values())) > MOST:
            return None
        ((k, some),) = own.items()
        edges[scene.name] = np.searchsorted(scene.times, [kink.time for kink in some]).tolist()
        told += [_told(scene, k, kink, dataset.units) for kink in some]
    if not told:
        return None
    note = (
        f"{CHECK}whatever moves it, a velocity jumps: {listed(told)}; something hits the body "
        f"there, or lets it go, and each side is followed from a state of its own"
    )
    return cut_at(dataset, edges, note)


def bounce(dataset):
    """Whether bodies turn back at walls: what they do there is no kick, and no hand's."""
    return bool(walls_at(list(chain(*jumps_in(dataset.scenes))), dataset))


def lacks(found, levels):
    """Whether a law leaves more of places than the noise of rows, a memory of which may hide it."""
    if found.is_failed:
        return True
    left = found.residual / np.asarray(levels)[found.channels.axis]
    seen = np.isfinite(left)
    return float(np.square(left[seen]).sum()) > MISFIT * max(seen.sum() - found.n_free, 1)


def _unforeseen(scene, k, found):
    """Kinks of a body's track that a fit does not have."""
    return [
        kink for kink in kinks(scene.times, scene.positions[:, k])
        if found.is_failed or not is_foreseen(kink.time, scene, k, found)
    ]  # fmt: skip


def _told(scene, k, kink, units):
    speed = f"{np.linalg.norm(kink.turn):.3g} {units.text(VELOCITY)}"
    return f"that of {scene.names[k]} by {speed} at {kink.time:.4g} {units.text(SECOND)}"
