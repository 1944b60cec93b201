"""The plane of an orbit on the sky: an inclined one is seen foreshortened, whatever the force."""

import math
from dataclasses import replace

import numpy as np

from bsp_gp.fitting.ellipses import ellipse_of
from bsp_gp.fitting.parts.inclined import STEEPEST, Inclined, stretched
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.physics.force import ForceLaw

INCLINATIONS = np.radians([15.0, 30.0, 40.0, 50.0, 60.0, 68.0, 75.0, 81.0])
N_NODES = 18
N_STARTS = 2
APART = math.radians(25.0)
"""Between lines of nodes that are two starts."""


class Inclinations:
    """Planes that are inclined to the picture as a proposer."""

    name = "inclined"

    def propose(self, view):
        """The family of planes, where one is seen on the sky and the law has not tilted it yet.

        The law of the fit, its constants as they are and its strength free, is weighed in planes
        of every inclination.
        """
        law = view.fit.law
        if not is_open(view) or not any("p_i" in t.formula.inputs for t in law.terms):
            return Family(self.name)
        planes = planes_of(INCLINATIONS, N_NODES)
        plain, seen = ForceLaw(law.terms, law.constants), view.response
        total, left = seen.moments_of(plain), seen.left()[0]
        tried = (seen.regression.in_plane(plane.matrix(plane.own)) for plane in planes)
        moments = np.stack(
            [replace(seen, regression=one).moments_of(plain) for one in tried], axis=1
        )
        gains = _gains(left, total, moments, np.square(view.left).sum())
        free = np.square(view.draws_left).sum(axis=0)
        null = np.array([
            max(_gains(draw, total, moments, size).max(), 0.0)
            for draw, size in zip(view.moment_draws.T, free, strict=True)
        ])  # fmt: skip
        proposals = [_proposal(view, planes[k], float(gains[k])) for k in _apart(planes, gains)]
        if (orbit := lone_orbit(view)) is not None:
            gain = float(view.left @ view.left) - orbit.chisqr
            plane = Inclined((orbit.inclination, orbit.node))
            if gain > max((p.gain for p in proposals), default=0.0):
                proposals.insert(0, _proposal(view, plane, gain, path=orbit))
        best = float(max(gains.max(), 0.0))
        return Family(
            self.name, tuple(proposals), best, 2, null, n_tried=len(planes), is_continuum=True
        )


def _proposal(view, plane, gain, **more):
    return Proposal(
        "inclined", plane.describe(), view.hypothesis + plane, 0.0, gain, 2, kind="measurement",
        is_afresh=True, is_first=True, patience=PATIENT, **more,
    )  # fmt: skip


def lone_orbit(view, focus=None):
    """The ellipse nearest to the places of a lone body of one recording; None if there is none.

    Moments along tracks that are far off tell little of an orbit that turns round, or is seen
    nearly edge on.

    Parameters
    ----------
    focus : ndarray, shape (2,), m, optional
        What it goes round, where that is seen.
    """
    scene, *others = view.dataset.scenes
    if others or len(scene.dynamic) != 1:
        return None
    places = scene.positions[:, scene.dynamic[0]]
    errors = np.broadcast_to(np.array(view.fit.noise.levels), places.shape)
    if scene.sigma is not None:
        quoted = scene.sigma[:, scene.dynamic[0]]
        errors = np.where(np.isfinite(quoted) & (quoted > 0), quoted, errors)
    seen = np.isfinite(places).all(axis=1) & np.isfinite(errors).all(axis=1)
    found = ellipse_of(scene.times[seen], places[seen], errors[seen], focus)
    return found if found is not None and 0 < found.inclination < STEEPEST else None


def is_open(view):
    """Whether these are places in a picture of the sky of which the depth is not known."""
    law = view.fit.law
    return view.is_sky and view.dataset.n_dims == 2 and stretched(law) is None and not law.unseen


def planes_of(inclinations, n_nodes):
    """Planes of these inclinations (rad), with so many lines of nodes each, list of Inclined."""
    nodes = np.pi * np.arange(n_nodes) / n_nodes
    return [Inclined((float(i), float(node))) for i in inclinations for node in nodes]


def _gains(left, total, moments, remaining):
    """Chi-squared that each plane (n, C) takes off what remains, its strength free."""
    whole = left + total
    size = np.square(moments).sum(axis=0)
    along = np.divide(moments.T @ whole, np.sqrt(size), out=np.zeros(len(size)), where=size > 0)
    return remaining - (whole @ whole - np.square(along))


def _apart(planes, gains):
    """The best planes whose lines of nodes differ."""
    chosen = []
    for k in np.argsort(-gains):
        turns = [abs(planes[k].values[1] - planes[c].values[1]) for c in chosen]
        if len(chosen) < N_STARTS and gains[k] > 0 and all(
            min(turn, math.pi - turn) > APART for turn in turns
        ):
            chosen.append(int(k))
    return chosen
