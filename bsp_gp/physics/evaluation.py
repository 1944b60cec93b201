"""Laws made ready for many evaluations in the same scenes: a rollout asks at every step.

What does not change along a track (properties, directions, constants, and all that depends on
them alone) is computed once; what several terms share is computed once a step.
"""

import numpy as np

from bsp_gp.language.formula import Call, Constant, Input
from bsp_gp.language.inputs import property_of
from bsp_gp.language.operators import OPERATORS
from bsp_gp.physics.bodies import law_inputs, under

CHANGING = ("p_i", "p_j", "v_i", "v_j", "p_c", "t")
"""Inputs that differ from instant to instant; all others belong to the scene."""
FEW = 8
"""Sources up to which their forces are added one by one."""
CONTACTS = ("does_collide", "is_on")
"""Operators whose value is 1 or 0: where no bodies meet, a force that they multiply is zero."""


class PreparedLaw:
    """A law with the constants and the bodies of some scenes put in.

    Parameters
    ----------
    values : dict, optional
        Constants as `ForceLaw.values` gives them; they may have leading axes for copies.
    skips : bool
        Compute no force of contact at instants when no bodies meet. Then such a force is zero
        also for bodies of which it is not known where they are.
    """

    def __init__(self, law, bodies, values=None, skips=False):
        self.bodies = bodies = under(law, bodies)
        values = law.values(bodies) if values is None else values
        self._programs = []
        for kind in dict.fromkeys(term.kind for term in law.terms):
            terms = [term for term in law.terms if term.kind == kind]
            settlings = [Settling(term, bodies, law.is_per_entity(term)) for term in terms]
            formulas = [term.acceleration_formula for term in terms]
            program = _Program(kind, formulas, bodies, values[kind], skips)
            self._programs.append((program, settlings))

    def acceleration(self, positions, velocities, times):
        """Acceleration of every receiver, shape (..., S, R, d), m/s^2; see `ForceLaw`."""
        bodies = self.bodies
        shape = (
            *positions.shape[:-3], bodies.n_scenes, len(bodies.receivers), bodies.n_dims
        )  # fmt: skip
        total = np.zeros(shape)
        with np.errstate(all="ignore"):
            for program, settlings in self._programs:
                forces = program.run(positions, velocities, times)
                for force, settling in zip(forces, settlings, strict=True):
                    if force is not None:
                        total = total + settling(force, shape)
        return total


class _Steps:
    """Formulas as a list of steps on numbered values; what is known is computed at once."""

    def __init__(self):
        self.start, self._inputs, self._steps, self._numbers = [], {}, {}, {}

    def _known(self, leaf):
        """Value of an input, a constant or a number; None where it is told later."""
        raise NotImplementedError

    def _add(self, node):
        """Number of a node's value; its step is put down on first sight."""
        if node in self._numbers:
            return self._numbers[node]
        value = step = None
        if isinstance(node, Call):
            arguments = [self._add(arg) for arg in node.args]
            compute = OPERATORS[node.operator].evaluate
            types = tuple(arg.type for arg in node.args)
            known = [self.start[k] for k in arguments]
            if any(v is None for v in known):
                step = (compute, types, arguments)
            else:
                value = compute(types, *known)
        else:
            value = self._known(node)
        number = self._numbers[node] = len(self.start)
        self.start.append(value)
        if step is not None:
            self._steps[number] = step
        elif value is None:
            self._inputs[number] = node.name
        return number


class _Program(_Steps):
    """Formulas of one kind as a list of steps on numbered values.

    With `skips`, contacts are computed first, and after them only what forces need none of whose
    contacts is missing.
    """

    def __init__(self, kind, formulas, bodies, constants, skips):
        super().__init__()
        self.kind, self.bodies, self._constants = kind, bodies, constants
        self._scene = law_inputs(kind, bodies, None, None, None)
        with np.errstate(all="ignore"):
            self._results = [self._add(formula) for formula in formulas]
        self._awaited = [
            {self._numbers[node] for node in _contacts_of(formula)} if skips else set()
            for formula in formulas
        ]
        self._contacts = sorted(set().union(*self._awaited))
        self._first, self._known_first = self._plan(self._contacts, set())
        self._plans = {}

    def _known(self, leaf):
        if isinstance(leaf, Constant):
            return self._constants[leaf.name]
        if not isinstance(leaf, Input):
            return np.float64(leaf.value)
        is_changing = leaf.name in (*CHANGING, *self.bodies.series.names)
        return None if is_changing else self._scene[leaf.name]

    def _plan(self, wanted, known):
        """Inputs and steps that lead to the values wanted from those known, and their numbers."""
        wanted = set(wanted)
        for number in sorted(self._steps, reverse=True):  # arguments have lower numbers
            if number in wanted:
                wanted.update(self._steps[number][2])
        inputs = [(n, name) for n, name in self._inputs.items() if n in wanted - known]
        steps = [(n, *step) for n, step in self._steps.items() if n in wanted - known]
        return (inputs, steps), wanted

    def _plan_where(self, met):
        """Plan and numbers of the results (None: zero) where these contacts are made."""
        results = [
            number if awaited <= set(met) else None
            for number, awaited in zip(self._results, self._awaited, strict=True)
        ]
        return self._plan([k for k in results if k is not None], self._known_first)[0], results

    def run(self, positions, velocities, times):
        """Values of the formulas; None where one is zero for want of a contact."""
        values = self.start.copy()
        lookup = law_inputs(self.kind, self.bodies, positions, velocities, times)
        _follow(self._first, values, lookup)
        met = tuple([k for k in self._contacts if values[k].any()])
        if met not in self._plans:
            self._plans[met] = self._plan_where(met)
        plan, results = self._plans[met]
        _follow(plan, values, lookup)
        return [None if k is None else values[k] for k in results]


def _follow(plan, values, lookup):
    """Compute the values of a plan in place."""
    inputs, steps = plan
    for number, name in inputs:
        values[number] = lookup[name]
    for number, compute, types, arguments in steps:
        values[number] = compute(types, *[values[k] for k in arguments])


def _contacts_of(formula):
    if not isinstance(formula, Call):
        return ()
    if formula.operator in CONTACTS:
        return (formula,)
    if formula.operator == "mul":
        return tuple(node for arg in formula.args for node in _contacts_of(arg))
    return _contacts_of(formula.args[0]) if formula.operator in ("neg", "div") else ()


class Instants(_Steps):
    """Terms of a kind at the same instants, for many values of the constants inside them.

    What no constant changes is computed once. Places and velocities are (n, S, N, d), times (n, S).
    """

    def __init__(self, terms, bodies, positions, velocities, times):
        super().__init__()
        self._lookup = law_inputs(terms[0].kind, bodies, positions, velocities, times)
        self._settlings = [Settling(term, bodies) for term in terms]
        self._shape = (*np.shape(times), len(bodies.receivers), bodies.n_dims)
        with np.errstate(all="ignore"):
            self._ends = [self._add(term.acceleration_formula) for term in terms]
        self._whole = self._inputs.items(), [(k, *step) for k, step in self._steps.items()]

    def _known(self, leaf):
        if isinstance(leaf, Constant):
            return None
        return self._lookup[leaf.name] if isinstance(leaf, Input) else np.float64(leaf.value)

    def accelerations(self, constants):
        """Accelerations of the terms for P values of the constants, shape (n, S, R, P, c, d).

        They are not finite where a term is not.
        """
        values, tail = self.start.copy(), (1,) * (len(self._shape) - 2 + self._lookup.tail)
        n_values = len(next(iter(constants.values())))
        with np.errstate(all="ignore"):
            _follow(self._whole, values,
                    {name: np.reshape(own, (-1, *tail)) for name, own in constants.items()})
            out = np.empty((n_values, len(self._ends), *self._shape))
            for c, (end, settling) in enumerate(zip(self._ends, self._settlings, strict=True)):
                out[:, c] = settling(values[end], (n_values, *self._shape))
        return np.moveaxis(out, (0, 1), (3, 4))


class Settling:
    """Sums a term's values over sources and turns the force into an acceleration.

    A receiver of which a property that the term needs is unknown cannot feel the term: its
    acceleration is 0. With constants of its own (`per_entity`) only its mass is not needed:
    the constant is then per unit mass.
    """

    def __init__(self, term, bodies, per_entity=False):
        self._is_pair = term.kind == "pair"
        self._n_sources = bodies.others.shape[1]
        self._mass = None
        if term.needs_mass:
            mass = bodies.column("mass")[:, bodies.receivers]
            unknown = 1.0 if per_entity else np.inf
            self._mass = np.where(np.isnan(mass), unknown, mass)[..., None]
        lost = unknown_receivers(term, bodies)
        self._lost = lost[..., None] if lost.any() else None

    def __call__(self, force, shape):
        """Acceleration of `shape` (..., S, R, d) from the values of the term's formula."""
        if self._is_pair:
            full = (*shape[:-1], self._n_sources, shape[-1])
            if np.shape(force) != full:
                force = np.broadcast_to(force, full)
            with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is refused
                force = _summed(force)  # by the caller
        if self._mass is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                force = force / self._mass
        if self._lost is not None:
            force = np.where(self._lost, 0.0, force)
        return force if np.shape(force) == tuple(shape) else np.broadcast_to(force, shape)


def _summed(force):
    """Sum over the sources, the last axis but one; NumPy's own is slow along so short an axis."""
    n_sources = force.shape[-2]
    if not 0 < n_sources <= FEW:
        return force.sum(axis=-2)
    total = force[..., 0, :]
    for k in range(1, n_sources):
        total = total + force[..., k, :]
    return total


def unknown_receivers(term, bodies):
    """Receivers (S, R) of which the term names an unknown property, beside a cancelling mass."""
    kept = bodies.__dict__.setdefault("_unknown", {})
    if term.acceleration_formula not in kept:
        kept[term.acceleration_formula] = _unknown_receivers(term, bodies)
    return kept[term.acceleration_formula]


def _unknown_receivers(term, bodies):
    unknown = np.zeros((bodies.n_scenes, len(bodies.receivers)), dtype=bool)
    for name in term.acceleration_formula.inputs:
        known = property_of(name)
        if known and known[1] == "i":
            column = bodies.column(known[0])[:, bodies.receivers]
            unknown |= np.isnan(column).reshape(*column.shape[:2], -1).any(axis=-1)
    return unknown
