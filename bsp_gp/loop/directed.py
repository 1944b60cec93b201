"""Score tests in the directions of common effects, such as drag, a push, another exponent.

Tests of the whole residual have to find an effect in hundreds of numbers. In the direction in which
a known effect would move the tracks it stands in one number, so that much weaker ones are seen (Rao
1948). What constants and initial states can take up is projected out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.errors import BspError
from bsp_gp.language.formula import Call, Constant, Number
from bsp_gp.language.inputs import SHORT
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.arcs import orthonormal_rows
from bsp_gp.loop.declared_exponents import changed_exponents
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term

__all__ = ["directed_test"]

FIELD = {
    "drag, linear in speed": "m_i * v_i",
    "drag, square in speed": "m_i * norm(v_i) * v_i",
    "a push across the velocity": "m_i * perp(v_i)",
    "a push along x": "m_i * e_x",
    "a push along y": "m_i * e_y",
    "a push along z": "m_i * e_z",
}
PAIR = "{0}_i * {0}_j / norm(p_i - p_j)^2 * normalize(p_i - p_j)"
START = 1e-5
"""Strength at which derivatives are taken, in parts of what moves a body across its track."""
BEYOND = 1e-6
"""Part of a direction, squared, that must lie beyond what constants and states can take up."""


def directed_test(observation, fit, blocks, p_of_size):
    """The most significant of the common effects.

    Parameters
    ----------
    observation : Observation
    fit : Fit
        To whole tracks.
    blocks : list of tuple
        Of `Observation.track_blocks`.
    p_of_size : callable
        ``p_of_size(square, dof)``.

    Returns
    -------
    name : str
    p_value : float
        With the number of effects that were tried counted; 1 where none could be.
    n_tried : int
    """
    effects = _effects(observation, fit)
    names = list(effects)
    if not names:
        return "", 1.0, 0
    law = fit.whole.law
    for k, term in enumerate(effects.values()):
        law = law.plus(term, {f"d{k}": START})
    extra = tuple((f"d{k}", "") for k in range(len(names)))
    whole = replace(
        fit.whole, law=law, parameters=fit.whole.parameters + extra,
        values=np.append(fit.whole.values, np.full(len(names), START)),
    )  # fmt: skip
    residual, taken, rows = [], [], []
    n_own = len(fit.whole.parameters)
    for (flat, _, _), (_, by_constant, by_state) in zip(
        blocks, observation.track_blocks(whole), strict=True
    ):
        for s in range(len(flat)):
            q = orthonormal_rows(by_state[s])
            free = by_constant[s] - (by_constant[s] @ q.T) @ q
            residual.append(flat[s] - (q @ flat[s]) @ q)
            taken.append(free[:n_own])
            rows.append((free[n_own:], np.square(by_constant[s][n_own:]).sum(axis=1)))
    residual = np.concatenate(residual)
    sizes = sum(size for _, size in rows)
    rows = np.concatenate([free for free, _ in rows], axis=1)
    q = orthonormal_rows(np.concatenate(taken, axis=1))
    rows = rows - (rows @ q.T) @ q
    best, n_tried = ("", 1.0), 0
    for name, row, size in zip(names, rows, sizes, strict=True):
        beyond = float(row @ row)
        if np.isfinite(beyond) and beyond > BEYOND * size > 0:
            n_tried += 1
            p = p_of_size(float(row @ residual) ** 2 / beyond, 1)
            best = min(best, (name, p), key=lambda item: item[1])
    return best[0], min(1.0, n_tried * best[1]), n_tried


def _effects(observation, fit):
    """Effects that these data can speak of: terms of typical size, by name."""
    dataset, law = observation.dataset, fit.whole.law
    types = dataset_types(dataset)
    texts = dict(FIELD)
    for column in dataset.property_names:
        short = SHORT.get(column, column)
        if column != "mass":
            texts[f"a push across the velocity by {column}"] = f"{short}_i * perp(v_i)"
        if observation.sources:
            texts[f"a force between bodies by {column}"] = PAIR.format(short)
    if dataset.n_dims != 2:  # across the velocity lies a plane
        texts = {name: text for name, text in texts.items() if "perp" not in text}
    out = {}
    for name, text in texts.items():
        try:
            formula = parse_formula(text, types, units=dataset.units)
        except BspError:
            continue  # what it names is not in these data
        out[name] = Term(formula)
    for base, term in changed_exponents(observation, law):
        out[f"another exponent of {base}"] = term
    scale = _typical_acceleration(observation)
    made = {}
    for name, term in out.items():
        size = _size(observation, term, law)
        if np.isfinite(size) and size > 0:
            unit = Call("mul", Number(scale / size), term.formula)
            formula = Call("mul", Constant(f"d{len(made)}"), unit)
            made[name] = Term(formula, term.kind)
    return made


def _typical_acceleration(observation):
    """What takes a body across its track within the time of the track."""
    values = []
    for scene in observation.train:
        moved = scene.positions[:, scene.dynamic]
        extent = np.nanmax(moved, axis=0) - np.nanmin(moved, axis=0)
        values.append(np.nanmax(extent) / np.ptp(scene.times) ** 2)
    return float(np.median(values)) or 1.0


def _size(observation, term, law):
    """Root mean square of the acceleration of a term."""
    total, n = 0.0, 0
    lone = ForceLaw((term,), {c: law.constants[c] for c in term.formula.constants})
    with np.errstate(all="ignore"):
        for batch in observation.train_regression.batches:
            value = observation.train_regression.predict(batch, lone)
            value = value[batch.valid.any(axis=-1)]
            total, n = total + float(np.square(value).sum()), n + len(value)
    return float(np.sqrt(total / n)) if n else 0.0
