"""A law without the loop: constants fitted to a data set, errors on what is held out."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from bsp_gp.data.drawn import plot_constants
from bsp_gp.data.noise import checked_noise, declare_noise, estimate_noise
from bsp_gp.data.notes import listed
from bsp_gp.data.scene import CHECK, Dataset
from bsp_gp.data.split import choose_split
from bsp_gp.data.torn import without_torn_ends
from bsp_gp.errors import DataError, SettingsError, in_python
from bsp_gp.fitting.estimates import ConstantEstimate, Errors, plain
from bsp_gp.fitting.followed import about_lost, followed
from bsp_gp.fitting.held_out import held_out_errors
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.jackknife import jackknife_errors
from bsp_gp.fitting.law_text import (
    doubts,
    fit_text,
    how_it_ended,
    strong_correlations,
    variables,
    without_prediction,
)
from bsp_gp.fitting.noise_model import NoiseModel
from bsp_gp.fitting.outliers import is_exact, without_outliers
from bsp_gp.fitting.rests import without_rests
from bsp_gp.fitting.weighing import bears_outliers
from bsp_gp.physics.aliasing import aliasing_notes
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.force import ForceLaw, needs_masses
from bsp_gp.physics.masses import check_properties, with_usable_masses
from bsp_gp.randomness import Random, generator
from bsp_gp.units import METRE, Unit

SCHEMA = "bsp_gp/fit/2"
MAX_TOLD = 5
"""Constants that a fit tells unasked."""
MOST_FAR_OFF = 5
"""Rows that are far off that are told one by one."""
MISFIT = 1.5
"""Reduced chi-square above which what is left counts as correlated misfit, not as noise."""
UNTOLD = 0.9
"""Part of the width of its prior that is left of a property that the motion does not tell."""
LEAST_SHARE = 0.2
"""Part of the time limit that the errors on held-out scenes have at least."""


@dataclass(frozen=True, eq=False, repr=False)
class LawFit:
    """A law with its constants fitted to the training scenes of a data set.

    Attributes
    ----------
    law : ForceLaw
        With the fitted constants.
    law_text : str
        As typed, constants as names.
    constants : tuple of ConstantEstimate
        Values with 90 % intervals and units; no interval (nan) where the fit failed.
    correlation : ndarray, shape (k, k)
        Of the constants, in their order; 0 for those that the data do not determine.
    errors : Errors
        On the held-out scenes.
    noise : dict
        sigma (per axis), unit, source, method, correlation_time (s, None = white), correlated
        (part of the variance that has a memory), tails (degrees of freedom of Student's t, None =
        normal).
    status : str
        The first that applies of "nonfinite", "unconverged", "aliased" (failed fits, which say
        nothing of the law), "at_bound", "refuted" (by declared errors) and "converged".
    message : str
        The status in words, and what to do.
    chisqr, chi2_red : float
        Whitened sum of squares, and per degree of freedom.
    bic : float
        Of everything fitted, noise included, nats times two.
    log_evidence : float, nats
        By Laplace's approximation, see `bsp_gp.fitting.fit.Fit`.
    n_rows, n_free : int
        Numbers fitted, and free parameters, initial states included.
    n_starts, n_agree : int
        Starts, and those that led to this minimum.
    gradient : float
        Largest cosine between the residual and the change by a constant, 0 at a minimum.
    notes : tuple of str
        Those that begin with "check: " cast a doubt on the result.
    """

    dataset: str
    law: ForceLaw
    law_text: str
    constants: tuple[ConstantEstimate, ...]
    correlation: np.ndarray
    errors: Errors
    noise: dict
    status: str
    message: str
    chisqr: float
    chi2_red: float
    bic: float
    log_evidence: float
    n_rows: int
    n_free: int
    n_starts: int
    n_agree: int
    gradient: float
    split: str
    notes: tuple[str, ...] = ()

    @property
    def converged(self):
        """Whether the constants are a minimum, be it at a bound or refuted."""
        return self.status in ("at_bound", "refuted", "converged")

    @property
    def reduced_chisqr(self):
        """The same as `chi2_red`."""
        return self.chi2_red

    def to_dict(self):
        """The contents of fit.json: plain dicts, lists, numbers and None for nan."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "law"}
        law = {"text": fields.pop("law_text"), "with_values": self.law.text()}
        return plain({"schema": SCHEMA, "law": law, "converged": self.converged, **fields})

    def text(self):
        """The fit as a table for a terminal; variables stand with their 90 % intervals."""
        return fit_text(self)

    def __repr__(self):
        told = [line[2:] for line in variables(self.constants)]
        if len(told) > MAX_TOLD:
            told = [*told[: MAX_TOLD - 1], f"  and {len(told) - MAX_TOLD + 1} more"]
        e = self.errors
        return "\n".join([
            f"LawFit of {self.dataset!r}: {self.status}", f"  F_i = {self.law_text}", *told,
            f"  held-out position error {e.rollout_rmse:.4g} {e.unit}; reduced chi-square "
            f"{self.chi2_red:.4g} of {self.n_rows} numbers",
            f"  notes: {len(self.notes)}; text() tells all",
        ])  # fmt: skip

    def _repr_html_(self):
        return f"<pre>{escape(repr(self))}</pre>"

    def plot(self, axes=None):
        """Draw the constants with their intervals; returns the axes."""
        return plot_constants(self.constants, axes)

    def correlations(self):
        """Pairs of constants whose correlation exceeds 0.1, strongest first: (a, b, value)."""
        return strong_correlations(self.constants, self.correlation)


def fit_law(
    dataset: Dataset, laws: ForceLaw | str | Sequence[str], *, rng: Random = None,
    noise: float | Sequence[float] | None = None, starts: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None, time_limit: float | None = None,
) -> LawFit:  # fmt: skip
    """Fit the constants of a law to a data set.

    Parameters
    ----------
    laws : ForceLaw, str or sequence of str
        The forces; named constants are fitted, whatever values a ForceLaw has for them.
    rng : numpy.random.Generator, int or None
        For a split that is not declared; None is 0.
    noise : float or sequence of float, optional
        Standard deviation of a position (one, or one per axis), metres; overrides the data's.
    starts : mapping of str to float, optional
        Where constants begin, in the units in which they are told (SI where the data are
        calibrated); the others are found from the data.
    bounds : mapping of str to (float, float), optional
        Between which constants stay, in the same units.
    time_limit : float, optional
        Seconds after which the fit is ended and what was found is told.

    Raises
    ------
    BspError
        If the data, the law or a setting is unusable.

    Examples
    --------
    >>> found = fit_law(dataset, ["-k * norm(v_i)^n * normalize(v_i)"], bounds={"n": (0, 4)})
    ... # doctest: +SKIP
    """
    began = time.monotonic()
    _check_settings(starts, bounds, time_limit)
    if noise is not None:
        dataset = declare_noise(dataset, checked_noise(noise, dataset.n_dims))
    law = unset(laws) if isinstance(laws, ForceLaw) else read_law(dataset, laws)
    dataset = without_torn_ends(with_usable_masses(dataset, needs_masses(law)))
    dataset = without_rests(dataset, law)
    split = choose_split(dataset, generator(rng))
    said = estimate_noise(dataset)
    train, far_off = training_part(dataset, split.learned, said)
    check_properties(stack(train.scenes, dataset.up), law)

    def left():
        """Seconds for what comes after the fit."""
        if time_limit is None:
            return None
        return max(time_limit - (time.monotonic() - began), LEAST_SHARE * time_limit)

    def fitted(part, starts, deadline):
        hypothesis = Hypothesis.from_laws(part, law)
        return followed(hypothesis, part, starts=starts, bounds=bounds, deadline=deadline)

    found, hypothesis = fitted(train, starts, time_limit)
    blind = found
    if split.whole and split.test and not found.is_failed:
        part, _ = training_part(dataset, split.train, said)
        blind, _ = fitted(part, {**(starts or {}), **_plain(found)}, left())
    errors = held_out_errors(blind, dataset, split.test, deadline=left())
    wider = widening(found)
    constants = constant_estimates(found, dataset, bounds)
    noise_told = about_noise(found.noise, said, dataset.units)
    return LawFit(
        dataset=dataset.name, law=replace(found.law, up=dataset.up),
        law_text=found.law.text(digits=False),
        constants=constants, correlation=_correlation(found.covariance), errors=errors,
        noise=noise_told, status=found.status,
        message=in_python(how_it_ended(found, constants, time_limit)), chisqr=found.chisqr,
        chi2_red=found.chi2_red, bic=_bic(found), log_evidence=found.log_evidence,
        n_rows=found.n_rows, n_free=found.n_free, n_starts=found.n_starts, n_agree=found.n_agree,
        gradient=float(found.gradient), split=split.told,
        notes=(
            *dataset.notes, *said.notes, *about_lost(hypothesis),
            *about_outliers(found, train.scenes is not split.learned, far_off, dataset.units),
            *doubts(found, wider, bool(split.test)),
            *without_prediction(found, errors.rollout_rmse),
            *aliasing_notes(found.law, train.scenes, dataset.units),
        ),
    )  # fmt: skip


def training_part(dataset, scenes, said):
    """Scenes that are learned from, as fits take them.

    Returns
    -------
    train : Dataset
        Its scenes are `scenes` themselves where nothing is left out for being far off.
    far_off : tuple
        Which rows are far off their neighbours.

    Raises
    ------
    DataError
        If nothing moves.
    """
    if not np.isfinite(said.sigma).any():
        raise DataError("nothing moves: no dynamic entity changes its position on any axis")
    train = replace(dataset, scenes=scenes, train=(), test=())
    kept, far_off = without_outliers(scenes, said.sigma)
    if bears_outliers(NoiseModel.of(train), is_exact(scenes, said.sigma)):
        return train, far_off
    return replace(train, scenes=kept), far_off


def about_outliers(found, is_left_out, far_off, units):
    """What became of rows that are far off their neighbours, a note or none."""
    if not far_off:
        return ()
    how = "left out of the fit" if is_left_out else "weighed like all others"
    if not is_left_out and math.isfinite(found.noise.degrees):
        how = "given little weight by the tails of the noise"
    rows = [f"{body} of {scene} at t = {units.instant(at)}" for body, scene, at in far_off]
    return (f"{CHECK}far off their neighbours, and {how}: {listed(rows, MOST_FAR_OFF)}",)


def _plain(found):
    """Values of constants that are one number for all."""
    pairs = zip(found.parameters, found.values.tolist(), strict=True)
    return {name: value for (name, key), value in pairs if not key}


# --- settings -------------------------------------------------------------------------------------


def _check_settings(starts, bounds, time_limit):
    for what, given in (("starts", starts), ("bounds", bounds)):
        if given is not None and not isinstance(given, Mapping):
            raise SettingsError(f"{what} must be a mapping of constants, got {given!r:.60}")
    for name, value in (starts or {}).items():
        if not _is_number(value) or not math.isfinite(value):
            raise SettingsError(f"the start of {name} must be a finite number, got {value!r:.60}")
    for name, pair in (bounds or {}).items():
        is_pair = isinstance(pair, list | tuple) and len(pair) == 2
        if not is_pair or not all(_is_number(v) and not math.isnan(v) for v in pair):
            raise SettingsError(
                f"bounds of {name} must be two numbers, (low, high), got {pair!r:.60}"
            )
    if time_limit is not None and not (_is_number(time_limit) and 0 < time_limit < math.inf):
        raise SettingsError(
            f"time_limit must be a positive number of seconds, got {time_limit!r:.60}"
        )


def _is_number(value):
    return hasattr(value, "__float__") and not isinstance(value, str | bytes | bool)


def unset(law):
    """The law without values of constants that are one for all: a fit finds its own starts."""
    shared = [n for n in law.names if not hasattr(law.constants.get(n), "items")]
    return law.with_constants(dict.fromkeys(shared, math.nan))


# --- what is told ---------------------------------------------------------------------------------


def widening(found):
    """Factor on standard errors: misfit beyond the noise counts against the constants.

    With as many independent rows as the autocorrelation of the residual leaves.
    """
    dof = max(found.n_rows - found.n_free, 1)
    misfit = found.chisqr / dof
    if found.is_failed or not misfit > 1 + 5 * math.sqrt(2 / dof):
        return 1.0
    if misfit > MISFIT:
        white = found.whitened
        power = float(np.square(white).sum())
        rho = min(max(float((white[1:] * white[:-1]).sum()) / power, 0.0), 0.999)
        misfit *= (1 + rho) / (1 - rho)
    return math.sqrt(misfit)


def is_misfit(found):
    """Whether a fit surely leaves more than noise."""
    return widening(found) > math.sqrt(MISFIT)


def constant_estimates(found, dataset, bounds=None):
    """The constants of a fit with 90 % intervals; Student's t where the noise was estimated.

    Of a number that cannot be nothing (its bound lies above 0), and whose prior is logarithmic,
    they are symmetric in its logarithm. A strength may be nothing, and its interval may say so.
    """
    from scipy.stats import t as student_t  # a slow import

    bounds, wider = bounds or {}, widening(found)

    dof = max(found.n_rows - found.n_free, 1) if found.noise.is_free.any() else math.inf
    units = {n: dataset.units.text(unit) for n, unit in found.law.constant_units.items()}
    priors, positive = {}, set()
    for part in found.law.frame:
        text = Unit.text if getattr(part, "is_absolute", False) else dataset.units.text
        units |= {p.name: text(p.unit) for p in part.parameters if p.unit is not None}
        units |= dict.fromkeys(getattr(part, "angles", ()), "rad")
        priors |= {p.name: p for p in part.parameters if part.kind == "world"}
        positive |= {p.name for p in part.parameters
                     if p.low > 0 and getattr(p.prior, "is_logarithmic", False)}  # fmt: skip
    for body in found.law.unseen:
        units |= {name: dataset.units.text(unit) for name, unit in body.units.items()}
    bounds = {**{name: (p.low, p.high) for name, p in priors.items()}, **bounds}
    massless = {
        e.name for s in dataset.scenes for e in s.entities if not math.isfinite(e.mass)
    }  # fmt: skip
    halves = student_t.ppf(0.95, dof) * wider * found.errors
    if is_misfit(found):
        errors, n_parts = jackknife_errors(found)
        halves = np.maximum(halves, student_t.ppf(0.95, n_parts - 1) * errors)
    out = []
    for (name, entity), value, half, error in zip(
        found.parameters, found.values, halves, found.errors, strict=True
    ):
        low, high = bounds.get(name, (-math.inf, math.inf))
        unit = units.get(name, "")
        if entity in massless and unit:
            unit = f"{unit} per unit mass"
        state = ""
        is_open = name in priors and error > UNTOLD * priors[name].width(value)
        if not math.isfinite(half) and math.isfinite(value) and found.status == "unconverged":
            state = "unfinished"
        elif is_open or not (math.isfinite(half) and math.isfinite(value)):
            state = "undetermined"
        elif (value <= low or value >= high) and not found.is_failed:
            state = "at_bound"
        ends = value - half, value + half
        if name in positive and value > 0:  # a period that is hardly known is not below zero
            ends = tuple(value * np.exp((-half / value, half / value)))
        ends = (max(ends[0], low), min(ends[1], high))
        if found.is_failed:
            ends = (math.nan, math.nan)
        out.append(ConstantEstimate(name, float(value), *map(float, ends), unit, entity, state))
    # What acts comes before the places of what holds: a rail may have a dozen numbers.
    acting = {name for term in found.law.terms for name in term.formula.constants}
    return tuple(sorted(out, key=lambda c: c.name not in acting))


def _correlation(covariance):
    sizes = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # What is undetermined, or exact, has no correlation with anything.
    known = np.isfinite(sizes) & (sizes > 0)
    sizes = np.where(known, sizes, 1.0)
    correlation = np.where(np.outer(known, known), covariance, 0.0) / sizes / sizes[:, None]
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _bic(found):
    n_noise = sum(p.is_free for p in found.noise.parameters)
    return float((found.n_free + n_noise) * math.log(found.n_rows) - 2 * found.log_likelihood)


def about_noise(model, said, units):
    """What is known of the noise, or was estimated under the law."""
    is_estimated = bool(model.is_free.any())
    has_memory = model.correlated > 0
    return {
        "sigma": [float(level) for level in model.levels],
        "unit": units.text(METRE),
        "source": said.source,
        "method": f"under the law: {model.describe()}" if is_estimated else said.method,
        "correlation_time": float(model.correlation_time) if has_memory else None,
        "correlated": float(model.correlated),
        "tails": float(model.degrees) if math.isfinite(model.degrees) else None,
    }
