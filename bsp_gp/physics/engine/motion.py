"""A law made ready to move chains: accelerations, their exact derivatives, and contact margins.

States have the shape ``(2, R, d, M)``: places and velocities of R bodies at M points. A point
belongs to a chain and an instant; all points are computed at once.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.language.formula import summands
from bsp_gp.language.inputs import property_of
from bsp_gp.physics.engine.compiled import Compiled
from bsp_gp.physics.engine.constrained import (
    Constraints,
    Held,
    constraints_of,
    lone_constraint,
)
from bsp_gp.physics.engine.graph import Graph, Tape
from bsp_gp.physics.engine.linked import Linkages, linkages_of
from bsp_gp.physics.engine.lowering import MOVING, Lowering, fades_at_rest
from bsp_gp.physics.engine.owners import Owners, fitted_properties
from bsp_gp.physics.engine.rails import rails_of
from bsp_gp.physics.engine.seen import Frame
from bsp_gp.physics.engine.walls import Walls, walls_of
from bsp_gp.physics.series import late_inputs

CREEP = 1e-12
"""Speed at which it is asked which way friction acts on a body at rest, m/s."""
ALIKE = 1e-9
"""Part of the speed of a medium within which a body is as fast: below it rounding tells the way."""
STATE = ("p_i", "p_j", "v_i", "v_j")
RATE = " rate"
"""Behind the name of a measured input: its slope by the time."""


@dataclass(frozen=True, eq=False)
class Points:
    """Where and when a law is asked.

    Attributes
    ----------
    state : ndarray, shape (2, R, d, M)
    times : ndarray, shape (M,)
    chain : ndarray of int, shape (M,), or slice
        The chain of each point.
    driven : ndarray, shape (2, D, d, M) or None
    modes : list of ndarray of bool
        Per program (n_modes, R, J, M), as `Motion.modes_at` gives them.
    """

    state: np.ndarray
    times: np.ndarray
    chain: object
    driven: np.ndarray | None
    modes: list

    def at(self, state):
        """The same points with other states."""
        return replace(self, state=state)

    def pick(self, index):
        return Points(
            self.state[..., index],
            self.times[index],
            self.chain[index],
            None if self.driven is None else self.driven[..., index],
            [mode[..., index] for mode in self.modes],
        )


class _Program:
    """All terms of one kind of a law, lowered, the one constraint of a lone body put into them.

    `is_held`: its accelerations are those that this constraint leaves.
    """

    def __init__(self, law, kind, chains, part=None):
        self.kind = kind
        self.graph = g = Graph()
        self.terms = [term for term in law.terms if term.kind == kind]
        vectors = {k for k, v in chains.properties.items() if v.ndim == 3}
        parts, unknown = _instruments(law), fitted_properties(law)
        frame = Frame(g, parts, chains.n_dims, kind) if parts else None
        # Drag that fades with the speed brings nothing to rest.
        forces = (force for term in self.terms for force in summands(term.formula))
        may_stop = any("v_i" in f.inputs and not fades_at_rest(f) for f in forces)
        held = Held(g, part, chains, may_stop) if part else None
        self.series = chains.series.names
        late = late_inputs(law)
        self.moving = (*MOVING, *self.series, *(name + RATE for name in late))
        lowering = Lowering(
            held or frame or g, chains.n_dims, chains.direction, vectors, unknown, self.moving,
            rails_of(law),
        )  # fmt: skip
        total = [g.zero] * chains.n_dims
        for k, term in enumerate(self.terms):
            weight = g.input("weight", k)
            force = lowering.lower(term.acceleration_formula)
            if term.needs_mass and "mass" in unknown:
                force = [g.div(f, g.constant("mass_i")) for f in force]
            total = [g.add(a, g.mul(weight, f)) for a, f in zip(total, force, strict=True)]
        for axis in rails_of(law):
            total[axis] = g.zero
        if frame:
            total = frame.acceleration(total)
        names = replace(law, terms=tuple(self.terms)).names
        names += tuple(f"{column}_{role}" for column in unknown for role in "ij")
        self.is_held = held is not None and held.leaves_all(total, names, self.moving)
        if self.is_held:
            total = held.acceleration(total)
        self.constants = tuple(name for name in names if g.has_constant(name))
        self.modes, self.stops = lowering.modes, lowering.stops if may_stop else []
        self.value = Tape(g, total, self.moving)
        self._add_slopes(total, chains.n_dims, late)
        self._add_margins(chains.n_dims)
        self._add_media()

    def _add_media(self):
        """Velocities of that on which bodies come to rest, and their derivatives by constants."""
        g = self.graph
        media = [node for _, medium in self.stops for node in medium]
        self.media = Tape(g, media, self.moving)
        self.medium_of, nodes = self._by_constants(media)
        self.medium_slopes = Tape(g, nodes, self.moving)

    def _by_constants(self, nodes):
        """Derivatives of nodes by the constants, without zeros: (node, constant), slopes."""
        g = self.graph
        found = {(number, name): g.slope(node, g.constant(name))
                 for number, node in enumerate(nodes) for name in self.constants}  # fmt: skip
        which = [key for key, slope in found.items() if slope != g.zero]
        return which, [found[key] for key in which]

    def _add_slopes(self, total, n_dims, late):
        """Derivatives of the acceleration by places, velocities and constants."""
        g = self.graph
        self.slope_of, nodes = [], []
        for row, node in enumerate(total):
            for name in STATE if self.kind == "pair" else ("p_i", "v_i"):
                for axis in range(n_dims):
                    slope = g.slope(node, g.input(name, axis))
                    if slope != g.zero:
                        self.slope_of.append((row, name, axis))
                        nodes.append(slope)
        self.constant_of, by_constant = self._by_constants(total)
        nodes += by_constant
        for row, node in enumerate(total):
            for name, delay in late.items():
                slope = self._by_delay(node, name, n_dims)
                if slope != g.zero:
                    self.constant_of.append((row, delay))
                    nodes.append(slope)
        delays = {delay for _, delay in self.constant_of} - set(self.constants)
        self.constants += tuple(sorted(delays))
        self.slopes = Tape(g, nodes, self.moving)

    def _by_delay(self, node, name, n_dims):
        """Derivative of a node by the delay of an input."""
        g = self.graph
        parts = [
            g.mul(g.slope(node, g.input(name, axis)), g.input(name + RATE, axis))
            for axis in (None, *range(n_dims))
        ]
        return g.neg(g.sum(parts))

    def _add_margins(self, n_dims):
        g = self.graph
        names = STATE if self.kind == "pair" else ("p_i", "v_i")
        leaves = [(name, axis) for name in names for axis in range(n_dims)]
        margins = [mode.margin for mode in self.modes]
        self.margins = Tape(g, margins, self.moving)
        self.margin_slope_of, nodes = [], []
        for number, margin in enumerate(margins):
            keys = [*leaves, ("t", None), *((n, "constant") for n in self.constants)]
            for name, axis in keys:
                leaf = g.constant(name) if axis == "constant" else g.input(name, axis)
                slope = g.slope(margin, leaf)
                if slope != g.zero:
                    self.margin_slope_of.append((number, name, axis))
                    nodes.append(slope)
        self.margin_slopes = Tape(g, nodes, self.moving)


class Motion:
    """A law on some chains.

    Derivatives are by `parameters`, (name, entity) each; entity "" = one for all.
    """

    def __init__(self, law, chains, parameters):
        self.chains = chains
        self.law = law
        self.parameters = tuple(parameters)
        n_all, n_own = chains.code.shape[0], chains.n_moving
        self.others = np.array(
            [[j for j in range(n_all) if j != i] for i in range(n_own)], dtype=int
        ).reshape(n_own, n_all - 1)
        part = lone_constraint(law, chains)
        if part is not None:
            self.programs = [_Program(law, "field", chains, part)]
        self.is_folded = part is not None and self.programs[0].is_held
        if not self.is_folded:  # lowered as if there were none: that stands beside the formulas
            kinds = [t.kind for t in law.terms] + ["field"] * bool(_instruments(law))
            self.programs = [
                _Program(law, kind, chains)
                for kind in dict.fromkeys(kinds) if kind == "field" or n_all > 1
            ]
        self._settle()
        self._find_stops()
        self.has_modes = any(program.modes for program in self.programs)
        self.compiled = Compiled(self) if Compiled.can_take(self) else None
        # Pairs of moving bodies: (receivers, their sources' places among `others`, the sources).
        self._pairs = np.nonzero(self.others < n_own)
        self._pairs += (self.others[self._pairs],)

    def _find_stops(self):
        """Groups of axes along which bodies may come to rest, and on what: None is at rest."""
        found = {}
        for k, program in enumerate(self.programs):
            first = 0
            for axes, medium in program.stops:
                is_still = all(node == program.graph.zero for node in medium)
                found.setdefault((axes, None if is_still else (k, first)))
                first += len(axes)
        self.stops = tuple(axes for axes, _ in found)
        self._media = tuple(medium for _, medium in found)

    def on(self, chains, law):
        """The same formulas with other properties and constants.

        Parameters
        ----------
        chains : Chains
            Of the same build; the number of chains may differ.
        law : ForceLaw
            The same terms.
        """
        other = copy(self)
        other.chains, other.law = chains, law
        other.compiled = self.compiled and self.compiled.on(other)
        other._settle()
        return other

    def _settle(self):
        """Put in what the chains are."""
        self._static = [self._static_inputs(program) for program in self.programs]
        self._ready, self._picked = None, (None, {})
        self._late = late_inputs(self.law)
        owners = self._owners = Owners(self.law, self.chains, self.parameters, self.others)
        self._parameter_of = [
            {name: owners.parameter(name, program.kind) for name in program.constants}
            for program in self.programs
        ]
        is_held = bool(constraints_of(self.law))
        self.constraints = (
            Constraints(self.law, self.chains, self.parameters, owners) if is_held else None
        )
        is_linked = bool(linkages_of(self.law))
        self.linkages = Linkages(self.law, self.chains, self.parameters) if is_linked else None
        has_walls = bool(walls_of(self.law))
        self.walls = Walls(self.law, self.chains, self.parameters) if has_walls else None

    # --- what does not change along a track ------------------------------------------------------

    def _static_inputs(self, program):
        sizes = self.chains.contact_sizes(self.others) if program.kind == "pair" else {}
        sizes["is_driven"] = (self.others >= self.chains.n_moving)[..., None].astype(float)
        weights = [self._weight(term) for term in program.terms]

        def value(name, axis):
            if name == "weight":
                return _shared(weights[axis] if program.kind == "field" else weights[axis][:, None])
            if name in sizes:
                return _shared(sizes[name])
            if name == "is_scene":
                return np.array([scene == axis for scene in self.chains.scenes], dtype=float)
            column, role = property_of(name)
            values = self.chains.column(column)
            if axis is not None:
                values = values[..., axis]
            if role == "i":  # who does not know it has no weight, and 0 * nan is nan
                values = np.where(np.isnan(values), 1.0, values)
            own = values[: self.chains.n_moving]
            if program.kind == "field":
                return _shared(own)
            return _shared(own[:, None] if role == "i" else values[self.others])

        return value

    def _weight(self, term):
        """What turns a term's formula into an acceleration, (R, S): 0 where it cannot be felt."""
        chains = self.chains
        own = slice(None, chains.n_moving)
        weight = np.ones((chains.n_moving, chains.n_chains))
        if term.needs_mass and "mass" not in fitted_properties(self.law):
            mass = chains.column("mass")[own]
            unknown = 1.0 if self.law.is_per_entity(term) else np.inf
            weight = 1.0 / np.where(np.isnan(mass), unknown, mass)
        for name in term.acceleration_formula.inputs:
            known = property_of(name)
            if known and known[1] == "i":
                column = chains.column(known[0])[own]
                lost = np.isnan(column)
                weight = np.where(lost if lost.ndim == 2 else lost.any(axis=-1), 0.0, weight)
        return weight

    def set_constants(self, values):
        """Put the values of the free constants in, in the order of `parameters`.

        Values of shape (k, S) are those of each chain, for constants that bodies share.
        """
        if np.ndim(values) == 2:
            shared = dict(zip((name for name, _ in self.parameters), values, strict=True))
            known = {**self.law.constants, **shared}
        else:
            known = self.law.with_values(self.parameters, values).constants
        self._ready, self._picked = [], (None, {})
        for program, inputs in zip(self.programs, self._static, strict=True):
            constants = {
                name: self._owners.values(name, known, program.kind)
                for name in program.constants
            }
            self._ready.append(
                [
                    tape.prepare(inputs, constants)
                    for tape in (
                        program.value, program.slopes, program.margins, program.margin_slopes,
                        program.media, program.medium_slopes,
                    )
                ]
            )  # fmt: skip
        self.values = known
        if self.compiled:
            self.compiled.forget()
        for part in filter(None, (self.constraints, self.linkages, self.walls)):
            part.set_constants(known)

    def prepared(self, number, which):
        """What does not change along tracks for a tape of a program, as `Tape.prepare` gives it."""
        return self._ready[number][which]

    def parameter_of(self, number, name):
        """Which parameter a constant of a program is, as of `Owners.parameter`."""
        return self._parameter_of[number][name]

    # --- at points -------------------------------------------------------------------------------

    def _inputs(self, program, number, points):
        state, driven = points.state, points.driven
        if program.kind == "field":
            own = other = state
        else:
            own, other = state[:, :, None], self._sources(state, driven)

        def value(name, axis):
            if name == "t":
                return points.times
            if name == "mode":
                mode = program.modes[axis]
                held = points.modes[number][axis]
                if program.kind == "field":
                    held = held[:, 0]
                return np.where(held, mode.on, mode.off)
            if name.removesuffix(RATE) in program.series:
                values = self.measured(name, axis, points.times, points.chain)
                return values if program.kind == "field" else values[:, None]
            part = 0 if name[0] == "p" else 1
            return (own if name[-1] == "i" else other)[part][..., axis, :]

        return value

    def measured(self, name, axis, times, chain):
        """A measured input of every receiver at instants (M,), or its rate, shape (R, M)."""
        chains, own = self.chains, name.removesuffix(RATE)
        look = chains.series.along if own == name else chains.series.rate
        delay = self.values[self._late[own]] if own in self._late else 0.0
        times = times - np.broadcast_to(delay, chains.n_chains)[chain]
        chain = np.arange(chains.n_chains)[chain]
        out = np.full((chains.n_moving, len(times)), np.nan)
        for c in np.unique(chain):
            at = chain == c
            for r, body in enumerate(chains.bodies[c]):
                values = look(own, chains.scenes[c], body, times[at])
                out[r, at] = values if axis is None else values[axis]
        return out

    def _sources(self, state, driven):
        """Places and velocities of the sources of every receiver, (R, J, d, M) each."""
        if len(self.others) == 1:
            return driven[:, None]  # one receiver, and all others are driven
        whole = state if driven is None else np.concatenate([state, driven], axis=1)
        return _Picked(whole, self.others)

    def _run(self, which, points):
        """Outputs of one tape of every program: (program, arrays)."""
        names = ("value", "slopes", "margins", "margin_slopes", "media", "medium_slopes")
        for k, program in enumerate(self.programs):
            tape = getattr(program, names[which])
            with np.errstate(all="ignore"):
                prepared = self._prepared(k, which, points.chain)
                yield k, program, tape.run(prepared, self._inputs(program, k, points))

    def _prepared(self, number, which, chain):
        """What does not change along the tracks, for points of these chains.

        Stages of a step share their chains: the last ones are kept.
        """
        if self._picked[0] is not chain:
            self._picked = (chain, {})
        kept = self._picked[1]
        if (number, which) not in kept:
            n_chains = self.chains.n_chains
            ready = self._ready[number][which]
            kept[number, which] = {n: _at(v, chain, n_chains) for n, v in ready.items()}
        return kept[number, which]

    def acceleration(self, points, holds=True):
        """Accelerations, shape (R, d, M), m/s^2; 0 of a body at rest that friction holds there.

        Without `holds` a body at rest has no direction, and feels no friction: the paper's rule.
        """
        if not (self.stops and holds):
            return self._acceleration(points)
        points = self._settled(points)
        total = self._acceleration(points)
        out = total
        for group in range(len(self.stops)):
            if not self.are_at_rest(group, points, points.state[1]).any():
                continue  # all move, as bodies nearly always do
            still, is_held, creeping = self._at_rest(points, total, group)
            if creeping is not None:
                out = np.where(still, creeping, out)
                out = np.where(is_held, 0.0, out)
        return out

    @property
    def has_stops(self):
        """Whether friction may bring a body to rest."""
        return bool(self.stops)

    def is_held(self, points):
        """Bodies at rest that friction holds, and along which axes, (R, d, M).

        Whichever way they crept, it would stop them: Coulomb's rule, with one coefficient for rest
        and motion.
        """
        points = self._settled(points)
        total = self._acceleration(points)
        held = [self._at_rest(points, total, group)[1] for group in range(len(self.stops))]
        return np.any(held, axis=0)

    def past(self, group, points, velocity):
        """Velocities (R, d, M) past that on which bodies of a group of axes rest, (R, a, M)."""
        return velocity[:, list(self.stops[group])] - self.medium(group, points)

    def is_carried(self, group):
        """Whether that on which bodies of a group of axes come to rest moves."""
        return self._media[group] is not None

    def _settled(self, points):
        """The points with bodies that are as fast as what they rest on just as fast."""
        state = points.state
        for group in filter(self.is_carried, range(len(self.stops))):
            is_still = self.are_at_rest(group, points, state[1])[:, None]
            if is_still.any():
                axes, state = list(self.stops[group]), state.copy()
                medium = self.medium(group, points)
                state[1][:, axes] = np.where(is_still, medium, state[1][:, axes])
        return points if state is points.state else points.at(state)

    def are_at_rest(self, group, points, velocities):
        """Bodies (..., R, M) whose velocities (..., R, d, M) are those of what they rest on."""
        medium, axes = self.medium(group, points), list(self.stops[group])
        past = np.square(velocities[..., axes, :] - medium).sum(axis=-2)
        whole = np.square(medium).sum(axis=-2) if self.is_carried(group) else 0.0
        return past <= ALIKE**2 * whole

    def medium(self, group, points):
        """Velocity of that on which bodies of a group of axes come to rest, (R, a, M), or 0.0."""
        if self._media[group] is None:
            return 0.0
        (number, first), n_own = self._media[group], self.chains.n_moving
        values = next(out for k, _, out in self._run(4, points) if k == number)
        axes, shape = self.stops[group], (n_own, points.state.shape[-1])
        return np.stack(
            [np.broadcast_to(self._first(number, v), shape) for v in values[first:][: len(axes)]],
            axis=1,
        )

    def _first(self, number, value):
        """Values of a medium, which all sources of a receiver share, (R, M)."""
        is_pair = self.programs[number].kind == "pair" and np.ndim(value) == 3
        return value[:, 0] if is_pair else value

    def medium_slope(self, group, points):
        """Derivatives of that velocity by the constants, (R, a, k, M)."""
        axes, (_, n_own, _, n_points) = self.stops[group], points.state.shape
        out = np.zeros((n_own, len(axes), len(self.parameters), n_points))
        if self._media[group] is None:
            return out
        number, first = self._media[group]
        program = self.programs[number]
        values = next(found for k, _, found in self._run(5, points) if k == number)
        for (node, name), value in zip(program.medium_of, values, strict=True):
            if first <= node < first + len(axes):
                owners = np.asarray(self.parameter_of(number, name))
                own = owners[:, 0] if owners.ndim == 3 else owners
                value = np.broadcast_to(self._first(number, value), (n_own, n_points))
                at = own[..., points.chain] if own.ndim else np.broadcast_to(own, value.shape)
                body, point = np.nonzero(np.broadcast_to(at, value.shape) >= 0)
                where = np.broadcast_to(at, value.shape)[body, point]
                out[body, node - first, where, point] += value[body, point]
        return out

    def _at_rest(self, points, at_rest, group):
        """Bodies at rest along a group of axes, those held there, and how those go that creep.

        `at_rest` are accelerations where a velocity of zero has no direction; None creeps if none
        rests.
        """
        still, axes = np.zeros(at_rest.shape, dtype=bool), list(self.stops[group])
        still[:, axes] = self.are_at_rest(group, points, points.state[1])[:, None]
        if not still.any():
            return still, still, None
        pull = np.where(still, at_rest, 0.0)
        size = np.sqrt(np.square(pull).sum(axis=1, keepdims=True))
        way = np.where(size > 0, pull / np.where(size > 0, size, 1.0), 0.0)
        idle = still[:, axes[0]] & (size[:, 0] == 0)
        way[:, axes[0]] = np.where(idle, 1.0, way[:, axes[0]])  # nothing pulls: any way will do
        creep = points.state.copy()
        creep[1] += CREEP * way
        moved = Points(creep, points.times, points.chain, points.driven, points.modes)
        creeping = self._acceleration(moved)
        return still, still & ((creeping * way).sum(axis=1, keepdims=True) <= 0), creeping

    def _free_acceleration(self, points):
        total = self._pushed(points)
        return self.linkages.accelerations(total, points) if self.linkages else total

    def _pushed(self, points):
        if self.compiled:
            return self.compiled.accelerations(points)
        _, n_own, n_dims, n_points = points.state.shape
        total = np.zeros((n_own, n_dims, n_points))
        for number, program, outputs in self._run(0, points):
            for axis, value in enumerate(outputs):
                value = self._summed(program, value, n_points)
                if number:
                    total[:, axis] += value
                else:
                    total[:, axis] = value
        return total

    def _acceleration(self, points):
        if not self.constraints or self.is_folded:
            return self._free_acceleration(points)
        return self.constraints.accelerations(self._free_acceleration(self._along(points)), points)

    def _along(self, points):
        """Points at which forces are asked: friction turns with the least way off constraints."""
        return points.at(self.constraints.along(points)) if self.stops else points

    def _summed(self, program, value, n_points):
        """A term's values summed over the sources, (R, M)."""
        if program.kind == "field":
            return value
        if np.ndim(value) == 3 and np.shape(value)[1] == self.others.shape[1]:
            return value.sum(axis=1)
        shape = (*self.others.shape, n_points)
        return np.broadcast_to(value, shape).sum(axis=1)

    def slopes(self, points, holds=True):
        """Derivatives by the state, (M, R d, 2 R d), and by the constants, (M, R d, k)."""
        found = self.slope_rows(points, holds)
        return tuple(np.ascontiguousarray(np.moveaxis(part, -1, 0)) for part in found)

    def slope_rows(self, points, holds=True):
        """The same with the points on the last axis."""
        _, n_own, n_dims, n_points = points.state.shape
        n, asked = n_own * n_dims, points
        is_left = self.constraints and not self.is_folded
        if is_left:
            points = self._along(points)
        by_state = np.zeros((n_own, n_dims, 2, n_own, n_dims, n_points))
        by_constant = np.zeros((n_own, n_dims, len(self.parameters), n_points))
        held = self.is_held(points) if self.has_stops and holds else None
        if self.compiled:
            k = len(self.parameters)
            shapes = (n, 2 * n, n_points), (n, k, n_points)
            self.compiled.add_slopes(
                points, by_state.reshape(shapes[0]), by_constant.reshape(shapes[1])
            )
        else:
            self._add_slopes(points, by_state, by_constant)
        if self.linkages:
            free = self._pushed(points)
            by_state, by_constant = self.linkages.slopes(free, by_state, by_constant, points)
        if is_left:
            free = self._free_acceleration(points)
            flat = by_state.reshape(n, 2 * n, n_points), by_constant.reshape(n, -1, n_points)
            if points is not asked:
                moved = self.constraints.tangent_rows(points, is_there=True)
                moved = np.einsum("nzm,zym->nym", flat[0], moved)
                flat = moved[:, : 2 * n], flat[1] + moved[:, 2 * n :]
            by_state, by_constant = self.constraints.slopes(free, *flat, asked)
            by_state = by_state.reshape(n_own, n_dims, 2, n_own, n_dims, n_points)
            by_constant = by_constant.reshape(n_own, n_dims, -1, n_points)
        if held is not None:
            by_state[np.broadcast_to(held[:, :, None, None, None], by_state.shape)] = 0.0
            by_constant[np.broadcast_to(held[:, :, None], by_constant.shape)] = 0.0
        return by_state.reshape(n, 2 * n, n_points), by_constant.reshape(n, -1, n_points)

    def _add_slopes(self, points, by_state, by_constant):
        """Add derivatives of forces to arrays (R, d, 2, R, d, M) and (R, d, k, M)."""
        for k, program, outputs in self._run(1, points):
            for (row, name, axis), value in zip(program.slope_of, outputs, strict=False):
                self._add_slope(program, by_state, row, name, axis, value)
            rest = outputs[len(program.slope_of) :]
            for (row, name), value in zip(program.constant_of, rest, strict=True):
                parameter = self.parameter_of(k, name)
                self._add_constant(by_constant[:, row], program, parameter, value, points.chain)

    def slope_pattern(self):
        """Which derivatives by the state may differ from zero: a list of (row, column)."""
        n_own, n_dims = self.chains.n_moving, self.chains.n_dims
        if self.linkages or (self.constraints and not self.is_folded):
            return list(np.ndindex(n_own * n_dims, 2 * n_own * n_dims))
        found = np.zeros((n_own, n_dims, 2, n_own, n_dims, 1))
        for program in self.programs:
            for row, name, axis in program.slope_of:
                shape = self._shape(program, 1)
                value = np.ones(shape if program.kind == "pair" else (n_own, 1))
                self._add_slope(program, found, row, name, axis, value)
        n = n_own * n_dims
        return [tuple(pair) for pair in np.argwhere(found.reshape(n, 2 * n)).tolist()]

    def _add_slope(self, program, by_state, row, name, axis, value):
        part = 0 if name[0] == "p" else 1
        n_own = by_state.shape[0]
        own = np.arange(n_own)
        if name[-1] == "i":
            by_state[own, row, part, own, axis] += self._summed(
                program, value, by_state.shape[-1]
            )
            return
        if len(self._pairs[0]):
            value = np.broadcast_to(value, (*self.others.shape, by_state.shape[-1]))
            receiver, place, source = self._pairs
            by_state[receiver, row, part, source, axis] += value[receiver, place]

    def _add_constant(self, by_constant, program, parameter, value, chain):
        """Add a derivative to the parameters of its constant, (R, k, M)."""
        n_points = by_constant.shape[-1]
        if np.ndim(parameter) == 0:
            if parameter >= 0:
                by_constant[:, parameter] += self._summed(program, value, n_points)
            return
        if program.kind == "pair" and parameter.shape[1] == 1:  # one for all sources
            value, parameter = self._summed(program, value, n_points), parameter[:, 0]
        owner = parameter[..., chain]
        value = np.broadcast_to(value, owner.shape)
        each = [(owner, value)] if owner.ndim == 2 else zip(
            np.moveaxis(owner, 1, 0), np.moveaxis(value, 1, 0), strict=True
        )  # fmt: skip
        for own, part in each:  # of every source in turn
            body, point = np.nonzero(own >= 0)
            by_constant[body, own[body, point], point] += part[body, point]

    def _parameters_at(self, number, name, receiver, other, chain, n_points):
        """The parameter of a constant for a receiver and a source at every point; -1 = none."""
        parameter = np.asarray(self.parameter_of(number, name))
        if parameter.ndim == 3:
            parameter = parameter[:, min(other, parameter.shape[1] - 1)]
        return parameter[receiver][chain] if parameter.ndim else np.full(n_points, parameter)

    # --- conditions ------------------------------------------------------------------------------

    def margins(self, points):
        """Margins of all conditions, per program (n_modes, R, J, M); field laws have J = 1."""
        out = [np.zeros((0, 1, 1, points.state.shape[-1])) for _ in self.programs]
        if not self.has_modes:
            return out
        for k, program, outputs in self._run(2, points):
            if outputs:
                shape = self._shape(program, points.state.shape[-1])
                out[k] = np.stack([_lifted(program, v, shape) for v in outputs])
        return out

    def _shape(self, program, n_points):
        n_own = self.chains.n_moving
        return (n_own, 1 if program.kind == "field" else self.others.shape[1], n_points)

    def modes_at(self, points):
        """Whether each condition holds, per program (n_modes, R, J, M)."""
        return [margin > 0 for margin in self.margins(points)]

    def margin_slope(self, points, program_number, mode, receiver, other):
        """Derivatives of one margin at every point.

        Returns
        -------
        by_state : ndarray, shape (M, 2 * R * d)
        by_time : ndarray, shape (M,)
        by_constant : ndarray, shape (M, k)
        """
        _, n_own, n_dims, n_points = points.state.shape
        by_state = np.zeros((2, n_own, n_dims, n_points))
        by_time, by_constant = np.zeros(n_points), np.zeros((len(self.parameters), n_points))
        for k, program, outputs in self._run(3, points):
            if k != program_number:
                continue
            shape = self._shape(program, n_points)
            for (number, name, axis), value in zip(program.margin_slope_of, outputs, strict=True):
                if number != mode:
                    continue
                value = _lifted(program, value, shape)[receiver, other]
                if name == "t":
                    by_time += value
                elif axis == "constant":
                    owner = self._parameters_at(k, name, receiver, other, points.chain, n_points)
                    at = np.flatnonzero(owner >= 0)
                    by_constant[owner[at], at] += value[at]
                else:
                    part = 0 if name[0] == "p" else 1
                    body = receiver if name[-1] == "i" else self.others[receiver, other]
                    if body < n_own:
                        by_state[part, body, axis] += value
        return by_state.reshape(-1, n_points).T, by_time, by_constant.T


def _instruments(law):
    """Through what bodies are seen."""
    return tuple(part for part in law.frame if part.kind == "instrument")


class _Picked:
    """The states of some bodies, places and velocities each taken when they are asked for."""

    def __init__(self, whole, bodies):
        self.whole, self.bodies, self.parts = whole, bodies, {}

    def __getitem__(self, part):
        if part not in self.parts:
            self.parts[part] = self.whole[part][self.bodies]
        return self.parts[part]


def _lifted(program, value, shape):
    """A value of a margin for every receiver and source, (R, J, M)."""
    if program.kind == "field" and np.ndim(value) == 2:  # (R, M); of the time alone it is (M,)
        value = value[:, None]
    return np.broadcast_to(value, shape)


def _shared(values):
    """An array (..., S) cut to (..., 1) where all chains have the same values."""
    values = np.asarray(values, dtype=float)
    first = values[..., :1]
    same = (values == first) | (np.isnan(values) & np.isnan(first))
    return first if same.all() else values


def _at(value, chain, n_chains):
    """A prepared value for points of these chains."""
    if np.ndim(value) == 0 or np.shape(value)[-1] != n_chains or n_chains == 1:
        return value
    return value[..., chain]
