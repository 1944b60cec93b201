"""The codes and numbers of a closed loop in the words and records that pages are made of."""

from __future__ import annotations

import math
from types import SimpleNamespace

from bsp_gp.closing.outcome import LoopReport
from bsp_gp.report.naming import describe
from bsp_gp.report.numbers import format_number, is_number

__all__ = ["page_of"]

_CAUSES = {
    "exponent": "another exponent", "number": "another number", "period": "a period",
    "scale": "a wrong scale of lengths", "clock": "a clock that runs wrong",
    "tilt": "a camera that is turned", "slant": "a picture plane that is tilted",
    "drift": "a camera that drifts", "offset": "an origin that is off",
    "delay": "a delay of one body", "exposure": "an exposure that blurs",
    "lens": "a lens that distorts", "perspective": "perspective",
    "swapped_tracks": "tracks that are swapped", "lost_track": "a track that is lost",
    "bad_row": "a bad row", "hidden_body": "an unseen body", "contact": "a contact",
    "noise": "noise that is not as assumed",
}  # fmt: skip
_REASONS = {
    "adopted": "it is significant, likelier than all else, and borne out by scenes left out",
    "not_significant": "noise alone shows as much as the best of everything that was tried",
    "no_better_than_before": "it is no likelier than the model without it",
    "kinds_tie": "a cause of another kind is as likely",
    "held_out_refuses": "scenes that were left out do not gain what it promises",
    "no_candidate_fits": "nothing that was tried could be fitted",
    "not_tested": "what is left could not be tested",
    "declared_model_not_fitted": "the declared model could not be fitted to the tracks",
    "noise_explains": "the noise is not as assumed, and explains it",
    "time_is_up": "the time was up before everything was looked at",
    "superseded": "what was found later made it superfluous",
}
_STOPS = {
    "nothing_left": "nothing is left above the noise",
    "nothing_adopted": "nothing more was good enough to adopt",
    "most_rounds": "the limit of rounds was reached; more may be left",
    "time_is_up": "the time was up",
    "failed": "the declared model could not be fitted",
}
_LEFT_OUT = {
    "proposers": "some kinds of causes were not looked for",
    "fits": "some causes were not fitted",
    "removal": "what became superfluous was not taken back",
    "intervals": "neither the noise floor nor all intervals were found out",
}  # fmt: skip
_METHODS = {
    "parametric": "simulated copies of the held-out scenes, of which there are fewer than five",
    "resampled": "resampling whole held-out scenes", "none": "",
}  # fmt: skip
_TOLD = 20
"""Hypotheses of a round that a page lists."""


def page_of(report):
    """A report as pages read it; what is one already is given back.

    Parameters
    ----------
    report : LoopReport

    Returns
    -------
    SimpleNamespace
    """
    if not isinstance(report, LoopReport):
        return report
    rounds = [_round(done, report) for done in report.rounds]
    kept = (
        "dataset", "declared", "grammar", "seed", "alpha", "noise", "law_text", "law_latex",
        "constants", "verdict", "versions", "wall_s", "overlays", "residuals",
    )  # fmt: skip
    total = {**report.total, "ratio": _ratio(report.total["ratio"])}
    return SimpleNamespace(
        **{name: getattr(report, name) for name in kept},
        total=total, rounds=rounds, stop_reason=_STOPS[report.stop_reason],
        notes=tuple(_notes(report)), extras=(),
        corrections=tuple(
            {"name": r.effect.name, "text": r.effect.law, "kind": r.effect.kind}
            for r in rounds
            if r.adopted and r.effect.kind in ("measurement", "hidden_body")
        ),
    )  # fmt: skip


def _ratio(ratio):
    return SimpleNamespace(
        value=ratio.value, low=ratio.low, high=ratio.high, method=_METHODS[ratio.method]
    )


def _notes(report):
    """What a reader must know."""
    if report.left_out:
        listed = "; ".join(_LEFT_OUT[code] for code in report.left_out)
        yield f"the run was ended by its time limit: {listed}"
    last = report.rounds[-1]
    if any(r.adopted for r in report.rounds) and last.verdict == "seen, not adopted":
        yield (
            "what was adopted still leaves more than noise: its form and constants hold for this "
            "recording and are no discovery about nature"
        )
    yield from report.dataset["notes"]
    if report.dataset["split"]:
        yield report.dataset["split"]
    symbols = report.dataset["symbols"]
    if symbols:
        listed = ", ".join(f"{v} stands for {k}" for k, v in symbols.items())
        yield f"not calibrated: {listed}; constants are in the data's own units"
    if report.noise["source"] == "estimated":
        yield f"the noise was estimated {report.noise['method']}"


def _round(done, report):
    missing = _missing(done, report.alpha)
    name = "" if done.effect is None else _name(done.effect)
    tied = _tied(done) if done.reason == "kinds_tie" else ()
    return SimpleNamespace(
        number=done.number, missing=missing, missing_held_out=None,
        is_something_missing=missing.is_missing,
        effect=None if done.effect is None else _effect(done.effect, name, tied),
        rivals=(), hypotheses=_hypotheses(done), n_hypotheses=len(done.hypotheses),
        adopted=done.adopted or done.reason == "superseded",
        removed=_REASONS["superseded"] if done.reason == "superseded" else "",
        reason=_sentence(_REASONS[done.reason]), verdict=done.verdict, undecided=tied,
        significance="", before=done.before, after=done.after, floor=done.floor,
        ratio=done.ratio, ratios={"rollout_rmse": done.ratio}, held_out=done.held_out,
        certificate=done.certificate, seconds=done.seconds, trace=None, guidance=None,
        noise_memory=0.0,
    )  # fmt: skip


def _missing(done, alpha):
    missing = done.missing
    is_failed = not is_number(missing.p_value)
    return SimpleNamespace(
        statistic=missing.statistic, p_value=missing.p_value, tests={}, durbin_watson=math.nan,
        is_missing=not is_failed and missing.p_value <= alpha, is_failed=is_failed,
        detectable=missing.detectable, detectable_unit=missing.unit, detectable_force=math.nan,
        detectable_force_unit="", detectable_share=math.nan,
    )  # fmt: skip


def _name(effect):
    """What was found, in plain words."""
    if effect.formula is not None:
        value = next((c.value for c in effect.constants if is_number(c.value)), None)
        return describe(effect.formula, value)
    if effect.kind == "declared_term_change":
        return effect.name
    return _CAUSES.get(effect.code, effect.name)


def _effect(effect, name, tied):
    return SimpleNamespace(
        name=name, kind=effect.kind, law=effect.law or effect.name, latex=effect.latex,
        entities=effect.entities, constants=effect.constants, p_value=effect.p_value,
        probability=effect.probability, is_fact=effect.is_fact,
        equivalents=tied or effect.equivalents, separated_by="", n_unnamed=0, details={},
    )  # fmt: skip


def _tied(done):
    """Causes of another kind that are as likely."""
    best = done.effect
    rows = sorted(done.hypotheses, key=lambda row: -(row["probability"] or 0.0))
    others = [row for row in rows if row["code"] not in (best.code, "base")]
    return tuple(dict.fromkeys(_CAUSES.get(row["code"], row["law"]) for row in others[:2]))


def _hypotheses(done):
    """The likeliest rows of the table, as texts."""
    rows = sorted(done.hypotheses, key=lambda row: -_finite(row["probability"]))
    out = []
    for row in rows[:_TOLD]:
        gain, promised = row["held_out"]["gain"], row["held_out"]["promised"]
        held_out = f"{format_number(gain)} of {format_number(promised)}" if is_number(gain) else "–"
        out.append({
            "law": row["law"] or "as it was", "code": row["code"], "status": row["status"],
            "evidence": format_number(row["log_evidence"], 5), "held_out": held_out,
            "probability": format_number(row["probability"], 2),
        })  # fmt: skip
    return out


def _finite(value):
    return value if is_number(value) else 0.0


def _sentence(text):
    return text[:1].upper() + text[1:]
