"""A declared term refuted: the found term explains the data in its place, not beside it.

Beside the true term a wrong declared one has nothing left to do: its constant loses its meaning
(`blurred_constants`), and the sum of the two can be told from neither. Then the found term is put
in the place of the declared one, and the declared one is treated as any other further term.
"""

from __future__ import annotations

from dataclasses import replace

from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.effects import sign_bounds
from bsp_gp.loop.naming import describe
from bsp_gp.loop.outcome import Rival
from bsp_gp.physics.force import split_linear

__all__ = ["blurred_constants", "in_place_of_declared", "refuted_rival"]

MAX_BLUR = 10.0
"""Growth of the relative error of an adopted constant at which a further term is refused."""


SHARP = 0.03
"""A relative error up to this is sharp in any case."""


def blurred_constants(before, after):
    """Constants that lose their meaning when a term is added.

    A term that nearly repeats one of the law's inflates that one's error bar and may flip its
    sign; it explains nothing that can be named.

    Parameters
    ----------
    before, after : Fit

    Returns
    -------
    list of (name, float, float)
        With the relative half-widths before and after.
    """
    widths = {
        key: half / abs(value)
        for key, value, half in zip(before.parameters, before.values, before.intervals, strict=True)
        if value
    }
    out = []
    for key, value, half in zip(after.parameters, after.values, after.intervals, strict=True):
        if key in widths and value:
            width = half / abs(value)
            if width > MAX_BLUR * widths[key] and width > SHARP:
                out.append((key[0], widths[key], width))
    return out


def in_place_of_declared(observation, model, chosen):
    """The chosen attempt without the declared terms that it blurs; None if it blurs none.

    Only terms with a fitted strength can go: a declared number is believed.

    Parameters
    ----------
    observation : Observation
    model : Model
        The one entering the round.
    chosen : Attempt

    Returns
    -------
    Attempt or None
    """
    names = {name for name, _, _ in blurred_constants(model.fit, chosen.fit)}
    gone = [
        k
        for k, term in enumerate(chosen.law.terms)
        if term.is_declared and term.formula.constants and split_linear(term.formula)[0] in names
    ]
    if not gone:
        return None
    law, words = chosen.law, []
    for k in reversed(gone):
        words.insert(0, f"the declared {_words(law.terms[k], model)}")
        law = law.without(k)
    fit = observation.fit(law, sign_bounds(observation, law))
    return replace(
        chosen, law=fit.law, fit=fit, replaces=(*chosen.replaces, *words), equivalents=(), ties=()
    )


def _words(term, model):
    name = split_linear(term.formula)[0]
    return f"{describe(term.formula, model.law.constants.get(name))} ({to_text(term.formula)})"


def refuted_rival(model, chosen, attempt, ratio):
    """The declared law as a rival that lost.

    Parameters
    ----------
    model : Model
        The declared law.
    chosen : Attempt
        With the found term in place of the declared one.
    attempt : Attempt
        With both.
    ratio : float
        Held-out error with both over that with the found term alone.
    """
    n_eff = chosen.fit.n_effective
    kept = {to_text(term.formula) for term in chosen.law.terms}
    gone = [t for t in model.law.terms if t.is_declared and to_text(t.formula) not in kept]
    delta = float(model.fit.bic(n_eff) - chosen.fit.bic(n_eff))
    beside = float(attempt.fit.bic(n_eff) - chosen.fit.bic(n_eff))
    return Rival(
        " and ".join(f"declared {_words(t, model)}" for t in gone), "declared_term_change",
        " + ".join(to_text(t.formula) for t in gone), " + ".join(to_latex(t.formula) for t in gone),
        delta, 0.0, float(ratio), 0.0,
        f"refuted: BIC lower by {delta:.1f} with {chosen.name} in its place; kept beside it, BIC "
        f"changes by {beside:+.1f} and the held-out error to {ratio:.2f} of itself",
    )  # fmt: skip
