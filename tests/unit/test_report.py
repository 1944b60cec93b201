import csv
import importlib.util
import json
import logging
import math
import os
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.errors import OutputError
from bsp_gp.fitting.estimates import ConstantEstimate
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.criteria import (
    CAUSES,
    LEFT_OUT,
    NOISE_FINDINGS,
    REASONS,
    STOP_REASONS,
    VERDICTS,
)
from bsp_gp.loop.told import Told
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.report import codes
from bsp_gp.report import folder as folder_module
from bsp_gp.report.bars import rounds_figure
from bsp_gp.report.drawing import (
    new_figure,
    plain,
    scaled,
    spans_decades,
    svg_text,
    time_scaled,
)
from bsp_gp.report.explore import script, script_digest
from bsp_gp.report.figures import build_figures
from bsp_gp.report.first import bound_sentence, else_sentence, plain_sentence
from bsp_gp.report.folder import write_report
from bsp_gp.report.html import render_html
from bsp_gp.report.numbers import format_number, format_p, format_value, pretty_unit, rounded
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import (
    caveats,
    headline,
    missing_sentence,
    powers_sentence,
    ratio_caution,
    verdict_sentence,
    worse_bodies,
)
from bsp_gp.report.summary import summary_text
from bsp_gp.report.tracks import pick_overlays, wants_errors
from bsp_gp.report.typeset import law_document, split_terms, to_svg

_spec = importlib.util.spec_from_file_location(
    "report_sample", Path(__file__).with_name("report_sample.py")
)
sample = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(sample)

RUN = {"argv": ["bsp-gp", "close", "my data", "--seed", "7"]}
VOID = {"meta", "br", "img", "link", "input", "hr"}
CONTRACT = (
    "schema", "dataset", "declared", "grammar", "search", "seed", "alpha", "criteria", "noise",
    "rounds", "law", "total", "verdict", "probability", "equivalents", "stop_reason", "complete",
    "left_out", "n_fits", "versions", "wall_s",
)  # fmt: skip


@pytest.fixture(scope="module")
def pages():
    """Every sample report as a page, drawn once."""
    return {name: render_html(make(), RUN) for name, make in sample.ALL.items()}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The folder of the report in which an effect was adopted."""
    return write_report(
        sample.adopted(), tmp_path_factory.mktemp("reports") / "deep" / "drag", run_info=RUN
    )


class Outline(HTMLParser):
    """Tags that do not nest, attributes that fetch something, and the text."""

    def __init__(self, page):
        super().__init__()
        self.open, self.faults, self.fetched, self.tags, self.words = [], [], [], set(), []
        self.ids, self.links, self.folded, self.first, self.shown = set(), set(), 0, [], []
        self.unscoped, self.open_details = 0, []
        self.feed(page)
        self.close()
        self.faults += self.open
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        found = [v for k, v in attrs if k in ("src", "href", "srcset", "data", "action")]
        self.links |= {v[1:] for v in found if v.startswith("#")}
        self.fetched += [v for v in found if not v.startswith("#")]
        self.ids |= {v for k, v in attrs if k == "id"}
        self.folded += tag == "details" and "open" not in dict(attrs)
        self.unscoped += tag == "th" and "scope" not in dict(attrs)
        if tag == "details":
            self.open_details.append("open" in dict(attrs))
        self.faults += [k for k, _ in attrs if k.startswith("on")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.add(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"</{tag}>")
        if tag == "details":
            self.open_details.pop()

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.words.append(data)
            if "header" in self.open:
                self.first += data.split()
            if all(self.open_details) or "summary" in self.open:
                self.shown += data.split()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((9.80665, 9.79123, 9.82211, "m/s^2"), "9.807 [9.791, 9.822] m/s²"),
        ((0.18, 0.15, 0.22), "0.18 [0.15, 0.22]"),
        ((1.327e20, 1.323e20, 1.331e20, "m^3/s^2"), "1.327 [1.323, 1.331] × 10²⁰ m³/s²"),
        ((-0.02, -0.05, 0.011), "−0.02 [−0.05, 0.01]"),
        ((12345.6, 11000.0, 13800.0, "N"), "12300 [11000, 13800] N"),
        ((3.0, math.nan, math.nan, "kg*m"), "3.000 kg·m"),
        ((math.nan, math.nan, math.nan, "m"), "–"),
        ((math.inf, 0.0, 1.0), "–"),
        ((0.0, 0.0, 0.0), "0.000 [0.000, 0.000]"),
        ((2.0, -300.0, 300.0), "0 [−300, 300]"),
        ((1e-12, 0.9e-12, 1.1e-12), "1.00 [0.90, 1.10] × 10⁻¹²"),
    ],
)
def test_values_have_the_digits_that_their_interval_supports(arguments, text):
    assert format_value(*arguments) == text


def test_no_number_is_longer_than_a_float_can_hold():
    rng = np.random.default_rng(3)
    for value in rng.normal(size=200) * 10.0 ** rng.integers(-30, 30, 200):
        for relative in (0.0, 1e-18, 1e-9, 0.03, 7.0):
            half = abs(value) * relative
            for text in rounded(value, value - half, value + half)[:3]:
                assert len(re.sub(r"\D", "", text)) <= 15
            assert float(_ascii(format_number(value, 4))) == pytest.approx(value, rel=5e-4)


def _ascii(text):
    powers = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--")
    return text.replace(" × 10", "e").translate(powers)


def test_small_helpers():
    assert [pretty_unit(u) for u in ("1", "", None, "m^3/s^2", "kg^(-1)", "m^(1/2)")] == [
        "", "", "", "m³/s²", "kg⁻¹", "m^(1/2)",
    ]  # fmt: skip
    assert [format_p(p) for p in (0.0, 3e-5, 0.0123, 1.0, math.nan)] == [
        "p < 0.0001", "p < 0.0001", "p = 0.012", "p = 1", "p not known",
    ]  # fmt: skip
    assert format_number(3e-320) == "0" and rounded(3e-320, -1e-310, 2e-312)[0] == "0.000"
    assert format_number(True) == "–" and format_number("7") == "–" and format_number(None) == "–"
    assert plain("a$b$\nc") == r"a\$b\$ c" and len(plain("x" * 99)) == 28
    assert scaled("m", np.array([3e9, -5e10])) == (pytest.approx(1e-9), "10⁶ km")
    assert scaled("m", np.array([math.nan])) == (1.0, "m")
    assert time_scaled("s", np.array([0.0, 864000.0]))[1] == "days"
    assert time_scaled("frame", np.array([0.0, 9.0])) == (1.0, "frame")
    assert not spans_decades(np.abs(np.random.default_rng(1).normal(size=4000)))
    assert spans_decades(np.geomspace(1, 1e4, 50))


@pytest.mark.slow
@pytest.mark.parametrize("name", sample.ALL)
def test_page_is_well_nested_and_fetches_nothing(pages, name):
    outline = Outline(pages[name])
    assert not outline.faults
    assert not outline.tags & {"iframe", "object", "link", "form", "base"}
    scripts = re.findall(r"<script[^>]*>(.*?)</script>", pages[name], re.DOTALL)
    assert [text for text in scripts if not text.startswith("{")] in ([], [script()])
    assert (len(scripts) == 2) == (f"script-src '{script_digest()}'" in pages[name])
    assert all(v.startswith("data:image/svg+xml;base64,") for v in outline.fetched)
    assert not re.search(r"url\((?!#)|@import", pages[name])


@pytest.mark.parametrize("name", [n for n in sample.ALL if n != "hostile"])
def test_the_first_screen_is_short_and_the_rest_is_folded(pages, name):
    outline = Outline(pages[name])
    assert len(outline.first) <= 120
    assert len(outline.shown) <= 2500
    assert outline.folded >= 2
    assert outline.links and outline.links <= outline.ids, "the contents lead somewhere"
    assert outline.unscoped == 0
    assert len(pages[name].encode()) < 1.5e6


def test_the_first_screen_says_it_all(pages):
    first = " ".join(Outline(pages["adopted"]).first)
    for fact in (
        "The declared model lacks drag, quadratic in speed.", "6.11 m", "1.10 m", "0.18 [0.15",
        "0.297 m", "its velocity", "upwards", "Probability of this form: 86 %",
        "These data do not tell it from c1 * v_i * norm(v_i)^1.1 (and 1 more)",
        "A constant force of up to 0.31 % of the declared one may still hide",
    ):  # fmt: skip
        assert fact in first
    page = pages["adopted"]
    drawing = page[page.index('<figure class="picture">') : page.index("</figure>")]
    assert 'id="before"' in drawing and 'id="after"' in drawing
    for name in ("before", "after"):  # the boxes hide the lines, without a script
        assert f'id="show-{name}" checked' in drawing
        assert f'.picture:has(#show-{name}:not(:checked)) [id="{name}"]' in page


@pytest.mark.slow
def test_a_section_with_something_to_say_says_it_first():
    report = sample.adopted()
    extra = {**report.extras[0], "headline": "it is that of the air"}
    page = Outline(render_html(replace(report, extras=(extra,)), RUN))
    assert "quadratic in speed; it is that of the air." in " ".join(page.first)


@pytest.mark.slow
def test_forces_that_were_found_as_one_are_told_apart_and_a_large_class_has_no_probability():
    types = input_types(PROPERTY_UNITS)
    texts = ("c1 * v_i", "c2 * norm(p_i - p_j)^-3 * normalize(p_j - p_i)")
    terms = tuple(Term(parse_formula(text, types)) for text in texts)
    report = sample.adopted()
    constants = tuple(ConstantEstimate(n, v, v - 1, v + 1) for n, v in (("c1", -1.0), ("c2", 2.0)))
    effect = replace(
        report.rounds[0].effect, law=" + ".join(texts), constants=constants, probability=1e-8,
        equivalents=("c1 * v_i " * 20, "c1"),
    )  # fmt: skip
    rounds = (replace(report.rounds[0], effect=effect),)
    made = replace(report, rounds=rounds, law=ForceLaw(terms, {"c1": -1.0, "c2": 2.0}))
    first = " ".join(Outline(render_html(made, RUN)).first)
    assert "The declared model lacks two forces." in first
    assert "They are: drag, linear in speed; pull to the other body, as distance⁻³." in first
    assert "do not tell it from 2 other forms" in first and "Probability" not in first


def test_powers_of_several_forces_are_told_with_the_constant_of_each():
    report = sample.adopted()
    one = {"of": "norm(p_i - p_j)", "stated": -3.0, "value": -2.99, "low": -3.01, "high": -2.97}
    powers = ({**one, "term": "c1 * (m_i)"}, {**one, "term": "c2 * (m_j)", "of": "norm(v_i)"})
    told = [
        powers_sentence(replace(report.rounds[0], effect=replace(
            report.rounds[0].effect, exponents=given, varies_with=())))
        for given in (powers, powers[:1])
    ]  # fmt: skip
    assert "in c1, distance to the −2.99" in told[0] and "in c2, speed to the −2.99" in told[0]
    assert "(90 %): distance to the" in told[1]
    further = {**one, "term": "c1 * (m_i)", "stated": 0.0}
    effect = replace(report.rounds[0].effect, exponents=(further,), varies_with=())
    told = powers_sentence(replace(report.rounds[0], effect=effect))
    assert "a further distance to the −2.990 [−3.010, −2.970], which the law has not" in told


@pytest.mark.slow
def test_errors_of_scenes_have_their_unit():
    report = sample.adopted()
    rounds = (replace(report.rounds[0], held_out=({"scene": "a", "before": 2.0, "after": 1.0},)),)
    page = render_html(replace(report, rounds=rounds), RUN)
    assert "position error before (m)</th>" in page and "after (m)</th>" in page


def test_lengths_are_told_in_the_unit_of_the_data():
    report = sample.adopted()
    page = page_of(replace(report, dataset={**report.dataset, "units": {"length": "cm"}}))
    assert headline(page)["before"] == "610 cm"  # 6.105 m
    drag = next(c for c in page.constants if c.name == "c1")
    assert drag.unit == next(c for c in report.constants if c.name == "c1").unit.replace("m", "cm")
    assert page.overlays[0].observed[0] == pytest.approx(100 * report.overlays[0].observed[0])
    assert "980.665 [cm/s^2]" in page.law_text
    first, si = page.rounds[0], report.rounds[0]
    assert first.held_out[0]["before"] == pytest.approx(100 * si.held_out[0]["before"])
    assert first.trace.values == pytest.approx(100 * np.array(si.trace.values))
    assert first.trace.at == pytest.approx(100 * np.array(si.trace.at))  # speeds
    by_time = replace(si.trace, channels=(replace(si.trace.channels[0], variable="time"),))
    told = Told({"length": "au", "time": "yr"}, {}).trace(by_time)
    assert told.at == pytest.approx(np.array(si.trace.at) / 31557600.0)


def test_the_body_that_acts_has_its_name():
    formula = parse_formula("c1 * norm(p_i - p_j)^-3 * normalize(p_j - p_i)", input_types({}))
    report = sample.adopted()
    effect = replace(report.rounds[0].effect, formula=formula, kind="pair")
    rounds = (replace(report.rounds[0], effect=effect),)
    named = replace(report, rounds=rounds, dataset={**report.dataset, "partner": "Sun"})
    assert "pull to Sun" in verdict_sentence(page_of(named))
    assert "pull to the other body" in verdict_sentence(page_of(replace(report, rounds=rounds)))


@pytest.mark.parametrize("name", [n for n in sample.ALL if n != "hostile"])
def test_page_shows_no_raw_number(pages, name):
    text = Outline(pages[name]).text
    assert not re.search(r"\d\.\d{14,}|\bnan\b|\binf\b|\bNone\b|Errors\(", text)


def test_page_of_an_adopted_effect_has_the_facts(pages):
    text = Outline(pages["adopted"]).text
    for fact in (
        "The declared model lacks drag, quadratic in speed.", "6.11 m", "1.10 m", "0.297 m",
        "0.18 [0.15, 0.22]", "9.807", "[9.791, 9.822]", "m/s²", "ball 13", "kg/m",
        "whitened χ² per degree of freedom 8.31", "p = 0.002, selection included",
        "c1 * R_i * v_i * norm(v_i)", "x = (1 + scale) X", "−2541.3", "310 of 400", "0.86",
        "a push along the velocity that changes with speed (97 % of it, p < 0.0001)",
        "it has a memory from row to row", "up to 0.012 N (0.31 % of the declared force)",
        "throw_3", "Decomposition of the residual", "along the velocity",
        "All 75,816 laws up to depth 5 were tried.", "sha256:3fa9", "numpy 2.4.6",
        "bsp-gp close 'my data' --seed 7", "3 rows of throw_2 were dropped",
        "0.019 m/s² or more would have been seen with 95 % power",
        "Nothing is left above the noise",
    ):  # fmt: skip
        assert fact in text
    assert pages["adopted"].count('class="math"') == 6
    assert pages["adopted"].count("<img") == 5
    assert "Read this first" not in text and "Notes (2)" in text


def test_page_of_every_other_verdict(pages):
    text = {name: Outline(page).text for name, page in pages.items()}
    assert "Nothing is missing from the declared model" in text["nothing_missing"]
    assert "0.019 m/s² or more would have been seen" in text["nothing_missing"]
    assert "Adopted law" not in text["nothing_missing"]
    assert "forward push, quadratic in speed, was seen" in text["seen_not_adopted"]
    assert "do not gain what it promises" in text["seen_not_adopted"]
    assert "these data cannot tell what" in text["cannot_tell"]
    assert "ended by its time limit: some causes were not fitted" in text["cannot_tell"]
    assert "Lengths are not calibrated (they are in px)" in text["cannot_tell"]
    assert "The noise of the measurement is not known" in text["cannot_tell"]
    assert "Read this first" in text["cannot_tell"]
    assert "Adopted law" not in text["seen_not_adopted"]
    assert "1.32712440018 × 10²⁰" in text["orbit"] and "m³/s²" in text["orbit"]


@pytest.mark.slow
def test_text_of_users_is_escaped_everywhere(tmp_path, pages):
    assert "<script>alert" not in pages["hostile"] and "alert(&#34;x&#34;)" in pages["hostile"]
    assert 'alert("x")' in Outline(pages["hostile"]).text
    out = write_report(sample.hostile(), tmp_path / "r")
    for file in out.glob("figures/*.svg"):
        tree = ET.parse(file)
        assert not [e for e in tree.iter() if str(e.tag).endswith("script")]
    assert "Thrown balls" in (out / "report.html").read_text("utf-8")
    assert r"\frac{" not in law_document(sample.hostile())


def test_figures_belong_to_what_the_report_has(caplog):
    caplog.set_level(logging.WARNING)
    names = {name: list(build_figures(make())) for name, make in sample.ALL.items()}
    assert names["adopted"] == ["headline", "tracks", "constants", "rounds", "residuals", "trace_1"]
    assert names["orbit"] == ["headline", "tracks", "track_errors", "constants", "rounds",
                              "residuals"]
    assert names["cannot_tell"] == []
    assert names["all_nan"] == []
    assert not caplog.records


def test_tracks_are_picked_scene_after_scene_and_shown_apart():
    flat = sample.overlays_2d(20)
    assert len(pick_overlays(flat)) == 9
    two = [replace(o, scene="a") for o in flat[:10]] + [replace(flat[10], scene="b")]
    assert flat[10].times is pick_overlays(two, 2)[1].times
    assert not wants_errors(flat)
    assert wants_errors([replace(o, declared=o.adopted) for o in flat])
    assert wants_errors(sample.orbit().overlays)


@pytest.mark.parametrize(("radius", "is_alike"), [(1.0, True), (1.3, False)])
def test_a_rollout_that_is_late_on_the_same_path_is_shown_by_its_error(radius, is_alike):
    t = np.linspace(0, 9, 400)
    swing, late = np.cos(t), np.cos(t - 0.7)
    some = replace(
        sample.overlays_2d(1)[0], times=t, observed=np.c_[np.sin(swing), -np.cos(swing)],
        declared=radius * np.c_[np.sin(late), -np.cos(late)],
    )  # fmt: skip
    assert wants_errors([some]) == is_alike


def test_a_rollout_that_runs_away_and_odd_names_can_be_drawn():
    first = sample.overlays_2d(1)[0]
    wild = replace(first, declared=first.declared * 1e9, entity="鉄球 $x_$ \x07")
    lone = replace(first, scene="", observed=first.observed[:, :1], declared=first.declared[:, :1],
                   adopted=first.adopted[:, :1] * math.nan, n_initial=0)
    figures = build_figures(replace(sample.adopted(), overlays=(wild, lone)))
    assert figures["tracks"].svg and figures["tracks"].png
    low, high = figures["tracks"].figure.axes[0].get_ylim()
    assert -40 < low < high < 40


def test_many_entities_keep_the_figure_short():
    c = sample.adopted().constants[1]
    many = tuple(replace(c, entity=f"e{k}", value=10.0 ** (k % 5)) for k in range(500))
    figure = build_figures(replace(sample.adopted(), constants=many))["constants"].figure
    assert figure.get_size_inches()[1] < 12


@pytest.mark.parametrize(
    "latex",
    [
        r"\mathbf{F}_i = \mathbf{0}",
        r"\sum_{j\ne i} \frac{c_{1}\,m_i}{{r}_{ij}^{2}}\,\hat{\mathbf{r}_{ij}} + \hat{\mathbf{x}}",
        r"\operatorname{project}\left(\mathbf{v}_i, \mathbf{r}_{ji}\right)\,\hat{\mathbf{x}}",
        r"{\left(\mathbf{v}_i\right)}_{\perp} + \left|\frac{1}{2}\right|\,\mathrm{drag area}_i",
        r"\left[i\,j\ \mathrm{touch}\right]\,\widehat{\left(\mathbf{p}_i - \mathbf{c}\right)}",
        r"1.5\times 10^{-8}\,[\mathrm{kg~m/s^2}]\,\sqrt{\left\|\mathbf{v}_i\right\|}",
    ],
)
def test_our_latex_can_be_typeset(latex):
    parts = to_svg(latex).split("\n")
    assert len(parts) == len(split_terms(latex))
    for part in parts:
        assert ET.fromstring(part)[0].get("d")


@pytest.mark.parametrize("latex", ["", r"\frac{", "$x$", r"\nonsense{x}", "x" * 9999, "{}"])
def test_what_cannot_be_typeset_is_left_as_text(latex):
    assert to_svg(latex) is None


def test_signs_of_a_sum_are_not_doubled():
    assert split_terms(r"a + -b + \left(c + d\right)") == ["a", "- b", r"+ \left(c + d\right)"]
    assert split_terms(r"a\left\{b + c\right\} + d") == [r"a\left\{b + c\right\}", "+ d"]


@pytest.mark.parametrize("name", sample.ALL)
def test_summary_fits_a_terminal(name):
    report = sample.ALL[name]()
    text = summary_text(report)
    lines = text.split("\n")
    assert len(lines) <= 25 or name == "hostile"
    assert max(map(len, lines)) <= 100 and "…" not in text
    assert report.verdict in lines[0]
    narrow = summary_text(report, 60)
    assert max(map(len, narrow.split("\n"))) <= 60
    assert "".join(narrow.split()) == "".join(text.split()), "the same words on narrow lines"
    assert text.isprintable() or text.replace("\n", "").isprintable()


def test_summary_has_the_facts():
    text = " ".join(summary_text(sample.adopted()).split())
    for fact in ("lacks drag, quadratic in speed", "6.11 m → 1.10 m, ratio 0.18 [0.15, 0.22]",
                 "noise floor 0.297 m", "g = 9.807 [9.791, 9.822] m/s²", "c1: 14 entities",
                 "2 other laws", "p = 0.002", "up to 0.012 N"):  # fmt: skip
        assert fact in text


def test_constants_of_a_few_bodies_are_told_one_by_one():
    report = sample.adopted()
    some = [c for c in report.constants if c.entity][:2]
    text = summary_text(replace(report, constants=some))
    assert "entities" not in text.partition("Constants")[2].partition("Round")[0]
    assert all(f"{c.name} of {c.entity} = " in text for c in some)


def test_summary_shows_every_doubt_about_the_data():
    notes = ("a first note", "check: the clock of scene 'a' seems to jump by 10", "check: far off")
    report = sample.adopted()
    text = summary_text(replace(report, dataset={**report.dataset, "notes": notes}))
    assert "Check: the clock of scene 'a' seems to jump by 10\nCheck: far off\n" in text
    assert text.count("first note") <= 1 and "check:" not in text


def test_summary_stays_short_however_much_there_is():
    full = sample.adopted()
    long = "word " * 400
    notes = (long, f"check: {long}") * 9
    report = replace(full, rounds=full.rounds * 20, constants=full.constants[:1] * 50,
                     dataset={**full.dataset, "notes": notes}, law_text=long)
    text = summary_text(report)
    assert max(map(len, text.split("\n"))) <= 100 and len(text) < 7 * len(long)
    assert " ".join(long.split()) in " ".join(text.split()), "the law stands there in full"


def test_bodies_that_get_worse_are_named():
    report = sample.adopted()
    first, *rest = report.overlays
    worse = replace(first, entity="cork", adopted=first.adopted + 9.0)
    page = page_of(replace(report, overlays=(worse, *rest)))
    assert re.search(r"Worse .*: cork \(\S+ → \S+ m\)\.$", worse_bodies(page))
    assert worse_bodies(page) in summary_text(page).replace("\n", " ")
    assert worse_bodies(page_of(report)) == ""


def test_a_floor_that_is_not_drawn_is_in_no_caption():
    """A floor above the error is told no more; the figure's caption named it all the same."""
    report = sample.adopted()
    bare = tuple(replace(r, floor=None) for r in report.rounds)
    drawn, left_out = (rounds_figure(page_of(r))[0] for r in (report, replace(report, rounds=bare)))
    assert "floor" in drawn and "floor" not in left_out


def test_what_foresees_held_out_rows_worse_is_said_to():
    report = sample.seen_not_adopted()
    (seen,) = report.rounds
    for factor, is_worse in ((2.0, True), (0.9, False), (math.nan, False)):
        after = replace(seen.before, rollout_rmse=factor * seen.before.rollout_rmse)
        told = page_of(replace(report, rounds=(replace(seen, after=after),)))
        assert ("foreseen worse" in " ".join(plain_sentence(told))) is is_worse


def test_sentences_match_the_verdict():
    full = sample.adopted()
    effect = replace(full.rounds[0].effect, kind="hidden_body", code="hidden_body", formula=None)
    hidden = replace(full, rounds=(replace(full.rounds[0], effect=effect),))
    assert verdict_sentence(page_of(hidden)) == "An unseen body acts on these."
    tilt = replace(effect, kind="measurement", code="tilt")
    tilted = replace(full, rounds=(replace(full.rounds[0], effect=tilt), full.rounds[-1]))
    assert verdict_sentence(page_of(tilted)) == (
        "The measurement distorts the motion (a camera that is turned). No force is missing beside "
        "it."
    )
    assert "nothing was good enough" in verdict_sentence(page_of(sample.seen_not_adopted()))
    assert headline(page_of(sample.nothing_missing()))["ratio"] == "–"
    said = missing_sentence(page_of(full).rounds[0], 0.01).lower()
    assert "more is left than noise" in said


@pytest.mark.parametrize(
    ("codes", "words"),
    [(CAUSES, codes.CAUSES), (REASONS, codes.REASONS), (STOP_REASONS, codes.STOPS),
     (LEFT_OUT, codes.LEFT_OUT), (NOISE_FINDINGS, codes.NOISE), (VERDICTS, codes.TONES)],
)  # fmt: skip
def test_every_code_has_words(codes, words):
    assert set(codes) - {"law"} == set(words)


def test_doubtful_gains_and_missing_knowledge_are_said():
    report = page_of(sample.adopted())
    ratio = sample.RATIO

    def caution(**changes):
        total = {**report.total, "ratio": replace(ratio, **changes)}
        return ratio_caution(SimpleNamespace(**{**vars(report), "total": total}))

    assert caution() == ""
    assert "includes 1" in caution(high=1.2)
    assert "no better" in caution(value=1.1, high=1.2)
    assert "no interval" in caution(high=math.nan)
    assert caveats(report) == []
    assert len(caveats(page_of(sample.cannot_tell()))) == 2


@pytest.mark.parametrize("name", sample.ALL)
def test_report_json_keeps_its_contract(name):
    data = json.loads(folder_module._json(sample.ALL[name]().to_dict()))
    assert set(CONTRACT) <= set(data)
    assert list(data)[0] == "schema"
    assert {"before", "after", "floor", "ratio"} <= set(data["total"])
    for key in ("before", "floor"):
        assert {"residual_acceleration", "one_step_nrmse", "rollout_rmse", "endpoint",
                "unit"} <= set(data["total"][key])  # fmt: skip
    for r in data["rounds"]:
        assert {"missing", "effect", "hypotheses", "varies_with", "noise_findings", "hidden_bound",
                "adopted", "reason", "before", "after", "floor", "ratio", "held_out",
                "certificate"} <= set(r)  # fmt: skip
        assert {"statistic", "p_value", "detectable"} <= set(r["missing"])


@pytest.mark.slow
def test_folder_has_every_file(written):
    names = {p.relative_to(written).as_posix() for p in written.rglob("*") if p.is_file()}
    drawn = ("headline", "tracks", "constants", "rounds", "residuals", "trace_1")
    figures = {f"figures/{n}.{e}" for n in drawn for e in ("svg", "png")}
    assert names == figures | {"report.html", "report.json", "law.txt", "law.tex", "residuals.csv",
                               "run.json", ".bsp_gp"}
    assert [p.name for p in written.parent.iterdir()] == ["drag"]
    assert (written / "figures" / "tracks.png").read_bytes().startswith(b"\x89PNG")
    text = (written / "report.json").read_text("utf-8")
    assert text.endswith("}\n") and '\n "dataset"' in text and "NaN" not in text
    run = json.loads((written / "run.json").read_text("utf-8"))
    assert run["argv"] == RUN["argv"] and run["seed"] == 7
    assert run["dataset"]["fingerprint"] == "sha256:3fa9"
    law = (written / "law.txt").read_text("utf-8").splitlines()
    assert law[0] == sample.adopted().law_text
    assert all(line.startswith("# ") for line in law[1:]) and len(law) == 16
    tex = (written / "law.tex").read_text("utf-8")
    assert r"\mathbf{F}_i ={}&" in tex and r"\\ & - {c}_{1}" in tex and "m/s$^{2}$" in tex


def test_residuals_csv_loses_no_digit(written):
    table = sample.adopted().residuals
    with (written / "residuals.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(table.t)
    assert [float(r["before"]) for r in rows] == table.before.tolist()
    assert {r["distance"] for r in rows} == {""}


@pytest.mark.slow
def test_the_same_report_gives_the_same_bytes(tmp_path, written):
    again = write_report(sample.adopted(), tmp_path / "again", run_info=RUN)
    files = [{p.relative_to(f): p.read_bytes() for p in f.rglob("*") if p.is_file()}
             for f in (written, again)]
    assert files[0] == files[1] and len(files[0]) > 10


@pytest.fixture
def small():
    """A report that is quick to write."""
    return sample.cannot_tell()


def test_an_older_report_is_replaced_only_on_demand(tmp_path, small):
    target = tmp_path / "r"
    target.mkdir()
    write_report(small, target)
    with pytest.raises(OutputError, match="overwrite=True"):
        write_report(small, target)
    write_report(replace(small, seed=8), target, overwrite=True)
    assert json.loads((target / "report.json").read_text("utf-8"))["seed"] == 8
    assert os.listdir(tmp_path) == ["r"]


@pytest.mark.parametrize("content", [None, "{}", '{"schema": "other"}'])
def test_a_foreign_folder_is_never_deleted(tmp_path, small, content):
    (tmp_path / "thesis.txt").write_text("years of work")
    if content is not None:
        (tmp_path / "report.json").write_text(content)
    for overwrite in (False, True):
        with pytest.raises(OutputError, match="never overwritten"):
            write_report(small, tmp_path, overwrite=overwrite)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("has_older", [False, True])
def test_a_failure_in_the_middle_leaves_nothing_behind(tmp_path, small, monkeypatch, failure,
                                                       has_older):
    target = tmp_path / "r"
    if has_older:
        write_report(small, target)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    write = Path.write_bytes

    def fail_late(self, data):
        if self.name == "law.tex":
            raise failure
        return write(self, data)

    monkeypatch.setattr(Path, "write_bytes", fail_late)
    expected = OutputError if isinstance(failure, OSError) else KeyboardInterrupt
    with pytest.raises(expected):
        write_report(replace(small, seed=99), target, overwrite=True)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    assert os.listdir(tmp_path) == (["r"] if has_older else [])


def test_a_number_that_json_cannot_hold_writes_nothing(tmp_path, small):
    with pytest.raises(ValueError, match="JSON"):
        write_report(small, tmp_path / "r", run_info={"x": math.nan})
    assert os.listdir(tmp_path) == []


def test_beside_a_name_stand_its_probability_and_that_of_none_of_these():
    report = sample.adopted()
    first = report.rounds[0]
    unknown = {**first.hypotheses[1], "id": 9, "code": "free_force", "law": "free_force along",
               "status": "linearised", "probability": 0.2}  # fmt: skip

    def told(is_fact):
        effect = replace(first.effect, equivalents=(), is_fact=is_fact, probability=0.75)
        rows = (*first.hypotheses, unknown)
        only = replace(first, effect=effect, hypotheses=rows)
        return else_sentence(page_of(replace(report, rounds=(only,))))

    assert told(True) == (
        "Probability of this form: 75 %; of none that is listed: 20 %. "
        "Nothing else that was tried does as well."
    )
    assert told(False).endswith("that its form is the true one is not shown.")
    assert "none that is listed" not in else_sentence(page_of(report))


def test_what_may_be_hidden_is_told_beside_the_final_law():
    report = sample.adopted()
    text = summary_text(report)
    assert "0.012 N (0.31 % of the declared force)" in text
    assert "signal-to-noise ratio of 2.5 at most" in text.replace("\n  ", " ")
    assert "may still hide" in bound_sentence(page_of(report))
    assert bound_sentence(page_of(replace(report, hidden_bound=None))) == ""


@pytest.mark.parametrize("adopted", [True, False])
def test_what_was_adopted_is_told_with_its_constants_as_they_are_in_the_end(adopted):
    report = sample.orbit()
    (done,) = report.rounds
    early = ConstantEstimate("c1", 1.0e28, 0.9e28, 1.1e28, "m^4/s^2")
    first = replace(done, adopted=adopted, effect=replace(done.effect, constants=(early,)))
    (told,) = page_of(replace(report, rounds=(first,))).rounds
    last = {c.name: c.value for c in page_of(report).constants}["c1"]
    was = page_of(replace(report, constants=(early,))).constants[0].value
    assert last != was
    assert told.effect.constants[0].value == (last if adopted else was)


def test_what_numbers_of_an_axis_share_is_a_power_in_letters():
    def draw(figure):
        axes = figure.subplots()
        axes.plot([1234567, 1234569], [0, 3e-7])

    figure = new_figure(draw, 3.0)
    svg_text(figure)
    axes = figure.axes[0]
    told = [axis.get_offset_text().get_text() for axis in (axes.xaxis, axes.yaxis)]
    assert told == ["+1.23456 × 10⁶", "× 10⁻⁷"]


def test_what_was_adopted_before_nothing_more_was_is_named():
    first = replace(sample.adopted().rounds[0], number=1)
    last = replace(sample.seen_not_adopted().rounds[0], number=2)
    report = replace(sample.seen_not_adopted(), rounds=(first, last))
    said = verdict_sentence(page_of(report))
    assert "so does what was adopted (drag, quadratic in speed); nothing more was" in said


def test_how_rows_were_taken_is_no_force_that_there_might_be():
    force = sample.adopted().rounds[0]
    rows = replace(force, effect=replace(force.effect, kind="measurement", code="untrimmed"))
    report = replace(sample.adopted(), rounds=(rows, force), verdict="effective law")
    said = verdict_sentence(page_of(report))
    assert "as if there were drag, quadratic in speed. It describes them" in said
    assert "cause is not shown. " in said


@pytest.mark.parametrize(
    ("noise", "effect", "said"),
    [
        ((), None, "is missing from the declared model, but these data cannot tell what."),
        (("it has a memory",), None, "or the noise is not as it was assumed: these data cannot"),
        ((), SimpleNamespace(name="drag"), "looked at. Of what was, drag explains most so far."),
    ],
)  # fmt: skip
def test_what_is_known_when_the_time_is_up_is_told(noise, effect, said):
    """A null with a noisy camera ended as "something is missing", an oscillator without a word."""
    last = SimpleNamespace(
        adopted=False, undecided=(), is_missing=True, noise=noise, effect=effect,
        code="time_is_up", reason="the time was up before everything was looked at",
    )  # fmt: skip
    report = SimpleNamespace(verdict="cannot tell", rounds=(last,))
    assert said in verdict_sentence(report)
