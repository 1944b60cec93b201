"""How the size of a residual scales: exponents of power laws in a channel, with intervals.

In a channel with unit vectors u the residual is taken for c x^p u, a force over the mass of the
receiver. The exponents are those of least squares in the smooth view, and their 90 % intervals
hold all values at which the sum of squares rises by less than 2.71 times the noise, everything
else refitted (profile likelihood). Every track has an amplitude of its own unless one amplitude
and powers of the declared properties explain all of them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from bsp_gp.loop.felt_noise import slopes_of, with_felt_noise
from bsp_gp.loop.quantities import MIN_RANGE, masses_of, quantities_of
from bsp_gp.loop.scaling import MOST, AboutPoint, Scaling, shifts_of
from bsp_gp.loop.shares import explain
from bsp_gp.loop.traced import Exponent, Profile
from bsp_gp.units import ACCELERATION

__all__ = ["exponents_of"]

DROP = 2.705543454095404
"""Quantile of chi-squared with one degree of freedom that leaves 10 %."""
MAX_HALF = 1.0
"""Half-width of an interval above which an exponent counts as not determined."""
SHIFT = 0.02
"""Step of the place of an unseen point, in typical distances from it."""
REJECTED = 0.01
"""p-value at which one amplitude for all, or a law as good as noise, is given up."""
MIN_SHARE = 0.9
"""Part of a channel that a power law must explain for its exponents to mean anything."""
MOST_HALF = 3.0
"""Half-width from the curvature alone at which the interval is not looked for."""
MAX_PROPERTIES = 4
ROUGH = "a rough guide: more than noise is left beside the power law"
FAR = "a rough guide: no track could be fitted with this power law"
UNBOUND = "its interval is too wide: it varies too little, or together with other quantities"
N_NODES = 5


def exponents_of(view, direction, dataset, companions=(), nearer=None):
    """Exponents of every quantity in one channel.

    Parameters
    ----------
    view : SmoothView
    direction : Direction
    dataset : Dataset
    companions : sequence of Direction
        Free smooth pushes in these are fitted as well.
    nearer : callable, optional
        ``nearer(direction, scaling, exponents) -> SmoothView or None``: the view along tracks that
        this power law leads.

    Returns
    -------
    list of Exponent
        The quantity that explains most first; it has a profile.
    """
    channel = _Channel(view, direction, dataset, companions)
    is_far = False
    if channel.motions and nearer is not None:
        closer = nearer(direction, channel.pooled, channel.together)
        is_far = closer is None and bool(direction.vector)
        if closer is not None:
            view, channel = closer, _Channel(closer, direction, dataset, companions)
    if channel.motions:
        # The force that was found is felt at states with noise in them, too.
        whole = _with_own_noise(view, direction, dataset, channel)
        if whole is not view:
            channel = _Channel(whole, direction, dataset, companions)
    rows = channel.told()
    if is_far and all(group.slopes is not None for group in view.groups):
        rows = [replace(e, reason=FAR) if e.is_determined and not e.reason else e for e in rows]
    return rows


class _Channel:
    """The power laws of one channel in one view."""

    def __init__(self, view, direction, dataset, companions):
        self.direction, self.dataset = direction, dataset
        self.view = view = _beside(view, companions)
        masses = masses_of(view)
        legs = [direction.legs(group) for group in view.groups]
        if masses is not None:
            legs = [leg / mass[..., None] for leg, mass in zip(legs, masses, strict=True)]
        self.has_masses = masses is not None
        self.known = quantities_of(view, direction, dataset)
        known = self.known
        self.motions = [q for q in known if not q.is_property and q.spread >= MIN_RANGE]
        inner = tuple(q for q in known if q.is_property and q.varies_in_track)[:MAX_PROPERTIES]
        outer = tuple(q for q in known if q.is_property and not q.varies_in_track)
        outer = outer[:MAX_PROPERTIES]
        make, self.shifts = partial(Scaling, view, legs), ()
        if direction.place is not None:
            place = np.asarray(direction.place)
            step = SHIFT * max(q.typical for q in known if q.name == "distance")
            make = partial(AboutPoint, view, legs, place=place, step=step)
            self.shifts = shifts_of(view, len(place))
        self.make = make
        if self.motions:
            self._fit(inner, outer)

    def _fit(self, inner, outer):
        view, make, shifts = self.view, self.make, self.shifts
        fits = {q.name: make((q, *inner, *shifts), False).fit() for q in self.motions}
        self.first = first = _first(view, self.direction, self.motions, fits)
        self.outer = _with_best_signs(make, (first, *inner), outer, shifts, fits[first.name])
        pooled = make((first, *inner, *self.outer, *shifts), True)
        self.best, self.scaling = pooled.fit(), pooled
        self.pooled, self.together = pooled, self.best[0]
        alone = make((first, *inner, *shifts), False)
        self.is_pooled = _is_one(view, pooled, self.best[1], alone, fits[first.name][1])
        if not self.is_pooled:
            self.best, self.scaling = fits[first.name], alone

    def told(self):
        """All exponents, the first quantity's first."""
        view, make = self.view, self.make
        told = partial(_told, self.direction, self.dataset, self.has_masses)
        out = [
            told(q, reason=_hardly(q))
            for q in self.known
            if not q.is_property and q not in self.motions
        ]
        if not self.motions:
            return out
        first, best, scaling = self.first, self.best, self.scaling
        columns = [self.direction.columns(group) for group in view.groups]
        explained = explain(view, columns)
        gain = max(float(explained.gain.sum() - explained.freedom.sum()), 1e-12)
        power = partial(_power, told, gain, view)
        rows = [power(scaling, best, 0, profile=_profile(scaling, best[0]))]
        for quantity in self.motions:
            if quantity is not first:
                both = make((quantity, *scaling.quantities), self.is_pooled)
                start = np.concatenate([[0.0], best[0]])
                rows.append(power(both, both.fit(start=start), 0, beside=(first.name,)))
        for k in range(1, len(scaling.quantities) - len(self.shifts)):
            rows.append(power(scaling, best, k, beside=(first.name,)))
        if not self.is_pooled:
            share = _share(gain, view, scaling, best[1])
            rows += _between(told, scaling, self.outer, best, first, share)
        return rows + out


def _beside(view, companions):
    """The view beside free pushes in some directions."""
    if not companions:
        return view
    blocks = [
        np.concatenate([d.columns(group) for d in companions], axis=3) for group in view.groups
    ]
    return view.beside(blocks)


def _with_own_noise(view, direction, dataset, channel):
    """The view in which noise is felt through the force of this channel as well."""
    if any(group.slopes is None for group in view.groups):
        return view
    scaling, (exponents, _) = channel.scaling, channel.best
    amplitudes = scaling.amplitudes(exponents)
    masses = masses_of(view)
    slopes = []
    for g, group in enumerate(view.groups):

        def field(batch, g=g, group=group):
            moved = replace(view, groups=(replace(group, batch=batch),))
            size, legs = amplitudes[g][None, :, :, None], direction.legs(moved.groups[0])
            fresh = {q.name: q for q in quantities_of(moved, direction, dataset)}
            for exponent, quantity in zip(exponents, scaling.quantities, strict=True):
                if quantity.is_property or quantity.name not in fresh:
                    log, sign = quantity.logs[g], quantity.signs and quantity.signs[g]
                else:
                    new = fresh[quantity.name]
                    log = new.logs[0] + np.log(new.typical / quantity.typical)
                    sign = new.signs and new.signs[0]
                size = size * np.exp(np.clip(exponent * log, -50.0, 50.0))
                size = size if sign is None else size * sign
            mass = 1.0 if masses is None else masses[g]
            return (legs * (size / mass)[..., None]).sum(axis=3)

        slopes.append(group.slopes + slopes_of(group.batch, field))
    return with_felt_noise(view, slopes, view.sigma)


def _first(view, direction, motions, fits):
    """The quantity that explains most; where others do as well, the one usual in that direction."""
    best = min(misfit for _, misfit in fits.values())
    slack = DROP * max(best / max(view.size, 1), 1.0)
    near = [q for q in motions if fits[q.name][1] <= best + slack]
    usual = ("distance", "stretch") if direction.distances is not None else ("speed",)
    return min(near, key=lambda q: (q.name not in usual, fits[q.name][1]))


def _hardly(quantity):
    return f"it varies by {100 * (quantity.spread - 1):.0f} % only"


def _told(direction, dataset, of_force, quantity, **settings):
    """An Exponent; not determined unless a value is given."""
    units = dataset.units
    blank = {"value": np.nan, "low": np.nan, "high": np.nan, "is_determined": False}
    return Exponent(
        channel=direction.name,
        variable=quantity.name,
        of_force=of_force,
        unit="" if quantity.unit is None else units.text(quantity.unit),
        size_unit=units.text(ACCELERATION),
        **{**blank, **settings},
    )


def _with_best_signs(make, inner, outer, shifts, fit):
    """Properties of both signs count with their sign or without, whichever explains more."""
    chosen = tuple(outer)
    for k, quantity in enumerate(outer):
        if quantity.signs is None:
            continue
        plain = replace(quantity, signs=None)
        trials = [(*chosen[:k], q, *chosen[k + 1 :]) for q in (quantity, plain)]
        start = np.concatenate([fit[0][: len(inner)], np.ones(len(outer)), np.zeros(len(shifts))])
        misfits = [make((*inner, *trial, *shifts), True).misfit(start) for trial in trials]
        chosen = trials[int(np.argmin(misfits))]
    return chosen


def _is_one(view, pooled, misfit, alone, free_misfit):
    """Whether one amplitude and powers of properties explain all tracks as well."""
    from scipy.stats import f

    n_more = alone.n_amplitudes + len(alone.quantities) - 1 - len(pooled.quantities)
    if n_more <= 0:
        return alone.n_amplitudes == 1
    rest = max(view.size - alone.n_amplitudes - len(alone.quantities), 1)
    noise = max(free_misfit / rest, 1.0)
    return bool(f.sf((misfit - free_misfit) / n_more / noise, n_more, rest) > REJECTED)


def _noise(view, scaling, misfit):
    """Variance about a power law: that of noise, or more where more is left than noise."""
    from scipy.stats import chi2

    rest = max(view.size - scaling.n_amplitudes - len(scaling.quantities), 1)
    return misfit / rest if chi2.sf(misfit, rest) < REJECTED else 1.0


def _power(told, gain, view, scaling, best, index, beside=(), profile=None):
    """The exponent number `index` of a fit with its profile-likelihood interval."""
    exponents, misfit = best
    quantity = scaling.quantities[index]
    share = _share(gain, view, scaling, misfit)
    settings = {"beside": beside, "share": share}
    if share < MIN_SHARE:
        return told(quantity, reason=f"powers explain {share:.0%} of it only", **settings)
    noise = _noise(view, scaling, misfit)
    half = np.sqrt(DROP * noise) * scaling.curvature_error(exponents, index)
    low = high = np.nan
    if half < MOST_HALF:
        bar = misfit + DROP * noise
        low, high = (_end(scaling, exponents, index, bar, sign * half) for sign in (-1, 1))
    if not (np.isfinite(low) and np.isfinite(high)):
        return told(quantity, reason=UNBOUND, **settings)
    settings |= {"value": float(exponents[index]), "low": low, "high": high}
    if high - low > 2 * MAX_HALF:
        return told(quantity, reason=UNBOUND, **settings)
    reason = ROUGH if noise > 1 else ""
    return told(quantity, is_determined=True, profile=profile, reason=reason, **settings)


def _share(gain, view, scaling, misfit):
    """Part of what a free push explains that the power law explains."""
    total = float(sum(np.square(t).sum() for t in view.target))
    n_free = len(scaling.quantities) + scaling.n_amplitudes
    return float(np.clip((total - misfit - n_free) / gain, 0.0, 1.0))


def _end(scaling, exponents, index, bar, step):
    """Where the profile of the sum of squares crosses the bar; nan beyond `MOST`."""
    from scipy.optimize import brentq

    first = float(exponents[index])

    def above(value):
        return scaling.fit({index: value}, start=exponents)[1] - bar

    inner, outer = first, first + 0.7 * step
    while above(outer) <= 0:
        inner, step = outer, 1.6 * step
        outer = first + step
        if abs(outer) > MOST:
            return float("nan")
    return float(brentq(above, *sorted((inner, outer)), xtol=0.005 * abs(step)))


def _between(told, scaling, outer, best, first, share):
    """Exponents of properties from the amplitudes of tracks that scatter beyond noise.

    Straight lines through the logarithms of the amplitudes; every track counts once.
    """
    from scipy.stats import t as student

    sizes = np.concatenate([np.abs(a).ravel() for a in scaling.amplitudes(best[0])])
    rows = [np.concatenate([np.broadcast_to(log[0, ..., 0], a.shape).ravel() for log, a in
                            zip(q.logs, scaling.amplitudes(best[0]), strict=True)])
            for q in outer]  # fmt: skip
    matrix = np.stack([np.ones(len(sizes)), *rows], axis=1)
    seen = sizes > 0
    matrix, logs = matrix[seen], np.log(np.where(seen, sizes, 1.0))[seen]
    rest = len(logs) - matrix.shape[1]
    for k, quantity in enumerate(outer, 1):
        if share < MIN_SHARE:
            reason = f"powers explain {share:.0%} of it only"
            yield told(quantity, reason=reason, share=share)
            continue
        if rest < 2 or np.linalg.matrix_rank(matrix) < matrix.shape[1]:
            yield told(quantity, reason="too few bodies for as many properties")
            continue
        values, *_ = np.linalg.lstsq(matrix, logs, rcond=None)
        scatter = np.square(logs - matrix @ values).sum() / rest
        half = student.ppf(0.95, rest) * np.sqrt(scatter * np.linalg.inv(matrix.T @ matrix)[k, k])
        value = float(values[k])
        settings = {"value": value, "low": value - half, "high": value + half, "share": share}
        if half > MAX_HALF:
            yield told(quantity, reason="bodies scatter too much about any power", **settings)
        else:
            yield told(quantity, is_determined=True, beside=(first.name,), **settings)


def _profile(scaling, exponents):
    """The residual along a channel against its first quantity, free of any power law."""
    view, quantity = scaling.view, scaling.quantities[0]
    logs = np.concatenate(
        [
            np.broadcast_to(log, leg.shape[:4])[leg.any(axis=-1)]
            for log, leg in zip(quantity.logs, scaling.legs, strict=True)
        ]
    )
    nodes = np.unique(np.quantile(logs, np.linspace(0.02, 0.98, N_NODES)))
    if len(nodes) < 3:
        return None
    weights = scaling.amplitudes(exponents)
    typical = _typical_of(weights)
    if typical == 0:
        return None
    columns = []
    rest = np.concatenate([[0.0], exponents[1:]])
    for hat in np.eye(len(nodes)):
        sizes = [
            np.interp(log, nodes, hat) * (weight / typical)[None, :, :, None]
            for log, weight in zip(quantity.logs, weights, strict=True)
        ]
        columns.append(view.flat(scaling.weighted(rest, sizes)))
    matrix = np.stack(columns, axis=1)
    matrix = matrix - view.constants @ (view.constants.T @ matrix)
    target = view.flat(view.target)
    inverse = np.linalg.pinv(matrix.T @ matrix, hermitian=True)
    values = inverse @ (matrix.T @ target)
    misfit = float(np.square(target - matrix @ values).sum())
    errors = np.sqrt(np.maximum(np.diag(inverse), 0.0) * _noise(view, scaling, misfit))
    fine = np.linspace(nodes[0], nodes[-1], 40)
    return Profile(
        *(tuple(map(float, row)) for row in (
            quantity.typical * np.exp(nodes), values, errors, quantity.typical * np.exp(fine),
            typical * np.exp(exponents[0] * fine),
        ))
    )  # fmt: skip


def _typical_of(weights):
    """Amplitude of the typical track: the median size, with the sign of most."""
    flat = np.concatenate([w.ravel() for w in weights])
    flat = flat[flat != 0]
    return float(np.median(np.abs(flat)) * (np.sign(np.median(flat)) or 1.0)) if len(flat) else 0.0
