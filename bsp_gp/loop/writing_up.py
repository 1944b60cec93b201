"""From rounds to a report: what is told of each, of the data, and of the tracks held out."""

import hashlib
import math
from collections import Counter
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from itertools import takewhile

import numpy as np

from bsp_gp.data.ephemeris import DAY_S
from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.fitting.estimates import ConstantEstimate
from bsp_gp.fitting.held_out import regression_of
from bsp_gp.fitting.law_fit import constant_estimates, is_misfit
from bsp_gp.fitting.parts.contacts import Kick
from bsp_gp.fitting.parts.hidden import HiddenSource
from bsp_gp.fitting.parts.orbits import Orbit
from bsp_gp.fitting.periodogram import is_of_swing, longest, rates_in
from bsp_gp.fitting.starts import roles_of
from bsp_gp.language.formula import Call, Input, Number, factors, walk
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.accounts import Ratio
from bsp_gp.loop.aliases import has_alias
from bsp_gp.loop.constancy import Z_90, Constancy, powers_beside
from bsp_gp.loop.criteria import CHANGES, FORESEEING, KICKED
from bsp_gp.loop.decide import share_of_listed
from bsp_gp.loop.foresight import NO_BETTER, NOTABLE, foresees
from bsp_gp.loop.outcome import Effect, Missing, Overlay, RoundRecord, is_open, law_record
from bsp_gp.loop.proposal import is_turning
from bsp_gp.loop.proposers.exponents import base_of
from bsp_gp.loop.proposers.orbits import SIDEREAL_DAY
from bsp_gp.loop.proposers.priors import AXES
from bsp_gp.loop.slight import MOST_CAUSES, noise_size, size_left
from bsp_gp.physics.bodies import input_types_of
from bsp_gp.physics.force import split_linear
from bsp_gp.units import ACCELERATION, DIMENSIONLESS, FORCE

HEAVIEST = 10
"""How many times all others a body weighs that is named as the one that acts."""
UNLISTED = {"varying_strength": "strength_varies", "free_force": "force_beside"}
"""Why a law only describes the tracks, by what nobody lists and is likelier than it alone."""
DESCRIBES = {
    *UNLISTED.values(), "held_out_disagrees", "many_causes", "own_period", "few_periods",
    "likelier_refused", "noise_likelier", "at_bound", "much_left", "more_left", "laboratory",
    "poorly_foreseen", "smooth_kicks", "open_powers", "another_power", "odd_power", "season",
    "alias", "passage", "undetermined", "bred",
}  # fmt: skip
"""Why a law only describes the tracks."""
MUCH, SURE_SNR = 0.3, 100.0
"""Part of what the declared law leaves from which much is left, and its signal-to-noise ratio."""
MORE, MORE_SNR = 0.1, 10.0
"""The same of what is surely more than noise, less the noise."""
FEWEST_PERIODS = 2
"""That a recording must have of what comes back in time: one wave is as good as any curve."""
SEASONS, AS_LONG = (365.25 * DAY_S, 182.625 * DAY_S, DAY_S, SIDEREAL_DAY), 0.03
"""The year of the Earth, half of it and its days, s, and by which part a period is as long."""
PACKAGES = ("bsp_gp", "numpy", "scipy", "pandas", "deap")
MOST_OVERLAYS = 12
TAIL = 0.05
MOST_UNTOLD = 2
"""Forces found at once, up to which the powers of each may be open to a neighbour."""
SURELY, NOTABLY = 4.0, 0.1
"""Errors by which a power must be off what a law has for it to be another for sure, and by how
much at least."""
BLIND = 2.0
"""Times the errors of the declared law that those of a final one may be as large as, from which
predictions that are no better say nothing for it."""
LEAST_LIKELY = 1e-4
"""Rows less likely are told without their constants."""


def record_of(
    done, scored, accounts, dataset, bounds, is_removed, constancy, criteria, doubt="",
    restated=None,
):  # fmt: skip
    """The record of a round.

    Parameters
    ----------
    done : Round
    scored : tuple of int or None
        Which fits of the accounts entered the round, and came out of it (None: none).
    dataset : Dataset
        Training scenes.
    bounds : dict
    is_removed : bool
        Whether backward removal has taken back what it adopted.
    constancy : Constancy or None
        Of the final law; None where there was no time to ask.
    doubt : str
        Why the final law only describes the tracks, of `DESCRIBES`, or "".
    restated : Restated or None
        How what it found is told beside what later rounds found.
    """
    decision, (before, after) = done.decision, scored
    verdict, reason = decision.verdict, decision.reason
    effect, table, unlisted = _judged(done, dataset, bounds, constancy, criteria)
    effect = effect if restated is None else _restated(effect, done, restated, dataset, bounds)
    if is_removed:
        verdict, reason = "seen, not adopted", "superseded"
    elif verdict == "effect adopted" and effect.varies_with:
        verdict, reason = "effective law", "strength_varies"
    elif verdict == "effect adopted" and unlisted is not None:
        verdict, reason = "effective law", UNLISTED[unlisted.code]
    elif verdict == "effect adopted" and doubt and decision.best.kind in FORESEEING:
        verdict, reason = "effective law", doubt
    elif verdict == "effect adopted" and (other := _own_doubt(done, effect, dataset)):
        verdict, reason = "effective law", other
    return RoundRecord(
        number=done.number,
        missing=Missing(
            done.entering.chi2_red, done.table.p_value, done.detectable,
            dataset.units.text(ACCELERATION),
        ),
        effect=effect,
        hypotheses=tuple(_hypothesis(row, done) for row in table.rows),
        adopted=decision.is_adopted and not is_removed,
        verdict=verdict,
        reason=reason,
        before=accounts.errors(before),
        after=None if after is None else accounts.errors(after),
        floor=accounts.told_floor,
        ratio=Ratio() if after is None else accounts.ratio(before, after),
        held_out=() if after is None else tuple(accounts.by_scene(before, after)),
        varies_with=tuple(done.varies_with),
        noise_findings=tuple(asdict(finding) for finding in done.noise_findings),
        hidden_bound=bound_of(done.hidden_bound, dataset.units),
        certificate="\n".join(f.certificate for f in done.families if f.certificate),
        seconds=done.seconds,
        trace=done.trace,
    )  # fmt: skip


def _own_doubt(done, effect, dataset):
    """Why what a round adopted only describes the tracks, by itself; "" where nothing says so."""
    best = done.decision.best
    if getattr(done.proposals[best.id], "is_smooth", False):
        return "smooth_kicks"
    if best.code in KICKED and is_of_the_sky(dataset):
        return "passage"
    is_series = len({e["term"] for e in effect.exponents if is_open(e)}) > 1
    if is_series or len({e["term"] for e in effect.exponents if not e["is_told"]}) > MOST_UNTOLD:
        return "open_powers"
    if best.code == "shape" and any(map(has_inside, done.proposals[best.id].formulas)):
        return "bred"
    if any(map(_is_another, effect.exponents)):
        return "another_power"
    if effect.law and _is_undetermined(effect, done.fits[best.id].law):
        return "undetermined"
    return "odd_power" if best.n_pushes and has_odd_power(done.fits[best.id]) else ""


def has_inside(formula):
    """Whether a term has constants beside its strength."""
    return bool(split_linear(formula)[1].constants)


def _is_undetermined(effect, law):
    """Whether each strength of the forces that a round has added may be nothing."""
    strengths = {split_linear(term.formula)[0] for term in law.terms}
    own = [c for c in effect.constants if c.name in strengths]
    return bool(own) and all(c.low < 0 < c.high for c in own)


def _is_another(exponent):
    """Whether a power, as an effect has it, is surely another than the law has."""
    error = (exponent["high"] - exponent["low"]) / (2 * Z_90)
    return abs(exponent["value"] - exponent["stated"]) > max(SURELY * error, NOTABLY)


def has_odd_power(found):
    """Whether a fitted power in the law of a fit is surely no multiple of a half."""
    roles = roles_of(found.law)
    for (name, _), value, error in zip(found.parameters, found.values, found.errors, strict=True):
        if roles.get(name) == "exponent" and abs(value - round(2 * value) / 2) > Z_90 * error:
            return True
    return False


def is_many(rounds, removed):
    """Whether rounds have added more forces, and what else moves bodies, than may be missing.

    Parameters
    ----------
    removed : collection of int
        Numbers of rounds whose causes were taken back.
    """
    kept = _kept(rounds, removed)
    is_series = any(r.proposals[r.decision.best.id].is_series for r in kept)
    return is_series or n_causes(rounds, removed) > MOST_CAUSES


def n_causes(rounds, removed=()):
    """How many forces, and what else moves bodies, rounds have added.

    Parameters
    ----------
    removed : collection of int
        Numbers of rounds whose causes were taken back.
    """
    adopted = _kept(rounds, removed)
    causes = [
        max(len(set(map(_kind_of, r.proposals[r.decision.best.id].formulas))), 1)
        for r in adopted
        if foresees(r.decision.best)
    ]
    # Someone may have kicked a ball now and then; what is kicked all the time is pushed.
    of_kicks = (r for r in adopted if r.decision.best.code in KICKED)
    parts = (p for r in of_kicks for p in r.hypotheses[r.decision.best.id].parts)
    kicks = {p.mark: (p.scene, p.entity) for p in parts if isinstance(p, Kick)}
    return max(sum(causes), *Counter(kicks.values()).values(), 0)


def is_idle(rounds, removed, ratio):
    """Whether all that was adopted mends rows or kicks bodies, and the motion is left as it was.

    Where something is missing that nothing explains, it is no account of that.

    Parameters
    ----------
    removed : collection of int
        Numbers of rounds whose causes were taken back.
    ratio : Ratio
        Of the errors of predictions.
    """
    found = [r.decision.best for r in _kept(rounds, removed)]
    end = rounds[-1].decision
    is_open = end.verdict in ("seen, not adopted", "cannot tell") and not end.is_adopted
    # A memory of the noise is an account, unless it is as large as the motion, or what might be
    # beside it was not looked for.
    is_tied = end.reason == "kinds_tie"
    is_none = end.reason == "swamped" or is_tied or rounds[-1].left_out
    moving = ("kicks",) if is_none else ("kicks", "noise")
    moves = any(foresees(best) or best.kind in moving for best in found)
    return bool(found) and is_open and not moves and (is_tied or not ratio.value < NO_BETTER)


def _kept(rounds, removed):
    """Rounds that adopt something which was not taken back; of those of `removed` it was."""
    return [r for r in rounds if r.decision.is_adopted and r.number not in removed]


def _kind_of(formula):
    """A formula; of powers of a coordinate along its axis, and of what turns about one, the kind.

    They are one series, or components of one spin.
    """
    rest = split_linear(formula)[1]
    if is_turning(rest):
        return "spin"
    above, below = factors(rest)
    *bases, direction = (base_of(part) for part in above)
    is_axis = isinstance(direction, Input) and direction.name in AXES
    if below or not is_axis:
        return formula
    own = {"p_i", "origin", direction.name}
    return direction.name if all(base.inputs == own for base in bases) else formula


def doubt_of_sources(rounds, removed):
    """Why an unseen body that rounds have added is none for sure; "" where nothing says so.

    One whose strength may be nothing may be anywhere: what it does, a push that changes a little
    from place to place, something else does as well.
    """
    for r in _kept(rounds, removed):
        best = r.decision.best
        if best.kind != "hidden_body":
            continue
        found = r.fits[best.id]
        for part in r.hypotheses[best.id].parts:
            if isinstance(part, HiddenSource) and (part.strength, "") in found.parameters:
                k = found.parameters.index((part.strength, ""))
                if abs(found.values[k]) < Z_90 * found.errors[k]:
                    return "not_placed"
    return ""


def doubt_of_axes(rounds, removed, dataset):
    """Why forces that rounds have added in the sky are none for sure; "" where nothing says so.

    Nothing up there acts along the axes of a picture, or about a place where nothing is; only what
    has a period may, as parallax does.

    Parameters
    ----------
    removed : collection of int
        Numbers of rounds whose causes were taken back.
    dataset : Dataset
    """
    if not is_of_the_sky(dataset):
        return ""
    adopted = (r.proposals[r.decision.best.id] for r in _kept(rounds, removed))
    forces = [formula for p in adopted if p.code != "period" for formula in p.formulas]
    known = {name for term in rounds[0].entering.law.terms for name in term.formula.inputs}
    odd = {*AXES, "origin"} - known  # whoever declares a centre knows what is there
    of_places = [f for f in forces if odd & f.inputs and not _is_oblate(f)]
    return "laboratory" if of_places else ""


def _is_oblate(formula):
    """Whether it falls off as the flattening of a centre does, about an axis of its own."""
    powers = (p.args[1] for p in walk(formula) if isinstance(p, Call) and p.operator == "pow")
    return any(isinstance(power, Number) and power.value == -5 for power in powers)


def doubt_of_rest(first, last, rounds, bound, dataset, removed=()):
    """Why laws that were found are none for sure; "" where nothing says so.

    Beside which a third of the motion is left that nothing explains, they are no part of what
    moves it either: of a double pendulum that no rod could follow, forces with a period were facts.
    Where some of it surely is, and nothing that was tried explains it, they may be the nearest of
    what was tried; so may a fitted power that is none of a textbook, however little is left.

    Parameters
    ----------
    first, last : Fit
        Of the declared law, and of the final one.
    bound : HiddenBound or None
        Of what is left.
    dataset : Dataset
        Training scenes.
    removed : collection of int
        Numbers of rounds whose causes were taken back.
    """
    end = rounds[-1].decision
    if end.is_adopted or end.verdict == "nothing missing" or bound is None:
        return ""
    if not (first.shows_tracks and last.shows_tracks):
        return ""
    if bound.snr > SURE_SNR and size_left(last) > MUCH * size_left(first):
        return "much_left"
    if end.verdict != "seen, not adopted" or bound.snr < MORE_SNR:
        return ""
    kept = _kept(rounds, removed)
    is_odd = any(foresees(r.decision.best) and has_odd_power(r.fits[r.decision.best.id])
                 for r in kept)  # fmt: skip
    more = math.sqrt(max(size_left(last) ** 2 - noise_size(last, dataset) ** 2, 0.0))
    return "more_left" if is_odd or more > MORE * size_left(first) else ""


def doubt_of_bounds(rounds, removed):
    """Why the form of a force that rounds have added is none for sure; "" where nothing says so.

    A constant inside it that ends at its bound, a threshold at the end of the tracks, says that
    another form is asked for.
    """
    for r in _kept(rounds, removed):
        best = r.decision.best
        found = r.fits[best.id]
        if best.code == "orbit" and found.status == "at_bound":
            return "at_bound"
        if best.kind != "force" or found.status != "at_bound":
            continue
        bounds = {p.name: (p.low, p.high) for p in r.hypotheses[best.id].parameters}
        for formula in _new(found, r.entering):
            multiplier, _ = split_linear(formula)
            for name in (n for n in formula.constants if n in bounds and n != multiplier):
                low, high = bounds[name]
                if not low < found.law.constants[name] < high:
                    return "at_bound"
    return ""


def doubt_of_periods(rounds, removed):
    """Why a push with a period that rounds added is none for sure; "" where nothing says so."""
    for r in _kept(rounds, removed):
        found = r.fits[r.decision.best.id]
        for formula in _new(found, r.entering):
            for name in rates_in(formula):
                rate = found.law.constants[name]
                if rate * longest(found) < 2 * math.pi * FEWEST_PERIODS:
                    return "few_periods"
                is_sum = r.decision.best.n_terms > 1
                if (is_sum or r.decision.best.code == "period") and is_of_swing(rate, r.entering):
                    return "own_period"
    return ""


def doubt_of_orbits(rounds, removed, criteria):
    """Why orbits that rounds have added are none for sure; "" where nothing says so.

    Stars are looked at from the Earth: what its year, half of it or its day does to instruments
    and to when stars are seen comes back as a companion would, and one period looks like another.
    What did not come back as long as the star was looked at may be of any form, and one of several
    orbits two.
    """
    for r in _kept(rounds, removed):
        found = r.fits[r.decision.best.id]
        orbits = [part for part in found.law.frame if isinstance(part, Orbit)]
        turns = FEWEST_PERIODS if len(orbits) > 1 else 1
        for part in orbits:
            period = found.law.constants[part.names[0]]
            if part in r.entering.law.frame:
                continue
            if any(abs(period / season - 1) < AS_LONG for season in SEASONS):
                return "season"
            if period * turns > longest(found):
                return "few_periods"
            if has_alias(found, part, criteria.separation):
                return "alias"
    return ""


def _new(found, before):
    """Formulas of terms that one fit has and another has not."""
    known = {term.formula for term in before.law.terms}
    return [term.formula for term in found.law.terms if term.formula not in known]


def not_foreseen(records, ratio, accounts):
    """Records in which causes that held-out rows do not bear out are no facts.

    Few held-out rows do not refuse a law for sure. One with which the error grows notably is not
    shown to be the cause all the same, nor is one with which it does not shrink where it might be
    several times as large as it is; unless that error is what noise makes of the right law.

    Parameters
    ----------
    records : sequence of RoundRecord
    ratio : Ratio
        Of errors on what was held out, under the final law and the declared one.
    accounts : Accounts
        Errors of the final law are the last there.
    """
    says_nothing = ratio.value >= 1 and ratio.high > BLIND
    if not (ratio.value > NOTABLE or says_nothing):
        return records
    is_noise = not accounts.errors(-1).rollout_rmse > accounts.noisiest
    blind = ("kicks", "noise", "measurement")  # nobody foresees what these do
    return [
        replace(r, verdict="effective law", reason="poorly_foreseen")
        if r.verdict == "effect adopted" and r.effect.kind not in blind
        and not (is_noise and r.effect.is_fact) else r
        for r in records
    ]  # fmt: skip


def judged_together(records):
    """Records of all rounds, none of them more certain than what stands beside it.

    Beside a law that only describes the tracks, whatever else is found makes up for it; and where
    something is left that nothing explains, no form is a fact.
    """
    reasons = {r.reason for r in records if r.adopted}
    is_description = bool(reasons & DESCRIBES)
    last = records[-1]
    is_left = not last.adopted and last.verdict != "nothing missing"
    if not (is_description or is_left):
        return tuple(records)
    out = []
    for r in records:
        if r.adopted and r.effect is not None:
            r = replace(r, effect=replace(r.effect, is_fact=False))
            # What is left beside all is the business of the one whose strength varies, if one does.
            is_beside = r.reason == "force_beside" and "strength_varies" in reasons
            if is_description and r.verdict == "effect adopted" or is_beside:
                r = replace(r, verdict="effective law", reason="beside_description")
        out.append(r)
    return tuple(out)


def bound_of(bound, units):
    """What may still be hidden; None where nothing was asked."""
    if bound is None:
        return None
    return {
        "snr": bound.snr, "force": bound.force, "unit": units.text(FORCE),
        "percent": 100 * bound.share,
    }  # fmt: skip


def _hypothesis(row, done):
    """One row of a table; what was fitted shares the p-value of the selection."""
    p_value = done.table.p_value
    return {
        "id": row.id, "code": row.code, "law": row.text, "source": row.source,
        "status": row.status, "log_evidence": row.log_evidence,
        "held_out": asdict(row.held_out),
        "p_value": p_value if math.isnan(row.p_value) and row.id else row.p_value,
        "probability": row.probability, "model": _model(row, done),
    }  # fmt: skip


def _model(row, done):
    """The law of a likely row with its constants, for predictions; None of one that has no more.

    Of what was only scored the constants are those of the linear look, without errors.
    """
    is_listed = row.status != "linearised"  # what nobody lists has a number, and no hypothesis
    if not (is_listed and row.probability >= LEAST_LIKELY and row.id in done.hypotheses):
        return None
    found = done.fits.get(row.id)
    if found is None:
        law, names, covariance = done.hypotheses[row.id].law, (), ()
        starts = done.proposals[row.id].starts
        law = law.with_constants({n: v for n, v in starts.items() if n in law.names})
    else:
        law, (names, covariance) = found.law, found.uncertain
        covariance = covariance.tolist()
    return {**law_record(law), "uncertain": names, "covariance": covariance}


def _judged(done, dataset, bounds, constancy, criteria):
    """The likeliest cause of a round beside what nobody lists, that table, and what is likelier."""
    best = done.decision.best
    if best is None:
        return None, done.table, None
    known = Constancy()
    if constancy is not None and done.decision.is_adopted and best.kind != "noise":
        known = constancy.of(_added(done, done.fits[best.id]) if best.kind == "force" else ())
    table = done.table.beside(best, known.unknown, criteria)
    share, top = share_of_listed(table, best)
    unlisted = next((u for u in known.unknown if share < 0.5 and u.text == top.text), None)
    effect = _effect(done, dataset, bounds, known, criteria)
    varies = {v["variable"]: v for v in effect.varies_with}
    if unlisted is not None and unlisted.term is not None:
        one = {"term": to_text(unlisted.term), "variable": unlisted.variable, "p_value": math.nan}
        varies.setdefault(unlisted.variable, one)
    effect = replace(
        effect, varies_with=tuple(varies.values()),
        is_fact=effect.is_fact and constancy is not None and share >= criteria.sure,
        probability=next(row.probability for row in table.rows if row.id == best.id),
    )  # fmt: skip
    return effect, table, unlisted


def _effect(done, dataset, bounds, known, criteria):
    """The likeliest cause of a round, as its own table has it."""
    best, proposal = done.decision.best, done.proposals[done.decision.best.id]
    fit = done.fits[best.id]
    old = {name for name, _ in done.entering.parameters}
    added = _added(done, fit) if best.kind == "force" else ()
    others = dict.fromkeys(row.text for row in done.decision.rivals)
    shed = {c for f in _new(fit, done.entering) if added and f not in added for c in f.constants}
    gone = old | shed - {c for f in added for c in f.constants}
    # A change of strength that explains no more than one which a law may have is not asked for.
    surely = (v for v in known.varies if v.p_value <= criteria.alpha)
    varies = list(takewhile(lambda v: v.share > criteria.constant_within, surely))
    is_apart = all(e.is_as_stated(criteria) for e in known.exponents)
    sums = [done.proposals[row.id].formulas for row in done.decision.rivals]
    return Effect(
        name=best.text,
        code=best.code,
        kind=_kind(best, fit.law),
        law=" + ".join(map(to_text, added)),
        latex=" + ".join(map(to_latex, added)),
        entities=tuple(
            dict.fromkeys(s.names[k] for s in dataset.scenes for k in s.dynamic)
        ),
        constants=tuple(
            c for c in told(constant_estimates(fit, dataset, bounds), done.details, fit)
            if c.name not in gone
        ),
        p_value=done.table.p_value,
        probability=best.probability,
        equivalents=tuple(dict.fromkeys((*best.ties, *others))),
        is_fact=done.decision.is_fact and is_apart and not varies,
        exponents=tuple(_exponent(e, criteria, added, sums) for e in known.exponents),
        varies_with=tuple(
            {"term": to_text(v.term), "variable": v.variable, "p_value": v.p_value}
            for v in varies
        ),
        formula=proposal.formulas[0] if len(proposal.formulas) == 1 else None,
        details={**done.details, "p_value": done.table.p_value} if done.details else {},
    )  # fmt: skip


def _restated(effect, done, restated, dataset, bounds):
    """An effect with one number for all."""
    own = set(restated.formula.constants) - set(done.entering.law.constants)
    constants = constant_estimates(restated.fit, dataset, bounds)
    is_force = effect.kind != "declared_term_change"
    return replace(
        effect, name=restated.text, code=restated.code, law=to_text(restated.formula),
        latex=to_latex(restated.formula), constants=tuple(c for c in constants if c.name in own),
        formula=restated.formula if is_force else None,
    )


def _exponent(one, criteria, own, rivals):
    """A power as it is told: to first order, but with those of rival sums of forces within it.

    Forms that the data do not tell apart are among what they allow, and what turns back has no
    logarithm of its speed there.
    """
    known = {one.low, one.high, *powers_beside(one.of, one.term, own, rivals)}
    return {
        "term": to_text(one.term), "of": to_text(one.of), "stated": one.stated,
        "value": one.value, "low": min(known), "high": max(known),
        "is_told": one.is_as_stated(criteria),
    }  # fmt: skip


def _added(done, fit):
    """Terms that a cause has brought in or changed, without those that were shed later."""
    proposal = done.proposals.get(done.decision.best.id)
    own = proposal.formulas if proposal else ()
    added = tuple(_new(fit, done.entering))
    return tuple(f for f in added if f in own) or added


def told(constants, details, fit):
    """Constants with the intervals of the draws of a round, where they are of the same fit.

    Parameters
    ----------
    constants : tuple of ConstantEstimate
    details : dict
        Of a `Round`.
    fit : Fit
        Whose constants they are: draws count noise alone, which is not all that it may leave.
    """
    drawn, leaves_more = {}, is_misfit(fit)
    for k, name in enumerate(details.get("names", ())):
        ends = np.quantile([draw[k] for draw in details["draws"]], (TAIL, 1 - TAIL))
        drawn[name, details["best"][k]] = tuple(map(float, ends))
    out = []
    for c in constants:
        low, high = drawn.get((c.name, c.value), (c.low, c.high))
        if leaves_more:
            low, high = min(low, c.low), max(high, c.high)
        unit = details.get("units", {}).get(c.name, c.unit)
        out.append(replace(c, low=low, high=high, unit=unit))
    return (*out, *(ConstantEstimate(**c) for c in details.get("constants", ())))


def _kind(best, law):
    """What kind of thing a cause is."""
    if best.code in CHANGES:
        return "declared_term_change"
    return law.terms[-1].kind if best.kind == "force" else best.kind


_ONE_WAY = 0.98
"""Share of the span of a track between its ends where it does not turn back, but for noise."""


def about_data(dataset, split, notes):
    """What the report says of the data.

    Parameters
    ----------
    notes : tuple of str
        What was found when the data were made ready.
    """
    return {
        "name": dataset.name,
        "n_scenes": len(dataset.scenes),
        "n_rows": int(sum(np.isfinite(s.positions).all(axis=-1).sum() for s in dataset.scenes)),
        "n_entities": len({n for s in dataset.scenes for n in s.names}),
        "n_dims": dataset.n_dims,
        "train": [s.name for s in split.train],
        "test": [s.name for s in split.test],
        "split": split.told,
        "units": dict(dataset.units.declared),
        "symbols": dict(dataset.units.symbols),
        "up": dataset.up,
        "partner": _partner(dataset),
        "properties": _properties(dataset),
        "inputs": {
            name: {"unit": [*map(str, type_.unit.exponents)], "is_vector": type_.shape == "vector"}
            for name, type_ in input_types_of(dataset).items()
        },
        "way": _way(dataset),
        "provenance": dict(dataset.provenance),
        "fingerprint": dataset_digest(dataset),
        "notes": [*dataset.notes, *notes],
    }


def _properties(dataset):
    """Units of the properties that laws may name, as exponents, and which are vectors."""
    out = {}
    for name in dict.fromkeys((*dataset.property_names, "mass")):
        values = [e.properties[name] for s in dataset.scenes for e in s.entities
                  if name in e.properties]  # fmt: skip
        unit = dataset.property_units.get(name)
        out[name] = {
            "unit": [str(power) for power in (unit or DIMENSIONLESS).exponents],
            "is_vector": any(np.ndim(value) for value in values),
            "is_constant": len(set(map(repr, values))) <= 1,
        }
    return out


def _way(dataset):
    """The axis along which everything moves all the time in one direction, "x" or "-x"; or ""."""
    axes, signs = set(), set()
    for scene in dataset.scenes:
        for k in scene.dynamic:
            track = scene.positions[:, k]
            track = track[np.isfinite(track).all(axis=1)]
            spans = np.ptp(track, axis=0) if len(track) > 1 else np.zeros(dataset.n_dims)
            axes |= set(np.flatnonzero(spans).tolist())
            if len(axes) != 1:
                return ""
            (axis,) = axes
            ahead = track[-1, axis] - track[0, axis]
            signs.add(np.sign(ahead))
            if len(signs) > 1 or abs(ahead) < _ONE_WAY * spans[axis]:
                return ""
    return ("-" if signs == {-1.0} else "") + "xyz"[axes.pop()] if axes else ""


def _partner(dataset):
    """The body that acts on what moves: the only other one, or by far the heaviest; else ""."""
    entities = {e.name: e for scene in dataset.scenes for e in scene.entities}
    if len(entities) == 2 and sum(not e.is_static for e in entities.values()) == 1:
        return next(e.name for e in entities.values() if e.is_static)
    masses = {name: float(e.properties.get("mass", math.nan)) for name, e in entities.items()}
    if len(masses) < 2 or not all(map(math.isfinite, masses.values())):
        return ""
    name = max(masses, key=masses.get)
    return name if masses[name] > HEAVIEST * (sum(masses.values()) - masses[name]) else ""


def dataset_digest(dataset):
    """Fingerprint of what was measured."""
    digest = hashlib.sha256()
    for scene in dataset.scenes:
        digest.update(scene.name.encode())
        digest.update(scene.times.tobytes())
        digest.update(scene.positions.tobytes())
    return digest.hexdigest()


def versions():
    """Versions of what the numbers come from."""
    out = {}
    for package in PACKAGES:
        try:
            out[package] = version(package)
        except PackageNotFoundError:  # running from a source tree
            out[package] = "source"
    return out


def overlays(accounts, begin):
    """Held-out tracks as observed and as the declared and the last fit foresee them.

    Parameters
    ----------
    begin : int
        Which of its fits is the declared one.
    """
    out = []
    rows = zip(accounts.scenes, accounts.rows[begin], accounts.rows[-1], strict=False)
    for scene, first, last in rows:
        for r, index in enumerate(scene.dynamic):
            if len(out) < MOST_OVERLAYS:
                out.append(
                    Overlay(
                        scene.name, scene.names[index], scene.times, scene.positions[:, index],
                        first["foreseen"][:, r], last["foreseen"][:, r], first["n_initial"],
                    )
                )  # fmt: skip
    return tuple(out)


def residual_table(first, last, dataset, split):
    """Residual accelerations under two laws, row by row.

    Returns
    -------
    DataFrame or None
        scene, entity, split ("train" or "test"), t, speed, distance (to the nearest other body,
        nan if there is none), size of the residual acceleration before and after, and its part
        along the velocity. None where a law has no finite constants.
    """
    import pandas as pd

    if not (np.isfinite(first.values).all() and np.isfinite(last.values).all()):
        return None
    tables = []
    for name, scenes in (("train", split.train), ("test", split.test)):
        if scenes:
            regression = regression_of(last, dataset, scenes)
            with np.errstate(all="ignore"):  # of a law that runs away
                laws = [regression.raw_residuals(fit.law) for fit in (first, last)]
                for batch, before, after in zip(regression.batches, *laws, strict=True):
                    tables.append(pd.DataFrame(_rows(batch, before, after, name)))
    return pd.concat(tables, ignore_index=True)


def _rows(batch, before, after, split):
    """Columns of the table, track after track."""
    s, r, row = np.nonzero(np.moveaxis(batch.valid.any(axis=-1), 0, -1))
    index = np.array(batch.bodies.receivers)[r]
    v = batch.velocities[row, s, index]
    speed = np.linalg.norm(v, axis=-1)
    unit = v / np.where(speed > 0, speed, 1.0)[:, None]
    places = batch.positions[row, s]
    gaps = np.linalg.norm(places - batch.positions[row, s, index][:, None], axis=-1)
    gaps[np.arange(len(gaps)), index] = np.nan
    names = np.array(batch.bodies.names, dtype=object)
    columns = {
        "scene": np.array(batch.scene_names, dtype=object)[s], "entity": names[s, index],
        "split": split, "t": batch.times[row, s], "speed": speed,
        "distance": np.fmin.reduce(gaps, axis=1),
    }  # fmt: skip
    left = [np.nan_to_num(values[row, s, r]) for values in (before, after)]
    for name, values in zip(("before", "after"), left, strict=True):
        columns[name] = np.linalg.norm(values, axis=-1)
    for name, values in zip(("before_along", "after_along"), left, strict=True):
        columns[name] = (values * unit).sum(axis=-1)
    return columns
