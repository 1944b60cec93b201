"""Causes that make predictions worse are refused, whatever they explain."""

from __future__ import annotations

import math
from dataclasses import replace

from scipy import special

from bsp_gp.loop.accounts import Accounts

__all__ = ["that_foresee"]

N_COPIES = 40
"""Simulated copies of the held-out scenes that say whether predictions are surely worse."""
LEVEL = 0.01
"""At which they are: causes of which predictions hardly depend are many."""
WIDER = special.ndtri(LEVEL) / special.ndtri(0.05)
REFUSED = {
    "verdict": "seen, not adopted", "reason": "predictions_worse", "is_adopted": False,
    "is_fact": False,
}  # fmt: skip


def that_foresee(rounds, refitted, dataset, scenes, rng, crew=None, kept=None):
    """Rounds up to the first whose cause surely makes predictions of held-out rows worse.

    Parameters
    ----------
    rounds : sequence of Round
    refitted : callable
        ``refitted(fit, hypothesis)`` gives a fit as it would be without the held-out rows.
    dataset : Dataset
    scenes : sequence of Scene
        Held out.
    rng : numpy.random.Generator
    crew : Crew, optional
        By whom scenes are scored.
    kept : dict, optional
        Of `Accounts`.

    Returns
    -------
    list of Round
        That round adopts nothing, and those after it are gone.
    """
    kept = {} if kept is None else kept
    for k, (done, stream) in enumerate(zip(rounds, rng.spawn(len(rounds)), strict=True)):
        if not done.decision.is_adopted:
            break
        pair = [
            refitted(done.entering, done.hypotheses[0]), refitted(done.after, done.continuing)
        ]  # fmt: skip

        def ratio(n_copies, pair=pair, stream=stream):
            accounts = Accounts(pair, dataset, scenes, stream, n_copies, crew, kept)
            return accounts.ratio(0, 1)

        # Only where predictions are worse does it matter whether that is chance.
        if ratio(0).value > 1 and _is_surely_worse(ratio(N_COPIES)):
            refused = replace(done, decision=replace(done.decision, **REFUSED))
            return [*rounds[:k], refused]
    return list(rounds)


def _is_surely_worse(ratio):
    """Whether a ratio of errors is above 1 at that level; its interval goes from 5 to 95 %."""
    if not (math.isfinite(ratio.low) and ratio.low > 0):
        return False
    return math.log(ratio.value) + WIDER * math.log(ratio.low / ratio.value) > 0
