"""Backward steps: adopted terms that later ones made needless, declared terms without support."""

from __future__ import annotations

from dataclasses import replace

from bsp_gp.language.render import to_text
from bsp_gp.loop.attempts import evaluate
from bsp_gp.loop.effects import sign_bounds
from bsp_gp.loop.residual import examine_residual
from bsp_gp.loop.telling import constant_estimates
from bsp_gp.physics.force import split_linear

__all__ = ["prune", "unsupported"]


def prune(observation, model, rounds, alpha):
    """Take back adopted terms that the data no longer ask for.

    A term that was adopted first stood in for what was found later. The least needed one goes
    while BIC falls without it and no more than noise is left then, or was left before.

    Parameters
    ----------
    observation : Observation
    model : Model
        After the last round.
    rounds : list of Round
    alpha : float

    Returns
    -------
    model : Model
    rounds : list of Round
        Those of which every term is gone say so in `removed`.
    """
    if sum(done.adopted for done in rounds) < 2:
        return model, rounds
    gone, was_left = {}, None
    while True:
        found = [k for k, term in enumerate(model.law.terms) if not term.is_declared]
        if len(found) < 2:
            break
        n_eff = model.fit.n_effective
        fits = [(_without(observation, model, k), k) for k in found]
        fit, k = min(fits, key=lambda item: item[0].bic(n_eff))
        gain = model.fit.bic(n_eff) - fit.bic(n_eff)
        if not gain > 0:
            break
        if was_left is None:
            was_left = not examine_residual(observation, model.fit, alpha).is_noise
        if not was_left and not examine_residual(observation, fit, alpha).is_noise:
            break
        gone[split_linear(model.law.terms[k].formula)[0]] = (
            f"beside what was found later it is not needed: BIC falls by {gain:.1f} without it"
        )
        model = evaluate(observation, fit.law, fit)
    kept, out = set(model.law.names), []
    for done in rounds:
        own = _first_seen(done, rounds) if done.adopted else set()
        is_gone = own and not own & kept and own & set(gone)
        out.append(replace(done, removed=gone[min(own & set(gone))]) if is_gone else done)
    return model, out


def _first_seen(done, rounds):
    """Names of the constants that a round added."""
    earlier = set()
    for other in rounds:
        names = {c.name for c in other.effect.constants} if other.adopted else set()
        if other is done:
            return names - earlier
        earlier |= names
    return set()


def _without(observation, model, k):
    law = model.law.without(k)
    return observation.fit(law, sign_bounds(observation, law), start=law)


def unsupported(observation, model):
    """What to say of declared terms that the data do without.

    Only terms with a fitted strength are asked about; a declared number is believed.

    Parameters
    ----------
    observation : Observation
    model : Model
        The last one.

    Yields
    ------
    str
    """
    n_eff = model.fit.n_effective
    for k, term in enumerate(model.law.terms):
        if not term.is_declared or not term.formula.constants:
            continue
        gain = model.fit.bic(n_eff) - _without(observation, model, k).bic(n_eff)
        if not gain > 0:
            continue
        name = split_linear(term.formula)[0]
        found = [c for c in constant_estimates(observation, model.fit) if c.name == name]
        most = max(found, key=lambda c: max(abs(c.low), abs(c.high)))
        yield (
            f"the declared term {to_text(term.formula)} has no support in these data: BIC falls "
            f"by {gain:.1f} without it; the greatest |{name}| that they allow is "
            f"{max(abs(most.low), abs(most.high)):.3g} {most.unit}".rstrip()
        )
