"""Laws that are others from an instant on, or beyond a place: a parachute, a carpet, a motor.

What moves a body before and after has terms of its own. Each alone explains little, and whoever
looks for one cause finds a kick there. So the terms of textbooks are taken everywhere, on one side
and on the other, and sums of them chosen as a whole where all of them together explain most.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from bsp_gp.language.formula import Call, Constant, Input, Number, product
from bsp_gp.loop.proposal import NEW, PATIENT, Family
from bsp_gp.loop.proposers.libraries import (
    Placed,
    Rows,
    asks_series,
    drags,
    extent_of,
    family_of,
    left_by,
    moving_axes,
)
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import fresh_name

INSTANTS, MOST_LOOKS = 14, 80
"""Instants at which stages of a flight may end, tried at first, and how often they are moved."""
LESS = 0.5
"""Part of what terms leave everywhere that they must leave where they may change."""


class Regimes:
    """Sums of terms that change at an instant or a place, for bodies that move alone."""

    name = "regimes"
    is_alone = False

    def propose(self, view):
        """The family of the likeliest sums, where laws that are the same everywhere leave much."""
        if view.is_sky or not asks_series(view):
            return Family(self.name)
        axes = moving_axes(view)
        types = dataset_types(view.dataset)
        rows = [(coordinate_of(types, axis)[1], 0) for axis in axes] + drags(view, axes)
        plain = Rows(view, rows).library()
        bar = LESS * (left_by(view, plain.columns) if plain else float(view.left @ view.left))
        edges = [(*coordinate_of(types, a), f"h_{'xyz'[a]}", extent_of(view, a)) for a in axes]
        span = _span_of_clock(view)
        if span is not None:
            edges.append((Input("t", types["t"]), None, "t", span))
        libraries = []
        for quantity, direction, stem, extent in edges:
            name = fresh_name(view.fit.law, stem)
            own = [row for row, _ in rows]
            if direction is not None:  # what it meets there gives way: a rubber band, a bumper
                own.append(Call("mul", Call("sub", quantity, Constant(name)), direction))
            changing = [(_on(quantity, name, side, row), NEW) for side in _SIDES for row in own]
            placed = Placed(view, rows + changing, (name,), (extent,))
            found = placed.best_on_line()
            if found is not None and left_by(view, found.columns) < bar:
                libraries.append(replace(found, placed=placed))
        stages = _stages(view, axes, span) if span and len(axes) == 1 else None
        if stages is not None and left_by(view, stages.columns) < bar:
            libraries.append(stages)
        family = family_of(self.name, view, libraries, has_waves=False)
        # Where a parachute opens at a high speed rows tell little of the instant.
        names = {place.name for place in stages.places} if stages else {""}
        return replace(family, proposals=tuple(
            replace(p, patience=PATIENT) if names <= set(p.starts) else p for p in family.proposals
        ))  # fmt: skip


def _span_of_clock(view):
    """First and last instant of a clock that all recordings share; None where each has its own.

    Those that begin at the same reading are taken to be counted from the same event.
    """
    scenes = view.dataset.scenes
    begun = [float(scene.times[0]) for scene in scenes]
    is_one = len({scene.part_of or scene.name for scene in scenes}) == 1
    if not is_one and max(begun) - min(begun) > view.step:
        return None
    return min(begun), max(float(scene.times[-1]) for scene in scenes)


def _stages(view, axes, span):
    """A flight in stages: a thrust up to an instant, and drags before and after another one.

    Of a rocket these are its motor, its body and its parachute; of a jumper the latter two.
    """
    types = dataset_types(view.dataset)
    names = [fresh_name(view.fit.law, stem) for stem in ("t", "t_open")]
    time, velocity = Input("t", types["t"]), Input("v_i", types["v_i"])
    drag = Call("mul", Call("norm", velocity), velocity)
    rows = []
    for push in (coordinate_of(types, axis)[1] for axis in axes):
        rows += [(push, 0), (_on(time, names[0], "sub", push), NEW)]
    rows += [(_on(time, names[1], "sub", drag), 0), (_on(time, names[1], "add", drag), NEW)]
    placed = Placed(view, rows, tuple(names), (span, span))
    line = np.linspace(*span, INSTANTS + 2)[1:-1]
    pairs = np.array([(early, late) for k, early in enumerate(line) for late in line[k + 1 :]])
    first = pairs[int(np.argmin(placed.left_at(pairs)))]
    step = line[1] - line[0]
    found = minimize(
        placed.unexplained, first, method="Nelder-Mead",
        options={"maxfev": MOST_LOOKS, "xatol": 1e-3 * step,
                 "initial_simplex": np.add(first, [[0, 0], [step / 2, 0], [0, step / 2]])},
    )  # fmt: skip
    return placed.library(found.x)


_SIDES = "sub", "add"


def _on(quantity, name, side, row):
    """A term below a place or up to an instant ("sub"), or beyond it ("add")."""
    sign = Call("sign", Call("sub", quantity, Constant(name)))
    return product([Number(0.5), Call(side, Number(1.0), sign), row])
