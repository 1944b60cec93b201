"""Laws packed for the compiled loops of `kernel`.

A motion is packed unless an operator of a user's acts in it, which only NumPy can call.
"""

from copy import copy

import numpy as np

from bsp_gp.physics.engine import kernel
from bsp_gp.physics.engine.kernel import OPS, Code, Inputs

STATES = {
    "p_i": kernel.PLACE, "v_i": kernel.VELOCITY,
    "p_j": kernel.PLACE_OF_SOURCE, "v_j": kernel.VELOCITY_OF_SOURCE,
}  # fmt: skip
ONE_STAGE = np.zeros((1, 1)), np.zeros(1)
NONE = np.zeros((1, 0, 0, 0))


class Compiled:
    """The programs of a motion, packed."""

    def __init__(self, motion):
        self.motion = motion
        self.series = list(dict.fromkeys(
            key for program in motion.programs
            for tape in (program.value, program.slopes) for _, key in tape.loads
            if key[0] not in (*STATES, "t", "mode")
        ))  # fmt: skip
        self.modes, self._first_mode = [], []
        for number, program in enumerate(motion.programs):
            self._first_mode.append(len(self.modes))
            self.modes += [(number, k, mode) for k, mode in enumerate(program.modes)]
        self._plans = [self._plan(which) for which in (0, 1)]
        self._codes = [None, None]

    @staticmethod
    def can_take(motion):
        """Whether all operations of a motion are among those that are compiled."""
        return all(
            op in OPS for program in motion.programs
            for tape in (program.value, program.slopes) for op, *_ in tape.line
        )  # fmt: skip

    def on(self, motion):
        """The same formulas on other chains."""
        other = copy(self)
        other.motion, other._codes = motion, [None, None]
        return other

    def forget(self):
        """Constants have changed."""
        self._codes = [None, None]

    # --- packing ---------------------------------------------------------------------------------

    def _plan(self, which):
        """Rows of loads, steps and results of all programs, with the first ones of each."""
        plans, base = [], 0
        for number, program in enumerate(self.motion.programs):
            tape = (program.value, program.slopes)[which]
            loads = [(place, *self._load(number, *key)) for place, key in tape.loads]
            steps = [(OPS[op], x, x if y is None else y, to) for op, x, y, to in tape.line]
            plans.append((tape, loads, steps, base))
            base += tape.n_places
        return plans, base

    def _load(self, number, name, axis):
        if name == "t":
            return kernel.TIME, 0
        if name == "mode":
            return kernel.MODE, self._first_mode[number] + axis
        if name in STATES:
            return STATES[name], axis
        return kernel.SERIES, self.series.index((name, axis))

    def _code(self, which):
        if self._codes[which] is None:
            self._codes[which] = self._packed(which)
        return self._codes[which]

    def _packed(self, which):
        motion = self.motion
        plans, n_registers = self._plans[which]
        rows = {name: [] for name in ("kept", "loads", "steps", "outs")}
        numbers, owners = _Flat(), _Flat()
        programs = []
        for number, (tape, loads, steps, base) in enumerate(plans):
            program, first = motion.programs[number], {k: len(v) for k, v in rows.items()}
            ready = motion.prepared(number, which)
            rows["kept"] += [
                (place, *numbers.put(ready[node], program.kind)) for place, node in tape.kept
            ]
            rows["loads"] += loads
            rows["steps"] += steps
            rows["outs"] += self._outs(number, which, owners)
            ends = [n for k in rows for n in (first[k], len(rows[k]))]
            programs.append((program.kind == "pair", *ends, base))
        tables = {name: _table(rows[name], width) for name, width in
                  (("kept", 5), ("loads", 3), ("steps", 4), ("outs", 7))}  # fmt: skip
        return Code(
            programs=_table(programs, 10), numbers=numbers.joined(float),
            parameters=owners.joined(np.int64), n_registers=n_registers,
            others=np.ascontiguousarray(motion.others, dtype=np.int64), **tables,
        )  # fmt: skip

    def _outs(self, number, which, owners):
        """Where the results of a program belong."""
        program, motion = self.motion.programs[number], self.motion
        tape = (program.value, program.slopes)[which]
        if which == 0:
            return [(place, row, 0, 0, 0, 0, 0) for row, place in enumerate(tape.places)]
        n_dims, out, places = motion.chains.n_dims, [], iter(tape.places)
        for (row, name, axis), place in zip(program.slope_of, places, strict=False):
            by = kernel.OWN if name[-1] == "i" else kernel.SOURCE
            part = 0 if name[0] == "p" else 1
            out.append((place, row, by, part * n_dims + axis, 0, 0, 0))
        places = tape.places[len(program.slope_of) :]
        for (row, name), place in zip(program.constant_of, places, strict=True):
            owner = np.asarray(motion.parameter_of(number, name))
            out.append((place, row, kernel.CONSTANT, *owners.put(owner, program.kind)))
        return out

    # --- at points -------------------------------------------------------------------------------

    def inputs(self, times, chain, driven, modes):
        """What points have beside states.

        Parameters
        ----------
        times : ndarray, shape (s, M)
        chain : ndarray of int, shape (M,), or slice
        driven : ndarray, shape (2, D, d, M or s M) or None
        modes : list of ndarray of bool
            As of `Points`.
        """
        motion = self.motion
        chain = np.ascontiguousarray(np.arange(motion.chains.n_chains)[chain])
        driven = NONE if driven is None else np.ascontiguousarray(driven)
        series, held = NONE[0], NONE
        if self.series:
            asked = times.ravel(), np.tile(chain, len(times))
            series = np.stack([motion.measured(*key, *asked) for key in self.series])
        if self.modes:
            n_own, n_others = motion.others.shape
            held = np.empty((len(self.modes), n_own, max(n_others, 1), len(chain)))
            for k, (number, place, mode) in enumerate(self.modes):
                held[k] = np.where(modes[number][place], mode.on, mode.off)
        n_each = len(chain) if driven.shape[-1] > len(chain) else 0
        return Inputs(np.ascontiguousarray(times), chain, driven, n_each, series, held)

    def accelerations(self, points):
        """Forces over masses at points, (R, d, M)."""
        state, inputs = self._of(points)
        h, rates = np.zeros(len(points.times)), np.empty((1, *state.shape))
        kernel.step(self._code(0), *ONE_STAGE, h, inputs, state[None], rates, state.copy())
        return rates[0, 1]

    def add_slopes(self, points, by_state, by_constant):
        """Add their derivatives to arrays (R d, 2 R d, M) and (R d, k, M)."""
        kernel.slopes(self._code(1), *self._of(points), by_state, by_constant)

    def _of(self, points):
        inputs = self.inputs(points.times[None], points.chain, points.driven, points.modes)
        return np.ascontiguousarray(points.state), inputs

    def step(self, scheme, state, h, inputs):
        """One step of a scheme.

        Parameters
        ----------
        state : ndarray, shape (2, R, d, M)
        h : ndarray, shape (M,), s
        inputs : Inputs
            At the instants of all stages.

        Returns
        -------
        end : ndarray, shape (2, R, d, M)
        states, rates : ndarray, shape (s, 2, R, d, M)
            Of the stages.
        """
        states = np.empty((scheme.n_stages, *state.shape))
        states[0] = state
        end, rates, h = np.empty(state.shape), np.empty_like(states), np.ascontiguousarray(h)
        kernel.step(self._code(0), scheme.a, scheme.b, h, inputs, states, rates, end)
        return end, states, rates

    def carry(self, scheme, states, h, inputs, pattern, first):
        """Derivatives at the ends of steps from those at their starts, (n, n + k, M)."""
        first, h = np.ascontiguousarray(first), np.ascontiguousarray(h)
        out = np.empty_like(first)
        kernel.carry(self._code(1), scheme.a, scheme.b, h, inputs, states, pattern, first, out)
        return out


class _Flat:
    """Arrays of receivers, sources and chains laid out one behind the other."""

    def __init__(self):
        self.parts, self.size = [], 0

    def put(self, values, kind):
        """Where they begin, and their strides by receiver, source and chain."""
        values = np.asarray(values)
        shape = (1,) * (3 - values.ndim) + values.shape
        if kind == "field" and values.ndim == 2:
            shape = (values.shape[0], 1, values.shape[1])
        values = np.ascontiguousarray(values).reshape(shape)
        place = self.size
        self.parts.append(values.ravel())
        self.size += values.size
        strides = (
            values.strides[k] // values.itemsize if n > 1 else 0 for k, n in enumerate(shape)
        )
        return place, *strides

    def joined(self, kind):
        return np.concatenate([np.zeros(0, kind), *self.parts]).astype(kind, copy=False)


def _table(rows, width):
    return np.array(rows, dtype=np.int64).reshape(-1, width)
