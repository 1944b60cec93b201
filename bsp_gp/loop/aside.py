"""A cause that says all of the tracks is set aside while laws are asked for without it.

Random kicks leave nothing of any motion. They are no rival of the first law, which leaves what the
others explain, but of all laws together.
"""

from dataclasses import dataclass, field, replace

from bsp_gp.loop.decide import decide

CLOSER = 0.5
"""Part of what laws are behind that is left when another has been found, or no more are asked."""


@dataclass(frozen=True, eq=False)
class Aside:
    """What a round would adopt.

    Attributes
    ----------
    decision : Decision
    details : dict
        As of `Round`.
    """

    decision: object
    details: dict = field(default_factory=dict)


def without(table, best):
    """A table without one of its rows, its probabilities anew."""
    rows = tuple(row for row in table.rows if row.id != best.id)
    return replace(table, rows=rows).with_probabilities()


def law_beside(table, decision, proposals, criteria):
    """The decision for a law in the place of a cause that says all; None where there is no law."""
    best = decision.best
    if not (decision.is_adopted and proposals[best.id].is_last):
        return None
    other = decide(without(table, best), criteria)
    is_law = other.is_adopted and bool(proposals[other.best.id].formulas)
    return other if is_law else None


def is_hopeless(rounds):
    """Whether laws do not come nearer to what was set aside: half as near in every round."""
    behind = [gap for gap in _gaps(rounds) if gap is not None]
    return len(behind) > 1 and behind[-1] > max(CLOSER * behind[-2], 0.0)  # those ahead have won


def _gaps(rounds):
    """Nats by which all laws up to each round are behind what was set aside; None before that."""
    best, laws = None, []
    for done in rounds:
        best = best or (done.aside and done.aside.decision.best)
        if best and done.decision.is_adopted:
            laws.append(done.decision.best)
        prior = sum(row.log_prior for row in laws)
        yield best.log_posterior - laws[-1].log_evidence - prior if laws else None


def settled(rounds):
    """Rounds in which nothing is set aside: all laws together, or the cause that says all."""
    at = next((k for k, done in enumerate(rounds) if done.aside is not None), None)
    if at is None:
        return rounds
    done, gap = rounds[at], list(_gaps(rounds))[-1]
    table, own = without(done.table, done.aside.decision.best), done.aside
    if gap is not None and gap > 0:
        told = {"decision": own.decision, "details": own.details}
        return [*rounds[:at], replace(done, aside=None, **told)]
    table = done.table if gap is None else table  # None: the time was up
    return [*rounds[:at], replace(done, table=table, aside=None), *rounds[at + 1 :]]
