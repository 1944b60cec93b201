"""Whether a term is adopted: the tests that it must pass, and what is said where it fails one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bsp_gp.loop.attempts import TIE_BIC, evaluate
from bsp_gp.loop.before_after import BeforeAfter, compared
from bsp_gp.loop.models import Attempt, Model
from bsp_gp.loop.observation import contradicts
from bsp_gp.loop.outcome import Rival
from bsp_gp.loop.replacing import blurred_constants, in_place_of_declared, refuted_rival
from bsp_gp.loop.residual import examine_residual

__all__ = [
    "FREED", "MIN_BIC_GAIN", "MIN_SHARE", "TURNED", "Weighed", "blurred", "explained_share",
    "number_wins",
    "put_in_place", "verdict_of", "weigh",
]  # fmt: skip

MIN_BIC_GAIN = 6.0


FREED = (
    "a change of a declared number fits better than any new term; a wrong number, a wrong length "
    "scale and a wrong clock do the same, and these data cannot tell them apart"
)
TURNED = "a declared term with the other sign fits better than any new term"


MIN_SHARE = 0.75
"""Part of the held-out error above the noise floor (squared) that a term must remove."""


BEYOND_DOUBT = 0.1
"""Part of alpha that the p-value of a term must not exceed where held-out tracks are too few to
confirm it: they are then no second test."""


class Weighed(NamedTuple):
    """What was found out about a term: error floor, ratio, gain on held-out tracks, what is left.

    Attributes
    ----------
    floor : Errors
    ratio : Ratio
    held_out : float
        Fall of the chi-squared of held-out tracks; nan on exact data.
    is_left : bool
        Whether the law with the term still leaves more than noise.
    sight : float
        Signal-to-noise ratio at which held-out tracks would show the term; nan if not asked for.
    seen : float
        That at which training tracks show it.
    is_clear : bool
        Whether the search found it far beyond all simulated residuals, whose number bounds its
        p-value.
    """

    floor: object
    ratio: object
    held_out: float
    is_left: bool
    sight: float = float("nan")
    seen: float = float("inf")
    is_clear: bool = False

    def is_open(self, p_value, alpha):
        """Whether held-out tracks are too few to confirm a term that is beyond doubt without them.

        They do not contradict it either: were it true, their gain would be as small often enough.
        """
        if self.held_out > 0 or contradicts(self.held_out, self.sight, self.seen):
            return False
        return self.is_clear or p_value <= BEYOND_DOUBT * alpha


def weigh(observation, model, after, floor, ratio, alpha, is_clear=False):
    """What held-out tracks and the residual say of a model with one more term, as `Weighed`.

    `is_clear` says that the search found it far beyond all simulated residuals.
    """
    # A memory that was estimated takes up what a term leaves: then only errors can tell.
    is_blind = observation.is_exact or (observation.memory > 0 and observation.may_have_memory)
    is_left = is_blind or not examine_residual(observation, after.fit, alpha).is_noise
    held_out = observation.held_out_gain(model.law, after.law)
    sight = observation.held_out_sight(model.law, after.law) if held_out <= 0 else float("nan")
    seen = np.sqrt(max(model.fit.chisqr - after.fit.chisqr, 0.0))
    return Weighed(floor, ratio, held_out, is_left, sight, float(seen), is_clear)


def verdict_of(observation, model, after, chosen, attempts, found, p_value, alpha):
    """Adopt, or say why not.

    Parameters
    ----------
    observation : Observation
    model, after : Model
        Without and with the term.
    chosen : Attempt
        The term.
    attempts : list of Attempt
        All that were fitted in the round.
    found : Weighed
    p_value : float
        With the selection counted.
    alpha : float

    Returns
    -------
    adopted : bool
    verdict : str
        One of `outcome.VERDICTS`.
    reason : str
    """
    ratio, held_out = found.ratio, found.held_out
    n_eff = chosen.fit.n_effective
    gain = model.fit.bic(n_eff) - chosen.fit.bic(n_eff)
    share = explained_share(observation, model.errors, after.errors, found.floor)
    if p_value > alpha:
        return (
            False,
            "cannot tell",
            (
                "something is left, but no law of the grammar explains more of it than noise alone "
                f"would let the best of all laws explain (p = {p_value:.3g}, alpha = {alpha:g})"
            ),
        )
    if gain < MIN_BIC_GAIN:
        return (
            False,
            "seen, not adopted",
            (f"the evidence for it is weak: BIC falls by {gain:.1f}, less than {MIN_BIC_GAIN:g}"),
        )
    if number_wins(model, chosen, attempts, p_value, alpha):
        return False, "cannot tell", FREED
    if found.is_left and chosen.n_effects > 1:
        return (
            False,
            "seen, not adopted",
            (
                f"{chosen.n_effects} effects at once remove {max(share, 0):.0%} of the held-out "
                "error above the noise floor and leave more than noise: together they only imitate "
                "a cause that is not among the laws tried"
            ),
        )
    if found.is_left and not share >= MIN_SHARE:
        rivals = [
            a
            for a in attempts
            if not a.reason
            and a.name != chosen.name
            and a.fit.bic(n_eff) - chosen.fit.bic(n_eff) < TIE_BIC
        ]
        verdict = "cannot tell" if rivals else "seen, not adopted"
        return (
            False,
            verdict,
            (
                f"the best term removes only {max(share, 0):.0%} of the held-out error above the "
                f"noise floor, less than {MIN_SHARE:.0%}, and leaves more than noise: the cause is "
                "not among the laws tried"
            ),
        )
    blur = blurred(model.fit, after.fit)
    if blur:
        return (
            False,
            "seen, not adopted",
            (f"beside it {blur}: these data hardly tell the two terms apart"),
        )
    is_confirmed = held_out > 0 or found.is_open(p_value, alpha)
    # Predictions from the first rows test a law on the same tracks, and bluntly: they are asked
    # where more than noise is left, so that the likelihood of all rows is no judge.
    is_worse = found.is_left and not ratio.low <= 1
    if not observation.is_exact and (not is_confirmed or is_worse):
        return (
            False,
            "seen, not adopted",
            (
                f"held-out tracks do not confirm it: their chi-squared falls by {held_out:.3g}, "
                f"the error of predictions has the ratio {ratio.value:.2f} "
                f"[{ratio.low:.2f}, {ratio.high:.2f}]"
            ),
        )
    extra = f"; it takes the place of {', '.join(chosen.replaces)}" if chosen.replaces else ""
    return (
        True,
        "effect adopted",
        (
            f"BIC falls by {gain:.1f}, p = {p_value:.3g} with the selection counted, and "
            + _on_held_out(observation, share, found)
            + extra
        ),
    )


def _on_held_out(observation, share, found):
    """What held-out data say of an adopted term."""
    if share >= MIN_SHARE and (observation.is_exact or found.ratio.high < 1):
        return f"{share:.0%} of the held-out error above the noise floor is gone"
    if not observation.is_exact and not found.held_out > 0:
        return (
            "held-out tracks are too few to confirm or to contradict it (their chi-squared falls "
            f"by {found.held_out:.3g}, of which {found.sight**2:.2g} ± {2 * found.sight:.2g} was "
            "to be expected)"
        )
    return (
        f"held-out tracks confirm it (their chi-squared falls by {found.held_out:.3g}), though "
        "noise hides most of what it does to predictions"
    )


@dataclass(frozen=True, eq=False)
class _Refuted:
    """A declared term is out, the found one in its place."""

    chosen: Attempt
    after: Model
    errors: BeforeAfter
    reason: str
    rival: Rival


def put_in_place(observation, model, both, chosen, attempts, p_value, alpha, rng):
    """The found term in place of a declared one, if it passes there and the two beside it do not.

    `both` is the model with the two. The term alone must pass every test of a new term against
    the declared law, and the declared term, added to it again, must fail as a further term.
    """
    attempt = in_place_of_declared(observation, model, chosen)
    if attempt is None or not np.isfinite(attempt.fit.chisqr):
        return None
    after = evaluate(observation, attempt.law, attempt.fit)
    floor, copies = observation.floor(after.law, rng)
    errors = compared(observation, model, after, copies, rng)
    found = weigh(observation, model, after, floor, errors.ratio, alpha)
    adopted, _, reason = verdict_of(
        observation, model, after, attempt, attempts, found, p_value, alpha
    )
    if not adopted or explained_share(observation, after.errors, both.errors, floor) >= MIN_SHARE:
        return None
    left = observation.headline_error(both.law) / observation.headline_error(after.law)
    rival = refuted_rival(model, attempt, chosen, left)
    return _Refuted(attempt, after, errors, reason, rival)


def number_wins(model, chosen, attempts, p_value, alpha):
    """Whether something is there, and a change of a declared number explains it best."""
    n_eff = chosen.fit.n_effective
    if p_value > alpha or model.fit.bic(n_eff) - chosen.fit.bic(n_eff) < MIN_BIC_GAIN:
        return False
    return any(a.redoes_declared and _is_better(a.fit, chosen.fit, n_eff) for a in attempts)


def _is_better(fit, other, n_eff):
    """Whether a fit is clearly better: by its BIC; on exact data by leaving next to nothing."""
    if fit.is_exact:
        return fit.chisqr < 0.01 * other.chisqr
    return fit.bic(n_eff) < other.bic(n_eff) - TIE_BIC


def blurred(before, after):
    """Which constant loses its meaning when a term is added; "" if none does.

    A term that nearly repeats one of the law's inflates that one's error bar and may flip its
    sign; it explains nothing that can be named.
    """
    for name, was, width in blurred_constants(before, after):
        return f"the relative error of {name} grows from {was:.1g} to {width:.1g}"
    return ""


def explained_share(observation, before, after, floor):
    """Share of the squared held-out error above the floor that is gone."""
    if observation.is_exact:
        b, a, f = before.residual_acceleration, after.residual_acceleration, 0.0
    else:
        b, a, f = before.rollout_rmse, after.rollout_rmse, floor.rollout_rmse
    above = b**2 - f**2
    if not above > 0:
        return 0.0
    return float((b**2 - a**2) / above)
