"""What may be true: laws with their probabilities, and what is known of their constants."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.language.formula import rename_constants
from bsp_gp.language.operators import bessel_k1
from bsp_gp.language.render import to_text
from bsp_gp.loop.stored import law_of
from bsp_gp.physics.force import ForceLaw, fresh_name

LEAST = 1e-3
"""Less likely rivals are left out."""
MOST = 8
"""Rivals at the most, the likeliest."""
NEARLY, SURELY = 0.05, 2.0
"""By which a power may be off a whole one, or a half, that is tried in its place, and standard
deviations by which it may be."""


@dataclass(frozen=True, eq=False)
class Rival:
    """A law that may be true.

    Attributes
    ----------
    law : ForceLaw
        With the constants that fit best.
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
        if len(law.terms) < len(model["terms"]):  # it needs what no report keeps
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


_R = r"norm\(p_i - p_j\)"
_POWER = re.compile(rf"{_R}\^(n\d*)( \* exp\(-{_R} / \w+\))?")
_WHOLE = re.compile(rf"inverse\({_R}(?:\^(\d+))?\)|{_R}\^-(\d+)")
_FALLING = {
    rf"bessel_k1\({_R} / (\w+)\)": lambda r, length: float(bessel_k1(r / length)),
    rf"exp\(-{_R} / (\w+)\)": lambda r, length: math.exp(-r / length),
    rf"exp\(-\({_R} / (\w+)\)\^2\)": lambda r, length: math.exp(-((r / length) ** 2)),
    rf"\({_R}\^2 \+ (\w+)\^2\)\^-1\.5": lambda r, length: (r**2 + length**2) ** -1.5,
}
"""Factors that fall with the distance beyond a fitted length."""


def kin_of(rival, dataset):
    """Laws that one with a power of the distance may stand for in what was seen so far.

    Over a short way no power tells two whole powers, one that fades with a length besides, and a
    force that is screened in two dimensions apart: experiments are to be made where they differ.

    Parameters
    ----------
    dataset : Dataset
        For types and units.

    Returns
    -------
    list of Rival
        Of no probability yet, their constants starts; none where nothing falls with the distance.
    """
    texts = [to_text(term.formula) for term in rival.law.terms]
    if free := _free_power(rival, texts, dataset):
        return [free]
    found = [(k, match) for k, text in enumerate(texts)
             if (match := _POWER.search(text) or _WHOLE.search(text))]  # fmt: skip
    if len(found) != 1:
        return []
    ((k, match),) = found
    fades = texts[k].replace(match[0], "")
    if "exp(" in fades or "bessel" in fades or not rival.law.terms[k].formula.constants:
        return []
    values, length = rival.law.constants, fresh_name(rival.law, "L")
    strength, far = rival.law.terms[k].formula.constants[0], _typical_distance(dataset)
    is_whole = match.re is _WHOLE
    power = -float(match[1] or match[2] or 1) if is_whole else values[match[1]]
    # As strong at that distance: from further off its length runs away.
    alike = values[strength] * far**power / float(bessel_k1(1.0))
    screened = texts[k].replace(match[0], f"bessel_k1(norm(p_i - p_j) / {length})")
    kin = [([screened], {length: far, strength: alike})]
    if is_whole:
        exponent = fresh_name(rival.law, "n")
        kin.append(
            ([texts[k].replace(match[0], f"norm(p_i - p_j)^{exponent}")], {exponent: power})
        )
    elif not match[2]:
        faded = texts[k].replace(match[0], f"{match[0]} * exp(-norm(p_i - p_j) / {length})")
        kin.append(([faded], {length: FADING * far}))
        second = fresh_name(rival.law, strength.rstrip("0123456789"))
        whole = [texts[k].replace(match[0], f"norm(p_i - p_j)^{math.floor(power) + up}")
                 for up in (0, 1)]  # fmt: skip
        whole[1] = re.sub(rf"\b{strength}\b", second, whole[1])
        kin.append((whole, {second: values[strength]}))
    return [
        _changed(rival, [*texts[:k], *changed, *texts[k + 1 :]], starts, dataset)
        for changed, starts in kin
    ]


def _changed(rival, texts, starts, dataset):
    """A law of other texts, its constants as a rival has them or as `starts` say."""
    law = read_law(dataset, texts)
    law = replace(law, terms=tuple(replace(t, is_declared=False) for t in law.terms))
    known = {name: (rival.law.constants | starts)[name] for name in law.names}
    return Rival(law.text(digits=False), law.with_constants(known), 0.0)


def _free_power(rival, texts, dataset):
    """A fitted power in the place of what falls beyond a length; None where nothing does."""
    found = [
        (k, match, shape) for k, text in enumerate(texts) for pattern, shape in _FALLING.items()
        if (match := re.search(pattern, text))
    ]  # fmt: skip
    if len(found) != 1 or any(_POWER.search(text) for text in texts):
        return None
    ((k, match, shape),) = found
    values, strengths = rival.law.constants, rival.law.terms[k].formula.constants
    strengths = [name for name in strengths if name != match[1]]
    if len(strengths) != 1 or match[1] not in values:
        return None
    exponent, far = fresh_name(rival.law, "n"), _typical_distance(dataset)
    alike = values[strengths[0]] * shape(far, values[match[1]]) * far  # as strong at that distance
    changed = texts[k].replace(match[0], f"norm(p_i - p_j)^{exponent}")
    starts = {exponent: -1.0, strengths[0]: alike}
    return _changed(rival, [*texts[:k], changed, *texts[k + 1 :]], starts, dataset)


def of_whole_powers(rival, dataset):
    """The law with powers that are nearly whole, or nearly halves, written as such.

    Returns
    -------
    list of Rival
        One, of no probability yet, its constants starts; none where no power is.
    """
    texts = [to_text(term.formula) for term in rival.law.terms]
    values, changed = rival.law.constants, list(texts)
    errors = dict(zip(rival.names, np.sqrt(np.diag(rival.covariance)), strict=True))
    for name in rival.law.names:
        power = round(2 * values[name]) / 2
        if abs(values[name] - power) > max(NEARLY, SURELY * errors.get(name, 0.0)):
            continue
        what = r"\^" + name + r"\b"
        if not power:
            factor = rf"(?:\([^()]*\)|\w+(?:\([^()]*\))?){what}"
            what = rf" \* {factor}|{factor} \* "
        changed = [re.sub(what, f"^{power:g}" if power else "", text) for text in changed]
    if changed == texts:
        return []
    return [_changed(rival, changed, {}, dataset)]


def less_a_term(rival):
    """Laws that lack one of the terms of a sum: what was found beside another form may be none.

    Returns
    -------
    list of Rival
        Of no probability yet, their constants starts; none of a single term.
    """
    terms = rival.law.terms
    less = [rival.law.without(k) for k in range(len(terms))] if len(terms) > 1 else []
    return [Rival(law.text(digits=False), law, 0.0) for law in less]


FADING = 3.0
"""Distances over which forces fade to begin with, in typical ones."""


def _typical_distance(dataset):
    gaps = [s.positions[:, :, None] - s.positions[:, None] for s in dataset.scenes]
    gaps = np.concatenate([np.linalg.norm(gap, axis=-1).ravel() for gap in gaps])
    return float(np.median(gaps[gaps > 0]))
