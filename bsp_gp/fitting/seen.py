"""A law in the coordinates in which bodies are seen, and what delays and exposures show of tracks.

A measurement shows q of a true place p = u(q, t; phi) at the true time T(t). With the total
derivative D along a seen track, D u = J q' + du/dt, the true velocity is D u / T', and
``q'' = J^-1 (T'^2 a - D D u at q'' = 0)``. All of it is an expression, so that its derivatives by
states, constants and phi are exact, and fixed bodies are seen through the same instrument. A delay
and an exposure are no maps of places: ``seen = q - delay q' + (delay^2 + variance) / 2 q''``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.fitting.parts.instrument import Delay, Exposure

__all__ = ["Frame", "Sight", "places_of", "sight", "superposed"]


class Frame:
    """True states behind what is seen, as nodes of a graph.

    Parameters
    ----------
    graph : Graph
    parts : sequence of Instrument
    n_dims : int
    kind : str
        Of the terms; "pair" has sources.

    Attributes
    ----------
    state : dict of str to nodes
        What the inputs of a law are.
    """

    def __init__(self, graph, parts, n_dims, kind):
        self.graph, self.parts, self.kind = graph, parts, kind
        self.axes = range(n_dims)
        self.time = graph.input("t")
        self.state = {}
        for role in "ij" if kind == "pair" else "i":
            self._add(role)

    def _add(self, role):
        g = self.graph
        place, time = tuple(g.input(f"p_{role}", k) for k in self.axes), self.time
        is_driven = g.input("is_driven") if role == "j" else g.zero
        for part in reversed(self.parts):
            place, time = part.undo(g, place, time, is_driven)
        self.rate = g.slope(time, self.time)
        velocity = tuple(g.div(self._along(x, role), self.rate) for x in place)
        self.state |= {f"p_{role}": place, f"v_{role}": velocity, "t": time}

    def _along(self, node, role):
        """Derivative by the measured time along a seen track without acceleration."""
        g = self.graph
        moved = (
            g.mul(g.slope(node, g.input(f"p_{role}", k)), g.input(f"v_{role}", k))
            for k in self.axes
        )
        return g.add(g.sum(moved), g.slope(node, self.time))

    def acceleration(self, true):
        """Seen accelerations from true ones, nodes; forces of sources come without the bend."""
        g, place = self.graph, self.state["p_i"]
        right = [g.mul(g.call("square", self.rate), a) for a in true]
        if self.kind == "field":
            bend = (self._along(self._along(x, "i"), "i") for x in place)
            right = [g.sub(a, b) for a, b in zip(right, bend, strict=True)]
        rows = [[g.slope(x, g.input("p_i", k)) for k in self.axes] for x in place]
        if all(x == (g.one if i == k else g.zero)
               for i, row in enumerate(rows) for k, x in enumerate(row)):  # fmt: skip
            return right
        whole = self._determinant(rows)
        return [  # Cramer
            g.div(
                self._determinant(
                    [[*row[:k], b, *row[k + 1 :]] for row, b in zip(rows, right, strict=True)]
                ),
                whole,
            )
            for k in self.axes
        ]

    def _determinant(self, rows):
        g = self.graph
        if len(rows) == 1:
            return rows[0][0]
        total = g.zero
        for k, first in enumerate(rows[0]):
            minor = g.mul(first, self._determinant([[*r[:k], *r[k + 1 :]] for r in rows[1:]]))
            total = g.sub(total, minor) if k % 2 else g.add(total, minor)
        return total


@dataclass(frozen=True)
class _Superposed:
    """Several parts to first order: what each undoes, added up."""

    parts: tuple

    @property
    def names(self):
        return tuple(name for part in self.parts for name in part.names)

    def undo(self, g, place, time, is_driven):
        place_of, time_of = place, time
        for part in self.parts:
            own, when = part.undo(g, place, time, is_driven)
            place_of = tuple(g.add(t, g.sub(x, y)) for t, x, y in zip(place_of, own, place, strict=True))
            time_of = g.add(time_of, g.sub(when, time))
        return place_of, time_of


def superposed(law, parts):
    """The law with parts at zero, right to first order in each of them."""
    lags = tuple(part for part in parts if isinstance(part, (Delay, Exposure)))
    maps = _Superposed(tuple(part for part in parts if part not in lags))
    zero = {name: 0.0 for part in parts for name in part.names}
    return replace(
        law, frame=(*law.frame, maps, *lags), constants={**law.constants, **zero}
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen of states.

    Attributes
    ----------
    places : ndarray, shape (T, S, R, d), m
    by_state : ndarray, shape (T, S, R d, 2 R d)
        Beyond the place itself.
    by_constant : ndarray, shape (T, S, R d, k)
    """

    places: np.ndarray
    by_state: np.ndarray
    by_constant: np.ndarray

    def shown(self, changes, rows, chain, first):
        """Changes of what is seen, from those of states (L, W, n, c), constants from `first`."""
        n_seen, k = self.by_constant.shape[2:]
        out = changes[:, :, :n_seen] + self.by_state[rows, chain] @ changes
        out[..., first : first + k] += self.by_constant[rows, chain]
        return out


def places_of(nodes, seen=None):
    """Where bodies are seen, (T, S, R, d), with the sight of nodes (2, R, d, T, S)."""
    return np.moveaxis(nodes[0], (-2, -1), (0, 1)) if seen is None else seen.places


def sight(flow, nodes):
    """What delays and exposures show of nodes under the constants that are set.

    Parameters
    ----------
    flow : Flow
    nodes : ndarray, shape (2, R, d, T, S)

    Returns
    -------
    Sight or None
        None where places are seen as they are.
    """
    motion, chains = flow.motion, flow.chains
    parts = [p for p in motion.law.frame if isinstance(p, (Delay, Exposure))]
    if not parts:
        return None
    rows, chain = np.nonzero(np.isfinite(chains.times))
    state = nodes[..., rows, chain]
    points = flow.points(state, chains.times[rows, chain], chain)
    a, v = motion.acceleration(points), state[1]
    by_state, by_constant = motion.slopes(points)
    delay, variance, of_delay = np.zeros((len(a), 1, len(rows))), 0.0, {}
    for part in parts:
        value = motion.values[part.names[0]]
        if isinstance(part, Exposure):
            variance = variance + value
        else:
            of_delay[part.names[0]] = part.is_late(chains)[:, chain][:, None]
            delay = delay + value * of_delay[part.names[0]]
    half = (delay**2 + variance) / 2
    n_seen = v.shape[0] * v.shape[1]

    def flat(values):  # (R, d, M) -> (M, R d)
        return np.broadcast_to(values, v.shape).reshape(n_seen, -1).T

    by_state, by_constant = (flat(half)[..., None] * d for d in (by_state, by_constant))
    own = np.arange(n_seen)
    by_state[:, own, n_seen + own] -= flat(delay)
    for k, (name, _) in enumerate(motion.parameters):
        if name in of_delay:
            by_constant[..., k] += flat(of_delay[name] * (delay * a - v))
        elif any(name == part.names[0] for part in parts):
            by_constant[..., k] += flat(a / 2)
    shape = chains.times.shape
    out = [np.zeros((*shape, *d.shape[1:])) for d in (by_state, by_constant)]
    out[0][rows, chain], out[1][rows, chain] = by_state, by_constant
    places = places_of(nodes).copy()
    places[rows, chain] = np.moveaxis(state[0] - delay * v + half * a, -1, 0)
    return Sight(places, *out)
