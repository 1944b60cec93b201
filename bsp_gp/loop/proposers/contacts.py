"""Undeclared contacts: jumps of velocity, at every instant, of every body."""

from __future__ import annotations

import numpy as np

from bsp_gp.fitting.parts.contacts import Kick
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.physics.force import fresh_name

__all__ = ["Contacts"]

N_STARTS = 2
LEAST_ROWS = 4
"""Of a body before a kick and behind it: of fewer, a kick says no more than that they are off."""
APART = 3
"""Instants within which two kicks of a body are one."""
DETERMINED = 1e-6
"""Part of a kick, squared, that must lie beyond all that is free."""
BRIEF = 1e-2
"""Duration of a kick, in the shortest interval between rows."""


class Contacts:
    """Kicks as a proposer."""

    name = "contacts"

    def propose(self, view):
        """The family of all instants and bodies.

        Parameters
        ----------
        view : View
        """
        if view.fit.paper_steps:
            return Family(self.name)
        scans, first, spans = [], 0, _spans(view.dataset)
        for batch in view.response.regression.batches:
            scans.append(_Scan(view, batch, first))
            first += batch.kept.size
        null = np.max([scan.null for scan in scans], axis=0)
        peaks = [peak for scan in scans for peak in scan.peaks(spans)]
        peaks = sorted(peaks, key=lambda peak: -peak[0])[:N_STARTS]
        return Family(
            self.name, tuple(_proposal(view, spans, *peak) for peak in peaks),
            max((peak[0] for peak in peaks), default=0.0), view.dataset.n_dims, null,
            n_tried=sum(scan.gains.size for scan in scans), is_continuum=True,
        )  # fmt: skip


class _Scan:
    """Kicks at all instants of a batch: a brief acceleration, in moments.

    Attributes
    ----------
    gains : ndarray, shape (S, n, R)
    velocities : ndarray, shape (S, n, R, d), m/s
    null : ndarray, shape (B,)
    """

    def __init__(self, view, batch, first):
        self.batch = batch
        m, s = batch.kept.shape[:2]
        rows = slice(first, first + m * s)
        own = np.moveaxis(batch.whitener, 1, -1)  # (S, n, R, d, m)

        def mine(values):
            """Moments (N, ...) of this batch, (S, m, ...)."""
            return np.swapaxes(values[rows].reshape(m, s, *values.shape[1:]), 0, 1)

        free = own @ mine(view.taken)[:, None, None]  # (S, n, R, d, k)
        gram = own @ np.swapaxes(own, -1, -2) - free @ np.swapaxes(free, -1, -2)
        targets = np.concatenate([view.left[:, None], view.draws_left], axis=1)
        along = own @ mine(targets)[:, None, None]  # (S, n, R, d, 1 + B)
        values, vectors = np.linalg.eigh(gram)
        size = np.square(own).sum(axis=(-1, -2))[..., None]
        used = values > np.maximum(DETERMINED * size, 1e-12 * size.max(initial=0.0))
        inverse = np.where(used, 1 / np.where(used, values, 1.0), 0.0)
        turned = np.swapaxes(vectors, -1, -2) @ along
        gains = (inverse[..., None] * np.square(turned)).sum(axis=-2)
        self.gains, self.null = gains[..., 0], gains[..., 1:].max(axis=(0, 1, 2))
        found = (vectors @ (inverse[..., None] * turned))[..., 0]
        step = np.gradient(np.nan_to_num(batch.times), axis=0).T
        self.velocities = found * step[..., None, None]

    def peaks(self, spans):
        """The best kicks that are apart, within spans: gain, scene, body, instant, velocity."""
        left, batch = self.gains.copy(), self.batch
        for s, (scene, bodies) in enumerate(
            zip(batch.scene_names, batch.bodies.receiver_names, strict=True)
        ):
            for r, body in enumerate(bodies):
                first, last = spans[scene, body]
                is_inside = (batch.times[:, s] >= first) & (batch.times[:, s] <= last)
                left[s, ~is_inside, r] = 0.0
        for _ in range(N_STARTS):
            s, k, r = np.unravel_index(np.argmax(left), left.shape)
            if left[s, k, r] <= 0:
                return
            scene, body = batch.scene_names[s], batch.bodies.receiver_names[s][r]
            yield (float(left[s, k, r]), scene, body, float(batch.times[k, s]),
                   self.velocities[s, k, r])  # fmt: skip
            left[s, max(k - APART, 0) : k + APART + 1, r] = 0.0


def _spans(dataset):
    """First and last time at which enough rows of a body lie on both sides, by scene and body."""
    found = {}
    for scene in dataset.scenes:
        for k in scene.dynamic:
            times = scene.times[np.isfinite(scene.positions[:, k]).all(axis=1)]
            few = len(times) < 2 * LEAST_ROWS
            ends = (np.inf, -np.inf) if few else times[[LEAST_ROWS - 1, -LEAST_ROWS]]
            found[scene.name, scene.names[k]] = tuple(map(float, ends))
    return found


def _proposal(view, spans, gain, name, body, time, velocity):
    """A kick as a cause that may be missing."""
    law, n_dims = view.fit.law, len(velocity)
    scene = next(s for s in view.dataset.scenes if s.name == name)
    gains = tuple(fresh_name(law, f"w_{axis}") for axis in "xyz"[:n_dims])
    instant = fresh_name(law, "t")
    starts = {**dict(zip(gains, map(float, velocity), strict=True)), instant: time}
    taken = {n for s in view.dataset.scenes for e in s.entities for n in e.properties}
    number = next(k for k in range(1, len(taken) + 2) if f"kicked{k}" not in taken)
    part = Kick.of(
        name, body, f"kicked{number}", gains, instant, starts,
        spans[name, body], BRIEF * float(np.diff(scene.times).min()),
    )  # fmt: skip
    return Proposal(
        "contact", f"kick {body}[{name}, {time:.4g} s]", view.hypothesis + part,
        -view.criteria.cause_nats - view.odd_nats, gain, n_dims + 1, starts,
    )  # fmt: skip
