"""The weak form on one track: runs of rows, test functions, quadrature, whitening.

A test function is linear between the rows of a track, so that its second derivative is a comb at
the rows and the integral of the track against it needs no interpolation of positions, whatever
the times, and none across impulses either. The comb is what is chosen smooth and compact: a
combination of three neighbouring cubic B-splines, weighed by the accuracy of the rows, that sees
no straight motion; the test function, its second integral, is then compact as well, and smoother
than a cubic spline. Together the test functions of one width see of the track just what a least
squares spline sees of it beyond a straight line, so that no accuracy is lost to uneven times.

What is left to quadrature is the integral of the law: the product of the test function and a
local cubic through the law's values is integrated exactly (product integration; on even times the
rule of Numerov and its kin). Where velocities are measured one integration by parts is enough:
two neighbouring splines that see no constant velocity, and test functions that are constant
between rows.
"""

import itertools
from dataclasses import dataclass

import numpy as np

DEGREE = 3
RANK_CUT = 1e-10
"""Test functions (of unit size) whose part independent of the others is below this are left out."""
COMB_CUT = 1e-7
"""Combinations of splines that cancel to this part are rounding."""
_GAUSS = np.polynomial.legendre.leggauss(3)
"""Exact for the product of a linear test function and a cubic."""


@dataclass(frozen=True)
class Run:
    """Rows of a track, `nodes`, over which test functions may reach.

    The law is evaluated at the places `inner` among them.
    """

    nodes: np.ndarray
    inner: np.ndarray


def runs_of(times, seen, usable, limit, is_measured=False):
    """Part a track into runs.

    Parameters
    ----------
    times : ndarray, shape (T,)
    seen : ndarray of bool, shape (T,)
        Rows with a position (a velocity, if measured); others are bridged or part the track.
    usable : ndarray of bool, shape (T,)
        Rows at which the law can be evaluated. Test functions are 0 at seen rows that are not.
    limit : float
        Longest step between two rows that is bridged, s.
    is_measured : bool
        Whether velocities are measured; the law is then needed at the ends of a run as well.
    """
    out = []
    rows = np.flatnonzero(seen)
    if not len(rows):
        return out
    for part in np.split(rows, np.flatnonzero(np.diff(times[rows]) > limit) + 1):
        live = usable[part].copy()
        if not is_measured:
            live[[0, -1]] = False
        for places in np.split(np.arange(len(part)), np.flatnonzero(np.diff(live)) + 1):
            if not live[places[0]]:
                continue
            if is_measured:
                if len(places) > 1:
                    out.append(Run(part[places], np.arange(len(places))))
            else:
                nodes = part[places[0] - 1 : places[-1] + 2]
                out.append(Run(nodes, np.arange(1, len(nodes) - 1)))
    return out


def knots_of(times, spacing):
    """Knots of cubic splines over a run, repeated at its ends."""
    n_parts = max(int(round((times[-1] - times[0]) / spacing)), 1)
    inner = np.linspace(times[0], times[-1], n_parts + 1)
    return np.concatenate([[inner[0]] * DEGREE, inner, [inner[-1]] * DEGREE])


def reach_of(is_measured=False):
    """Knot intervals over which a test function reaches: three splines, or two, side by side."""
    return DEGREE + (2 if is_measured else 3)


def design(times, knots):
    """Values of all B-splines at some times, shape (n, K)."""
    from scipy.interpolate import BSpline

    return BSpline.design_matrix(times, knots, DEGREE).toarray()


def combs(times, spacing, sigma, is_measured=False):
    """Weights of the rows of a run in the test functions, (K, n).

    Those of positions are blind to straight motion, of measured velocities to a constant one.

    Parameters
    ----------
    times : ndarray, shape (n,)
    spacing : float
        Between the knots of the splines, s. 0: the narrowest test functions, as many as there are.
    sigma : ndarray, shape (n,)
    """
    n = len(times)
    n_blind = 1 if is_measured else 2
    if not spacing:
        return np.diff(np.eye(n), axis=0) if is_measured else second_differences(times)
    splines = design(times, knots_of(times, spacing)).T * (np.min(sigma) / sigma) ** 2
    splines = splines[splines.sum(axis=1) > RANK_CUT]  # knots without rows between them
    out = []
    for k in range(len(splines) - n_blind):
        some = splines[k : k + n_blind + 1]
        a = some.sum(axis=1)
        # Times from the middle of the three, so that nothing cancels that need not.
        places = times - (some @ times).sum() / a.sum()
        if is_measured:
            mix = [a[1], -a[0]]
        else:
            b = some @ places
            mix = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        comb = np.asarray(mix) @ some
        # Splines that share too few rows leave rounding.
        if np.linalg.norm(comb) > COMB_CUT * np.abs(mix) @ np.linalg.norm(some, axis=1):
            blind = _blinded(comb, places, n_blind)
            if np.linalg.norm(blind) > COMB_CUT * np.linalg.norm(comb):
                out.append(blind)
    return np.array(out).reshape(len(out), n)


def _blinded(comb, places, n_blind):
    """A comb less the rounding by which it is not blind, so that this is no function of its own."""
    rows = np.flatnonzero(comb)
    basis = np.stack([np.ones(len(rows)), places[rows]], axis=1)[:, :n_blind]
    basis, _ = np.linalg.qr(basis)
    out = np.zeros(len(comb))
    out[rows] = comb[rows] - basis @ (basis.T @ comb[rows])
    return out


def second_differences(times):
    """Rows of second differences: the combs of hat functions, shape (n - 2, n)."""
    before, after = np.diff(times)[:-1], np.diff(times)[1:]
    n = len(times) - 2
    matrix = np.zeros((n, n + 2))
    rows = np.arange(n)
    matrix[rows, rows] = 1 / before
    matrix[rows, rows + 2] = 1 / after
    matrix[rows, rows + 1] = -(1 / before + 1 / after)
    return matrix


def values_of_combs(comb, times, is_measured=False):
    """Test functions whose last derivative is the comb: at inner rows, (K, n - 2).

    Where velocities are measured, on every step, (K, n - 1).
    """
    slopes = np.cumsum(comb, axis=1)[:, :-1]
    if is_measured:
        return -slopes
    return np.cumsum(slopes * np.diff(times), axis=1)[:, :-1]


def quadrature(times, is_measured, is_stepped):
    """Weights, (places, inner rows), of a law's values in integrals against hats or steps.

    Parameters
    ----------
    is_stepped : bool
        The motion was made by steps: a force acts at the rows alone, for the mean of two steps.
    """
    n = len(times)
    if is_stepped:
        return np.diag((times[2:] - times[:-2]) / 2)
    inner = times if is_measured else times[1:-1]
    width = min(DEGREE + 1, len(inner))
    steps = np.arange(n - 1)
    h = np.diff(times)[:, None]
    # The nearest values of the law on either side of every step.
    first = np.clip(steps - (0 if is_measured else 1) - (width // 2 - 1), 0, len(inner) - width)
    near = first[:, None] + np.arange(width)
    fractions = (_GAUSS[0] + 1) / 2
    basis = _lagrange(inner[near], times[:-1, None] + h * fractions)
    basis = basis * (_GAUSS[1] / 2 * h)[..., None]  # (steps, places, width)
    if is_measured:
        weights = np.zeros((n - 1, n))
        weights[steps[:, None], near] = basis.sum(axis=1)
        return weights
    weights = np.zeros((n, n - 2))
    weights[steps[:, None], near] += np.einsum("q,kqw->kw", 1 - fractions, basis)
    weights[steps[:, None] + 1, near] += np.einsum("q,kqw->kw", fractions, basis)
    return weights[1:-1]


def _lagrange(nodes, at):
    """Values (k, q, w) at places (k, q) of the polynomials that are 1 at one node of (k, w)."""
    out = np.ones((*at.shape, nodes.shape[1]))
    for one, other in itertools.permutations(range(nodes.shape[1]), 2):
        gap = nodes[:, one] - nodes[:, other]
        out[..., one] *= (at - nodes[:, other, None]) / gap[:, None]
    return out


@dataclass(frozen=True)
class Track:
    """Whitened test functions of one track.

    Attributes
    ----------
    observe : ndarray, shape (K, T)
        Applied to the positions (velocities, if measured) of all rows, nan as 0.
    predict : ndarray, shape (K, T)
        Applied to the accelerations of a law at all rows.
    inner : ndarray of bool, shape (T,)
        Rows at which the law is asked for.
    """

    observe: np.ndarray
    predict: np.ndarray
    inner: np.ndarray

    @classmethod
    def of(cls, times, runs, spacing, sigma, *, is_measured=False, is_stepped=False):
        """Whiten the test functions of all runs of a track together.

        Parameters
        ----------
        times : ndarray, shape (T,)
        spacing : float
            See `combs`.
        sigma : ndarray, shape (T,)
            Standard deviations of the positions (velocities).
        """
        blocks, whitener, kept, observe = _observing(times, runs, spacing, sigma, is_measured)
        inner = np.zeros(len(times), dtype=bool)
        law = [np.zeros((0, len(times)))]
        for run, block in zip(runs, blocks, strict=True):
            t = times[run.nodes]
            inner[run.nodes[run.inner]] = True
            values = values_of_combs(block[:, run.nodes], t, is_measured)
            law.append(np.zeros(block.shape))
            law[-1][:, run.nodes[run.inner]] = values @ quadrature(t, is_measured, is_stepped)
        return cls(whitener @ observe, whitener @ np.concatenate(law)[kept], inner)


def seen_through(times, runs, spacing, sigma, values, is_measured=False):
    """What whitened test functions see of some values (T, k): shape (K, k), see `Track.of`."""
    _, whitener, _, observe = _observing(times, runs, spacing, sigma, is_measured)
    return whitener @ (observe @ values)


def _observing(times, runs, spacing, sigma, is_measured):
    """Combs of every run, what whitens them, which of all are independent, and those."""
    blocks = _blocks(times, runs, spacing, sigma, is_measured)
    data = np.concatenate([np.zeros((0, len(times))), *blocks])
    whitener, kept = _whitener(data * sigma)
    return blocks, whitener, kept, data[kept]


def _blocks(times, runs, spacing, sigma, is_measured):
    """Combs of every run, of unit size, over all rows of the track."""
    out = []
    for run in runs:
        comb = combs(times[run.nodes], spacing, sigma[run.nodes], is_measured)
        out.append(np.zeros((len(comb), len(times))))
        sizes = np.linalg.norm(comb, axis=1, keepdims=True)
        out[-1][:, run.nodes] = comb / np.where(sizes > 0, sizes, 1.0)
    return out


def _whitener(noise):
    """Inverse Cholesky factor of noise @ noise.T on the rows that are independent, and these."""
    from scipy.linalg import qr, solve_triangular

    sizes = np.linalg.norm(noise, axis=1)
    kept = np.flatnonzero(sizes > 0)
    if not len(kept):
        return np.zeros((0, 0)), kept
    # By an orthogonal factor of the noise itself: its square would have the square condition.
    unit = noise[kept] / sizes[kept, None]
    triangle, pivots = qr(unit.T, mode="r", pivoting=True, check_finite=False)
    size = np.abs(np.diag(triangle))
    independent = np.sort(pivots[: int(np.sum(size > RANK_CUT * size[0]))])
    (triangle,) = qr(unit[independent].T, mode="r", check_finite=False)
    triangle = triangle[: len(independent)]
    triangle = triangle * np.sign(np.diag(triangle))[:, None]
    kept = kept[independent]
    # In the order of time, lower triangular: every row is news beyond those before it.
    return solve_triangular(triangle.T, np.diag(1 / sizes[kept]), lower=True), kept
