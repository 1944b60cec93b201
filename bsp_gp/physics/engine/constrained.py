"""What constraints make of motion: accelerations, states, and the derivatives of both.

With g the constraints, J their derivatives by places and W the inverse masses, accelerations are
``a = f + W J' lambda`` with ``J a + v' g'' v = 0`` (Gauss 1829): the part of the forces that the
constraints leave, and what keeps bodies on them. That is linear in the forces, so that what is
fitted or searched beside them stays as it is. Bodies that no force moves take part as they were
measured.
"""

import numpy as np

from bsp_gp.language.inputs import property_of
from bsp_gp.physics.engine.driven import Driven
from bsp_gp.physics.engine.graph import Graph, Tape
from bsp_gp.physics.engine.lowering import MOVING, Lowering
from bsp_gp.physics.engine.owners import fitted_properties

APPROACHES = 8
"""Newton's steps by which states are put on constraints."""
NEAR = 1e-8
"""Part of its distance by which a state may be moved last."""
NOTHING = 1e-11
"""Part of a force that is none where constraints leave no more of it."""
STATE = ("p_i", "p_j", "v_i", "v_j", "a_i", "a_j")


def constraints_of(law):
    """The parts of a law that constrain bodies, tuple of Constraint."""
    return tuple(part for part in law.frame if part.kind == "constraint")


def lone_constraint(law, chains):
    """The one constraint of a lone body that depends on its place and the time alone, or None.

    Such a one can be put into the formulas of the law themselves.
    """
    parts = constraints_of(law)
    if len(parts) != 1 or len(law.frame) != 1 or chains.n_moving != 1:
        return None
    (part,) = parts
    moving = {name for name in part.formula.inputs if name in (*STATE, *chains.series.names)}
    bodies = {body for body, other in part.pairs if not other}
    is_lone = moving <= {"p_i"} and len(bodies) == len(part.pairs)
    is_lone &= all(own[0] in bodies for own in chains.bodies)
    if not is_lone or any(term.kind == "pair" for term in law.terms):
        return None
    return part


class Held:
    """A graph in which the velocity of a body is along a constraint, and accelerations can be.

    Parameters
    ----------
    part : Constraint
        On the body alone, see `lone_constraint`.
    is_rubbed : bool
        Whether friction acts, whose direction turns with the least way off the constraint.
    """

    def __init__(self, graph, part, chains, is_rubbed):
        g, axes = graph, range(chains.n_dims)
        self.graph = g
        value = Lowering(g, chains.n_dims, chains.direction).lower(part.formula)
        place, velocity = ([g.input(name, k) for k in axes] for name in ("p_i", "v_i"))

        def along(node):
            slopes = [g.slope(node, x) for x in place]
            return g.add(g.slope(node, g.input("t")), g.dot(slopes, velocity))

        rate = along(value)
        self.pull = [g.slope(value, x) for x in place]
        self.size, self.bend = g.dot(self.pull, self.pull), along(rate)
        share = g.div(rate, self.size)
        moved = [g.sub(v, g.mul(share, j)) for v, j in zip(velocity, self.pull, strict=True)]
        self.velocity = moved if is_rubbed else velocity

    def __getattr__(self, name):
        return getattr(self.graph, name)

    def input(self, name, axis=None):
        return self.velocity[axis] if name == "v_i" else self.graph.input(name, axis)

    def acceleration(self, free):
        """What the constraint leaves of accelerations, nodes."""
        g = self.graph
        tension = g.div(g.add(g.dot(self.pull, free), self.bend), self.size)
        return [g.sub(a, g.mul(tension, j)) for a, j in zip(free, self.pull, strict=True)]

    def leaves_all(self, free, names, moving):
        """Whether no constant loses all influence to the constraint, but for rounding.

        Told at random values: what is nothing is nothing everywhere.
        """
        g, rng, kept = self.graph, np.random.default_rng(0), {}

        def value(*key):
            return kept.setdefault(key, np.array([rng.uniform(0.5, 1.5)]))

        constants = [name for name in names if g.has_constant(name)]
        slopes = [
            g.slope(node, g.constant(name))
            for name in constants for node in (*free, *self.acceleration(free))
        ]  # fmt: skip
        tape = Tape(g, slopes, moving)
        ready = tape.prepare(value, {name: value(name)[0] for name in constants})
        with np.errstate(all="ignore"):
            out = [float(np.max(np.abs(x))) for x in tape.run(ready, value)]
        whole, left = np.moveaxis(np.reshape(out, (-1, 2, len(free))), 1, 0).max(axis=-1, initial=0)
        return bool(np.all((whole == 0) | (left > NEAR * whole)))


class _Program:
    """One constraint with its derivatives along tracks, as tapes."""

    def __init__(self, part, chains):
        self.part, axes = part, range(chains.n_dims)
        g = self.graph = Graph()
        value = Lowering(g, chains.n_dims, chains.direction).lower(part.formula)
        leaves = {name: [g.input(name, k) for k in axes] for name in STATE}
        self.names = part.names

        def along(node):  # total derivative by the time
            out = g.slope(node, g.input("t"))
            for rate, name in (("v", "p"), ("a", "v")):
                for role in "ij":
                    slopes = [g.slope(node, x) for x in leaves[f"{name}_{role}"]]
                    out = g.add(out, g.dot(slopes, leaves[f"{rate}_{role}"]))
            return out

        speed = along(value)
        pull = [g.slope(value, x) for role in "ij" for x in leaves[f"p_{role}"]]
        moving = (*MOVING, "a_i", "a_j")
        self.rows = Tape(g, [value, speed, along(speed), *pull], moving)
        keys = [(name, k) for name in STATE[:4] for k in axes]
        keys += [(name, None) for name in self.names]
        self.slope_of, nodes = [], []
        for row, node in enumerate([value, speed, along(speed), *pull]):
            for name, axis in keys:
                leaf = g.constant(name) if axis is None else leaves[name][axis]
                slope = g.slope(node, leaf)
                if slope != g.zero:
                    self.slope_of.append((row, name, axis))
                    nodes.append(slope)
        self.slopes = Tape(g, nodes, moving)


class _Link:
    """A constraint on one body, or on a body and another, of every chain."""

    def __init__(self, program, first, second):
        self.program = program
        self.first, self.second = first, second  # (S,), -1 = none, those behind moving ones driven
        # Mostly it is the same bodies in all chains.
        self.bodies = [int(b[0]) if (b == b[0]).all() else None for b in (first, second)]

    def at(self, chain):
        """Its bodies at points: one number for all, or an array (M,)."""
        both = zip(self.bodies, (self.first, self.second), strict=True)
        return [each[chain] if one is None else one for one, each in both]


class Constraints:
    """The constraints of a law on some chains."""

    def __init__(self, law, chains, parameters, owners):
        self.chains, self.owners = chains, owners
        self.n_own, self.n_dims = chains.n_moving, chains.n_dims
        self.n, self.k = self.n_own * self.n_dims, len(parameters)
        self.driven = Driven(chains)
        mass = chains.column("mass")[: self.n_own]
        self.weight = self._weights(np.where(np.isfinite(mass), mass, 1.0))
        self._fitted_mass = None  # which parameter, (n, S); -1 = it is known
        if "mass" in fitted_properties(law):
            self._fitted_mass = np.repeat(owners.parameter("mass_i", "field"), self.n_dims, axis=0)
        self.links = [
            link for part in constraints_of(law) for link in self._links(_Program(part, chains))
        ]
        self._ready, self._number = None, {}
        for link in self.links:
            for name in link.program.names:
                self._number[name] = owners.parameter(name, "field")

    def _weights(self, mass):
        """Inverse masses (R, S) of coordinates, (n, S)."""
        return np.repeat(1.0 / mass, self.n_dims, axis=0)

    def _links(self, program):
        """One link for each of the bodies of a chain that the constraint is on."""
        found = []
        for own, fixed in zip(self.chains.bodies, self.chains.fixed, strict=True):
            place = {name: k for k, name in enumerate((*own, *fixed))}
            found.append([
                (place[one], place[other] if other else -1)
                for one, other in program.part.pairs
                if one in own and (not other or other in place)
            ])  # fmt: skip
        for k in range(max(map(len, found))):
            pairs = [mine[k] if k < len(mine) else (-1, -1) for mine in found]
            yield _Link(program, *np.array(pairs).T)

    def set_constants(self, known):
        """Put the values of the constants of the law in."""
        self._ready = []
        if self._fitted_mass is not None:
            self.weight = self._weights(self.owners.values("mass_i", known, "field"))
        for link in self.links:
            constants = {
                name: self._mine(link, self.owners.values(name, known, "field"))
                for name in link.program.names
            }
            inputs = self._properties(link)
            tapes = (link.program.rows, link.program.slopes)
            self._ready.append([tape.prepare(inputs, constants) for tape in tapes])

    def _mine(self, link, values):
        """Values of bodies (R, S), those of the link's; others as they are."""
        values = np.asarray(values)
        if values.ndim < 2:
            return values[()]
        return values[np.maximum(link.first, 0), np.arange(values.shape[1])]

    def _properties(self, link):
        def value(name, axis):
            column, role = property_of(name)
            place = np.maximum(link.first if role == "i" else link.second, 0)
            return self.chains.column(column)[place, np.arange(self.chains.n_chains)]

        return value

    # --- at points -------------------------------------------------------------------------------

    def _outputs(self, number, which, points, accelerations):
        """Outputs of a tape of a link at points, (M,) each."""
        link, chain = self.links[number], points.chain
        places = (points.state[0], points.state[1], accelerations)
        if link.second.max() >= self.n_own:
            pull = self.driven.pull(points.times, np.arange(self.chains.n_chains)[chain])
            driven = (*points.driven, pull)
            places = tuple(map(np.concatenate, zip(places, driven, strict=True)))
        bodies, at = link.at(chain), np.arange(len(points.times))

        def value(name, axis):
            if name == "t":
                return points.times
            body, whole = bodies[name[-1] == "j"], places["pva".index(name[0])]
            return whole[body, axis] if np.ndim(body) == 0 else whole[body, axis, at]

        tape = (link.program.rows, link.program.slopes)[which]
        ready = {
            key: v if np.ndim(v) == 0 else v[chain] for key, v in self._ready[number][which].items()
        }
        return tape.run(ready, value), bodies

    def _own(self, body):
        """Whether, or where, a body of a link is one that forces move; which points these are."""
        if np.ndim(body) == 0:
            return body, slice(None), 0 <= body < self.n_own
        at = np.flatnonzero((body >= 0) & (body < self.n_own))
        return body[at], at, len(at) > 0

    def _rows(self, points, accelerations):
        """Values, their first and second derivatives by time (3, c, M), and J (c, n, M)."""
        m, d = len(points.times), self.n_dims
        values, jacobian = np.zeros((3, len(self.links), m)), np.zeros((len(self.links), self.n, m))
        with np.errstate(all="ignore"):
            for c, link in enumerate(self.links):
                out, bodies = self._outputs(c, 0, points, accelerations)
                values[:, c] = np.where(self._is_on(link, points.chain), out[:3], 0.0)
                for number, body in enumerate(bodies):
                    body, at, is_own = self._own(body)
                    for axis, slope in enumerate(out[3 + number * d : 3 + (number + 1) * d]):
                        if is_own:
                            slope = np.broadcast_to(slope, (m,))[at]
                            jacobian[c, body * d + axis, at] += slope
        return values, jacobian

    @staticmethod
    def _is_on(link, chain):
        """Whether a link is on a body at points."""
        return True if link.bodies[0] is not None else link.first[chain] >= 0

    def _slopes(self, points, accelerations):
        """Derivatives of the rows by states and constants: (3, c, 2n + k, M), (c, n, 2n + k, M)."""
        m, d, n = len(points.times), self.n_dims, self.n
        of_values = np.zeros((3, len(self.links), 2 * n + self.k, m))
        of_rows = np.zeros((len(self.links), n, 2 * n + self.k, m))
        with np.errstate(all="ignore"):
            for c, link in enumerate(self.links):
                out, bodies = self._outputs(c, 1, points, accelerations)
                for (row, name, axis), slope in zip(link.program.slope_of, out, strict=True):
                    by, at, is_own = self._column(link, name, axis, bodies, points.chain)
                    if not is_own:
                        continue
                    slope = np.broadcast_to(slope, (m,))
                    if row < 3:
                        of_values[row, c, by, at] += slope[at]
                        continue
                    number, of = divmod(row - 3, d)
                    body = bodies[number]
                    if np.ndim(body) or np.ndim(by):
                        at = np.arange(m)[at]
                        body, by = np.broadcast_to(body, (m,))[at], np.broadcast_to(by, at.shape)
                        own = (body >= 0) & (body < self.n_own)
                        body, by, at = body[own], by[own], at[own]
                        of_rows[c, body * d + of, by, at] += slope[at]
                    elif 0 <= body < self.n_own:
                        of_rows[c, body * d + of, by] += slope
        return of_values, of_rows

    def _column(self, link, name, axis, bodies, chain):
        """Which column a derivative belongs to, at which points, and whether there is any."""
        if axis is None:
            number = self._mine(link, self._number[name])
            if np.ndim(number) == 0:
                return 2 * self.n + number, slice(None), number >= 0
            number = number[chain]
            at = np.flatnonzero(number >= 0)
            return 2 * self.n + number[at], at, len(at) > 0
        body, at, is_own = self._own(bodies[name[-1] == "j"])
        return body * self.n_dims + axis + (self.n if name[0] == "v" else 0), at, is_own

    def _solved(self, jacobian, right, chain):
        """``(W J' G^-1) right`` and ``G^-1 right`` with G = J W J', right (c, ..., M)."""
        weighed = jacobian * self.weight[:, chain]
        if len(jacobian) == 1:
            gram = (weighed[0] * jacobian[0]).sum(axis=0)
            out = right / np.where(gram > 0, gram, 1.0)
            whole = weighed[0].reshape(self.n, *(1,) * (right.ndim - 2), -1)
            return whole * out, out
        gram = np.einsum("anm,bnm->mab", weighed, jacobian)
        own = np.arange(len(gram[0]))
        gram[:, own, own] += gram[:, own, own] == 0  # who is not constrained there
        flat = np.moveaxis(right.reshape(len(right), -1, right.shape[-1]), -1, 0)
        # Constraints that say the same twice share the pull.
        good = np.isfinite(gram).all(axis=(1, 2))[:, None, None]
        out = np.linalg.pinv(np.where(good, gram, 1.0), 1e-10, hermitian=True) @ flat
        out = np.where(good, out, np.nan)
        out = np.moveaxis(out, 0, -1).reshape(right.shape)
        return np.einsum("anm,a...m->n...m", weighed, out), out

    def accelerations(self, free, points):
        """What is left of accelerations (R, d, M) that bodies would have without constraints."""
        values, jacobian = self._rows(points, free)
        pull, _ = self._solved(jacobian, values[2], points.chain)
        return free - pull.reshape(free.shape)

    def slopes(self, free, by_state, by_constant, points):
        """Derivatives of the accelerations, from those without constraints, (n, 2n or k, M)."""
        n = self.n
        values, jacobian = self._rows(points, free)
        pull, tension = self._solved(jacobian, -values[2], points.chain)
        total = free + pull.reshape(free.shape)
        of_values, of_rows = self._slopes(points, total)
        own = np.concatenate([by_state, by_constant], axis=1)
        turned = np.einsum("cm,cnzm->nzm", tension, of_rows)
        own = own + self.weight[:, None, points.chain] * turned
        if self._fitted_mass is not None:
            number, weight = self._fitted_mass[:, points.chain], self.weight[:, points.chain]
            row, at = np.nonzero(number >= 0)
            by_mass = np.square(weight) * np.einsum("cm,cnm->nm", tension, jacobian)
            own[row, 2 * n + number[row, at], at] -= by_mass[row, at]
        left = of_values[2] + np.einsum("cnm,nzm->czm", jacobian, own)
        left = own - self._solved(jacobian, left, points.chain)[0]
        # What the constraints take up leaves rounding, which must not pass for an influence.
        is_left = np.abs(left).max(axis=0) > NOTHING * np.abs(own).max(axis=0)
        own = np.where(is_left, left, 0.0)
        return own[:, : 2 * n], own[:, 2 * n :]

    def held(self, points):
        """The states put on the constraints, (2, R, d, M)."""
        state, shape = points.state.copy(), points.state.shape[1:]
        rest = np.zeros(shape)
        for _ in range(APPROACHES):
            values, jacobian = self._rows(points.at(state), rest)
            shift, _ = self._solved(jacobian, values[0], points.chain)
            state[0] -= shift.reshape(shape)
            if not np.any(np.abs(shift) > NEAR * np.abs(state[0]).max(initial=0.0)):
                break  # the next step would be as small squared
        return self.along(points.at(state))

    def along(self, points):
        """The states with velocities along the constraints, (2, R, d, M)."""
        state = points.state.copy()
        values, jacobian = self._rows(points, np.zeros(state.shape[1:]))
        state[1] -= self._solved(jacobian, values[1], points.chain)[0].reshape(state.shape[1:])
        return state

    def tangent(self, points):
        """Derivatives of `held` where states are held by these and constants, (M, 2n, 2n + k)."""
        return np.moveaxis(self.tangent_rows(points), -1, 0)

    def tangent_rows(self, points, is_there=False):
        """The same with points on the last axis; `is_there`: of `along` alone."""
        n, m = self.n, len(points.times)
        rest = np.zeros(points.state.shape[1:])
        _, jacobian = self._rows(points, rest)
        of_values, _ = self._slopes(points, rest)
        out = np.tile(np.eye(2 * n, 2 * n + self.k)[..., None], m)
        if not is_there:
            out[:n] -= self._solved(jacobian, of_values[0], points.chain)[0]
        by_place = of_values[1][:, :n]
        moved = np.einsum("cpm,pzm->czm", by_place, out[:n])
        moved[:, n : 2 * n] += jacobian
        moved[:, 2 * n :] += of_values[1][:, 2 * n :]
        out[n:] -= self._solved(jacobian, moved, points.chain)[0]
        return out
