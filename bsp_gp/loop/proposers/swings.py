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
LONG = "(norm(centre - p_i) - D) * normalize(centre - p_i)"
"""The same of a spring that has a length, tied to a post."""
SHARE = 0.05
"""Length of such a spring in the extent of the tracks, at which a fit begins."""
LEAST_DRAG = 1e-3
"""Part of the rate of a swing at which a drag begins that the swing does not show."""


class Swings:
    """A spring to a rest point or a post, and a drag, as a proposer.

    Parameters
    ----------
    inside : Inside
        Whose forms are those of the grammar.
    """

    name = "swings"

    def __init__(self, inside):
        self.grammar = inside.grammar
        known = {to_text(form.term.formula): form for form in inside.forms}
        self.forms = [known[text] for text in (SPRING, LONG) if text in known]

    def propose(self, view):
        """The family of those laws, where a lone body swings without a cause."""
        scenes = view.dataset.scenes
        if not self.forms or view.is_astronomical or any(len(s.dynamic) != 1 for s in scenes):
            return Family(self.name)
        rate = swing_of(view.fit)
        if not rate or swing_of(view.fit, foreseen=True):
            return Family(self.name)
        search = inner_search(view, self.grammar, view.moment_draws)
        forms = [f for f in self.forms if search.axes_of(f) is not None]
        proposals = tuple(_slowed(view, search, form, rate) for form in forms)
        return Family(self.name, proposals, is_control=True)


def _slowed(view, search, form, rate):
    """A spring about the middle of all places, as stiff as swings are fast, and a drag."""
    scenes = view.dataset.scenes
    places = np.concatenate([s.positions[:, s.dynamic[0]] for s in scenes])
    middle, extent = np.nanmean(places, axis=0), float(np.nanmax(np.nanstd(places, axis=0)))
    at = [
        middle["xyz".index(axis.name.removeprefix(PLACE))] if axis.name.startswith(PLACE)
        else math.log(SHARE * extent)
        for axis in search.axes_of(form)
    ]  # fmt: skip
    spring = form_at(view, search, form, at)
    mass = _mass(scenes)
    strength = next(iter(spring.formulas[0].constants))
    spring = replace(spring, starts=spring.starts | {strength: mass * rate**2})
    law = spring.hypothesis.law
    name = fresh_name(law, "c")
    slowing = Call("mul", Constant(name), Input("v_i", dataset_types(view.dataset)["v_i"]))
    drag = -mass * max(_decay(view.fit), LEAST_DRAG * rate)
    return replace(
        spring, text=f"{spring.text} + {to_text(slowing)}",
        hypothesis=with_term(spring.hypothesis, Term(slowing, "field"), {name: drag}),
        formulas=(*spring.formulas, slowing), rank=spring.rank + 1,
        starts=spring.starts | {name: drag},
        log_prior=spring.log_prior - view.criteria.cause_nats,
    )  # fmt: skip


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
