"""Experiments at the ends of what can be chosen, where a law was never tried.

Experiments by chance seldom begin with bodies close together, fast, or far out; what laws add
there is not seen in them. A law that has foreseen others must foresee these before it stands.
"""

import numpy as np

N_DRAWN = 256
"""Experiments by chance among which ends are looked for."""


def at_the_ends(means, tried, rng, count=1):
    """Experiments that begin further out than all that were tried, each in one respect.

    Parameters
    ----------
    means : Means
    tried : sequence of Experiment
    rng : numpy.random.Generator
    count : int
        At the most.

    Returns
    -------
    list of Experiment
        The closest pair first, then the widest, the longest and the shortest, the fastest and the
        slowest body, and the least and greatest of every setting, property and coordinate.
    """
    drawn = [means.draw(rng) for _ in range(N_DRAWN)]
    known = [_respects(experiment) for experiment in tried]
    found = [_respects(experiment) for experiment in drawn]
    chosen: dict = {}
    for name in found[0]:
        for sign in (1.0, -1.0):
            values = sign * np.array([own[name] for own in found])
            k = int(np.argmin(values))
            if values[k] < min(sign * own[name] for own in known):
                chosen.setdefault(k, drawn[k])
    return list(chosen.values())[:count]


def _respects(experiment):
    """What forces may depend on where an experiment begins, by name, the most usual first."""
    moving = [k for k, body in enumerate(experiment.bodies) if not body.is_static]
    places = np.array([body.position for body in experiment.bodies], dtype=float)
    speeds = [np.linalg.norm(experiment.bodies[k].velocity) for k in moving]
    out = {}
    gaps = [np.linalg.norm(places[k] - places[j])
            for k in moving for j in range(len(places)) if j != k]  # fmt: skip
    if gaps:
        out |= {"gap": min(gaps)}
    out |= {"time": -experiment.times[-1], "speed": max(speeds, default=0.0)}
    out |= {f"setting {name}": value for name, value in experiment.settings.items()}
    for k in moving:
        body = experiment.bodies[k]
        out |= {f"{name} of {body.name}": value for name, value in body.properties.items()}
    for k in moving:
        out |= {f"{axis} of {experiment.bodies[k].name}": place
                for axis, place in zip("xyz", places[k].tolist(), strict=False)}  # fmt: skip
    return out
