"""What the loop returns: every round's before and after, the final law, and why it stopped.

`LoopReport.to_dict` is ``report.json``: its top level and ``before``/``after``/``total`` are a
stable contract, the inside of a round may grow. All ``low``/``high`` are 90 % intervals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from bsp_gp.fitting.estimates import ConstantEstimate, Errors
from bsp_gp.fitting.estimates import plain as _plain
from bsp_gp.loop.traced import Guidance, Trace

__all__ = [
    "SCHEMA",
    "VERDICTS",
    "ConstantEstimate",
    "Effect",
    "Errors",
    "LoopReport",
    "Missing",
    "Overlay",
    "Ratio",
    "ResidualTable",
    "Rival",
    "Round",
]

SCHEMA = "bsp_gp/report/1"
VERDICTS = ("effect adopted", "nothing missing", "seen, not adopted", "cannot tell")


@dataclass(frozen=True)
class Ratio:
    """After divided by before, with its 90 % interval."""

    value: float
    low: float
    high: float
    method: str = ""


@dataclass(frozen=True)
class Missing:
    """Question 1, answered: what is left above the noise.

    Attributes
    ----------
    statistic : float
        Whitened residual sum of squares per degree of freedom (1 = noise alone).
    p_value : float
        Chance of as much, or as strongly autocorrelated a residual, from noise alone; nan where
        the fit failed.
    detectable_force, detectable_share : float
        Smallest constant force, one for all bodies, that would have been seen with 95 % power,
        `detectable_force_unit`, and in parts of the root mean square of the declared force; nan
        where a mass is not known.
    detectable : float
        The acceleration that it gives to a body of typical (median) mass, `detectable_unit`; where
        a mass is not known, the smallest acceleration that is one for all.
    tests : dict of str to float
        p-values of the single tests.
    is_missing : bool
    rhythm : Rhythm or None
        The frequency in which the residual stands out most.
    directions : tuple of Direction
        Common effects, the most significant first.
    together : tuple of Direction
        Two common forces at once, then three, the most significant of each first.
    durbin_watson : float
        Of the whitened residual along tracks: 2 = not correlated, 0 = the same from row to row.
    """

    statistic: float
    p_value: float
    detectable: float
    detectable_unit: str = ""
    tests: dict = field(default_factory=dict)
    is_missing: bool = True
    rhythm: object = field(default=None, repr=False, compare=False)
    directions: tuple = field(default=(), repr=False)
    together: tuple = field(default=(), repr=False)
    durbin_watson: float = math.nan
    detectable_force: float = math.nan
    detectable_force_unit: str = ""
    detectable_share: float = math.nan

    @property
    def is_failed(self):
        """Whether there was nothing to be tested: the fit has no finite value."""
        return not math.isfinite(self.p_value)

    @property
    def is_noise(self):
        """Whether what is left was tested, and is no more than noise."""
        return not self.is_missing and not self.is_failed


@dataclass(frozen=True)
class Rival:
    """Another explanation that was weighed.

    Attributes
    ----------
    name, kind : str
        Kind as in `Effect`.
    law, latex : str
    delta_bic : float
        BIC minus the adopted (or best) one's; positive = worse.
    training_share, held_out_ratio : float
        Part of the training residual explained; held-out error after / before.
    complexity : float
    reason : str
        Why it lost, or that it ties.
    """

    name: str
    kind: str
    law: str
    latex: str
    delta_bic: float
    training_share: float
    held_out_ratio: float
    complexity: float
    reason: str


@dataclass(frozen=True)
class Effect:
    """A traced effect.

    Attributes
    ----------
    name : str
        In plain words: "drag, linear in speed".
    kind : str
        pair | field | hidden_body | measurement | declared_term_change.
    law, latex : str
    entities : tuple of str
    constants : tuple of ConstantEstimate
    p_value : float
        Selection included.
    equivalents : tuple of str
        Laws that these data cannot tell from it: those fitted to whole tracks, then by
        evidence and prior; where a trace guides, those that it points to first.
    separated_by : str
        Which measurement would tell them apart.
    details : dict
        Of a hidden body: draws of its place and strength, and the tracks to draw them among.
    n_unnamed : int
        At least so many more cannot be told from it either.
    """

    name: str
    kind: str
    law: str
    latex: str
    entities: tuple[str, ...]
    constants: tuple[ConstantEstimate, ...]
    p_value: float
    equivalents: tuple[str, ...] = ()
    separated_by: str = ""
    details: dict = field(default_factory=dict, repr=False)
    n_unnamed: int = 0


@dataclass(frozen=True)
class Round:
    """One turn of the loop.

    Attributes
    ----------
    ratio : Ratio or None
        Of the rollout errors; `ratios` has all, by name.
    significance : str
        How the p-value came about, where data sets were simulated and searched.
    noise_memory : float
        Correlation time of the position noise, s; 0 = white.
    trace : Trace or None
        Where the residual is, and what it depends on.
    guidance : Guidance or None
        What of that guided the search.
    undecided : tuple of str
        Explanations that are no force law and fit as well as the effect: these data cannot tell.
        A law may be adopted all the same, for predictions; the verdict is then "cannot tell".
    removed : str
        Why what was adopted was taken back after a later round; "" if it stands.
    missing_held_out : Missing or None
        What the held-out tracks lack when the law is fitted to them; asked where nothing is
        missing from the training tracks.
    """

    number: int
    missing: Missing
    effect: Effect | None
    rivals: tuple[Rival, ...]
    adopted: bool
    reason: str
    before: Errors
    after: Errors | None
    floor: Errors
    ratio: Ratio | None
    held_out: tuple[dict, ...]
    certificate: str
    seconds: float = 0.0
    verdict: str = ""
    significance: str = ""
    noise_memory: float = 0.0
    trace: Trace | None = None
    guidance: Guidance | None = None
    undecided: tuple[str, ...] = ()
    removed: str = ""
    missing_held_out: Missing | None = None
    ratios: dict = field(default_factory=dict)

    @property
    def is_something_missing(self):
        """Whether training or held-out tracks lack something."""
        there = self.missing_held_out
        return self.missing.is_missing or (there is not None and there.is_missing)


@dataclass(frozen=True, eq=False)
class Overlay:
    """One held-out entity: what was observed and what the two models predict.

    Attributes
    ----------
    scene, entity : str
    times : ndarray, shape (T,), s
    observed, declared, adopted : ndarray, shape (T, d), metres
        nan where there is none. `declared` and `adopted` start from the states fitted on the
        first `n_initial` rows.
    n_initial : int
    """

    scene: str
    entity: str
    times: object
    observed: object
    declared: object
    adopted: object
    n_initial: int


@dataclass(frozen=True, eq=False)
class ResidualTable:
    """Residual accelerations row by row; equal-length 1-D arrays.

    Attributes
    ----------
    scene, entity, split : list of str
        Split is "train" or "test".
    t, speed, distance : ndarray
        Distance to the nearest other body, nan if there is none.
    before, after : ndarray
        Size of the residual acceleration under the declared and the final law.
    before_along, after_along : ndarray
        Its signed component along the velocity.
    """

    scene: list
    entity: list
    split: list
    t: object
    speed: object
    distance: object
    before: object
    after: object
    before_along: object
    after_along: object


@dataclass(frozen=True, eq=False)
class LoopReport:
    """Everything that a run of the loop found out.

    Attributes
    ----------
    dataset : dict
        name, n_scenes, n_rows, n_entities, train, test, provenance, fingerprint, units.
    declared : tuple of dict
        ``{"law", "latex"}`` of every declared term.
    grammar : dict
        name, fingerprint.
    law : ForceLaw
        The final law with its constants.
    law_text, law_latex : str
    constants : tuple of ConstantEstimate
        Of the final law.
    noise : dict
        sigma (list per axis or float), unit, source.
    total : dict
        before, after, floor (Errors), ratio (Ratio) of the rollout errors, ratios (dict) of all.
    verdict, stop_reason : str
    overlays : tuple of Overlay
    residuals : ResidualTable or None
    notes : tuple of str
        What a reader must know: dropped rows, unknown masses, missing calibration, caveats.
    extras : tuple of dict
        Further sections for the page: ``{"title", "paragraphs": [str], "table": [[...]] or None}``.
    corrections : tuple of dict
        Explanations that were adopted and are no force between visible bodies: ``{"name", "kind",
        "text", "constants"}``. Errors after, residuals and predictions are under them: what was
        measured is put right, or a body is added, before a law is applied.
    """

    dataset: dict
    declared: tuple
    grammar: dict
    seed: int
    alpha: float
    noise: dict
    rounds: tuple[Round, ...]
    law: object
    law_text: str
    law_latex: str
    constants: tuple[ConstantEstimate, ...]
    total: dict
    verdict: str
    stop_reason: str
    versions: dict
    wall_s: float
    overlays: tuple[Overlay, ...] = ()
    residuals: ResidualTable | None = None
    notes: tuple[str, ...] = ()
    extras: tuple = ()
    corrections: tuple = ()

    def to_dict(self):
        """The contents of report.json: plain dicts, lists, numbers and None for nan."""
        return _plain(
            {
                "schema": SCHEMA,
                "dataset": self.dataset,
                "declared": list(self.declared),
                "grammar": self.grammar,
                "seed": self.seed,
                "alpha": self.alpha,
                "noise": self.noise,
                "rounds": list(self.rounds),
                "law": {
                    "text": self.law_text,
                    "latex": self.law_latex,
                    "constants": list(self.constants),
                },
                "total": self.total,
                "verdict": self.verdict,
                "stop_reason": self.stop_reason,
                "notes": list(self.notes),
                "extras": list(self.extras),
                "corrections": list(self.corrections),
                "versions": self.versions,
                "wall_s": self.wall_s,
            }
        )

    def table(self):
        """Before and after of every round as a DataFrame, one row per round and model."""
        import pandas as pd

        rows = []
        for r in self.rounds:
            for label, errors in (("before", r.before), ("after", r.after), ("floor", r.floor)):
                if errors is not None:
                    told = _plain(errors)
                    intervals = told.pop("intervals")
                    for metric, (low, high) in intervals.items():
                        told |= {f"{metric}_low": low, f"{metric}_high": high}
                    rows.append(
                        {"round": r.number, "model": label, "adopted": r.adopted, **told}
                    )
        return pd.DataFrame(rows)
