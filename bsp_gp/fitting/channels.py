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
    def of(cls, groups):
        """The channels of groups of chains, one after the other, without speeds."""
        bodies, scenes, axis, body, scene, chain = {}, {}, [], [], [], []
        count = 0
        for chains in groups:
            for name, members in zip(chains.scenes, chains.bodies, strict=True):
                at = scenes.setdefault(name, len(scenes))
                for member in members:
                    body += [bodies.setdefault(member, len(bodies))] * chains.n_dims
                    scene += [at] * chains.n_dims
                    axis += range(chains.n_dims)
                    chain += [count] * chains.n_dims
                count += 1
        quoted = None
        if any(chains.sigma is not None for chains in groups):
            quoted = join(
                np.full(c.observed.shape, np.nan) if c.sigma is None else c.sigma for c in groups
            )
        times = [np.broadcast_to(c.times[:, :, None, None], c.observed.shape) for c in groups]
        return cls(
            times=join(times), seen=np.isfinite(join(c.observed for c in groups)),
            axis=np.array(axis), body=np.array(body), scene=np.array(scene), chain=np.array(chain),
            body_names=tuple(bodies), scene_names=tuple(scenes), quoted=quoted,
        )  # fmt: skip

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


def split(rows, groups):
    """Rows (T, C) of all channels as every group of chains has them (T, S, R, d): undoes `join`."""
    first = 0
    for chains in groups:
        shape = chains.observed.shape
        count = int(np.prod(shape[1:]))
        yield rows[: shape[0], first : first + count].reshape(shape)
        first += count


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
