"""Laws that are others from an instant on, or beyond a place: a parachute, a carpet, a motor.

What moves a body before and after has terms of its own. Each alone explains little, and whoever
looks for one cause finds a kick there. So the terms of textbooks are taken everywhere, on one side
and on the other, and sums of them chosen as a whole where all of them together explain most.
"""

from dataclasses import replace

from bsp_gp.language.formula import Call, Constant, Input, Number, product
from bsp_gp.loop.proposal import NEW, Family
from bsp_gp.loop.proposers.libraries import (
    Placed,
    asks_series,
    drags,
    extent_of,
    family_of,
    left_by,
    library_of,
    moving_axes,
)
from bsp_gp.loop.proposers.periods import coordinate_of
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import fresh_name

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
        axes, scenes = moving_axes(view), view.dataset.scenes
        types = dataset_types(view.dataset)
        rows = [(coordinate_of(types, axis)[1], 0) for axis in axes] + drags(view, axes)
        plain = library_of(view, rows)
        bar = LESS * (left_by(view, plain.columns) if plain else float(view.left @ view.left))
        edges = [(*coordinate_of(types, a), f"h_{'xyz'[a]}", extent_of(view, a)) for a in axes]
        if len(scenes) == 1:
            (scene,) = scenes
            edges.append((Input("t", types["t"]), None, "t", (scene.times[0], scene.times[-1])))
        libraries = []
        for quantity, direction, stem, extent in edges:
            name = fresh_name(view.fit.law, stem)
            own = [row for row, _ in rows]
            if direction is not None:  # what it meets there gives way: a rubber band, a bumper
                own.append(Call("mul", Call("sub", quantity, Constant(name)), direction))
            changing = [(_on(quantity, name, side, row), NEW) for side in _SIDES for row in own]
            placed = Placed(view, rows + changing, (name,), (extent,), quantity.type.unit)
            found = placed.best_on_line()
            if found is not None and left_by(view, found.columns) < bar:
                libraries.append(replace(found, placed=placed))
        return family_of(self.name, view, libraries, has_waves=False)


_SIDES = "sub", "add"


def _on(quantity, name, side, row):
    """A term below a place or up to an instant ("sub"), or beyond it ("add")."""
    sign = Call("sign", Call("sub", quantity, Constant(name)))
    return product([Number(0.5), Call(side, Number(1.0), sign), row])
