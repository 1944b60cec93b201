"""None of these: machines that know no physics, beside the law of a fit (LOOP §5).

Two kinds of them are set beside every law that was found, linearised at its own fit: a *strength
that varies* smoothly with one variable, or from body to body, and a *free force* in a direction in
which physics acts. Each is a Gaussian process on the moments of the tracks, columns C with weights
W, so that its evidence beside the law as it is has a closed form for every amplitude:
``sum (y^2 s / (1 + s) - log(1 + s)) / 2``, with ``s = amplitude^2 eigenvalues of C W C'``. The
amplitude, in parts of what was found, is as likely in every factor of ten between
`Criteria.constant_within` and one: a change that is smaller is none, and one that could not be seen
speaks neither for nor against the law.
"""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.language.formula import Formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.constancy import logarithms, powers_in, varied
from bsp_gp.loop.trace import free_forces
from bsp_gp.physics.force import ForceLaw

CODES = ("varying_strength", "free_force")
FALL = 4.5
"""Weights of cosines fall as ``exp(-k^2 / FALL)``."""
COUNT = 4
LITTLE = 4
"""Power of `Criteria.constant_within` down to which amplitudes that are none are tried."""
NODES = 41
"""Amplitudes over which evidence is summed, in equal steps of their logarithm."""
SEEN, LEAST = 1e-6, 0.1
"""Part of its length that a column must have beside the constants to count, and chi-squared that
all must show at the greatest amplitude: what shows less does what the law does."""


@dataclass(frozen=True)
class Unknown:
    """What nobody lists, beside a law as it is.

    Attributes
    ----------
    code : str
        "varying_strength" or "free_force".
    term : Formula or None
        Whose strength varies.
    direction, variable : str
        Of a free force; in what it, or the strength, varies.
    log_odds : float, nats
        Log-evidence beside the law as it is.
    """

    code: str
    term: Formula | None
    direction: str
    variable: str
    log_odds: float

    @property
    def text(self):
        of = self.direction if self.term is None else to_text(self.term)
        return f"{self.code} {of}" + (f" by {self.variable}" if self.variable else "")


def unknowns(view, terms, gain):
    """What nobody lists beside the law of a View: of each term, and one free force.

    Parameters
    ----------
    terms : sequence of Term
        Of its law, those whose strength may vary.
    gain : float
        Chi-squared that was found: as large is a free force at the most.
    """
    # Under the pure error the tracks show more of what was found than the base, under its own.
    gain = max(gain, _shown(view, terms))
    found, little = [], [0.0]
    for term in terms:
        of_term = []
        for variable, columns, w in _variations(view, term):
            odds, below = _log_odds(view, columns * np.sqrt(w))
            of_term.append(Unknown(CODES[0], term.formula, "", variable, odds))
            little.append(below)
        found += _as_one(of_term)
    free = []
    for direction, variable, columns in free_forces(view, COUNT):
        is_named = variable in ("body", "scene")
        order = np.zeros(columns.shape[1]) if is_named else np.arange(columns.shape[1])
        odds, below = _log_odds(view, columns * np.exp(-np.square(order) / FALL / 2), gain)
        free.append(Unknown(CODES[1], None, direction, variable, odds))
        little.append(below)
    # What as little explains as a law may change, or leave, speaks for none of them.
    found = (*found, *_as_one(free))
    return tuple(replace(one, log_odds=one.log_odds - max(little)) for one in found)


def _shown(view, terms):
    """Chi-squared that terms of the law of a view make in its moments."""
    if not terms:
        return 0.0
    names = dict.fromkeys(name for term in terms for name in term.formula.constants)
    known = {name: view.fit.law.constants[name] for name in names}
    moments = view.response.moments_of(ForceLaw(tuple(terms), known))
    return float(moments @ moments) if np.isfinite(moments).all() else 0.0


def _as_one(tried):
    """The likeliest of what is equally likely beforehand, with the odds of all together."""
    tried = [one for one in tried if one.log_odds is not None]  # those that would show
    if not tried:
        return ()
    odds = np.logaddexp.reduce([one.log_odds for one in tried]) - np.log(len(tried))
    return (replace(max(tried, key=lambda one: one.log_odds), log_odds=float(odds)),)


def _variations(view, term):
    """Moments of a term times functions of one variable, with their weights."""
    for base in powers_in(term):
        columns = logarithms(view, term, base)
        if columns is not None:
            yield to_text(base), columns, np.exp(-np.square([1, 2]) / FALL)
    for variable, columns in varied(view, term, count=COUNT, with_names=True):
        is_smooth = variable not in ("body", "scene", "direction")
        order = np.arange(1, 1 + columns.shape[1]) if is_smooth else np.zeros(columns.shape[1])
        yield variable, columns, np.exp(-np.square(order) / FALL)


def _log_odds(view, columns, gain=None):
    """Log-evidence of a Gaussian process with these columns (n, F) beside none, nats.

    Of amplitudes from `Criteria.constant_within`, and the greatest of those below. None and zero
    where the columns would show nothing (`gain`) that the constants do not.
    """
    if not np.isfinite(columns).all():
        return None, 0.0
    basis, sizes, _ = np.linalg.svd(view.beside(columns), full_matrices=False)
    seen = sizes > SEEN * np.linalg.norm(columns, axis=0).max(initial=0.0)
    square, sizes = np.square(basis[:, seen].T @ view.left), np.square(sizes[seen])
    if gain is not None and seen.any():
        sizes *= max(gain, 0.0) / sizes.sum()
    if not sizes.sum() > LEAST:
        return None, 0.0
    within = view.criteria.constant_within
    little, much = (
        0.5 * (square * share / (1 + share) - np.log1p(share)).sum(axis=1)
        for share in (
            np.square(np.geomspace(*ends, NODES))[:, None] * sizes
            for ends in ((within**LITTLE, within), (within, 1.0))
        )
    )
    return float(np.logaddexp.reduce(much) - np.log(NODES)), float(little.max())
