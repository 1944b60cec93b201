"""Orbits for the studies of fits: one to five bodies around a central mass, quoted errors.

Constants are drawn over three decades, and nothing is told to the fit.
"""

import numpy as np
from fit_tracks import Shot, World, growth, integrated
from fit_worlds import anchor, between, moving

CENTRAL = "k * m_i * sun_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
MUTUAL = "g * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
DRAG = "-c * m_i * v_i"
KINDS = ("static", "static and mutual", "static and drag", "free")
DECADES = (10**-1.5, 10**1.5)
MAX_REVOLUTIONS = 20.0
MAX_GROWTH = 5.0
"""Of span times Lyapunov exponent."""
SPACING = 6.0
"""Least distance of neighbours' orbits, closest approach of one to farthest of the other, in their
Hill radii."""


def orbits(rng):
    """One world of `KINDS`; too chaotic ones are drawn anew."""
    while True:
        world = _drawn(rng)
        if "g" not in world.truth:  # every body on a curve of its own
            return world
        try:
            lyapunov = growth(world)
        except ArithmeticError:  # two bodies met
            continue
        if lyapunov <= MAX_GROWTH:
            world.facts["lyapunov"] = float(lyapunov)
            return world


def _drawn(rng):
    kind = KINDS[rng.integers(len(KINDS))]
    n_bodies = int(rng.integers(2 if kind == "static and mutual" else 1, 6))
    n_dims = 3 if rng.random() < 0.3 else 2
    strength, size = between(rng, *DECADES), between(rng, 0.1, 10.0)
    axes, eccentricities, masses = _arranged(rng, n_bodies, size, kind)
    states = np.stack(
        [_begun(rng, a, e, strength, n_dims) for a, e in zip(axes, eccentricities, strict=True)],
        axis=1,
    )
    period = 2 * np.pi * np.sqrt(axes[0] ** 3 / strength)
    revolutions = between(rng, 1.0, MAX_REVOLUTIONS)
    times, is_even = _epochs(rng, revolutions, period)
    truth, laws = {"k": strength}, (CENTRAL,)
    if kind == "static and mutual":
        # Masses are told in units of the Sun's; that they pull with the same constant is not.
        truth, laws = {"k": strength, "g": strength * between(rng, 0.5, 2.0)}, (CENTRAL, MUTUAL)
    elif kind == "static and drag":
        truth = {"k": strength, "c": rng.uniform(0.02, 0.3) / times[-1]}
        laws = (CENTRAL, DRAG)
    elif kind == "free":
        truth, laws = {"g": strength}, (MUTUAL,)
        masses, states = _with_sun(masses, states)
    level = between(rng, 1e-4, 1e-2)
    sigma = level * axes[0] * np.exp(rng.normal(0.0, 0.4, (len(times), *states.shape[1:])))
    entities, fixed = _entities(kind, masses, n_dims)
    facts = {
        "bodies": n_bodies, "dims": n_dims, "revolutions": revolutions, "rows": len(times),
        "even": is_even, "eccentricity": float(max(eccentricities)), "level": level,
    }  # fmt: skip
    return World(
        kind, laws, truth, entities, (Shot(times, states, sigma),),
        integrated(_pulls(kind, masses)), "quoted", fixed, facts=facts,
    )  # fmt: skip


def _arranged(rng, n_bodies, size, kind):
    """Semi-major axes, eccentricities and masses (of the centre's) that keep their distance.

    Where planets pull one another, more eccentric ones stand farther apart.
    """
    is_coupled = kind in ("static and mutual", "free")
    masses = np.array([between(rng, 1e-4, 5e-3) for _ in range(n_bodies)])
    limit = 0.9 if n_bodies == 1 or not is_coupled else 0.9 / n_bodies
    eccentricities = limit * np.sqrt(rng.random(n_bodies))
    axes = [size]
    for j in range(1, n_bodies):
        farthest = axes[-1] * (1 + eccentricities[j - 1])
        hill = ((masses[j - 1] + masses[j]) / 3) ** (1 / 3)
        gap = 1 + SPACING * hill if is_coupled else 1.05
        axes.append(farthest * gap * rng.uniform(1.0, 1.5) / (1 - eccentricities[j]))
    return np.array(axes), eccentricities, masses


def _begun(rng, axis, eccentricity, strength, n_dims):
    """Place and velocity on an orbit at a random anomaly, either way around, shape (2, d)."""
    mean, angle = rng.uniform(0, 2 * np.pi, 2)
    anomaly = mean
    for _ in range(200):  # Newton's method for Kepler's equation, halved where it would leap
        step = (anomaly - eccentricity * np.sin(anomaly) - mean) / (
            1 - eccentricity * np.cos(anomaly)
        )
        anomaly -= np.clip(step, -0.5, 0.5)
    b = np.sqrt(1 - eccentricity**2) * rng.choice([-1.0, 1.0])
    rate = np.sqrt(strength / axis**3) / (1 - eccentricity * np.cos(anomaly))
    place = axis * np.array([np.cos(anomaly) - eccentricity, b * np.sin(anomaly)])
    speed = axis * rate * np.array([-np.sin(anomaly), b * np.cos(anomaly)])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    flat = np.stack([place, speed]) @ turn
    if n_dims == 2:
        return flat
    tilt = rng.normal(0.0, 0.15)
    return np.column_stack([flat[:, 0], flat[:, 1] * np.cos(tilt), flat[:, 1] * np.sin(tilt)])


def _epochs(rng, revolutions, period):
    """Even epochs, 4 to 12 in each of the innermost body's revolutions, or as many at random."""
    n = max(12, int(np.ceil(revolutions * rng.uniform(4.0, 12.0))) + 1)
    is_even = bool(rng.random() < 0.5)
    share = np.linspace(0.0, 1.0, n)
    if not is_even:
        share = np.sort(np.concatenate([[0.0, 1.0], rng.random(n - 2)]))
    return share * revolutions * period, is_even


def _with_sun(masses, states):
    """A central body that moves, centre of mass at rest; all masses of its own scale."""
    masses = np.concatenate([[1.0], masses])
    states = np.concatenate([np.zeros((2, 1, states.shape[2])), states], axis=1)
    middle = np.einsum("j,sjd->sd", masses, states) / masses.sum()
    return masses, states - middle[:, None]


def _entities(kind, masses, n_dims):
    if kind == "free":
        return tuple(moving(f"b{j}", m) for j, m in enumerate(masses)), ()
    planets = tuple(moving(f"b{j}", m, sun=0.0) for j, m in enumerate(masses))
    return (*planets, anchor(sun=1.0, mass=0.0)), (0.0,) * n_dims


def _pulls(kind, masses):
    n_bodies = len(masses)

    def mutual(p, c):
        apart = p[:, None, :] - p[:, :, None]
        cube = (np.square(apart).sum(axis=-1) + np.eye(n_bodies)) ** 1.5
        return ((c["g"] * masses / cube)[..., None] * apart).sum(axis=2)

    def acceleration(t, p, v, c):
        total = 0.0
        if "k" in c:
            total = total - c["k"] * p / np.square(p).sum(axis=-1, keepdims=True) ** 1.5
        if "g" in c:
            total = total + mutual(p, c)
        if "c" in c:
            total = total - c["c"] * v
        return total

    return acceleration
