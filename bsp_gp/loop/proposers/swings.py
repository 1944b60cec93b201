"""What drives a body back to where it comes to rest, if it swings and no force is known that does.

Beside a law that drives nothing back, moments along tracks as they were seen tell little of such a
force: a rest point that creeps by a hundredth of the swing takes most of it away, where a push with
a period explains nearly all. Whole tracks do not mind, so that it is fitted whatever it promises.
"""

import math
from dataclasses import replace

import numpy as np

from bsp_gp.fitting.channels import join
from bsp_gp.fitting.periodogram import longest, swing_of
from bsp_gp.language.formula import Call, Constant, Input
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, with_term
from bsp_gp.loop.proposers.inside import form_at, inner_search
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term, fresh_name
from bsp_gp.search.inner import PLACE

SPRING = "centre - p_i"
"""The form of the grammar that drives back to a place."""
LEAST_DRAG = 1e-3
"""Part of the rate of a swing at which a drag begins that the swing does not show."""


class Swings:
    """A spring to a rest point, and a drag, as a proposer.

    Parameters
    ----------
    inside : Inside
        Whose forms are those of the grammar.
    """

    name = "swings"

    def __init__(self, inside):
        self.grammar = inside.grammar
        texts = [to_text(form.term.formula) for form in inside.forms]
        self.form = inside.forms[texts.index(SPRING)] if SPRING in texts else None

    def propose(self, view):
        """The family of that one law, where a lone body swings without a cause."""
        scenes = view.dataset.scenes
        if self.form is None or view.is_astronomical or any(len(s.dynamic) != 1 for s in scenes):
            return Family(self.name)
        rate = swing_of(view.fit)
        if not rate or swing_of(view.fit, foreseen=True):
            return Family(self.name)
        search = inner_search(view, self.grammar, view.moment_draws)
        axes = search.axes_of(self.form)
        if axes is None:
            return Family(self.name)
        places = np.concatenate([s.positions[:, s.dynamic[0]] for s in scenes])
        middle = np.nanmean(places, axis=0)
        at = np.array(["xyz".index(axis.name.removeprefix(PLACE)) for axis in axes])
        spring = form_at(view, search, self.form, middle[at])
        mass = _mass(scenes)
        strength = next(iter(spring.formulas[0].constants))
        spring = replace(spring, starts=spring.starts | {strength: mass * rate**2})
        law = spring.hypothesis.law
        name = fresh_name(law, "c")
        slowing = Call("mul", Constant(name), Input("v_i", dataset_types(view.dataset)["v_i"]))
        drag = -mass * max(_decay(view.fit), LEAST_DRAG * rate)
        both = replace(
            spring, text=f"{spring.text} + {to_text(slowing)}",
            hypothesis=with_term(spring.hypothesis, Term(slowing, "field"), {name: drag}),
            formulas=(*spring.formulas, slowing), rank=spring.rank + 1,
            starts=spring.starts | {name: drag},
            log_prior=spring.log_prior - view.criteria.cause_nats,
        )  # fmt: skip
        return Family(self.name, (both,), is_control=True)


def _mass(scenes):
    """A mass that bodies have, kg; 1 where none is known."""
    masses = np.array([s.entities[s.dynamic[0]].mass for s in scenes], dtype=float)
    known = masses[np.isfinite(masses)]
    return float(np.median(known)) if len(known) else 1.0


def _decay(found):
    """The rate at which velocities die away, 1/s, by the sizes of two halves of tracks."""
    early = late = 0.0
    for track in join(chains.observed for chains in found.groups).T:
        seen = track[np.isfinite(track)]
        half = len(seen) // 2
        if half:  # some are shorter than others
            early, late = early + np.var(seen[:half]), late + np.var(seen[half:])
    return 2.0 * math.log(early / late) / longest(found) if early > late > 0 else 0.0
