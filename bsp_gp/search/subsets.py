"""Best sets of terms: a wide beam over the Gram matrix of many candidate columns.

Greedy addition can take a proxy first (a |v|^3 for a 1/r^3) and never part with it. With the
whitened columns of all plausible terms at hand, sets of k terms cost only small matrix algebra,
so that a set is revised as a whole.
"""

import numpy as np

EXTENSIONS = 150
"""Best columns by which every set of the beam is extended."""


def best_subsets(columns, target, size, *, beam=1000, keep=40):
    """Find sets of columns that explain most of a target, refitted jointly.

    Parameters
    ----------
    columns : ndarray, shape (n, m)
        Nuisance terms already projected out.
    target : ndarray, shape (n,)
        Likewise.
    size : int
        Greatest number of columns in a set. All single columns are scored; the best `beam` sets
        of each size are extended by their `EXTENSIONS` best columns.
    keep : int
        Sets returned of each size.

    Returns
    -------
    dict of int to list of (loss, tuple of int)
        For each size, half the residual sum of squares of the best sets, lowest first; indices
        ascending.
    """
    norms = np.linalg.norm(columns, axis=0)
    live = np.flatnonzero((norms > 0) & np.isfinite(norms))
    unit = columns[:, live] / norms[live]
    gram = unit.T @ unit
    dots = unit.T @ target
    sets = np.zeros((1, 0), dtype=int)
    out = {}
    for count in range(1, size + 1):
        sets = _extend(gram, dots, sets, beam)
        if not len(sets):
            break
        # One round of swaps: every member of the best sets is tried to be replaced by any column.
        cores = np.unique(
            np.concatenate([np.delete(sets[:keep], k, axis=1) for k in range(count)]), axis=0
        )
        swapped = _extend(gram, dots, cores, 4 * keep)
        both = np.unique(np.concatenate([sets[: 4 * keep], swapped]), axis=0)
        out[count] = _exact_losses(unit, target, both, live)[:keep]
    return out


def _exact_losses(unit, target, sets, live):
    out = []
    for chosen in sets:
        coefficients, *_ = np.linalg.lstsq(unit[:, chosen], target, rcond=None)
        residual = target - unit[:, chosen] @ coefficients
        out.append((0.5 * float(residual @ residual), tuple(sorted(live[chosen].tolist()))))
    return sorted(out)


def _extend(gram, dots, sets, beam):
    """Every set plus every column, best `beam` by explained sum of squares, duplicates merged."""
    n_columns = len(dots)
    found_sets, found_gains = [], []
    for chosen in sets:
        inner = gram[np.ix_(chosen, chosen)]
        cross = gram[:, chosen]
        solved = (
            np.linalg.lstsq(inner, np.column_stack([cross.T, dots[chosen]]), rcond=1e-13)[0]
            if len(chosen)
            else np.zeros((0, n_columns + 1))
        )
        base = float(dots[chosen] @ solved[:, -1]) if len(chosen) else 0.0
        left = 1.0 - np.einsum("mk,km->m", cross, solved[:, :n_columns])
        reach = dots - cross @ solved[:, -1]
        gain = np.where(left > 1e-9, base + reach**2 / np.where(left > 1e-9, left, 1.0), -np.inf)
        gain[chosen] = -np.inf
        top = np.argsort(-gain, kind="stable")[:EXTENSIONS]
        top = top[np.isfinite(gain[top])]
        found_sets.append(np.column_stack([np.tile(chosen, (len(top), 1)), top]))
        found_gains.append(gain[top])
    all_sets = np.sort(np.concatenate(found_sets), axis=1)
    all_gains = np.concatenate(found_gains)
    order = np.argsort(-all_gains, kind="stable")
    if len(order) > 4 * beam:
        order = order[: 4 * beam]
    unique, first = np.unique(all_sets[order], axis=0, return_index=True)
    rank = np.argsort(first)[:beam]
    return unique[rank]
