"""An unseen body that the law moves with the bodies that are seen, where one recording shows them.

Its states in the middle of the recording are sought: at rest, or on circles about the strongest
body in the plane of the tracks; the best are improved by drawing about them. Scores are those of
the pull along the track that the visible bodies give a body of no weight.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.stats import norm, qmc

from bsp_gp.data.scene import Entity, Scene
from bsp_gp.fitting.parts.hidden import HiddenBody, body_pulls
from bsp_gp.fitting.parts.inclined import stretched
from bsp_gp.language.inputs import property_of
from bsp_gp.loop.proposal import PATIENT, Family
from bsp_gp.loop.proposers.hidden import Sources, Stage, apart, attraction, pulls_of, still
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion, Points
from bsp_gp.physics.force import ForceLaw, Unseen, fresh_name, numbered
from bsp_gp.physics.masses import are_units

N_STEPS = 96
"""Of the integration over the recording."""
N_PEAKS = 24
"""Places at which a body at rest does best, tried as one that is let go there."""
N_DRAWS, N_BEST, N_TURNS = 128, 16, 16
WIDTH = 0.2
"""Of the first draws about a start, in its distance from the strongest body and its speed."""
LEAST_WIDTH, SETTLED = 1e-6, 1e-3
"""Part of that width that is left at least, and gain from turn to turn that is none."""


class Companions(Sources):
    """Unseen bodies under the law as a proposer."""

    name = "companions"

    def propose(self, view):
        """The family of bodies let go, and on circles."""
        is_angle = view.dataset.units.is_angle
        if is_angle or len(view.dataset.scenes) > 1 or not _moves_anything(view):
            return Family(self.name)
        stage = Stage(view)
        null, proposals, n_tried = np.zeros(view.moment_draws.shape[1]), [], 0
        for terms in pulls_of(view, stage.strength) or [attraction(view, stage)]:
            orbits = Orbits(view, stage, terms)
            states = orbits.states()
            gains, strengths, unit = orbits.scores(states)
            null = np.maximum(null, np.square(unit.T @ view.draws_left).max(axis=0))
            n_tried += len(gains)
            chosen = states[apart(unit, np.where(strengths > 0, gains, 0.0))]
            if view.reference:  # the tide of a body is nearly that of one on the other side
                chosen = np.concatenate([chosen, -chosen])
            proposals += [orbits.proposal(*best) for best in orbits.improved(chosen)]
        return self.family(proposals, null, n_tried)


def _moves_anything(view):
    """Whether the law acts from bodies, and moves a body of which nothing is known."""
    law, masses = view.fit.law, are_units(view.dataset)
    own = [property_of(n) for t in law.terms for n in t.acceleration_formula.inputs]
    is_known = not any((t.needs_mass and not masses) or law.is_per_entity(t) for t in law.terms)
    is_known = is_known and all(found is None or found[1] == "j" for found in own)
    kinds = {t.kind for t in law.terms}
    return is_known and not law.unseen and ("pair" in kinds or bool(kinds and view.reference))


class Orbits:
    """Tracks of bodies of no weight among those of a view, and how well each would do.

    Parameters
    ----------
    terms : tuple of (Term, Term)
        By which the body acts, of `pulls_of`.

    Attributes
    ----------
    times : ndarray, shape (K,), s
        Of the integration; states are those in its middle.
    """

    def __init__(self, view, stage, terms):
        self.view, self.stage, self.terms = view, stage, terms
        self.scene = _fitted_scene(view)
        self.own = {"mass": 1.0} if are_units(view.dataset) else {}
        unknown = Entity(numbered("unseen", self.scene.names), properties=self.own)
        blank = np.full((len(self.scene.times), 1, stage.n_dims), np.nan)
        whole = [np.concatenate([v, blank], axis=1)
                 for v in (self.scene.positions, self.scene.velocities)]  # fmt: skip
        self.column = stage.column(terms)
        crew = tuple(replace(e, is_static=True) for e in self.scene.entities)
        if view.reference and not self.column:  # companions are light
            kept = [k for k, e in enumerate(crew) if e.name == view.reference]
            crew, whole = tuple(crew[k] for k in kept), [v[:, [*kept, -1]] for v in whole]
        self.crew = crew
        probe = Scene("probe", self.scene.times, whole[0], (*crew, unknown), whole[1])
        law = replace(view.fit.law, frame=())
        (chains,) = build_chains(law, (probe,), view.dataset.up, "measured")
        motion = Motion(law, chains, ())
        motion.set_constants(np.zeros(0))
        self.flow = Flow(motion, np.ones(1))
        self.times = np.linspace(self.scene.times[0], self.scene.times[-1], N_STEPS + 1)

    # --- tracks ----------------------------------------------------------------------------------

    def tracks(self, states):
        """Places and velocities from states (C, 2 d) in the middle, (K, 2, d, C)."""
        count, d = len(states), self.stage.n_dims
        out = np.empty((len(self.times), 2, d, count))
        middle = N_STEPS // 2
        out[middle] = states.T.reshape(2, d, count)
        with np.errstate(all="ignore"):
            for sign, stop in ((1, N_STEPS), (-1, 0)):
                for k in range(middle, stop, sign):
                    t, h = self.times[k], self.times[k + sign] - self.times[k]
                    y = out[k]
                    a = self.rate(t, y)
                    b = self.rate(t + h / 2, y + h / 2 * a)
                    c = self.rate(t + h / 2, y + h / 2 * b)
                    e = self.rate(t + h, y + h * c)
                    out[k + sign] = y + h / 6 * (a + 2 * b + 2 * c + e)
        return out

    def rate(self, time, state):
        """Velocities and accelerations of states (2, d, C) at an instant."""
        count = state.shape[-1]
        chain, times = np.zeros(count, dtype=int), np.full(count, time)
        driven = self.flow.driven.at(times[:1], chain[:1])
        driven = np.broadcast_to(driven, (*driven.shape[:-1], count))
        points = Points(state[:, None], times, chain, driven, [])
        points = replace(points, modes=self.flow.motion.modes_at(points))
        return np.stack([state[1], self.flow.motion.acceleration(points)[0]])

    def _at(self, tracks, batch):
        """Places and velocities at the instants of a batch, (n, S, 1, C, d) each, by cubics."""
        times = np.nan_to_num(batch.times)
        h = self.times[1] - self.times[0]
        k = np.clip(((times - self.times[0]) / h).astype(int), 0, N_STEPS - 1)
        u = ((times - self.times[k]) / h)[..., None, None]
        (a, va), (b, vb) = np.moveaxis(tracks[k], 2, 0), np.moveaxis(tracks[k + 1], 2, 0)
        with np.errstate(all="ignore"):  # some run away
            bend, twist = 3 * (b - a) - h * (2 * va + vb), 2 * (a - b) + h * (va + vb)
            place = a + u * (h * va + u * (bend + u * twist))
            velocity = va + u * (2 * bend + 3 * u * twist) / h
        return tuple(np.swapaxes(v, 2, 3)[:, :, None] for v in (place, velocity))

    # --- scores ----------------------------------------------------------------------------------

    def columns(self, states):
        """Moments of the pull of unit strength of bodies in these states, (n, C)."""
        step, parts = max(len(self.stage.chunks[0]), 1), []
        for first in range(0, len(states), step):
            tracks = self.tracks(states[first : first + step])
            parts.append(self.stage.columns(self.terms, partial(self._at, tracks)))
        return np.concatenate(parts, axis=1)

    def scores(self, states):
        """Gains and strengths (C,) of states, and their columns of unit length (n, C)."""
        unit, size = self.stage.beside(self.columns(states))
        along = unit.T @ self.view.left
        return np.square(along), along / size, unit

    def states(self):
        """States to begin with, (C, 2 d)."""
        stage, d = self.stage, self.stage.n_dims
        places = stage.places
        parts = [stage.columns(self.terms, still(part)) for part in stage.chunks]
        unit, _ = stage.beside(np.concatenate(parts, axis=1))
        peaks = places[np.argsort(-np.square(unit.T @ self.view.left))[:N_PEAKS]]
        let_go = np.concatenate([peaks, np.zeros_like(peaks)], axis=1)
        axes = np.eye(d)
        if d == 3:  # in the plane of the tracks
            seen = self.scene.positions.reshape(-1, d)
            axes = np.linalg.svd(seen - seen.mean(axis=0), full_matrices=False)[2]
            flat = (places - stage.middle) @ np.diag([1.0, 1.0, 0.0])
            places = stage.middle + np.unique(flat, axis=0) @ axes
        centre, moved = self.strongest()
        offset = places - centre
        (rate,) = [self.rate(self.times[N_STEPS // 2],
                             np.stack([places.T, 0 * places.T]))[1].T]  # fmt: skip
        along = np.sqrt(np.maximum(-(rate * offset).sum(axis=1), 0.0))
        flat = offset @ axes[:2].T
        radius = np.linalg.norm(flat, axis=1, keepdims=True)
        across = np.stack([-flat[:, 1], flat[:, 0]], axis=1) / np.where(radius > 0, radius, 1.0)
        circular = along[:, None] * (across @ axes[:2])
        both = [np.concatenate([places, moved + v], axis=1) for v in (circular, -circular)]
        return np.concatenate([let_go, *both])

    def strongest(self):
        """Place and velocity of the body that pulls most, in the middle of the recording."""
        strengths = [e.properties.get(self.column, 0.0) for e in self.crew]
        k = int(np.nanargmax(np.abs(strengths)))
        states = self.flow.driven.at(self.times[[N_STEPS // 2]], np.zeros(1, dtype=int))
        return states[0, k, :, 0], states[1, k, :, 0]

    def improved(self, states):
        """The best states near some (B, 2 d), their gains and strengths.

        Each turn draws about the best of the last one, as widely as the best of its draws lie.
        """
        d, (centre, moved) = self.stage.n_dims, self.strongest()
        away = np.linalg.norm(states[:, :d] - centre, axis=1)
        pace = np.linalg.norm(states[:, d:] - moved, axis=1) + WIDTH * self.stage.speed
        widths = WIDTH * np.repeat(np.stack([away, pace], axis=1), d, axis=1)
        z = norm.ppf(qmc.Sobol(2 * d, scramble=False).fast_forward(1).random(N_DRAWS))
        factors = [np.diag(width) for width in widths]
        gains, strengths, _ = self.scores(states)
        best = list(zip(states, gains, strengths, strict=True))
        for _ in range(N_TURNS):
            near = np.array([b[0] + z @ f.T for b, f in zip(best, factors, strict=True)])
            gains, strengths, _ = self.scores(near.reshape(-1, 2 * d))
            gains = np.where(np.isfinite(gains) & (strengths > 0), gains, -1.0)
            before = max(b[1] for b in best)
            for k, own in enumerate(np.split(np.arange(len(gains)), len(best))):
                order = own[np.argsort(-gains[own])[:N_BEST]]
                places = near[k, order - own[0]]
                if gains[order[0]] > best[k][1]:
                    best[k] = places[0], gains[order[0]], strengths[order[0]]
                spread = places - best[k][0]
                least = np.diag(np.square(LEAST_WIDTH * widths[k]))
                factors[k] = np.linalg.cholesky(spread.T @ spread / N_BEST + least)
            if max(b[1] for b in best) - before <= SETTLED * (1 + before):
                break
        return best

    def proposal(self, state, gain, strength):
        """A body in this state as a cause that may be missing."""
        stage, view, d = self.stage, self.view, self.stage.n_dims
        first = self.tracks(state[None])[0, :, :, 0].ravel()
        speeds = tuple(fresh_name(view.fit.law, f"u_{axis}") for axis in "xyz"[:d])
        unit = view.dataset.property_units.get(self.column)
        known = {} if unit is None else {stage.strength: unit}
        body = Unseen(numbered("unseen", self.scene.names), stage.names, speeds, known)
        starts = dict(zip((stage.strength, *body.names), map(float, (strength, *first)),
                          strict=True))  # fmt: skip
        declared = {term.formula for term in view.fit.law.terms}
        pulls = tuple(
            pull for term, _ in self.terms
            for pull in body_pulls(
                term, stage.strength, term.formula in declared, bool(view.reference)
            )
        )  # fmt: skip
        names = {n for pull in pulls for n in pull.formula.constants}
        law = view.fit.law.constants
        known = {**{n: law[n] for n in names if n in law}, **starts}
        part = HiddenBody(
            ForceLaw(pulls, known, unseen=(body,)), None, stage.names, speeds, **stage.common,
            between=tuple(term for term, _ in self.terms), epoch=float(self.times[0]),
            properties={**self.own, **({self.column: float(strength)} if self.column else {})},
        )  # fmt: skip
        return stage.proposal(
            "under the law", self.terms, (part,), float(gain), starts,
            view.odd_nats - view.criteria.cause_nats,
            patience=PATIENT if view.reference else 1, has_other_starts=bool(view.reference),
        )  # fmt: skip


def _fitted_scene(view):
    """The recording with moving bodies where the fit has them, in the plane of their motion."""
    (scene,), plane = view.dataset.scenes, stretched(view.fit.law)
    places, speeds = np.array(scene.positions), np.full(scene.positions.shape, np.nan)
    for chains, nodes in zip(view.fit.groups, view.fit.nodes, strict=True):
        for s, names in enumerate(chains.bodies):
            for r, name in enumerate(names):
                k = scene.names.index(name)
                places[:, k], speeds[:, k] = np.moveaxis(nodes[:, r, :, :, s], 1, 2)
    if plane is not None:
        places, speeds = places @ plane.T, speeds @ plane.T
    return replace(scene, positions=places, velocities=speeds)
