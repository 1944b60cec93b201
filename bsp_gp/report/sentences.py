"""What a report says in words; the page and the terminal say the same."""

import math
import re

import numpy as np

from bsp_gp.report.codes import FINDINGS, VARIABLES
from bsp_gp.report.naming import is_beyond, is_untold, size_name
from bsp_gp.report.numbers import (
    NOT_KNOWN,
    format_constant,
    format_level,
    format_number,
    format_p,
    format_ratio,
    format_value,
    is_number,
    length_text,
    pretty_unit,
    rounded,
    with_unit,
)
from bsp_gp.units import is_speed

_METRICS = (
    ("rollout_rmse", "held-out position error"),
    ("one_step_nrmse", "held-out one-step error"),
    ("residual_acceleration", "held-out residual acceleration"),
)
_UNCALIBRATED = (
    "", "1", "px", "pixel", "pixels", "arcsec", "frame", "frames", "unit", "units", "a.u.",
)  # fmt: skip
_UNKNOWN = ("", "unknown", "none", "not known", "assumed")


def error_name(unit):
    """What errors on held-out tracks are errors of."""
    return "velocity error" if is_speed(str(unit or "")) else "position error"


def adopted_rounds(report):
    """The rounds whose effect is part of the law."""
    return [r for r in report.rounds if r.adopted and r.effect is not None and not r.removed]


def _counted(parts):
    """Parts, of which what comes again is said once."""
    parts = list(parts)
    often = {2: " (twice)"}
    return [f"{p}{often.get(n, f' ({n} times)')}" if (n := parts.count(p)) > 1 else p
            for p in dict.fromkeys(parts)]  # fmt: skip


def _joined(parts):
    parts = list(parts)
    if len(parts) < 2:
        return "".join(parts)
    return ", ".join(parts[:-1]) + " and " + parts[-1]


def _ended(text):
    """The text as a sentence: a full stop unless it has its own."""
    text = str(text).strip()
    return text if not text or text[-1] in ".!?" else text + "."


WORSE = 1.1
"""Ratio of errors on what was held out, of all or of one body, from which the adopted law is told
to foresee it worse."""
MENDED = 0.01
"""Of a ratio of errors, about one, within which mended rows have changed nothing of others."""
_DESCRIBES = "It describes these tracks, but "


def _why_it_describes(reason=""):
    """Why what was adopted only describes the tracks, for a reason that is told as a sentence."""
    reason = reason.strip().rstrip(".")
    if reason.startswith(_DESCRIBES):
        but = reason.removeprefix(_DESCRIBES)
        return f"It describes them, but {but}: that it is the cause is not shown."
    why = f": {reason[:1].lower()}{reason[1:]}" if reason else ""
    return f"It describes them; that it is the cause is not shown{why}."


def _findings(rounds):
    """What was found, effects of one kind told together."""
    groups = {}
    for r in rounds:
        usual = FINDINGS.get(r.effect.kind, "the declared model lacks {}")
        sentence = FINDINGS.get(r.effect.code, usual)
        groups.setdefault(sentence, []).append(_either(r))
    return _joined(sentence.format(_joined(_counted(names))) for sentence, names in groups.items())


def _either(round_):
    """The effect of a round, and what these data cannot tell from it that is no law."""
    names = [round_.effect.name, *round_.undecided]
    return ("; or " if any(" or " in name for name in names) else " or ").join(names)


def verdict_sentence(report):
    """The outcome of the whole run in one or two sentences."""
    return " ".join(filter(None, verdict_parts(report)))


def verdict_parts(report):
    """The outcome of the whole run in one sentence, and what belongs to it, which may be ""."""
    adopted = adopted_rounds(report)
    last = report.rounds[-1] if report.rounds else None
    if report.verdict == "effect adopted" and adopted:
        text = _findings(adopted)
        if not report.declared:
            text = text.replace("the declared model lacks", "the motion shows")
        is_force = any(r.effect.kind not in ("measurement", "noise") for r in adopted)
        is_all = not is_force and last.verdict == "nothing missing"
        detail = "No force is missing beside it." if is_all else ""
        others = [r.effect.likeliest_other for r in adopted if r.effect.likeliest_other]
        if others:
            detail = f"These data do not tell it from {others[-1]}."
        if last.verdict == "seen, not adopted":
            detail = ("More than noise is left beside it that nothing explains: it is the nearest "
                      "of all that was tried.")  # fmt: skip
        return text[:1].upper() + text[1:] + ".", detail
    if report.verdict == "effective law" and adopted:
        # How rows were taken is no force that there might be.
        forces = [r for r in adopted if r.effect.kind not in ("measurement", "noise")] or adopted
        names = _joined(_counted(map(_either, forces)))
        text = f"On these tracks the motion is as if there were {names}."
        others = _findings(r for r in adopted if r not in forces)
        told = [r.reason for r in adopted if r.verdict == report.verdict]
        detail = _why_it_describes(*told[:1])
        return text, f"{detail} {others[:1].upper()}{others[1:]}." if others else detail
    if report.verdict == "the noise is not as assumed":
        return "The noise of the measurement is not as it was assumed.", ""
    if report.verdict == "nothing missing":
        text = "Nothing is missing from the declared model: what it leaves unexplained is noise."
        return text, _detectable(last.missing) if last else ""
    if report.verdict == "seen, not adopted":
        found = [r for r in report.rounds if r.effect is not None]
        seen = [r.effect.name for r in found]
        worse = ""
        if found and _is_worse(found[-1]):
            worse = ": what was held out is foreseen worse with it than without"
        text = "The declared model leaves more than noise, but nothing was good enough to adopt."
        if adopted:
            names = _joined(_counted(map(_either, adopted)))
            text = (f"The declared model leaves more than noise, and so does what was adopted "
                    f"({names}); nothing more was good enough.")  # fmt: skip
        return text, f"The best, {seen[-1]}, was seen and not adopted{worse}." if seen else ""
    adopted = [r for r in adopted if r.verdict == "cannot tell"]
    if report.verdict == "cannot tell" and adopted:
        text = "Something is missing from the declared model, but these data cannot tell whether "
        detail = "The first of these stands in the law below, for predictions; it is no finding."
        return f"{text}it is {_joined(_either(r) for r in adopted)}.", detail
    if report.verdict == "cannot tell" and last is not None and last.undecided:
        return f"These data cannot tell whether it is {_either(last)}.", ""
    if report.verdict == "cannot tell":
        if last is not None and last.is_missing:
            text = "Something is missing from the declared model, but these data cannot tell what."
            if last.noise:  # of which nobody has seen whether it is all that is missing
                text = ("Something is missing from the declared model, or the noise is not as it "
                        "was assumed: these data cannot tell which.")  # fmt: skip
        else:
            text = "These data cannot tell whether anything is missing from the declared model."
        reason = _ended(last.reason) if last else ""
        if last is not None and last.code == "time_is_up" and last.effect is not None:
            reason += f" Of what was, {last.effect.name} explains most so far."
        return text, reason[:1].upper() + reason[1:]
    return f"Verdict: {report.verdict}.", ""


WORSE = 1.1
"""Error of predictions, in that without a cause, from which these are worse."""


def _is_worse(done):
    """Whether a round's best foresees what was held out worse than the law without it."""
    errors = [e.rollout_rmse for e in (done.before, done.after) if e is not None]
    return len(errors) == 2 and all(map(is_number, errors)) and errors[1] > WORSE * errors[0]


_SHORT = {"kg m/s^2": "N"}


def _detectable(missing):
    if not is_number(missing.detectable):
        return ""
    size = with_unit(format_number(missing.detectable, 2), missing.unit)
    return (
        f"A constant extra acceleration of {size} or more would have been seen with 95 % power; a "
        "smaller one may hide in the noise."
    )


def hidden_sentence(beside):
    """How much may still be hidden beside the final law, or the model that entered a round."""
    bound, parts = beside.bound, []
    if bound is not None and is_number(bound.force):
        share = ""
        if is_number(bound.percent) and bound.percent > 100:
            share = f" ({format_number(bound.percent / 100, 2)} times the declared force)"
        elif is_number(bound.percent):
            share = f" ({format_number(bound.percent, 2)} % of the declared force)"
        parts.append(
            f"A constant force of up to {force_text(bound)}{share} is not excluded (95 %)."
        )
    if bound is not None and is_number(bound.snr):
        snr = format_number(bound.snr, 2)
        parts.append(f"Whatever is left has a signal-to-noise ratio of {snr} at most (95 %).")
    return " ".join(parts)


def force_text(bound):
    """The force of a bound with its unit."""
    return with_unit(format_number(bound.force, 2), _SHORT.get(bound.unit, bound.unit))


def powers_sentence(round_):
    """Which powers of speed and distance the data allow in what a round found; "" if none."""
    effect, told = round_.effect, {}
    for e in effect.exponents if effect is not None else ():
        if not e["stated"] and _is_about_zero(e):
            continue  # what a law rightly lacks is not told
        size = size_name(e["of"])
        text = f"{size} to the {format_value(e['value'], e['low'], e['high'])}"
        if is_untold(e):
            low, high = (format_number(e[key], 2) for key in ("low", "high"))
            text = f"{size} to any power from {low} to {high}"
        if is_beyond(e):
            text = f"{size} to another power than is written, these data do not tell which"
        elif e["stated"] == 0:
            text = f"a further {text}, which the law has not"
        elif is_number(e["stated"]):
            text += f", written as {e['stated']:g}".replace("-", "−")
        first = re.search(r"[A-Za-z]\w*", e["term"])  # its strength, or what stands first in that
        told.setdefault(first[0] if first else e["term"], []).append(text)
    several = len(told) > 1  # then whose it is: "distance" alone would be any force's
    told = [f"in {c}, {t}" if several else t for c, texts in told.items() for t in texts]
    varies = [VARIABLES.get(v["variable"], _SIZES.get(v["variable"], v["variable"]))
              for v in (effect.varies_with if effect is not None else ())]  # fmt: skip
    parts = [f"Powers that the data allow (90 %): {'; '.join(told)}."] if told else []
    if varies:
        varies = _joined(dict.fromkeys(varies))
        parts.append(f"Its strength is not constant: it changes with {varies}.")
    return " ".join(parts)


def _is_about_zero(exponent):
    """Whether zero is within twice the interval: one in ten intervals at 90 % is beside it."""
    low, value, high = (exponent[key] for key in ("low", "value", "high"))
    return not (low > 0 or high < 0) or 2 * low - value <= 0 <= 2 * high - value


_SIZES = {
    "norm(v_i)": "speed", "norm(p_i - p_j)": "distance", "norm(v_i - v_j)": "relative speed",
}


def noise_sentence(round_):
    """What was found of the noise; "" where it is as assumed."""
    if not round_.noise:
        return ""
    return f"The noise is not quite as assumed: {_joined(dict.fromkeys(round_.noise))}."


def missing_sentence(round_, alpha):
    """Question 1 of a round: whether anything is left above the noise, with its numbers."""
    missing = round_.missing
    numbers = format_p(missing.p_value)
    if is_number(missing.statistic):
        numbers = f"{format_number(missing.statistic)} where noise alone gives 1, {numbers}"
    if round_.is_missing:
        text = f"More is left than noise explains (whitened χ² per degree of freedom {numbers})."
    elif not is_number(missing.p_value):
        return "The model could not be fitted, so that what it leaves could not be tested."
    else:
        text = f"Nothing is left above the noise (whitened χ² per degree of freedom {numbers})."
    if not is_number(missing.statistic):
        text = text.replace("whitened χ² per degree of freedom ", "")
    level = f" Tested at {format_level(alpha)}."
    # Beside what is missing, an effect would have to be as large to be seen.
    smallest = "" if round_.is_missing else _detectable(missing)
    return f"{text}{level} {smallest}".strip()


def outcome_sentence(round_):
    """How a round ended: which effect, adopted or not, and why."""
    reason = _ended(round_.reason)
    if round_.effect is None:
        return reason or "No effect was traced."
    name = round_.effect.name
    p = round_.effect.p_value
    significance = format_p(p) + (", selection included" if is_number(p) else "")
    if round_.removed:
        return f"Adopted, and taken back: {name} ({significance}). {_ended(round_.removed)}"
    if round_.adopted and round_.undecided:
        return (
            f"Taken up for predictions: {name} ({significance}). {reason} "
            f"These data cannot tell which it is: {_either(round_)}."
        )
    if round_.adopted:
        return f"Adopted: {name} ({significance}). {reason}".strip()
    return f"Seen, not adopted: {name} ({significance}). {reason}".strip()


def parting_sentence(effect):
    """The recording that parts a law from one that depends on time instead; "" where none does."""
    timed = [law for law in effect.equivalents if re.search(r"\bt\b", law)]
    if not timed or re.search(r"\bt\b", effect.law or ""):
        return ""
    return (
        f"{timed[0]} moves this body in the same way. A recording that begins at another place, or "
        "faster, tells them apart: what depends on time alone pushes as before."
    )


def overturned_by(round_):
    """What would change the verdict of a round, one sentence each."""
    effect = round_.effect
    if effect is None:
        return []
    out = [text for text in (parting_sentence(effect),) if text]
    if effect.equivalents:
        out.append(
            f"Data in which {effect.equivalents[0]} does better: these do not tell it apart, and "
            "evidence of this kind grows with the number of rows."
        )
    if round_.adopted:
        out.append(
            "A new recording whose held-out error is no smaller with it than without, or that "
            "asks for constants outside of the intervals given here: then it is no law, but "
            "something about this recording."
        )
    else:
        out.append(
            "A recording that shows more of it (longer, with less noise, with more of what it "
            "depends on) and in which it passes the test that it failed here."
        )
    return out


def headline(report):
    """The one comparison that a reader takes away.

    Returns
    -------
    dict
        label, before, after, ratio, floor (texts, `NOT_KNOWN` where there is none),
        has_after (bool), text (one line).
    """
    before, after, floor = (report.total.get(k) for k in ("before", "after", "floor"))
    known = [m for m in _METRICS if before is not None and is_number(getattr(before, m[0]))]
    metric, label = (known or _METRICS)[0]
    label = label.replace("position error", error_name(before.unit if before is not None else ""))
    is_adopted = after is not None and bool(adopted_rounds(report))
    has_after = is_adopted and is_number(getattr(after, metric))

    def size(errors):
        if errors is None:
            return NOT_KNOWN
        is_force = metric == "residual_acceleration"
        unit = errors.acceleration_unit if is_force else errors.unit
        return length_text(getattr(errors, metric), unit)

    out = {
        "label": label[:1].upper() + label[1:],
        "before": size(before),
        "after": size(after) if has_after else NOT_KNOWN,
        "ratio": format_ratio(report.total.get("ratio"))
        if has_after and metric == "rollout_rmse"
        else NOT_KNOWN,
        "floor": size(floor),
        "has_after": has_after,
    }
    text = f"{out['label']}: {out['before']}"
    if has_after:
        text += f" → {out['after']}"
        if out["ratio"] != NOT_KNOWN:
            text += f", ratio {out['ratio']}"
    else:
        text += " under the declared model"
        text += f", and {_without_error(report)}" if is_adopted else ""
    if out["floor"] != NOT_KNOWN:
        text += f"; noise floor {out['floor']}"
    out["text"] = text
    return out


def _without_error(report):
    """Why there is no error of the adopted law on what is held out."""
    after = report.total["after"]
    if after.rollout_rmse == math.inf:
        return "none under the adopted law: its tracks run away on what is held out"
    if "errors" in report.left_out:
        return "none under the adopted law: the time was up before"
    return (
        "none under the adopted law: fitted without what is held out, its constants or tracks "
        "were not found"
    )


def ratio_caution(report):
    """A warning where the gain is not certain, else ""."""
    ratio = report.total.get("ratio")
    kinds = {r.effect.kind for r in adopted_rounds(report)}
    if "kicks" in kinds:
        return "Kicks cannot be foreseen: held-out tracks are foreseen no better with them."
    if ratio is None or not kinds - {"noise"} or not is_number(ratio.value):
        return ""
    if kinds <= {"measurement", "noise"} and abs(ratio.value - 1) < MENDED:
        return ""  # what was mended is in the rows that are not held out
    if ratio.value > WORSE:
        return "Held-out data are foreseen worse with the adopted law than with the declared one."
    if ratio.value >= 1:
        return "The adopted law is no better than the declared one on the held-out data."
    if is_number(ratio.high) and ratio.high >= 1:
        return "The 90 % interval of the ratio includes 1: the gain is not certain."
    if not (is_number(ratio.low) and is_number(ratio.high)):
        return "The ratio has no interval; --bootstrap 99 asks for one."
    return ""


def worse_bodies(report):
    """Bodies whose held-out tracks the adopted law predicts worse than the declared one did."""
    if not adopted_rounds(report):
        return ""
    squares = {}
    for overlay in report.overlays:
        for k, model in enumerate((overlay.declared, overlay.adopted)):
            left = np.asarray(model, float) - np.asarray(overlay.observed, float)
            left = np.square(left[overlay.n_initial :]).sum(axis=-1)
            squares.setdefault(overlay.entity, ([], []))[k].append(left)
    told = []
    for body, both in squares.items():
        before, after = (np.concatenate(parts) for parts in both)
        both_known = np.isfinite(before) & np.isfinite(after)
        if not both_known.any():
            continue
        before, after = (float(np.sqrt(e[both_known].mean())) for e in (before, after))
        if after > WORSE * before:
            size = with_unit(format_number(after), report.total["before"].unit)
            told.append(f"{body} ({format_number(before)} → {size})")
    if not told or len(squares) == 1:
        return ""
    return f"Worse under the adopted law, position error: {_joined(told[:6])}."


def caveats(report):
    """What makes the numbers mean less than they seem to: no calibration, no known noise."""
    out = []
    before = report.total.get("before")
    unit = (before.unit if before is not None else "") or ""
    if unit.strip().lower() in _UNCALIBRATED:
        out.append(
            "Lengths are not calibrated"
            + (f" (they are in {unit})" if pretty_unit(unit) else " (no unit was declared)")
            + ": constants are in the units of the data, not in SI, and a wrong scale, a wrong "
            "clock and a wrong constant look alike."
        )
    sigma = report.noise.get("sigma")
    values = list(sigma) if hasattr(sigma, "__len__") and not isinstance(sigma, str) else [sigma]
    source = str(report.noise.get("source") or "").strip().lower()
    if not any(is_number(v) for v in values) or source in _UNKNOWN:
        out.append(
            "The noise of the measurement is not known: p-values, the noise floor and the "
            "smallest effect that would have been seen rest on an assumption."
        )
    return out


def constant_groups(constants):
    """Put constants into what is one for all and what belongs to single entities.

    Returns
    -------
    shared : list of ConstantEstimate
    own : list of (name, unit, list of ConstantEstimate)
        Sorted by value, unknown values last.
    """
    shared = [c for c in constants if not c.entity]
    own = {}
    for c in constants:
        if c.entity:
            own.setdefault((c.name, c.unit), []).append(c)

    def order(c):
        return (not is_number(c.value), c.value if is_number(c.value) else math.inf, c.entity)

    return shared, [(name, unit, sorted(group, key=order)) for (name, unit), group in own.items()]


def constant_lines(constants, most, more):
    """A line for each constant, and one of each kind that entities have of their own.

    Of more than `most` the last line is ``more`` of how many are left.
    """
    shared, own = constant_groups(constants)
    lines = [f"{c.name} = {format_constant(c)}" for c in shared]
    lines += [group_range(*group) for group in own]
    if len(lines) > most:
        lines = [*lines[: most - 1], more.format(len(lines) - most + 1)]
    return lines


MOST_CLEAR = 6
"""Bodies or scenes that are named as those in which a constant is not zero."""
CLEAR = 1.8
"""Times half an interval of 90 % that are three standard deviations."""


def group_range(name, unit, group):
    """One line for a constant of which every entity has its own."""
    values = [c.value for c in group if is_number(c.value) and c.state != "undetermined"]
    label = f"{name}: {len(group)} {'entities' if len(group) > 1 else 'entity'}"
    n_open = sum(c.state == "undetermined" for c in group)
    if n_open:
        label += f", {n_open} of them undetermined"
    if not values:
        return f"{label}, no value known"
    spread = max(values) - min(values)
    low, _, high, power = rounded(min(values), min(values) - spread / 4, max(values))
    to = f"{high}{with_unit(power, unit)}" if power else with_unit(high, unit)
    clear = [c.entity for c in group if _is_clear(c)]
    some = 0 < len(clear) < len(group) and len(clear) <= MOST_CLEAR
    return f"{label}, {low} to {to}" + (f"; clearly not zero: {', '.join(clear)}" if some else "")


def _is_clear(constant):
    """Whether zero is three standard deviations away."""
    if not all(map(is_number, (constant.value, constant.low, constant.high))):
        return False
    error = max(constant.high - constant.value, constant.value - constant.low)
    return abs(constant.value) > CLEAR * error
