"""Where an unseen source may be, and how strong: draws from the posterior about its fit.

Draws are those of Laplace's approximation, weighed by the priors: where the data hardly determine
a number, these do.
"""

import numpy as np

from bsp_gp.fitting.law_fit import widening
from bsp_gp.fitting.parts.inclined import stretched
from bsp_gp.inference.posterior import effective_size
from bsp_gp.units import Unit

N_PROPOSED, N_DRAWS = 8000, 600
SHARE_90 = 0.9
SHOWN_ROWS = 60
LENGTH = Unit.of(m=1)


def whereabouts(dataset, part, fit, rng):
    """Draws of the numbers of an unseen source, and what a map of them needs.

    Parameters
    ----------
    dataset : Dataset
        Without it.
    part : HiddenSource
    fit : Fit
        With it.

    Returns
    -------
    dict
        Plain numbers; of `draws` the strength is last. Empty of a fit whose covariance is not
        known.
    """
    names = [*part.places, *part.speeds, part.strength]
    at = [[n for n, _ in fit.parameters].index(name) for name in names]
    if not np.isfinite(fit.covariance).all() or not np.all(fit.errors > 0):
        return {}
    draws, n_eff = _drawn(fit, _Prior(part, at, fit), rng)
    draws, best, d = draws[:, at], fit.values[at], len(part.places)
    centre = draws[:, :d].mean(axis=0)
    away = np.linalg.norm(draws[:, :d] - centre, axis=1)
    scene = max(dataset.scenes, key=lambda s: len(s.times))
    rows = np.unique(np.linspace(0, len(scene.times) - 1, SHOWN_ROWS).astype(int))
    plane = stretched(fit.law)
    visible = scene.positions[rows] if plane is None else scene.positions[rows] @ plane.T
    visible = np.swapaxes(visible, 0, 1).tolist()
    unit = _strength_unit(part, dataset)
    speed = dataset.units.text(LENGTH / Unit.of(s=1))
    units = dict.fromkeys(part.places, dataset.units.text(LENGTH))
    units |= dict.fromkeys(part.speeds, speed) | ({part.strength: unit} if part.column else {})
    return {
        "motion": part.motion, "epoch": part.epoch, "names": names, "best": best.tolist(),
        "property": part.column, "unit": unit, "units": units,
        "is_share": part.between[0].formula in {term.formula for term in fit.law.terms},
        "length_unit": dataset.units.text(LENGTH),
        **({} if plane is None else {"seen_at": np.linalg.solve(plane, best[:d]).tolist()}),
        "draws": draws.tolist(),
        "n_eff": float(n_eff), "centre": centre.tolist(),
        "radius_90": float(np.quantile(away, SHARE_90)),
        "track": part.track(fit, scene.times)[rows].tolist(),
        "visible": {
            name: [[x if np.isfinite(x) else None for x in p] for p in places]
            for name, places in zip(scene.names, visible, strict=True)
        },
    }  # fmt: skip


def _strength_unit(part, dataset):
    """Unit of a strength: a mass that gravity tells is in kilograms, whatever masses are in."""
    units, own = dataset.units, part.unit(dataset)
    is_weighed = units.is_calibrated(LENGTH / Unit.of(s=1)) and part.column == "mass"
    return own.text() if is_weighed else units.text(own)


class _Prior:
    """Log-density of values (W, k) of all constants, up to one: that of the evidence."""

    def __init__(self, part, at, fit):
        self.least = fit.errors[at[-1]]
        own = {p.name: p.prior for p in part.parameters}
        self.places, self.strength = at[:-1], at[-1]
        self.centre, self.scale = np.array([own[n] for n in (*part.places, *part.speeds)]).T
        self.is_mass = part.column == "mass"

    def __call__(self, x):
        strength = x[:, self.strength]
        far = np.square((x[:, self.places] - self.centre) / self.scale)
        value = -np.log1p(far).sum(axis=1) - np.log(np.maximum(np.abs(strength), self.least))
        return np.where((strength > 0) | (not self.is_mass), value, -np.inf)


def _drawn(fit, prior, rng):
    """Equally weighted draws of all constants (N, k), and their effective number."""
    values, vectors = np.linalg.eigh(fit.covariance / np.outer(fit.errors, fit.errors))
    factor = fit.errors[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)) * widening(fit)
    z = rng.standard_normal((N_PROPOSED, len(fit.values)))
    if fit.noise.is_free.any():
        dof = max(fit.n_rows - fit.n_free, 1)
        z *= np.sqrt(dof / rng.chisquare(dof, N_PROPOSED))[:, None]
    x = fit.values + z @ factor.T
    log_weight = prior(x)
    if not np.isfinite(log_weight).any():
        return np.repeat(fit.values[None], N_DRAWS, axis=0), 1.0
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    return x[rng.choice(len(x), N_DRAWS, p=weight)], effective_size(weight)
