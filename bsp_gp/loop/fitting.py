"""A law without the loop: its constants fitted to a data set."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.data.noise import declare_noise
from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.close import _check_masses, declared_law
from bsp_gp.loop.outcome import ConstantEstimate, Errors, _plain
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.simulation import checked_noise, simulate_law
from bsp_gp.loop.telling import constant_estimates
from bsp_gp.physics.aliasing import aliasing_notes
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.shooting import fit_rollout
from bsp_gp.search.constants import START_SCALES, fit_constants, linear_columns
from bsp_gp.units import Unit

__all__ = ["SCHEMA", "LawFit", "fit_law", "simulate_law"]

SCHEMA = "bsp_gp/fit/1"
MIN_CORRELATION = 0.1
_SAME_CHISQR = 1e-3


@dataclass(frozen=True, eq=False)
class LawFit:
    """A law with its constants fitted to the training scenes of a data set.

    Attributes
    ----------
    dataset : str
    law : ForceLaw
        With the fitted constants.
    law_text : str
        As typed, constants as names.
    constants : tuple of ConstantEstimate
        Values with 90 % intervals and units.
    correlation : ndarray, shape (k, k)
        Of the constants, in their order.
    errors : Errors
        On the held-out scenes.
    noise : dict
        sigma (per axis), unit, source, method.
    chisqr, reduced_chisqr : float
        Whitened sum of squares, and per degree of freedom.
    bic : float
    n_rows, n_free : int
        Numbers fitted, and free parameters (initial states included where they are fitted).
    converged : bool
    message : str
        How it was fitted and how convergence was checked.
    split : str
    notes : tuple of str
    """

    dataset: str
    law: ForceLaw
    law_text: str
    constants: tuple[ConstantEstimate, ...]
    correlation: np.ndarray
    errors: Errors
    noise: dict
    chisqr: float
    reduced_chisqr: float
    bic: float
    n_rows: int
    n_free: int
    converged: bool
    message: str
    split: str
    notes: tuple[str, ...] = ()

    def to_dict(self):
        """The contents of fit.json: plain dicts, lists, numbers and None for nan."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "law"}
        law = {"text": fields.pop("law_text"), "with_values": self.law.text()}
        return _plain({"schema": SCHEMA, "law": law, **fields})

    def text(self):
        """The fit as a table for a terminal; variables stand with their 90 % intervals."""
        e, sigma = (
            self.errors,
            ", ".join(f"{s:.3g}" if math.isfinite(s) else "-" for s in self.noise["sigma"]),
        )
        lines = [
            "[[Model]]", f"    F_i = {self.law_text}",
            "[[Fit Statistics]]",
            f"    data set           = {self.dataset}; {self.split}",
            f"    # data points      = {self.n_rows}",
            f"    # variables        = {len(self.constants)} constants, {self.n_free} free in all",
            f"    chi-square         = {self.chisqr:.6g}",
            f"    reduced chi-square = {self.reduced_chisqr:.6g}",
            f"    Bayesian info crit = {self.bic:.6g}",
            f"    noise              = {sigma} {self.noise['unit']} ({self.noise['source']})",
            f"    converged          = {'yes' if self.converged else 'NO'}: {self.message}",
            "[[Held-out Errors]]",
            f"    rollout rms        = {e.rollout_rmse:.4g} {e.unit}",
            f"    end point (median) = {e.endpoint:.4g} {e.unit}",
            f"    one-step nrmse     = {e.one_step_nrmse:.4g} {e.unit}",
            f"    residual accel.    = {e.residual_acceleration:.4g} {e.acceleration_unit}",
            "[[Variables]] (± half of the 90 % interval)",
            *(list(_variables(self.constants)) or ["    none: every number of the law is given"]),
        ]  # fmt: skip
        pairs = self.correlations()
        if pairs:
            lines.append(f"[[Correlations]] (unreported correlations are < {MIN_CORRELATION:g})")
            width = max(len(a) + len(b) for a, b, _ in pairs)
            lines += [
                f"    C({a}, {b}){' ' * (width - len(a) - len(b))} = {value:+.4f}"
                for a, b, value in pairs
            ]
        lines += [f"Note: {note}" for note in self.notes]
        return "\n".join(lines)

    def correlations(self):
        """Pairs of constants whose correlation exceeds 0.1, strongest first: (a, b, value)."""
        names = [_label(c) for c in self.constants]
        pairs = [
            (names[a], names[b], float(self.correlation[a, b]))
            for a in range(len(names))
            for b in range(a + 1, len(names))
            if abs(self.correlation[a, b]) > MIN_CORRELATION
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))


def _label(constant):
    return f"{constant.name}[{constant.entity}]" if constant.entity else constant.name


def _variables(constants):
    width = max((len(_label(c)) for c in constants), default=0) + 1
    for c in constants:
        half = (c.high - c.low) / 2
        unit = f" {c.unit}" if c.unit else ""
        if c.state == "undetermined":
            at = f" (left at {c.value:.3g}{unit})" if math.isfinite(c.value) else ""
            yield f"    {_label(c) + ':':<{width}} undetermined by these data{at}"
            continue
        if c.state == "at_bound":
            yield f"    {_label(c) + ':':<{width}} at its bound, {c.value:.8g}{unit}"
            continue
        value, error = _rounded(c.value, half)
        share = f" ({100 * half / abs(c.value):.2g} %)" if c.value and math.isfinite(half) else ""
        yield f"    {_label(c) + ':':<{width}} {value} ± {error}{unit}{share}"


def _rounded(value, half):
    """Value and half-width with two digits of the half-width."""
    if not (half > 0 and math.isfinite(half) and math.isfinite(value)):
        return f"{value:.8g}", f"{half:.2g}"
    digits = math.floor(math.log10(max(abs(value), half))) - math.floor(math.log10(half)) + 2
    return f"{value:.{min(max(digits, 2), 15)}g}", f"{half:.2g}"


def fit_law(dataset, laws, *, rng, noise=None):
    """Fit the constants of a law to a data set.

    Parameters
    ----------
    dataset : Dataset
    laws : ForceLaw or sequence of str
        The forces; named constants are fitted. The constants of a ForceLaw are start values.
    rng : numpy.random.Generator
        For a split that is not declared.
    noise : float or sequence of float, optional
        Standard deviation of a position (one, or one per axis), metres; overrides the data's.

    Returns
    -------
    LawFit

    Raises
    ------
    BspError
        If the data or the law is unusable.
    """
    law = laws if isinstance(laws, ForceLaw) else declared_law(dataset, laws)
    if noise is not None:
        dataset = declare_noise(dataset, checked_noise(noise, dataset.n_dims))
    pairs = any(term.kind == "pair" for term in law.terms)
    sources = pairs and max(len(scene.entities) for scene in dataset.scenes) > 1
    observation = observe(dataset, law, rng, sources=sources)
    _check_masses(observation, law)
    regression = observation.train_regression
    is_linear = linear_columns(regression, law) is not None
    if not is_linear:
        law = fit_constants(regression, law, starts=len(START_SCALES)).law
    model = evaluate(observation, law)
    converged, n_free, message = _convergence(observation, model.fit, is_linear)
    return LawFit(
        dataset=dataset.name,
        law=model.law,
        law_text=model.law.text(digits=False),
        constants=constant_estimates(observation, model.fit),
        correlation=_correlation(model.fit.covariance),
        errors=model.errors,
        noise=_about_noise(observation),
        chisqr=model.fit.chisqr,
        reduced_chisqr=model.fit.chisqr / max(model.fit.n_rows - n_free, 1),
        bic=float(model.fit.bic()),
        n_rows=int(model.fit.n_rows),
        n_free=n_free,
        converged=converged,
        message=message,
        split=observation.split_note,
        notes=(
            *observation.dataset.notes,
            *observation.noise.notes,
            *aliasing_notes(model.law, observation.train, dataset.units),
        ),
    )


def _correlation(covariance):
    sizes = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # What is undetermined, or exact, has no correlation with anything.
    known = np.isfinite(sizes) & (sizes > 0)
    sizes = np.where(known, sizes, 1.0)
    correlation = np.where(np.outer(known, known), covariance, 0.0) / sizes / sizes[:, None]
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _convergence(observation, fit, is_linear):
    """Whether the constants are a minimum: (converged, number of free parameters, how)."""
    if observation.is_exact:
        how = "accelerations" + (", closed form" if is_linear else ", L-BFGS from several starts")
        if is_linear:
            return True, len(fit.parameters), how
        slope = fit.jacobian.T @ fit.residual
        sizes = np.linalg.norm(fit.jacobian, axis=0) * np.linalg.norm(fit.residual)
        flat = bool(np.all(np.abs(slope) <= _SAME_CHISQR * sizes)) or fit.chisqr < fit.n_rows
        return flat, len(fit.parameters), how
    again = fit_rollout(
        observation.segments,
        fit.law,
        observation.sigma,
        integrator=observation.integrator,
        substeps=observation.substeps,
        up=observation.dataset.up,
        memory=observation.memory,
    )
    change = abs(again.chisqr - fit.chisqr)
    same = change < _SAME_CHISQR * max(fit.chisqr, 1.0)
    how = f"whole tracks, initial states free; a restart changes chi-square by {change:.1e}"
    return bool(again.converged and same), int(again.n_free), how


def _about_noise(observation):
    return {
        "sigma": [float(s) for s in observation.sigma],
        "unit": observation.dataset.units.text(Unit.of(m=1)),
        "source": observation.noise.source,
        "method": observation.noise.method,
    }
