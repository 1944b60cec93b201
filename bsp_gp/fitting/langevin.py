"""Random kicks: the motion of a body under linear forces and white noise, by its exact likelihood.

With inertia ``v' = -g v - w (x - c) + a + sqrt(q) xi``; where none is seen ``x' = -r (x - c) + u +
sqrt(2 D) xi``. There a camera may show the mean place over its exposure, which makes steps that
follow each other alike, as inertia does (Berglund 2010, Phys. Rev. E 82, 011917). Transitions
between rows are exact (Van Loan 1978), and a Kalman filter gives the likelihood in O(rows).
"""

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.linalg import LinAlgError
from scipy.optimize import brentq, minimize
from scipy.stats import chi2, kurtosis, kurtosistest

from bsp_gp.compiling import compiled

COST = 4.0
"""Nats that a force must gain: a rate that is not there gains as much in less than one of a
hundred recordings (a random walk's own test, which no chi-squared is)."""
INERTIA = 2.0
"""Nats that a rate of the drag must gain beside kicks, or no inertia is seen."""
LEAST_KICKS = 0.05
"""Standard deviations of a row that kicks add over a whole track at the least."""
BLUR = 2.0
"""Nats that the exposure of a camera must gain, or places are those of an instant."""
SHORTEST, LONGEST = 0.05, 1.0
"""Exposures, in steps between rows."""
MEMORY = 6.0
"""Nats that a memory of kicks gains which are none: a force that changes slowly is no kick."""
STEEPEST = 20.0
"""Rates beyond which no inertia can be seen, per row."""
FARTHEST = 10.0
"""Extents within which the centre of a trap and the first place of a track lie."""
MILD = 1.0
"""Excess kurtosis of errors of forecasts that real kicks may have."""
LOOSE = 0.1
"""Correlation of errors of forecasts from row to row that real kicks may have."""
TERMS, LAST = 16, 0.5
"""Terms of the series of an exponential, and what it takes: the next is below rounding."""
UNSEEN = 20.0
"""Times a noise that its interval may reach, or the noise is next to none and has a limit alone."""
Z_90 = 1.6448536269514722
LOG_TURN = float(np.log(2 * np.pi))


@dataclass(frozen=True, eq=False)
class Track:
    """One body in one recording.

    Attributes
    ----------
    times : ndarray, shape (T,), s
    places : ndarray, shape (T, d), m
        Whole rows, without gaps: where nothing was seen there is no row.
    """

    times: np.ndarray
    places: np.ndarray


@dataclass(frozen=True, eq=False)
class Langevin:
    """A model of kicks and linear forces, fitted.

    Attributes
    ----------
    terms : frozenset of str
        Of "kicks", "drag", "trap", "push".
    is_overdamped : bool
        Whether no inertia is seen: "drag" then has no rate of its own.
    is_blurred : bool
        Whether places are means over an exposure.
    values : dict of str to (float, float, float)
        Value and 90 % interval, SI: ``drag_rate`` g, ``trap_rate`` w (r where overdamped),
        ``kick_power`` q, ``diffusion`` q / (2 g^2), ``speed_variance`` q / (2 g) (a temperature
        times Boltzmann's constant per mass), ``noise``, ``exposure``, ``centre_x`` ... ,
        ``push_x`` ... .
    log_likelihood : float, nats
        Of all rows, states and offsets marginalised.
    oddity : float
        Chance that errors of one-step forecasts are as far from white and normal as they are.
    memory_gain : float, nats
        What it gains where what kicks goes on for a while.
    settling : float
        Rows that it takes until kicks show above the noise; nan without kicks.
    """

    terms: frozenset
    is_overdamped: bool
    values: dict = field(repr=False)
    log_likelihood: float = -np.inf
    oddity: float = 1.0
    is_blurred: bool = False
    memory_gain: float = 0.0
    settling: float = np.nan

    @property
    def are_kicks(self):
        """Whether what acts beside its forces is over at once, as far as rows tell."""
        return "kicks" in self.terms and self.memory_gain < MEMORY

    @property
    def score(self):
        """Log-likelihood less what its forces cost, nats."""
        own = INERTIA * self.is_overdamped - BLUR * self.is_blurred
        return self.log_likelihood - COST * len(self.terms) + own


def models_of(tracks, noise=None, near=0.0, tick=None):
    """All models of kicks and linear forces, the likeliest first.

    Parameters
    ----------
    tracks : sequence of Track
        Of bodies of one kind: rates are shared.
    noise : float, optional
        Known error of a place, m.
    near : float, nats
        Of models that are so near to the likeliest it is asked how oddly their forecasts err.
    tick : callable, optional
        Asked at every look; raises where the time is up.
    """
    with np.errstate(all="ignore"):  # numbers that no rate carries are refused
        return _models_of(_Problem(tracks, noise, tick), near)


def _models_of(problem, near):
    found = []
    for kicks, drag, trap in product((True, False), repeat=3):
        terms = frozenset(n for n, has in (("kicks", kicks), ("drag", drag), ("trap", trap)) if has)
        # What swings on undisturbed is followed from near its rates alone: kicks lead to them.
        beside = next((m for m in found if m.terms == terms | {"kicks"}), None)
        found.append(problem.fit(terms, False, beside=beside))
    for trap in (True, False):
        terms = frozenset({"kicks", "drag"} | ({"trap"} if trap else set()))
        found.append(problem.fit(terms, True))
        if max(m.score for m in found) > found[-1].score:  # inertia, or a camera
            found.append(problem.fit(terms, True, True))
    # A steady push looks like a trap far away: it is asked whatever is likelier until then.
    free = [m for m in found if "trap" not in m.terms]
    best = max(free, key=lambda m: m.score)
    for one in (m for m in free if m.terms == best.terms):  # with inertia, and without
        found.append(problem.fit(one.terms | {"push"}, one.is_overdamped, one.is_blurred))
    found = sorted(found, key=lambda m: -m.score)
    asked = [m for m in found if "kicks" in m.terms and found[0].score - m.score <= near]
    odd = {id(m): problem.oddity(m) for m in asked}
    slow = {id(m): problem.memory_gain(m) for m in asked if not m.is_overdamped}
    return [
        replace(m, oddity=odd.get(id(m), 1.0), memory_gain=slow.get(id(m), 0.0)) for m in found
    ]


class _Problem:
    """Tracks in units of their own rows and steps."""

    def __init__(self, tracks, noise, tick=None):
        self.tick = tick
        steps = np.concatenate([np.diff(t.times) for t in tracks])
        self.step = float(np.median(steps))
        moved = np.concatenate([np.diff(t.places, axis=0).ravel() for t in tracks])
        self.size = float(np.sqrt(np.mean(np.square(moved)))) or 1.0
        self.noise = None if noise is None else max(noise / self.size, 1e-6)
        times = [(t.times - t.times[0]) / self.step for t in tracks]
        # Steps of all tracks, so that motions over each are told once.
        steps = [np.round(np.diff(t), 9) for t in times]
        self.kinds, number = np.unique(np.concatenate(steps), return_inverse=True)
        numbers = np.split(number, np.cumsum([len(own) for own in steps])[:-1])
        self.parts = [
            _Part(t, track.places / self.size, own)
            for t, track, own in zip(times, tracks, numbers, strict=True)
        ]  # fmt: skip
        self.n_dims = tracks[0].places.shape[1]
        self.n_numbers = sum(p.places.size for p in self.parts)
        self.span = float(np.mean([p.times[-1] for p in self.parts]))
        self.guess = self._guesses()

    def _guesses(self):
        """Sizes of noise, speeds, accelerations and extents, in own units."""
        third = np.concatenate([np.diff(p.places, 3, axis=0).ravel() for p in self.parts])
        noise = float(np.sqrt(np.mean(np.square(third)) / 20)) or 1e-6
        lag = max(int(self.span // 200), 2)
        far = np.concatenate([(p.places[lag:] - p.places[:-lag]).ravel() / lag for p in self.parts])
        speed = float(np.sqrt(max(np.mean(np.square(far)) - 2 * (noise / lag) ** 2, 1e-12)))
        fastest = max(float(np.abs(far).max()), speed)  # of what slows down: at its beginning
        extent = float(np.mean([np.ptp(p.places, axis=0).max() for p in self.parts]))
        spread = float(np.mean([np.var(p.places, axis=0).mean() for p in self.parts]))
        return {
            "noise": noise, "speed": speed, "fastest": fastest, "extent": extent,
            "spread": max(spread, 1e-12),
        }  # fmt: skip

    # --- fits ------------------------------------------------------------------------------------

    def memory_gain(self, found):
        """Log-likelihood that a model gains where kicks have a memory (Ornstein, Uhlenbeck)."""
        other = self.fit(found.terms, False, has_memory=True)
        return other.log_likelihood - found.log_likelihood

    def fit(self, terms, is_overdamped, is_blurred=False, has_memory=False, beside=None):
        """A model with the parameters that do best; it is tried from those of another, too."""
        names = [n for n, has in (
            ("drag", "drag" in terms and not is_overdamped), ("trap", "trap" in terms),
            ("kicks", "kicks" in terms), ("noise", self.noise is None), ("exposure", is_blurred),
            ("memory", has_memory),
        ) if has]  # fmt: skip
        bounds = [self._bounds(name) for name in names]

        def height(x):
            return self.height(dict(zip(names, x, strict=True)), terms, is_overdamped)[0]

        best, starts = None, self._starts(names, terms, is_overdamped)
        if beside is not None and names:
            starts.append(self._as_start(names, beside))
        for start in starts:
            if not names:
                found = np.zeros(0), -height(start)
            else:
                start = np.clip(start, *np.transpose(bounds))
                done = minimize(lambda x: -height(x), start, method="L-BFGS-B", bounds=bounds,
                                options={"maxiter": 60, "eps": 1e-5})  # fmt: skip
                found = done.x, float(done.fun)
            if best is None or found[1] < best[1]:
                best = found
        x, top = best[0], -best[1]
        _, offsets = self.height(dict(zip(names, x, strict=True)), terms, is_overdamped)
        covariance = _covariance(height, x, bounds)
        told = self._told(terms, is_overdamped, names, x, covariance, offsets, top)
        value, low, high = told.values.get("noise", (0.0, 0.0, 0.0))
        if "kicks" in terms and high > UNSEEN * value:
            most = _most(height, names.index("noise"), x, bounds, top)
            told.values["noise"] = value, low, most * self.size
        return replace(told, is_blurred=is_blurred)

    def _bounds(self, name):
        """Of the logarithm of a parameter."""
        rate = np.log([0.05 / self.span, STEEPEST])
        extent = self.guess["extent"]
        return {
            "drag": tuple(rate), "trap": (np.log(1e-3 / self.span**2), np.log(STEEPEST)),
            "kicks": (np.log((LEAST_KICKS * self.guess["noise"]) ** 2 / self.span**3), 9.0),
            "noise": tuple(np.log([1e-6, 10 * extent + 1])),
            "exposure": tuple(np.log([SHORTEST, LONGEST])),
            "memory": tuple(np.log([1.0, max(self.span, 2.0)])),
        }[name]

    def _starts(self, names, terms, is_overdamped):
        """Logarithms to begin with, one array per start."""
        g, out = self.guess, []
        for rate in (10 / self.span, 0.1) if "drag" in names else (1 / self.span,):
            if is_overdamped:
                trap = max(2 / self.span, g["speed"] ** 2 / g["spread"] / 4)
                kicks = g["spread"] * trap if "trap" in terms else 0.5 * g["speed"] ** 2 * 2
            else:
                trap = g["speed"] ** 2 / g["spread"]
                kicks = 2 * max(rate, 1 / self.span) * g["speed"] ** 2
            values = {"drag": rate, "trap": trap, "kicks": kicks, "noise": max(g["noise"], 1e-5),
                      "exposure": LONGEST / 2, "memory": 10.0}  # fmt: skip
            out.append(np.log([values[name] for name in names]))
            if is_overdamped and "trap" in terms:  # a stiff one: steps from row to row are kicks
                stiff = values | {"kicks": 1.0, "trap": 0.5 / g["spread"]}
                out.append(np.log([stiff[name] for name in names]))
        return out

    def _as_start(self, names, found):
        """Logarithms of a model with inertia to begin another with."""
        values = {name: value for name, (value, *_) in found.values.items()}
        own = {
            "drag": values.get("drag_rate", 0.0) * self.step,
            "trap": values.get("trap_rate", 0.0) * self.step**2,
            "noise": values.get("noise", 0.0) / self.size,
        }  # fmt: skip
        return np.log([max(own[name], 1e-300) for name in names])

    def height(self, at, terms, is_overdamped):
        """Log-likelihood, and offsets with their variances, of logarithms of parameters.

        Offsets are places of a trap, per track and axis, or pushes, per axis.
        """
        if self.tick is not None:
            self.tick()
        values = {name: float(np.exp(v)) for name, v in at.items()}
        noise = self.noise or values["noise"]
        model = _Model(
            is_overdamped, values.get("drag", 0.0), values.get("trap", 0.0),
            values.get("kicks", 0.0), noise, values.get("exposure", 0.0),
            values.get("memory", 0.0),
        )  # fmt: skip
        speed = self.guess["fastest"]
        has_offset = bool({"trap", "push"} & terms)
        total, rows = 0.0, []
        far = FARTHEST * self.guess["extent"]
        try:
            moves = model.transitions(self.kinds)
        except (LinAlgError, ValueError):  # numbers do not carry them
            return -1e30, []
        for part in self.parts:
            if model.kicks:
                found = part.density(model, moves, speed, far)
            else:
                found = part.drawn(model, moves, speed, far)
            if not np.isfinite(found[0]):
                return -1e30, []
            total += found[0]
            rows.append(found[1:])
        if not has_offset:
            return total, []
        right, square = (np.array([row[k] for row in rows]) for k in range(2))  # (S, d), (S,)
        square = np.repeat(square[:, None], self.n_dims, axis=1)
        if "trap" in terms:  # a force of w c: per track and axis
            width = FARTHEST * self.guess["extent"] * values["trap"]
        else:
            width = speed if is_overdamped else speed / max(self.span / 10, 1.0)
            right, square = right.sum(axis=0, keepdims=True), square.sum(axis=0, keepdims=True)
        whole = square + width**-2.0
        total += float((0.5 * right**2 / whole - 0.5 * np.log(whole * width**2)).sum())
        return total, [right / whole, 1 / whole]

    def oddity(self, found):
        """Chance that forecasts of a model err as oddly as they do (Ljung and Box; kurtosis)."""
        size, step = self.size, self.step
        value = {name: v[0] for name, v in found.values.items()}
        rate = step if found.is_overdamped else step**2
        kicks = "diffusion" if found.is_overdamped else "kick_power"
        power = step if found.is_overdamped else step**3
        model = _Model(
            found.is_overdamped, value.get("drag_rate", 0.0) * step,
            value.get("trap_rate", 0.0) * rate, value[kicks] * power / size**2,
            self.noise or value["noise"] / size, value.get("exposure", 0.0) / step,
        )  # fmt: skip
        pushes = np.array([value.get(f"push_{axis}", 0.0) for axis in "xyz"[: self.n_dims]])
        centres = np.array([value.get(f"centre_{axis}", np.nan) for axis in "xyz"[: self.n_dims]])
        moves = model.transitions(self.kinds)
        lags, squares, count, n_errors, every = 10, np.zeros(10), 0, 0, []
        for k, part in enumerate(self.parts):
            push = pushes * rate / size
            if "trap" in found.terms:  # other tracks have centres of their own
                centre = centres / size - part.origin if not k else part.places.mean(axis=0)
                push = model.trap * centre
            errors = part.forecast(model, moves, push, self.guess["fastest"],
                                   FARTHEST * self.guess["extent"])[3:]  # fmt: skip
            every.append(errors)
            if len(errors) <= lags:  # of so short a part no memory is told
                continue
            size_ = np.square(errors).sum(axis=0)
            for lag in range(1, lags + 1):
                along = (errors[lag:] * errors[:-lag]).sum(axis=0) / size_
                weight = len(errors) ** 2 / (len(errors) - lag)
                squares[lag - 1] += weight * np.square(along).sum()
            count, n_errors = count + errors.shape[1], n_errors + errors.size
        # Cameras and tables shake a little, which long tracks show.
        is_odd = count and (squares - count).max() > LOOSE**2 * n_errors
        white = chi2.sf(squares.sum(), lags * count) if is_odd else 1.0
        every = np.concatenate([e.ravel() for e in every])
        # Where steps are less sure at times (beads out of focus) tails are a little heavy.
        normal = kurtosistest(every).pvalue if abs(kurtosis(every)) > MILD else 1.0
        return float(min(1.0, 2 * min(white, normal)))

    # --- what is told ----------------------------------------------------------------------------

    def _told(self, terms, is_overdamped, names, x, covariance, offsets, height):
        """A model with its numbers and intervals in SI."""
        size, step = self.size, self.step
        logs = {name: np.eye(len(names))[k] for k, name in enumerate(names)}
        units = {
            "drag_rate": ({"drag": 1}, 1 / step),
            "trap_rate": ({"trap": 1}, 1 / step if is_overdamped else step**-2.0),
            "kick_power": ({"kicks": 1}, size**2 / step**3),
            "diffusion": ({"kicks": 1, "drag": -2}, 0.5 * size**2 / step),
            "speed_variance": ({"kicks": 1, "drag": -1}, 0.5 * size**2 / step**2),
            "noise": ({"noise": 1}, size), "exposure": ({"exposure": 1}, step),
        }  # fmt: skip
        if is_overdamped:
            for name in ("kick_power", "speed_variance"):
                del units[name]
            units["diffusion"] = {"kicks": 1}, size**2 / step
        out = {}
        for name, (powers, scale) in units.items():
            if not set(powers) <= set(names):
                continue
            way = sum(p * logs[n] for n, p in powers.items())
            middle, error = float(way @ x), float(np.sqrt(max(way @ covariance @ way, 0.0)))
            most = np.log(LONGEST) if name == "exposure" else np.inf
            ends = (scale * np.exp(min(middle + z * error, most)) for z in (0.0, -Z_90, Z_90))
            out[name] = tuple(map(float, ends))
        if offsets:
            self._tell_offsets(out, terms, offsets, dict(zip(names, x, strict=True)), is_overdamped)
        log_likelihood = height - self.n_numbers * np.log(size)
        settling = np.nan
        if "kicks" in names:
            at = dict(zip(names, np.exp(x), strict=True))
            share = (at.get("noise") or self.noise) ** 2 / at["kicks"]
            settling = float((share / 2) ** 0.5 if is_overdamped else share**0.25)
        return Langevin(terms, is_overdamped, out, float(log_likelihood), settling=settling)

    def _tell_offsets(self, out, terms, offsets, at, is_overdamped):
        """Add the centre of a trap (of the first track) or the push."""
        middle, variance = offsets[0][0], offsets[1][0]
        if "trap" in terms:
            scale, name = self.size / np.exp(at["trap"]), "centre"
            origin = self.parts[0].origin * self.size
        else:
            scale = self.size / self.step ** (1 if is_overdamped else 2)
            name, origin = "push", np.zeros(self.n_dims)
        for k, axis in enumerate("xyz"[: self.n_dims]):
            value, half = scale * middle[k], Z_90 * scale * np.sqrt(variance[k])
            out[f"{name}_{axis}"] = tuple(float(origin[k] + value + z * half) for z in (0, -1, 1))


def _most(height, at, x, bounds, top):
    """The greatest value of a logarithm that is not excluded where the best is low (profile), e^it.

    Of a log-likelihood whose greatest is `top`, at x.
    """
    others = [k for k in range(len(x)) if k != at]
    start, beside = np.array(x, dtype=float), [bounds[k] for k in others]

    def below(level):
        def loss(rest):
            start[others], start[at] = rest, level
            return -height(start)

        done = minimize(loss, x[others], method="L-BFGS-B", bounds=beside,
                        options={"maxiter": 20, "eps": 1e-5})  # fmt: skip
        return top + done.fun - Z_90**2 / 2

    low, high = float(x[at]), float(bounds[at][1])
    return float(np.exp(brentq(below, low, high, xtol=0.05))) if below(high) > 0 else np.inf


def _covariance(height, x, bounds):
    """Of the numbers of a log-likelihood, from its curvature; what stands at a bound is held."""
    n = len(x)
    out = np.zeros((n, n))
    free = [k for k in range(n) if bounds[k][0] + 1e-6 < x[k] < bounds[k][1] - 1e-6]
    if not free:
        return out
    h, m = 0.02, len(free)

    def moved(shift):
        y = np.array(x, dtype=float)
        y[free] += shift
        return height(y)

    eye, curve = h * np.eye(m), np.zeros((m, m))
    middle = moved(np.zeros(m))
    for a in range(m):
        up, down = moved(eye[a]), moved(-eye[a])
        curve[a, a] = (2 * middle - up - down) / h**2
        for b in range(a):
            cross = (moved(eye[a] + eye[b]) + moved(-eye[a] - eye[b])
                     - moved(eye[a] - eye[b]) - moved(eye[b] - eye[a]))  # fmt: skip
            curve[a, b] = curve[b, a] = -cross / (4 * h**2)
    values, vectors = np.linalg.eigh(curve)
    values = np.maximum(values, 1e-2)  # what the data do not tell is open over decades
    out[np.ix_(free, free)] = (vectors / values) @ vectors.T
    return out


@dataclass(frozen=True)
class _Model:
    """Numbers of a model, in units of rows and steps."""

    is_overdamped: bool
    drag: float
    trap: float
    kicks: float
    noise: float
    exposure: float = 0.0
    memory: float = 0.0

    def first(self, speed, far):
        """What makes the first state white, (n, n); its first number is what is shown."""
        if self.exposure:  # the mean is where the place is, but for kicks
            beside = np.sqrt(self.kicks * self.exposure / 1.5)
            return np.array([[1 / beside, -1 / beside], [0.0, 1 / far]])
        own = [1 / far] if self.is_overdamped else [1 / far, 1 / speed]
        return np.diag([*own, np.sqrt(2 * self.memory / self.kicks)] if self.memory else own)

    def transitions(self, steps):
        """Over time steps (K,): F (K, n, n), Q (K, n, n), and what a push of one adds (K, n)."""
        if self.exposure:
            return self._blurred(steps)
        if self.is_overdamped:
            drift, noise, push = [[-self.trap]], [[2 * self.kicks]], [1.0]
        elif self.memory:  # an acceleration that fades, as strong as kicks over long times
            drift = [[0.0, 1.0, 0.0], [-self.trap, -self.drag, 1.0], [0.0, 0.0, -1 / self.memory]]
            noise, push = np.diag([0.0, 0.0, self.kicks / self.memory**2]), [0.0, 1.0, 0.0]
        else:
            drift = [[0.0, 1.0], [-self.trap, -self.drag]]
            noise, push = [[0.0, 0.0], [0.0, self.kicks]], [0.0, 1.0]
        return _over(drift, noise, push, steps)

    def _blurred(self, steps):
        """The same of the mean place over the exposure and the place, which goes on alone."""
        f, q, push = _over([[-self.trap]], [[2 * self.kicks]], [1.0], steps - self.exposure)
        lasts = np.full(len(steps), self.exposure)
        drift, noise = [[0.0, 1.0 / self.exposure], [0.0, -self.trap]], np.diag([0, 2 * self.kicks])
        seen, own, pushed = _over(drift, noise, [0.0, 1.0], lasts)
        by_place = seen[:, :, 1:]  # the mean begins anew with every exposure
        whole = np.concatenate([np.zeros_like(by_place), by_place @ f], axis=2)
        return whole, by_place @ q @ np.swapaxes(by_place, 1, 2) + own, (
            by_place @ push[..., None])[..., 0] + pushed


def _over(drift, noise, push, steps):
    """Transitions of a linear motion over time steps, see `_Model.transitions`."""
    n = len(drift)
    block = np.zeros((2 * n + 2, 2 * n + 2))
    alone = block[n + 1 :, n + 1 :].T
    alone[:n, :n], alone[:n, n], block[:n, n + 1 : -1] = drift, push, noise
    block[: n + 1, : n + 1] = -alone
    both = exponentials(block, steps)
    moved = np.swapaxes(both[:, n + 1 :, n + 1 :], 1, 2)
    f, q = moved[:, :n, :n], (moved @ both[:, : n + 1, n + 1 :])[:, :n, :n]
    return f, (q + np.swapaxes(q, 1, 2)) / 2, moved[:, :n, n]


def exponentials(matrix, times):
    """Exponentials of one matrix times each of many numbers.

    By scaling and squaring, as `scipy.linalg.expm` has them one by one in some 10 us. The powers
    of the series are those of one matrix: what each time adds is its own powers (0.5 us).

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
    times : ndarray, shape (T,)

    Returns
    -------
    ndarray, shape (T, n, n)
    """
    size, n = np.abs(matrix).sum(axis=0).max(), len(matrix)
    if not np.isfinite(size):
        return np.full((len(times), n, n), np.nan)
    # How often each is halved until the series converges: the own number of each, which keeps the
    # digits of short steps beside long ones.
    halvings = np.ceil(np.log2(np.maximum(np.abs(times) * size / LAST, 1.0))).astype(int)
    powers = [np.eye(n)]
    for k in range(1, TERMS):
        powers.append(powers[-1] @ matrix / (k * size) if size else np.zeros((n, n)))
    series, out = np.reshape(powers, (TERMS, n * n)), np.empty((len(times), n, n))
    for count in np.unique(halvings):
        own = halvings == count
        part = np.vander(times[own] * size / 2.0**count, TERMS, increasing=True) @ series
        part = part.reshape(-1, n, n)
        for _ in range(count):
            part = part @ part
        out[own] = part
    return out


class _Part:
    """One track, in units of rows and steps, about its first place.

    `number` (T - 1,) says which kind of step leads from each row to the next.
    """

    def __init__(self, times, places, number):
        self.times, self.origin, self.number = times, places[0], number
        self.places = places - places[0]

    def density(self, model, moves, speed, far):
        """Log-density of the rows, how it depends on a push; nan where numbers do not carry it.

        The density without a push; with one of size a the exponent gains ``a right - a^2 square /
        2`` on each axis.
        """
        errors, log_det = self._filtered(model, moves, speed, far)
        height, right, square = self._of_gram(errors.T @ errors, log_det)
        return height, -right, square

    def _of_gram(self, gram, log_det):
        n_rows, n_dims = self.places.shape
        height = -0.5 * np.trace(gram[:n_dims, :n_dims]) - 0.5 * n_dims * float(
            log_det + n_rows * LOG_TURN
        )
        return float(height), gram[:n_dims, -1], float(gram[-1, -1])

    def forecast(self, model, moves, push, speed, far):
        """Errors of one-step forecasts under a push (d,), of unit size, (T, d)."""
        errors, _ = self._filtered(model, moves, speed, far)
        return errors[:, :-1] + errors[:, -1:] * push

    def _filtered(self, model, moves, speed, far):
        wide = np.linalg.inv(model.first(speed, far))  # from what makes the first state white
        seen = np.concatenate([self.places, np.zeros((len(self.places), 1))], axis=1)
        return _forecasts(*moves, self.number, seen, wide @ wide.T, float(model.noise) ** 2)

    def drawn(self, model, moves, speed, far):
        """The same of a motion without kicks."""
        f, _, push = moves
        n = f.shape[1]
        columns = _carried(f, push, self.number) / model.noise
        rows = self.places / model.noise
        first = 1 / np.diagonal(model.first(speed, far))
        own = columns[:, :n] * first
        whole = np.eye(n) + own.T @ own
        both = np.concatenate([rows, columns[:, n:]], axis=1)
        fitted = np.linalg.solve(whole, own.T @ both)
        left = both - own @ fitted
        log_det = np.linalg.slogdet(whole)[1] + 2 * len(rows) * np.log(model.noise)
        return self._of_gram(left.T @ left + fitted.T @ fitted, log_det)


@compiled
def _forecasts(f, q, push, number, seen, first, noise):
    """A Kalman filter over steps of such kinds.

    Parameters
    ----------
    seen : ndarray, shape (T, d + 1)
        Places, and zeros.
    first : ndarray, shape (n, n)
        Covariance of the first state, about zero.
    noise : float
        Variance of a place.

    Returns
    -------
    errors : ndarray, shape (T, d + 1)
        Of forecasts of the next row, of unit size; in the last column what a push of one adds.
    log_det : float
        Of the covariance of the places along one axis.
    """
    n, n_columns = f.shape[1], seen.shape[1]
    state, before = np.zeros((n, n_columns)), np.zeros((n, n_columns))
    spread, half, gain = first.copy(), np.zeros((n, n)), np.zeros(n)
    errors, log_det = np.empty_like(seen), 0.0
    for row in range(len(seen)):
        if row:
            k = number[row - 1]
            before[:] = state
            for i in range(n):
                for c in range(n_columns):
                    value = push[k, i] if c == n_columns - 1 else 0.0
                    for m in range(n):
                        value += f[k, i, m] * before[m, c]
                    state[i, c] = value
                for j in range(n):
                    half[i, j] = 0.0
                    for m in range(n):
                        half[i, j] += f[k, i, m] * spread[m, j]
            for i in range(n):
                for j in range(i + 1):
                    value = q[k, i, j]
                    for m in range(n):
                        value += half[i, m] * f[k, j, m]
                    spread[i, j] = spread[j, i] = value
        size = spread[0, 0] + noise
        log_det += np.log(size)
        for i in range(n):
            gain[i] = spread[i, 0]
        for c in range(n_columns):
            error = seen[row, c] - state[0, c]
            errors[row, c] = error / np.sqrt(size)
            for i in range(n):
                state[i, c] += gain[i] / size * error
        for i in range(1, n):
            for j in range(1, n):
                spread[i, j] -= gain[i] * gain[j] / size
        for i in range(n):  # as a product: a difference would be rounding where little is noise
            spread[i, 0] = spread[0, i] = gain[i] * noise / size
    return errors, log_det


@compiled
def _carried(f, push, number):
    """Places (T, n + 1) by the first state, and by a push of one, over steps of such kinds."""
    n = f.shape[1]
    state, before = np.zeros((n, n + 1)), np.zeros((n, n + 1))
    for i in range(n):
        state[i, i] = 1.0
    out = np.empty((len(number) + 1, n + 1))
    out[0] = state[0]
    for k in range(len(number)):
        before[:] = state
        kind = number[k]
        for i in range(n):
            for j in range(n + 1):
                value = push[kind, i] if j == n else 0.0
                for m in range(n):
                    value += f[kind, i, m] * before[m, j]
                state[i, j] = value
        out[k + 1] = state[0]
    return out
