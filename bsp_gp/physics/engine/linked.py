"""Arms that hang on one another: what the motion of one does to the other's angle.

Angles of arms in a plane, each from one fixed direction, have the kinetic energy

    T = sum_i m_i w_i^2 / 2 + sum_(i<j) C_ij cos(q_i - q_j) w_i w_j

with moments of inertia m_i and couplings C_ij, whatever the arms are made of. With
``kappa_ij = C_ij / m_i`` Lagrange's equations are ``A a = f - h``: f are the torques per moment of
inertia, ``A_ij = delta_ij + kappa_ij cos(q_i - q_j)`` and
``h_i = sum_j kappa_ij sin(q_i - q_j) w_j^2``.
That is linear in the torques, so that what is fitted or searched beside them stays as it is.
"""

import numpy as np

from bsp_gp.physics.engine.constrained import constraints_of


def linkages_of(law):
    """The parts of a law that link arms, tuple of Linkage."""
    return tuple(part for part in law.frame if part.kind == "linkage")


def is_held(law):
    """Whether accelerations are more than forces over masses."""
    return bool(constraints_of(law) or linkages_of(law))


class Linkages:
    """The linkages of a law on some chains."""

    def __init__(self, law, chains, parameters):
        self.chains, self.n, self.d = chains, chains.n_moving, chains.n_dims
        number = {name: k for k, (name, _) in enumerate(parameters)}
        mass = chains.column("mass")[: self.n]
        self.weight = 1.0 / np.where(np.isfinite(mass), mass, 1.0)
        self.links = []
        for part in linkages_of(law):
            i, j = (
                np.array([own.index(name) if name in own else -1 for own in chains.bodies])
                for name in part.pair
            )
            both = (i >= 0) & (j >= 0)
            for a, b, name in ((i, j, part.couplings[0]), (j, i, part.couplings[1])):
                self.links.append((a, b, both, name, number.get(name, -1)))
        self.known = {}

    def set_constants(self, known):
        """Put the values of the constants of the law in."""
        self.known = {name: np.asarray(known[name], dtype=float) for *_, name, _ in self.links}

    def _at(self, points):
        """Every link at points: receivers, sources, points, kappa per unit, kappa, its number."""
        index = np.arange(len(points.times))
        chain = index * 0 + np.arange(self.chains.n_chains)[points.chain]
        for a, b, both, name, number in self.links:
            at = index[both[chain]]
            i, j = a[chain[at]], b[chain[at]]
            per = self.weight[i, chain[at] if self.weight.shape[1] > 1 else 0]
            value = self.known[name]
            value = value[chain[at]] if value.ndim else value
            yield i, j, at, per, value * per, number

    def matrix(self, points):
        """A of all bodies at points, (M, R, R)."""
        out = np.tile(np.eye(self.n), (len(points.times), 1, 1))
        angle = points.state[0][:, 0]
        for i, j, at, _, kappa, _ in self._at(points):
            out[at, i, j] += kappa * np.cos(angle[i, at] - angle[j, at])
        return out

    def solved(self, matrix, right):
        """``A^-1 right`` with right (R, ..., M); nan where arms would have no inertia."""
        if self.n == 2:
            return _solved_pair(matrix, right)
        shape = right.shape
        flat = np.moveaxis(right.reshape(self.n, -1, shape[-1]), -1, 0)
        good = np.isfinite(matrix).all(axis=(1, 2))
        good[good] = np.linalg.slogdet(matrix[good])[0] > 0
        out = np.full(flat.shape, np.nan)
        out[good] = np.linalg.solve(matrix[good], flat[good])
        return np.moveaxis(out, 0, -1).reshape(shape)

    def _swing(self, points):
        """H at points, (R, M)."""
        angle, rate = points.state[0][:, 0], points.state[1][:, 0]
        out = np.zeros((self.n, len(points.times)))
        for i, j, at, _, kappa, _ in self._at(points):
            out[i, at] += kappa * np.sin(angle[i, at] - angle[j, at]) * np.square(rate[j, at])
        return out

    def accelerations(self, free, points):
        """Accelerations (R, d, M) from those that arms would have without each other."""
        out = free.copy()
        out[:, 0] = self.solved(self.matrix(points), free[:, 0] - self._swing(points))
        return out

    def slopes(self, free, by_state, by_constant, points):
        """Derivatives (R, d, 2, R, d, M), (R, d, k, M) of accelerations, from those of `free`."""
        by_state, by_constant = by_state.copy(), by_constant.copy()
        matrix = self.matrix(points)
        angle, rate = points.state[0][:, 0], points.state[1][:, 0]
        pull = self.solved(matrix, free[:, 0] - self._swing(points))
        for i, j, at, per, kappa, number in self._at(points):
            gap = angle[i, at] - angle[j, at]
            c, s, w = np.cos(gap), np.sin(gap), rate[j, at]
            turn = kappa * (c * np.square(w) - s * pull[j, at])
            by_state[i, 0, 0, i, 0, at] -= turn
            by_state[i, 0, 0, j, 0, at] += turn
            by_state[i, 0, 1, j, 0, at] -= 2 * kappa * s * w
            if number >= 0:
                by_constant[i, 0, number, at] -= per * (c * pull[j, at] + s * np.square(w))
        by_state[:, 0] = self.solved(matrix, by_state[:, 0])
        by_constant[:, 0] = self.solved(matrix, by_constant[:, 0])
        return by_state, by_constant


def _solved_pair(matrix, right):
    """The same of two arms, by Cramer's rule: most of the time of a double pendulum is here."""
    (a, b), (c, d) = matrix.transpose(1, 2, 0)
    whole = a * d - b * c
    whole = np.where(whole > 0, whole, np.nan)  # nan stays nan
    first, second = right
    return np.stack([(d * first - b * second) / whole, (a * second - c * first) / whole])
