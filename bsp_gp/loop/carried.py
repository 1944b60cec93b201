"""What was found in a part of the rows, carried over to all of them."""

from dataclasses import replace

from bsp_gp.fitting.hypothesis import Forces, Hypothesis
from bsp_gp.loop.kept import told_rows
from bsp_gp.loop.proposal import FAULTS, continued


def carried(rounds, hypothesis, dataset, begun, *, criteria, bounds=None, clock):
    """Rounds that adopted laws in a part of the rows, their fits made again with all.

    Up to the first whose cause is one of some scenes only, or has no fit with all rows.

    Parameters
    ----------
    rounds : sequence of Round
    hypothesis : Hypothesis
        The declared one, for `dataset`.
    dataset : Dataset
        All that is learned from.
    begun : Fit
        What is declared.
    criteria : Criteria
    bounds : dict, optional
    clock : Clock

    Returns
    -------
    list of Round
    """
    out, found = [], begun
    for done in rounds:
        if not done.goes_on or done.aside is not None or found.is_failed:
            break
        proposals, fits = {}, {0: found}
        for number in told_rows(done):
            proposal = _carried(done, number, hypothesis)
            new = proposal and _fitted(proposal, found, dataset, criteria, bounds, clock)
            if new is not None:
                proposals[number], fits[number] = proposal, new
        best = done.decision.best.id
        if best not in fits or fits[best].is_failed or clock.is_over:
            break
        hypotheses = {k: p.hypothesis for k, p in proposals.items()}
        out.append(replace(
            done, entering=found, fits=fits, proposals=proposals, usual=None,
            hypotheses={0: hypothesis, **hypotheses},
        ))  # fmt: skip
        found, hypothesis = fits[best], hypotheses[best]
    return out


def _fitted(proposal, found, dataset, criteria, bounds, clock):
    try:
        return proposal.fitted(
            found, dataset, criteria=criteria, bounds=bounds, deadline=clock.left
        )
    except FAULTS:
        return None


def _carried(done, number, hypothesis):
    """A proposal that extends the hypothesis of all rows, from where it was fitted; or None."""
    proposal, known = done.proposals[number], done.hypotheses[0].parts
    added = [part for part in proposal.hypothesis.parts if not any(part is own for own in known)]
    if number not in done.fits or not all(map(_is_of_all_scenes, added)):
        return None
    wider = continued(hypothesis + Hypothesis(tuple(added)), done.fits[number])
    return replace(
        proposal, hypothesis=wider, starts={}, judged=None, path=None, after=None, instead=None
    )


def _is_of_all_scenes(part):
    """Whether a part is a force or a constraint that has no number of a scene's own."""
    if isinstance(part, Forces):
        return not any(name.endswith("[scene]") for name in part.law.constants)
    return part.kind == "constraint"
