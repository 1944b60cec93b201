"""What a measurement may have done to places and times, every kind scored as columns on rows."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy import stats

from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.fitting.parts.instrument import LARGE, Instrument
from bsp_gp.fitting.tangent import instrument_columns
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.view import gains
from bsp_gp.threads import one_thread

FRAMES = 3.0
"""Delays and exposures that are believed, in median time steps."""
FAR = 0.1
"""Offsets that are believed, in half the width of the picture."""
ODD = ("decentred", "zoom")
"""What fewer cameras do: what grows with time in a picture is a force as a rule."""
MOST_BODIES, MOST_SCENES = 6, 20
"""Bodies and scenes up to which each is asked for a delay and a drift of its own."""


class Measurement:
    """Errors of the measurement as a proposer."""

    name = "measurement"
    asks_rows = True

    def propose(self, view):
        """The family of all kinds that make sense for the data."""
        known = set(view.fit.law.constants)
        kinds = kinds_of(view.dataset, view.fit)
        told = [pair for p in kinds if known.isdisjoint(p.names) for pair in _columns(view.fit, p)]
        alike, tried = [_alike(part) for part, _ in told], []
        for part, columns in told:
            score = view.tangent.score(columns)
            n_causes = 2 if part.code in ODD else 1
            log_prior = -n_causes * view.criteria.cause_nats - math.log(alike.count(_alike(part)))
            proposal = _proposal(view, part, score, log_prior)
            if proposal is not None:
                by_chance = gains(view.tangent.projected(columns), view.row_draws)
                tried.append((proposal, score, by_chance))
        if not tried:
            return Family(self.name)
        best = min((score for _, score, _ in tried), key=lambda s: (s.p_value, -s.statistic))
        chances = np.min([stats.chi2.sf(gain, score.rank) for _, score, gain in tried], axis=0)
        null = stats.chi2.isf(chances, best.rank)
        proposals = sorted((p for p, _, _ in tried), key=lambda p: -p.promise)
        return Family(
            self.name, tuple(proposals), best.statistic, best.rank, null, n_tried=len(tried)
        )  # fmt: skip


def _alike(part):
    """What an error is one of several of: those of one body or scene are."""
    return part.code, min(len(part.whose), 2)


def _columns(fit, part):
    """A part and what it changes of tracks; of scenes that differ the same of each one alone."""
    with one_thread(), np.errstate(all="ignore"):
        columns = instrument_columns(fit, part.in_small)
    yield part, columns
    if len(part.whose) > 1:
        for name, own in zip(part.whose, np.split(columns, len(part.whose)), strict=True):
            yield replace(part, whose=(name,)), own


def _proposal(view, part, score, log_prior):
    """A part with its numbers as the score has them; None if it gains nothing that is believed.

    Data that leave all numbers more open than what is believed do not see the part.
    """
    known = score.errors < part.limit
    start = np.where(np.isfinite(score.errors), score.amplitudes, 0.0)
    values = np.clip(start, part.lowest, part.limit)
    lost = float(np.square((start - values)[known] / score.errors[known]).sum())
    gain = score.statistic - lost - 2.0 * (score.rank - 1)  # more numbers take more of noise
    if not known.any() or not gain > 0:
        return None
    hypothesis = view.hypothesis + part.with_small(values)
    return Proposal(
        part.code, part.describe(), hypothesis, log_prior, gain, score.rank, kind="measurement"
    )


def kinds_of(dataset, fit):
    """The kinds of errors that make sense for scenes, at zero; a fit says which axes move."""
    scenes = dataset.scenes
    axes = tuple(np.flatnonzero(np.isfinite(fit.noise.levels)).tolist())
    places = np.concatenate([s.positions.reshape(-1, s.n_dims) for s in scenes])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    size = float(np.max(high - low)) / 2 or 1.0
    picture = {"middle": tuple(((low + high) / 2).tolist()), "size": size}
    step = float(np.median(np.concatenate([np.diff(s.times) for s in scenes])))
    span = max(float(np.ptp(s.times)) for s in scenes)
    drift = Instrument(
        "drift", axes, size / span, epoch=min(float(s.times[0]) for s in scenes)
    )
    scale, clock = Instrument("scale"), Instrument("clock")
    out = [scale, clock, drift]
    out.append(Instrument("exposure", (), (FRAMES * step) ** 2))
    if not is_of_the_sky(dataset) and not dataset.units.is_angle:
        zoom = {"limit": LARGE / span, "epoch": drift.epoch, **picture}
        out += [Instrument("zoom", own, **zoom) for own in ((), axes)]
    if dataset.is_film:  # the picture is read within a frame
        out += [Instrument("shutter", (k,), step / size, **picture) for k in axes]
    if len(axes) > 1:
        # A camera is turned against what was declared; what was found since turns with it.
        named = {n for t in fit.law.terms if t.is_declared for n in t.formula.inputs}
        if named & {"up", "down"}:
            named.add(f"e_{dataset.up[-1]}")
        for plane in combinations(axes, 2):
            if named & {f"e_{'xyz'[k]}" for k in plane}:
                out.append(Instrument("tilt", plane))
        if len(axes) < 3 or not is_of_the_sky(dataset):  # no camera saw an ephemeris in space
            for k in axes:
                out += [Instrument(code, (k,), **picture) for code in ("slant", "perspective")]
            out += [Instrument(code, axes, **picture) for code in ("lens", "decentred")]
    # Of what turns all round, out of balance does nearly the same.
    if dataset.units.is_angle and len(axes) == 1 and 2 * size < math.pi:
        out += [Instrument(code, axes) for code in ("zero", "pivot")]
    if any(e.is_static for s in scenes for e in s.entities):
        out.append(Instrument("offset", axes, FAR * size))
    if 1 < len(scenes) <= MOST_SCENES:
        names = tuple(s.name for s in scenes)
        out += [replace(part, whose=names) for part in (scale, clock, drift)]
    names = dict.fromkeys(s.names[k] for s in scenes for k in s.dynamic)
    if max(len(s.entities) for s in scenes) > 1 and len(names) <= MOST_BODIES:
        out += [Instrument("delay", (), FRAMES * step, whose=(name,)) for name in names]
    return out
