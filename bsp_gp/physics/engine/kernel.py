"""Compiled loops of the engine: tapes, steps and their derivatives, some points at a time.

What `graph.Tape`, `Motion` and `Flow.step` compute with NumPy, a call for every operation of every
stage, is here one call for a step. Few points are left waiting by no interpreter, and of many what
a stage needs stays in the cache. `compiled` packs laws into the arrays that are read here.
"""

from collections import namedtuple

import numpy as np

from bsp_gp.compiling import compiled
from bsp_gp.language.operators import GUARD

Code = namedtuple("Code", "programs kept numbers loads steps outs parameters others n_registers")
"""A law packed: rows of integers for each program, and the numbers that do not change.

programs : (P, 10), sources are others or none; first and last rows of kept, loads, steps, outs; and
    the first register
kept : (., 5), register, place in `numbers`, and its strides by receiver, source and chain
loads : (., 3), register, kind of input (`TIME` ...), axis or number
steps : (., 4), operation, first and second register, register of the result
outs : (., 7), register, row, what it is derived by (`OWN`, `SOURCE`, `CONSTANT`), column or place
    in `parameters`, and its strides
parameters : numbers of the parameters that constants are; -1 = none
others : (R, J), the sources of every receiver
"""
Inputs = namedtuple("Inputs", "times chain driven n_each series modes")
"""What points have beside states: times (s, M), chains (M,), places and velocities of driven bodies
(2, D, d, s M or M) of which each stage has `n_each`, measured inputs (Q, R, s M), and the values
of modes (Q, R, J, M)."""

OPS = {
    name: number for number, name in enumerate((
        "add", "sub", "mul", "div", "neg", "square", "sqrt", "inverse_positive", "pow", "exp",
        "log", "sin", "cos", "tanh", "abs", "sign", "minimum", "less", "inverse_guarded",
        "log_positive", "bessel_k0", "bessel_k1",
    ))
}  # fmt: skip
TIME, PLACE, VELOCITY, PLACE_OF_SOURCE, VELOCITY_OF_SOURCE, SERIES, MODE = range(7)
OWN, SOURCE, CONSTANT = range(3)
FAR = 745.0
"""From here on exp(-x) is zero."""
LANES, MOST_CARRIED = 128, 1 << 16
"""Points that are computed together, and derivatives of them in all stages."""


@compiled
def _operate(op, x, y, z, n):
    """An operation of `OPS` on n points."""
    if op == 0:
        for m in range(n):
            z[m] = x[m] + y[m]
    elif op == 1:
        for m in range(n):
            z[m] = x[m] - y[m]
    elif op == 2:
        for m in range(n):
            z[m] = x[m] * y[m]
    elif op == 3:
        for m in range(n):
            z[m] = x[m] / y[m]
    elif op == 4:
        for m in range(n):
            z[m] = -x[m]
    elif op == 5:
        for m in range(n):
            z[m] = x[m] * x[m]
    elif op == 6:
        for m in range(n):
            z[m] = np.sqrt(x[m])
    elif op == 7:
        for m in range(n):
            z[m] = 1.0 / x[m] if x[m] > 0 else 0.0
    elif op == 8:
        for m in range(n):
            z[m] = x[m] ** y[m]
    else:
        _operate_rarely(op, x, y, z, n)


@compiled
def _bessel(order, x):
    """K0 or K1: exp(-x cosh t) cosh(order t) over t, by trapezes, which are exact to rounding."""
    if not 0 < x < FAR:
        return np.inf if x == 0 else 0.0 if x >= FAR else np.nan
    h, total, k = min(0.25, 0.7 / np.sqrt(x)), 0.5, 0
    while True:
        k += 1
        high = np.cosh(k * h)
        part = np.exp(-x * (high - 1.0)) * (high if order else 1.0)
        total += part
        if not part > 1e-17 * total:
            return h * total * np.exp(-x)


@compiled
def _operate_rarely(op, x, y, z, n):
    """The operations of `OPS` that take long, or are seldom met."""
    for m in range(n):
        if op == 9:
            z[m] = np.exp(x[m])
        elif op == 10:
            z[m] = np.log(x[m])
        elif op == 11:
            z[m] = np.sin(x[m])
        elif op == 12:
            z[m] = np.cos(x[m])
        elif op == 13:
            z[m] = np.tanh(x[m])
        elif op == 14:
            z[m] = np.abs(x[m])
        elif op == 15:
            z[m] = np.sign(x[m])
        elif op == 16:
            z[m] = np.minimum(x[m], y[m])
        elif op == 17:
            z[m] = 1.0 if x[m] < y[m] else 0.0
        elif op == 18:
            z[m] = 1.0 / x[m] if x[m] > GUARD else 0.0
        elif op == 19:
            z[m] = np.log(x[m]) if x[m] > 0 else 0.0
        else:
            z[m] = _bessel(op - 20, x[m])


@compiled
def _play(code, program, state, inputs, r, j, s, m0, n, registers):
    """A program for a receiver and a source, at some points of a stage."""
    p = code.programs[program]
    first = p[9]
    for k in range(p[1], p[2]):
        at = code.kept[k, 1] + r * code.kept[k, 2] + j * code.kept[k, 3]
        row, by_chain = registers[first + code.kept[k, 0]], code.kept[k, 4]
        for m in range(n):
            row[m] = code.numbers[at + by_chain * inputs.chain[m0 + m]]
    n_own = state.shape[1]
    source = code.others[r, j] if p[0] else 0
    begin, begin_driven = s * inputs.chain.size + m0, s * inputs.n_each + m0
    for k in range(p[3], p[4]):
        kind, which = code.loads[k, 1], code.loads[k, 2]
        row = registers[first + code.loads[k, 0]]
        for m in range(n):
            if kind == TIME:
                row[m] = inputs.times[s, m0 + m]
            elif kind == SERIES:
                row[m] = inputs.series[which, r, begin + m]
            elif kind == MODE:
                row[m] = inputs.modes[which, r, j, m0 + m]
            elif kind <= VELOCITY:
                row[m] = state[kind - PLACE, r, which, m0 + m]
            elif source < n_own:
                row[m] = state[kind - PLACE_OF_SOURCE, source, which, m0 + m]
            else:
                part = kind - PLACE_OF_SOURCE
                row[m] = inputs.driven[part, source - n_own, which, begin_driven + m]
    for k in range(p[5], p[6]):
        x, y = registers[first + code.steps[k, 1]], registers[first + code.steps[k, 2]]
        _operate(code.steps[k, 0], x, y, registers[first + code.steps[k, 3]], n)


@compiled
def _accelerate(code, state, inputs, s, m0, n, registers, out):
    """Accelerations (R, d, M) at some points."""
    n_own, n_dims = out.shape[0], out.shape[1]
    for r in range(n_own):
        for x in range(n_dims):
            for m in range(m0, m0 + n):
                out[r, x, m] = 0.0
    for program in range(len(code.programs)):
        p = code.programs[program]
        for r in range(n_own):
            for j in range(code.others.shape[1] if p[0] else 1):
                _play(code, program, state, inputs, r, j, s, m0, n, registers)
                for k in range(p[7], p[8]):
                    given, row = registers[p[9] + code.outs[k, 0]], out[r, code.outs[k, 1]]
                    for m in range(n):
                        row[m0 + m] += given[m]


@compiled
def _derive(code, state, inputs, s, m0, n, registers, by_state, by_constant, begin):
    """Derivatives of accelerations (R d, 2 R d, .) and (R d, k, .) at some points, added."""
    n_own, n_dims = state.shape[1], state.shape[2]
    half = n_own * n_dims
    for program in range(len(code.programs)):
        p = code.programs[program]
        for r in range(n_own):
            for j in range(code.others.shape[1] if p[0] else 1):
                _play(code, program, state, inputs, r, j, s, m0, n, registers)
                for k in range(p[7], p[8]):
                    given = registers[p[9] + code.outs[k, 0]]
                    row, by = r * n_dims + code.outs[k, 1], code.outs[k, 2]
                    column = code.outs[k, 3]
                    if by == CONSTANT:
                        column += r * code.outs[k, 4] + j * code.outs[k, 5]
                        for m in range(n):
                            at = column + code.outs[k, 6] * inputs.chain[m0 + m]
                            own = code.parameters[at]
                            if own >= 0:
                                by_constant[row, own, begin + m] += given[m]
                        continue
                    body = r if by == OWN else code.others[r, j]
                    if body < n_own:
                        part, axis = column // n_dims, column % n_dims
                        to = by_state[row, part * half + body * n_dims + axis]
                        for m in range(n):
                            to[begin + m] += given[m]


@compiled
def slopes(code, state, inputs, by_state, by_constant):
    """Derivatives of accelerations at states, added to (R d, 2 R d, M) and (R d, k, M)."""
    registers = np.empty((code.n_registers, LANES))
    for m0 in range(0, state.shape[3], LANES):
        n = min(LANES, state.shape[3] - m0)
        _derive(code, state, inputs, 0, m0, n, registers, by_state, by_constant, m0)


@compiled
def step(code, a, b, h, inputs, states, rates, end):
    """One step of a Runge-Kutta scheme from states[0].

    Parameters
    ----------
    a, b : ndarray, shape (s, s) and (s,)
    h : ndarray, shape (M,)
    states, rates : ndarray, shape (s, 2, R, d, M)
        Of the stages; filled.
    end : ndarray, shape (2, R, d, M)
        Filled.
    """
    n_stages, _, n_own, n_dims, n_points = states.shape
    registers = np.empty((code.n_registers, LANES))
    for m0 in range(0, n_points, LANES):
        n = min(LANES, n_points - m0)
        for s in range(n_stages + 1):
            to = end if s == n_stages else states[s]
            for part in range(2 if s else 0):
                for r in range(n_own):
                    for x in range(n_dims):
                        row = to[part, r, x]
                        for m in range(m0, m0 + n):
                            row[m] = 0.0
                        for k in range(s):
                            weight = b[k] if s == n_stages else a[s, k]
                            if weight != 0.0:
                                rate = rates[k, part, r, x]
                                for m in range(m0, m0 + n):
                                    row[m] += weight * rate[m]
                        start = states[0, part, r, x]
                        for m in range(m0, m0 + n):
                            row[m] = start[m] + h[m] * row[m]
            if s < n_stages:
                for r in range(n_own):
                    for x in range(n_dims):
                        for m in range(m0, m0 + n):
                            rates[s, 0, r, x, m] = to[1, r, x, m]
                _accelerate(code, to, inputs, s, m0, n, registers, rates[s, 1])


@compiled
def carry(code, a, b, h, inputs, states, pattern, first, out):
    """Derivatives at the end of a step, from those at its start and all stages' states.

    Parameters
    ----------
    a, b, h
        As of `step`.
    states : ndarray, shape (s, 2, R, d, M)
    pattern : ndarray of int, shape (., 2)
        Derivatives of accelerations by states that may differ from zero.
    first, out : ndarray, shape (n, n + k, M)
        By something before the step and by the constants; `out` is filled.
    """
    n_state, width, n_points = first.shape
    n_stages, half = len(b), n_state // 2
    lanes = max(min(LANES, n_points, MOST_CARRIED // (n_stages * n_state * width)), 1)
    registers = np.empty((code.n_registers, LANES))
    # Of every row of derivatives those of a point lie side by side.
    rates = np.empty((n_stages, n_state, lanes * width))
    begin, change = np.empty((n_state, lanes * width)), np.empty((n_state, lanes * width))
    by_state = np.zeros((half, n_state, lanes))
    by_constant = np.zeros((half, width - n_state, lanes))
    for m0 in range(0, n_points, lanes):
        n = min(lanes, n_points - m0)
        for i in range(n_state):
            for m in range(n):
                for c in range(width):
                    begin[i, m * width + c] = first[i, c, m0 + m]
        for s in range(n_stages + 1):
            for i in range(n_state):
                row, start = change[i], begin[i]
                for at in range(n * width):
                    row[at] = 0.0
                for k in range(s):
                    weight = b[k] if s == n_stages else a[s, k]
                    if weight != 0.0:
                        rate = rates[k, i]
                        for at in range(n * width):
                            row[at] += weight * rate[at]
                for m in range(n):
                    for at in range(m * width, m * width + width):
                        row[at] = start[at] + h[m0 + m] * row[at]
            if s == n_stages:
                for i in range(n_state):
                    for m in range(n):
                        for c in range(width):
                            out[i, c, m0 + m] = change[i, m * width + c]
                continue
            for i in range(half):
                for c in range(width - n_state):
                    for m in range(n):
                        by_constant[i, c, m] = 0.0
            for q in range(len(pattern)):
                for m in range(n):
                    by_state[pattern[q, 0], pattern[q, 1], m] = 0.0
            _derive(code, states[s], inputs, s, m0, n, registers, by_state, by_constant, 0)
            for i in range(half):
                fall, row, moved = rates[s, i], rates[s, half + i], change[half + i]
                for m in range(n):
                    for c in range(width):
                        fall[m * width + c] = moved[m * width + c]
                        own = by_constant[i, c - n_state, m] if c >= n_state else 0.0
                        row[m * width + c] = own
            for q in range(len(pattern)):
                factor = by_state[pattern[q, 0], pattern[q, 1]]
                row, other = rates[s, half + pattern[q, 0]], change[pattern[q, 1]]
                for m in range(n):
                    for at in range(m * width, m * width + width):
                        row[at] += factor[m] * other[at]
