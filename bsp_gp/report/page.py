"""The codes and numbers of a closed loop in the words and records that pages are made of."""

import re
from dataclasses import replace
from types import SimpleNamespace

from bsp_gp.data.scene import CHECK
from bsp_gp.language.formula import summands
from bsp_gp.language.render import to_text
from bsp_gp.loop.criteria import CHANGES, KICKED
from bsp_gp.loop.stored import formula_of
from bsp_gp.loop.told import retold
from bsp_gp.physics.engine.owners import fitted_properties
from bsp_gp.physics.force import needs_masses, split_linear
from bsp_gp.physics.masses import NO_MASS, ONE_KILOGRAM, is_of_no_mass
from bsp_gp.report.codes import (
    CAUSES,
    LEFT_OUT,
    METHODS,
    NOISE,
    OWN_STRENGTHS,
    REASONS,
    STOPS,
)
from bsp_gp.report.kicks import kick
from bsp_gp.report.naming import (
    along_one_line,
    bad_rows,
    between_bumpers,
    change,
    clock_jumps,
    constant_distance,
    describe,
    inclination,
    kept_curve,
    of_scenes,
    period,
    ripple,
)
from bsp_gp.report.numbers import format_number, format_value, is_number
from bsp_gp.report.rewritings import dependence, other_way, rewritten, told_once
from bsp_gp.report.unseen_body import name_of, rivals_of

_TOLD = 12
"""Hypotheses of a round that a page lists."""
_MOST_FINDINGS = 3
_LIKELY = 0.1
"""Part of the probability of the likeliest from which causes of other kinds are told with it."""
_JOINED = (
    f"{CHECK}a rod joins bodies whose masses are not known: they are taken as equal, and what acts "
    "on them is told wrongly if they are not; --property mass=NAME:0.1,OTHER:0.2 gives them"
)
_IN_THE_FIRST = "masses of bodies on rods are told in that of the one that hangs first"
_NAMED = {
    **dict.fromkeys(KICKED, kick), "inclined": inclination, "ripple": ripple, "bad_row": bad_rows,
    "clock_jump": clock_jumps,
}  # fmt: skip
"""How causes of a code are told, whatever they are."""
_COUNTS = {2: "two", 3: "three", 4: "four", 5: "five"}


def page_of(report):
    """A report as pages read it."""
    if isinstance(report, SimpleNamespace):
        return report
    rounds = [_round(done, report) for done in report.rounds]
    kept = (
        "dataset", "declared", "grammar", "seed", "alpha", "noise", "law_text", "law_latex",
        "constants", "verdict", "versions", "wall_s", "overlays", "residuals", "extras", "left_out",
    )  # fmt: skip
    total = {**report.total, "ratio": _ratio(report.total["ratio"])}
    page = SimpleNamespace(
        **{name: getattr(report, name) for name in kept},
        total=total, rounds=rounds, bound=_bound(report.hidden_bound),
        stop_reason=STOPS[report.stop_reason], notes=tuple(_notes(report)),
        corrections=tuple(
            {"name": r.effect.name, "text": r.effect.law, "kind": r.effect.kind}
            for r in rounds
            if r.adopted and not r.removed and r.effect.kind in ("measurement", "hidden_body")
        ),
    )  # fmt: skip
    page = retold(page)
    for r, done in zip(page.rounds, report.rounds, strict=True):
        if r.effect is not None:
            if r.effect.kind == "hidden_body":
                r.effect.name = name_of(r.effect)
            elif r.effect.code in KICKED:  # anew, in the units of the data
                own = {"name": done.effect.name, "code": r.effect.code}
                r.effect.name = kick(SimpleNamespace(constants=r.effect.constants, **own))
            law, rivals = r.effect.written or "", rivals_of(r.effect.equivalents)
            tried = [row["law"] for row in done.hypotheses if row["status"] == "converged"]
            r.effect.dependence = dependence(law, rivals, tried, page.dataset)
            r.effect.equivalents, n_same, why = told_once(law, rivals, page.dataset)
            other = _other_error(r.effect, done.hypotheses)
            r.effect.likeliest_other = other or _other_form(r.effect, done, page.dataset)
            r.effect.rewritten = rewritten(n_same, why)
            r.effect.name += other_way(r.effect, why, page.dataset)
    return page


def _other_error(effect, rows):
    """In plain words, the likeliest other error of the measurement that fits as well; "" if none.

    Parameters
    ----------
    rows : sequence of dict
        Of the table of its round.
    """
    if effect.is_fact or effect.kind != "measurement":
        return ""
    rows = [row for row in rows if row["law"] in effect.equivalents and row["model"]
            and row["code"] in CAUSES and row["code"] != effect.code
            and len(row["model"]["uncertain"]) <= len(effect.constants)]  # fmt: skip
    row = max(rows, key=lambda row: _finite(row["probability"]), default=None)
    return "" if row is None else of_scenes(row["code"], row["model"]["uncertain"])


def _other_form(effect, done, dataset):
    """In plain words, the likeliest form that fits as well as one that is no fact; "" if none.

    Of those with more numbers some always do.
    """
    is_open = any(not e["is_told"] for e in effect.exponents)  # its interval says as much
    if effect.is_fact or is_open or effect.kind not in ("pair", "field", "declared_term_change"):
        return ""
    models = {row["law"]: row for row in done.hypotheses if row.get("model")}
    own = models.get(done.effect.name)
    changed = {text: row for text, row in models.items() if row["code"] in CHANGES}
    for text in effect.equivalents:
        row, law = changed.get(text), formula_of(text, dataset)
        if row is not None:
            words, n = change(row["code"], text), len(effect.constants)
            n += _n_values(row) - _n_values(own) if own else 0
        elif law is not None:
            words, n = _in_words(text, dataset), len(law.constants)
        else:
            continue
        if words != effect.name and n <= len(effect.constants):
            return words
    return ""


def _n_values(row):
    """Numbers of the law of a row of the table."""
    values = row["model"]["values"].values()
    return sum(len(value) if isinstance(value, dict) else 1 for value in values)


def _ratio(ratio):
    return SimpleNamespace(
        value=ratio.value, low=ratio.low, high=ratio.high, method=METHODS[ratio.method]
    )


def _notes(report):
    """What a reader must know."""
    if report.left_out:
        listed = "; ".join(LEFT_OUT[code] for code in report.left_out)
        yield f"the run was ended by its time limit: {listed}; --time-limit 1h, or none, gives more"
    last = report.rounds[-1]
    if any(r.adopted for r in report.rounds) and last.verdict == "seen, not adopted":
        yield (
            "what was adopted still leaves more than noise: its form and constants hold for this "
            "recording and are no discovery about nature"
        )
    for entry in report.declared:
        if entry.get("is_displaced"):
            yield (
                f"Beside what was found the data do not ask for the declared {entry['law']}: "
                "it was taken out of the law."
            )
    is_joined = any(getattr(part, "is_coupling", False) for part in report.law.frame)
    for note in report.dataset["notes"]:
        is_of_masses = is_of_no_mass(note)
        if note.startswith(ONE_KILOGRAM):
            note = CHECK + note if needs_masses(report.law) else NO_MASS
        yield note
        if is_of_masses and is_joined:
            yield _IN_THE_FIRST if "mass" in fitted_properties(report.law) else _JOINED
    if report.dataset["split"]:
        yield report.dataset["split"]
    symbols = {k: v for k, v in report.dataset["symbols"].items() if v != "rad"}
    if symbols:
        listed = ", ".join(f"{v} stands for {k}" for k, v in symbols.items())
        yield f"not calibrated: {listed}; constants are in the data's own units"
    yield from _unsupported(report)
    if report.noise["source"] == "estimated":
        yield f"the noise was estimated {report.noise['method']}"


def _unsupported(report):
    """Declared terms that the data do without: their constant may as well be zero."""
    estimates = {c.name: c for c in report.constants if not c.entity}
    for term in report.law.terms:
        name, _ = split_linear(term.formula)
        c = estimates.get(name)
        if term.is_declared and c is not None and c.low < 0 < c.high:
            size = format_value(c.value, c.low, c.high, c.unit)
            yield f"the declared term {to_text(term.formula)} has no support: {name} = {size}"


def _settled(done, report):
    """A round whose effect, if it was kept, has its constants as they are in the end."""
    if done.effect is None or not done.adopted:
        return done
    last = {(c.name, c.entity): c for c in report.constants}
    constants = tuple(last.get((c.name, c.entity), c) for c in done.effect.constants)
    return replace(done, effect=replace(done.effect, constants=constants))


def _round(done, report):
    done = _settled(done, report)
    other = report.dataset.get("partner") or "the other body"
    parts = () if done.effect is None else _parts(done.effect, report.law, other)
    beside = () if done.effect is None else _beside(done.effect, report.law, other)
    name = "" if done.effect is None else _name(done.effect, parts, other)
    if done.effect is not None and name == done.effect.name:
        name = _in_words(name, report.dataset) or name
    tied = _tied(done, report.dataset) if done.reason == "kinds_tie" else ()
    p_value = done.missing.p_value
    return SimpleNamespace(
        number=done.number, missing=done.missing,
        is_missing=is_number(p_value) and p_value <= report.alpha,
        noise=tuple(_noise(finding) for finding in done.noise_findings[:_MOST_FINDINGS]),
        bound=_bound(done.hidden_bound),
        effect=None if done.effect is None else _effect(done.effect, name, parts, beside, tied),
        unlisted=sum(
            _finite(row["probability"]) for row in done.hypotheses if row["status"] == "linearised"
        ),
        hypotheses=_hypotheses(done), n_hypotheses=len(done.hypotheses),
        adopted=done.adopted or done.reason == "superseded",
        removed=REASONS["superseded"] if done.reason == "superseded" else "",
        code=done.reason, reason=_sentence(REASONS[done.reason]), verdict=done.verdict,
        undecided=tied,
        before=done.before, after=done.after, floor=done.floor, ratio=_ratio(done.ratio),
        held_out=done.held_out, certificate=done.certificate, seconds=done.seconds,
        trace=done.trace, time_unit="s",
    )  # fmt: skip


def _bound(bound):
    """How much may be hidden; None where it is not known."""
    return None if bound is None else SimpleNamespace(**bound)


def _noise(finding):
    """One finding about the noise, with where it shows."""
    where = [finding[key] for key in ("entity", "scene") if finding[key]]
    where += [f"row {finding['row'] + 1}"] if finding["row"] >= 0 else []
    most = "furthest off: " if finding["code"] == "tails" else ""
    return NOISE[finding["code"]] + (f" ({most}{', '.join(where)})" if where else "")


def _parts(effect, law, other):
    """Each of several forces that were found as one, in plain words; one, if along several axes."""
    if effect.code in (*KICKED, "reference"):  # one force along every axis, or by every body
        return ()
    if effect.formula is not None or not effect.law:
        return ()
    phrases, n_terms = _phrases(effect, law, other)
    return phrases if n_terms > 1 else ()


def _beside(effect, law, other):
    """In plain words, the forces that were found with what holds bodies or stops them."""
    if effect.kind not in ("constraint", "wall"):
        return ()
    return _phrases(effect, law, other)[0]


def _phrases(effect, law, other):
    """The terms that an effect adds in plain words, those along axes as one; how many they are."""
    added = {c.name: c.value for c in effect.constants}
    terms = [t for t in law.terms if not t.is_declared and set(t.formula.constants) & set(added)]
    values = [next((added[n] for n in t.formula.constants if n in added), None) for t in terms]
    own = [[e for e in effect.exponents if e["term"] == to_text(t.formula)] for t in terms]
    every = zip(terms, values, own, strict=True)
    is_bred = effect.code == "shape"
    told = [describe(t.formula, v, other, exponents, is_bred) + _strengths(t.formula)
            for t, v, exponents in every]  # fmt: skip
    # Components of one spin are called alike.
    return tuple(dict.fromkeys(along_one_line(told, values))), len(terms)


def _strengths(formula):
    """What is said behind a force with a constant of each body or scene."""
    own = (found[1] for n in formula.constants if (found := re.search(r"\[(body|scene)\]$", n)))
    return next((f", {OWN_STRENGTHS[f'law_by_{by}']}" for by in own), "")


def _name(effect, parts, other):
    """What was found, in plain words; `other` is the body that acts."""
    if effect.code == "kicks":
        return effect.name
    if effect.code in _NAMED:
        return _NAMED[effect.code](effect)
    if effect.code == "frame":
        return CAUSES["frame"]
    if effect.code == "reference":
        return f"{CAUSES['reference']} ({effect.name}), which the others pull"
    if effect.kind == "declared_term_change":
        known = [c for c in effect.constants if is_number(c.low) and not c.entity]
        own = [c for c in known if re.fullmatch(r"[ns]\d+|delay\d+|wind_[xyz]\d+", c.name)]
        return change(effect.code, effect.name, own)
    if between := between_bumpers(effect):
        return between
    if len(parts) == 1:
        return parts[0] + (period(effect) if effect.code == "period" else "")
    if parts:
        return f"{_COUNTS.get(len(parts), len(parts))} forces"
    if effect.formula is not None:
        # Of those inside, and of a plane beside it, none tells the way.
        inside = (*split_linear(effect.formula)[1].constants, "inclination", "node")
        strengths = (c for c in effect.constants if c.name not in inside)
        values = [c.value for c in strengths if is_number(c.value)]
        is_one_way = bool(values) and (min(values) > 0 or max(values) < 0)
        value = values[0] if is_one_way or len(values) == 1 else None
        is_bred = effect.code == "shape"
        phrase = describe(effect.formula, value, other, effect.exponents, is_bred)
        phrase += period(effect) if effect.code == "period" else ""
        own = OWN_STRENGTHS.get(effect.code)
        phrase = f"{phrase}, {own}" if own else phrase
        is_aslant = any(c.name == "inclination" for c in effect.constants)
        return f"{phrase}, and {inclination(effect)}" if is_aslant else phrase
    if effect.code in ("rod", "wire"):
        return {"rod": constant_distance, "wire": kept_curve}[effect.code](effect)
    if effect.code in ("scale", "clock", "drift"):
        return of_scenes(effect.code, (c.name for c in effect.constants))
    return CAUSES.get(effect.code, effect.name)


def _effect(effect, name, parts, beside, tied):
    return SimpleNamespace(
        name=name, code=effect.code, parts=parts if len(parts) > 1 else (), kind=effect.kind,
        beside=beside, law=effect.law or effect.name,
        written=effect.law, latex=effect.latex,
        entities=effect.entities, constants=effect.constants, p_value=effect.p_value,
        probability=effect.probability, is_fact=effect.is_fact,
        exponents=effect.exponents, varies_with=effect.varies_with,
        equivalents=tied or effect.equivalents, details=getattr(effect, "details", None) or {},
    )  # fmt: skip


def _tied(done, dataset):
    """Causes of another kind that are as likely."""
    best = done.effect
    rows = _likeliest_first(done)
    likely = _LIKELY * max((_finite(row["probability"]) for row in rows), default=0.0)
    others = [
        row for row in rows
        if row["code"] not in (best.code, "base") and row["status"] != "linearised"
    ]
    told = others[:2] + [row for row in others[2:] if _finite(row["probability"]) > likely]
    is_likely = any(_finite(row["probability"]) > likely for row in others)
    if not done.adopted or (best.kind == "kicks" and not is_likely):
        told = [{"code": "noise", "law": ""}]  # of the base: what is kicked in a trap wanders so
    return tuple(dict.fromkeys(_called(row, dataset) for row in told))


def _called(row, dataset):
    """A row of the table in a few words."""
    if row["code"] in ("number", "exponent"):
        return change(row["code"], row["law"])
    values = (row.get("model") or {}).get("values", {})
    if row["code"] == "shape":
        return _in_words(row["law"], dataset, values, is_bred=True)
    return CAUSES.get(row["code"]) or _in_words(row["law"], dataset, values) or row["law"]


def _in_words(text, dataset, values=None, is_bred=False):
    """The forces of a law that was not taken up in plain words; "" where it is no sum of forces."""
    law, values = formula_of(text, dataset), values or {}
    if law is None:
        return ""
    other, told, sizes = dataset.get("partner") or "the other body", [], []
    for term in summands(law):
        name, _ = split_linear(term)
        sizes.append(values.get(name))
        told.append(describe(term, sizes[-1], other, is_bred=is_bred))
    told = list(dict.fromkeys(along_one_line(told, sizes)))
    return " and ".join(filter(None, [", ".join(told[:-1]), told[-1]]))


def _hypotheses(done):
    """The likeliest rows of the table, as texts."""
    out = []
    for row in _likeliest_first(done)[:_TOLD]:
        gain, promised = row["held_out"]["gain"], row["held_out"]["promised"]
        held_out = f"{format_number(gain)} of {format_number(promised)}" if is_number(gain) else "–"
        out.append({
            "law": row["law"] or "as it was", "code": row["code"], "status": row["status"],
            "evidence": format_number(row["log_evidence"], 5), "held_out": held_out,
            "probability": format_number(row["probability"], 2),
        })  # fmt: skip
    return out


def _likeliest_first(done):
    return sorted(done.hypotheses, key=lambda row: -_finite(row["probability"]))


def _finite(value):
    return value if is_number(value) else 0.0


def _sentence(text):
    return text[:1].upper() + text[1:]
