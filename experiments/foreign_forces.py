"""Forces that nobody lists, as functions of an instant of a scene; `foreign_worlds` has the kinds.

Each is built of a strength and of random numbers of the set: ``build(strength, rng) -> force``,
with ``force(at)`` in newtons; one that remembers has `blocks` and ``rate(at, a)`` beside.
"""

import numpy as np
from foreign_layouts import STIFFNESS, unit, weight


def drag(law):
    """Against the velocity: `law(at)` newtons of unit strength."""
    return lambda c, rng: lambda at: -c * law(at) * at.along


def way_of(rng):
    """A direction that is no axis."""
    angle = rng.uniform(0.3, 1.2) + rng.integers(4) * np.pi / 2
    return np.array([np.cos(angle), np.sin(angle)])


def push(law, is_oblique=False):
    """Along one direction: `law(at, a)` newtons of unit strength, `a` three numbers of the set."""

    def build(c, rng):
        numbers, way = rng.uniform(size=3), way_of(rng) if is_oblique else np.array([1.0, 0.0])
        return lambda at: c * law(at, numbers) * np.append(way, np.zeros(at.p.shape[1] - 2))

    return build


def edge(x, width):
    return 0.5 * (1 + np.tanh(x / width))


# --- on one body ----------------------------------------------------------------------------------


def in_window(c, rng):
    low = rng.uniform(-0.5, 0.5)
    return lambda at: -c * edge(at.p[:, :1] - low, 0.1) * edge(low + 1.2 - at.p[:, :1], 0.1) * at.v


def near_wall(c, rng):
    wall = rng.uniform(-2.5, -1.5)
    return lambda at: -c * np.exp(-np.abs(at.p[:, :1] - wall) / 0.8) * at.v


def hill(c, rng):
    place = rng.uniform(-0.6, 0.6, 2)

    def force(at):
        out = at.p[:, :2] - place
        push = np.zeros_like(at.p)
        push[:, :2] = c * out * np.exp(-np.square(out).sum(axis=1, keepdims=True) / 0.8)
        return push

    return force


def by_axis(c, rng):
    return lambda at: -c * at.v * np.eye(at.p.shape[1])[0]


def by_grain(c, rng):
    way = way_of(rng)
    return lambda at: -c * (at.v @ way)[:, None] * way


def lift(c, rng):
    return lambda at: c * at.speed**0.6 * at.perp


class Lagged:
    """A drag that follows the velocity late."""

    blocks = 1

    def __init__(self, c, rng):
        self.c, self.lag = c, rng.uniform(0.15, 0.4)

    def __call__(self, at):
        return -self.c * at.u[0]

    def rate(self, at, a):
        return (at.v - at.u[0])[None] / (self.lag * at.span)


class Basset:
    """A drag of past accelerations, weighted by one over the root of their age."""

    blocks = 7

    def __init__(self, c, rng):
        self.c, self.times = c, np.geomspace(0.01, 2.0, self.blocks)[:, None, None]

    def __call__(self, at):
        return -self.c * (at.u / np.sqrt(self.times * at.span)).sum(axis=0)

    def rate(self, at, a):
        return a - at.u / (self.times * at.span)


class Maxwell:
    """A spring that flows, beside the declared one."""

    blocks = 1

    def __init__(self, c, rng):
        self.c, self.time = c, rng.uniform(0.5, 1.5)

    def __call__(self, at):
        return -self.c * at.u[0]

    def rate(self, at, a):
        return (at.v - at.u[0] / self.time)[None]


class StateFriction:
    """Dry friction that weakens while a body slides (Ruina)."""

    blocks = 1

    def __init__(self, c, rng):
        self.c, self.length = c, rng.uniform(0.3, 0.8)

    def __call__(self, at):
        return -self.c * at.m * (1 + 2 * np.exp(-at.u[0, :, :1])) * at.along

    def rate(self, at, a):
        return np.broadcast_to(at.speed / self.length, at.p.shape)[None]


def kicks(rate):
    """Pushes at random, `rate` of them in a recording, each as long as the others."""

    def build(c, rng):
        seed, known = int(rng.integers(2**32)), {}

        def drawn(at):
            own = np.random.default_rng((seed, at.scene))
            when = own.uniform(0, at.span, (rate, len(at.p), 1))
            return when, own.standard_normal((rate, *at.p.shape))

        def force(at):
            if at.scene not in known:
                known[at.scene] = drawn(at)
            when, way = known[at.scene]
            length = min(0.5 / rate, 0.03) * at.span
            return c * (way * np.exp(-0.5 * np.square((at.t - when) / length))).sum(axis=0)

        return force

    return build


# --- springs, pulls, pairs ------------------------------------------------------------------------


def spring(law):
    """Beside the declared spring: `law(c, at)` times the way to the post."""
    return lambda c, rng: lambda at: law(c, at) * at.to_post


def length(at):
    return np.linalg.norm(at.to_post, axis=-1, keepdims=True)


def one_sided(c, rng):
    return lambda at: c * np.maximum(at.to_post, 0.0) * np.eye(at.p.shape[1])[0]


def parametric(c, rng):
    rate, phase = rng.uniform(2.5, 6.0), rng.uniform(0, 2 * np.pi)
    return lambda at: c * np.cos(rate * at.t + phase) * at.to_post


def losing_mass(c, rng):
    # Of a mass m (1 - c t / span) under the declared spring, written as a force on m.
    return lambda at: STIFFNESS * at.to_post * (1 / (1 - c * at.t / at.span) - 1)


def pull(law):
    """Beside the declared pull: `law(c, r, at)` times masses, along the line to each body."""

    def build(c, rng):
        return lambda at: (
            at.m[:, None] * at.m[None] * law(c, at.distance, at) * at.apart / at.distance
        ).sum(axis=1)

    return build


def softened(c, r, at):
    return r / (r**2 + c) ** 1.5 - r**-2.0


def three_bodies(c, rng):
    """Down the potential -c m1 m2 m3 / (r12 + r23 + r31)."""

    def force(at):
        around = at.distance[np.triu_indices(len(at.p), 1)].sum()
        return c * np.prod(at.m) / around**2 * unit(at.apart).sum(axis=1)

    return force


def retarded(c, rng):
    def force(at):
        late = c * np.linalg.norm(at.apart, axis=-1, keepdims=True)
        seen = at.apart - late * at.v[None]  # to where the others were
        size = np.linalg.norm(seen, axis=-1, keepdims=True)
        size = np.where(size > 0, size, 1.0)
        new = seen / size**3 - at.apart / at.distance**3
        return (at.m[:, None] * at.m[None] * new).sum(axis=1)

    return force


def chase(c, rng):
    def force(at):
        after = np.roll(np.arange(len(at.p)), -1)
        return c * unit(at.p[after] - at.p)

    return force


def viscous_pair(c, rng):
    def force(at):
        return c * ((at.v[None] - at.v[:, None]) * np.exp(-at.distance / 1.5)).sum(axis=1)

    return force


def swirl(c, rng):
    def force(at):
        turned = np.stack([-at.apart[..., 1], at.apart[..., 0]], axis=-1)
        return c * (turned * np.exp(-np.square(at.distance / 2.0))).sum(axis=1)

    return force


def odd_path(c, rng):
    rates, phases = rng.uniform(0.4, 0.9, 2), rng.uniform(0, 2 * np.pi, 2)

    def force(at):
        place = 45.0 * np.cos(rates * at.t + phases)
        out = place - at.p[:, :2]
        size = np.square(out).sum(axis=1, keepdims=True) + 25.0
        return c * at.m * np.pad(out / size, ((0, 0), (0, at.p.shape[1] - 2)))

    return force


def flyby(c, rng):
    start, aim = way_of(rng), rng.uniform(-1, 1, 2)

    def force(at):
        out = 4.0 * start * (1 - 2 * (at.t / at.span) ** 2) + aim - at.p[:, :2]
        return c * at.m * out / (np.linalg.norm(out, axis=1, keepdims=True) + 0.3) ** 2.5

    return force


# --- frames ---------------------------------------------------------------------------------------


def spun_up(c, rng):
    def force(at):
        rate, change = c * (0.3 + at.t / at.span), c / at.span
        turned = np.zeros_like(at.p)
        turned[:, 0], turned[:, 1] = -at.p[:, 1], at.p[:, 0]
        flat = at.p * (np.arange(at.p.shape[1]) < 2)
        swift = np.zeros_like(at.p)
        swift[:, 0], swift[:, 1] = -at.v[:, 1], at.v[:, 0]
        return at.m * (-2 * rate * swift + rate**2 * flat - change * turned)

    return force


def shaken(c, rng):
    rates, phases = rng.uniform(2, 9, (3, 2)), rng.uniform(0, 2 * np.pi, (3, 2))
    return lambda at: c * at.m * np.sin(rates * at.t + phases).sum(axis=0)


def rocked(c, rng):
    rate = rng.uniform(3, 6)

    def force(at):
        angle, own = c * np.sin(rate * at.t), weight(at)
        size, turned = own[:, -1], np.zeros_like(own)
        turned[:, 0], turned[:, -1] = -size * np.sin(angle), size * (np.cos(angle) - 1)
        return turned

    return force
