"""pyoperon, gplearn and pysindy on the laws of `peers_tasks.py`: the best set-up that we know of.

None of them can be told that forces add up over pairs, so that is coded around them by hand. Where
only such sums are seen, neither pyoperon nor gplearn can fit the constants of what it evolves;
those of the final model are polished afterwards by least squares on the same objective, in the
tool's own tree with the tool's own evaluation.
"""

import copy
import time
import warnings

import numpy as np
from peers_tasks import motion, pairs_of, relative, table
from scipy.optimize import least_squares

ARITHMETIC = "add,sub,mul,div,constant,variable"
FUNCTIONS = ARITHMETIC + ",square,sqrt,pow,exp,fmax"
LENGTHS = (1.0, 3.0, 10.0)
"""Ranges of the dictionary's exponentials, m: a decade, without a look at the laws."""


def pull_of(task, form, seed, fit):
    """Let a tool find the pull of a pair; its error on fresh data.

    Parameters
    ----------
    fit : callable
        ``fit(x, y, pairs) -> (predict, text)``; y is None where pulls are not seen, pairs is None
        where they are.
    """
    started = time.process_time()
    if form == "table":
        (x, y), (x_fresh, y_fresh) = table(task, seed)
        predict, text = fit(x, y, None)
        spent = time.process_time() - started
        return relative(predict(x_fresh) - y_fresh, y_fresh), spent, text
    known, fresh = (pairs_of(task, scenes) for scenes in motion(task, seed))
    predict, text = fit(known.x, None, known)
    spent = time.process_time() - started
    factor = scale_of(known, predict(known.x))
    error = factor * fresh.summed(predict(fresh.x)) - fresh.seen
    return relative(error, fresh.seen), spent, f"{factor:.6g} * ({text})"


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


def polished(pairs, pull_with, start, diff_step=None):
    """Constants that leave least of the accelerations, from those that a tool ended with.

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
    size = np.linalg.norm(pairs.seen)

    def left(constants):
        pull = np.asarray(pull_with(constants), dtype=float)
        if misfit(pairs, pull) == 1.0:
            return pairs.seen.ravel() / size  # all of it, as `misfit` has it
        return (scale_of(pairs, pull) * pairs.summed(pull) - pairs.seen).ravel() / size

    if not len(start):
        return start
    with np.errstate(all="ignore"):
        found = least_squares(left, start, "3-point", x_scale="jac", diff_step=diff_step,
                              max_nfev=200).x  # fmt: skip
        better = misfit(pairs, pull_with(found)) < misfit(pairs, pull_with(start))
    return found if better else start


def pyoperon(task, form, seed, seconds):
    """C++ genetic programming; constants by Levenberg-Marquardt where pulls are seen.

    Arithmetic alone first, then more functions: each has half of the time, by the clock. Where
    pulls are not seen constants are mutated, and those of the final tree polished.
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

    def once(x, y, pairs, symbols):
        common = {
            "allowed_symbols": symbols, "population_size": 1000, "generations": 10**6,
            "max_evaluations": 10**9, "max_length": 25, "epsilon": 1e-9, "n_threads": 1,
            "max_time": max(1, int(seconds / 2)), "random_state": seed,
        }  # fmt: skip
        if pairs is None:
            return SymbolicRegressor(optimizer_iterations=10, **common).fit(x, y)
        # "c2" asks for no scaling of the model; the evaluator above takes its place.
        model = Summed(objectives=["c2"], optimizer_iterations=0, add_model_scale_term=False,
                       add_model_intercept_term=False, **common)  # fmt: skip
        model.pairs, model.data = pairs, op.Dataset(np.asfortranarray(np.column_stack((x, y))))
        model.fit(x, y)

        def pull_with(constants):
            model.model_.SetCoefficients(np.asarray(constants, dtype=np.float32))
            return model.predict(x)

        # Single precision: smaller steps would be lost in rounding.
        pull_with(polished(pairs, pull_with, model.model_.GetCoefficients(), diff_step=1e-3))
        return model

    def fit(x, y, pairs):
        best = None
        # Where pulls are not seen a target is asked for all the same, and not looked at.
        target = np.arange(len(x)) % 2 * 1.0 if y is None else y
        for symbols in (ARITHMETIC, FUNCTIONS):
            model = once(x, target, pairs, symbols)
            pull = np.asarray(model.predict(x), dtype=float)
            left = misfit(pairs, pull) if pairs else relative(pull - y, y) ** 2
            if best is None or left < best[0]:
                best = (left, model)
            if left < 1e-10:
                break
        model = best[1]
        text = model.get_model_string(model.model_, precision=5)
        return lambda x: np.asarray(model.predict(x), dtype=float), text

    return pull_of(task, form, seed, fit)


def gplearn(task, form, seed, seconds):
    """Genetic programming in Python, warm-started generation by generation until time is up.

    Constants are drawn, never fitted; where pulls are not seen those of the final program are
    polished. A power that is no whole number is exp of a multiple of log.
    """
    from gplearn.fitness import make_fitness
    from gplearn.functions import make_function
    from gplearn.genetic import SymbolicRegressor

    def exp(x):
        return np.exp(np.clip(x, -50, 50))

    def fit(x, y, pairs):
        def judge(y, y_pred, _):
            # gplearn tries the metric on two rows first.
            return 1.0 if pairs is None or len(y_pred) != len(x) else misfit(pairs, y_pred)

        summed = make_fitness(function=judge, greater_is_better=False, wrap=False)
        metric = "pearson" if pairs is None else summed
        functions = ("add", "sub", "mul", "div", "sqrt", "inv", "log", "max",
                     make_function(function=exp, name="exp", arity=1, wrap=False))  # fmt: skip
        model = SymbolicRegressor(
            population_size=1000, generations=1, metric=metric, function_set=functions,
            stopping_criteria=1 - 1e-9 if pairs is None else 1e-9, const_range=(-10.0, 10.0),
            parsimony_coefficient=1e-4, init_depth=(2, 5), random_state=seed, warm_start=True,
        )  # fmt: skip
        dummy = np.arange(len(x)) % 2 * 1.0 if y is None else y
        started = time.process_time()
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            model.fit(x, dummy)
            while time.process_time() - started < seconds and not done(model, pairs):
                model.set_params(generations=model.generations + 1)
                model.fit(x, dummy)
        program = model._program
        slope, offset = 1.0, 0.0
        if pairs is not None:
            start = [node for node in program.program if isinstance(node, float)]
            best = polished(pairs, lambda c: with_constants(program, c).execute(x), start)
            program = with_constants(program, best)
        else:
            slope, offset = np.polyfit(program.execute(x), y, 1)

        def predict(x):
            with np.errstate(all="ignore"):
                return slope * program.execute(x) + offset

        return predict, f"{slope:.6g} * {program} + {offset:.3g}" if y is not None else str(program)

    return pull_of(task, form, seed, fit)


def with_constants(program, constants):
    """A program of gplearn with other constants."""
    constants = iter(constants)
    twin = copy.copy(program)
    twin.program = [float(next(constants)) if isinstance(node, float) else node
                    for node in program.program]  # fmt: skip
    return twin


def done(model, pairs):
    """Whether gplearn's best program explains the data."""
    best = model.run_details_["best_fitness"][-1]
    return best >= 1 - 1e-9 if pairs is None else best <= 1e-9


def pysindy(task, form, seed, seconds):
    """Sequentially thresholded regression on a dictionary; the pair sum by hand.

    The dictionary, of whole powers or the wide one, and the threshold are those whose terms err
    least on the last fifth of the rows, the fewest terms among equals: half-integer powers and
    exponentials are so alike that where they are not needed they do harm.
    """
    from pysindy import STLSQ

    def fit(x, y, pairs):
        best = None
        for is_wide in (False, True):
            columns = dictionary(x, is_wide)
            if pairs is None:
                theta, target = np.column_stack(list(columns.values())), y
            else:
                theta = np.column_stack([pairs.summed(c).ravel() for c in columns.values()])
                target = pairs.seen.ravel()
            scale = np.linalg.norm(theta, axis=0)
            cut = len(target) * 4 // 5
            for threshold in np.linalg.norm(target) * np.logspace(-6, -0.5, 23):
                model = STLSQ(threshold=threshold, alpha=0.0, max_iter=50)
                weights = fitted(model, theta[:cut] / scale, target[:cut]) / scale
                error = relative(theta[cut:] @ weights - target[cut:], target[cut:])
                key = (max(error, 1e-9), int((weights != 0).sum()))
                if best is None or key < best[0]:
                    best = (key, weights, is_wide, list(columns))
        _, weights, is_wide, names = best
        text = " + ".join(f"{w:.5g} {n}" for w, n in zip(weights, names, strict=True) if w)

        def predict(x):
            return np.column_stack(list(dictionary(x, is_wide).values())) @ weights

        return predict, text or "0"

    return pull_of(task, form, seed, fit)


def fitted(model, theta, target):
    """Weights; zero where the threshold leaves no term."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return model.fit(theta, target[:, None]).coef_[0]


def dictionary(x, is_wide=False):
    """Products of masses times whole powers of the distance.

    The wide one has half-integer powers and exponentials over powers too.
    """
    m_i, m_j, r = x[:, 0], x[:, 1], x[:, 2]
    masses = {"1": 1.0 + 0 * r, "m_i": m_i, "m_j": m_j, "m_i m_j": m_i * m_j}
    powers = np.arange(-4, 4.5, 0.5) if is_wide else range(-4, 5)
    parts = {f"r^{k:g}": r**k for k in powers}
    if is_wide:
        parts.update({f"exp(-r/{length:g}) r^{k}": np.exp(-r / length) * r ** float(k)
                      for length in LENGTHS for k in (-2, -1, 0)})  # fmt: skip
    return {f"{name} {part}": m * values for name, m in masses.items()
            for part, values in parts.items()}  # fmt: skip
