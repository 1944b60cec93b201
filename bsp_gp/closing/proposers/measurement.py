"""What a measurement may have done to places and times: every kind scored as columns on the rows."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy import stats
from threadpoolctl import threadpool_limits

from bsp_gp.closing.proposal import Family, Near, Proposal
from bsp_gp.closing.view import gains
from bsp_gp.fitting.parts.instrument import (
    LARGE,
    Clock,
    Delay,
    Drift,
    Exposure,
    Lens,
    Offset,
    Perspective,
    Scale,
    Slant,
    Tilt,
)
from bsp_gp.fitting.tangent import instrument_columns

__all__ = ["Measurement", "kinds_of"]

LOG_PRIOR = -3.0
"""Of a kind of error: as likely beforehand as the simplest laws of a grammar."""
FRAMES = 3.0
"""Delays and exposures that are believed, in median time steps."""
FAR = 0.1
"""Offsets that are believed, in half the width of the picture."""
MOST_BODIES = 6
"""Bodies up to which each is asked for a delay of its own."""


class Measurement:
    """Errors of the measurement as a proposer."""

    name = "measurement"

    def propose(self, view):
        """The family of all kinds that make sense for the data.

        Parameters
        ----------
        view : View
        """
        known = set(view.fit.law.constants)
        parts = [p for p in kinds_of(view.dataset, view.fit) if known.isdisjoint(p.names)]
        if not parts:
            return Family(self.name)
        with threadpool_limits(1, "blas"), np.errstate(all="ignore"):
            columns = instrument_columns(view.fit, parts)
        variants = {p.code: sum(o.code == p.code for o in parts) for p in parts}
        proposals, tried, first = [], [], 0
        for part in parts:
            own = columns[first : first + len(part.names)]
            first += len(own)
            score = view.tangent.score(own)
            if not score.rank or not _is_seen(part, score):
                continue
            tried.append((score, gains(view.tangent.projected(own), view.row_draws)))
            log_prior = LOG_PRIOR - math.log(variants[part.code])
            proposals.append(_proposal(view, part, score, log_prior))
        if not tried:
            return Family(self.name)
        best = min((score for score, _ in tried), key=lambda s: (s.p_value, -s.statistic))
        null = np.max([_as_of_rank(g, s.rank, best.rank) for s, g in tried], axis=0)
        proposals.sort(key=lambda p: -p.promise)
        return Family(
            self.name, tuple(proposals), best.statistic, best.rank, null,
            tuple(Near(p.code, p.text, p.gain, p.log_prior) for p in proposals if p.rank == 1),
            n_tried=len(tried),
        )  # fmt: skip


def _is_seen(part, score):
    """Whether the data can tell any number of a part from zero within what is believed."""
    return bool(np.any(score.errors < part.limit))


def _proposal(view, part, score, log_prior):
    start = np.where(np.isfinite(score.errors), score.amplitudes, 0.0)
    part = replace(part, values=tuple(np.clip(start, part.lowest, part.limit).tolist()))
    return Proposal(
        part.code, part.describe(), view.hypothesis + part, log_prior, score.statistic, score.rank
    )


def _as_of_rank(gain, rank, other):
    """Gains of chi-squared that are as unlikely in another number of directions."""
    return gain if rank == other else stats.chi2.isf(stats.chi2.sf(gain, rank), other)


def kinds_of(dataset, fit):
    """The kinds of errors that make sense for scenes, at zero.

    Parameters
    ----------
    dataset : Dataset
    fit : Fit
        Whose noise says along which axes bodies move.

    Returns
    -------
    list of Instrument
    """
    scenes = dataset.scenes
    axes = tuple(np.flatnonzero(np.isfinite(fit.noise.levels)).tolist())
    places = np.concatenate([s.positions.reshape(-1, s.n_dims) for s in scenes])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    size = float(np.max(high - low)) / 2 or 1.0
    picture = {"middle": tuple(((low + high) / 2).tolist()), "size": size}
    span = max(float(np.ptp(s.times)) for s in scenes)
    step = float(np.median(np.concatenate([np.diff(s.times) for s in scenes])))
    epoch = min(float(s.times[0]) for s in scenes)
    slow = LARGE * size / span
    out = [Scale(), Clock()]
    if len(axes) > 1:
        out += [Tilt(plane) for plane in combinations(axes, 2)]
        out += [kind((k,), **picture) for k in axes for kind in (Slant, Perspective)]
        out += [Lens(axes, **picture)]
    if any(e.is_static for s in scenes for e in s.entities):
        out.append(Offset(axes, FAR * size))
    out.append(Drift(axes, slow, epoch=epoch))
    if len(scenes) > 1:
        out.append(Drift(axes, slow, epoch=epoch, scenes=tuple(s.name for s in scenes)))
    names = dict.fromkeys(s.names[k] for s in scenes for k in s.dynamic)
    if max(len(s.entities) for s in scenes) > 1 and len(names) <= MOST_BODIES:
        out += [Delay((), FRAMES * step, body=name) for name in names]
    return [*out, Exposure((), (FRAMES * step) ** 2)]
