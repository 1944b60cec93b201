"""A push with a period: one for all bodies, or in proportion to their masses or coordinates."""

from copy import copy
from dataclasses import dataclass
from functools import partial

import numpy as np

from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.tangent import INDEPENDENT, as_pair
from bsp_gp.language.formula import Call, Constant, Input
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.view import MOST_WEIGHTS
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_name
from bsp_gp.physics.regression import checked
from bsp_gp.search.columns import orthonormal

OVERSAMPLING = 4
MOST_FREQUENCIES = 2000
NYQUIST = 0.9
ZOOMS, CLOSER = 4, 4.0
"""Finer rates about the best, and how much finer each time."""
MOST_PEAKS = 4
"""Rates that are looked at closely beside other forces."""
FAR = 1.0
"""Spans of the times from their zero from which on waves count from the first row: else the least
change of a rate, as of decimal years, turns them round."""
MOST_BYTES = 1 << 28
"""Of waves that are kept where they are scanned beside one form after the other."""
BLOCK = 128
"""Frequencies that are scored at a time."""


class Periods:
    """Pushes with a period as a proposer."""

    name = "periods"

    def propose(self, view):
        """The family of all periods."""
        rates = rates_of(view)
        axes = np.flatnonzero(np.isfinite(view.fit.noise.levels))
        if not len(rates):
            return Family(self.name, null=np.zeros(view.moment_draws.shape[1]))
        scan = Scan(view, rates, np.column_stack([view.left, view.draws_left]))
        kinds = (
            ([scan.kernels(weights, axis, is_placed) for axis in axes],
             partial(_proposal, view, rates, has_mass, is_placed, ties))
            for (has_mass, weights, ties), is_placed in _kinds(view)
        )  # fmt: skip
        return scanned(self.name, scan, axes, kinds)


def scanned(name, scan, axes, kinds):
    """The family of the best rate along every axis, and along all, of every kind of wave.

    Parameters
    ----------
    name : str
    scan : Scan
        Of the data and draws of noise.
    axes : ndarray of int
    kinds : iterable of (list, callable)
        Kernels by axis, and ``proposal(axes, rate, gain)``.
    """
    null, proposals, best = np.zeros(scan.targets.shape[1] - 1), [], 0.0
    for kernels, proposal in kinds:
        for along, gain in scan.gains(kernels).items():
            even = as_pair(gain, 2 * len(along))  # all as if of two numbers
            null, best = np.maximum(null, even[:, 1:].max(axis=0)), max(best, even[:, 0].max())
            k = int(np.argmax(gain[:, 0]))
            rate, most = scan.closer([kernels[a] for a in along], scan.rates[k], gain[k, 0])
            proposals.append(proposal(tuple(axes[list(along)]), rate, most))
    proposals.sort(key=lambda p: -p.promise)
    return Family(
        name, tuple(proposals), float(best), 2, null,
        n_tried=len(scan.rates) * len(proposals), is_continuum=True,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Wave:
    """A push with a period along one axis, where it explains most beside other forces.

    Attributes
    ----------
    names : tuple of str
        Constants of the cosine, the sine and the rate.
    rate : float, rad/s
    bounds : tuple of float
        Of the rate.
    columns : ndarray, shape (n, 3)
        Moments of the cosine, the sine, and a change of the rate.
    """

    part: Forces
    names: tuple
    rate: float
    bounds: tuple
    columns: np.ndarray


@dataclass(frozen=True, eq=False)
class Pushes:
    """Pushes with a period, as they are scanned beside one set of forces after the other.

    Attributes
    ----------
    scan : Scan
        By some of the chains, where these are many.
    rows : ndarray of int or slice
        Where its moments stand among all.
    alone : dict of int to (list, list of float)
        By axis moments of the push, and the rates that do best alone.
    """

    scan: "Scan"
    rows: object
    alone: dict


def waves_alone(view):
    """For `wave_beside`: pushes along every axis, and the rates that do best alone."""
    rates = rates_of(view)
    lesser, rows = view.lesser(MOST_WEIGHTS)
    scan = Scan(lesser, rates, lesser.left[:, None], MOST_BYTES)
    axes = np.flatnonzero(np.isfinite(view.fit.noise.levels)) if len(rates) else ()
    kernels = {axis: scan.kernels(_weights(lesser), axis) for axis in axes}
    alone = {axis: (k, [r for r, _ in scan.peaks(k)]) for axis, k in kernels.items()}
    return Pushes(scan, rows, alone)


def wave_beside(view, columns, pushes):
    """The push with a period that explains most beside moments (n, c); None if there is none.

    Parameters
    ----------
    columns : ndarray, shape (n, c)
    pushes : Pushes
        Of `waves_alone`.
    """
    if not pushes.alone:
        return None
    rates, lesser = pushes.scan.rates, pushes.scan.view
    scan = pushes.scan.beside_columns(columns if lesser is view else columns[pushes.rows])
    best = None
    for axis, (kernel, known) in pushes.alone.items():
        # Beside what imitates it a peak is much narrower than that of the push alone.
        starts = [(rate, -np.inf) for rate in known] + scan.peaks(kernel)
        for rate, gain in starts:
            rate, most = scan.closer([kernel], rate, gain)
            if best is None or most > best[0]:
                best = most, rate, axis, kernel
    _, rate, axis, kernel = best
    if lesser is not view:  # its moments are those of all chains
        scan = Scan(view, rates, view.left[:, None]).beside_columns(columns)
        kernel = scan.kernels(_weights(view), axis)
    step = (rates[1] - rates[0] if len(rates) > 1 else rate) / CLOSER**ZOOMS
    here, before, after = scan.waves(kernel, np.array([rate, rate - step, rate + step])).swapaxes(
        0, 1
    )
    amounts = np.linalg.lstsq(scan.beside(here), scan.targets[:, 0], rcond=1e-10)[0]
    change = (after - before) @ amounts / (2 * step)
    (has_mass, *_), *_ = variants(view)
    terms, constants = _push(view, (axis,), has_mass)
    return Wave(
        Forces(ForceLaw(terms, constants | {next(reversed(constants)): rate})), tuple(constants),
        rate, (float(rates[0]), float(rates[-1])),
        view.beside(np.column_stack([here, change])),
    )  # fmt: skip


def _weights(view):
    """Of the first variant of a push."""
    (_, weights, _), *_ = variants(view)
    return weights


class Scan:
    """Gains of cosines and sines of many rates on targets (n, 1 + B): the data, and noise.

    An orthonormal basis (n, k) of what else may explain them is projected out of the waves.
    """

    def __init__(self, view, rates, targets, most_bytes=0):
        self.view, self.rates, self.targets, self.basis = view, rates, targets, None
        self.batches = view.response.regression.batches
        self._known, self._most = {}, most_bytes  # waves of rates that are scanned again, by kernel

    def beside_columns(self, columns):
        """A scan of the same waves on what moments (n, c) leave, beside these."""
        other, columns = copy(self), self.view.beside(columns)
        other.basis = orthonormal(columns, len(columns))
        left = self.view.left
        other.targets = (left - other.basis @ (other.basis.T @ left))[:, None]
        return other

    def kernels(self, weights, axis, is_placed=False):
        """Moments by the push along an axis at every instant, (S, m, n) per batch.

        It grows with the coordinate along that axis where it `is_placed`.
        """
        out = []
        for batch, weight in zip(self.batches, weights, strict=True):
            if is_placed:
                weight = weight * batch.positions[:, :, batch.bodies.receivers, axis]
            acting = np.where(batch.valid[..., axis], weight, 0.0)  # (n, S, R)
            out.append(np.einsum("smnr,nsr->smn", batch.whitener[..., axis], acting))
        return out

    def kernel_of(self, law):
        """Moments by the accelerations of a law at every instant."""
        out = []
        for batch in self.batches:
            value = checked(self.view.response.regression.predict(batch, law), batch)
            out.append(np.einsum("smnrd,nsrd->smn", batch.whitener, value, optimize=True))
        return out

    def gains(self, kernels):
        """Chi-squared gained by axes, each alone and all together: ``{axes: (F, 1 + B)}``."""
        n = len(kernels)
        alone = [(k,) for k in range(n)]
        out = {along: [] for along in (alone if n == 1 else [*alone, tuple(range(n))])}
        for first in range(0, len(self.rates), BLOCK):
            waves = [self._block(kernel, first) for kernel in kernels]
            for along, found in out.items():
                found.append(self._gain(np.concatenate([waves[k] for k in along], axis=2)))
        return {along: np.concatenate(found) for along, found in out.items()}

    def _block(self, kernel, first):
        """Waves of some rates on the grid, worked out once where few kernels have them."""
        key = id(kernel[0]), first
        if key not in self._known:
            found = self.waves(kernel, self.rates[first : first + BLOCK])
            if sum(block.nbytes for _, block in self._known.values()) + found.nbytes > self._most:
                return found
            self._known[key] = kernel[0], found  # kept with its kernel: another may get its id
        return self._known[key][1]

    def best(self, kernel):
        """The best rate of one kernel, what it gains, and all gains as of pairs, (F, 1 + B)."""
        gains = self.gains([kernel])[(0,)]
        k = int(np.argmax(gains[:, 0]))
        rate, gain = self.closer([kernel], self.rates[k], gains[k, 0])
        return rate, gain, as_pair(gains, 2)

    def peaks(self, kernel):
        """The highest peaks of the gain, looked at closely, as pairs of rate and gain."""
        gain = self.gains([kernel])[(0,)][:, 0]
        padded = np.concatenate([[-np.inf], gain, [-np.inf]])
        peaks = np.flatnonzero((gain >= padded[:-2]) & (gain > padded[2:]))
        peaks = peaks[np.argsort(-gain[peaks])][:MOST_PEAKS]
        return [self.closer([kernel], self.rates[k], gain[k]) for k in peaks]

    def closer(self, kernels, rate, gain):
        """The best rate near one of those that were scored, and what all axes gain with it."""
        step = self.rates[1] - self.rates[0] if len(self.rates) > 1 else 0.0
        for zoom in range(ZOOMS):
            near = rate + step / CLOSER**zoom * np.linspace(-1, 1, 9)
            near = np.clip(near, self.rates[0], self.rates[-1])
            columns = np.concatenate([self.waves(kernel, near) for kernel in kernels], axis=2)
            found = self._gain(columns)[:, 0]
            k = int(np.argmax(found))
            if found[k] > gain:
                rate, gain = near[k], found[k]
        return float(rate), float(gain)

    def waves(self, kernel, rates):
        """Moments of cosines and sines, (n, F, 2)."""
        return self.waves_of([batch.times.T for batch in self.batches], kernel, rates)

    @staticmethod
    def waves_of(phases, kernel, rates):
        """The same for phases (S, n) per unit of rate."""
        parts = []
        for phase, matrix in zip(phases, kernel, strict=True):
            angle = np.nan_to_num(phase)[:, :, None] * rates  # (S, n, F)
            waves = [np.swapaxes(matrix @ f(angle), 0, 1) for f in (np.cos, np.sin)]  # (m, S, F)
            parts.append(np.stack(waves, axis=-1).reshape(-1, len(rates), 2))
        return np.concatenate(parts)

    @property
    def _others(self):
        """Orthonormal columns of what constants of the law, and the basis, can take up, (n, k)."""
        known = self.view.taken
        return known if self.basis is None else np.concatenate([known, self.basis], axis=1)

    def beside(self, columns):
        """Columns (n, c) beside what constants of the law, and the basis, can take up."""
        q = self._others
        return columns - q @ (q.T @ columns)

    def _gain(self, columns):
        """Gains of columns (n, F, c), (F, 1 + B)."""
        n, f, c = columns.shape
        flat, q = columns.reshape(n, f * c), self._others
        taken = q.T @ flat
        dots = (flat.T @ self.targets - taken.T @ (q.T @ self.targets)).reshape(f, c, -1)
        taken, gram, size = taken.reshape(-1, f, c), np.empty((f, c, c)), np.empty((f, c, 1))
        for i in range(c):
            for j in range(i + 1):
                whole = np.einsum("nf,nf->f", columns[:, :, i], columns[:, :, j])
                gram[:, i, j] = whole - np.einsum("kf,kf->f", taken[:, :, i], taken[:, :, j])
                gram[:, j, i] = gram[:, i, j]
            size[:, i, 0] = np.sqrt(np.where(whole > 0, whole, 1.0))
        values, vectors = np.linalg.eigh(gram / (size * np.swapaxes(size, 1, 2)))
        inverse = np.where(values > INDEPENDENT, 1 / np.maximum(values, INDEPENDENT), 0.0)
        along = np.swapaxes(vectors, 1, 2) @ (dots / size)
        return (np.square(along) * inverse[..., None]).sum(axis=1)


def rates_of(view):
    """From one turn a recording up to near the Nyquist frequency of the median row, rad/s."""
    groups = view.fit.groups
    span = max(float(np.nanmax(np.nanmax(c.times, 0) - np.nanmin(c.times, 0))) for c in groups)
    step = float(np.nanmedian(np.concatenate([np.diff(c.times, axis=0).ravel() for c in groups])))
    low, high = 2 * np.pi / span, NYQUIST * np.pi / step
    count = int(OVERSAMPLING * (high / low - 1)) + 1
    return low * (1 + np.arange(min(count, MOST_FREQUENCIES)) / OVERSAMPLING) if high > low else []


def variants(view):
    """The push as a force and in proportion to the mass: (has mass, weights per batch, ties)."""
    batches, masses = view.response.regression.batches, view.masses
    is_one = masses is not None and np.ptp(np.concatenate([m.ravel() for m in masses])) == 0
    if masses is not None:
        yield False, [1 / m for m in masses], is_one
    if not is_one:
        yield True, [np.ones(b.valid.shape[1:3]) for b in batches], False


def _kinds(view):
    """Variants of a push that is the same everywhere, then of one as an oscillating trap has it.

    There is no such trap in the sky.
    """
    for is_placed in (False,) if view.is_sky else (False, True):
        for variant in variants(view):
            yield variant, is_placed


def _proposal(view, rates, has_mass, is_placed, ties, axes, rate, gain):
    terms, constants = _push(view, axes, has_mass, is_placed)
    name = next(reversed(constants))
    constants[name] = rate
    other = [text_of(_push(view, axes, True, is_placed)[0])] if ties else []
    return Proposal(
        "period", text_of(terms), view.hypothesis + Forces(ForceLaw(terms, constants)),
        -(1 + has_mass + is_placed) * view.criteria.cause_nats - view.odd_nats, float(gain),
        2 * len(axes) + 1, {name: rate}, {name: (float(rates[0]), float(rates[-1]))},
        ties=tuple(other),
    )  # fmt: skip


def text_of(terms):
    """Terms as one text."""
    return " + ".join(to_text(term.formula) for term in terms)


def coordinate_of(types, axis):
    """The coordinate along an axis, and the axis, as formulas."""
    direction = Input(f"e_{'xyz'[axis]}", types[f"e_{'xyz'[axis]}"])
    place = Call("sub", Input("p_i", types["p_i"]), Input("origin", types["origin"]))
    return Call("dot", place, direction), direction


def cosine_and_sine(names, angle):
    """The two terms of a wave, each times a constant of these names."""
    waves = zip(names, ("cos", "sin"), strict=True)
    return [Call("mul", Constant(name), Call(wave, angle)) for name, wave in waves]


def _push(view, axes, has_mass, is_placed=False):
    """Terms of one rate, one per axis, and their constants, the rate last."""
    rate = Constant(fresh_name(view.fit.law, "w"))
    angle = Call("mul", rate, view.since(FAR))
    return waving(view, axes, rate, lambda axis: angle, has_mass, is_placed)


def waving(view, axes, rate, angle_of, has_mass, is_placed=False):
    """Terms with a cosine and a sine along every axis, and their constants, the rate last.

    Parameters
    ----------
    axes : sequence of int
    rate : Constant
    angle_of : callable
        Of an axis, with the rate in it.
    has_mass, is_placed : bool
        Whether they grow with the mass, and with the coordinate along their axis.
    """
    types, constants = dataset_types(view.dataset), {}
    terms, stems = [], iter(("a", "b", "g", "h", "k", "l"))
    for axis in axes:
        names = [fresh_name(view.fit.law, next(stems)) for _ in range(2)]
        constants |= dict.fromkeys(names, np.nan)
        formula = Call("add", *cosine_and_sine(names, angle_of(axis)))
        if has_mass:
            formula = Call("mul", formula, Input("m_i", types["m_i"]))
        coordinate, direction = coordinate_of(types, axis)
        if is_placed:
            formula = Call("mul", formula, coordinate)
        terms.append(Term(Call("mul", formula, direction), "field"))
    return tuple(terms), {**constants, rate.name: np.nan}
