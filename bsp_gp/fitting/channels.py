"""The coordinates of bodies in scenes, one channel each: when seen, and whose."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bsp_gp.fitting.whitening import gaps_of

_BY_ROW = ("times", "seen", "quoted", "speed")


@dataclass(frozen=True, eq=False)
class Channels:
    """What the noise of measured rows may depend on.

    Attributes
    ----------
    times : ndarray, shape (T, C), s
        nan = no row.
    seen : ndarray of bool, shape (T, C)
        Where there is a measured value.
    axis, body, scene : ndarray of int, shape (C,)
    chain : ndarray of int, shape (C,)
        Channels of one number share local unknowns: the initial states of a scene.
    body_names, scene_names : tuple of str
        What the integers of `body` and `scene` stand for.
    quoted : ndarray, shape (T, C), or None, metres
        Quoted standard deviations; nan where a row quotes none.
    speed : ndarray, shape (T, C), or None, m/s
        Of the body along the channel's axis; noise may grow with it.
    """

    times: np.ndarray
    seen: np.ndarray
    axis: np.ndarray
    body: np.ndarray
    scene: np.ndarray
    chain: np.ndarray
    body_names: tuple = ()
    scene_names: tuple = ()
    quoted: np.ndarray | None = None
    speed: np.ndarray | None = None

    @classmethod
    def of(cls, batches, speeds=None):
        """The channels of the receivers of batches, in their order.

        Parameters
        ----------
        speeds : sequence of ndarray, shape (T, S, R, d), m/s, optional
            Fitted or smoothed velocities of the receivers.
        """
        bodies, scenes, of_body, of_scene, axis = {}, {}, [], [], []
        for batch in batches:
            n_dims = batch.bodies.n_dims
            for scene, names in zip(batch.scenes, batch.bodies.receiver_names, strict=True):
                at = scenes.setdefault(scene.name, len(scenes))
                for name in names:
                    of_body += [bodies.setdefault(name, len(bodies))] * n_dims
                    of_scene += [at] * n_dims
                    axis += range(n_dims)
        positions = [b.positions[:, :, b.bodies.receivers] for b in batches]
        shapes = [p.shape for p in positions]
        times = [
            np.broadcast_to(b.times[:, :, None, None], shape)
            for b, shape in zip(batches, shapes, strict=True)
        ]
        quoted = None
        if any(b.sigma is not None for b in batches):
            blank = [np.full(shape, np.nan) for shape in shapes]
            quoted = join(
                x if b.sigma is None else b.sigma[:, :, b.bodies.receivers]
                for b, x in zip(batches, blank, strict=True)
            )
        return cls(
            times=join(times),
            seen=np.isfinite(join(positions)),
            axis=np.array(axis, dtype=int),
            body=np.array(of_body, dtype=int),
            scene=np.array(of_scene, dtype=int),
            chain=np.array(of_scene, dtype=int),
            body_names=tuple(bodies),
            scene_names=tuple(scenes),
            quoted=quoted,
            speed=None if speeds is None else np.abs(join(speeds)),
        )

    @cached_property
    def gaps(self):
        """Intervals to the row before, s, shape (T, C); inf where a channel begins."""
        return gaps_of(self.times)

    def at_rows(self, rows):
        """The same at some rows of every channel, ndarray of int."""
        own = {n: getattr(self, n) for n in _BY_ROW}
        return replace(self, **{n: None if v is None else v[rows] for n, v in own.items()})

    def only(self, kept):
        """Some of the channels; `kept` is an array of bool, shape (C,)."""
        rows = {n: getattr(self, n) for n in _BY_ROW}
        own = {n: getattr(self, n)[kept] for n in ("axis", "body", "scene", "chain")}
        rows = {n: None if v is None else v[:, kept] for n, v in rows.items()}
        return replace(self, **rows, **own)


def join(arrays):
    """Arrays (..., T, S, R, d) of batches as one (..., T, C), shorter ones filled up with nan."""
    flat = [np.reshape(a, (*np.shape(a)[:-3], int(np.prod(np.shape(a)[-3:])))) for a in arrays]
    n_rows = max(a.shape[-2] for a in flat)
    filled = []
    for a in flat:
        whole = np.full((*a.shape[:-2], n_rows, a.shape[-1]), np.nan)
        whole[..., : a.shape[-2], :] = a
        filled.append(whole)
    return np.concatenate(filled, axis=-1)


def unexplained(fit, name):
    """Chi-squared of a scene and its degrees of freedom.

    Tails of the noise, if it has any, are no reason why a whole track should lie far off.
    """
    channels = fit.channels
    mine = channels.scene == channels.scene_names.index(name)
    chains = len(np.unique(channels.chain[mine]))
    dof = channels.seen[:, mine].sum() - chains * len(fit.local_columns)
    left = fit.whitened
    if np.isfinite(fit.noise.degrees) and not fit.noise.adding:
        left = np.nan_to_num(fit.residual / np.array(fit.noise.levels)[channels.axis])
    return float(np.square(left[:, mine]).sum()), max(int(dof), 1)
