"""Several laws at once, where one alone does not explain what is left.

Added one at a time, a proxy may be taken first and never be parted with. So pairs of the likeliest
laws are always weighed, and where even the best law leaves more than noise, whole sets are chosen
from all laws that share its property factors.
"""

import numpy as np
from scipy import stats

from bsp_gp.fitting.response import RESOLVED
from bsp_gp.language.formula import Call, Constant, Input, factors, substitute
from bsp_gp.language.inputs import property_of
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposers.priors import drives, vector_of
from bsp_gp.loop.view import MOST_PAIRS
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, split_linear
from bsp_gp.search.candidate import Candidate
from bsp_gp.search.exhaustive import law_pool
from bsp_gp.search.subsets import best_subsets

MOST_PAIRED, MOST_SETS, LARGEST = 150, 40, 3
"""Laws of which two at once are tried, sets that are proposed, and laws in one of them."""
MOST_BEST = 12
"""Laws of pairs in sets, where these are too many to be all evaluated."""
LEAST_APART = 0.02
"""Part of a law, squared, that must lie beside another for the two to be told apart."""
SAME = 1e-9
"""Part of a law, squared, by which another may differ that is one with it on these data."""
LEAST_USUAL = 0.002
"""The same of two usual laws: drag is often linear and quadratic at once, much alike on a swing."""
SIMILAR = 0.01
"""Part of the best gain within which the simplest law says which properties matter."""


def pairs_of(view, found, usual=()):
    """Two laws at once that promise more than any alone, the best few.

    Parameters
    ----------
    found : list of Candidate
        The likeliest first.
    usual : collection of Formula
        Laws that are always among them: variants of one that explains much crowd out the rest.

    Returns
    -------
    list of (tuple of Candidate, ndarray, float)
        Laws, their constants, and what they gain.
    """
    found = [c for c in found if len(c.formula.constants) == 1]
    found = found[:MOST_PAIRED] + [c for c in found[MOST_PAIRED:] if c.formula in usual]
    if len(found) < 2:
        return []
    unit, size = _unit(view, _columns(view, found))
    scores, overlap = unit.T @ view.left, unit.T @ unit
    first, second = np.triu_indices(len(found), 1)
    cosine = overlap[first, second]
    apart = 1.0 - np.square(cosine)
    is_usual = np.array([c.formula in usual for c in found])
    good = apart > np.where(is_usual[first] & is_usual[second], LEAST_USUAL, LEAST_APART)
    first, second, cosine, apart = first[good], second[good], cosine[good], apart[good]
    a, b = scores[first], scores[second]
    gains = (a * a + b * b - 2 * a * b * cosine) / apart
    cost, vectors = np.array([c.complexity for c in found]), [vector_of(c) for c in found]
    is_one = np.array([vectors[i] == vectors[j] for i, j in zip(first, second, strict=True)])
    both = np.where(is_one, np.maximum(cost[first], cost[second]), cost[first] + cost[second])
    promise = 0.5 * gains - both
    least = 0.5 * found[0].gain - found[0].complexity
    out = []
    for k in np.argsort(-promise)[:MOST_SETS]:
        if promise[k] <= least:
            break
        i, j = first[k], second[k]
        amounts = np.array([a[k] - b[k] * cosine[k], b[k] - a[k] * cosine[k]]) / apart[k]
        out.append(((found[i], found[j]), amounts / size[[i, j]], float(gains[k])))
    return out


def sets_of(view, laws, found, declared):
    """Sets of laws with the property factors of the best one, where that leaves more than noise.

    Parameters
    ----------
    laws : Laws
        The proposer: its grammar and bounds.
    found : list of Candidate
        The likeliest first.
    declared : list of ndarray
        Moments of terms with declared numbers, at unit length: no set may free them.

    Returns
    -------
    list
        As of `pairs_of`.
    """
    if not found:
        return []
    total = float(view.left @ view.left)
    if total - found[0].gain < RESOLVED * total:
        return []
    if stats.chi2.sf(total - found[0].gain, max(view.n_left - 1, 1)) > view.criteria.alpha:
        return []
    most = max(c.gain for c in found)
    near = [c for c in found if c.gain > (1 - SIMILAR) * most]
    wanted = properties_of(min(near, key=lambda c: c.complexity).formula)
    pool, columns = [], []
    for kind in laws.kinds:
        if kind == "pair" and view.n_pairs > MOST_PAIRS:  # those only that were scored anyway
            best = [c for c in found if c.kind == kind and len(c.formula.constants) == 1]
            pool += [(split_linear(c.formula)[1], c.complexity, kind) for c in best[:MOST_BEST]]
            if best:
                columns.append(_columns(view, best[:MOST_BEST]))
            continue
        rest, matrix = law_pool(
            view.response.regression, laws.grammar, kind=kind, max_levels=laws.max_levels,
            is_left=lambda formula: properties_of(formula) == wanted,
        )  # fmt: skip
        pool += [(formula, complexity + view.odd_of(formula, kind), kind)
                 for formula, complexity in rest]  # fmt: skip
        columns.append(matrix)
    if not pool:
        return []
    columns = np.concatenate(columns, axis=1)
    own, _ = _unit(None, columns)
    marks = np.round(np.abs(own[0] + own[len(own) // 2] + own.sum(axis=0)), 9)
    free = np.zeros(len(pool), dtype=bool)
    free[np.unique(marks, return_index=True)[1]] = True  # a law that is written twice is one
    for direction in declared:
        free &= 1 - np.square(direction @ own) > LEAST_APART
    pool, columns = [pool[k] for k in np.flatnonzero(free)], columns[:, free]
    steady = [_steady_twin(view, law, columns[:, k]) for k, law in enumerate(pool)]
    unit, size = _unit(view, columns)
    subsets = best_subsets(unit, view.left, LARGEST)
    chosen = [s for n in range(2, LARGEST + 1) for _, s in subsets.get(n, ())[:MOST_SETS]]
    return [
        _set(view, [pool[k] for k in s], unit[:, s], size[list(s)], [steady[k] for k in s])
        for s in chosen
    ]


def _steady_twin(view, law, column):
    """A push along an axis that is one with a force along the velocity here, and how much of it."""
    formula, complexity, kind = law
    types = dataset_types(view.dataset)
    along = Call("normalize", Input("v_i", types["v_i"]))
    above, below = factors(formula)
    rest = [f for f in (*above, *below) if f != along]
    if along not in above or kind != "field" or any("v_i" in f.inputs for f in rest):
        return None
    for axis in np.flatnonzero(np.isfinite(view.fit.noise.levels)):
        direction = Input(f"e_{'xyz'[axis]}", types[f"e_{'xyz'[axis]}"])
        push = substitute(formula, {along: direction})
        own = view.response.regression.column(Term(push, kind))[0][:, 0]
        share = float(own @ column) / (float(own @ own) or 1.0)
        if np.square(column - share * own).sum() < SAME * np.square(column).sum():
            return (push, complexity, kind), share
    return None


def _set(view, members, unit, size, steady):
    amounts, *_ = np.linalg.lstsq(unit, view.left, rcond=None)
    total = float(view.left @ view.left)
    gain = total - float(np.square(view.left - unit @ amounts).sum())
    amounts, members = amounts / size, list(members)
    for k, twin in enumerate(steady):  # what drives a body along its way is rather a weight
        if twin is not None and drives(members[k][0], float(amounts[k])):
            members[k], amounts[k] = twin[0], amounts[k] * twin[1]
    candidates = tuple(
        Candidate(Call("mul", Constant("c1"), formula), kind, {}, 0.0, complexity, 0.0, total)
        for formula, complexity, kind in members
    )
    return candidates, amounts, gain


def _columns(view, found):
    terms = [Term(split_linear(c.formula)[1], c.kind) for c in found]
    return np.stack([view.response.regression.column(t)[0][:, 0] for t in terms], axis=1)


def _unit(view, columns):
    """Columns at unit length, beside the constants of the law of a view, and their lengths."""
    top = np.max(np.abs(columns), axis=0, initial=0.0)
    top = np.where((top > 0) & np.isfinite(top), top, 1.0)
    rows = np.where(np.isfinite(columns), columns, 0.0) / top
    rows = rows if view is None else view.beside(rows)
    size = np.linalg.norm(rows, axis=0)
    return rows / np.where(size > 0, size, 1.0), np.where(size > 0, size, 1.0) * top


def properties_of(formula):
    """Property factors of a law or of a product of properties, whatever their order."""
    above, below = factors(formula)
    sides = [sorted(to_text(p) for p in side if is_property(p)) for side in (above, below)]
    return tuple(map(tuple, sides))


def is_property(part):
    """Whether a factor is made of properties alone."""
    return bool(part.inputs) and all(map(property_of, part.inputs)) and not part.constants
