"""What a posterior predicts: one-step errors averaged over draws, and rollouts with bands."""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.inference.latents import PropertyTable
from bsp_gp.inference.misfit import DirectMisfit, constant_values, repeated
from bsp_gp.physics.bodies import Batch, stack
from bsp_gp.physics.dynamics import rollout
from bsp_gp.physics.likelihood import build_regression

N_DRAWS = 200
"""Of the posterior, for its bands."""


def posterior_nrmse(law, scenes, latents, draws, *, reference=None, up=None):
    """The paper's nRMSE of every scene, averaged over draws of the latents.

    Parameters
    ----------
    draws : ndarray, shape (W, k)
        Equally weighted, columns in the order of `latents`.
    reference : sequence of Scene, optional
        The same scenes without noise: errors are then those of the predicted places against
        these, while the states predicted from stay the measured ones.

    Returns
    -------
    ndarray, shape (n_scenes,)
        Mean over draws, times and all entities (static ones with error 0) of the Euclidean
        one-step error.
    """
    out = []
    for index, scene in enumerate(scenes):
        mine, columns = latents.of_scenes([scene.name])
        regression = build_regression([scene], up=up)
        misfit = DirectMisfit(law, mine, regression)
        batch = regression.batches[0]
        n, _, r, d = batch.target.shape
        errors = misfit.residual(draws[:, columns]).reshape(len(draws), n, r, d)
        if reference is not None:
            gap = (reference[index].positions - scene.positions)[2:, batch.bodies.receivers]
            errors = errors + gap
        sizes = np.linalg.norm(errors, axis=-1)
        out.append(sizes.sum(axis=(1, 2)).mean() / (n * len(scene.entities)))
    return np.array(out)


@dataclass(frozen=True, eq=False)
class Bands:
    """Posterior-predictive rollout of one scene.

    Attributes
    ----------
    names : tuple of str
        Receivers.
    times : ndarray, shape (T,)
    median, low, high : ndarray, shape (T, R, d)
        Of the positions, metres; `low` and `high` bound 90 %.
    observed : ndarray, shape (T, R, d)
    """

    scene: str
    names: tuple[str, ...]
    times: np.ndarray
    median: np.ndarray
    low: np.ndarray
    high: np.ndarray
    observed: np.ndarray


def predictive_bands(law, scene, latents, posterior, *, rng, integrator="euler", up=None):
    """Roll a scene out from its first rows under draws of the posterior.

    Parameters
    ----------
    posterior : Posterior
        Over the latents, and over the constants if they were sampled too.
    """
    (batch,) = stack([scene], up)
    mine, _ = latents.of_scenes([scene.name])
    draws = posterior.draw(N_DRAWS, rng=rng)
    column = {name: k for k, name in enumerate(posterior.names)}
    values = draws[:, [column[name] for name in mine.names]]
    table = PropertyTable(batch.bodies, (scene.name,), mine)
    bodies = repeated(batch.bodies, N_DRAWS, table.columns(values))
    names = tuple(n for n in law.names if n in column and not hasattr(law.constants[n], "items"))
    constants = np.stack([draws[:, column[n]] for n in names], axis=1) if names else None
    given = constant_values(law, names, constants if names else np.zeros((N_DRAWS, 0)), bodies)
    many = Batch(
        (scene,) * N_DRAWS, bodies, *(np.repeat(a, N_DRAWS, axis=1) for a in
                                      (batch.times, batch.positions)), None
    )  # fmt: skip
    receivers = bodies.receivers
    p = many.positions[1][:, receivers]
    v = (p - many.positions[0][:, receivers]) / (batch.times[1] - batch.times[0])[0]
    late = replace(many, times=many.times[1:], positions=many.positions[1:])
    tracks = rollout(law, late, p, v, integrator=integrator, values=given)
    tracks = np.concatenate([many.positions[:1][:, :, receivers], tracks])
    low, median, high = np.nanquantile(tracks, [0.05, 0.5, 0.95], axis=1)
    return Bands(
        scene.name, batch.bodies.receiver_names[0], scene.times, median, low, high,
        scene.positions[:, receivers],
    )  # fmt: skip
