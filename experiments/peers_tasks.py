"""Laws for the comparison with other tools: their scenes, pair tables and scores.

Each law is a central force between two discs, given as its pull of body i towards body j. It is
put in two forms: the *table* of pulls of single pairs, which is what general symbolic regression
asks for, and the *motion* of four discs, in which only sums of pulls over the others are seen, as
accelerations.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.data.scene import Dataset, Entity, Scene

N_BODIES, N_FRAMES, DT = 4, 41, 0.05
N_SCENES = 3
"""Scenes to learn from; as many fresh ones to be judged on."""
N_TABLE = 600
NEAREST = 2.0
"""Least distance of two discs in a scene, m."""
TOLERANCE = 1e-5
"""Root mean square error on fresh data over that of no force, up to which a law is found: a
hundred times the rounding of single precision, in which one of the tools computes."""
FAR_TOLERANCE = 1e-4
"""The same beyond the range that was learned from, where a mere approximation fails."""
ENOUGH = 0.1 * TOLERANCE
"""Error on the known data at which a tool may stop."""


@dataclass(frozen=True)
class Task:
    """A law to be found.

    Attributes
    ----------
    name, text : str
    pull : callable
        ``pull(m_i, m_j, r, s)``, N, towards j; s is the sum of the radii, m.
    speed : float
        Of the discs at first, m/s.
    box : float
        Half width of the square in which they start, m.
    has_contact : bool
        Whether radii matter.
    radius : tuple of float
        Least and greatest, m.
    """

    name: str
    text: str
    pull: Callable
    speed: float = 2.0
    box: float = 12.0
    has_contact: bool = False
    radius: tuple[float, float] = (2.0, 4.0)

    @property
    def columns(self):
        """What a pull depends on, as far as a table tells."""
        return ("m_i", "m_j", "r", "s") if self.has_contact else ("m_i", "m_j", "r")


TASKS = {
    task.name: task
    for task in (
        Task("gravity", "50 m_i m_j / r^2", lambda mi, mj, r, s: 50 * mi * mj / r**2),
        Task("fractional exponent", "5 m_i m_j / r^1.37",
             lambda mi, mj, r, s: 5 * mi * mj / r**1.37),
        Task("softened gravity", "50 m_i m_j r / (r^2 + 4^2)^1.5",
             lambda mi, mj, r, s: 50 * mi * mj * r / (r**2 + 16.0) ** 1.5),
        Task("screened force", "50 m_i m_j exp(-r / 6) / r^2",
             lambda mi, mj, r, s: 50 * mi * mj * np.exp(-r / 6) / r**2),
        Task("two forces", "20 m_i m_j / r^2 + 0.8 r",
             lambda mi, mj, r, s: 20 * mi * mj / r**2 + 0.8 * r),
        Task("shifted gravity", "50 m_i m_j / (r + 3)^2",
             lambda mi, mj, r, s: 50 * mi * mj / (r + 3) ** 2),
        Task("contact", "-80 (s - r) where r < s",
             lambda mi, mj, r, s: -80 * np.maximum(s - r, 0.0), 12.0, 8.0, True),
        # Eight more, the last four of which are no form of our grammar, chosen before it was tuned.
        Task("massive carrier", "60 m_i m_j (1 + r / 5) exp(-r / 5) / r^2",
             lambda mi, mj, r, s: 60 * mi * mj * (1 + r / 5) * np.exp(-r / 5) / r**2),
        Task("Gaussian", "3 m_i m_j r exp(-(r / 7)^2)",
             lambda mi, mj, r, s: 3 * mi * mj * r * np.exp(-((r / 7) ** 2))),
        Task("powers of masses", "30 m_i^0.6 m_j^1.4 / r^1.5",
             lambda mi, mj, r, s: 30 * mi**0.6 * mj**1.4 / r**1.5),
        Task("rest length", "-4 (6.5 - r)", lambda mi, mj, r, s: -4 * (6.5 - r)),
        Task("saturating", "8 m_i m_j r / (r^2 + 5^2)",
             lambda mi, mj, r, s: 8 * mi * mj * r / (r**2 + 25)),
        Task("two powers", "60 m_i m_j / r^1.5 - 250 m_i m_j / r^3.2",
             lambda mi, mj, r, s: mi * mj * (60 / r**1.5 - 250 / r**3.2)),
        Task("growing and screened", "10 m_i m_j sqrt(r) / (1 + exp((r - 9) / 2))",
             lambda mi, mj, r, s: 10 * mi * mj * np.sqrt(r) / (1 + np.exp((r - 9) / 2))),
        Task("oscillating", "25 m_i m_j cos(r / 3) / r",
             lambda mi, mj, r, s: 25 * mi * mj * np.cos(r / 3) / r),
    )
}  # fmt: skip


def scene_of(task, name, rng):
    """Discs that a task's law moves, so that one symplectic Euler step is exact."""
    while True:
        mass, radius = rng.uniform(1, 9, N_BODIES), rng.uniform(*task.radius, N_BODIES)
        track = moved(task, mass, radius, rng)
        gap = np.linalg.norm(track[:, :, None] - track[:, None], axis=-1)
        # One close encounter would outweigh all other rows, in every tool's least squares.
        if gap[:, *np.triu_indices(N_BODIES, 1)].min() > NEAREST:
            break
    entities = [Entity(str(k + 1), "disc", float(radius[k]), properties={"mass": float(mass[k])})
                for k in range(N_BODIES)]  # fmt: skip
    return Scene(name, DT * np.arange(N_FRAMES), track, tuple(entities))


def moved(task, mass, radius, rng):
    """Tracks from drawn places and velocities, shape (T, N, 2)."""
    p = rng.uniform(-task.box, task.box, (N_BODIES, 2))
    track = [p, p + DT * rng.normal(0, task.speed, (N_BODIES, 2))]
    while len(track) < N_FRAMES:
        a = accelerations(task, track[-1], mass, radius)
        track.append(2 * track[-1] - track[-2] + DT**2 * a)
    return np.array(track)


def accelerations(task, p, mass, radius):
    """Sums of the pulls over the others, over the mass, shape (N, 2)."""
    gap = p[None] - p[:, None]
    r = np.linalg.norm(gap, axis=-1) + np.eye(len(p))
    pull = task.pull(mass[:, None], mass[None], r, radius[:, None] + radius[None])
    pull = pull * (1 - np.eye(len(p))) / mass[:, None]
    return (pull[..., None] * gap / r[..., None]).sum(axis=1)


def beyond(task):
    """The task in twice the box; of a contact with twice the radii too, so that it is deeper."""
    radius = tuple(2 * r for r in task.radius) if task.has_contact else task.radius
    return replace(task, box=2 * task.box, radius=radius)


def motion(task, seed):
    """Scenes to learn from, fresh ones, and fresh ones beyond the range of both."""
    rng = np.random.default_rng(seed)
    tasks = [task] * (2 * N_SCENES) + [beyond(task)] * N_SCENES
    scenes = [scene_of(one, str(k), rng) for k, one in enumerate(tasks, 1)]
    return [scenes[k : k + N_SCENES] for k in range(0, len(scenes), N_SCENES)]


@dataclass(frozen=True)
class Pairs:
    """What the other tools are given of scenes: pairs, and what is seen of each receiver.

    Attributes
    ----------
    x : ndarray, shape (P, 3 or 4)
        Task.columns.
    direction : ndarray, shape (P, 2)
        Unit vector from i to j.
    row : ndarray of int, shape (P,)
        Row of the acceleration that the pair has a part in.
    seen : ndarray, shape (n, 2), metres/second^2
    pull : ndarray, shape (P,), N
        The truth; only the table's tools may look at it.
    """

    x: np.ndarray
    direction: np.ndarray
    row: np.ndarray
    seen: np.ndarray
    pull: np.ndarray

    def summed(self, pull):
        """Accelerations that pulls of pairs make, shape (n, 2)."""
        part = pull / self.x[:, 0]
        return np.stack([np.bincount(self.row, part * self.direction[:, k], len(self.seen))
                         for k in range(2)], axis=1)  # fmt: skip


def pairs_of(task, scenes):
    """All pairs of all instants of scenes."""
    x, direction, row, seen, n = [], [], [], [], 0
    i, j = (index.ravel() for index in np.nonzero(~np.eye(N_BODIES, dtype=bool)))
    for scene in scenes:
        mass = np.array([e.mass for e in scene.entities])
        radius = np.array([e.radius for e in scene.entities])
        p = scene.positions
        for t in range(1, len(p) - 1):
            gap = p[t, j] - p[t, i]
            r = np.linalg.norm(gap, axis=1)
            x.append(np.column_stack([mass[i], mass[j], r, radius[i] + radius[j]]))
            direction.append(gap / r[:, None])
            row.append(n + i)
            seen.append((p[t + 1] - 2 * p[t] + p[t - 1]) / DT**2)
            n += N_BODIES
    x, direction, row = np.vstack(x), np.vstack(direction), np.concatenate(row)
    return Pairs(x[:, : len(task.columns)], direction, row, np.vstack(seen), task.pull(*x.T))


def table(task, seed):
    """Pulls of single pairs, drawn from the scenes of `motion`: three times (x, y).

    Of a contact law half of the rows are of pairs that touch.
    """
    rng = np.random.default_rng((seed, 1))
    parts = []
    for scenes in motion(task, seed):
        pairs = pairs_of(task, scenes)
        weights = np.ones(len(pairs.pull))
        if task.has_contact:
            touches = pairs.pull != 0
            weights = np.where(touches, 1 / max(touches.sum(), 1), 1 / (~touches).sum())
        n = min(N_TABLE, int((weights > 0).sum()))
        index = rng.choice(len(weights), n, replace=False, p=weights / weights.sum())
        parts.append((pairs.x[index], pairs.pull[index]))
    return parts


def table_scenes(task, x, y):
    """The same table as motion: a disc and a fixed one, three frames, for each row."""
    scenes = []
    for k, (row, pull) in enumerate(zip(x, y, strict=True)):
        m_i, m_j, r = row[:3]
        s = row[3] if task.has_contact else 2.0
        entities = (
            Entity("i", "disc", s / 2, properties={"mass": float(m_i)}),
            Entity("j", "disc", s / 2, is_static=True, properties={"mass": float(m_j)}),
        )
        positions = np.zeros((3, 2, 2))
        positions[:, 0, 0] = r
        positions[2, 0, 0] -= DT**2 * pull / m_i
        scenes.append(Scene(str(k), DT * np.arange(3), positions, entities))
    return scenes


def dataset_of(scenes):
    """Scenes as a data set, for its types."""
    return Dataset("peers", tuple(scenes))


def relative(error, target):
    """Root mean square error over that of zero; inf where not finite."""
    error = np.asarray(error, dtype=float)
    if not np.isfinite(error).all():
        return float("inf")
    return float(np.linalg.norm(error) / np.linalg.norm(target))
