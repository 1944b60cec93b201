"""A body that no track shows: places far and near, each with the pull that visible bodies have.

Beside that an attraction as the inverse square of the distance is asked for: one body alone, or
bodies of which no force on each other is declared, may go round what nobody sees.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bsp_gp.data.ephemeris import GRAVITATIONAL_CONSTANT
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.hidden import HiddenSource, beside_origin, pull_of, unit_pull
from bsp_gp.language.formula import evaluate
from bsp_gp.language.inputs import STATE_INPUTS, input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import PATIENT, Family, Proposal
from bsp_gp.loop.proposers.centres import strength_of
from bsp_gp.loop.whereabouts import whereabouts
from bsp_gp.physics.bodies import law_inputs
from bsp_gp.physics.force import ForceLaw, Term, fresh_name
from bsp_gp.units import Unit

FARTHEST = 30.0
"""Places are sought up to so many sizes of the data from their middle."""
N_NEAR, N_RINGS, N_WAYS = 21, 12, 36
"""Places along an axis within twice the data, distances beyond, and directions of each."""
ALIKE = 0.95
"""Correlation of moments above which two places are one start."""
N_STARTS = 2
CHUNK = 1 << 22
"""Numbers in one array at a time."""
ATTRACTION = "m_i * (p_j - p_i) / norm(p_j - p_i)^3"
GRAVITY = f"{GRAVITATIONAL_CONSTANT} [m^3/(kg s^2)] * m_j * {ATTRACTION}"
TYPES = {**input_types({"mass": Unit.of(kg=1)}), **{n: STATE_INPUTS[n] for n in ("p_i", "p_j")}}
ZOOMS, CLOSER, MOVES, LITTLE = 6, 2.5, 4, 1e-4
"""Finer grids about the best places, how much finer each is, times that one moves along, and the
part of a gain that is worth it."""
AWAY = 0.1
"""Part of the data's size that a fit may miss and still lead to what extends it."""
MOST = 0.9
"""Part of what no law at all leaves that a source explains, from which it is fitted in any case."""
LONG = 8
"""Times the patience of other laws with which a source where places count from is fitted: of many
turns that planets disturb the descent is long, and hardly anything else moves a body of the sky."""
SAME = 1e-6
"""By which two pulls may differ that are one."""


class Sources:
    """What proposers of unseen bodies share."""

    name = ""

    def family(self, proposals, null, n_tried):
        """The family of proposals found among so many places."""
        proposals = sorted(proposals, key=lambda p: -p.promise)
        best = max((p.gain for p in proposals), default=0.0)
        return Family(
            self.name, tuple(proposals), best, 1 if n_tried else 0, null, n_tried=n_tried,
            is_continuum=True,
        )  # fmt: skip

    def details(self, view, proposal, fit, rng):
        """What the posterior of a fitted source is, see `whereabouts`."""
        *_, part = (p for p in proposal.hypothesis.parts if isinstance(p, HiddenSource))
        found = whereabouts(view.dataset, part, fit, rng)
        return found and {**found, "beside": view.reference}


class Hidden(Sources):
    """Unseen sources as a proposer."""

    name = "hidden"
    is_of_sky = True

    def propose(self, view):
        """The family of sources at rest, and for a single recording of moving ones."""
        if view.dataset.units.is_angle:  # no angle says where a source might be
            return Family(self.name)
        stage = Stage(view)
        null = np.zeros(view.moment_draws.shape[1])
        proposals, n_tried = [], 0
        known = []
        pulls = pulls_of(view, stage.strength)
        if view.dataset.n_moving_axes > 1:  # on a line, `inside` asks for attractors anywhere
            pulls.append(attraction(view, stage))
        for terms in pulls:
            parts = [stage.columns(terms, still(part)) for part in stage.chunks]
            unit, _ = stage.beside(np.concatenate(parts, axis=1))
            if any(_are_same(unit, other) for other in known):
                continue
            known.append(unit)
            gains = stage.gains(terms, unit.T @ view.left)
            null = np.maximum(null, np.square(unit.T @ view.draws_left).max(axis=0))
            n_tried += len(gains)
            for k in apart(unit, gains):
                proposals += stage.proposals(terms, *stage.closer(terms, k))
        family = self.family(proposals, null, n_tried)
        first = _at_origin(view, stage)
        if first:  # where tables of the sky count from, whether that body is in them or not
            proposals = (*first, *family.proposals)
            return replace(family, proposals=proposals, n_controls=len(first))
        most = MOST * float(view.left @ view.left)
        # Of orbits with few rows a turn moments tell all but the power: who goes round what nobody
        # sees is fitted as that, whatever sums of other forms promise.
        is_orbit = not view.fit.law.terms and family.gain > most
        return replace(family, n_controls=int(is_orbit))


def pulls_of(view, strength):
    """Sets of terms by which one source may act, each with its pull per unit of strength.

    Parameters
    ----------
    strength : str
        Name of the constant that stands for the strength.

    Returns
    -------
    list of tuple of (Term, Term)
    """
    law, columns = view.fit.law, {}
    for term in law.terms:
        is_placed = term.kind == "pair" and "p_j" in term.formula.inputs
        pull = unit_pull(term, strength) if is_placed else None
        if pull is not None:
            columns.setdefault(pull[1], []).append((term, Term(pull[0], "pair")))
    return [tuple(both) for both in columns.values()]


def attraction(view, stage):
    """The pull of a source as the inverse square of the distance, as of `pulls_of`.

    It is gravity where the data are as large as that takes, else one of its own strength.
    """
    term = Term(stage.gravity if view.is_astronomical else parse_formula(ATTRACTION, TYPES), "pair")
    return ((term, Term(unit_pull(term, stage.strength)[0], "pair")),)


def _are_same(unit, other):
    """Whether the columns of two pulls are the same at every place."""
    cosines = np.abs(np.einsum("nc,nc->c", unit, other))
    return bool(np.all(cosines[(unit != 0).any(axis=0)] > 1 - SAME))


def _at_origin(view, stage):
    """A source at rest where the places count from, if the tracks bend towards that; or none.

    Where rows are few a turn, or turns many, moments along tracks tell no place: how fast bodies
    bend tells the mass.
    """
    if not view.is_astronomical or view.fit.law.terms or view.reference:
        return ()
    strength = strength_of(view.dataset, lambda scene: np.zeros(scene.n_dims))
    if strength is None:
        return ()
    terms, place = attraction(view, stage), np.zeros(stage.n_dims)
    gain = max(float(view.left @ view.left) - view.n_left, 0.0)
    every = stage.proposals(terms, place, strength / GRAVITATIONAL_CONSTANT, gain)
    return tuple(replace(each, is_first=True, patience=LONG * PATIENT) for each in every)


def still(places):
    """Tracks of sources at rest (C, d)."""
    return lambda batch: (places, np.zeros_like(places))


class Stage:
    """Places at which a source is sought."""

    def __init__(self, view):
        self.view = view
        batches = view.response.regression.batches
        shown = [b.positions[b.valid.any(axis=(2, 3))] for b in batches]
        places = np.concatenate([p.reshape(-1, p.shape[-1]) for p in shown])
        low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
        self.middle, self.size = (low + high) / 2, float(np.max(high - low)) / 2 or 1.0
        v = np.concatenate([b.velocities[b.valid.any(axis=(2, 3))].ravel() for b in batches])
        self.speed = float(np.sqrt(np.nanmean(np.square(v)))) or 1.0
        self.n_dims = len(self.middle)
        law = view.fit.law
        self.strength = fresh_name(law, "M")
        self.gravity = parse_formula(GRAVITY, TYPES)
        self.names = tuple(fresh_name(law, f"h_{axis}") for axis in "xyz"[: self.n_dims])
        self.places = self.middle + self.size * _grid(self.n_dims)
        per_place = sum(b.target.size for b in batches)
        step = max(CHUNK // per_place, 1)
        self.chunks = [self.places[k : k + step] for k in range(0, len(self.places), step)]

    def columns(self, terms, tracks, batches=None):
        """Moments of the pull of unit strength of C sources, (n, C).

        Parameters
        ----------
        terms : tuple of (Term, Term)
        tracks : callable
            ``tracks(batch)`` gives places and velocities, (C, d) or (n, S, 1, C, d).
        batches : sequence of ResponseBatch, optional
            By default those of the view.
        """
        view = self.view
        constants = {
            name: value
            for name, value in view.fit.law.constants.items()
            if not hasattr(value, "items")
        }
        constants |= {name: 1.0 for _, pull in terms for name in pull.formula.constants
                      if name not in constants}  # fmt: skip
        parts = []
        for batch in batches or view.response.regression.batches:
            places, velocities = tracks(batch)
            lookup = _Spread(batch, places, velocities)
            total = 0.0
            for _, pull in terms:
                formula = pull.acceleration_formula
                formula = beside_origin(formula) if view.reference else formula
                force = evaluate(formula, lookup, constants)
                if pull.needs_mass:
                    force = force / lookup["m_i"][..., None]
                total = total + force
            count = places.shape[-2]
            shape = (*batch.target.shape[:3], count, self.n_dims)
            total = np.broadcast_to(np.where(np.isfinite(total), total, 0.0), shape)
            moments = batch.whiten(total)
            parts.append(np.moveaxis(moments[:, :, 0, :, 0], -1, 0).reshape(count, -1))
        return np.concatenate(parts, axis=1).T

    def beside(self, columns):
        """Columns (n, C) beside all constants, of unit length, and their lengths."""
        rows = self.view.beside(columns)
        size = np.square(rows).sum(axis=0)
        good = size > 1e-8 * np.square(columns).sum(axis=0)
        size = np.sqrt(np.where(good, size, 1.0))
        return np.where(good, rows / size, 0.0), size

    @property
    def common(self):
        """What is far and fast, as parts take it."""
        return {
            "middle": tuple(map(float, self.middle)), "size": self.size, "speed": self.speed,
            "strength": self.strength,
        }  # fmt: skip

    def column(self, terms):
        """The property by which sources act; "" where they all act alike."""
        return unit_pull(terms[0][0], self.strength)[1]

    def source(self, terms, starts, speeds=(), **own):
        """A source that begins as `starts` say, a part; `own` stands in place of what is common."""
        is_relative, epoch = bool(self.view.reference), own.get("epoch", 0.0)
        pulls = tuple(
            pull_of(term, self.strength, self.names, speeds, epoch, is_relative)
            for term, _ in terms
        )
        return HiddenSource(
            ForceLaw(pulls, _known(self.view, terms, starts)), None, self.names, speeds,
            **{**self.common, **own}, between=tuple(term for term, _ in terms),
        )  # fmt: skip

    def proposal(self, motion, terms, parts, gain, starts, log_prior, **more):
        """A source, and what else `parts` are, as a cause that may be missing."""
        text = " + ".join(to_text(term.formula) for term, _ in terms)
        return Proposal(
            "hidden_body", f"{motion}: {text}", self.view.hypothesis + Hypothesis(parts),
            log_prior, gain, sum(len(part.parameters) for part in parts), starts,
            self.bounds(terms), kind="hidden_body", **more,
        )  # fmt: skip

    def gains(self, terms, along):
        """Chi-squared that sources gain by strengths `along`, as far as these are allowed."""
        return np.square(np.maximum(along, 0.0) if self.bounds(terms) else along)

    def closer(self, terms, k):
        """The best place near one of the grid, the strength there, and the gain.

        Near a track what a source explains changes within much less than the grid is wide.
        """
        span = np.linspace(-1.0, 1.0, 5 if self.n_dims == 2 else 3)
        steps = np.stack(np.meshgrid(*(span,) * self.n_dims, indexing="ij"), axis=-1)
        steps, place = steps.reshape(-1, self.n_dims), self.places[k]
        near = np.linalg.norm(self.places - place, axis=1)
        wide, best = float(near[near > 0].min()), None
        for zoom in range(ZOOMS):
            for _ in range(MOVES):
                places = place + steps * wide / CLOSER**zoom
                unit, size = self.beside(self.columns(terms, still(places)))
                along = unit.T @ self.view.left
                gains = self.gains(terms, along)
                top = int(np.argmax(gains))
                if best is not None and not gains[top] > (1 + LITTLE) * best[2]:
                    break
                place, best = places[top], (places[top], along[top] / size[top], gains[top])
        return best[0], float(best[1]), float(best[2])

    def proposals(self, terms, place, strength, gain):
        """A source at a place, at rest; in one recording also moving."""
        place = dict(zip(self.names, map(float, place), strict=True))
        starts = {self.strength: strength, **place}
        prior, more = self.log_prior(terms), {"is_afresh": self.is_led_away}
        rest = self.source(terms, starts)
        out = [self.proposal("at rest", terms, (rest,), gain, starts, prior, **more)]
        if len(self.view.dataset.scenes) == 1:
            times = self.view.dataset.scenes[0].times
            speeds = tuple(fresh_name(self.view.fit.law, f"u_{a}") for a in "xyz"[: self.n_dims])
            starts = {**starts, **dict.fromkeys(speeds, 0.0)}
            moving = self.source(terms, starts, speeds, epoch=float(times[0] + times[-1]) / 2)
            if any(term.is_declared for term, _ in terms):  # by which its way would bend
                prior -= self.view.odd_nats
            out.append(self.proposal("moving", terms, (moving,), gain, starts, prior, **more))
        return out

    def log_prior(self, terms):
        """Of a source beforehand, nats: gravity is what bends tracks of astronomical size."""
        is_gravity = all(to_text(term.formula) == to_text(self.gravity) for term, _ in terms)
        return 0.0 if is_gravity else -self.view.criteria.cause_nats

    def bounds(self, terms):
        """Of the strength: nothing pushes by its mass, nor at the size of the sky."""
        is_sky = self.view.is_astronomical or self.view.reference
        is_pull = self.column(terms) == "mass" or is_sky
        return {self.strength: (0.0, math.inf)} if is_pull else {}

    @property
    def is_led_away(self):
        """Whether the fit is so far from the data that what is missing leads it elsewhere."""
        left = self.view.fit.residual
        return bool(np.nanmax(np.abs(left)) > AWAY * self.size)


def _known(view, terms, starts):
    """Constants of the pulls: those of the law, and where the others begin."""
    names = {n for _, pull in terms for n in pull.formula.constants} | set(starts)
    law = view.fit.law.constants
    return {n: starts.get(n, law.get(n)) for n in names}


class _Spread(Mapping):
    """Inputs of one source with an axis for candidates behind those of the rows."""

    def __init__(self, batch, places, velocities):
        self._inputs = law_inputs(
            "field", batch.bodies, batch.positions, batch.velocities, batch.times
        )
        self._of_source = {"p_j": places, "v_j": velocities}

    def __getitem__(self, name):
        if name in self._of_source:
            return self._of_source[name]
        value = np.asarray(self._inputs[name])
        if value.ndim == 1:  # a direction
            return value
        vector = name in ("p_i", "v_i")
        return value[..., None, :] if vector else value[..., None]

    def __iter__(self):
        return iter(self._inputs)

    def __len__(self):
        return len(self._inputs)


def _grid(n_dims):
    """Places about the middle, in sizes of the data: a lattice near, rings far away."""
    axis = np.linspace(-2.0, 2.0, N_NEAR if n_dims == 2 else N_NEAR // 2)
    near = np.stack(np.meshgrid(*(axis,) * n_dims, indexing="ij"), axis=-1).reshape(-1, n_dims)
    far = np.geomspace(2.0, FARTHEST, N_RINGS)
    if n_dims == 2:
        angle = 2 * np.pi * np.arange(N_WAYS) / N_WAYS
        ways = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    else:
        k = np.arange(3 * N_WAYS) + 0.5
        polar, turn = np.arccos(1 - 2 * k / len(k)), np.pi * (1 + 5**0.5) * k
        ways = np.stack(
            [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1
        )
    return np.concatenate([near, (far[:, None, None] * ways).reshape(-1, n_dims)])


def apart(unit, gains):
    """The best places that do not look alike."""
    chosen = []
    for k in np.argsort(-gains):
        if len(chosen) == N_STARTS:
            break
        if all(abs(unit[:, k] @ unit[:, other]) < ALIKE for other in chosen):
            chosen.append(int(k))
    return chosen
