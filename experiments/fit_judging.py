"""Fits of made worlds held against the truth: one row for each."""

import time

import numpy as np
from fit_reference import reference
from fit_tracks import bound, dataset_of, misfit_gap
from scipy.stats import chi2, norm

from bsp_gp.errors import BspError

FAILED = ("nonfinite", "unconverged", "aliased")
"""Statuses of a fit that is none."""
QUANTILE = 0.999
SE_RATIO = 1.2
FAULTS = (BspError, ArithmeticError, ValueError)
"""What counts as a failed fit, and does not end a study."""


def fitted(dataset, laws, *, starts=None, bounds=None, deadline=None):
    """Fit laws to a data set.

    Returns
    -------
    fit : Fit or None
    facts : dict
        status (the error where there is no fit), seconds, starts that agree.
    """
    from bsp_gp.fitting.fit import fit
    from bsp_gp.fitting.hypothesis import Hypothesis

    began, wall = time.process_time(), time.perf_counter()
    try:
        found = fit(
            Hypothesis.from_laws(dataset, list(laws)), dataset, starts=starts or None,
            bounds=bounds or None, deadline=deadline,
        )  # fmt: skip
        facts = {
            "status": found.status, "n_starts": found.n_starts, "n_agree": found.n_agree,
            "chi2_red": found.chi2_red, "error": "",
        }  # fmt: skip
    except FAULTS as error:
        found, facts = None, {"status": "raised", "error": f"{type(error).__name__}: {error}"[:300]}
    facts["cpu_s"] = time.process_time() - began
    facts["wall_s"] = time.perf_counter() - wall
    return found, facts


def is_fit(found):
    return found is not None and found.status not in FAILED and np.isfinite(found.values).all()


def constants_of(found, world):
    """Values and covariance in the order of the truth, with the truth's signs."""
    names = [name for name, _ in found.parameters]
    order = [names.index(name) for name in world.truth]
    values = np.asarray(found.values, dtype=float)[order]
    covariance = np.array(found.covariance, dtype=float)[np.ix_(order, order)]
    signs = np.ones(len(order))
    if world.mirror:
        places = [list(world.truth).index(name) for name in world.mirror]
        # The last of them is a rate: its sign is what a person would choose.
        if values[places[-1]] * world.values[places[-1]] < 0:
            signs[places] = -1.0
    return values * signs, covariance * np.outer(signs, signs)


def distance(difference, covariance):
    """Chi-squared of a difference; nan where the covariance is none."""
    size = np.sqrt(np.diag(covariance))
    if not (np.isfinite(covariance).all() and (size > 0).all()):
        return np.nan
    scaled = covariance / np.outer(size, size)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] <= 0:
        return np.nan
    return float(np.sum((vectors.T @ (difference / size)) ** 2 / values))


def noise_level(found, axis=0):
    """The fitted standard deviation of white noise along an axis, m."""
    return float(found.noise.levels[axis])


# --- judges: world, rng, deadline -> row ----------------------------------------------------------


def judge_bound(world, rng, deadline):
    """Against the truth and the Cramér-Rao bound: is it the right minimum, with the right errors?

    A minimum is wrong if the joint chi-squared of the constants is beyond its quantile and the
    world's own track fits worse with them than with the true ones.
    """
    return _against_truth(world, rng, deadline)[0]


def judge_within(name, n_sd):
    """A judge that asks one constant alone to be within so many of its standard errors."""

    def judge(world, rng, deadline):
        row, found, values, covariance = _against_truth(world, rng, deadline)
        if values is not None:
            k = list(world.truth).index(name)
            row["deviation"] = float((values - world.values)[k] / np.sqrt(covariance[k, k]))
            row["passed"] = bool(is_fit(found) and abs(row["deviation"]) <= n_sd)
        return row

    return judge


def _against_truth(world, rng, deadline):
    """The row, the fit, and the constants with their covariance (None where there are none)."""
    dataset = dataset_of(world, rng)
    limits = bound(world)
    found, row = fitted(
        dataset, world.laws, starts=world.starts, bounds=world.bounds, deadline=deadline
    )
    row |= {**world.facts, "kind": world.kind, "passed": False, "wrong_converged": False}
    if found is None or not np.isfinite(found.values).all():
        return row, found, None, None
    values, covariance = constants_of(found, world)
    with np.errstate(invalid="ignore"):
        ratios = np.sqrt(np.diag(covariance) / np.diag(limits))
    limit = float(chi2.ppf(QUANTILE, len(values)))
    joint = distance(values - world.values, covariance)
    row |= {
        "chi2": joint, "chi2_limit": limit, "chi2_bound": distance(values - world.values, limits),
        "se_ratio": float(ratios.max()), "se_ratio_least": float(ratios.min()),
        "worst_rel": float(np.abs(values / world.values - 1).max()),
    }  # fmt: skip
    is_near = joint <= limit
    row["passed"] = bool(is_fit(found) and is_near and ratios.max() <= SE_RATIO)
    if not is_near or row["chi2_bound"] > limit:
        row["misfit_gap"] = misfit_gap(world, dataset, values)
        is_called_good = found.status in ("converged", "at_bound")
        row["wrong_converged"] = bool(is_called_good and row["misfit_gap"] > 0)
    return row, found, values, covariance


def judge_agreement(case, rng, deadline):
    """Against scipy's least squares from the truth: values and standard errors."""
    world = case.world
    dataset = dataset_of(world, rng)
    found, row = fitted(dataset, world.laws, bounds=world.bounds, deadline=deadline)
    row |= {"passed": False, "right_status": row["status"] in case.status}
    if found is None or not np.isfinite(found.values).all():
        return row
    values, covariance = constants_of(found, world)
    other = reference(world, dataset)
    weights = np.array(list(case.compared.values()))
    own_se = np.sqrt([_variance(w, covariance) for w in weights])
    asked = np.isfinite(own_se) | (np.count_nonzero(weights, axis=1) == 1)
    se = np.sqrt([w @ other.covariance @ w for w in weights])
    row |= {
        "value_gap_se": float(np.abs(weights @ (values - other.values) / se).max()),
        "se_gap": float(np.abs(own_se / se - 1)[asked].max()),
    }
    row["passed"] = bool(
        row["right_status"] and row["value_gap_se"] <= 1e-3 and row["se_gap"] <= 0.01
    )
    return row


def _variance(weights, covariance):
    """Of a combination; of one whose members are not determined one by one it is not asked."""
    used = weights != 0
    part = covariance[np.ix_(used, used)]
    return weights[used] @ part @ weights[used] if np.isfinite(part).all() else np.nan


def judge_noise(world, rng, deadline):
    """With and without the last law: the noise level of both, and which of them wins."""
    dataset = dataset_of(world, rng)
    true = float(np.max(world.shots[0].sigma))
    row = {"kind": world.kind, **world.facts, "passed": False}
    evidence = {}
    for label, laws in (("with", world.laws), ("without", world.laws[:-1])):
        found, facts = fitted(dataset, laws, deadline=deadline)
        row |= {f"{key}_{label}": value for key, value in facts.items()}
        if is_fit(found):
            row[f"level_{label}"] = noise_level(found) / true
            evidence[label] = float(found.log_evidence)
    if len(evidence) == 2:
        row["gain"] = evidence["with"] - evidence["without"]
        row["level_right"] = bool(abs(row["level_with"] - 1) <= 0.1)
        row["both_right"] = bool(row["level_right"] and abs(row["level_without"] - 1) <= 0.1)
        row["passed"] = bool(row["both_right"] and row["gain"] > 0)
    return row


def calibrated(world, rng, deadline):
    """Ranks of the true constants in the fitted Gaussian, uniform if it is a posterior."""
    dataset = dataset_of(world, rng)
    found, row = fitted(dataset, world.laws, bounds=world.bounds, deadline=deadline)
    row |= {"kind": world.kind, "passed": False}
    if is_fit(found):
        values, covariance = constants_of(found, world)
        se = np.sqrt(np.diag(covariance))
        row["passed"] = bool((np.isfinite(se) & (se > 0)).all())
    if row["passed"]:
        z = (world.values - values) / se
        row |= {f"rank_{name}": float(norm.cdf(v)) for name, v in zip(world.truth, z, strict=True)}
        row["chi2"] = distance(values - world.values, covariance)
    return row
