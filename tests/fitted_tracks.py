"""Laws, bodies and scenes for the tests of bsp_gp.fitting, and scipy's answer to compare with."""

import numpy as np
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import PROPERTY_UNITS, Dataset, Entity, Scene
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion
from bsp_gp.physics.force import ForceLaw, Term
from tests.throws import SI


def law_of(*texts, n_dims=2, vectors=(), more=(), **constants):
    """A law from texts; `more` names further properties without a unit."""
    units = {**PROPERTY_UNITS, **dict.fromkeys(more)}
    types = input_types(units, n_dims=n_dims, up="y", vectors=vectors)
    return ForceLaw([Term(parse_formula(text, types)) for text in texts], constants)


def parameters_of(law):
    """All constants as (name, entity), one for each body where a constant is a mapping."""
    out = []
    for name in law.names:
        value = law.constants[name]
        out += [(name, entity) for entity in (value if hasattr(value, "items") else [""])]
    return tuple(out)


def values_of(law):
    """The values of `parameters_of`."""
    return np.array(
        [law.constants[n][e] if e else law.constants[n] for n, e in parameters_of(law)], dtype=float
    )


def body(name, mass=1.0, **settings):
    return Entity(name, properties={"mass": mass, **settings.pop("properties", {})}, **settings)


def disc(name, radius, **settings):
    return body(name, shape="disc", radius=radius, **settings)


def scene_of(times, crew, places, name="s", **settings):
    """Bodies at `places` (N, d), or at rows of them (T, N, d)."""
    places = np.broadcast_to(places, (len(times), len(crew), np.shape(places)[-1]))
    return Scene(name, np.asarray(times, dtype=float), places, crew, **settings)


def flow_of(law, scenes, tolerance=1e-12, paper_steps=False):
    """The one group of chains of these scenes, ready to run; constants are put in."""
    (chains,) = build_chains(law, scenes, "y")
    motion = Motion(law, chains, parameters_of(law))
    motion.set_constants(values_of(law))
    return Flow(motion, np.full(chains.n_chains, tolerance), paper_steps)


def nodes_of(flow, places, velocities):
    """Nodes that have the same state in every row, (2, R, d, T, S), from (R, d) or (R, d, T, S)."""
    shape = (flow.chains.n_moving, flow.chains.n_dims, *flow.chains.times.shape)
    state = [np.asarray(x, dtype=float) for x in (places, velocities)]
    state = [x.reshape(*x.shape, 1, 1) if x.ndim == 2 else x for x in state]
    return np.stack([np.broadcast_to(x, shape) for x in state]).copy()


def reference(law, scene, places, velocities, times, max_step=np.inf):
    """Places and velocities (T, R, d) by scipy's DOP853 with the package's own accelerations.

    Driven bodies stay where the scene's first row has them.
    """
    (batch,) = stack([scene], "y")
    moving = batch.bodies.receivers
    shape = (2, len(moving), scene.n_dims)
    p, v = batch.positions[0].copy(), np.zeros_like(batch.positions[0])

    def slope(t, state):
        state = state.reshape(shape)
        p[:, moving], v[:, moving] = state
        a = law.acceleration(batch.bodies, p, v, np.array([t]))[0]
        return np.concatenate([state[1].ravel(), a.ravel()])

    start = np.concatenate([np.ravel(places), np.ravel(velocities)]).astype(float)
    found = solve_ivp(
        slope, (times[0], times[-1]), start, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-13,
        max_step=max_step,
    )  # fmt: skip
    track = found.y.T.reshape(len(times), *shape)
    return track[:, 0], track[:, 1]


def differences(flow, nodes, mesh, step=1e-6):
    """Transitions (K, n, n + k) by central differences of the ends over the same steps."""
    n, k = flow.n_state, flow.n_constants
    motion = flow.motion
    values = values_of(motion.law)
    out = np.empty((flow.n_intervals, n, n + k))
    flat = nodes.reshape(n, -1)
    for column in range(n + k):
        ends = []
        for sign in (1.0, -1.0):
            moved, constants = flat.copy(), values.copy()
            if column < n:
                h = step
                moved[column] += sign * h
            else:
                h = step * max(abs(values[column - n]), 1e-3)
                constants[column - n] += sign * h
            motion.set_constants(constants)
            ends.append(flow.run(moved.reshape(nodes.shape), mesh, slopes=False)[0])
        out[:, :, column] = ((ends[0] - ends[1]) / (2 * h)).reshape(n, -1).T
    motion.set_constants(values)
    return out


def dataset_of(scenes, noise=None, **settings):
    """Scenes as a data set in SI with y up."""
    return Dataset("tracks", tuple(scenes), units=SI, up="y", noise=noise, **settings)
