"""Rows weighed by the tails of their noise: a gross outlier must not pull on a fit.

Under Student's t a minimum is one of least squares in which every row has the weight that its own
residual gives it (iteratively reweighted least squares): each round raises the likelihood. Rows
that are far off their neighbours have no weight before there is a law to have residuals of.
"""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy import stats

from bsp_gp.data.scene import Dataset
from bsp_gp.fitting.outliers import without_outliers
from bsp_gp.fitting.student import expected_weights, information, log_likelihood, weights_of

ROUNDS = 50
"""Times that rows are weighed; they settle in three to ten."""
SMALL_GAIN = 1e-2
"""Gain of log-likelihood by a round, from which on the weights stay: of a law that is far off every
round gains hardly less than the one before."""
ON_END, AWAY = 7, 0.005
"""Rows on end, of which most are off by more than noise is in this part of all rows: of a hundred
million such only two are so by chance."""


def bears_outliers(model, is_exact):
    """Whether tails can be told from the data, so that they weigh what is far off."""
    is_still = ~np.isfinite(model.levels)
    return not is_exact and bool((model.is_free | is_still).all())


def to_begin_with(dataset: Dataset, model):
    """The data without rows far off their neighbours, where tails will weigh these; or the same."""
    scenes, far_off = without_outliers(dataset.scenes, model.levels)
    return replace(dataset, scenes=scenes) if far_off else dataset


def as_normal(fit):
    """The fit with a residual and noise of the same score and information, and no tails.

    Under Student's t the score of a row is its weight times its residual, of which the variance is
    the expected information (`student.expected_weights`): their ratio is what a row of normal noise
    of that information had left. So what asks a residual for causes needs to know of no tails, and
    no outlier passes for one. It is the same one where it has no tails, and where rows in turn are
    off as noise never is: of what a law lacks so much of, tails would leave nothing.
    """
    model, channels = fit.noise, fit.channels
    if math.isinf(model.degrees) or _is_led_away(model, channels, fit.residual):
        return fit
    share = information(model.degrees)
    wider = (1.0 - model.correlated) / share + model.correlated
    levels = tuple(
        level * math.sqrt(wider) if free else level
        for level, free in zip(model.levels, model.is_free, strict=True)
    )
    noise = replace(
        model, degrees=math.inf, levels=levels, correlated=model.correlated / wider,
        speed_growth=model.speed_growth / math.sqrt(share),
    )  # fmt: skip
    weights = weights_of(model, channels, fit.residual) / expected_weights(model, channels)
    if model.adding:  # each row has its own part of errors that add up
        whitener = noise.whitener(channels)
        residual = whitener.colour(weights * whitener.whiten(fit.residual))
        return replace(fit, noise=noise, residual=np.where(whitener.seen, residual, np.nan))
    return replace(fit, noise=noise, residual=fit.residual * weights)


def _is_led_away(model, channels, residual):
    """Whether most of some rows on end are off on one side by what is much for the noise."""
    scaled = pd.DataFrame(residual / np.array(model.levels)[channels.axis])
    middle = scaled.rolling(ON_END, min_periods=ON_END).median()
    return bool((middle.abs() > stats.t.isf(AWAY, model.degrees)).to_numpy().any())


def weighed(run, climb, minimum, model):
    """The minimum, and its climb, under a noise, every row with the weight that the tails give it.

    It is "unconverged" where the weights do not settle.
    """
    meshes, before = climb.problem.meshes, -math.inf
    for _ in range(ROUNDS):
        channels, residual = run.left_at(climb, minimum)
        reached = log_likelihood(model, channels, residual)
        is_last = math.isinf(model.degrees) or reached - before < SMALL_GAIN or run.is_over()
        before = reached
        climb = climb.with_noises(
            run.noises(model, channels, weights_of(model, channels, residual))
        )
        minimum = climb.again(minimum, meshes, is_last)
        if minimum.linearised is None:
            break
        if is_last:
            return climb, minimum
    return climb, replace(minimum, status="unconverged", code="weights")


def informed(run, climb, minimum, model):
    """The minimum with the linearisation that tells how well it is known."""
    if math.isinf(model.degrees) or minimum.linearised is None:
        return minimum
    channels, _ = run.left_at(climb, minimum)
    noises = run.noises(model, channels, expected_weights(model, channels))
    whole = climb.with_noises(noises).whole(climb.problem.meshes)
    linearised = whole.linearise(minimum.point)
    return minimum if linearised is None else replace(minimum, linearised=linearised)
