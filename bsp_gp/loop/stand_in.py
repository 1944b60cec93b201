"""States of a track that is led by what was traced, for exponents without a bias of smoothing.

A model that lacks much leads its tracks far astray, and smoothing what it leaves rounds off sharp
turns. So the power law of a channel is added to the model as a stand-in, whole tracks are fitted
again, and the residual of the model alone is looked at along them.
"""

from __future__ import annotations

import numpy as np

from bsp_gp.errors import BspError
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.naming import fresh_name
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term

__all__ = ["fit_with_stand_in", "law_text"]

MAX_MISFIT, MAX_PART = 3.0, 0.02
"""Mean square of whitened positions, or part of the model's own sum of squares, up to which a track
counts as led near to the truth."""
_SIZES = {"speed": "norm(v_i)", "distance": "norm(p_i - p_j)", "stretch": "(norm(p_i - p_j) - l_j)"}


def law_text(direction, scaling, exponents, name):
    """The power law of a channel as a law, "" where the language has no words for it.

    Parameters
    ----------
    direction : Direction
    scaling : Scaling
    exponents : ndarray
        Of its quantities.
    name : str
        Of its constant.
    """
    if not direction.vector:
        return ""
    parts = [name]
    for exponent, quantity in zip(exponents, scaling.quantities, strict=True):
        if abs(exponent) < 5e-4:
            continue
        size = quantity.name if quantity.is_property else _SIZES.get(quantity.name, "")
        of_pair = quantity.name in ("distance", "stretch")
        if not size or (of_pair and direction.kind != "line"):
            return ""
        if quantity.signs is not None:
            # A power of a negative number is none; a plain factor is near enough.
            parts.append(size)
        else:
            size = f"abs({size})" if quantity.is_property else size
            parts.append(f"{size}^{exponent:.3f}" if exponent > 0 else f"{size}^({exponent:.3f})")
    return " * ".join([*parts, direction.vector])


def fit_with_stand_in(observation, fit, direction, scaling, exponents):
    """The model with the power law of a channel, fitted to whole tracks; None if it cannot be.

    Parameters
    ----------
    observation : Observation
    fit : Fit
        Of the model without it.
    direction : Direction
    scaling : Scaling
        With one amplitude for all tracks.
    exponents : ndarray

    Returns
    -------
    Fit or None
    """
    if fit.whole is None:
        return None
    name = fresh_name(fit.law)
    text = law_text(direction, scaling, exponents, name)
    if not text:
        return None
    dataset = observation.dataset
    try:
        formula = parse_formula(text, dataset_types(dataset), units=dataset.units)
        law = fit.law.plus(Term(formula), {name: 0.0})
        with np.errstate(over="ignore", invalid="ignore"):  # trial tracks may run away
            found = observation.fit_beyond(law, fit)
    except BspError:
        return None  # a power that is not finite somewhere: the states stay as they were
    is_near = found.chisqr <= max(MAX_MISFIT * found.n_rows, MAX_PART * fit.chisqr)
    return found if is_near and found.chisqr < fit.chisqr else None
