"""A cause that says all of the tracks is set aside while laws are asked for without it.

Random kicks leave nothing of any motion. They are no rival of the first law, which leaves what the
others explain, but of all laws together.
"""

from dataclasses import dataclass, field, replace

from bsp_gp.loop.decide import decide


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


def settled(rounds):
    """Rounds in which nothing is set aside: all laws together, or the cause that says all.

    Parameters
    ----------
    rounds : list of Round

    Returns
    -------
    list of Round
    """
    out = list(rounds)
    for k, done in enumerate(rounds):
        if done.aside is None:
            continue
        best = done.aside.decision.best
        laws = [r.decision.best for r in rounds[k:] if r.decision.is_adopted]
        together = laws[-1].log_evidence + sum(row.log_prior for row in laws)
        if best.log_posterior > together:
            own = {"decision": done.aside.decision, "details": done.aside.details, "aside": None}
            return [*out[:k], replace(done, **own)]
        out[k] = replace(done, table=without(done.table, best), aside=None)
    return out
