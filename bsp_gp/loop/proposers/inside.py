"""Laws with constants inside, beside the laws of a grammar: see `bsp_gp.search.inner`."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy import stats

from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.hypothesis import Parameter
from bsp_gp.fitting.parts.ranged import RangedForces
from bsp_gp.inference.priors import Prior
from bsp_gp.language.formula import Call, Constant, rename_constants, substitute
from bsp_gp.language.radian import RADIAN
from bsp_gp.language.render import to_text
from bsp_gp.loop.clock import TimeIsUp
from bsp_gp.loop.proposal import Family, Proposal, with_term
from bsp_gp.loop.proposers.periods import wave_beside, waves_alone
from bsp_gp.loop.proposers.priors import drives, edges_cost, is_passed_once
from bsp_gp.loop.view import MOST_PAIRS, MOST_WEIGHTS
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_names, kind_of, split_linear
from bsp_gp.search.columns import orthonormal
from bsp_gp.search.inner import PLACE, ZOOMS, Form, InnerSearch, Scan, read_forms
from bsp_gp.search.subsets import best_subsets
from bsp_gp.units import Unit

__all__ = ["Inside", "form_at", "inner_search", "scan_at", "shown_of", "sums"]

MOST = 8
"""Forms that are proposed."""
MOST_CLOSER, LEAST_CLOSER = 80, 20
"""Forms that are looked at between the places of their grids, and closer ever fewer of them."""
SCANNED = 25_000
"""Pairs at all instants on which forms are scanned where they are more than `MOST_PAIRS`."""
MOST_LEADING = 8
"""Of the likeliest pair laws of the grammar, those tried beside forms as textbooks' are: a source
that is seen beside one that is not."""
MOST_LEADS, MOST_SUMS, LARGEST = 3, 3, 3
"""Forms beside which laws are sought, sets of these of each size, and terms of a sum."""
ROUNDING = 1e-9
"""Part of what a law explains by which another that is the same on these data may differ."""
SEPARATE = 0.02
"""Part of a law that must lie beside a form and changes of it for the two to be told apart."""


LINES = (PLACE, "h_", "H_")
"""How names of coordinates of a place begin."""
SINES = tuple(f"sin(({axis}_i - h_{axis}) / D) * e_{axis}" for axis in "xy")
"""What drives an angle back: a weight on an arm. A radian is fitted, where that is not known."""
SINES_OF_ANGLES = tuple(f"sin(({axis}_i - h_{axis}) / {RADIAN.text}) * e_{axis}" for axis in "xy")
"""The same where it is."""


def may_be_angle(dataset):
    """Whether what is measured is an angle, or may be one: numbers of a sensor on an axle."""
    units, is_one = dataset.units, dataset.n_moving_axes == 1
    return units.is_angle or (is_one and not units.is_calibrated(Unit.of(m=1)))


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
    is_alone = False

    def __init__(self, laws, dataset):
        self.grammar, self.common = laws.grammar, laws.common
        forms = read_forms(laws.grammar, dataset, laws.properties, laws.available)
        # A sine of a length is no force before it repeats, which `ripples` asks for.
        sines = [form for form in forms if to_text(form.term.formula) in SINES]
        if not may_be_angle(dataset):
            forms = [form for form in forms if form not in sines]
        if dataset.units.is_angle:
            forms = [*map(_of_angle, sines), *forms]
        self.forms = forms

    def propose(self, view):
        """The family of all forms that explain more than laws without inner constants."""
        search = inner_search(view, self.grammar, view.moment_draws)
        # Where laws without inner constants leave no more than noise, few forms are tried; where no
        # force is declared, all are.
        left = view.left @ view.left - (view.explained if view.fit.law.terms else 0.0)
        leaves_noise = stats.chi2.sf(left, max(view.n_left, 1)) > view.criteria.alpha
        drawn = [Form(Term(split_linear(c.formula)[1], c.kind), c.complexity) for c in view.drawn]
        parts, scans = {"field": search, "pair": search}, []
        if view.n_pairs > MOST_PAIRS:
            parts["pair"] = search.of_part(*view.part(SCANNED / view.n_pairs))
        if view.n_weights > MOST_WEIGHTS:
            parts["field"] = search.of_part(*view.part(MOST_WEIGHTS / view.n_weights))
        is_partial = False
        for form in (*self.forms, *drawn):
            try:
                if view.tick is not None:
                    view.tick()
            except TimeIsUp:  # what was scanned up to here is looked at, which is the lesser part
                is_partial = True
                break
            axes = search.axes_of(form)
            if axes and not (leaves_noise and len(axes) > 1):
                found = parts[form.term.kind].scan(form)
                scans += [found] if found.n_points else []
        if not scans:
            return Family(self.name, is_partial=is_partial)
        distinct = []
        for scan in sorted(scans, key=lambda s: -s.promise):
            twin = next((c for c in distinct if scan.is_like(c)), None)
            if twin is not None:
                twin.ties.append(scan)
            else:
                distinct.append(scan)
        # A peak may be much narrower than the grid is coarse: forms are looked at closely.
        closer = distinct
        for zoom in range(ZOOMS):
            closer = closer[: max(MOST_CLOSER >> zoom, LEAST_CLOSER)]
            closer = [parts[scan.form.term.kind].closer(scan, zoom) for scan in closer]
            closer = sorted(closer, key=lambda s: -s.promise)
        of_parts = {kind for kind, own in parts.items() if own is not search}
        if of_parts:  # what the best of a part explain of all
            some = [s for s in closer if s.form.term.kind in of_parts][:MOST]
            closer = [s for s in closer if s.form.term.kind not in of_parts][:MOST]
            closer = sorted([*closer, *map(search.anew, some)], key=lambda s: -s.promise)
        closer = closer[:MOST]
        least = (1 + ROUNDING) * view.explained + 1.0  # what its constants gain by chance alone
        every = [_proposal(view, search, s) for s in closer if s.best > least]
        if not leaves_noise:
            is_enough = any(_is_noise(view, s.best, 2) for s in closer)
            # Of forms of which one is the other's special case both lead: the best of every size.
            sizes = {len(s.axes): s for s in reversed(closer)}
            leads = dict.fromkeys((*sizes.values(), *closer[:MOST_LEADS]))
            leads = leads if is_enough else (*leads, None)
            best = [f for f in view.leading if not f.constants and kind_of(f) == "pair"]
            best = [Call("mul", Constant("c1"), form) for form in best[:MOST_LEADING]]
            laws = shown_of(view, dict.fromkeys((*self.common, *best)))
            alone = cache(lambda: waves_alone(view))
            every += [p for lead in leads for p in sums(view, search, lead, laws, alone)]
        view.foremost = max([view.foremost, *(p.promise for p in every)])
        least = view.promised - 2 * view.criteria.tie_nats  # what is less likely tells nothing new
        proposals = sorted((p for p in every if p.promise > least), key=lambda p: -p.promise)
        count = sum(s.n_points for s in scans)
        return Family(
            self.name, tuple(proposals), max(s.gain for s in scans), 1,
            np.max([s.null for s in scans], axis=0),
            f"{len(scans)} forms with constants inside scored at {count} places on grids",
            n_tried=count, is_partial=is_partial,
        )  # fmt: skip


def _of_angle(form):
    """A sine of places that are angles, whose radian is known."""
    formula = substitute(form.term.formula, {Constant("D"): RADIAN})
    return replace(form, term=Term(formula, form.term.kind))


def sums(view, search, scan, shown, alone):
    """A form and one or two laws of textbooks beside it, where it leaves more than noise.

    Where all of these leave more, a push with a period joins them, if `alone` tells of such pushes;
    without a form only then.
    The inner constants move with them, as far as moments are linear in these.
    """
    if scan is not None and _is_noise(view, scan.best, 2):
        return
    own = view.left[:, None][:, :0] if scan is None else search.linearised(scan)
    laws, columns = shown
    every = np.concatenate([own, columns], axis=1)
    wave, gain = None, view.gain_of(every)
    if alone is not None and not _is_noise(view, gain, every.shape[1]):
        wave = wave_beside(view, every, alone())
    for lead in [None] * (scan is not None) + [wave] * (wave is not None):
        waves = own[:, :0] if lead is None else lead.columns
        taken = orthonormal(np.concatenate([own, waves], axis=1), len(own))
        beside = columns - taken @ (taken.T @ columns)
        is_own = np.linalg.norm(beside, axis=0) > SEPARATE * np.linalg.norm(columns, axis=0)
        rest = view.left - taken @ (taken.T @ view.left)
        subsets = best_subsets(np.where(is_own, beside, 0.0), rest, LARGEST - 1)
        chosen = [members for found in subsets.values() for _, members in found[:MOST_SUMS]]
        for members in [()] * (scan is not None and lead is not None) + chosen:
            own_laws = [laws[k] for k in members]
            yield _sum(view, search, scan, own, own_laws, columns[:, members], lead)


def _is_noise(view, gain, rank):
    """Whether what is left beside a gain is no more than noise."""
    left = view.left @ view.left - gain
    return stats.chi2.sf(left, max(view.n_left - rank, 1)) > view.criteria.alpha


def shown_of(view, laws):
    """Laws that the law cannot take up, and their moments beside it, (n, c).

    All bodies have what they name.
    """
    found = {}
    for law in laws:
        try:
            column = view.force_columns([split_linear(law)[1]], kind_of(law))
        except EvaluationError:  # some body lacks a property
            continue
        if not np.isfinite(column).all():
            continue
        beside = view.beside(column)
        if np.linalg.norm(beside) > SEPARATE * np.linalg.norm(column):
            found[law] = beside
    nothing = np.zeros((len(view.left), 0))
    return list(found), np.concatenate([nothing, *found.values()], axis=1)


def _sum(view, search, scan, own, laws, columns, wave=None):
    """The proposal of a form and others beside it, all where moments have them together."""
    both = np.concatenate([own, columns, *((wave.columns,) if wave else ())], axis=1)
    amounts, _, gain = view.fitted_to(both)
    n_own = own.shape[1]
    if scan is None:
        one = Proposal("law", "", view.hypothesis, 0.0, 0.0, 0, n_dims=view.dataset.n_dims)
        starts = {}
    else:
        with np.errstate(over="ignore"):
            steps = amounts[1:n_own] / amounts[0] if amounts[0] else np.zeros(n_own - 1)
        one = _proposal(view, search, search.moved(scan, steps))
        starts = {**one.starts, next(iter(one.formulas[0].constants)): amounts[0]}
    hypothesis, formulas = one.hypothesis, list(one.formulas)
    law = hypothesis.law
    for formula, amount in zip(laws, amounts[n_own:], strict=False):
        names = fresh_names(law, formula.constants)
        term = Term(rename_constants(formula, names), kind_of(formula))
        values = dict.fromkeys(names.values(), float(amount))
        hypothesis, law = with_term(hypothesis, term, values), law.plus(term, values)
        starts, formulas = {**starts, **values}, [*formulas, term.formula]
    least = view.criteria.cause_nats  # of laws of textbooks; others cost what they do alone
    odd_nats = sum(max(view.leading.get(split_linear(law)[1], 0.0) - least, 0.0) for law in laws)
    bounds, rank, n_more = one.bounds, one.rank + len(laws), len(laws)
    if wave is not None:
        hypothesis = hypothesis + wave.part
        starts |= dict(zip(wave.names, (*amounts[-3:-1], wave.rate), strict=True))
        bounds, rank, n_more = bounds | {wave.names[-1]: wave.bounds}, rank + 3, n_more + 1
        formulas += [term.formula for term in wave.part.law.terms]
    return replace(
        one, text=" + ".join(map(to_text, formulas)), hypothesis=hypothesis, starts=starts,
        bounds=bounds, formulas=tuple(formulas), ties=(), gain=gain, rank=rank,
        log_prior=one.log_prior - view.criteria.cause_nats * n_more - odd_nats,
    )  # fmt: skip


def inner_search(view, grammar, draws):
    """Grids for the constants inside of a grammar, on what a view's law leaves, and on noise."""
    return InnerSearch(
        view.response.regression, view.left, view.beside(draws), view.beside,
        np.isfinite(view.fit.noise.levels), grammar.inside.get("ranges", {}),
        dataset_types(view.dataset),
    )  # fmt: skip


def form_at(view, search, form, at):
    """The proposal of a form whose inner constants are these, by name."""
    return _proposal(view, search, scan_at(search, form, at))


def scan_at(search, form, at):
    """The scan of a form whose inner constants are these, by name."""
    none, axes = np.zeros(0), search.axes_of(form)
    coordinates = np.array([axis.coordinate(at[axis.name]) for axis in axes], dtype=float)
    spacing = np.array([axis.spacing for axis in axes])
    scan = search.anew(Scan(form, axes, 1, 0.0, none, 0.0, 0.0, coordinates, spacing, ()))
    return replace(scan, gain=scan.best)


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
    odd_nats = view.odd_of(scan.form.term.formula, scan.form.term.kind)
    if drives(formulas[0], starts[names["c"]]):
        odd_nats += view.criteria.cause_nats
    axes = {axis.name.rstrip("0123456789")[-1] for axis in scan.axes if axis.name.startswith(LINES)}
    places = [(axis.name[2], starts[names[axis.name]]) for axis in scan.axes
              if axis.name.startswith(("h_", "H_"))]  # fmt: skip
    odd_nats += view.criteria.cause_nats * edges_cost(formulas[0], places, view.dataset)
    if is_passed_once(formulas[0], axes, view.dataset):
        odd_nats += 2 * view.criteria.cause_nats
    return Proposal(
        "law", to_text(formulas[0]), view.hypothesis + RangedForces(law, None, ranges),
        -view.criteria.cause_nats - odd_nats - scan.form.nats, scan.best, 1 + len(ranges),
        starts=starts, formulas=(formulas[0],), ties=tuple(formulas[1:]),
        n_dims=view.dataset.n_dims, volume=scan.volume, is_wide=True,
    )  # fmt: skip


def _range(axis, name):
    """The range and prior of an inner constant as a fit takes them."""
    if axis.cauchy is not None:
        return Parameter(name, prior=axis.cauchy)
    low, high = (float(axis.values(end)) for end in (axis.low, axis.high))
    prior = Prior("log_uniform" if axis.is_log else "uniform", low, high)
    return Parameter(name, low=low, high=high, prior=prior)
