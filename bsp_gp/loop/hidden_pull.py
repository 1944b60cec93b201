"""The pull of a source that no camera sees, under the pair law that holds between visible bodies.

What the law needs of a source beside its place is one number, its strength: the mass in a law of
gravity, the charge in Coulomb's. The pull is linear in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.data.scene import Entity, Scene
from bsp_gp.language.inputs import property_of
from bsp_gp.physics.bodies import Bodies, stack
from bsp_gp.physics.evaluation import PreparedLaw
from bsp_gp.physics.force import ForceLaw

__all__ = ["HIDDEN_NAME", "Pull", "hidden_entity", "hidden_name", "pulls_of"]

HIDDEN_NAME = "hidden body"
TOUCHING = {"s_i", "s_j", "p_c"}
"""Inputs of laws of contact: what has no known extent cannot touch."""
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Pull:
    """Pair terms of a law as they act from one unseen source.

    Attributes
    ----------
    law : ForceLaw
        The pair terms that name no other property of a source than `column`.
    column : str
        The property that is the source's strength.
    is_positive : bool
        Whether a strength below zero is ruled out: no visible body has one.
    most : float
        Greatest strength of a visible body.
    others : tuple of str
        Further properties that the whole law asks of a source; the unseen one has none of them.
    """

    law: ForceLaw
    column: str
    is_positive: bool
    most: float
    others: tuple = ()

    def under(self, law):
        """The same pull with the constants of a later fit."""
        constants = {name: law.constants[name] for name in self.law.constants}
        return replace(self, law=self.law.with_constants(constants))

    def on(self, entities, n_dims, up=None):
        """The pull of unit strength on some receivers.

        Parameters
        ----------
        entities : sequence of Entity
            The receivers of one scene.
        n_dims : int
        up : str, optional

        Returns
        -------
        callable
            ``pull(positions, velocities, times, places, place_velocities)``: accelerations
            (C, n, R, d) at states (n, R, d) and times (n,) from places (C, n, d).
        """
        bodies = _one_source(entities, hidden_entity(self, 1.0), n_dims, up)
        law = PreparedLaw(self.law, bodies)

        def pull(positions, velocities, times, places, place_velocities):
            n_receivers = positions.shape[1]
            shape = (*places.shape[:2], 1, n_receivers + 1, places.shape[-1])
            p, v = np.empty(shape), np.empty(shape)
            p[..., 0, :n_receivers, :], v[..., 0, :n_receivers, :] = positions, velocities
            p[..., 0, n_receivers, :], v[..., 0, n_receivers, :] = places, place_velocities
            found = law.acceleration(p, v, np.asarray(times)[:, None])[:, :, 0]
            return np.where(np.isfinite(found), found, 0.0)

        return pull


class _OneSource(Bodies):
    """Bodies of which the last alone is a source."""

    def __post_init__(self):
        n = len(self.receivers)
        object.__setattr__(self, "others", np.full((n, 1), n))


def _one_source(entities, hidden, n_dims, up):
    still = np.arange(3.0)[:, None, None] + np.arange(len(entities) + 1.0)[:, None] * 10.0
    scene = Scene(
        "receivers", np.arange(3.0), np.broadcast_to(still, (3, len(entities) + 1, n_dims)),
        (*entities, hidden),
    )  # fmt: skip
    bodies = stack([scene], up)[0].bodies
    return _OneSource(
        bodies.names, np.arange(len(entities)), bodies.properties, bodies.shapes, bodies.n_dims, up
    )


def hidden_entity(pull, strength, name=HIDDEN_NAME):
    """An unseen source as an entity."""
    blank = dict.fromkeys(pull.others, 0.0)
    return Entity(name, is_static=True, properties={**blank, pull.column: float(strength)})


def hidden_name(scenes):
    """A name that no visible body bears."""
    taken = {name for scene in scenes for name in scene.names}
    number, name = 1, HIDDEN_NAME
    while name in taken:
        number += 1
        name = f"{HIDDEN_NAME} {number}"
    return name


def pulls_of(observation, law):
    """What an unseen source could do under a law, one `Pull` for each property of sources.

    Parameters
    ----------
    observation : Observation
    law : ForceLaw
        Fitted.

    Returns
    -------
    list of Pull
        Empty if the law has no pair term that acts at a distance with a strength of its source.
    """
    terms, named = {}, {}
    for term in law.terms:
        inputs = term.formula.inputs
        known = [property_of(name) for name in sorted(inputs)]
        columns = {column for column, role in filter(None, known) if role == "j"}
        if term.kind != "pair" or inputs & TOUCHING:
            continue
        named.update(dict.fromkeys(sorted(columns)))
        if len(columns) == 1:
            terms.setdefault(columns.pop(), []).append(term)
    out = []
    for column, own in terms.items():
        values = np.array(
            [
                entity.properties.get(column, np.nan)
                for scene in observation.train
                for entity in scene.entities
                if np.ndim(entity.properties.get(column, np.nan)) == 0
            ]
        )
        values = values[np.isfinite(values)]
        if not values.any():
            continue
        constants = {n: law.constants[n] for term in own for n in term.formula.constants}
        pull = Pull(
            ForceLaw(tuple(own), constants), column, bool((values >= 0).all()),
            float(np.abs(values).max()), tuple(c for c in named if c != column),
        )  # fmt: skip
        if _is_linear(pull, observation):
            out.append(pull)
    return out


def _is_linear(pull, observation):
    """Whether twice the strength pulls twice as much."""
    scene = observation.train[0]
    receivers = [scene.entities[k] for k in scene.dynamic]
    place = np.nanmax(scene.positions, axis=(0, 1)) + 1.0
    p = np.where(np.isfinite(scene.positions[0]), scene.positions[0], 0.0)
    p = p[scene.dynamic]
    found = []
    for strength in (1.0, 2.0):
        hidden = hidden_entity(pull, strength)
        bodies = _one_source(receivers, hidden, scene.n_dims, observation.dataset.up)
        states = np.concatenate([p, place[None]])[None]
        found.append(pull.law.acceleration(bodies, states, np.ones_like(states), scene.times[:1]))
    one, two = found
    size = np.abs(one).max()
    return bool(np.isfinite(two).all() and size > 0 and np.allclose(two, 2 * one, atol=SAME * size))
