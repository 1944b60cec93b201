"""Walls that bodies bounce off: at one instant the velocity turns back, and motion goes on.

A step ends as near to the instant of contact as a step can be chosen. What is left of the way, a
little before or behind it, is gone back with the acceleration in front of the wall and forth again
with that behind the contact. So a bounce is one smooth function of the end of its step and of the
wall (both sheets go on a little beyond the instant), and its derivatives jump as they should
(saltation).
"""

import numpy as np

AT_ONCE = 1e-3
"""Part of an interval that a step may end before or behind a contact."""
UNDECIDED = 0.3
"""Part of an interval from its end within which the next node tells whether a contact was."""
AT_REST = 0.2
"""Part of an interval below which a body that would leave a wall for so long stays at it."""
LEAST_KEPT = 0.05
"""Part of its speed that a body keeps at the least where it is followed back through a contact."""
TINY = 1e-30
"""Change of a number by which derivatives are taken: imaginary, it takes nothing away."""


def walls_of(law):
    """The parts of a law that bodies bounce off, tuple of Wall."""
    return tuple(part for part in law.frame if part.kind == "wall")


class Walls:
    """The walls of a law on some chains."""

    def __init__(self, law, chains, parameters):
        self.parts, self.n_chains = walls_of(law), chains.n_chains
        self.n_own, self.n_dims = chains.n_moving, chains.n_dims
        self._number = {name: k for k, (name, _) in enumerate(parameters)}
        self._n_constants = len(parameters)
        self._values = ()

    @property
    def n_codes(self):
        """Pairs of a wall and a body."""
        return len(self.parts) * self.n_own

    def set_constants(self, known):
        """Put the values of the constants of the law in."""
        self._values = tuple(
            np.array([np.broadcast_to(known[name], self.n_chains) for name in part.names], float)
            for part in self.parts
        )

    def hits(self, state, chain, pull, size, left, whole, aims):
        """Which bodies bounce at the ends of steps, and which steps have to end earlier.

        Parameters
        ----------
        state : ndarray, shape (2, R, d, M)
            At the ends of steps.
        chain : ndarray of int, shape (M,)
        pull : ndarray, shape (R, d, M)
            Accelerations there.
        size, left, whole : ndarray, shape (M,), s
            Of steps, of what was left of their intervals before them, of intervals.
        aims : ndarray, shape (2, R, d, M) or None
            Next nodes: a contact that the end of an interval leaves undecided is where they say.

        Returns
        -------
        hit : ndarray of int, shape (M,)
            Number of the wall times R plus that of the body, from the number of all such on if it
            comes to rest there; -1 = none.
        size : ndarray, shape (M,)
            Smaller where a step has to end earlier.
        """
        hit, out, whole = np.full(len(size), -1), size.copy(), np.abs(whole)
        for number, (part, known) in enumerate(zip(self.parts, self._values, strict=True)):
            values = known[:, chain]
            normal = part.normal_at(values)
            far = (normal * state[0]).sum(axis=1) - part.side * values[0]
            speed, push = ((normal * x).sum(axis=1) for x in (state[1], pull))
            since = _since(far, speed, push)
            is_in = (speed < 0) & (since > -AT_ONCE * whole) & (size > 0)
            came = speed - push * since
            stays = (push < 0) & (-2 * values[1] * came < -push * AT_REST * whole)
            if aims is not None:
                after = (normal * aims[1]).sum(axis=1)
                is_behind = np.abs(after + values[1] * speed) < np.abs(after - speed)
                rest = left - size + since
                is_near = (speed < 0) & (np.abs(rest) < UNDECIDED * whole)
                is_last = np.abs(left - size) <= 1e-9 * whole
                is_in = np.where(is_near, is_behind & (is_last | is_in), is_in)
            for body in range(self.n_own):
                late = np.where(is_in[body], since[body], -np.inf)
                is_late = late > AT_ONCE * whole
                can_cut = is_late & (size > 2 * AT_ONCE * whole) & ~stays[body]
                earlier = np.maximum(size - late, 2 * AT_ONCE * whole)
                out = np.where(can_cut, np.minimum(out, earlier), out)
                code = number * self.n_own + body + self.n_codes * stays[body]
                hit = np.where(is_in[body] & ~can_cut, code, hit)
        return np.where(out < size, -1, hit), out

    def righted(self, points, acceleration):
        """States of points behind a wall as they are in front of it, (2, R, d, M).

        On the way in they are so behind the contact, on the way out before it.
        """
        state = points.state.copy()
        for part, known in zip(self.parts, self._values, strict=True):
            values = known[:, points.chain]
            normal, pull = part.normal_at(values), acceleration(points.at(state))
            far = (normal * state[0]).sum(axis=1) - part.side * values[0]
            is_in = (normal * state[1]).sum(axis=1) < 0
            for body in range(self.n_own):
                before, (p, v) = pull[body], state[:, body]
                back = np.stack(_reflected(part, p, v, values, before, before, False))
                # Backwards in time what went out comes in, with more of its speed.
                kept = values.copy()
                kept[1 : 2 + (len(values) > 2)] = 1 / np.maximum(values[1:3], LEAST_KEPT)
                ahead = np.stack(_reflected(part, p, -v, kept, before, before, False))
                ahead[1] *= -1
                new = np.where(is_in[body], back, ahead)
                state[:, body] = np.where(far[body] < 0, new, state[:, body])
        return state

    def bounced(self, points, hit, acceleration, slopes=False):
        """Ends of steps behind their contacts, (2, R, d, M), and derivatives of these, or None.

        Derivatives are by the state, (M, n, n), and by the constants, (M, n, k).

        Parameters
        ----------
        points : Points
            At the ends of steps, all of which hit the same wall with the same body.
        acceleration : callable
            Of points, (R, d, M).
        """
        stays, pair = divmod(int(hit), self.n_codes)
        number, body = divmod(pair, self.n_own)
        part, values = self.parts[number], self._values[number][:, points.chain]
        before = acceleration(points)[body]
        state = points.state.copy()
        for _ in range(2):  # forces behind the contact hang on the velocity there
            after = acceleration(points.at(state))[body]
            place, velocity = _reflected(part, *points.state[:, body], values, before, after, stays)
            state[0, body], state[1, body] = place, velocity
        if not slopes:
            return state, None, None
        n, d = 2 * self.n_own * self.n_dims, self.n_dims
        rows = np.concatenate([body * d + np.arange(d), n // 2 + body * d + np.arange(d)])
        by_state = np.tile(np.eye(n), (len(points.times), 1, 1))
        by_constant = np.zeros((len(points.times), n, self._n_constants))
        p, v = points.state[:, body]
        for k in range(2 * d + len(values)):
            moved = [p.astype(complex), v.astype(complex), values.astype(complex)]
            if k < 2 * d:
                moved[k // d][k % d] += 1j * TINY
            else:
                moved[2][k - 2 * d] += 1j * TINY
            changed = np.concatenate(_reflected(part, *moved, before, after, stays)).imag.T / TINY
            if k < 2 * d:
                by_state[:, rows, rows[k]] = changed
            elif (at := self._number.get(part.names[k - 2 * d], -1)) >= 0:
                by_constant[:, rows, at] = changed
        return state, by_state, by_constant


def _since(far, speed, push):
    """Time since a body was at a wall, or nearest to one that it misses; negative if it will be."""
    square = speed * speed - 2 * push * far
    is_there = square.real > 0
    root = np.sqrt(np.where(is_there, square, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        # Of two the instant at which it went in; at the wall itself, at rest, it is now.
        since = np.where(is_there, 2 * far / (speed - root), speed / push)
    return np.where(np.isfinite(since), since, 0.0)


def _reflected(part, place, velocity, values, before, after, stays):
    """Places and velocities (d, M) on the other side of a contact, at the same instant."""
    normal = part.normal_at(values)
    far, speed, push = ((normal * x).sum(axis=0) for x in (place, velocity, before))
    since = _since(far - part.side * values[0], speed, push)
    at = place - since * velocity + before * since**2 / 2
    came = velocity - before * since
    across = normal * (normal * came).sum(axis=0)
    if stays:
        on = place - normal * (far - part.side * values[0])
        return on, velocity - normal * speed
    went = part.kept_at(values) * (came - across) - values[1] * across
    return at + went * since + after * since**2 / 2, went + after * since
