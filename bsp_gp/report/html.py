"""The report as one page: every word escaped, every figure inside, nothing fetched."""

import base64
import re
import shlex
from html import escape

from jinja2 import Environment, PackageLoader, StrictUndefined

from bsp_gp.data.notes import listed
from bsp_gp.report.codes import KINDS, TONES
from bsp_gp.report.explore import exploration, script, script_digest
from bsp_gp.report.figures import build_figures, units_of
from bsp_gp.report.first import (
    bound_sentence,
    else_sentence,
    legend,
    plain_sentence,
    told_constants,
)
from bsp_gp.report.numbers import (
    NOT_KNOWN,
    format_level,
    format_number,
    format_ratio,
    format_value,
    is_number,
    pretty_unit,
    rounded,
    with_unit,
)
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import (
    adopted_rounds,
    caveats,
    constant_groups,
    group_range,
    headline,
    hidden_sentence,
    missing_sentence,
    noise_sentence,
    outcome_sentence,
    overturned_by,
    powers_sentence,
    ratio_caution,
    worse_bodies,
)
from bsp_gp.report.traces import trace_section
from bsp_gp.report.typeset import to_svg

_MAX_ROWS = 300
_ERRORS = (
    ("rollout_rmse", "Position error of rollouts (RMS)", "unit"),
    ("endpoint", "Position error at the end point (median)", "unit"),
    ("endpoint_mean", "Position error at the end point (mean)", "unit"),
    ("one_step_nrmse", "One-step error (mean)", "unit"),
    ("residual_acceleration", "Residual acceleration (RMS)", "acceleration_unit"),
)


def render_html(report, run_info=None, figures=None):
    """Write the page of a report, a complete HTML document.

    Parameters
    ----------
    run_info : mapping, optional
        ``argv`` (list of str) is shown as the command that makes the report again.
    figures : dict of str to ReportFigure, optional
        From `build_figures`; drawn here if not given.
    """
    figures = build_figures(report) if figures is None else figures
    report = page_of(report)
    explored = exploration(report, units_of(report), bool(adopted_rounds(report)))
    sentence, detail = plain_sentence(report)
    shared, own = constant_groups(report.constants)
    environment = Environment(
        loader=PackageLoader("bsp_gp.report", "templates"), autoescape=True,
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.globals.update(
        typeset=to_svg, number=format_number, value=format_value, kind=lambda k: KINDS.get(k, k),
    )  # fmt: skip
    return environment.get_template("report.html").render(
        name=report.dataset.get("name") or "data", facts=_facts(report), verdict=report.verdict,
        tone=TONES.get(report.verdict, "open"), sentence=sentence, detail=detail,
        head=headline(report),
        caution=" ".join(filter(None, (ratio_caution(report), worse_bodies(report)))),
        caveats=caveats(report),
        caveat_words=[text.partition(" (")[0].partition(":")[0] for text in caveats(report)],
        notes=report.notes, notes_title=_notes_title(report), legend=legend(report),
        told_constants=told_constants(report), otherwise=else_sentence(report),
        bound=bound_sentence(report), drawing=_drawing(figures.get("headline")),
        contents=_contents(report, figures), explored=explored, script=script(),
        script_digest=script_digest(), law_text=report.law_text, law_latex=report.law_latex,
        law_title=_law_title(report), corrections=report.corrections, declared=report.declared,
        constants=[_constant(c) for c in shared],
        own=[(group_range(*g), g[0], pretty_unit(g[1]), [_constant(c) for c in g[2]]) for g in own],
        figures={name: _figure(f) for name, f in figures.items()}, total=_total_table(report),
        intervals=_intervals_note(report), rounds=[_round(r, report) for r in report.rounds],
        extras=[_extra(e) for e in report.extras], stop_reason=report.stop_reason,
        reproduce=_reproduce(report, run_info or {}),
    )  # fmt: skip


def _drawing(figure):
    """The picture of the first screen, whose lines the page can hide."""
    if figure is None:
        return None
    svg = figure.svg[figure.svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = svg.replace("<svg ", f'<svg role="img" aria-label="{escape(figure.caption)}" ', 1)
    return {"svg": svg, "caption": figure.caption}


def _notes_title(report):
    n = len(caveats(report)) + len(report.notes)
    return f"Notes ({n})"


def _contents(report, figures):
    """Link and title of every section."""
    out = [("law", _law_title(report)), ("error", "Error on held-out data")]
    out += [("notes", _notes_title(report))] if caveats(report) or report.notes else []
    out += [("tracks", "Held-out tracks")] if "tracks" in figures else []
    out += [(f"round-{r.number}", f"Round {r.number}") for r in report.rounds]
    out += [("residuals", "What is left")] if "residuals" in figures else []
    out += [("scenes", "Scene by scene")] if any(r.held_out for r in report.rounds) else []
    out += [(f"extra-{k}", e.get("title", "")) for k, e in enumerate(report.extras, 1)]
    return [*out, ("stop", "Why it stopped"), ("again", "To make it again")]


def _law_title(report):
    if adopted_rounds(report):
        return "The law and its constants"
    return "The declared law, as fitted"


def _facts(report):
    """What was measured, in a line."""
    data = report.dataset
    parts = [
        f"{data[key]} {word if data[key] != 1 else one}"
        for key, word, one in (
            ("n_scenes", "scenes", "scene"),
            ("n_entities", "entities", "entity"),
            ("n_rows", "rows", "row"),
        )
        if data.get(key) is not None
    ]
    parts += [
        f"{_count(data[key])} {word}"
        for key, word in (("train", "to learn from"), ("test", "held out"))
        if data.get(key)
    ]
    sigma = report.noise.get("sigma")
    values = sigma if isinstance(sigma, list | tuple) else [sigma]
    known = [format_number(v, 2) for v in values if is_number(v)]
    if known:
        text = " / ".join(dict.fromkeys(known))
        source = report.noise.get("source")
        parts.append(
            "noise "
            + with_unit(text, report.noise.get("unit"))
            + (f" ({source})" if source else "")
        )
    return " · ".join(parts)


def _count(value):
    """A number of scenes, or the text that describes a split."""
    return len(value) if isinstance(value, list | tuple) else value


def _constant(c):
    value, low, high, power = rounded(c.value, c.low, c.high)
    if c.state == "undetermined":
        value = power = ""
        low = high = NOT_KNOWN
    interval = NOT_KNOWN if NOT_KNOWN in (low, high) else f"[{low}, {high}]{power}"
    return {
        "name": c.name,
        "entity": c.entity,
        "value": (value + power) or "undetermined",
        "interval": "at its bound" if c.state == "at_bound" else interval,
        "unit": pretty_unit(c.unit),
    }


def _figure(figure):
    data = base64.b64encode(figure.svg.encode("utf-8")).decode("ascii")
    return {"uri": f"data:image/svg+xml;base64,{data}", "caption": figure.caption}


def _error_table(before, after, floor, ratios):
    rows = []
    for metric, label, unit_of in _ERRORS:
        unit = next((getattr(e, unit_of) for e in (before, after, floor) if e is not None), "")
        if not any(is_number(getattr(e, metric, None)) for e in (before, after, floor)):
            continue
        values = [_error(e, metric) for e in (before, after, floor)]
        rows.append([label, *values, format_ratio(ratios.get(metric)), pretty_unit(unit)])
    return rows


def _error(errors, metric):
    """An error with its interval, without unit."""
    if errors is None:
        return NOT_KNOWN
    value, interval = getattr(errors, metric), errors.intervals.get(metric, ())
    if not all(map(is_number, interval)) or not interval:
        return format_number(value)
    return format_value(value, *interval)


def _total_table(report):
    before, after, floor = (report.total.get(k) for k in ("before", "after", "floor"))
    ratios = report.total.get("ratios", {})
    if not adopted_rounds(report):
        after, ratios = None, {}
    return _error_table(before, after, floor, ratios)


def _intervals_note(report):
    """Where the intervals of errors come from."""
    ratio = report.total.get("ratio")
    if ratio is None or not is_number(ratio.low):
        return ""
    return f"In brackets: 90 % intervals ({ratio.method})."


def _round(r, report):
    effect = r.effect
    table = _error_table(r.before, r.after, r.floor, {"rollout_rmse": r.ratio})
    shared, own = constant_groups(effect.constants if effect is not None else ())
    return {
        "number": r.number,
        "title": effect.name if effect is not None else r.verdict,
        "state": _state(r),
        "missing": missing_sentence(r, report.alpha),
        "noise": noise_sentence(r),
        "powers": powers_sentence(r),
        "hidden": hidden_sentence(r),
        "trace": trace_section(r),
        "outcome": outcome_sentence(r),
        "effect": effect,
        "constants": [_constant(c) for c in shared],
        "own": [group_range(*group) for group in own],
        "entities": listed(effect.entities, 12) if effect else "",
        "table": [] if table == _total_table(report) else table,
        "hypotheses": r.hypotheses,
        "n_hypotheses": r.n_hypotheses,
        "held_out": _by_scene(r),
        "overturned_by": overturned_by(r),
        "certificate": r.certificate,
    }


def _state(round_):
    if round_.effect is None:
        return ""
    if round_.removed:
        return "taken back"
    return "adopted" if round_.adopted else "not adopted"


def _cell(value):
    if value is None or (isinstance(value, float) and not is_number(value)):
        return NOT_KNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    if is_number(value):
        return str(value) if isinstance(value, int) else format_number(value)
    if isinstance(value, list | tuple):
        return ", ".join(_cell(v) for v in value)
    return str(value)


def _by_scene(round_):
    """The position errors of held-out scenes, told with what they are."""
    if not round_.held_out:
        return None
    unit = f" ({round_.before.unit})" if round_.before.unit else ""
    names = {"before": f"position error before{unit}", "after": f"after{unit}"}
    rows = [{names.get(k, k): v for k, v in row.items()} for row in round_.held_out]
    return _table_of_dicts(rows)


def _table_of_dicts(rows):
    """Header, rows and number of rows left out; None without rows."""
    if not rows:
        return None
    keys = list(dict.fromkeys(k for row in rows for k in row))
    return {
        "header": [str(k).replace("_", " ") for k in keys],
        "is_number": [any(is_number(row.get(k)) for row in rows) for k in keys],
        "rows": [[_cell(row.get(k)) for k in keys] for row in rows[:_MAX_ROWS]],
        "n_left": max(len(rows) - _MAX_ROWS, 0),
    }


def _extra(extra):
    table = extra.get("table") or []
    return {
        "title": extra.get("title", ""),
        "paragraphs": extra.get("paragraphs") or [],
        "header": [_cell(v) for v in table[0]] if table else [],
        "rows": [[_cell(v) for v in row] for row in table[1:]],
    }


def _reproduce(report, run_info):
    """Label and text of everything that a run needs to be repeated."""
    grammar = " ".join(
        str(report.grammar[k]) for k in ("name", "fingerprint") if report.grammar.get(k)
    )
    provenance = report.dataset.get("provenance")
    if hasattr(provenance, "items"):
        provenance = "; ".join(f"{k}: {_cell(v)}" for k, v in provenance.items())
    versions = ", ".join(f"{k} {v}" for k, v in report.versions.items())
    rows = [
        ("Command", shlex.join(map(str, run_info.get("argv") or ()))), ("Seed", report.seed),
        ("Level of significance", format_level(report.alpha)), ("Grammar", grammar or NOT_KNOWN),
        ("Data", report.dataset.get("fingerprint") or ""), ("Provenance", provenance or ""),
        ("Versions", versions or NOT_KNOWN),
        ("Time taken", with_unit(format_number(report.wall_s, 3), "s")),
    ]  # fmt: skip
    return [(label, str(text)) for label, text in rows if text != ""]
