"""Errors of the measurement as a proposer: what is proposed, where, and what chance shows."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.instrument import Instrument
from bsp_gp.fitting.tangent import instrument_columns
from bsp_gp.loop.criteria import CAUSES
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.proposers.measurement import Measurement, kinds_of
from bsp_gp.loop.view import View, selected
from bsp_gp.physics.force import Term
from tests.fitted_tracks import body, dataset_of, law_of, reference, scene_of

WEIGHT = "9.81 [m/s^2] * m_i * down"
SIGMA = 0.004


def throws(seed, change=lambda times, places: (times, places), n=5):
    rng = np.random.default_rng(seed)
    law, times, scenes = law_of(WEIGHT), np.linspace(0.0, 1.2, 30), []
    for k in range(n):
        start = np.array([[[0.0, 2.0]], [[rng.uniform(-3, 3), rng.uniform(2, 6)]]])
        scene = scene_of(times, (body("ball", rng.uniform(0.5, 2)),), start[0], str(k))
        seen_at, seen = change(times, reference(law, scene, *start, times)[0])
        seen = seen + SIGMA * rng.standard_normal(seen.shape)
        scenes.append(replace(scene, times=seen_at, positions=seen))
    return dataset_of(scenes, noise=(SIGMA, SIGMA))


def tilted(times, places, angle=0.01):
    c, s = np.cos(angle), np.sin(angle)
    return times, places @ np.array([[c, s], [-s, c]])


def viewed(data, *parts, seed=0):
    hypothesis = Hypothesis.from_laws(data, [WEIGHT])
    for part in parts:
        hypothesis = hypothesis + part
    found = fit(hypothesis, data)
    return View(found, continued(hypothesis, found), data, np.random.default_rng(seed))


def test_the_kind_that_is_there_comes_first():
    view = viewed(throws(1, tilted))
    family = Measurement().propose(view)
    best = family.proposals[0]
    assert best.code == "tilt" and best.rank == 1 and best.log_prior == -3.0
    assert best.gain == family.gain > 30
    assert family.n_tried == len(family.proposals) and len(family.null) == len(view.row_draws)
    assert selected(family.gain, family.rank, family.null, view.noise_dof) < 1e-6
    added = best.hypothesis.parts[-1]
    new = fit(best.hypothesis, view.dataset)
    assert added.values[0] == pytest.approx(0.01, abs=4 * new.errors[0])
    assert view.fit.chisqr - new.chisqr == pytest.approx(best.gain, rel=0.02)


def test_codes_priors_bounds_and_starts():
    data = throws(1, tilted)
    family = Measurement().propose(viewed(data))
    kinds = kinds_of(data, viewed(data).fit)
    counts = {code: sum(part.code == code for part in kinds) for code in {p.code for p in kinds}}
    assert counts["slant"] == counts["perspective"] == 2
    assert counts["drift"] == counts["scale"] == counts["clock"] == 2  # of all, and in each scene
    assert "offset" not in counts and "delay" not in counts  # nothing fixed, one body
    for p in family.proposals:
        assert p.code in CAUSES
        part = p.hypothesis.parts[-1]
        n = len(data.scenes) if len(part.whose) == 1 else 1 if part.whose else counts[p.code]
        n = 1 if p.code in ("drift", "scale", "clock") and not part.whose else n
        n_causes = 2 if p.code in ("decentred", "zoom") else 1
        assert p.log_prior == pytest.approx(-3.0 * n_causes - np.log(n))
        for number in part.parameters:
            assert number.low <= number.start <= number.high
    # Bodies that fall in nothing are not seen to drift: their initial states take it up.
    assert "drift" not in {p.code for p in family.proposals}


def test_columns_are_what_a_part_does_to_the_tracks():
    view = viewed(throws(2))
    (column,) = instrument_columns(view.fit, Instrument("scale"))
    places = view.fit.channels.axis == 1
    moved = np.where(view.fit.channels.seen, column, 0.0)
    # In the lengths that are seen g is larger by the factor, from the same initial state.
    times = view.fit.channels.times
    assert np.abs(moved[:, ~places]).max() < 1e-9
    np.testing.assert_allclose(moved[:, places], (-9.81 / 2 * times**2)[:, places], atol=1e-6)


def test_what_is_adopted_is_not_proposed_again():
    data = throws(1, tilted)
    first = Measurement().propose(viewed(data)).proposals[0]
    family = Measurement().propose(viewed(data, first.hypothesis.parts[-1]))
    assert "tilt" not in {p.code for p in family.proposals} and family.gain < 12


def test_an_exposure_that_were_negative_is_not_proposed():
    data = throws(1)
    view = viewed(data)
    step = np.diff(data.scenes[0].times)[0]
    part = Instrument("exposure", (), (3 * step) ** 2)
    assert part.parameters[0].low == 0.0
    for p in Measurement().propose(view).proposals:
        values = p.hypothesis.parts[-1].values
        assert p.code != "exposure" or values[0] > 0


@pytest.mark.slow
def test_chance_is_counted_over_all_kinds():
    chances = []
    for seed in range(12):
        view = viewed(throws(100 + seed), seed=seed)
        family = Measurement().propose(view)
        chances.append(selected(family.gain, family.rank, family.null, view.noise_dof))
    assert min(chances) > 1e-3 and np.median(chances) > 0.1


def test_rounds_adopt_a_tilt_and_then_nothing():
    data = throws(1, tilted)
    rounds = run_rounds(
        Hypothesis.from_laws(data, [WEIGHT]), data, [Measurement()], rng=np.random.default_rng(0)
    )
    assert [r.decision.verdict for r in rounds] == ["effect adopted", "nothing missing"]
    assert rounds[0].decision.best.code == "tilt"
    kept = [p for p in rounds[1].hypotheses[0].parts if isinstance(p, Instrument)]
    assert [p.code for p in kept] == ["tilt"]


def test_scale_and_clock_do_the_same_to_a_fall():
    data = throws(1, lambda times, places: (1.01 * times, places))
    rounds = run_rounds(
        Hypothesis.from_laws(data, [WEIGHT]), data, [Measurement()], rng=np.random.default_rng(0),
        max_rounds=1,
    )  # fmt: skip
    decision = rounds[0].decision
    told = {row.code: row.log_posterior for row in (decision.best, *decision.rivals)}
    assert {"clock", "scale"} <= set(told) and not decision.is_fact
    assert abs(told["clock"] - told["scale"]) < 0.1


def test_a_camera_is_turned_against_directions_that_are_declared_alone():
    """What was found to act along an axis turns with the camera: nothing else tells the turn."""
    view = viewed(throws(1))
    isotropic = replace(view.fit, law=law_of("-c1 * v_i").with_constants({"c1": 0.1}))
    added = replace(isotropic, law=isotropic.law.plus(Term(law_of("c2 * e_x").terms[0].formula)))
    for found, count in ((view.fit, 1), (isotropic, 0), (added, 0)):
        codes = [part.code for part in kinds_of(view.dataset, found)]
        assert codes.count("tilt") == count


@pytest.mark.parametrize("code", ["scale", "clock"])
def test_one_recording_alone_may_have_a_scale_or_a_clock_of_its_own(code):
    """Lengths of one scene of five had been a camera that drifts, another weight, and a kick."""
    data = throws(2)
    odd, *others = data.scenes
    change = {"positions": 1.04 * odd.positions} if code == "scale" else {"times": odd.times / 1.04}
    data = replace(data, scenes=(replace(odd, **change), *others))
    family = Measurement().propose(viewed(data))
    best = family.proposals[0]
    assert best.code in ("scale", "clock") and best.rank == 1  # a weight alone tells them not apart
    part = best.hypothesis.parts[-1]
    assert part.whose == (odd.name,)
    new = fit(best.hypothesis, data)
    assert new.chi2_red < 1.3
    expected = 0.04 if code == "scale" else 1.04**2 - 1  # of the weight, as a scale
    known = {"scale": expected, "clock": 1 / np.sqrt(1 + expected) - 1}
    assert part.values[0] == pytest.approx(known[best.code], abs=0.01)


def test_a_part_of_scenes_does_nothing_in_others():
    data = throws(1)
    view = viewed(data)
    names = tuple(scene.name for scene in data.scenes)
    for code in ("scale", "clock", "drift"):
        part = Instrument(code, (0, 1) if code == "drift" else (), whose=names)
        columns = instrument_columns(view.fit, part)
        (first, *_) = instrument_columns(view.fit, replace(part, whose=names[:1]))
        np.testing.assert_allclose(columns[0], first, atol=1e-12)
        other = view.fit.channels.scene != list(view.fit.channels.scene_names).index(names[0])
        assert not columns[0][:, other].any()
