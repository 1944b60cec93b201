"""Bodies that pull or push all others by strengths of their own: charges, unknown masses.

Of charges those of both bodies count, so that what they do to each other has one size.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from bsp_gp.data.ephemeris import GRAVITATIONAL_CONSTANT
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.parts.latents import Properties
from bsp_gp.fitting.tangent import as_pair
from bsp_gp.inference.latents import latents_of_bodies
from bsp_gp.inference.priors import Prior
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.loop.proposers.by_owner import evidence_of
from bsp_gp.loop.proposers.hidden import TYPES
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.engine.owners import fitted_properties
from bsp_gp.physics.force import ForceLaw, Term, numbered
from bsp_gp.units import Unit

FEWEST, MOST = 3, 60
"""Bodies of which strengths are asked; of a pair each has one that acts on the other alone, which
is asked for where their masses are not known."""
MOST_CHARGED = 12
"""Bodies of which charges are asked, with a column for each pair."""
POWERS = (-3, -2, -1, 1)
"""Of the distance."""
ATTRACTION = (
    f"{GRAVITATIONAL_CONSTANT} [m^3/(kg s^2)] * (m_i * m_j * inverse(norm(p_i - p_j)^2) * "
    "normalize(p_j - p_i))"
)
LEAST, LITTLE = 1e-12, 1e3
"""Part of the greatest mass that every body has, and times that with which the fit of one begins
which the moments tell to push."""
WIDE = 3.0
"""Width of the prior of strengths, in the root mean square of those that the moments tell."""


class Sources:
    """A pull of every body on all others, as a power of the distance, as a proposer.

    What a body does to others need not be what it is made to do by them: neither its mass nor any
    number that is known of it need tell how strongly it pulls. Strengths are linear in what is left
    of the tracks, one column for each body.
    """

    name = "sources"
    is_alone = False
    is_of_sky = True

    def propose(self, view):
        """The family of all powers."""
        names = list(dict.fromkeys(n for s in view.dataset.scenes for n in s.names))
        together = max(len(scene.names) for scene in view.dataset.scenes)
        is_unknown = {e.mass for s in view.dataset.scenes for e in s.entities} == {1.0}
        fewest = 2 if is_unknown else FEWEST
        if together < fewest or len(names) > MOST or view.dataset.units.is_angle:
            return Family(self.name)
        # Of the sky gravity is asked for, where what pulls is seen, and its masses are open.
        if view.is_sky and (not view.is_astronomical or not is_unknown or view.reference):
            return Family(self.name)
        null, found, best, n_tried = np.zeros(view.moment_draws.shape[1]), [], 0.0, 0
        known = {to_text(term.formula) for term in view.fit.law.terms}
        for power in (-2,) if view.is_sky else POWERS:
            if any(_text(column, power) in known for column in fitted_properties(view.fit.law)):
                continue
            columns = _columns(view, names, power)
            acts = np.isfinite(columns).all(axis=0) & np.any(columns, axis=0)
            columns = columns[:, acts]
            if acts.sum() < fewest:
                continue
            score = view.score_forces(columns)
            n_tried += 1
            if not np.any(score.amplitudes):
                continue  # what is fitted already says all of it
            null = np.maximum(null, as_pair(view.null_forces(columns), score.rank))
            best = max(best, float(as_pair(score.statistic, score.rank)))
            height = evidence_of(view, columns)
            alike = evidence_of(view, columns.sum(axis=1, keepdims=True))
            if height - alike > view.criteria.noise_nats:
                strengths = np.zeros(len(names))
                strengths[acts] = score.amplitudes
                own = (names, strengths, score.rank, height)
                is_gravity = view.is_sky and np.max(strengths) > 0
                pull = _text(_column(view), power), Unit.of(m=1 - power, s=-2)
                found.append(_gravity(view, *own) if is_gravity else _proposal(view, *pull, *own))
            if not view.is_sky and FEWEST <= len(names) <= MOST_CHARGED:
                found += _charges(view, names, power, alike)
        # Where some law with numbers that are known does as well, no other is asked for; gravity of
        # bodies of the sky is, before all else.
        least = view.promised - view.criteria.noise_nats
        found = [p for p in found if p.is_first or p.promise > least]
        found.sort(key=lambda p: -p.promise)
        n_first = sum(p.is_first for p in found)
        return Family(
            self.name, tuple(found), best, 2, null, n_tried=n_tried, n_controls=n_first
        )


def _columns(view, names, power):
    """Moments of a pull of strength one to each body, beside no other, (n, len(names))."""
    index = np.broadcast_to(np.arange(len(names)), (len(names), len(names)))
    return _moments(view, names, power, index)


def _moments(view, names, power, index, is_force=False):
    """Moments of pulls of bodies on each other, (n, 1 + the largest number in `index`).

    Parameters
    ----------
    index : ndarray of int, shape (len(names), len(names))
        The column of a pull on one body (row) to another, another for each that is pulled to.
    is_force : bool
        Whether pulls are of one newton, and not of 1 m/s^2.
    """
    masses = {(s.name, e.name): e.mass for s in view.dataset.scenes for e in s.entities}
    n_columns, parts = int(index.max()) + 1, []
    for batch in view.response.regression.batches:
        places = batch.positions  # (n, S, N, d)
        own = batch.bodies.receivers
        gaps = places[:, :, None] - places[:, :, own, None]  # (n, S, R, N, d)
        distance = np.linalg.norm(gaps, axis=-1, keepdims=True)
        is_other = np.isfinite(distance) & (distance > 0)
        safe = np.where(is_other, distance, 1.0)
        pulls = np.where(is_other, np.nan_to_num(gaps) * safe ** (power - 1), 0.0)
        values = np.zeros((*pulls.shape[:3], n_columns, pulls.shape[-1]))
        for s, here in enumerate(batch.bodies.names):
            at = np.array([names.index(name) for name in here])
            if is_force:
                own_masses = [masses[batch.scene_names[s], here[r]] for r in own]
                pulls[:, s] /= np.reshape(own_masses, (-1, 1, 1))
            for r, one in enumerate(at[own]):
                others = np.flatnonzero(at != one)
                values[:, s, r, index[one, at[others]]] = pulls[:, s, r, others]
        moments = batch.whiten(values)  # (m, S, 1, n_columns, 1)
        parts.append(moments[:, :, 0, :, 0].reshape(-1, n_columns))
    return np.concatenate(parts)


def _charges(view, names, power, alike):
    """Charges that push apart what is alike, or pull it together, where one for all does less.

    Parameters
    ----------
    alike : float, nats
        The evidence of a pull to all others alike.
    """
    ones, others = np.triu_indices(len(names), 1)
    pairs = np.zeros((len(names), len(names)), dtype=int)
    pairs[ones, others] = pairs[others, ones] = np.arange(len(ones))
    columns = _moments(view, names, power, pairs, is_force=True)
    if not np.isfinite(columns).all() or not np.any(columns, axis=0).all():
        return
    basis, reach = np.linalg.qr(view.beside(columns))
    target = basis.T @ view.left
    pulls = np.linalg.lstsq(reach, target, rcond=1e-10)[0]
    for sign, way in ((-1.0, "p_i - p_j"), (1.0, "p_j - p_i")):
        products = np.zeros((len(names), len(names)))
        products[ones, others] = products[others, ones] = sign * pulls
        sizes, vectors = np.linalg.eigh(products)
        charges = vectors[:, -1] * np.sqrt(max(sizes[-1], np.finfo(float).tiny))
        charges = charges / np.sign(charges[np.argmax(np.abs(charges))])
        charges = least_squares(
            lambda q, sign=sign: target - sign * (reach @ (q[ones] * q[others])), charges
        ).x
        slopes = np.zeros((len(ones), len(names)))
        slopes[np.arange(len(ones)), ones] = sign * charges[others]
        slopes[np.arange(len(ones)), others] = sign * charges[ones]
        height = evidence_of(view, columns @ slopes)
        if height - alike > view.criteria.noise_nats and np.all(charges):
            column = _column(view)
            text = f"{column}_i * {column}_j * norm(p_i - p_j)^{power} * normalize({way})"
            unit = Unit.of(kg=1, m=1 - power, s=-2) ** 0.5
            yield _proposal(view, text, unit, names, charges, len(names), height)


def _column(view):
    """A name for a property more."""
    return numbered("strength", view.dataset.property_names)


def _proposal(view, text, unit, names, strengths, rank, height):
    """A law with a property more, one number of each body."""
    column = _column(view)
    spread = WIDE * float(np.sqrt(np.mean(np.square(strengths))))
    prior = Prior("truncated_normal", mean=0.0, sd=spread)
    values = tuple(map(float, strengths))
    part = Properties(latents_of_bodies(names, column, prior), ((column, unit),), values)
    seen = part.seen(view.dataset)
    types = dataset_types(replace(seen, property_units={**seen.property_units, column: unit}))
    formula = parse_formula(text, types, units=view.dataset.units)
    return Proposal(
        "law_by_source", text, view.hypothesis + part + Forces(ForceLaw((Term(formula),), {})),
        -2 * view.criteria.cause_nats, 2 * height, rank, is_wide=True, formulas=(formula,),
        n_dims=view.dataset.n_dims,
    )  # fmt: skip


def _gravity(view, names, strengths, rank, height):
    """The attraction by masses that are not known."""
    masses = strengths / GRAVITATIONAL_CONSTANT
    least = LEAST * float(np.max(masses))  # what moves has a mass
    masses = np.maximum(masses, LITTLE * least)
    spread = WIDE * float(np.sqrt(np.mean(np.square(masses))))
    prior = Prior("truncated_normal", low=least, mean=0.0, sd=spread)
    values, latents = tuple(map(float, masses)), latents_of_bodies(names, "mass", prior)
    part = Properties(latents, (("mass", Unit.of(kg=1)),), values, is_absolute=True)
    formula = parse_formula(ATTRACTION, TYPES)
    return Proposal(
        "gravity", to_text(formula), view.hypothesis + part + Forces(
            ForceLaw((Term(formula),), {})
        ),
        -view.criteria.cause_nats, 2 * height, rank, is_wide=True, formulas=(formula,),
        n_dims=view.dataset.n_dims, is_first=True, patience=PATIENT,
    )  # fmt: skip


def _text(column, power):
    """The pull of all bodies by their number in a column."""
    return f"m_i * {column}_j * norm(p_i - p_j)^{power} * normalize(p_j - p_i)"
