"""A law in the coordinates in which bodies are seen, and what delays and exposures show of tracks.

A measurement shows q of a true place p = u(q, t; phi) at the true time T(t). With the total
derivative D along a seen track, D u = J q' + du/dt, the true velocity is D u / T', and
``q'' = J^-1 (T'^2 a - D D u at q'' = 0)``. All of it is an expression, so that its derivatives by
states, constants and phi are exact, and fixed bodies are seen through the same instrument. A delay
and an exposure are no maps of places: ``seen = q - delay q' + (delay^2 + variance) / 2 q''``. A
shutter that reads a picture row by row is a delay that changes along an axis.
"""

from dataclasses import dataclass

import numpy as np


class Frame:
    """A graph whose inputs are the true states behind what parts show, for terms of a kind."""

    def __init__(self, graph, parts, n_dims, kind):
        self.graph, self.kind, self.axes, self._state = graph, kind, range(n_dims), {}
        seen = graph.input("t")
        for role in "ij" if kind == "pair" else "i":
            place, time = tuple(graph.input(f"p_{role}", k) for k in self.axes), seen
            is_driven = graph.input("is_driven") if role == "j" else graph.zero
            for part in reversed(parts):
                place, time = part.undo(graph, place, time, is_driven)
            self.rate = graph.slope(time, seen)
            velocity = tuple(graph.div(self._along(x, role), self.rate) for x in place)
            self._state |= {f"p_{role}": place, f"v_{role}": velocity, "t": (time,)}

    def __getattr__(self, name):
        return getattr(self.graph, name)

    def input(self, name, axis=None):
        true = self._state.get(name)
        return self.graph.input(name, axis) if true is None else true[axis or 0]

    def _along(self, node, role):
        """Derivative by the measured time along a seen track without acceleration."""
        g = self.graph
        slopes = [g.slope(node, g.input(f"p_{role}", k)) for k in self.axes]
        moved = g.dot(slopes, [g.input(f"v_{role}", k) for k in self.axes])
        return g.add(moved, g.slope(node, g.input("t")))

    def acceleration(self, true):
        """Seen accelerations from true ones, nodes; the bend is taken with the field terms."""
        g, place = self.graph, self._state["p_i"]
        right = [g.mul(g.call("square", self.rate), a) for a in true]
        if self.kind == "field":
            bends = [self._along(self._along(x, "i"), "i") for x in place]
            right = [g.sub(a, bend) for a, bend in zip(right, bends, strict=True)]
        columns = [[g.slope(x, g.input("p_i", k)) for x in place] for k in self.axes]
        whole = self._determinant(columns)
        return [  # Cramer's rule
            g.div(self._determinant([*columns[:k], right, *columns[k + 1 :]]), whole)
            for k in self.axes
        ]

    def _determinant(self, columns):
        g, total = self.graph, self.graph.zero
        if len(columns) == 1:
            return columns[0][0]
        for k, first in enumerate(columns[0]):
            minor = g.mul(first, self._determinant([[*c[:k], *c[k + 1 :]] for c in columns[1:]]))
            total = g.sub(total, minor) if k % 2 else g.add(total, minor)
        return total


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen of states.

    Attributes
    ----------
    places : ndarray, shape (T, S, R, d), m
    by_state : ndarray, shape (T, S, R d, 2 R d), or None
        Beyond the place itself; None where places are seen as they are.
    by_constant : ndarray, shape (T, S, R d, k), or None
    """

    places: np.ndarray
    by_state: np.ndarray | None = None
    by_constant: np.ndarray | None = None

    def shown(self, changes, rows, chain, first):
        """Changes of what is seen, from those of states (L, W, n, c), constants from `first`."""
        places = changes[:, :, : changes.shape[2] // 2]
        if self.by_state is None:
            return places
        out = places + self.by_state[rows, chain] @ changes
        out[..., first : first + self.by_constant.shape[-1]] += self.by_constant[rows, chain]
        return out


def sight(flow, nodes):
    """What is seen of nodes (2, R, d, T, S) under the constants that are set."""
    seen = _late(flow, nodes)
    added = [part for part in flow.motion.law.frame if hasattr(part, "added")]
    return _with_added(seen, flow, added) if added else seen


def _with_added(seen, flow, parts):
    """What is seen, and what parts add to it at every instant, whatever the places."""
    motion, chains = flow.motion, flow.chains
    places, (n_rows, n_chains, n_bodies, n_dims) = seen.places.copy(), seen.places.shape
    n_seen, by_state, by_constant = n_bodies * n_dims, seen.by_state, seen.by_constant
    if by_state is None:
        by_state = np.zeros((n_rows, n_chains, n_seen, 2 * n_seen))
        by_constant = np.zeros((n_rows, n_chains, n_seen, len(motion.parameters)))
    numbers = {name: k for k, (name, _) in enumerate(motion.parameters)}  # others are known
    times = np.nan_to_num(chains.times)
    for part in parts:
        value, slopes = part.added(times, motion.values)
        places[..., part.axis] += value[..., None]
        for name, slope in zip(part.names, slopes, strict=True):
            if name in numbers:
                by_constant[:, :, part.axis :: n_dims, numbers[name]] += slope[..., None]
    return Sight(places, by_state, by_constant)


def _late(flow, nodes):
    """What a clock of its own shows of nodes."""
    places = np.moveaxis(nodes[0], (-2, -1), (0, 1))
    motion, chains = flow.motion, flow.chains
    parts = {
        p.names[0]: p for p in motion.law.frame
        if p.kind == "instrument" and p.code in ("delay", "exposure", "shutter")
    }  # fmt: skip
    if not parts:
        return Sight(places)
    rows, chain = np.nonzero(np.isfinite(chains.times))
    points = flow.at(nodes, rows, chain)
    (p, v), a = points.state, motion.acceleration(points)
    by_state, by_constant = motion.slopes(points)
    bodies, late = np.array(chains.bodies).T[:, None, chain], {}
    for name, part in parts.items():  # seconds for each unit of the part's number
        if part.code == "shutter":
            (k,) = part.axes
            late[name] = part.middle[k] - p[:, [k]]
        else:
            late[name] = bodies == part.whose[0] if part.whose else np.zeros(bodies.shape)
    delay = sum(motion.values[name] * mine for name, mine in late.items())
    is_blur = {name: part.code == "exposure" for name, part in parts.items()}
    variance = sum(motion.values[name] for name in parts if is_blur[name])
    half = (delay**2 + variance) / 2
    n_seen = v.shape[0] * v.shape[1]

    def flat(values):  # (R, d or 1, M) -> (M, R d)
        return np.broadcast_to(values, v.shape).reshape(n_seen, -1).T

    by_state, by_constant = (flat(half)[..., None] * d for d in (by_state, by_constant))
    own = np.arange(n_seen)
    by_state[:, own, n_seen + own] -= flat(delay)
    by_place = flat(v - delay * a)
    for name, part in parts.items():
        if part.code == "shutter":  # the delay changes with the place along the axis
            axis = own - own % v.shape[1] + part.axes[0]
            by_state[:, own, axis] += motion.values[name] * by_place
    for k, (name, _) in enumerate(motion.parameters):
        if name in parts:
            by_delay = late[name] * (delay * a - v)
            by_constant[..., k] += flat(a / 2 if is_blur[name] else by_delay)
    shape = chains.times.shape
    places = places.copy()
    places[rows, chain] = np.moveaxis(p - delay * v + half * a, -1, 0)
    out = [np.zeros((*shape, *d.shape[1:])) for d in (by_state, by_constant)]
    out[0][rows, chain], out[1][rows, chain] = by_state, by_constant
    return Sight(places, *out)
