"""Attempts that need no search: common effects, a period, an exponent of a declared term."""

from __future__ import annotations

from dataclasses import replace

from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.attempts import attempt_of
from bsp_gp.loop.declared_exponents import exponent_attempts
from bsp_gp.loop.effects import Proposal
from bsp_gp.loop.periodic import periodic_attempts
from bsp_gp.loop.residual import examine_residual
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term

__all__ = ["directed_attempts", "joined", "known_attempts", "leaves_noise"]

MOST_DIRECTIONS = 3
PRIOR_NATS = 4.0
"""Complexity of a common effect, as that of the shortest laws of a grammar."""


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

    def is_usable(attempt):
        return all(t.formula.inputs <= usable for t in attempt.law.terms[n_own:])

    out = [attempt for attempt in out if is_usable(attempt)]
    for n in sorted({len(d.laws) for d in missing.together}):
        if leaves_noise(observation, out, alpha):
            break  # one effect before two
        sets = [d for d in missing.together if len(d.laws) == n and d.p_value <= alpha]
        out += filter(is_usable, directed_attempts(observation, model, sets[:MOST_DIRECTIONS]))
    return out


def directed_attempts(observation, model, directions):
    """Attempts at common effects that are forces.

    They were named before the data were seen, so that each has a p-value of its own, which need
    not count all laws of a grammar.

    Parameters
    ----------
    observation : Observation
    model : Model
    directions : sequence of Direction

    Returns
    -------
    list of Attempt
    """
    out, types = [], dataset_types(observation.dataset)
    for direction in directions:
        if not direction.laws:
            continue
        proposals = []
        for text in direction.laws:
            formula = parse_formula(text, types, units=observation.dataset.units)
            kind = Term(formula).kind
            proposals.append(
                Proposal(formula, kind, "c1", False, PRIOR_NATS, float("nan"), float("nan"))
            )
        attempt = attempt_of((observation, model.fit, *proposals))
        if attempt is not None:
            out.append(replace(attempt, p_value=direction.p_value))
    return out


def leaves_noise(observation, attempts, alpha):
    """Whether the best of the attempts explains all that was left.

    Parameters
    ----------
    observation : Observation
    attempts : list of Attempt
    alpha : float

    Returns
    -------
    bool
    """
    able = [a for a in attempts if not a.reason]
    if not able:
        return False
    n_eff = able[0].fit.n_effective
    best = min(able, key=lambda a: a.score(n_eff))
    return examine_residual(observation, best.fit, alpha).is_noise


def joined(attempts, known):
    """Attempts of the search and known ones; a law that is both once, with the better prior."""
    own = {a.text: a for a in known}
    out = [_both(a, own.pop(a.text)) if a.text in own else a for a in attempts]
    return out + list(own.values())


def _both(searched, known):
    complexity = min(searched.complexity, known.complexity)
    return replace(searched, p_value=known.p_value, complexity=complexity)
