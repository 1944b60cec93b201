"""Logs that are late: measured inputs of the law looked up at other times."""

from dataclasses import replace

import numpy as np

from bsp_gp.fitting.parts.late import Late
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.physics.force import ForceLaw, split_linear, term_gradient
from bsp_gp.physics.regression import checked
from bsp_gp.search.columns import orthonormal

BELIEVED = 0.25
"""Delays that are believed, in the length of the shortest recording."""
MOST_DELAYS = 160
"""That are tried on either side, half a row apart where that is enough."""
CLOSER, ZOOMS = 4, 3
"""Delays between two of them that are tried about the best, and how often."""


class LateLogs:
    """Delays of measured inputs that the law names, each alone and all together, as a proposer."""

    name = "late"

    def propose(self, view):
        """The family of all inputs, each with all delays."""
        law = view.fit.law
        named = {n for term in law.terms for n in term.formula.inputs}
        late = {n for part in law.frame if part.kind == "log" for n in part.inputs}
        inputs = sorted(named & set(_series(view).names) - late)
        sets = [(name,) for name in inputs] + [tuple(inputs)] * (len(inputs) > 1)
        span = min(float(np.ptp(scene.times)) for scene in view.dataset.scenes)
        limit, null = BELIEVED * span, np.zeros(view.moment_draws.shape[1])
        proposals, n_tried = [], 0
        for each in sets:
            scan = _Scan(view, each)
            delays = _delays(view, limit)
            gains = np.stack([scan.gains(delay) for delay in delays])  # (D, 1 + B)
            null, n_tried = np.maximum(null, gains[:, 1:].max(axis=0)), n_tried + len(delays)
            k = int(np.argmax(gains[:, 0]))
            delay, gain = scan.closer(delays[k], gains[k, 0], delays[1] - delays[0], limit)
            if gain > 0:
                proposals.append(_proposal(view, scan, each, delay, gain, limit))
        proposals.sort(key=lambda p: -p.promise)
        best = proposals[0].gain if proposals else 0.0
        rank = 1 if proposals else 0
        return Family(
            self.name, tuple(proposals), best, rank, null, n_tried=n_tried, is_continuum=True
        )


class _Scan:
    """What is explained with some inputs of the law at other times, its constants fitted anew."""

    def __init__(self, view, inputs):
        self.view, self.inputs = view, inputs
        law = view.fit.law
        self.terms = [t for t in law.terms if not t.formula.inputs.isdisjoint(inputs)]
        self.law = law
        target, self.columns = view.response.left()
        self.targets = np.column_stack([target, view.moment_draws])
        self.base = np.square(view.beside(self.targets)).sum(axis=0)
        self.place = {pair[0]: k for k, pair in enumerate(view.fit.parameters) if not pair[1]}
        self.now = self._shown(0.0)

    def gains(self, delay):
        """Chi-squared gained on the data and on noise, (1 + B,)."""
        left, columns = self._left(delay)
        q = orthonormal(columns, len(left))
        return self.base - np.square(left - q @ (q.T @ left)).sum(axis=0)

    def closer(self, delay, gain, step, limit):
        """The best delay near one that was tried, and what it gains."""
        for zoom in range(ZOOMS):
            near = delay + step / CLOSER**zoom * np.linspace(-1, 1, 2 * CLOSER + 1)
            near = np.clip(near, -limit, limit)
            found = [self.gains(each)[0] for each in near]
            k = int(np.argmax(found))
            if found[k] > gain:
                delay, gain = near[k], found[k]
        return float(delay), float(gain)

    def constants(self, delay):
        """Where strengths of the terms begin with the inputs at other times."""
        left, columns = self._left(delay)
        changes = np.linalg.lstsq(columns, left[:, 0], rcond=None)[0]
        names = {split_linear(term.formula)[0] for term in self.terms} & set(self.place)
        return {
            name: float(self.view.fit.values[self.place[name]] + changes[self.place[name]])
            for name in sorted(names)
        }

    def _left(self, delay):
        """What is left of targets (n, 1 + B), and the columns of all constants (n, k)."""
        value, slopes = self._shown(delay)
        columns = self.columns.copy()
        for name, slope in slopes.items():
            if name in self.place:
                columns[:, self.place[name]] += slope - self.now[1][name]
        return self.targets - (value - self.now[0])[:, None], columns

    def _shown(self, delay):
        """Moments of the terms, and of their changes by constants, by name."""
        parts = []
        for batch in self.view.response.regression.batches:
            series = batch.bodies.series
            delays = {**series.delays, **dict.fromkeys(self.inputs, delay)}
            bodies = replace(batch.bodies, series=replace(series, delays=delays))
            value, slopes = 0.0, {}
            for term in self.terms:
                law = ForceLaw(
                    (term,), {n: self.law.constants[n] for n in term.formula.constants}
                )
                own, by_constant = term_gradient(
                    law, term, bodies, batch.positions, batch.velocities, batch.times
                )
                value = value + own
                for name, slope in by_constant.items():
                    slopes[name] = slopes.get(name, 0.0) + slope
            values = np.stack([checked(v, batch) for v in (value, *slopes.values())], axis=-2)
            moments = batch.whiten(values)[:, :, 0, :, 0]
            parts.append(moments.reshape(-1, moments.shape[-1]))
        first, *rest = np.concatenate(parts).T
        return first, dict(zip(slopes, rest, strict=True))


def _series(view):
    return view.response.regression.batches[0].bodies.series


def _delays(view, limit):
    """Delays on both sides of none, as close as half a row where that is enough."""
    count = int(np.clip(limit / (view.step / 2), 2, MOST_DELAYS))
    return np.linspace(-limit, limit, 2 * count + 1)


def _proposal(view, scan, inputs, delay, gain, limit):
    part = Late(inputs, limit, delay)
    return Proposal(
        "late_log", part.describe(), view.hypothesis + part, -view.criteria.cause_nats, gain,
        starts={**scan.constants(delay), part.names[0]: delay}, kind="measurement",
    )  # fmt: skip
