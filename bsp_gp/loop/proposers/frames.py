"""A frame that turns: Coriolis and centrifugal forces as one cause with one Omega."""

from itertools import combinations_with_replacement

import numpy as np
from scipy.optimize import least_squares

from bsp_gp.fitting.frames import expanded
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.proposers.libraries import extent_of
from bsp_gp.loop.view import gains
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_name, fresh_names
from bsp_gp.search.columns import orthonormal

FARTHEST = 30.0
"""Extents of the tracks beyond them, within which a frame turns about a point: about one that is
farther away it is a steady push, which everything on Earth has."""


class Frames:
    """Rotating frames as a proposer: about the origin, and about a point that is fitted."""

    name = "frames"

    def propose(self, view):
        """The family of both.

        An accelerated frame is a push in proportion to mass, which laws and periods propose; on
        one line what turns is a push away from a place.
        """
        is_line = view.dataset.n_moving_axes == 1
        if is_line or view.dataset.units.is_angle or _is_turning(view.fit.law):
            return Family(self.name)
        turns, swings, pushes = _columns(view)
        free = np.concatenate([turns, swings, pushes], axis=1)
        # Omega and its products freed at once show no less on noise than one Omega does.
        null = gains(free.T, view.draws_left.T)
        proposals = []
        for has_centre in (False, True):
            q = orthonormal(pushes, len(free)) if has_centre else pushes[:, :0]
            kept = [m - q @ (q.T @ m) for m in (view.left[:, None], turns, swings)]
            spin, gain = _spin(*kept)
            if has_centre:
                gain += float(np.square(q.T @ view.left).sum())
            proposals.append(_proposal(view, spin, gain, has_centre))
        proposals.sort(key=lambda p: -p.promise)
        best = max(p.gain for p in proposals)
        return Family(self.name, tuple(proposals), best, free.shape[1], null, n_tried=2)


def _is_turning(law):
    """Whether the law has such a frame already."""
    return any({"v_i", "p_i", "origin"} <= set(t.formula.inputs) for t in law.terms)


def _columns(view):
    """Moments by each component of Omega, by each product of two, and by the axis' place."""
    types = dataset_types(view.dataset)

    def moments(texts):
        columns = view.force_columns([parse_formula(f"m_i * {t}", types) for t in texts])
        return view.beside(np.nan_to_num(columns))

    axes = "xyz"[: view.dataset.n_dims]
    pushes = moments([f"e_{a}" for a in axes])
    if len(axes) == 2:
        return moments(["perp(v_i) * (-2)"]), moments(["(p_i - origin)"]), pushes
    turns = moments([f"cross(e_{a}, v_i) * (-2)" for a in axes])
    pairs = combinations_with_replacement(axes, 2)
    each = "cross(e_{}, cross(e_{}, p_i - origin))"
    swings = [(each.format(a, b), each.format(b, a)) for a, b in pairs]
    swings = [f"({one}{f' + {two}' if one != two else ''}) * (-1)" for one, two in swings]
    return turns, moments(swings), pushes


def _spin(left, turns, swings):
    """Omega that explains most of some moments, and what chi-squared that takes away."""
    k = turns.shape[1]
    # All that matters is within the span of the columns.
    q = orthonormal(np.concatenate([turns, swings], axis=1), len(left))
    target, turns, swings = (q.T @ m for m in (left[:, 0], turns, swings))
    pairs = list(combinations_with_replacement(range(k), 2))

    def missed(spin):
        return target - turns @ spin - swings @ [spin[a] * spin[b] for a, b in pairs]

    both = np.concatenate([turns, swings], axis=1)
    starts = [np.linalg.lstsq(m, target, rcond=None)[0][:k] for m in (turns, both)]
    found = min((least_squares(missed, start) for start in starts), key=lambda f: f.cost)
    return found.x, float(target @ target) - 2 * float(found.cost)


def _proposal(view, spin, gain, has_centre):
    axes, law = "xyz"[: view.dataset.n_dims], view.fit.law
    name = fresh_name(law, "Omega")
    of_spin = [name] if len(axes) == 2 else [f"{name}_{axis}" for axis in axes]
    of_place = list(fresh_names(law, [f"centre_{axis}" for axis in axes]).values())
    text = f"rotating({name})" + f" about ({', '.join(of_place)})" * has_centre
    formula = parse_formula(expanded(text, len(axes)), dataset_types(view.dataset))
    values = dict.fromkeys(formula.constants, 0.0)
    values |= dict(zip(of_spin, spin.tolist(), strict=True))
    ends = [extent_of(view, axis) for axis in range(len(axes))] if has_centre else []
    reach = FARTHEST * max((high - low for low, high in ends), default=0.0)
    places = {
        name: (low - reach, high + reach)
        for name, (low, high) in zip(of_place, ends, strict=False)
    }  # fmt: skip
    values |= {name: min(max(0.0, low), high) for name, (low, high) in places.items()}
    return Proposal(
        "frame", to_text(formula), view.hypothesis + Forces(ForceLaw((Term(formula),), values)),
        -2 * view.criteria.cause_nats - view.odd_nats, gain, len(values), starts=values,
        bounds=places, formulas=(formula,), n_dims=len(axes),
    )  # fmt: skip
