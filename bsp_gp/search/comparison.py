"""Searches compared on a user's data: for what the declared model leaves."""

import numpy as np

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.split import choose_split
from bsp_gp.errors import EvaluationError, SettingsError
from bsp_gp.fitting.hypothesis import declared_law
from bsp_gp.fitting.outliers import is_exact
from bsp_gp.language.formula import rename_constants
from bsp_gp.language.render import to_text
from bsp_gp.physics.force import Term, fresh_name
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.masses import with_usable_masses
from bsp_gp.physics.metrics import residual_acceleration
from bsp_gp.search.compare import STRATEGIES, compare
from bsp_gp.search.constants import fit_constants
from bsp_gp.search.objective import Objective
from bsp_gp.search.run import Budget


def compare_searches(
    dataset, laws, grammar, *, rng, kind=None, seeds=5, n_scored=20_000, exclude=(), searches=None,
    executor=None, missing_inputs=(), method=None,
):  # fmt: skip
    """Search what a declared model leaves with every strategy, from several seeds.

    Parameters
    ----------
    laws : sequence of str
        The declared model; empty for no force at all.
    grammar : Grammar
        Masked to the data.
    kind : str, optional
        "pair" or "field"; by default the grammar's first of which these data have any.
    seeds : int
        Runs of each strategy.
    n_scored : int
        Budget of a run, in scored laws.
    exclude : collection of str
        Inputs that laws may not use.
    searches : sequence of str, optional
        Names out of `bsp_gp.search.compare.STRATEGIES`; all by default. The exhaustive search
        always runs, as the measure of the others.
    missing_inputs : tuple of str
        For the certificate.
    method : str, optional
        How accelerations are read off noisy positions: "gls" (the default) or "weak".

    Returns
    -------
    rows : list of dict
        One per run: search, seed, law, constants, share of the residual explained, description
        length, regret, n_evaluated, seconds, and the residual accelerations that are left on
        training and held-out data, m/s^2.
    certificate : Certificate
    how : str
        How accelerations were read off the positions.

    Raises
    ------
    SettingsError
        If a name is unknown, or there is no law to compare on these data.
    """
    names = tuple(STRATEGIES) if searches is None else tuple(searches)
    unknown = [name for name in names if name not in STRATEGIES]
    if unknown:
        raise SettingsError(f"search must be one of {', '.join(STRATEGIES)}, got {unknown[0]!r}")
    kind = _sayable_kind(dataset, grammar, kind)
    law = declared_law(dataset, laws)
    regression, held_out = regressions(dataset, law, rng.spawn(1)[0], method)
    fit = fit_constants(regression, law)
    objective = Objective(
        regression, grammar.without_inputs(exclude), kind, target=fit.residual,
        nuisance=fit.jacobian, criterion="mdl",
    )  # fmt: skip
    outcomes = compare(
        objective, Budget(n_scored=n_scored), seeds=seeds, rng=rng,
        strategies={name: STRATEGIES[name] for name in names}, executor=executor,
        missing_inputs=missing_inputs,
    )  # fmt: skip
    if outcomes[0].best is None:
        raise SettingsError(
            f"there is nothing to compare: no {kind} law of the grammar {grammar.name} has a "
            "finite value on these data within the bound of the exhaustive search; choose another "
            "--kind or another --grammar"
        )
    optimum = outcomes[0].cost
    rows = [_row(outcome, optimum, fit.law, regression, held_out) for outcome in outcomes]
    widths = regression.widths
    how = regression.method + (f", {widths.text()}" if widths is not None else "")
    return rows, outcomes[0].certificate, how


def regressions(dataset, law, rng, method=None):
    """Accelerations read off the training scenes, and off those held out.

    Exact positions are taken for rows of steps, or of a smooth motion, as the law fits them better.

    Parameters
    ----------
    law : ForceLaw
        The declared one.
    rng : numpy.random.Generator
        For a split that is not declared.
    method : str, optional
        As of `compare_searches`.

    Raises
    ------
    SettingsError
        If a method is asked for that these data have no use for.
    """
    dataset = with_usable_masses(dataset)
    split = choose_split(dataset, rng)
    sigma = np.array(estimate_noise(dataset).sigma)
    own = ("gls",)
    if dataset.velocity == "measured" and all(s.velocities is not None for s in dataset.scenes):
        own, sigma = ("derivative",), np.where(np.isfinite(sigma), 1.0, np.nan)
    elif is_exact(dataset.scenes, sigma):
        own = ("one_step", "central")
    if method is not None and (own != ("gls",) or method not in ("gls", "weak")):
        raise SettingsError(
            f"accelerations are read off these data by {own[0]!r}, not by {method!r}: 'gls' and "
            "'weak' are for positions with noise"
        )

    def read(scenes, method):
        return build_regression(
            scenes, method=method, sigma=sigma, up=dataset.up,
            memory=dataset.noise_memory or 0.0, may_be_empty=True,
        )  # fmt: skip

    train = {name: read(split.train, name) for name in ((method,) if method else own)}
    best = min(train, key=lambda name: fit_constants(train[name], law).loss)
    return train[best], read(split.test, best)


def _sayable_kind(dataset, grammar, kind):
    """The kind to search; pair laws need another body to act."""
    kinds = tuple(grammar.start)
    is_alone = all(len(scene.entities) < 2 for scene in dataset.scenes)
    if kind is not None and kind not in kinds:
        raise SettingsError(
            f"kind must be one of {', '.join(kinds)} in the grammar {grammar.name}, got {kind!r}"
        )
    if not is_alone:
        return kind or kinds[0]
    if kind == "pair" or set(kinds) == {"pair"}:
        raise SettingsError(
            "pair laws act between bodies, and every scene has one body only; "
            + (
                "choose --kind field"
                if "field" in kinds
                else f"choose a grammar with field laws, such as physics, not {grammar.name}"
            )
        )
    return kind or next(k for k in kinds if k != "pair")


def _row(outcome, optimum, law, train, test):
    row = {
        "search": outcome.search, "seed": outcome.seed, "law": "", "constants": "",
        "share": 0.0, "description_nats": outcome.cost, "regret_nats": outcome.cost - optimum,
        "n_evaluated": outcome.n_evaluated, "n_to_best": outcome.n_to_best,
        "seconds": round(outcome.seconds, 3), "left_train": np.nan, "left_test": np.nan,
    }  # fmt: skip
    best = outcome.best
    if best is None:
        return row
    names = {}
    for name in best.formula.constants:
        names[name] = fresh_name(law) if not names else f"{fresh_name(law)}_{len(names) + 1}"
    term = Term(rename_constants(best.formula, names), best.kind)
    whole = law.plus(term, {names[n]: v for n, v in best.constants.items()})
    try:
        whole = fit_constants(train, whole).law
        left = [residual_acceleration(regression, whole) for regression in (train, test)]
    except EvaluationError:
        left = [np.nan, np.inf]  # no finite value on held-out data
    constants = "; ".join(f"{name} = {value:.6g}" for name, value in best.constants.items())
    return row | {
        "law": to_text(best.formula), "constants": constants, "share": best.share,
        "left_train": left[0], "left_test": left[1],
    }  # fmt: skip
