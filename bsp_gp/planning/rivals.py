"""What may be true: laws with their probabilities, and what is known of their constants."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.language.formula import rename_constants
from bsp_gp.loop.stored import law_of
from bsp_gp.physics.force import ForceLaw, fresh_name

__all__ = ["Rival", "in_common", "rivals_of"]

LEAST = 1e-3
"""Less likely rivals are left out."""
MOST = 8
"""Rivals at the most, the likeliest."""
UNKNOWN = 0.1
"""Part of a constant by which it may be off where no fit told its error."""


@dataclass(frozen=True, eq=False)
class Rival:
    """A law that may be true.

    Attributes
    ----------
    text : str
    law : ForceLaw
        With the constants that fit best.
    probability : float
    names : tuple of str
        Constants that are uncertain.
    covariance : ndarray, shape (k, k)
        Of them.
    """

    text: str
    law: ForceLaw
    probability: float
    names: tuple = ()
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self):
        for name in self.law.names:
            value = self.law.constants.get(name, math.nan)
            if isinstance(value, Mapping) or not math.isfinite(value):
                raise SettingsError(f"{self.text}: {name} has no value for a new experiment")

    def draws(self, rng, count):
        """Constants as they may be, dict of name to ndarray (count,); the best first."""
        values = {n: np.full(count, float(self.law.constants[n])) for n in self.law.names}
        if len(self.names):
            spread = np.linalg.svd(np.asarray(self.covariance, float), hermitian=True)
            root = spread[0] * np.sqrt(np.maximum(spread[1], 0.0))
            moves = rng.standard_normal((count, len(self.names))) @ root.T
            moves[0] = 0.0
            for name, move in zip(self.names, moves.T, strict=True):
                values[name] = values[name] + move
        return values


def in_common(law):
    """A law whose constants by scene or body are one for all, their median: it foretells.

    Parameters
    ----------
    law : ForceLaw

    Returns
    -------
    ForceLaw
        The law itself where it has none.
    """
    names, values = {}, {}
    for name, value in law.constants.items():
        if isinstance(value, Mapping) and value:
            stem = name.partition("[")[0]
            names[name] = fresh_name(law, stem) if stem in law.constants else stem
            values[names[name]] = float(np.median(list(value.values())))
    if not names:
        return law
    kept = {name: value for name, value in law.constants.items() if name not in names}
    terms = tuple(replace(t, formula=rename_constants(t.formula, names)) for t in law.terms)
    return replace(law, terms=terms, constants={**kept, **values})


def rivals_of(report):
    """Rivals of the last round of a report that told any apart, probabilities adding up to one.

    Parameters
    ----------
    report : LoopReport

    Returns
    -------
    tuple of Rival
        Empty where no row of its tables is a force whose constants are known.
    """
    adopted = [done for done in report.rounds if done.adopted] or list(report.rounds[-1:])
    found = []
    for row in adopted[-1].hypotheses:
        model = row.get("model")
        if model is None or not (row["probability"] or 0.0) >= LEAST:
            continue
        law = law_of(model, report.dataset)
        if law is None or law.names != tuple(n for n in law.names if n in law.constants):
            continue
        count = len(model["uncertain"])
        covariance = np.array(model["covariance"], float).reshape(count, count)
        name = row["law"] or "no further force"
        try:
            uncertain = tuple(model["uncertain"])
            found.append(Rival(name, law, row["probability"], uncertain, covariance))
        except SettingsError:  # constants of scenes or bodies of their own say nothing of new ones
            continue
    found = sorted(found, key=lambda r: -r.probability)[:MOST]
    total = sum(r.probability for r in found)
    return tuple(replace(r, probability=r.probability / total) for r in found)
