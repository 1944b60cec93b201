"""What the loop returns: codes and numbers of every round, the final law, and why it stopped.

`LoopReport.to_dict` is ``report.json``, schema "bsp_gp/report/2". All ``low``/``high`` are 90 %
intervals. Words are made of this in the room of reports.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from html import escape
from typing import ClassVar

import numpy as np

from bsp_gp.data.drawn import plot_models
from bsp_gp.errors import SettingsError
from bsp_gp.fitting.estimates import ConstantEstimate, Errors, plain
from bsp_gp.language.render import to_text
from bsp_gp.loop.accounts import Ratio
from bsp_gp.loop.told import Told
from bsp_gp.physics.force import ForceLaw
from bsp_gp.units import FORCE

SCHEMA = "bsp_gp/report/2"


@dataclass(frozen=True)
class Missing:
    """What is left above the noise.

    Attributes
    ----------
    statistic : float
        Whitened sum of squares per degree of freedom of the fit that enters.
    p_value : float
        Chance that noise alone shows as much in the best of everything that was tried; nan where
        that fit failed.
    detectable : float
        Least constant acceleration, one for all bodies, that would have been seen with 95 %
        power on every axis, `unit`.
    """

    statistic: float
    p_value: float
    detectable: float = math.nan
    unit: str = ""


@dataclass(frozen=True)
class Effect:
    """The likeliest cause of a round.

    Attributes
    ----------
    name : str
        What it adds, as text.
    code : str
        One of `CAUSES`.
    kind : str
        pair | field | hidden_body | measurement | declared_term_change | noise.
    law, latex : str
        The term that it adds; "" where it is no force.
    entities : tuple of str
        Bodies on which it acts.
    constants : tuple of ConstantEstimate
        That it brought in.
    p_value, probability : float
        Selection counted; over the table of the round.
    equivalents : tuple of str
        What these data cannot tell from it, the likeliest first.
    is_fact : bool
        Whether its form is told apart from all rivals, powers next to its own among them.
    exponents : tuple of dict
        ``{term, of, stated, value, low, high, is_told}``: powers of speed and distance in a law
        that was found, as it has them, as the data have them, whether these exclude all others.
    varies_with : tuple of dict
        ``{term, variable, p_value}``: in what its strength changes.
    formula : Formula or None
    details : dict
        What its proposer tells beyond the fit: of an unseen body draws from its posterior.
    """

    name: str
    code: str
    kind: str
    law: str
    latex: str
    entities: tuple[str, ...]
    constants: tuple[ConstantEstimate, ...]
    p_value: float
    probability: float
    equivalents: tuple[str, ...] = ()
    is_fact: bool = False
    exponents: tuple = ()
    varies_with: tuple = ()
    formula: object = field(default=None, repr=False, compare=False)
    details: dict = field(default_factory=dict, repr=False, compare=False)

    def to_dict(self):
        """Everything but the formula."""
        kept = [name for name in self.__dataclass_fields__ if name != "formula"]
        return {name: getattr(self, name) for name in kept}


WIDEST = 3.0
"""Width of the interval of a power up to which its best value is told: friction, linear and
quadratic drag lie within it."""


def is_open(exponent):
    """Whether the data leave a power, as an effect has it, so open that its value says nothing.

    Several forces of such powers are a series that follows any curve.
    """
    return not exponent["high"] - exponent["low"] <= WIDEST


@dataclass(frozen=True)
class RoundRecord:
    """One round as it is reported.

    Attributes
    ----------
    hypotheses : tuple of dict
        Rows of the table of the round.
    varies_with, noise_findings : tuple of dict
        ``{term, variable, p_value}``, ``{code, scene, entity, row}``.
    hidden_bound : dict or None
        ``{snr, force, unit, percent}``.
    verdict, reason : str
        Codes.
    before, after, floor : Errors
        `before` is the model that enters; `after` is None where nothing was fitted beside it. One
        floor, that of the last law, serves all rounds.
    held_out : tuple of dict
        ``{scene, before, after}`` of the position errors.
    trace : object or None
    """

    number: int
    missing: Missing
    effect: Effect | None
    hypotheses: tuple
    adopted: bool
    verdict: str
    reason: str
    before: Errors
    after: Errors | None
    floor: Errors
    ratio: Ratio
    held_out: tuple = ()
    varies_with: tuple = ()
    noise_findings: tuple = ()
    hidden_bound: object = None
    certificate: str = ""
    seconds: float = 0.0
    trace: object = None

    def to_dict(self):
        """One entry of `rounds`."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__}
        fields["effect"] = self.effect.to_dict() if self.effect is not None else None
        return fields


@dataclass(frozen=True, eq=False)
class Overlay:
    """One held-out entity: what was observed and what the two models predict.

    Attributes
    ----------
    times : ndarray, shape (T,), s
    observed, declared, adopted : ndarray, shape (T, d), metres
        nan where there is none. `declared` and `adopted` start from the states fitted on the
        first `n_initial` rows.
    """

    scene: str
    entity: str
    times: object
    observed: object
    declared: object
    adopted: object
    n_initial: int


def _declared_error(overlay):
    left = np.asarray(overlay.declared, float) - np.asarray(overlay.observed, float)
    return float(np.nan_to_num(np.nansum(np.square(left))))


@dataclass(frozen=True, eq=False, repr=False)
class LoopReport:
    """Everything that a run of the loop found out.

    Attributes
    ----------
    dataset : dict
        name, n_scenes, n_rows, n_entities, n_dims, train, test, split, units, up, provenance,
        fingerprint, notes.
    declared : tuple of dict
        ``{"law", "latex", "is_displaced"}`` of every declared term; a displaced one is in the final
        law no more, since what was found stands in its place.
    grammar : dict
        name, fingerprint.
    search : str
    seed : int or None
    criteria : dict
        Of `Criteria`, by name; `alpha` is one of them.
    noise : dict
        sigma (per axis), unit, source, correlation_time, tails.
    rounds : tuple of RoundRecord
    law : ForceLaw
        The final law with its constants.
    law_text, law_latex : str
    constants : tuple of ConstantEstimate
        Of the final law.
    total : dict
        before, after, floor (Errors) and ratio (Ratio) of declared and final law; ratios by
        metric.
    verdict : str
        The first of `VERDICTS` that any round gave.
    probability : float
        Of the cause that gave the verdict; nan where there is none.
    equivalents : tuple of str
        What is not told apart from it.
    stop_reason : str
    left_out : tuple of str
        What there was no time for; none where the run is complete.
    n_fits : int
    versions : dict
    wall_s : float
    hidden_bound : dict or None
        ``{snr, force, unit, percent}``: how much may still be hidden beside the final law, 95 %.
    overlays : tuple of Overlay
    residuals : DataFrame or None
        See `bsp_gp.loop.writing_up.residual_table`.
    fit, hypothesis : Fit, Hypothesis
        The last ones.
    extras : tuple of dict
        Sections that whoever closed the loop adds: title, paragraphs, table, values.
    """

    dataset: dict
    declared: tuple
    grammar: dict
    search: str
    seed: object
    criteria: dict
    noise: dict
    rounds: tuple[RoundRecord, ...]
    law: object
    law_text: str
    law_latex: str
    constants: tuple[ConstantEstimate, ...]
    total: dict
    verdict: str
    probability: float
    equivalents: tuple[str, ...]
    stop_reason: str
    left_out: tuple[str, ...]
    n_fits: int
    versions: dict
    wall_s: float
    hidden_bound: object = None
    overlays: tuple[Overlay, ...] = field(default=(), repr=False)
    residuals: object = field(default=None, repr=False)
    fit: object = field(default=None, repr=False)
    hypothesis: object = field(default=None, repr=False)
    extras: tuple = field(default=(), repr=False)
    words: ClassVar[Callable | None] = None
    """What makes words of a report, lines of (found, constants, rivals): of the room of reports."""

    def __post_init__(self):
        if isinstance(self.law, ForceLaw):
            object.__setattr__(self, "law", replace(self.law, up=self.dataset.get("up")))

    def __repr__(self):
        units = Told(self.dataset.get("units") or {}, self.dataset.get("symbols") or {})
        before, after, floor = (
            units.errors(self.total[name]) for name in ("before", "after", "floor")
        )
        known = [e.rollout_rmse for e in (before, after) if e is not None]
        told = " -> ".join(f"{e:.4g}" for e in known if not math.isnan(e)) + f" {before.unit}"
        if len(known) > 1 and math.isnan(known[1]):
            told += " under the declared model, none is known under the adopted law"
        if floor is not None and not math.isnan(floor.rollout_rmse):
            told += f"; noise floor {floor.rollout_rmse:.4g}"
        bound = self.hidden_bound
        hidden = []
        if bound is not None and math.isfinite(bound["force"] or math.nan):
            factor, unit = units.force(bound["unit"])
            size = f"{factor * bound['force']:.2g} {'N' if unit == FORCE.text() else unit}"
            hidden = [f"  a constant force of up to {size} is not excluded (95 %)"]
        found, constants, rivals = self.words() if self.words else self._without_words()
        return "\n".join([
            f"LoopReport of {self.dataset.get('name')!r}: {self.verdict}",
            *(f"  {line}" for line in found),
            f"  law: F_i = {units.text(self.law_text)}",
            *(f"  {line}" for line in constants),
            f"  held-out position error: {told}",
            *(f"  {line}" for line in rivals), *hidden,
            f"  rounds: {len(self.rounds)}, fits: {self.n_fits}; in full: bsp_gp.write_report",
        ])  # fmt: skip

    def _without_words(self):
        n = len(self.equivalents)
        ties = [f"these data do not tell it from {n} other form{'s' * (n > 1)}"] if n else []
        return [], [], ties

    def _repr_html_(self):
        """For a notebook, which typesets the law."""
        return f"<div>$${escape(self.law_latex)}$$</div><pre>{escape(repr(self))}</pre>"

    def plot(self, axes=None, *, number=None):
        """Draw a held-out track as observed and as both models foresee it; returns the axes.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Where to draw; by default new ones.
        number : int, optional
            Of `overlays`; by default the one on which the declared model errs most.
        """
        if not self.overlays:
            raise SettingsError("this report holds no tracks; those that were read back have none")
        shown = max(self.overlays, key=_declared_error) if number is None else self.overlays[number]
        models = {"declared model": shown.declared, "adopted law": shown.adopted}
        unit = self.total["before"].unit
        axes = plot_models(np.asarray(shown.times), np.asarray(shown.observed), models, axes,
                           length=unit)  # fmt: skip
        axes.set_title(f"{shown.scene}: {shown.entity}".replace("$", r"\$"))
        return axes

    @property
    def alpha(self):
        return self.criteria["alpha"]

    @property
    def complete(self):
        """Whether nothing was left out for want of time."""
        return not self.left_out

    def to_dict(self):
        """The contents of report.json: plain dicts, lists, numbers and None for nan."""
        total = {name: self.total[name] for name in ("before", "after", "floor", "ratio")}
        kept = (
            "dataset", "declared", "grammar", "search", "seed", "alpha", "criteria", "noise",
            "verdict", "probability", "equivalents", "hidden_bound", "stop_reason",
            "complete", "left_out", "n_fits", "versions", "wall_s",
        )  # fmt: skip
        law = {
            "text": self.law_text, "latex": self.law_latex, "constants": self.constants,
            **law_record(self.law),
        }  # fmt: skip
        return plain(
            {
                "schema": SCHEMA,
                **{name: getattr(self, name) for name in kept},
                "rounds": [done.to_dict() for done in self.rounds],
                "law": law,
                "total": total,
                "extras": self.extras,
            }
        )

    def table(self):
        """Every hypothesis of every round as a DataFrame, one row each."""
        import pandas as pd

        rows = []
        for done in self.rounds:
            for row in done.hypotheses:
                held_out = {f"held_out_{k}": v for k, v in row["held_out"].items()}
                flat = {k: v for k, v in row.items() if k not in ("held_out", "model")}
                rows.append({"round": done.number, **flat, **held_out})
        return pd.DataFrame(rows)


def law_record(law):
    """Terms and constants of a law, as `bsp_gp.loop.stored.law_of` reads them."""
    return {
        "terms": [
            {"text": to_text(t.formula), "kind": t.kind, "is_declared": t.is_declared}
            for t in law.terms
        ],
        "values": {
            name: dict(value) if hasattr(value, "items") else value
            for name, value in law.constants.items()
        },
    }
