"""Forces whose strength is a function that no form has: see `bsp_gp.search.shapes`."""

import math
from dataclasses import replace

import numpy as np
from scipy import stats

from bsp_gp.loop.clock import TimeIsUp
from bsp_gp.loop.proposal import UNIFORM, Family
from bsp_gp.loop.proposers.inside import (
    form_at,
    inner_search,
    scan_at,
    shown_of,
    sums,
)
from bsp_gp.loop.proposers.libraries import SERIES
from bsp_gp.loop.view import MOST_PAIRS, MOST_WEIGHTS
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.search.shapes import ShapeSearch, read_ways


class Shapes:
    """Shapes of one variable, bred where forms that are listed leave more than noise.

    Alone, and beside steady pushes, which hide what other forces depend on. Like series they may
    stand for a force of any form, and are as dear.

    Parameters
    ----------
    laws : Laws
        Which come first, and tell the view what they explain, as `Inside` does.
    dataset : Dataset
        Training scenes.
    """

    name = "shapes"
    is_alone = False

    def __init__(self, laws, dataset):
        self.grammar, self.common, self.budget = laws.grammar, laws.common, laws.searching.budget
        types = dataset_types(dataset)
        self.ways = read_ways(laws.grammar, dataset, laws.properties, types, laws.available)

    def propose(self, view):
        """The family of shapes, where one may be likelier than all that is listed."""
        null, size = np.zeros(view.moment_draws.shape[1]), float(view.left @ view.left)
        odd = math.log(max(len(self.ways), 1)) + SERIES
        nats = odd + view.criteria.cause_nats
        most = 0.5 * (size - stats.chi2.isf(1 - view.criteria.alpha, max(view.n_left, 1)))
        if not self.ways or most < max(view.foremost, 0.0) + nats:
            return Family(self.name, null=null)  # if one left noise alone it would be no likelier
        search = inner_search(view, self.grammar, view.moment_draws)
        shown = shown_of(view, self.common)
        steady = [k for k, law in enumerate(shown[0]) if set(law.inputs) <= UNIFORM]
        pushes, clock = shown[1][:, steady], _Clock(view)
        bred, proposals = [], []
        for beside in (pushes[:, :0], pushes)[: 1 + bool(steady)]:
            if clock.was_over:
                break
            is_sum = beside.shape[1] > 0
            least = max([view.foremost, 0.0, *(p.promise for p in proposals)]) + nats
            least += is_sum * view.criteria.cause_nats
            bred.append(self._bred(view, search, beside, 2 * least, clock))
            for shape in bred[-1].found:
                scan = scan_at(search, replace(shape.form, nats=shape.nats + odd), shape.at)
                ones = [form_at(view, search, scan.form, shape.at)]
                ones += sums(view, search, scan, shown, None) if is_sum else ()
                proposals += [replace(p, code="shape") for p in ones]
        least = max(view.foremost, 0.0) - view.criteria.class_nats
        proposals = sorted((p for p in proposals if p.promise > least), key=lambda p: -p.promise)
        gain = max(own.gain for own in bred) if proposals else 0.0
        return Family(
            self.name, tuple(proposals), gain, 1 if proposals else 0,
            np.max([null, *(own.null for own in bred)], axis=0),
            "\n".join(own.text() for own in bred if own.n_tried),
            n_tried=sum(own.n_tried for own in bred), is_partial=clock.was_over,
        )  # fmt: skip

    def _bred(self, view, search, beside, least, clock):
        """What is bred beside moments of other forces (n, c), on so much as is looked at."""
        least -= view.gain_of(beside)
        most = max(view.n_pairs / MOST_PAIRS, view.n_weights / MOST_WEIGHTS)
        part, share = search.besides(beside), 1.0
        if most > 1:
            regression, rows, own = view.part(1 / most)
            part = search.of_part(regression, rows, own).besides(beside[rows])
            share = float(np.square(search.target[rows]).sum() / np.square(search.target).sum())
        shapes = ShapeSearch(self.grammar.shapes, part, self.ways, self.budget)
        shapes.run(_genetic, view.search_rng, least=share * least, progress=clock.is_over)
        return shapes


def _genetic(max_levels, seeds):
    """Genetic programming, which breeds them."""
    from bsp_gp.search.genetic import Genetic  # DEAP is slow to import

    return Genetic(max_levels=max_levels, seeds=seeds)


class _Clock:
    """Whether the time for proposals is up: what was bred until then is proposed."""

    def __init__(self, view):
        self.tick, self.was_over = view.tick, False

    def is_over(self, step):
        try:
            if self.tick is not None:
                self.tick()
        except TimeIsUp:
            self.was_over = True
        return self.was_over
