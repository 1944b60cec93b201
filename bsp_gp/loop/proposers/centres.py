"""What goes round a body that is seen at rest, in the sky: gravity before all other forces.

Where rows are far apart, or a body passes another one closely, moments along tracks tell little of
a force; whole tracks do. Its strength is told by how fast each body is bent at its distance.
"""

import math
from dataclasses import replace

import numpy as np

from bsp_gp.fitting.parts.inclined import Inclined
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import PATIENT, Family, Proposal, with_term
from bsp_gp.loop.proposers.inclined import is_open, lone_orbit
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, fresh_name

PULL = "inverse(norm(p_i - p_j)^2) * normalize(p_i - p_j)"
LEAST_ROWS = 5
TOWARDS = 0.5
"""Cosine from which half of all bends, at the least, are towards a centre."""
SURE = 4.0
"""Standard errors of an axis by which an ellipse is flattened that is seen aslant."""


class Centres:
    """The pull of a body at rest, as the inverse square of the distance, as a proposer."""

    name = "centres"

    def propose(self, view):
        """The family of that one law, where no pull between bodies is known.

        Of a lone body in a picture also in the plane of its orbit: of few rows with large errors
        the whole orbit tells the strength where neighbouring ones do not.
        """
        law, null = view.fit.law, np.zeros(view.moment_draws.shape[1])
        is_pulled = any(term.kind == "pair" for term in law.terms) or law.unseen
        if is_pulled or not view.is_sky or any(_centre(s) is None for s in view.dataset.scenes):
            return Family(self.name, null=null)
        strength = strength_of(view.dataset)
        plain = () if strength is None else (_pull(view, strength),)
        proposals = (*_aslant(view), *plain)
        return Family(self.name, proposals, null=null, is_control=bool(proposals))


def _pull(view, strength):
    """The pull, of a strength to begin with."""
    name = fresh_name(view.fit.law, "c")
    mass = "m_i * m_j * " if has_masses(view.dataset) else ""
    formula = parse_formula(f"{name} * ({mass}{PULL})", dataset_types(view.dataset))
    hypothesis = with_term(view.hypothesis, Term(formula, "pair"), {name: -strength})
    gain = max(float(view.left @ view.left) - view.n_left, 0.0)
    return Proposal(
        "law", to_text(formula), hypothesis, 0.0, gain, 1, starts={name: -strength},
        formulas=(formula,), n_dims=view.dataset.n_dims, is_first=True, is_afresh=True,
        patience=PATIENT,
    )  # fmt: skip


def _aslant(view):
    """The pull and the plane of the orbit of a lone body: a double star is seen aslant."""
    if not is_open(view):
        return
    orbit = lone_orbit(view, _centre(view.dataset.scenes[0]))
    if orbit is None:
        return
    flatter = orbit.axis * (1 - math.cos(orbit.inclination))
    error = np.nanmax(view.fit.noise.levels) / math.sqrt(len(view.dataset.scenes[0].times))
    if not flatter > SURE * error:
        return
    pull, plane = _pull(view, orbit.strength), Inclined((orbit.inclination, orbit.node))
    yield replace(
        pull, hypothesis=pull.hypothesis + plane, text=f"{pull.text} in an inclined plane",
        log_prior=-view.criteria.cause_nats, rank=pull.rank + 2, path=orbit,
    )  # fmt: skip


def has_masses(dataset):
    """Whether every body has a mass that is known."""
    bodies = [entity for scene in dataset.scenes for entity in scene.entities]
    return bool(np.isfinite([body.mass for body in bodies]).all())


def _centre(scene):
    """Where the only body at rest is, (d,); None where there is none, or several."""
    still = [k for k, entity in enumerate(scene.entities) if entity.is_static]
    return np.nanmean(scene.positions[:, still[0]], axis=0) if len(still) == 1 else None


def strength_of(dataset, centre_of=_centre):
    """Acceleration towards the only body at rest times the square of the distance; None without.

    The median over rows and bodies does not mind where one passes another closely.

    Parameters
    ----------
    dataset : Dataset
    centre_of : callable, optional
        ``centre_of(scene)``: where it is, (d,), or None.
    """
    found, aside = [], []
    for scene in dataset.scenes:
        centre = centre_of(scene)
        if centre is None:
            return None
        for k in scene.dynamic:
            seen = np.isfinite(scene.positions[:, k]).all(axis=1)
            times, places = scene.times[seen], scene.positions[seen, k] - centre
            if len(times) < LEAST_ROWS:
                continue
            before, after = np.diff(times)[:-1, None], np.diff(times)[1:, None]
            speeds = np.diff(places, axis=0) / np.diff(times)[:, None]
            bend = 2 * np.diff(speeds, axis=0) / (before + after)
            distance = np.linalg.norm(places[1:-1], axis=1)
            towards = -(bend * places[1:-1]).sum(axis=1) / distance
            found += (towards * distance**2).tolist()
            aside += (towards < TOWARDS * np.linalg.norm(bend, axis=1)).tolist()
    strength = float(np.median(found)) if found else 0.0
    return strength if strength > 0 and np.mean(aside) < 0.5 else None
