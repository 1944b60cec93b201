"""The way back to a law of textbooks, where an odd one was adopted and more was found beside it.

Of two causes the likeliest single law is often an odd one that takes up some of the other. What is
found beside it does not tell whether the plain law and that other cause are likelier.
"""

from dataclasses import replace

from bsp_gp.loop.decide import HARDLY_MORE, Decision
from bsp_gp.loop.evidence import log_evidence


def usual_law(turn, table, decision, is_usual):
    """The decision for the likeliest laws of textbooks that leave hardly more; None without such.

    Parameters
    ----------
    turn : object
        With proposals by row.
    table : HypothesisTable
    decision : Decision
        Of it; nothing is asked where what it adopts is no odd law.
    is_usual : callable
        ``is_usual(proposal)``.
    """
    best = decision.best
    if not decision.is_adopted or best.kind != "force" or is_usual(turn.proposals[best.id]):
        return None
    rows = (
        row for row in table.candidates
        if row.id in turn.proposals and is_usual(turn.proposals[row.id])
        and row.left < HARDLY_MORE * best.left
    )  # fmt: skip
    row = next(rows, None)
    return row and Decision("effect adopted", "adopted", row, True)


def retraced(rounds):
    """Rounds up to one that adopts the usual law in the place of an odd one, or None.

    Only where a cause was found beside the odd one: else both were compared as they are.
    """
    for k, (done, after) in enumerate(zip(rounds, rounds[1:], strict=False)):
        if done.usual is not None and done.goes_on and after.decision.is_adopted:
            told = {"decision": done.usual.decision, "details": done.usual.details}
            return [*rounds[:k], replace(done, usual=None, **told)]
    return None


def is_likelier(rounds, others, criteria):
    """Whether all that some rounds found is likelier than all that others found."""
    return _log_posterior(rounds, criteria) > _log_posterior(others, criteria)


def _log_posterior(rounds, criteria):
    found, hypothesis = rounds[-1].after, rounds[-1].continuing
    adopted = (done.decision.best for done in rounds if done.decision.is_adopted)
    return log_evidence(found, hypothesis, criteria) + sum(row.log_prior for row in adopted)
