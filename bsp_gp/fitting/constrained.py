"""What constraints make of motion: accelerations, states, and the derivatives of both.

With g the constraints, J their derivatives by places and W the inverse masses, accelerations are
``a = f + W J' lambda`` with ``J a + v' g'' v = 0`` (Gauss 1829): the part of the forces that the
constraints leave, and what keeps bodies on them. That is linear in the forces, so that what is
fitted or searched beside them stays as it is. Bodies that no force moves take part as they were
measured.
"""

from __future__ import annotations

import numpy as np

from bsp_gp.fitting.driven import Driven
from bsp_gp.fitting.graph import Graph, Tape
from bsp_gp.fitting.lowering import MOVING, Lowering
from bsp_gp.language.inputs import property_of

__all__ = ["Constraints", "constraints_of"]

APPROACHES = 8
"""Newton's steps by which states are put on constraints."""
STATE = ("p_i", "p_j", "v_i", "v_j", "a_i", "a_j")


def constraints_of(law):
    """The parts of a law that constrain bodies, tuple of Constraint."""
    return tuple(part for part in law.frame if part.kind == "constraint")


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

    def __init__(self, program, first, second, n_own):
        self.program = program
        self.first, self.second = first, second  # (S,), -1 = none, n_own + k = driven body k
        self.is_on = first >= 0
        self.n_own = n_own


class Constraints:
    """The constraints of a law on some chains.

    Parameters
    ----------
    law : ForceLaw
    chains : Chains
    parameters : sequence of (name, entity)
    owners : Owners
    """

    def __init__(self, law, chains, parameters, owners):
        self.chains, self.owners = chains, owners
        self.n_own, self.n_dims = chains.n_moving, chains.n_dims
        self.n, self.k = self.n_own * self.n_dims, len(parameters)
        self.driven = Driven(chains)
        mass = chains.column("mass")[: self.n_own]
        self.weight = np.repeat(1.0 / np.where(np.isfinite(mass), mass, 1.0), self.n_dims, axis=0)
        self.links = [
            link for part in constraints_of(law) for link in self._links(_Program(part, chains))
        ]
        self._ready, self._number = None, {}
        for link in self.links:
            for name in link.program.names:
                self._number[name] = owners.parameter(name, "field")

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
            yield _Link(program, *np.array(pairs).T, self.n_own)

    def set_constants(self, known):
        """Put the values of the constants of the law in."""
        self._ready = []
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
        link, chain = self.links[number], np.arange(self.chains.n_chains)[points.chain]
        at = np.arange(len(chain))
        first, second = link.first[chain], link.second[chain]
        places = np.concatenate([points.state, accelerations[None]])
        if (second >= self.n_own).any():
            driven = np.concatenate([points.driven, self.driven.pull(points.times, chain)[None]])
            places = np.concatenate([places, driven], axis=1)

        def value(name, axis):
            if name == "t":
                return points.times
            return places["pva".index(name[0]), first if name[-1] == "i" else second, axis, at]

        tape = (link.program.rows, link.program.slopes)[which]
        ready = {
            key: v if np.ndim(v) == 0 else v[chain] for key, v in self._ready[number][which].items()
        }
        return tape.run(ready, value), first, second, link.is_on[chain], at

    def _rows(self, points, accelerations):
        """Values, their first and second derivatives by time (c, M), and J (c, n, M)."""
        m, d = len(points.times), self.n_dims
        values, jacobian = np.zeros((3, len(self.links), m)), np.zeros((len(self.links), self.n, m))
        with np.errstate(all="ignore"):
            for c in range(len(self.links)):
                out, first, second, is_on, at = self._outputs(c, 0, points, accelerations)
                for row in range(3):
                    values[row, c] = np.where(is_on, out[row], 0.0)
                for body, part in ((first, out[3 : 3 + d]), (second, out[3 + d :])):
                    mine = np.flatnonzero((body >= 0) & (body < self.n_own) & is_on)
                    for axis, slope in enumerate(part):
                        slope = np.broadcast_to(slope, (m,))
                        jacobian[c, body[mine] * d + axis, at[mine]] += slope[mine]
        return values, jacobian

    def _slopes(self, points, accelerations):
        """Derivatives of the rows by states and constants: (3, c, 2n + k, M), (c, n, 2n + k, M)."""
        m, d, n = len(points.times), self.n_dims, self.n
        of_values = np.zeros((3, len(self.links), 2 * n + self.k, m))
        of_rows = np.zeros((len(self.links), n, 2 * n + self.k, m))
        with np.errstate(all="ignore"):
            for c, link in enumerate(self.links):
                out, first, second, is_on, at = self._outputs(c, 1, points, accelerations)
                for (row, name, axis), slope in zip(link.program.slope_of, out, strict=True):
                    slope, mine = np.broadcast_to(slope, (m,)), is_on
                    if axis is None:
                        by = self._parameter(link, name, points.chain, m)
                        mine = mine & (by >= 0)
                        by = by + 2 * n
                    else:
                        body = first if name[-1] == "i" else second
                        mine = mine & (body >= 0) & (body < self.n_own)
                        by = body * d + axis + (n if name[0] == "v" else 0)
                    if row >= 3:
                        body, of = (first, row - 3) if row < 3 + d else (second, row - 3 - d)
                        mine = mine & (body >= 0) & (body < self.n_own)
                        mine = np.flatnonzero(mine)
                        of_rows[c, body[mine] * d + of, by[mine], at[mine]] += slope[mine]
                        continue
                    mine = np.flatnonzero(mine)
                    of_values[row, c, by[mine], at[mine]] += slope[mine]
        return of_values, of_rows

    def _parameter(self, link, name, chain, m):
        """Number of the parameter of a constant at every point; -1 = none."""
        number = self._mine(link, self._number[name])
        return number[chain] if np.ndim(number) else np.full(m, number)

    def _solved(self, jacobian, right, chain):
        """``(W J' G^-1) right`` and ``G^-1 right`` with G = J W J', right (c, ..., M)."""
        weighed = jacobian * self.weight[:, chain]
        gram = np.einsum("anm,bnm->mab", weighed, jacobian)
        own = np.arange(len(gram[0]))
        gram[:, own, own] += gram[:, own, own] == 0  # who is not constrained there
        flat = np.moveaxis(right.reshape(len(right), -1, right.shape[-1]), -1, 0)
        if len(own) == 1:
            out = flat / gram
        else:  # constraints that say the same twice share the pull
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
        left = of_values[2] + np.einsum("cnm,nzm->czm", jacobian, own)
        own = own - self._solved(jacobian, left, points.chain)[0]
        return own[:, : 2 * n], own[:, 2 * n :]

    def held(self, points):
        """The states put on the constraints, (2, R, d, M)."""
        state, shape = points.state.copy(), points.state.shape[1:]
        rest = np.zeros(shape)
        for _ in range(APPROACHES):
            values, jacobian = self._rows(points.at(state), rest)
            shift, _ = self._solved(jacobian, values[0], points.chain)
            state[0] -= shift.reshape(shape)
            if not np.any(np.abs(shift) > 1e-15 * np.abs(state[0]).max(initial=0.0)):
                break
        values, jacobian = self._rows(points.at(state), rest)
        state[1] -= self._solved(jacobian, values[1], points.chain)[0].reshape(shape)
        return state

    def tangent(self, points):
        """Derivatives of `held` at states on the constraints by states and constants.

        Returns
        -------
        ndarray, shape (M, 2n, 2n + k)
        """
        n, m = self.n, len(points.times)
        rest = np.zeros(points.state.shape[1:])
        _, jacobian = self._rows(points, rest)
        of_values, of_rows = self._slopes(points, rest)
        out = np.zeros((2 * n, 2 * n + self.k, m))
        out[np.arange(2 * n), np.arange(2 * n)] = 1.0
        out[:n] -= self._solved(jacobian, of_values[0], points.chain)[0]
        by_place = of_values[1][:, :n]
        moved = np.einsum("cpm,pzm->czm", by_place, out[:n])
        moved[:, n : 2 * n] += jacobian
        moved[:, 2 * n :] += of_values[1][:, 2 * n :]
        out[n:] -= self._solved(jacobian, moved, points.chain)[0]
        return np.moveaxis(out, -1, 0)
