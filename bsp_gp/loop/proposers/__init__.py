"""Proposers: each turns a fit into causes that may be missing, one short file each."""

from bsp_gp.loop.proposers.alternating import Alternating
from bsp_gp.loop.proposers.anchors import Anchors
from bsp_gp.loop.proposers.aslant import Aslant
from bsp_gp.loop.proposers.blown import Blown
from bsp_gp.loop.proposers.by_owner import ByOwner
from bsp_gp.loop.proposers.centres import Centres
from bsp_gp.loop.proposers.companions import Companions
from bsp_gp.loop.proposers.contacts import Contacts
from bsp_gp.loop.proposers.defects import Defects
from bsp_gp.loop.proposers.delayed import Delayed
from bsp_gp.loop.proposers.exponents import Declared
from bsp_gp.loop.proposers.frames import Frames
from bsp_gp.loop.proposers.growing import Growing
from bsp_gp.loop.proposers.hands import Hands
from bsp_gp.loop.proposers.hidden import Hidden
from bsp_gp.loop.proposers.inclined import Inclinations
from bsp_gp.loop.proposers.inside import Inside
from bsp_gp.loop.proposers.kicks import Kicks
from bsp_gp.loop.proposers.late import LateLogs
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.proposers.measurement import Measurement
from bsp_gp.loop.proposers.noise import Noise
from bsp_gp.loop.proposers.orbits import OrbitPairs, Orbits
from bsp_gp.loop.proposers.own_laws import OwnLaws
from bsp_gp.loop.proposers.periods import Periods
from bsp_gp.loop.proposers.polynomials import Polynomials
from bsp_gp.loop.proposers.pulsing import Pulsing
from bsp_gp.loop.proposers.reference import References
from bsp_gp.loop.proposers.regimes import Regimes
from bsp_gp.loop.proposers.ripples import Ripples
from bsp_gp.loop.proposers.rods import Rods
from bsp_gp.loop.proposers.shapes import Shapes
from bsp_gp.loop.proposers.sources import Sources
from bsp_gp.loop.proposers.spun import Spun
from bsp_gp.loop.proposers.swings import Swings
from bsp_gp.loop.proposers.unfollowed import Unfollowed
from bsp_gp.loop.proposers.varying import Varying
from bsp_gp.loop.proposers.walls import Walls
from bsp_gp.loop.proposers.winds import Winds


def standard(grammar, dataset, **settings):
    """All proposers; this list is the only place that knows them by name.

    Parameters
    ----------
    dataset : Dataset
        Training scenes.
    **settings
        Of `Laws`.
    """
    if dataset.is_of_sight:
        orbits = Orbits()
        return [orbits, OrbitPairs(orbits), Noise()]
    laws = Laws(grammar, dataset, **settings)
    inside = Inside(laws, dataset)
    return [
        laws, inside, Shapes(laws, dataset), Polynomials(laws), Regimes(), Spun(), Blown(),
        Swings(inside), ByOwner(laws), OwnLaws(laws), Declared(), Varying(), Growing(), Delayed(),
        Winds(), Periods(), Ripples(), Pulsing(), Alternating(laws, dataset), Frames(),
        Inclinations(), References(), Sources(), Hidden(), Centres(), Aslant(), Companions(),
        Kicks(), Contacts(), Walls(), Rods(), Anchors(), Measurement(), LateLogs(), Defects(),
        Hands(), Noise(), Unfollowed(laws),
    ]  # fmt: skip
