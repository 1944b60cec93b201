"""What a table of hypotheses says: the one place in which the loop decides."""

import math
from dataclasses import dataclass

from bsp_gp.loop.criteria import FORESEEING, KICKED, Criteria
from bsp_gp.loop.slight import MOST_CAUSES
from bsp_gp.loop.table import SAME_MINIMUM, part_of

FORCED = 10.0
"""Times the nats of odd noise by which a force must be likelier than a memory of the noise for
this to be none."""
SWAMPED = 0.1
"""Size of noise with a memory, in that of the motion, from which it is no noise of a measurement:
of what no law explains, the motion itself is left."""
HARDLY_MORE = 2.0
"""Times what many kicks leave, up to which such a cause comes before them."""
AS_LITTLE = 1.1
"""Times what a cause leaves that another may leave to be as good."""
PLAIN = 0.1
"""Part of what the base leaves, up to which a uniform push that leaves as much is taken first, and
forces without a push that has the period of the swing."""


@dataclass(frozen=True)
class Decision:
    """What follows from a table.

    Attributes
    ----------
    verdict, reason : str
        Codes.
    best : Row or None
        The likeliest cause, whether it is adopted or not.
    rivals : tuple of Row
        What is not told apart from it, the likeliest first.
    is_fact : bool
        Whether the form of the best is told apart from all rivals.
    is_beside_more : bool
        Whether forces are to be found beside it: what it explains alone is no verdict on it.
    """

    verdict: str
    reason: str
    best: object = None
    is_adopted: bool = False
    rivals: tuple = ()
    is_fact: bool = False
    is_beside_more: bool = False


def decide(table, criteria=None):
    """Decide from a table alone."""
    criteria = criteria or Criteria()
    if not table.base.is_fit and not (table.p_value <= criteria.alpha and table.candidates):
        return Decision("cannot tell", "declared_model_not_fitted")
    if not math.isfinite(table.p_value):
        return Decision("cannot tell", "not_tested")
    if table.p_value > criteria.alpha:
        return _unless_swamped(table, Decision("nothing missing", "not_significant"), criteria)
    candidates = table.candidates
    # Of what no law explains that noise does not do either nothing is said but that it was seen.
    is_forced = table.forced > FORCED * criteria.noise_nats
    if not candidates:
        if table.noise_p <= criteria.alpha and not is_forced:
            told = Decision("the noise is not as assumed", "noise_explains")
            return _unless_swamped(table, told, criteria)
        return Decision("seen, not adopted", "no_candidate_fits")
    best = part_of(candidates[0], candidates, criteria)
    noise = next((row for row in candidates if row.kind == "noise"), None)
    # Of a base that has a memory, more of it is another noise only where that is likelier.
    more = SAME_MINIMUM if math.isinf(table.forced) else criteria.tie_nats
    is_near = noise is not None and (
        best.log_posterior - noise.log_posterior < criteria.noise_nats
        and noise.log_posterior > table.base.log_posterior + more
    )  # fmt: skip
    if is_near:
        told = Decision("the noise is not as assumed", "noise_explains", noise, True)
        return _unless_swamped(table, told, criteria)
    rivals = tuple(
        row for row in _comparable(table)
        if row.id != best.id and _is_rival(row, best, criteria)
    )  # fmt: skip
    # A hand moves a body in any way, and so does a kick: they are told alone where no force does
    # nearly as well.
    is_anyhow = best.code in ("untrimmed", *KICKED)
    tie = criteria.class_nats if is_anyhow else criteria.tie_nats
    tied = [
        row for row in rivals
        if (row.kind != best.kind or is_anyhow and row.code not in KICKED)
        and best.log_posterior - row.log_posterior < tie
    ]  # fmt: skip
    # Of odd noise that the base has, too, a cause is told only where it is likelier by as much,
    # and so it is where nobody can tell what it would be.
    is_odd = table.noise_p <= criteria.alpha
    needed = criteria.noise_nats if is_odd or tied else SAME_MINIMUM
    if best.log_posterior - table.base.log_posterior <= needed:
        # Who is kicked in a trap wanders as noise with a memory does: it is the same process.
        if is_odd and best.kind == "kicks" and _explains_alike(best, table.base, criteria):
            return Decision("cannot tell", "kinds_tie", best, True, rivals, False)
        if is_odd and not is_forced:
            told = Decision("the noise is not as assumed", "noise_explains")
            return _unless_swamped(table, told, criteria)
        seen = None if is_forced and best.kind == "noise" else best
        return Decision("seen, not adopted", "no_better_than_before", seen, False, rivals)
    if _is_refused(best, criteria):
        return Decision("seen, not adopted", "held_out_refuses", best, False, rivals)
    if best.is_alike and (alike := _as_good(best, candidates)):
        return Decision("cannot tell", "kinds_tie", best, True, alike, False)
    is_fact = not any(_is_near(row, best, criteria) for row in rivals)
    if (weight := _weight_before(best, table)) is not None:
        return Decision("effect adopted", "adopted", weight, True, is_beside_more=True)
    if (first := _cause_before_kicks(best, candidates)) is not None:
        return Decision("effect adopted", "adopted", first, True)
    if tied:
        return Decision("cannot tell", "kinds_tie", best, True, rivals, False)
    least = table.base.log_posterior + needed
    if (plain := _without_echo(best, candidates, table.base, least, criteria)) is not None:
        return Decision("effect adopted", "adopted", plain, True)
    return Decision("effect adopted", "adopted", best, True, rivals, is_fact)


def _weight_before(best, table):
    """The uniform push that explains nearly all that others explain; None without one.

    Everything on Earth has weight. Where that leaves little, another force that fits the tracks
    better still is what is asked for beside it, and not in its place; nor are sums of several.
    Forces between bodies that are seen need no such stand-in.
    """
    is_plain = best.n_pushes and best.n_terms - best.n_pushes < 2
    # A number of a declared law that is another is no force that stands in for one.
    is_law = best.kind == "hidden_body" or (best.kind == "force" and best.n_terms > 0)
    if is_plain or not is_law or best.is_of_pairs:
        return None
    return next(
        (row for row in table.candidates if row.code == "law" and row.n_pushes == row.n_terms > 0
         and row.left < PLAIN * table.base.left), None
    )  # fmt: skip


def _as_good(best, candidates):
    """Causes of other kinds that foresee the motion and leave as little, tuple of Row."""
    return tuple(
        row for row in candidates
        if row.kind in FORESEEING and row.kind != best.kind and row.left < AS_LITTLE * best.left
    )  # fmt: skip


def _cause_before_kicks(best, candidates):
    """The likeliest cause that leaves not much more than many kicks do; None without one.

    Enough kicks follow any track: what a planet that nobody sees does to a comet is none of them.
    """
    if best.n_kicks <= MOST_CAUSES:
        return None
    return next(
        (row for row in candidates if row.kind in FORESEEING and not row.n_kicks
         and row.left < HARDLY_MORE * best.left), None
    )  # fmt: skip


def _without_echo(best, candidates, base, least, criteria):
    """The likeliest forces that leave little, where a sum with an echo in it leaves less; or None.

    A push with the period of the swing is the first harmonic of whatever the law has otherwise,
    such as friction. It is asked for beside these, which must be likelier than `least` themselves.
    """
    if not best.is_echo:
        return None
    return next(
        (row for row in candidates if row.kind == best.kind and not row.is_echo
         and row.left < PLAIN * base.left and row.log_posterior > least
         and not _is_refused(row, criteria)), None
    )  # fmt: skip


def _unless_swamped(table, decision, criteria):
    """A decision that all is noise, unless such noise is about as large as the motion.

    Such noise is one account of the motion; a cause that is as likely is another.
    """
    if not table.swamped > SWAMPED:
        return decision
    least = table.base.log_posterior - criteria.noise_nats
    likely = (row for row in table.candidates if row.log_posterior > least)
    cause = next((row for row in likely if row.kind in FORESEEING), None)
    return Decision("cannot tell", "kinds_tie" if cause else "swamped", cause)


def share_of_listed(table, best):
    """Probability of a row beside what nobody lists, and the likeliest of those rows or None.

    Parameters
    ----------
    table : HypothesisTable
        With such rows, see `HypothesisTable.beside`.
    best : Row
    """
    rows = [row for row in table.rows if row.status == "linearised"]
    odds = [row.log_posterior - best.log_posterior for row in rows]
    top = max(odds, default=-math.inf)
    share = 1.0 / (1.0 + sum(math.exp(min(each, 700.0)) for each in odds))
    return share, next((r for r, o in zip(rows, odds, strict=True) if o == top), None)


def _comparable(table):
    rows = [r for r in table.rows[1:] if r.is_fit or r.status == "scored"]
    return sorted(rows, key=lambda r: -r.log_posterior)


def _is_rival(row, best, criteria):
    likely = best.log_posterior - row.log_posterior < criteria.class_nats
    # What is unlikely beforehand, and explains the data as well, is not ruled out either.
    equal = best.log_evidence - row.log_evidence < 2 * criteria.tie_nats
    # Nor is a cause of another kind that makes the same track with a number more.
    same = row.code != best.code and row.n_free <= best.n_free + 1
    same = same and abs(_apart(best, row)) < 2 * criteria.tie_nats
    # Nor a way in which an unseen body moves, whatever the speeds that it may have beforehand.
    same = same or row.code == best.code == "hidden_body"
    return _apart(best, row) < criteria.separation and (likely or equal or same)


def _is_near(row, best, criteria):
    """Whether a rival keeps the best from being a fact; one that is wider does where it is better.

    A wide form of no more numbers is as good a form as any.
    """
    if row.is_wide and row.n_free > best.n_free:
        return _apart(best, row) < -2 * criteria.tie_nats
    return abs(_apart(best, row)) < criteria.separation


def _explains_alike(row, base, criteria):
    """Whether a row explains the data as well as what it extends, whatever is likelier before."""
    return row.log_evidence - base.log_evidence > -criteria.tie_nats


def _apart(best, row):
    """Chi-squared by which a row fits the tracks worse than the best."""
    return 2 * (best.log_likelihood - row.log_likelihood)


def _is_refused(best, criteria):
    """Whether scenes that were left out speak against the best."""
    held_out = best.held_out
    if not held_out.gain == held_out.gain:  # nan: none were left out
        return False
    return held_out.gain + 2 * held_out.se < criteria.promise * held_out.promised
