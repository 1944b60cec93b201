"""Errors of networks in the words of `bsp_gp.physics.metrics`: one step, and whole rollouts."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from .models import FIXED_NUMBER, excess_of_row
from .training import run_of
from .worlds import rows_of


def one_step(trained, worlds):
    """The paper's nRMSE of every run on every scene: mean over entities and times.

    Returns
    -------
    ndarray, shape (n_runs, S), metres
    """
    rows = rows_of(worlds)
    error = np.linalg.norm(trained.excess(worlds) - rows.excess, axis=-1) * rows.weights
    error = np.where(np.isfinite(error), error, np.inf)
    return error.reshape(trained.n_runs, worlds.n_scenes, -1).sum(axis=-1) * worlds.n_scenes


def share_predicted(trained, worlds):
    """Mean size of what is predicted over that of what there is: near 0, it predicts no force.

    Returns
    -------
    ndarray, shape (n_runs,)
    """
    rows = rows_of(worlds)
    predicted, true = (np.linalg.norm(excess, axis=-1) * rows.weights
                       for excess in (trained.excess(worlds), rows.excess))  # fmt: skip
    return predicted.sum(axis=(1, 2)) / true.sum()


@partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))
def _roll(model, n_moving, dt, inputs, n_steps, params, norm, bodies, p, v):
    one = partial(excess_of_row, model, n_moving=n_moving, dt=dt, inputs=inputs)

    def scene(bodies, p, v):
        moves = bodies["moves"][:n_moving, None]

        def step(state, _):
            p, v = state
            excess = moves * one(params, norm, {**bodies, "p": p, "v": v})
            v = v.at[:n_moving].add(excess / dt)
            p = p + dt * v
            return (p, v), p

        return jax.lax.scan(step, (p, v), None, length=n_steps)[1]

    return jax.vmap(scene)(bodies, p, v)


def rollouts(trained, worlds):
    """Mean distance from the track when the network runs on from the first two rows.

    Returns
    -------
    ndarray, shape (n_runs, S), metres
        Over all entities and later rows; inf where the motion left the range of numbers.
    """
    p = worlds.positions
    v = (p[:, 1] - p[:, 0]) / worlds.dt
    bodies = {name: np.asarray(x, np.float32) for name, x in worlds.bodies.tree().items()}
    errors = []
    for k in range(trained.n_runs):
        out = _roll(trained.model, worlds.n_moving, worlds.dt, trained.inputs, p.shape[1] - 2,
                    run_of(trained.params, k), run_of(trained.norm, k), bodies,
                    jnp.asarray(p[:, 1], jnp.float32), jnp.asarray(v, jnp.float32))  # fmt: skip
        gap = np.linalg.norm(np.asarray(out, np.float64) - p[:, 2:], axis=-1).sum(axis=(1, 2))
        gap = gap / (worlds.n_bodies * (p.shape[1] - 2))
        errors.append(np.where(np.isfinite(gap), gap, np.inf))
    return np.array(errors)


def can_be_asked(model, worlds, n_bodies):
    """Whether a network trained on so many bodies has an answer for these worlds."""
    return model not in FIXED_NUMBER or worlds.positions.shape[2] == n_bodies
