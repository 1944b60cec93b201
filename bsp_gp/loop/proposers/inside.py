"""Laws with constants inside, beside the laws of a grammar: see `bsp_gp.search.inner`."""

from __future__ import annotations

import numpy as np
from scipy import stats

from bsp_gp.fitting.hypothesis import Parameter
from bsp_gp.fitting.parts.ranged import RangedForces
from bsp_gp.inference.priors import Prior
from bsp_gp.language.formula import Call, Constant, rename_constants
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.view import MOST_PAIRS
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_names, split_linear
from bsp_gp.search.inner import Form, InnerSearch, read_forms

__all__ = ["Inside", "inner_search"]

MOST = 8
"""Forms that are looked at more closely."""


class Inside:
    """Forms with constants inside as a proposer.

    They are a family of their own, so that those of them that are tried cost other laws little.

    Parameters
    ----------
    laws : Laws
        Which come first, and tell the view what they explain.
    dataset : Dataset
        Training scenes.
    """

    name = "inside"

    def __init__(self, laws, dataset):
        self.grammar = laws.grammar
        self.forms = read_forms(laws.grammar, dataset, laws.properties, laws.available)

    def propose(self, view):
        """The family of all forms that explain more than laws without inner constants.

        Parameters
        ----------
        view : View
        """
        search = inner_search(view, self.grammar, view.moment_draws)
        # Where laws without inner constants leave no more than noise, few forms are tried; where no
        # force is declared, all are.
        left = view.left @ view.left - (view.explained if view.fit.law.terms else 0.0)
        is_noise = stats.chi2.sf(left, max(view.n_left, 1)) > view.criteria.alpha
        drawn = [Form(Term(split_linear(c.formula)[1], c.kind), c.complexity) for c in view.drawn]
        scans = []
        for form in (*self.forms, *drawn):
            if view.tick is not None:
                view.tick()
            is_dear = form.term.kind == "pair" and view.n_pairs > MOST_PAIRS
            axes = None if is_dear else search.axes_of(form)
            if axes and not (is_noise and len(axes) > 1):
                scans.append(search.scan(form))
        if not scans:
            return Family(self.name)
        chosen = []
        for scan in sorted(scans, key=lambda s: -s.promise):
            twin = next((c for c in chosen if scan.is_like(c)), None)
            if twin is not None:
                twin.ties.append(scan)
            elif len(chosen) < MOST:
                chosen.append(scan)
        closer = [search.closer(scan) for scan in chosen]
        every = (_proposal(view, search, s) for s in closer if s.best > view.explained)
        least = view.promised - 2 * view.criteria.tie_nats  # what is less likely tells nothing new
        proposals = sorted((p for p in every if p.promise > least), key=lambda p: -p.promise)
        count = sum(s.n_points for s in scans)
        return Family(
            self.name, tuple(proposals), max(s.gain for s in scans), 1,
            np.max([s.null for s in scans], axis=0),
            f"{len(scans)} forms with constants inside scored at {count} places on grids",
            n_tried=count,
        )  # fmt: skip


def inner_search(view, grammar, draws):
    """Grids for the constants inside of a grammar, on what a view's law leaves, and on noise."""
    return InnerSearch(
        view.response.regression, view.left, view.beside(draws), view.beside,
        np.isfinite(view.fit.noise.levels), grammar.inside.get("ranges", {}),
        dataset_types(view.dataset),
    )  # fmt: skip


def _proposal(view, search, scan):
    """The hypothesis with a form where the grid has it."""
    names = fresh_names(view.fit.law, ("c", *(axis.name for axis in scan.axes)))
    formulas = [
        Call("mul", Constant("c"), search.placed(each.form.term.formula))
        for each in (scan, *scan.ties)
    ]
    formulas = [rename_constants(formula, names) for formula in formulas]
    ranges = tuple(_range(axis, names[axis.name]) for axis in scan.axes)
    starts = {
        p.name: float(np.clip(axis.values(at), p.low, p.high))
        for axis, at, p in zip(scan.axes, scan.at, ranges, strict=True)
    }
    starts[names["c"]] = search.strength(scan)
    law = ForceLaw((Term(formulas[0], scan.form.term.kind),), starts)
    return Proposal(
        "law", to_text(formulas[0]), view.hypothesis + RangedForces(law, None, ranges),
        -view.criteria.cause_nats - scan.form.nats, scan.best, 1 + len(ranges), starts=starts,
        formulas=(formulas[0],), ties=tuple(formulas[1:]), n_dims=view.dataset.n_dims,
        volume=scan.volume, is_wide=True,
    )  # fmt: skip


def _range(axis, name):
    """The range and prior of an inner constant as a fit takes them."""
    if axis.cauchy is not None:
        return Parameter(name, prior=axis.cauchy)
    low, high = (float(axis.values(end)) for end in (axis.low, axis.high))
    prior = Prior("log_uniform" if axis.is_log else "uniform", low, high)
    return Parameter(name, low=low, high=high, prior=prior)
