"""Proposals fitted jointly with the rest of the law, and the choice among them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.language.formula import Call, Constant, factors, product
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.dropping import or_fault
from bsp_gp.loop.effects import CLASS_BIC, sign_bounds
from bsp_gp.loop.models import Attempt, Model, is_property
from bsp_gp.loop.naming import describe, form_of, fresh_name, rename_constant
from bsp_gp.loop.planning import plan_ahead
from bsp_gp.loop.residual import examine_residual
from bsp_gp.physics.force import Term, split_linear

__all__ = ["TIE_BIC", "attempt_of", "attempts_of", "choose", "evaluate", "named"]

TIE_BIC = 2.0


def evaluate(observation, law, fit=None):
    """Fit a law (unless fitted) and score it on the held-out scenes."""
    fit = fit or observation.fit(law)
    errors, rows = observation.errors(fit.law)
    return Model(fit.law, fit, errors, rows)


def attempts_of(observation, model, proposals, workers):
    """Every proposal of the shortlist, fitted jointly with the rest of the law."""
    jobs = [(observation, model.fit, proposal) for proposal in proposals.shortlist]
    run = map if workers is None else workers.map
    return [attempt for attempt in run(attempt_of, jobs) if attempt is not None]


def named(proposal, law):
    """The formula of a proposal with a constant that the law does not use yet."""
    return rename_constant(proposal.formula, proposal.constant, fresh_name(law))


def attempt_of(job):
    """Proposals fitted jointly with the law: of (observation, fit before, *proposals); or None."""
    observation, before, *proposals = job
    law, terms = before.law, []
    for proposal in proposals:
        name, formula = fresh_name(law), named(proposal, law)
        start = 0.0
        if proposal.per_entity:
            start = dict.fromkeys(observation.train_regression.receiver_names(), 0.0)
        law = law.plus(Term(formula, proposal.kind), {name: start})
        terms.append((name, formula))
    bounds = sign_bounds(observation, law)
    # No finite value at some instant of the training data, say; counted by the round.
    fit, _ = or_fault(observation.fit_beyond, law, before, bounds)
    if fit is None or not np.isfinite(fit.chisqr):
        return None
    reason, words = "", []
    for name, formula in terms:
        values = [v for (n, _), v in zip(fit.parameters, fit.values, strict=True) if n == name]
        low, high = bounds.get(name, (-np.inf, np.inf))
        if observation.is_exact and not all(low <= v <= high for v in values):
            reason = "it would push forward along the velocity: the sign of another cause"
        elif not np.any(values):
            reason = "its sign would push forward: held at zero"
        words.append(describe(formula, _typical(values)))
    if any(p.redoes_declared for p in proposals):
        reason = "it only changes the number of a declared term, which is declared as fixed"
    kinds = {p.kind for p in proposals}
    ties = ()
    if len(proposals) == 1:
        (proposal,), ((name, _),) = proposals, terms
        ties = tuple(to_text(rename_constant(t, proposal.constant, name)) for t in _other(proposal))
    return Attempt(
        fit.law,
        fit,
        sum(p.complexity for p in proposals),
        " and ".join(words),
        " + ".join(to_text(formula) for _, formula in terms),
        " + ".join(to_latex(formula) for _, formula in terms),
        kinds.pop() if len(kinds) == 1 else "pair",
        proposals[0].share if len(proposals) == 1 else float("nan"),
        ties,
        reason,
        redoes_declared=any(p.redoes_declared for p in proposals),
        n_effects=len(proposals),
    )


def _other(proposal):
    """Ties of a proposal that are other laws, not the same one or each other written anew."""
    forms = {form_of(proposal.formula)}
    for tie in proposal.ties:
        form = form_of(tie)
        if form not in forms:
            forms.add(form)
            yield tie


def _typical(values):
    return float(np.median(values)) if len(values) else None


def choose(observation, model, search, attempts, alpha):
    """The attempt to adopt: best evidence and prior; then its nearest kin of the declared law."""
    able = [a for a in attempts if not a.reason]
    if not able:
        return None
    n_eff = min(attempts, key=lambda a: a.fit.chisqr).fit.n_effective
    best = min(able, key=lambda a: (a.score(n_eff), a.complexity))
    best = _confirmed(observation, model, able, best, n_eff, alpha)
    if best.freed or best.n_effects > 1:
        return best
    best = _like_declared(observation, model, best, n_eff)
    if observation.is_exact:
        best = plan_ahead(observation, model.law, best, search)
    return best


def _confirmed(observation, model, able, best, n_eff, alpha):
    """The best attempt, or where the data refute it, the next that they do not.

    Only those are looked at that are not ruled out beside the best. Held-out tracks refute a law
    under which they are less likely than they should be were it true, and what is left refutes one
    beside others that leave noise.
    """
    if observation.is_exact or observation.velocity == "measured":
        return best
    near = [a for a in able if a.score(n_eff) - best.score(n_eff) < CLASS_BIC]
    near.sort(key=lambda a: (a.score(n_eff), a.complexity))
    kept = [a for a in near if not observation.held_out_contradict(model.fit, a.fit)]
    for attempt in kept or near:
        if examine_residual(observation, attempt.fit, alpha).is_noise:
            return attempt
    return kept[0] if kept else best


def _declared_pair(law):
    """Property factors of the declared pair term, if there is exactly one such term."""
    terms = [t for t in law.terms if t.is_declared and t.kind == "pair"]
    if len(terms) != 1:
        return None
    above, below = factors(terms[0].formula)
    if any(is_property(f) for f in below):
        return None
    return [f for f in above if is_property(f)]


def _with_properties(formula, properties):
    """The formula with its property factors replaced."""
    above, below = factors(formula)
    above = [f for f in above if not is_property(f)]
    below = [f for f in below if not is_property(f)]
    vectors = [f for f in above if f.type.shape == "vector"]
    scalars = [f for f in above if f.type.shape != "vector" and not isinstance(f, Constant)]
    head = [f for f in above if isinstance(f, Constant)]
    coefficient = product([*head, *properties, *scalars])
    if below:
        coefficient = Call("div", coefficient, product(below))
    return product([coefficient, *vectors])


def _like_declared(observation, model, best, n_eff):
    """Prefer the property factors of the declared pair law where the data cannot tell."""
    law = model.law
    properties = _declared_pair(law)
    term = best.law.terms[-1]
    if not properties or term.kind != "pair":
        return best
    formula = _with_properties(term.formula, properties)
    if formula == term.formula:
        return best
    name = split_linear(formula)[0]
    new = law.plus(Term(formula, "pair"), {name: 0.0})
    fit, _ = or_fault(observation.fit_beyond, new, model.fit, sign_bounds(observation, new))
    if fit is None:
        return best
    # On exact data what is left is misfit: a tenth of it more is no evidence.
    same = (
        fit.chisqr < 1.1 * best.fit.chisqr
        if observation.is_exact
        else fit.bic(n_eff) - best.fit.bic(n_eff) < TIE_BIC
    )
    if not same:
        return best
    value = float(fit.values[-1])
    return replace(
        best,
        law=fit.law,
        fit=fit,
        text=to_text(formula),
        latex=to_latex(formula),
        name=describe(formula, value),
        ties=(best.text, *best.ties),
    )
