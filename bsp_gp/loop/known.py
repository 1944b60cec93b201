"""Attempts that need no search: common effects, a period, another exponent of a declared term."""

from __future__ import annotations

from dataclasses import replace

from bsp_gp.loop.declared_exponents import exponent_attempts
from bsp_gp.loop.directed import directed_attempts
from bsp_gp.loop.periodic import periodic_attempts
from bsp_gp.loop.residual import examine_residual

__all__ = ["joined", "known_attempts", "leaves_noise_alone"]

MOST_DIRECTIONS = 3


def known_attempts(search, model, missing, alpha):
    """Attempts at what was named before the data were seen and stands out in the residual.

    Only with inputs that the search may use; time is left to a period, which is no input.

    Parameters
    ----------
    search : EffectSearch
        With the observation.
    model : Model
    missing : Missing
        Of the model.
    alpha : float

    Returns
    -------
    list of Attempt
    """
    observation, usable = search.observation, search.usable_inputs() | {"t"}
    clear = [d for d in missing.directions if d.p_value <= alpha][:MOST_DIRECTIONS]
    out = exponent_attempts(observation, model, {d.base: d.p_value for d in clear if d.base})
    out += periodic_attempts(observation, model, missing.rhythm)
    out += directed_attempts(observation, model, clear)
    n_own = len(model.law.terms)
    return [a for a in out if all(t.formula.inputs <= usable for t in a.law.terms[n_own:])]


def leaves_noise_alone(observation, attempts, alpha):
    """Whether the best of the attempts explains all that was left.

    Then nothing need be explained by noise with a memory: along tracks that lack a strong effect
    everything looks like that.
    """
    able = [a for a in attempts if not a.reason]
    if not able or not observation.may_have_memory:
        return False
    n_eff = able[0].fit.n_effective
    best = min(able, key=lambda a: a.score(n_eff))
    return not examine_residual(observation, best.fit, alpha).is_missing


def joined(attempts, known):
    """Attempts of the search and known ones, a law that is both only once."""
    own = {a.text: a for a in known}
    out = [replace(a, p_value=own.pop(a.text).p_value) if a.text in own else a for a in attempts]
    return out + list(own.values())
