"""pyoperon, gplearn and pysindy on the laws of `peers_tasks.py`: the best set-up that we know of.

None of them can be told that forces add up over pairs, so that is coded around them by hand. Where
only such sums are seen, pyoperon cannot fit the constants of what it evolves, and gplearn never
does; those of the final model of both are polished by least squares on the same objective, in the
tool's own tree with the tool's own evaluation.
"""

import copy
import itertools
import time
import warnings
from dataclasses import dataclass

import numpy as np
from peers_tasks import ENOUGH, Pairs, motion, pairs_of, relative, table
from scipy.optimize import least_squares

ARITHMETIC = "add,sub,mul,div,constant,variable"
FUNCTIONS = ARITHMETIC + ",square,sqrt,pow,exp,fmax"
SLICE = 1
"""Seconds, by the clock, after which pyoperon is asked how far it is."""
LENGTHS = (1.0, 3.0, 10.0)
"""Ranges of the dictionary's exponentials, m: a decade, without a look at the laws."""


@dataclass(frozen=True)
class Known:
    """What a tool learns from: pulls of pairs, or accelerations that sums of pulls make.

    Attributes
    ----------
    x : ndarray, shape (n, 3 or 4)
        Masses, distance, and of a contact law the sum of the radii.
    y : ndarray, shape (n,), or None
        Pulls, where they are seen.
    pairs : Pairs or None
        Where they are not.
    """

    x: np.ndarray
    y: np.ndarray | None = None
    pairs: Pairs | None = None

    @property
    def target(self):
        """Pulls; where they are not seen, numbers that a tool asks for and does not look at."""
        return np.arange(len(self.x)) % 2 * 1.0 if self.y is None else self.y

    def left(self, pull):
        """What pulls leave, over the size of what is known; of sums with their best factor."""
        pull = np.asarray(pull, dtype=float)
        seen = self.y if self.pairs is None else self.pairs.seen
        size = np.linalg.norm(seen)
        if self.pairs is None:
            error = pull - seen
            return error / size if np.isfinite(error).all() else seen / size
        if misfit(self.pairs, pull) == 1.0:
            return seen.ravel() / size  # all of it, as `misfit` has it
        return (scale_of(self.pairs, pull) * self.pairs.summed(pull) - seen).ravel() / size

    def error(self, pull):
        """Size of what is left."""
        return float(np.linalg.norm(self.left(pull)))

    def polished(self, pull_with, start, diff_step=None):
        """Constants that leave least, from those that a tool ended with.

        Parameters
        ----------
        pull_with : callable
            ``pull_with(constants) -> pull`` of the pairs.
        start : sequence of float
        diff_step : float, optional
            Relative step of the derivatives; larger where pulls are of single precision.

        Returns
        -------
        ndarray
            `start` if nothing is better.
        """
        start = np.asarray(start, dtype=float)
        if not len(start):
            return start
        with np.errstate(all="ignore"):
            found = least_squares(lambda c: self.left(pull_with(c)), start, "3-point",
                                  x_scale="jac", diff_step=diff_step, max_nfev=200).x  # fmt: skip
            better = self.error(pull_with(found)) < self.error(pull_with(start))
        return found if better else start


def law_of(task, form, seed, fit):
    """Let a tool find the pull of a pair, and judge it on fresh data.

    Parameters
    ----------
    fit : callable
        ``fit(known) -> (predict, text, size)``.

    Returns
    -------
    dict
        "error" and "error_far", over those of no force; "seconds", "found", "size".
    """
    if form == "table":
        (x, y), *parts = table(task, seed)
        known = Known(x, y)
    else:
        mine, *parts = (pairs_of(task, scenes) for scenes in motion(task, seed))
        known = Known(mine.x, pairs=mine)
    started = time.process_time()
    predict, text, size = fit(known)
    spent = time.process_time() - started
    if form == "table":
        errors = [relative(predict(x) - y, y) for x, y in parts]
    else:
        factor = scale_of(mine, predict(mine.x))
        errors = [relative(factor * p.summed(predict(p.x)) - p.seen, p.seen) for p in parts]
        text = f"{factor:.6g} * ({text})"
    return {"error": errors[0], "error_far": errors[1], "seconds": round(spent, 3),
            "found": text, "size": size}  # fmt: skip


def scale_of(pairs, pull):
    """The factor with which pulls explain the accelerations best."""
    a = pairs.summed(pull)
    return float((a * pairs.seen).sum() / max((a * a).sum(), 1e-300))


def misfit(pairs, pull):
    """Share of the accelerations' sum of squares that pulls leave, with their best factor."""
    if not np.isfinite(pull).all():
        return 1.0
    a = pairs.summed(np.asarray(pull, dtype=float))
    size = (a * a).sum()
    if not 0 < size < np.inf:
        return 1.0
    return float(1 - (a * pairs.seen).sum() ** 2 / (size * (pairs.seen**2).sum()))


def pyoperon(task, form, seed, seconds):
    """C++ genetic programming; constants by Levenberg-Marquardt where pulls are seen.

    Arithmetic alone first, then more functions: each has half of the time, slice by slice. Where
    pulls are not seen constants are mutated; those of the final tree are polished.
    """
    import pyoperon as op
    from pyoperon.sklearn import SymbolicRegressor

    class Summed(SymbolicRegressor):
        """Judged by the accelerations that summed pairs make."""

        def _init_evaluator(self, objective, problem, dtable, uncertainty):
            rows = op.Range(0, len(self.pairs.x))

            def judge(_, individual):
                pull = op.Evaluate(dtable, individual.Genotype, self.data, rows)
                return [misfit(self.pairs, pull)]

            return op.UserDefinedEvaluator(problem, judge)

    def once(known, symbols, started):
        common = {
            "allowed_symbols": symbols, "population_size": 1000, "generations": 10**6,
            "max_evaluations": 10**9, "max_length": 25, "epsilon": 1e-12, "n_threads": 1,
            "max_time": SLICE, "warm_start": True,
        }  # fmt: skip
        if known.pairs is None:
            # Its default, R², is one in single precision long before a law is exact.
            model = SymbolicRegressor(objectives=["nmse"], optimizer_iterations=10, **common)
        else:
            # "c2" asks for no scaling of the model; the evaluator above takes its place.
            model = Summed(objectives=["c2"], optimizer_iterations=0, add_model_scale_term=False,
                           add_model_intercept_term=False, **common)  # fmt: skip
            model.pairs = known.pairs
            model.data = op.Dataset(np.asfortranarray(np.column_stack((known.x, known.target))))
        for k in itertools.count():
            model.set_params(random_state=1000 * seed + k)
            model.fit(known.x, known.target)
            error = known.error(model.predict(known.x))
            if error <= ENOUGH or time.process_time() - started >= seconds / 2:
                break

        def pull_with(constants):
            model.model_.SetCoefficients(np.asarray(constants, dtype=np.float32))
            return model.predict(known.x)

        # Single precision: smaller steps would be lost in rounding.
        pull_with(known.polished(pull_with, model.model_.GetCoefficients(), diff_step=1e-3))
        return known.error(model.predict(known.x)), model

    def fit(known):
        found = []
        for symbols in (ARITHMETIC, FUNCTIONS):
            found.append(once(known, symbols, time.process_time()))
            if found[-1][0] <= ENOUGH:
                break
        _, model = min(found, key=lambda pair: pair[0])
        text = model.get_model_string(model.model_, precision=5)
        return lambda x: np.asarray(model.predict(x), dtype=float), text, model.model_.Length

    return law_of(task, form, seed, fit)


def gplearn(task, form, seed, seconds):
    """Genetic programming in Python, warm-started generation by generation until time is up.

    Constants are drawn, never fitted; those of the final program are polished. A power that is
    no whole number is exp of a multiple of log.
    """
    from gplearn.fitness import make_fitness
    from gplearn.functions import make_function
    from gplearn.genetic import SymbolicRegressor

    def exp(x):
        return np.exp(np.clip(x, -50, 50))

    def fit(known):
        pairs = known.pairs

        def judge(y, y_pred, _):
            # gplearn tries the metric on two rows first.
            return 1.0 if pairs is None or len(y_pred) != len(known.x) else misfit(pairs, y_pred)

        summed = make_fitness(function=judge, greater_is_better=False, wrap=False)
        functions = ("add", "sub", "mul", "div", "sqrt", "inv", "log", "max",
                     make_function(function=exp, name="exp", arity=1, wrap=False))  # fmt: skip
        # Shares of squares; a coefficient of correlation is a square root of one.
        enough = 1 - 0.5 * ENOUGH**2 if pairs is None else ENOUGH**2
        model = SymbolicRegressor(
            population_size=1000, generations=1, metric="pearson" if pairs is None else summed,
            function_set=functions, stopping_criteria=enough, const_range=(-10.0, 10.0),
            parsimony_coefficient=1e-4, init_depth=(2, 5), random_state=seed, warm_start=True,
        )  # fmt: skip
        started = time.process_time()
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            model.fit(known.x, known.target)
            while time.process_time() - started < seconds and not done(model, enough, pairs):
                model.set_params(generations=model.generations + 1)
                model.fit(known.x, known.target)

        def scaled(program):
            """Slope and offset that a coefficient of correlation leaves open."""
            raw = program.execute(known.x)
            if known.y is None or not np.isfinite(raw).all():
                return 1.0, 0.0
            return np.polyfit(raw, known.y, 1)

        def pull_with(constants):
            program = with_constants(model._program, constants)
            slope, offset = scaled(program)
            return slope * program.execute(known.x) + offset

        start = [node for node in model._program.program if isinstance(node, float)]
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            program = with_constants(model._program, known.polished(pull_with, start))
            slope, offset = scaled(program)

        def predict(x):
            with np.errstate(all="ignore"):
                return slope * program.execute(x) + offset

        text = str(program) if known.y is None else f"{slope:.6g} * {program} + {offset:.3g}"
        return predict, text, len(program.program)

    return law_of(task, form, seed, fit)


def with_constants(program, constants):
    """A program of gplearn with other constants."""
    constants = iter(constants)
    twin = copy.copy(program)
    twin.program = [float(next(constants)) if isinstance(node, float) else node
                    for node in program.program]  # fmt: skip
    return twin


def done(model, enough, pairs):
    """Whether gplearn's best program explains the data."""
    best = model.run_details_["best_fitness"][-1]
    return best >= enough if pairs is None else best <= enough


def pysindy(task, form, seed, seconds):
    """Sequentially thresholded regression on a dictionary; the pair sum by hand.

    The dictionary, of whole powers or the wide one, and the threshold are those whose terms err
    least on every fifth row, the fewest terms among equals: half-integer powers and exponentials
    are so alike that where they are not needed they do harm. The terms are then fitted to all.
    """
    from pysindy import STLSQ

    def fit(known):
        best = None
        for is_wide in (False, True):
            columns = dictionary(known.x, is_wide)
            if known.pairs is None:
                theta, target = np.column_stack(list(columns.values())), known.y
            else:
                theta = np.column_stack([known.pairs.summed(c).ravel() for c in columns.values()])
                target = known.pairs.seen.ravel()
            scale = np.linalg.norm(theta, axis=0)
            theta = theta / np.where(scale > 0, scale, 1.0)
            held = np.arange(len(target)) % 5 == 4
            for threshold in np.linalg.norm(target) * np.logspace(-6, -0.5, 23):
                model = STLSQ(threshold=threshold, alpha=0.0, max_iter=50)
                weights = fitted(model, theta[~held], target[~held])
                error = relative(theta[held] @ weights - target[held], target[held])
                key = (max(error, 1e-9), int((weights != 0).sum()))
                if best is None or key < best[0]:
                    used = np.flatnonzero(weights)
                    whole = np.linalg.lstsq(theta[:, used], target, rcond=None)[0] / scale[used]
                    best = (key, dict(zip(used.tolist(), whole, strict=True)), is_wide,
                            list(columns))  # fmt: skip
        _, weights, is_wide, names = best
        text = " + ".join(f"{w:.5g} {names[k]}" for k, w in weights.items())

        def predict(x):
            columns = list(dictionary(x, is_wide).values())
            return sum((w * columns[k] for k, w in weights.items()), np.zeros(len(x)))

        return predict, text or "0", len(weights)

    return law_of(task, form, seed, fit)


def fitted(model, theta, target):
    """Weights; zero where the threshold leaves no term."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return model.fit(theta, target[:, None]).coef_[0]


def dictionary(x, is_wide=False):
    """Products of masses times whole powers of the distance.

    The wide one has half-integer powers and exponentials over powers too. Where radii are known
    there is the depth of a contact, and its square.
    """
    m_i, m_j, r = x[:, 0], x[:, 1], x[:, 2]
    masses = {"1": 1.0 + 0 * r, "m_i": m_i, "m_j": m_j, "m_i m_j": m_i * m_j}
    powers = np.arange(-4, 4.5, 0.5) if is_wide else range(-4, 5)
    parts = {f"r^{k:g}": r**k for k in powers}
    if is_wide:
        parts.update({f"exp(-r/{length:g}) r^{k}": np.exp(-r / length) * r ** float(k)
                      for length in LENGTHS for k in (-2, -1, 0)})  # fmt: skip
    if x.shape[1] == 4:
        depth = np.maximum(x[:, 3] - r, 0.0)
        parts.update({"max(s - r, 0)": depth, "max(s - r, 0)^2": depth**2})
    return {f"{name} {part}": m * values for name, m in masses.items()
            for part, values in parts.items()}  # fmt: skip
