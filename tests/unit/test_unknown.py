"""None of these: what nobody lists, beside a law at its own fit."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.decide import share_of_listed
from bsp_gp.loop.proposal import continued, with_term
from bsp_gp.loop.table import HypothesisTable, Row
from bsp_gp.loop.unknown import Unknown, unknowns
from bsp_gp.loop.view import View
from bsp_gp.physics.force import Term
from tests.fitted_tracks import law_of
from tests.loop_views import GRAVITY
from tests.unit.test_constancy import LINEAR, SQUARED, thrown

CRITERIA = Criteria()
BASE = Row(0, "base", "", "", "converged", 0.0, 0.0, -250.0, 4)
BEST = Row(1, "law", "c1 * v_i", "laws", "converged", 50.0, -3.0, -190.0, 5, key=("law", "1"))


def beside(dataset, law):
    """What nobody lists beside gravity and a law, and the view of their fit."""
    formula = law_of(f"c1 * ({law})").terms[0].formula
    hypothesis = Hypothesis.from_laws(dataset, (GRAVITY,))
    without = fit(hypothesis, dataset)
    hypothesis = with_term(hypothesis, Term(formula), {"c1": -0.05})
    found = fit(hypothesis, dataset)
    view = View(found, continued(hypothesis, found), dataset, np.random.default_rng(0))
    gain = 2 * (found.log_likelihood - without.log_likelihood)
    return {one.code: one for one in unknowns(view, found.law.terms[1:], gain)}


@pytest.mark.parametrize(("law", "power"), [(LINEAR, 1.0), (SQUARED, 2.0)])
def test_beside_a_true_law_nothing_is_likelier_than_it(law, power):
    for seed in range(3):
        data = thrown(lambda t, p, v: 0.15 * v ** (power - 1), seed)
        found = beside(data, law)
        assert set(found) == {"varying_strength", "free_force"}
        assert all(one.log_odds < 0 for one in found.values())


@pytest.mark.parametrize(
    ("drag", "variable"),
    [(lambda t, p, v: 0.05 + 0.2 * t, "time"), (lambda t, p, v: 0.2 * np.exp(-p[1] / 2), "y")],
)
def test_a_strength_that_varies_is_told_with_its_variable(drag, variable):
    found = beside(thrown(drag), LINEAR)["varying_strength"]
    assert found.variable == variable and found.log_odds > 10


def test_a_force_of_no_listed_form_is_seen_beside_the_law():
    data = thrown(lambda t, p, v: 0.15)
    scenes = []
    for scene in data.scenes:  # pushed to and fro along x, whatever the velocity
        t = scene.times
        places = np.array(scene.positions)
        places[:, 0, 0] += 0.05 * np.sin(6.0 * t)
        scenes.append(replace(scene, positions=places))
    found = beside(replace(data, scenes=tuple(scenes)), LINEAR)["free_force"]
    assert (found.direction, found.variable) == ("e_x", "time") and found.log_odds > 10


@pytest.mark.slow
def test_odds_do_not_hang_on_units_of_length():
    data = thrown(lambda t, p, v: 0.15 + 0.1 * np.tanh(p[0]))
    feet = [replace(s, positions=s.positions / 0.3048) for s in data.scenes]
    other = replace(data, scenes=tuple(feet), noise=(data.noise[0] / 0.3048,))
    gravity = f"{-9.81 / 0.3048} [m/s^2] * m_i * e_y"
    formula = law_of(f"c1 * ({LINEAR})").terms[0].formula

    def odds(dataset, declared):
        hypothesis = with_term(
            Hypothesis.from_laws(dataset, (declared,)), Term(formula), {"c1": -0.05}
        )
        found = fit(hypothesis, dataset)
        view = View(found, continued(hypothesis, found), dataset, np.random.default_rng(0))
        return [one.log_odds for one in unknowns(view, found.law.terms[1:], 900.0)]

    assert np.allclose(odds(data, GRAVITY), odds(other, gravity), rtol=1e-3, atol=1e-3)


def test_rows_of_the_table_share_the_probability():
    table = HypothesisTable((BASE, BEST), 1e-6)
    nothing = table.beside(BEST, (), CRITERIA)
    assert nothing.rows[1].probability > 0.99 and share_of_listed(nothing, BEST) == (1.0, None)
    far = Unknown("free_force", None, "along", "time", -8.0)
    near = Unknown("varying_strength", law_of("c1 * v_i").terms[0].formula, "", "y", 3.0)
    with_far = table.beside(BEST, (far,), CRITERIA)
    share, likeliest = share_of_listed(with_far, BEST)
    assert share > CRITERIA.sure and likeliest.code == "free_force"
    assert with_far.rows[1].probability == pytest.approx(share, abs=1e-6)
    with_both = table.beside(BEST, (far, near), CRITERIA)
    share, likeliest = share_of_listed(with_both, BEST)
    assert share == pytest.approx(1 / (1 + np.exp(3.0 - CRITERIA.unknown_nats)), rel=1e-3)
    assert likeliest.code == "varying_strength" and not likeliest.is_fit
    assert sum(row.probability for row in with_both.rows) == pytest.approx(1.0)
    assert len({row.id for row in with_both.rows}) == 4


@pytest.mark.slow
def test_a_report_holds_the_rows_and_what_may_still_be_hidden():
    data = thrown(lambda t, p, v: 0.15, n_scenes=8)
    report = close_loop(data, (GRAVITY,), rng=np.random.default_rng(0), n_bootstrap=0, max_rounds=1)
    (done,) = report.rounds
    codes = {row["code"] for row in done.hypotheses if row["status"] == "linearised"}
    assert codes == {"varying_strength", "free_force"}
    assert sum(row["probability"] for row in done.hypotheses) == pytest.approx(1.0)
    assert report.probability == done.effect.probability
    # Beside the law that was adopted little is left, beside the declared one there was much.
    assert 0 < report.hidden_bound["snr"] < 0.5 * done.hidden_bound["snr"]
