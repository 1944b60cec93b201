"""Constants of bodies and scenes: typed, fitted, held out, and proposed where one is not enough."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import LawError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import held_out_rows
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.proposers.varying import Varying
from bsp_gp.loop.view import selected
from tests.fitted_tracks import law_of
from tests.loop_views import GRAVITY, view_of
from tests.throws import SI
from tests.unit.test_decide import in_feet

DRAG = "-b * v_i"
MASS, SIGMA = 0.3, 0.004
SPREAD = {"body": {"A": 0.06, "B": 0.17, "C": 0.22}, "scene": {"0": 0.06, "1": 0.2, "2": 0.13}}


def dragged(seed, by="", n_scenes=3, drag=None):
    """Three bodies thrown with linear drag, that of each body, or scene, or one for all."""
    rng = np.random.default_rng(seed)
    t = 0.03 * np.arange(40)
    scenes = []
    for s in range(n_scenes):
        places = []
        for body in "ABC":
            key = body if by == "body" else str(s)
            rate = (SPREAD[by][key] if by and drag is None else drag or 0.15) / MASS
            limit = np.array([0.0, -9.81]) / rate
            start, v = rng.uniform((-3, 3), (3, 5)), rng.uniform((-4, 1), (4, 5))
            gone = (1 - np.exp(-rate * t))[:, None] / rate
            places.append(start + limit * t[:, None] + (v - limit) * gone)
        exact = np.stack(places, axis=1)
        crew = tuple(Entity(body, properties={"mass": MASS}) for body in "ABC")
        scenes.append(Scene(str(s), t, exact + SIGMA * rng.standard_normal(exact.shape), crew))
    return Dataset("dragged", tuple(scenes), noise=(SIGMA,), units=SI)


# --- typed ----------------------------------------------------------------------------------------


def test_an_index_is_read_and_written():
    (term,) = law_of("-c1[body] * v_i + b [scene] * e_x").terms
    assert term.formula.constants == ("c1[body]", "b[scene]")
    assert to_text(term.formula) == "-c1[body] * v_i + b[scene] * e_x"
    assert r"c_{1,\mathrm{body}}" in to_latex(term.formula)


@pytest.mark.parametrize("text", ["m_i[body] * v_i", "c[time] * v_i", "norm[body](v_i) * v_i"])
def test_what_has_no_index_is_refused(text):
    with pytest.raises(LawError):
        law_of(text)


@pytest.mark.parametrize("by", ["body", "scene"])
def test_indexed_constants_are_fitted(by):
    data = dragged(1, by)
    found = fit(Hypothesis.from_laws(data, [GRAVITY, f"-b[{by}] * v_i"]), data)
    assert found.status == "converged"
    for (name, key), value, error in zip(
        found.parameters, found.values, found.errors, strict=True
    ):
        assert name == f"b[{by}]"
        assert abs(value - SPREAD[by][key]) < 4 * error < 0.05


def test_a_scene_that_was_not_fitted_gets_a_constant_from_its_first_rows():
    data = dragged(2, "scene")
    found = fit(Hypothesis.from_laws(data, [GRAVITY, "-b[scene] * v_i"]), data)
    (other,) = dragged(3, "scene", 1, drag=0.25).scenes
    (row,) = held_out_rows(found, data, [replace(other, name="new")])
    (mean,) = held_out_rows(
        fit(Hypothesis.from_laws(data, [GRAVITY, "-0.13 [kg/s] * v_i"]), data), data, [other]
    )
    sizes = [np.sqrt(np.nanmean(np.square(r["track"]))) for r in (row, mean)]
    assert sizes[0] < 0.5 * sizes[1]
    assert np.isfinite(row["steps"]).any()


# --- proposed -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("by", ["body", "scene"])
def test_what_varies_is_proposed_first_and_starts_where_it_is(by):
    view = view_of(dragged(4, by), GRAVITY, DRAG)
    family = Varying().propose(view)
    best = family.proposals[0]
    assert (best.code, best.text) == (f"constant_per_{by}", f"-b[{by}] * v_i")
    table = best.hypothesis.law.constants[f"b[{by}]"]
    for key, true in SPREAD[by].items():
        assert table[key] == pytest.approx(true, rel=0.25)
    assert selected(family.gain, family.rank, family.null) < 1e-12


@pytest.mark.slow
def test_where_nothing_varies_chances_are_even_and_the_evidence_is_no_better():
    chances, gained = [], []
    for seed in range(20):
        data = dragged(100 + seed)
        family = Varying().propose(view_of(data, GRAVITY, DRAG, seed=seed))
        chances.append(selected(family.gain, family.rank, family.null))
        plain, own = (Hypothesis.from_laws(data, [GRAVITY, f"-b{k} * v_i"]) for k in ("", "[body]"))
        heights = [log_evidence(fit(h, data), h) for h in (plain, own)]
        gained.append(heights[1] - heights[0] + family.proposals[0].log_prior)
    assert 2 <= sum(p < 0.5 for p in chances) <= 18  # 10 are expected
    assert sum(p < 0.01 for p in chances) <= 2
    assert np.mean(np.array(gained) > 0) <= 0.1


def test_evidence_of_what_varies_does_not_depend_on_units():
    data, gains = dragged(5, "body"), []
    for told, g in ((data, "9.81"), (in_feet(data), repr(9.81 / 0.3048))):
        weight = f"-{g} [m/s^2] * m_i * e_y"
        parts = [Hypothesis.from_laws(told, [weight, f"-b{k} * v_i"]) for k in ("", "[body]")]
        heights = [log_evidence(fit(h, told), h) for h in parts]
        gains.append(heights[1] - heights[0])
    assert gains[0] > 100
    assert gains[0] == pytest.approx(gains[1], abs=1e-4)


def test_what_varies_can_be_taken_back():
    data = dragged(8, "body")
    plain, own = (Hypothesis.from_laws(data, [GRAVITY, f"-b{k} * v_i"]) for k in ("", "[body]"))
    back = continued(plain, fit(own, data))
    assert np.isnan(back.law.constants["b"])
    assert fit(back, data).status == "refuted"


def test_one_body_a_scene_is_one_proposal_with_a_tie():
    data = dragged(6)
    own = tuple(
        Scene(s.name, s.times, s.positions[:, [k]], (s.entities[k],))
        for k, s in enumerate(data.scenes)
    )
    family = Varying().propose(view_of(Dataset("own", own, noise=(SIGMA,), units=SI), DRAG))
    assert [p.code for p in family.proposals] == ["constant_per_body"]
    assert family.proposals[0].ties == ("-b[scene] * v_i",)


@pytest.mark.slow
def test_the_loop_adopts_drag_of_each_body():
    report = close_loop(
        dragged(7, "body", 5), [GRAVITY, DRAG], rng=np.random.default_rng(0), n_bootstrap=0,
        max_levels=4,
    )  # fmt: skip
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.code == "constant_per_body"
    assert report.stop_reason == "nothing_left"
    told = {c.entity: c for c in report.constants}
    for body, true in SPREAD["body"].items():
        assert told[body].low - 0.01 < true < told[body].high + 0.01
    assert report.total["ratio"].value < 0.5
