"""Causes that make predictions worse are refused, whatever they explain.

In their place comes the likeliest that makes them better, if one does. Where something is left
beside them, the last ones that make predictions no better are refused as well.
"""

import math
from dataclasses import replace

import numpy as np
from scipy import special, stats

from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import TrackNoise
from bsp_gp.loop.accounts import Accounts
from bsp_gp.loop.criteria import FORESEEING, KICKED
from bsp_gp.loop.proposal import FAULTS, continued

N_COPIES = 40
"""Simulated copies of the held-out scenes that say whether predictions are surely worse."""
LEVEL = 0.01
"""At which they are: causes of which predictions hardly depend are many."""
WIDER = special.ndtri(LEVEL) / special.ndtri(0.05)
WORSE = 1.01
"""Ratio of errors up to which predictions are as before: a thrust that is over when they begin
changes nothing of them but rounding."""
NOTABLE = 1.25
"""Ratio of errors from which predictions are worse where its interval, from 5 to 95 %, excludes 1:
what is so little foreseen is not worth what it explains."""
NO_BETTER = 0.95
"""Ratio of errors above which predictions are no better: a law beside which something is left is
worth what it foresees."""
HARDLY = 2.0
"""Root mean square of what a cause changes of predictions, in noise of a row, below which what was
held out hardly shows it."""
KEPT, SURELY = 0.9, 5.0
"""Part of its promise that a cause keeps for scenes which are left out in turn, and standard errors
of that, by which it is foreseen."""
MOST_INSTEAD = 6
"""Causes that are asked in the place of one that is refused."""
INSTEAD = 0.5
"""Times the error before, below which a cause is told in the place of one that is refused: such a
one only describes the tracks, and what leaves most of the error does not describe them."""
BEYOND = 1.5
"""Times the error that noise makes, above which it is asked whether a law holds there."""


class Foresight:
    """What causes do to predictions of held-out rows, each asked once.

    Parameters
    ----------
    refitted : callable
        ``refitted(fit, hypothesis)`` gives a fit as it would be without the held-out rows.
    scenes : sequence of Scene
        Held out.
    streams : sequence of numpy.random.Generator
        One for each round there may be.
    crew : Crew, optional
        By whom scenes are scored.
    kept : dict, optional
        Of `Accounts`.
    """

    def __init__(self, refitted, dataset, scenes, streams, crew=None, kept=None):
        self._refitted, self._dataset, self._scenes = refitted, dataset, scenes
        self._streams, self._crew, self._kept = streams, crew, {} if kept is None else kept
        self._known = {}

    def refuses(self, done, last=None):
        """Whether the cause that a round adopts surely makes predictions worse.

        Parameters
        ----------
        done : Round
        last : Round, optional
            Up to which causes are asked for together; that round.
        """
        return self._of(done, last or done)[0]

    def helps(self, done, last=None):
        """Whether it makes them better, or explains what no law foresees."""
        return self._of(done, last or done)[1]

    def instead(self, done, criteria):
        """The round with another cause, where predictions are no better with the one it adopts.

        It adopts the likeliest of those with which predictions surely are off by half as much, as a
        law that describes the tracks: one that does so better is refused by what was held out
        alone. The likeliest of every number of constants are asked first: with all of those that
        are likelier the same may be too much. Noise foresees nothing: causes that are as likely
        are asked as well. In the sky only bodies come in question, and no push along an axis. The
        round as it is where there is none.

        Parameters
        ----------
        done : Round
            That adopts something.
        criteria : Criteria
        """
        base, refused = done.table.base, done.decision.best
        is_noise = refused.kind == "noise"
        if not is_noise and not self.refuses(done) and (self.helps(done) or not foresees(refused)):
            return done
        others = [
            row for row in done.table.candidates
            if row.id != refused.id and foresees(row) and row.id in done.fits
            and row.log_posterior - base.log_posterior > criteria.noise_nats
            and not (is_noise and refused.log_posterior - row.log_posterior > criteria.noise_nats)
            and (not is_of_the_sky(self._dataset) or _is_pull(row, done.proposals[row.id]))
        ]  # fmt: skip
        firsts = {row.n_free: row for row in reversed(others)}
        others.sort(key=lambda row: firsts[row.n_free] is not row)
        for row in others[:MOST_INSTEAD]:
            rivals = (refused, *(r for r in done.decision.rivals if r.id != row.id))
            decision = replace(
                done.decision, verdict="effective law", best=row, rivals=rivals, is_fact=False,
                reason="noise_likelier" if is_noise else "likelier_refused",
            )  # fmt: skip
            other = replace(done, decision=decision)
            if self._is_much_better(other):
                return other
        return done

    def _is_much_better(self, done):
        """Whether predictions surely get much better with the cause that a round adopts."""
        accounts = self._accounts(done, done)
        if not accounts(0).ratio(0, 1).value < INSTEAD:
            return False
        if self.refuses(done) or not self.helps(done):
            return False
        return accounts(N_COPIES).ratio(0, 1).high < INSTEAD

    def _of(self, done, last):
        asked = tuple((each.number, each.decision.best.id) for each in (done, last))
        if asked not in self._known:
            self._known[asked] = self._asked(done, last)
        return self._known[asked]

    def _accounts(self, done, last):
        """``accounts(n_copies)`` of the fits before a round and after one."""
        pair = [
            self._refitted(done.entering, done.hypotheses[0]),
            self._refitted(last.after, last.continuing),
        ]
        seeds = self._streams[done.number - 1].bit_generator.seed_seq
        key = (*seeds.spawn_key, done.decision.best.id)

        def accounts(n_copies):
            # Whatever was asked before, and in whatever order.
            stream = np.random.default_rng(np.random.SeedSequence(seeds.entropy, spawn_key=key))
            return Accounts(
                pair, self._dataset, self._scenes, stream, n_copies, self._crew, self._kept
            )

        return accounts

    def _asked(self, done, last):
        accounts = self._accounts(done, last)
        plain = accounts(0)
        if done.entering.is_failed:  # it foresees nothing: what it was left at has seen all rows
            return False, math.isfinite(plain.errors(1).rollout_rmse)
        if done.decision.best.kind == "noise":  # no cause: rows are weighed otherwise
            return False, True
        ratio = plain.ratio(0, 1).value
        # Only where predictions are worse does it matter whether that is chance.
        is_worse = ratio > WORSE and _is_surely_worse(accounts(N_COPIES))
        if is_worse or _runs_away(plain):
            return True, False
        if not ratio > NO_BETTER:
            return False, True
        if last is done and is_foreseen(done.decision.best) and _is_hardly_shown(plain):
            return False, True
        return False, ratio < 1.0 and _is_better_in_noise(accounts(N_COPIES))


def _is_pull(row, proposal):
    """Whether a cause is what moves bodies in the sky: other bodies, seen or not."""
    return row.kind == "hidden_body" or all("p_j" in form.inputs for form in proposal.formulas)


def that_foresee(rounds, foresight):
    """Rounds up to the first whose cause surely makes predictions of held-out rows worse.

    Where something is left in the end, the last causes that make them no better go as well.

    Returns
    -------
    list of Round
        The first round of a cause that is refused adopts nothing, and those after it are gone.
    """
    helps, adopted = [], [done for done in rounds if done.decision.is_adopted]
    for k, done in enumerate(rounds):
        if not done.decision.is_adopted:
            break
        # What was judged beside forces that were not known yet foresees nothing without them.
        last = adopted[-1] if done.is_beside_more else done
        if foresight.refuses(done, last):
            rounds = [*rounds[:k], _refused(done, "predictions_worse")]
            break
        helps.append(foresight.helps(done, last))
    verdict = rounds[-1].decision.verdict
    if verdict == "nothing missing":
        return list(rounds)
    # Odd noise that is left may be what a cause was made of that is one of many.
    return _that_help(rounds, helps, is_noise=verdict == "the noise is not as assumed")


def is_refuted(found, hypothesis, accounts, whole, deadline=None):
    """Whether what was held out does not follow a law within the noise, whatever its numbers.

    All scenes are fitted together under the noise of those that the law was found in: what the
    others add to chi-squared is compared with what these leave.

    Parameters
    ----------
    found : Fit
        The final law, to the scenes that it was found in.
    accounts : Accounts
        Errors of its predictions are the last there.
    whole : callable
        ``whole()`` gives the Dataset of all scenes, as fits take them.
    deadline : float, optional
        Seconds.
    """
    error, floor = accounts.errors(-1).rollout_rmse, accounts.floor.rollout_rmse
    if found.is_failed or not error > BEYOND * floor:
        return False
    noise = replace(found.noise, sources=("declared",) * len(found.noise.levels))
    try:
        every = fit(continued(hypothesis, found) + TrackNoise(noise), whole(), deadline=deadline)
    except FAULTS:
        return False
    more = every.n_rows - every.n_free - (found.n_rows - found.n_free)
    if every.is_failed or more < 1:
        return False
    left = (every.chisqr - found.chisqr) / more / max(found.chi2_red, 1.0)
    return bool(stats.f.sf(left, more, found.n_rows - found.n_free) < LEVEL)


def _is_better_in_noise(accounts):
    """Whether predictions that noise keeps from being much better surely are better."""
    floor, ratio = accounts.floor.rollout_rmse, accounts.ratio(0, 1)
    has_room = not math.isfinite(floor) or NO_BETTER * accounts.errors(0).rollout_rmse > floor
    return not has_room and ratio.high < 1.0


def is_foreseen(cause):
    """Whether each scene that it was found in is foreseen by the others as well as was promised.

    Where what was held out hardly shows it that is what predictions say of it: gliders that have
    met before the last rows tell nothing there of how they meet.
    """
    gain, se, promised = (getattr(cause.held_out, name) for name in ("gain", "se", "promised"))
    return gain > KEPT * promised > 0 and gain > SURELY * se


def _is_hardly_shown(accounts):
    """Whether what a cause changes of predictions is no more than the noise of held-out rows."""
    apart = [
        (after["foreseen"] - before["foreseen"])[after["n_initial"] :] / np.array(accounts.scatter)
        for before, after in zip(*accounts.rows, strict=True)
    ]
    seen = np.concatenate([rows[np.isfinite(rows)] for rows in apart] or [np.zeros(0)])
    return bool(len(seen)) and float(np.sqrt(np.mean(np.square(seen)))) < HARDLY


def _that_help(rounds, helps, is_noise=False):
    """Rounds up to the last that adopts what predictions are better with, or what is a fact."""
    kept = list(rounds)
    for k in reversed(range(len(helps))):
        if not foresees(rounds[k].decision.best):
            continue  # a kick beside a force that helps nothing says nothing for that
        if helps[k] or (is_noise and rounds[k].decision.is_fact):
            break
        kept = [*rounds[:k], _refused(rounds[k], "predictions_no_better")]
    return kept


def foresees(cause):
    """Whether a cause says what held-out rows show: not a kick, which was at its instant."""
    return cause.kind in FORESEEING and cause.code not in KICKED


def _runs_away(accounts):
    """Whether tracks that were foreseen before run away with the cause."""
    before, after = (accounts.errors(k).rollout_rmse for k in (0, 1))
    return math.isfinite(before) and bool(accounts.rows[1]) and not math.isfinite(after)


def _refused(done, reason):
    decision = replace(
        done.decision, verdict="seen, not adopted", reason=reason, is_adopted=False, is_fact=False
    )
    return replace(done, decision=decision)


def _is_surely_worse(accounts):
    """Whether a ratio of errors is above 1 at that level, or notably and at that of its interval.

    Not where the last error is one that noise makes of the predictions of any law: of what it is on
    a few held-out scenes, some is taken for a misfit that the next ones would show. Where few are
    held out, and the law cannot follow them from any state, it is.
    """
    ratio = accounts.ratio(0, 1)
    if accounts.is_parametric and not accounts.copies:
        return True
    if accounts.errors(1).rollout_rmse <= accounts.noisiest:
        return False
    if not (math.isfinite(ratio.low) and ratio.low > 0):
        return False
    is_notable = ratio.value > NOTABLE and ratio.low > 1
    return is_notable or math.log(ratio.value) + WIDER * math.log(ratio.low / ratio.value) > 0
