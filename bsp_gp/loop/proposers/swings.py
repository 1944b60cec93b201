"""What drives a body back to where it comes to rest, if it swings and no force is known that does.

Beside a law that drives nothing back, moments along tracks as they were seen tell little of such a
force: a rest point that creeps by a hundredth of the swing takes most of it away, where a push with
a period explains nearly all. Whole tracks do not mind, so that it is fitted whatever it promises.
"""

import math
from dataclasses import replace

import numpy as np

from bsp_gp.fitting.channels import join
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.periodogram import longest, modes_of, swing_of
from bsp_gp.language.formula import Call, Constant, Input, rename_constants
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, with_term
from bsp_gp.loop.proposers.inside import SINES, SINES_OF_ANGLES, form_at, inner_search, may_be_angle
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_name
from bsp_gp.search.inner import PLACE

SPRING = "centre - p_i"
"""The form of the grammar that drives back to a place."""
LONG = "(norm(centre - p_i) - D) * normalize(centre - p_i)"
"""The same of a spring that has a length, tied to a post."""
SHARE = 0.05
"""Length of such a spring in the extent of the tracks, at which a fit begins."""
WIDE = 3.0
"""A radian in the extent of an angle that is not calibrated, at which a fit begins."""
FEWER_TURNS = 0.75
"""Of a body beside others that swing."""
MOST_BODIES = 12
"""That are asked whether each swings at a rate of its own."""
ALIKE = 1.5
"""Ratio of rates up to which two bodies may be tied to each other."""
COUPLING = 0.05
"""Strength of what ties them, in that of what ties each to its rest point, where a fit begins."""
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
        sines = (known[text] for text in (SINES_OF_ANGLES[0], SINES[0]) if text in known)
        self.of_angles = list(sines)[:1]

    def propose(self, view):
        """The family of those laws, where bodies swing without a cause, each at a rate of its own.

        Of several bodies a spring alone is asked, which is of another strength for each: moons that
        are seen from the side swing like that; of two, one between them as well.
        """
        scenes = view.dataset.scenes
        names = dict.fromkeys(s.names[k] for s in scenes for k in s.dynamic)
        # In the sky nothing is tied by springs, but orbits are seen edge on.
        is_sky = view.is_sky and view.dataset.n_moving_axes > 1
        if not self.forms or is_sky or len(names) > MOST_BODIES:
            return Family(self.name)
        is_alone = all(len(s.dynamic) == 1 for s in scenes)
        n_modes = 2 if len(names) == 2 and not is_alone else 1
        rates = {name: swing_of(view.fit, body=name, n_modes=n_modes)
                 for name in ([None] if is_alone else names)}  # fmt: skip
        slow = [name for name, rate in rates.items() if not rate]
        if 2 * len(slow) > len(rates):
            return Family(self.name)
        # Beside bodies that swing for sure one may be so slow that the track is one turn of it.
        rates |= {name: swing_of(view.fit, body=name, turns=FEWER_TURNS, n_modes=n_modes)
                  for name in slow}  # fmt: skip
        if not all(rates.values()):
            return Family(self.name)
        if swing_of(view.fit, foreseen=True):
            return Family(self.name)
        search = inner_search(view, self.grammar, view.moment_draws)
        own = self.of_angles if may_be_angle(view.dataset) else []
        forms = [f for f in self.forms + own if search.axes_of(f) is not None]
        if is_alone:
            proposals = tuple(_slowed(view, search, form, rates[None]) for form in forms)
        else:
            proposals = tuple(_apart(view, search, form, rates) for form in forms[:1])
            if forms and are_coupled(rates, scenes):
                modes = _modes(view, float(np.median(list(rates.values()))))
                ways = (
                    _coupled(view, search, forms[0], rates, modes, each) for each in (False, True)
                )
                proposals += tuple(ways)
        return Family(self.name, proposals, is_control=True)


def _about(view, search, form):
    """A spring about the middle of all places, its strength open."""
    scenes = view.dataset.scenes
    tracks = [s.positions[:, k] for s in scenes for k in s.dynamic]
    places = np.concatenate(tracks)
    middle = np.nanmean(places, axis=0)
    if len(scenes[0].dynamic) > 1:  # the mean of one that has not swung often is beside the middle
        ends = [(np.nanmin(track, axis=0) + np.nanmax(track, axis=0)) / 2 for track in tracks]
        middle = np.median(ends, axis=0)
    size = _radian(view.dataset) if _is_sine(form) else SHARE * _extent(view.dataset)
    at = {
        axis.name: middle["xyz".index(axis.name[-1])] if axis.name.startswith((PLACE, "h_"))
        else size
        for axis in search.axes_of(form)
    }  # fmt: skip
    return form_at(view, search, form, at)


def _extent(dataset):
    """How far bodies are off their middle, along the axis along which that is farthest."""
    places = np.concatenate([s.positions[:, k] for s in dataset.scenes for k in s.dynamic])
    return float(np.nanmax(np.nanstd(places, axis=0)))


def _radian(dataset):
    """A radian, in the unit of places; of an angle that is not calibrated where a fit begins."""
    return 1.0 if dataset.units.is_angle else WIDE * _extent(dataset)


def _is_sine(form):
    return to_text(form.term.formula) in (SINES_OF_ANGLES[0], SINES[0])


def _apart(view, search, form, rates):
    """A spring to one rest point for all bodies, as stiff for each as its swings are fast."""
    spring, scenes = _about(view, search, form), view.dataset.scenes
    (formula,), strength = spring.formulas, next(iter(spring.formulas[0].constants))
    name = f"{strength}[body]"
    masses = {s.names[k]: s.entities[k].mass for s in scenes for k in s.dynamic}
    table = {
        body: rate**2 * (masses[body] if math.isfinite(masses[body]) else 1.0)
        for body, rate in rates.items()
    }  # fmt: skip
    formula = rename_constants(formula, {strength: name})
    starts = {key: value for key, value in spring.starts.items() if key != strength}
    part = spring.hypothesis.parts[-1]
    law = ForceLaw((Term(formula, "field"),), {**starts, name: table})
    return replace(
        spring, code="law_by_body", text=to_text(formula), formulas=(formula,), starts=starts,
        hypothesis=view.hypothesis + replace(part, law=law), rank=spring.rank + len(rates) - 1,
        log_prior=spring.log_prior - view.criteria.cause_nats, ties=(),
    )  # fmt: skip


def are_coupled(rates, scenes):
    """Whether two bodies, the same in all scenes, swing about as fast: a spring may tie them."""
    is_pair = len(rates) == 2 and all(len(scene.dynamic) == 2 for scene in scenes)
    return is_pair and max(rates.values()) < ALIKE * min(rates.values())


def _coupled(view, search, form, rates, modes, is_apart):
    """Springs to a rest point of each of two bodies, one between them, and a drag.

    Energy goes over from one to the other and back, and each alone seems to be driven. Where masses
    differ (`is_apart`) each has a stiffness, a coupling and a drag of its own.
    """
    spring, dataset = _about(view, search, form), view.dataset
    (formula,), types = spring.formulas, dataset_types(dataset)
    strength, *centres = formula.constants
    by = "[body]" if is_apart else ""
    own = {name: f"{name}[body]" for name in centres}
    formula = rename_constants(formula, {strength: strength + by, **own})
    across, drag = (fresh_name(ForceLaw((Term(formula),), {}), stem) for stem in ("k", "d"))
    place, other, velocity = (Input(name, types[name]) for name in ("p_i", "p_j", "v_i"))
    terms = (
        formula, Call("mul", Constant(across + by), Call("sub", other, place)),
        Call("mul", Constant(drag + by), velocity),
    )  # fmt: skip
    mass, rate = usual_mass(dataset.scenes), float(np.median(list(rates.values())))
    together, apart = modes
    amounts = {
        strength: mass * together**2, across: mass * (apart**2 - together**2) / 2,
        drag: -mass * max(decay_of(view.fit), LEAST_DRAG * rate),
    }  # fmt: skip
    constants = {
        name + by: dict.fromkeys(rates, value) if by else value for name, value in amounts.items()
    }
    constants |= {own[name]: _middles(dataset, name, rates) for name in centres}
    law = ForceLaw(tuple(map(Term, terms)), constants)
    return replace(
        spring, code="law_by_body", text=" + ".join(map(to_text, terms)), formulas=terms,
        starts={}, hypothesis=view.hypothesis + Forces(law, None),
        rank=2 * len(centres) + (6 if is_apart else 3), ties=(), is_afresh=True,
        log_prior=spring.log_prior - (3 if is_apart else 2) * view.criteria.cause_nats,
    )  # fmt: skip


def _modes(view, rate):
    """The rates at which two bodies swing the same way, and against each other, rad/s.

    They are those of bodies that a weak spring ties, where but one is seen.
    """
    found = [modes_of(view.fit, body=name) for name in view.fit.channels.body_names]
    first, second = max(found, key=lambda pair: pair[1])
    if not second:
        return rate, rate * math.sqrt(1 + 2 * COUPLING)
    alike = 0.0  # how surely the first is one in which both go the same way
    for scene in view.dataset.scenes:
        one, other = (
            _amplitudes(scene.times, scene.positions[:, k], (first, second)) for k in scene.dynamic
        )
        alike += float((one[0] * other[0]).sum())
    return (first, second) if alike > 0 else (second, first)


def _amplitudes(times, places, rates):
    """Cosines and sines of rates that a track (T, d) is made of, about, (rates, 2, d)."""
    seen = np.isfinite(places).all(axis=1)
    waves = [f(rate * times[seen]) for rate in rates for f in (np.cos, np.sin)]
    columns = np.column_stack([np.ones(seen.sum()), *waves])
    return np.linalg.lstsq(columns, places[seen], rcond=None)[0][1:].reshape(len(rates), 2, -1)


def _middles(dataset, name, bodies):
    """Where each body is in the middle along the axis of a centre's constant."""
    axis = "xyz".index(name.removeprefix(PLACE)[0])
    tracks = {
        body: np.concatenate([s.positions[:, s.names.index(body), axis] for s in dataset.scenes])
        for body in bodies
    }
    return {body: float(np.nanmean(track)) for body, track in tracks.items()}


def _slowed(view, search, form, rate):
    """A spring about the middle of all places, as stiff as swings are fast, and a drag."""
    spring, scenes = _about(view, search, form), view.dataset.scenes
    mass = usual_mass(scenes)
    strength = next(iter(spring.formulas[0].constants))
    stiffness = mass * rate**2
    if _is_sine(form):  # which swings the more slowly the wider it does
        wide = [np.nanvar(s.positions[:, s.dynamic]) * s.positions.shape[2] for s in scenes]
        radian = _radian(view.dataset)
        stiffness *= -radian * (1 + max(wide) / (2 * radian) ** 2)
    spring = replace(spring, starts=spring.starts | {strength: stiffness})
    law = spring.hypothesis.law
    name = fresh_name(law, "c")
    slowing = Call("mul", Constant(name), Input("v_i", dataset_types(view.dataset)["v_i"]))
    drag = -mass * max(decay_of(view.fit), LEAST_DRAG * rate)
    return replace(
        spring, text=f"{spring.text} + {to_text(slowing)}",
        hypothesis=with_term(spring.hypothesis, Term(slowing, "field"), {name: drag}),
        formulas=(*spring.formulas, slowing), rank=spring.rank + 1,
        starts=spring.starts | {name: drag},
        log_prior=spring.log_prior - view.criteria.cause_nats, is_usual=True,
    )  # fmt: skip


def usual_mass(scenes, name=""):
    """A mass that bodies have, or the one of a name, kg; 1 where none is known."""
    own = [(s, [k for k in s.dynamic if s.names[k] == name] or s.dynamic) for s in scenes]
    masses = np.array([s.entities[rows[0]].mass for s, rows in own if len(rows)], dtype=float)
    known = masses[np.isfinite(masses)]
    return float(np.median(known)) if len(known) else 1.0


def decay_of(found):
    """The rate at which velocities die away, 1/s, by the sizes of two halves of tracks."""
    early = late = 0.0
    for track in join(chains.observed for chains in found.groups).T:
        seen = track[np.isfinite(track)]
        half = len(seen) // 2
        if half:  # some are shorter than others
            early, late = early + np.var(seen[:half]), late + np.var(seen[half:])
    return 2.0 * math.log(early / late) / longest(found) if early > late > 0 else 0.0
