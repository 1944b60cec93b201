"""Motion that the package did not make: scipy's DOP853 under laws that no grammar lists."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from foreign_layouts import LAYOUTS, unit
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import FitError
from bsp_gp.units import DIMENSIONLESS, UnitSystem

RTOL, ATOL = 1e-10, 1e-12
FEW, MANY = (3, 6), (6, 13)
ROWS = (50, 201)
SI = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})


@dataclass(frozen=True, eq=False)
class At:
    """One instant of a scene, as forces see it.

    Attributes
    ----------
    t : float, s
    p, v : ndarray, shape (N, d)
        Metres, metres per second.
    props : dict of str to ndarray, shape (N, 1)
        Properties by name; nan where a body has none.
    scene : int
    span : float, s
        How long the recording is.
    u : ndarray, shape (k, N, d)
        What a force remembers.
    """

    t: float
    p: np.ndarray
    v: np.ndarray
    props: dict
    scene: int
    span: float
    u: np.ndarray = None

    @property
    def m(self):
        return self.props["mass"]

    @cached_property
    def speed(self):
        return np.linalg.norm(self.v, axis=-1, keepdims=True)

    @property
    def along(self):
        return unit(self.v)

    @property
    def perp(self):
        """The velocity turned by +90 degrees."""
        return np.stack([-self.v[:, 1], self.v[:, 0]], axis=-1)

    @cached_property
    def apart(self):
        """From every body i to every j, (N, N, d)."""
        return self.p[None] - self.p[:, None]

    @cached_property
    def distance(self):
        """Between bodies, (N, N, 1); 1 of a body to itself."""
        size = np.linalg.norm(self.apart, axis=-1, keepdims=True)
        return np.where(size > 0, size, 1.0)

    @property
    def to_post(self):
        """From every body to the last one."""
        return self.p[-1] - self.p


# --- motion ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plan:
    """What of a set is drawn but its force and its noise.

    Attributes
    ----------
    layout : str
    n_dims : int
    is_long : bool
        Whether it has six scenes or more.
    properties : tuple of str
        Columns that the data show.
    entropy : tuple of int
    """

    layout: str
    n_dims: int
    is_long: bool
    properties: tuple
    entropy: tuple


@dataclass(frozen=True, eq=False)
class Truth:
    """Exact motion with the accelerations behind it, (S, T, N, d), as judges of laws take them."""

    scenes: tuple
    total: np.ndarray = field(repr=False)
    declared: np.ndarray = field(repr=False)

    def scene(self, k):
        return self.scenes[k]

    def accelerations(self, of_declared=False):
        return self.declared if of_declared else self.total


def moved(plan, force=None, layout=None, n_scenes=None):
    """Exact data of a plan under its declared force and a foreign one.

    Parameters
    ----------
    plan : Plan
    force : callable, optional
        ``force(at)``, N; with `blocks` and `rate(at, a)` where it remembers something.
    layout : Layout, optional
        One that is not listed.
    n_scenes : int, optional
        In place of a number that is drawn.

    Returns
    -------
    Dataset, Truth
    """
    layout, rng = layout or LAYOUTS[plan.layout], np.random.default_rng(plan.entropy)
    times = np.linspace(0, layout.span * rng.uniform(0.8, 1.2), int(rng.integers(*ROWS)))
    crews = layout.crew(rng)
    scenes, totals, declared = [], [], []
    n_scenes = n_scenes or int(rng.integers(*(MANY if plan.is_long else FEW)))
    for k in range(n_scenes):
        crew = crews[k % len(crews)]
        start = _started(layout, plan.n_dims, crew, times, rng)
        p, v, total, own = _run(layout, crew, *start, times, force, k)
        shown = tuple(_shown(entity, plan.properties) for entity in crew)
        scenes.append(Scene(str(k + 1), times, p, shown, velocities=v))
        totals.append(total)
        declared.append(own)
    bare = tuple(Scene(s.name, s.times, s.positions, s.entities) for s in scenes)
    up = "xyz"[plan.n_dims - 1] if layout.has_up else None
    units = {"spin": DIMENSIONLESS} if "spin" in plan.properties else {}
    dataset = Dataset(plan.layout, bare, units=SI, property_units=units, up=up)
    return dataset, Truth(tuple(scenes), np.array(totals), np.array(declared))


def _shown(entity, columns):
    kept = {name: value for name, value in entity.properties.items() if name in columns}
    return Entity(entity.name, is_static=entity.is_static, properties=kept)


def _started(layout, n_dims, crew, times, rng):
    """Where a scene starts: bodies keep apart under the declared force, whatever is foreign."""
    while True:
        p, v = layout.start(rng, n_dims, crew)
        if not layout.closest:
            return p, v
        places = _run(layout, crew, p, v, times, None, 0)[0]
        i, j = np.triu_indices(len(crew), 1)
        if np.linalg.norm(places[:, i] - places[:, j], axis=-1).min() >= layout.closest:
            return p, v


def _run(layout, crew, p, v, times, force, scene):
    """Positions, velocities, and accelerations in all and of what is declared, (T, N, d)."""
    shape, is_moving = p.shape, np.array([[not e.is_static] for e in crew])
    names = {name for e in crew for name in e.properties}
    props = {
        name: np.array([[e.properties.get(name, np.nan)] for e in crew]) for name in names
    }
    mass = np.where(is_moving, np.nan_to_num(props["mass"], nan=1.0), 1.0)
    blocks = getattr(force, "blocks", 0)

    def at(t, y):
        p, v, *u = y.reshape(2 + blocks, *shape)
        return At(t, p, v, props, scene, times[-1], np.array(u))

    def accelerations(now):
        own = layout.force(now)
        total = own if force is None else own + force(now)
        return (np.where(is_moving, f / mass, 0.0) for f in (total, own))

    def slope(t, y):
        now = at(t, y)
        a = next(accelerations(now))
        rates = force.rate(now, a) if blocks else np.zeros((0, *shape))
        return np.concatenate([now.v.ravel(), a.ravel(), np.where(is_moving, rates, 0.0).ravel()])

    y = np.concatenate([p.ravel(), v.ravel(), np.zeros(blocks * p.size)])
    out = solve_ivp(
        slope, (times[0], times[-1]), y, "DOP853", times, rtol=RTOL, atol=ATOL,
        max_step=times[-1] / 20,  # a short push is not stepped over
    )  # fmt: skip
    if not out.success:
        raise FitError(f"the motion of layout {layout.declared(2)} ended early: {out.message}")
    states = [at(t, row) for t, row in zip(times, out.y.T, strict=True)]
    both = np.array([list(accelerations(now)) for now in states])
    return np.array([s.p for s in states]), np.array([s.v for s in states]), both[:, 0], both[:, 1]
