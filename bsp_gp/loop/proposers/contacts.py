"""Undeclared contacts: jumps of velocity, at every instant, of every body."""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.fitting.parts.contacts import Kick, kicks_text
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.physics.force import fresh_name, numbered

N_STARTS, MOST_KICKS = 2, 6
"""Single kicks that are proposed, and kicks at once."""
LEAST_ROWS = 4
"""Of a body before a kick and behind it: of fewer, a kick says no more than that they are off."""
APART = 3
"""Instants within which two kicks of a body are one."""
NEAR, CLOSE = 0.05, 0.5
"""Part of the range of the distances of two bodies within which they are as near as ever, and of
the usual distance up to which they meet then."""
DETERMINED = 1e-6
"""Part of a kick, squared, that must lie beyond all that is free."""
BESIDE = 0.25
"""Intervals before an instant at which a fit begins: at a row itself slopes jump."""
BRIEF = 1e-2
"""Duration of a kick, in the shortest interval between rows."""


class Contacts:
    """Kicks as a proposer."""

    name = "contacts"

    def propose(self, view):
        """The family of all instants and bodies."""
        if view.fit.paper_steps:
            return Family(self.name)
        scans, first, spans = [], 0, _spans(view.dataset)
        for batch in view.response.regression.batches:
            scans.append(_Scan(view, batch, first))
            first += batch.kept.size
        null = np.max([scan.null for scan in scans], axis=0)
        peaks = [peak for scan in scans for peak in scan.peaks(spans)]
        peaks = sorted(peaks, key=lambda peak: -peak.gain)[:N_STARTS]
        single = [_proposal(view, spans, (peak,), peak.gain) for peak in peaks]
        return Family(
            self.name, (*_met(view, scans, peaks, spans), *single, *_several(view, scans, spans)),
            max((peak.gain for peak in peaks), default=0.0), view.dataset.n_dims, null,
            n_tried=sum(scan.gains.size for scan in scans), is_continuum=True,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Peak:
    """A kick that explains more than others near it; `columns` (n, d) are by 1 m/s on an axis."""

    gain: float
    scene: str
    body: str
    time: float
    velocity: np.ndarray
    columns: np.ndarray


def _met(view, scans, peaks, spans):
    """Kicks that two bodies give each other while they are as near as ever, one collision each."""
    scenes, out = {scene.name: scene for scene in view.dataset.scenes}, {}
    for peak in peaks:
        meetings = _meetings(scenes[peak.scene], peak)

        def is_open(scene, body, times, peak=peak, meetings=meetings):
            first, last = meetings.get(body, (np.inf, -np.inf))
            return (scene == peak.scene) & (times >= first) & (times <= last)

        rest = _weighed(view, (peak,))[1]
        found = [
            other for scan in scans if meetings
            for other in scan.of_target(rest).peaks(spans, (), 1, is_open)
        ]  # fmt: skip
        if not found:
            continue
        both = peak, max(found, key=lambda each: each.gain)
        pair = peak.scene, meetings[both[1].body], frozenset(each.body for each in both)
        if pair in out:  # the other's kick, of the same collision
            continue
        amounts, rest = _weighed(view, both)
        gain = float(view.left @ view.left - rest @ rest)
        if 0.5 * (gain - peak.gain) > view.criteria.cause_nats:
            both = [
                replace(each, velocity=velocity)
                for each, velocity in zip(both, amounts.reshape(2, -1), strict=True)
            ]
            # One event: that the other is kicked, too, is what a collision is.
            log_prior = -(view.criteria.cause_nats + view.odd_nats)
            found = _proposal(view, spans, both, gain)
            out[pair] = replace(found, code="collision", log_prior=log_prior)
    return list(out.values())


def _meetings(scene, peak):
    """From when to when others are as near to a body as ever, while it is kicked, by body."""
    out, own = {}, scene.names.index(peak.body)
    for k in scene.dynamic:
        apart = np.linalg.norm(scene.positions[:, k] - scene.positions[:, own], axis=1)
        seen = np.flatnonzero(np.isfinite(apart))
        if k == own or not len(seen):
            continue
        times, apart = scene.times[seen], apart[seen]
        if apart.min() > CLOSE * np.median(apart):
            continue
        is_near = apart <= apart.min() + NEAR * np.ptp(apart)
        at = int(np.argmin(np.abs(times - peak.time)))
        if is_near[at]:
            far = np.flatnonzero(~is_near)
            first = times[max(far[far < at], default=-1) + 1]
            last = times[min(far[far > at], default=len(times)) - 1]
            out[scene.names[k]] = float(first), float(last)
    return out


def _several(view, scans, spans):
    """Several kicks at once, one after the other where most is left: what one alone hides.

    Bodies that are kicked now and then would else pass for bodies that are kicked all the time.
    Every one has to be chosen among all instants, and pays for that: a few of thousands imitate
    what is smooth. None where one alone promises as much.
    """
    single = view.criteria.cause_nats + view.odd_nats
    cost = single + float(np.log(sum(scan.gains.size for scan in scans)))
    chosen, gains = [], []
    while len(chosen) < MOST_KICKS:
        more = _next(view, scans, spans, chosen)
        if more is None:
            break
        found = [*chosen, more]
        for k in range(len(chosen)):  # beside one that was not known then it may lie elsewhere
            others = [*found[:k], *found[k + 1 :]]
            found[k] = _next(view, scans, spans, others) or found[k]
        amounts, rest = _weighed(view, found)
        gain = float(view.left @ view.left - rest @ rest)
        if gains and gain - gains[-1] < 2 * single:
            break
        chosen, velocities = found, amounts.reshape(len(found), -1)
        gains.append(gain)
    if len(chosen) < 2 or 0.5 * gains[-1] - cost * len(chosen) <= 0.5 * gains[0] - single:
        return []
    peaks = tuple(replace(p, velocity=v) for p, v in zip(chosen, velocities, strict=True))
    return [replace(_proposal(view, spans, peaks, gains[-1]), log_prior=-cost * len(peaks))]


def _next(view, scans, spans, chosen):
    """The kick that explains most of what others leave; None where there is none."""
    rest = _weighed(view, chosen)[1]
    taken = [(peak.scene, peak.body, peak.time) for peak in chosen]
    peaks = [peak for scan in scans for peak in scan.of_target(rest).peaks(spans, taken, 1)]
    return max(peaks, key=lambda peak: peak.gain, default=None)


def _weighed(view, peaks):
    """Velocities of kicks that explain most together, and the moments that these leave."""
    if not peaks:
        return np.zeros(0), view.left
    columns = view.beside(np.concatenate([peak.columns for peak in peaks], axis=1))
    amounts = np.linalg.lstsq(columns, view.left, rcond=1e-10)[0]
    return amounts, view.left - columns @ amounts


class _Scan:
    """Kicks at all instants of a batch: a brief acceleration, in moments; gains are (S, n, R)."""

    def __init__(self, view, batch, first):
        self.batch, self.total = batch, len(view.left)
        m, s = batch.kept.shape[:2]
        self.rows = slice(first, first + m * s)
        self.own = own = np.moveaxis(batch.whitener, 1, -1)  # (S, n, R, d, m)
        free = own @ self._mine(view.taken)[:, None, None]  # (S, n, R, d, k)
        gram = own @ np.swapaxes(own, -1, -2) - free @ np.swapaxes(free, -1, -2)
        values, self._vectors = np.linalg.eigh(gram)
        size = np.square(own).sum(axis=(-1, -2))[..., None]
        used = values > np.maximum(DETERMINED * size, 1e-12 * size.max(initial=0.0))
        self._inverse = np.where(used, 1 / np.where(used, values, 1.0), 0.0)
        self.step = np.gradient(np.nan_to_num(batch.times), axis=0).T
        targets = np.concatenate([view.left[:, None], view.draws_left], axis=1)
        gains, self.velocities = self._explained(targets)
        self.gains, self.null = gains[..., 0], gains[..., 1:].max(axis=(0, 1, 2))

    def of_target(self, target):
        """The same for other moments (n,), beside what constants take up."""
        other = copy(self)
        gains, other.velocities = self._explained(target[:, None])
        other.gains = gains[..., 0]
        return other

    def _mine(self, values):
        """Moments (N, ...) of this batch, (S, m, ...)."""
        m, s = self.batch.kept.shape[:2]
        return np.swapaxes(values[self.rows].reshape(m, s, *values.shape[1:]), 0, 1)

    def _explained(self, targets):
        """What a kick explains of targets (n, B), (S, n, R, B), and its velocity for the first."""
        along = self.own @ self._mine(targets)[:, None, None]  # (S, n, R, d, B)
        turned = np.swapaxes(self._vectors, -1, -2) @ along
        gains = (self._inverse[..., None] * np.square(turned)).sum(axis=-2)
        found = (self._vectors @ (self._inverse[..., None] * turned[..., :1]))[..., 0]
        return gains, found * self.step[..., None, None]

    def _columns(self, s, k, r):
        """Moments by velocities of one that a body gains at an instant, (N, d)."""
        out = np.zeros((self.total, self.own.shape[3]))
        m, n_pieces = self.batch.kept.shape[:2]
        mine = np.zeros((m, n_pieces, self.own.shape[3]))
        mine[:, s] = self.own[s, k, r].T / (self.step[s, k] or 1.0)
        out[self.rows] = mine.reshape(-1, mine.shape[2])
        return out

    def peaks(self, spans, taken=(), count=N_STARTS, is_open=None):
        """The best kicks that are apart, within spans, and none of those that are taken.

        Of those that ``is_open(scene, body, times)`` lets through, where it is given.
        """
        left, batch = self.gains.copy(), self.batch
        for s, (scene, bodies) in enumerate(
            zip(batch.scene_names, batch.bodies.receiver_names, strict=True)
        ):
            for r, body in enumerate(bodies):
                first, last = spans[scene, body]
                is_inside = (batch.times[:, s] >= first) & (batch.times[:, s] <= last)
                if is_open is not None:
                    is_inside &= is_open(scene, body, batch.times[:, s])
                left[s, ~is_inside, r] = 0.0
                for at in (time for where, own, time in taken if (where, own) == (scene, body)):
                    k = int(np.argmin(np.abs(np.nan_to_num(batch.times[:, s], nan=np.inf) - at)))
                    left[s, max(k - APART, 0) : k + APART + 1, r] = 0.0
        for _ in range(count):
            s, k, r = np.unravel_index(np.argmax(left), left.shape)
            if left[s, k, r] <= 0:
                return
            scene, body = batch.scene_names[s], batch.bodies.receiver_names[s][r]
            yield _Peak(
                float(left[s, k, r]), scene, body, float(batch.times[k, s]),
                self.velocities[s, k, r], self._columns(s, k, r),
            )  # fmt: skip
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


def _proposal(view, spans, peaks, gain):
    """Kicks as a cause that may be missing."""
    law, hypothesis, starts = view.fit.law, view.hypothesis, {}
    taken = {n for s in view.dataset.scenes for e in s.entities for n in e.properties}
    moving = np.flatnonzero(np.isfinite(view.fit.noise.levels))  # nothing is gained along others
    for peak in peaks:
        gains = {axis: fresh_name(law, f"w_{axis}") for axis in ("xyz"[k] for k in moving)}
        instant = fresh_name(law, "t")
        scene = next(s for s in view.dataset.scenes if s.name == peak.scene)
        interval, (low, high) = float(np.diff(scene.times).min()), spans[peak.scene, peak.body]
        time = float(np.clip(peak.time - BESIDE * interval, low, high))
        velocity = map(float, peak.velocity[moving])
        own = {**dict(zip(gains.values(), velocity, strict=True)), instant: time}
        mark = numbered("kicked", taken)
        taken.add(mark)
        part = Kick.of(
            peak.scene, peak.body, mark, gains, instant, own, (low, high),
            BRIEF * interval,
        )  # fmt: skip
        hypothesis, starts = hypothesis + part, starts | own
        for term in part.law.terms:
            law = law.plus(term, own)
    text = kicks_text((p.body, p.scene, p.time) for p in peaks)
    return Proposal(
        "contact", text, hypothesis,
        -(view.criteria.cause_nats + view.odd_nats) * len(peaks), gain, len(starts), starts,
    )  # fmt: skip
