"""Score tests in the directions of common effects, such as drag, a push, another exponent.

Tests of the whole residual have to find an effect in hundreds of numbers. In the direction in which
a known effect would move the tracks it stands in one number, so that much weaker ones are seen (Rao
1948). What constants and initial states can take up is projected out. Two or three effects at once
stand in the plane or space of their directions.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bsp_gp.errors import BspError
from bsp_gp.language.formula import Call, Constant, Number
from bsp_gp.language.inputs import SHORT
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.arcs import orthonormal_rows
from bsp_gp.loop.declared_exponents import changed_exponents
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, split_linear

__all__ = ["Direction", "directed_test"]

MOST_AT_ONCE = 3
"""Common effects that are looked for together."""
MOST_TOLD = 8
"""Sets of effects of a size that are kept, the most significant first."""
INDEPENDENT = 1e-4
"""Least eigenvalue, of 1 in all, at which directions are told apart."""

FIELD = {
    "drag, linear in speed": "c1 * (norm(v_i) * normalize(v_i))",
    "drag, square in speed": "c1 * (norm(v_i)^2 * normalize(v_i))",
    "a push across the velocity": "c1 * (norm(v_i) * perp(normalize(v_i)))",
    "a push along x": "c1 * e_x",
    "a push along y": "c1 * e_y",
    "a push along z": "c1 * e_z",
    "Coulomb friction": "c1 * (m_i * normalize(v_i))",
}
"""On one body alone."""
BETWEEN = {
    "an elastic pull between bodies": "c1 * (norm(p_i - p_j) * normalize(p_i - p_j))",
    "a loss of speed at contacts": "c1 * (along(v_i - v_j, p_i - p_j) * normalize(p_i - p_j)"
                                   " * does_collide(s_i, p_i, s_j, p_j))",
    "Coulomb friction on a mat": "c1 * (m_i * mu_j * normalize(v_i) * is_on(s_i, p_i, s_j, p_j))",
}  # fmt: skip
"""Between two bodies, whatever their properties. All as the grammar writes them, so that one law
has one text."""
ACROSS = "c1 * ({0}_i * norm(v_i) * perp(normalize(v_i)))"
PAIR = "c1 * ({0}_i * {0}_j * inverse(norm(p_i - p_j)^2) * normalize(p_i - p_j))"
START = 1e-5
"""Strength at which derivatives are taken, in parts of what moves a body across its track."""
BEYOND = 1e-6
"""Part of a direction, squared, that must lie beyond what constants and states can take up."""


class Direction(NamedTuple):
    """A common effect, or several at once, and how much the residual speaks for it.

    Attributes
    ----------
    name : str
    laws : tuple of str
        Of the effects as forces, each with the constant c1; empty for another exponent of a
        declared term.
    p_value : float
        With the number of effects, or sets of as many effects, that were tried counted.
    n_tried : int
    base : str
        Whose exponent it is; "" for a force.
    """

    name: str
    laws: tuple
    p_value: float
    n_tried: int
    base: str = ""


def directed_test(observation, fit, blocks, p_of_size):
    """Common effects, the most significant first.

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
    single : tuple of Direction
        Without those that these data cannot show.
    together : tuple of Direction
        Two forces at once, then three.
    """
    effects = _effects(observation, fit.whole.law)
    if not effects:
        return (), ()
    law = fit.whole.law
    for k, (*_, term) in enumerate(effects):
        law = law.plus(term, {f"d{k}": START})
    extra = tuple((f"d{k}", "") for k in range(len(effects)))
    whole = replace(
        fit.whole, law=law, parameters=fit.whole.parameters + extra,
        values=np.append(fit.whole.values, np.full(len(effects), START)),
    )  # fmt: skip
    residual, taken, rows, sizes = [], [], [], 0.0
    n_own = len(fit.whole.parameters)
    for (flat, _, _), (_, by_constant, by_state) in zip(
        blocks, observation.track_blocks(whole), strict=True
    ):
        for s in range(len(flat)):
            q = orthonormal_rows(by_state[s])
            free = by_constant[s] - (by_constant[s] @ q.T) @ q
            residual.append(flat[s] - (q @ flat[s]) @ q)
            taken.append(free[:n_own])
            rows.append(free[n_own:])
            with np.errstate(over="ignore"):
                sizes = sizes + np.square(by_constant[s][n_own:]).sum(axis=1)
    residual, rows = np.concatenate(residual), np.concatenate(rows, axis=1)
    q = orthonormal_rows(np.concatenate(taken, axis=1))
    is_finite = np.isfinite(sizes) & np.isfinite(rows).all(axis=1)
    rows = np.where(is_finite[:, None], rows, 0.0)  # tracks that run away show no effect
    rows = rows - (rows @ q.T) @ q
    size_beyond = np.einsum("kn,kn->k", rows, rows)
    seen = is_finite & (size_beyond > BEYOND * sizes) & (sizes > 0)
    effects = [effect for effect, is_seen in zip(effects, seen, strict=True) if is_seen]
    rows = rows[seen] / np.sqrt(size_beyond[seen])[:, None]
    scores, overlaps = rows @ residual, rows @ rows.T
    single = _ranked(effects, [(k,) for k in range(len(effects))], scores, overlaps, p_of_size)
    forces = [k for k, (_, text, *_) in enumerate(effects) if text]
    together = ()
    for n in range(2, MOST_AT_ONCE + 1):
        sets = _ranked(effects, combinations(forces, n), scores, overlaps, p_of_size)
        together += sets[:MOST_TOLD]
    return single, together


def _ranked(effects, sets, scores, overlaps, p_of_size):
    """Sets of effects of one size as Directions, the most significant first."""
    found = []
    for members in map(list, sets):
        values, vectors = np.linalg.eigh(overlaps[np.ix_(members, members)])
        if values[0] > INDEPENDENT:
            square = float(np.sum((vectors.T @ scores[members]) ** 2 / values))
            found.append((square, members))
    found.sort(key=lambda item: -item[0])  # p-values of clear effects are all 0
    out, n = [], len(found)
    for square, members in found:
        names, texts, bases, _ = zip(*(effects[k] for k in members), strict=True)
        p_value = float(np.minimum(1.0, n * p_of_size(square, len(members))))
        laws = tuple(text for text in texts if text)
        out.append(Direction(" and ".join(names), laws, p_value, n, bases[0]))
    return tuple(out)


def _effects(observation, law):
    """Effects that these data can speak of: (name, text, base, term of typical size)."""
    dataset = observation.dataset
    types = dataset_types(dataset)
    texts = {**FIELD, **(BETWEEN if observation.sources else {})}
    for column in dataset.property_names:
        short = SHORT.get(column, column)
        if column != "mass":
            texts[f"a push across the velocity by {column}"] = ACROSS.format(short)
        if observation.sources:
            texts[f"a force between bodies by {column}"] = PAIR.format(short)
    if dataset.n_dims != 2:  # across the velocity lies a plane
        texts = {name: text for name, text in texts.items() if "perp" not in text}
    found = []
    for name, text in texts.items():
        try:
            formula = parse_formula(text, types, units=dataset.units)
        except BspError:
            continue  # what it names is not in these data
        found.append((name, text, "", Term(split_linear(formula)[1])))
    for base, term in changed_exponents(observation, law):
        found.append((f"another exponent of {base}", "", base, term))
    scale, out = _typical_acceleration(observation), []
    for *names, term in found:
        size = _size(observation, term, law)
        if np.isfinite(size) and size > 0:
            unit = Call("mul", Number(scale / size), term.formula)
            formula = Call("mul", Constant(f"d{len(out)}"), unit)
            out.append((*names, Term(formula, term.kind)))
    return out


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
