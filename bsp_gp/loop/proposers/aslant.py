"""What a lone body of the sky goes round, in planes that are inclined to the picture."""

import numpy as np

from bsp_gp.data.ephemeris import GRAVITATIONAL_CONSTANT
from bsp_gp.fitting.parts.inclined import Inclined
from bsp_gp.loop.proposal import PATIENT, Family
from bsp_gp.loop.proposers.hidden import N_NEAR, Sources, Stage, attraction, still
from bsp_gp.loop.proposers.inclined import is_open, lone_orbit, planes_of

INCLINATIONS = np.radians([25.0, 40.0, 52.0, 62.0, 70.0, 77.0])
N_NODES = 12


class Aslant(Sources):
    """Unseen sources at rest in planes that are inclined to the sky, as a proposer.

    The orbit is no orbit of such a pull in the picture, and a plane explains nothing without what
    pulls: neither is found alone.
    """

    name = "aslant"

    def propose(self, view):
        """The family of the best place in the best plane, where no declared force names places."""
        if not is_open(view) or any("p_i" in t.formula.inputs for t in view.fit.law.terms):
            return Family(self.name)
        stage, tried = Stage(view), []
        terms, null = attraction(view, stage), np.zeros(view.moment_draws.shape[1])
        for plane in planes_of(INCLINATIONS, N_NODES):
            matrix = plane.matrix(plane.own)
            batches = view.response.regression.in_plane(matrix).batches
            places = stage.places[: N_NEAR**2] @ matrix.T
            unit, size = stage.beside(stage.columns(terms, still(places), batches))
            null = np.maximum(null, np.square(unit.T @ view.draws_left).max(axis=0))
            along = unit.T @ view.left
            k = int(np.argmax(along))
            tried.append((float(along[k]), plane, places[k], float(along[k] / size[k])))
        best = max(tried, key=lambda one: one[0])
        proposals = _of_ellipse(view, stage, terms)
        if not proposals and best[0] > 0:
            proposals = [_proposal(stage, terms, best[0] ** 2, *best[1:])]
        return self.family(proposals, null, len(tried) * N_NEAR**2)


def _of_ellipse(view, stage, terms):
    """The source in the focus of the ellipse nearest to a lone star, if there is one."""
    found = lone_orbit(view)
    if found is None:
        return []
    plane = Inclined((found.inclination, found.node))
    strength = found.strength / (GRAVITATIONAL_CONSTANT if view.is_astronomical else 1.0)
    place = plane.matrix(plane.own) @ found.focus
    gain = max(float(view.left @ view.left) - found.chisqr, 0.0)
    return [_proposal(stage, terms, gain, plane, place, strength, path=found)]


def _proposal(stage, terms, gain, plane, place, strength, **more):
    """A source at a place in a plane, and the plane."""
    starts = {stage.strength: strength, **dict(zip(stage.names, map(float, place), strict=True))}
    middle = tuple((plane.matrix(plane.own) @ stage.middle).tolist())
    source = stage.source(terms, starts, middle=middle)
    return stage.proposal(
        "at rest, seen aslant", terms, (source, plane), gain, starts, stage.log_prior(terms),
        is_afresh=True, patience=PATIENT, **more,
    )  # fmt: skip
