"""Whether what was found has the same strength everywhere, and which powers the data allow."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.constancy import constancy, powers_beside
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.proposal import continued, with_term
from bsp_gp.loop.proposers.exponents import power_of
from bsp_gp.loop.view import View
from bsp_gp.loop.writing_up import judged_together
from bsp_gp.physics.force import Term
from bsp_gp.units import Unit
from tests.fitted_tracks import law_of
from tests.loop_views import GRAVITY
from tests.throws import SI

SIGMA, MASS = 0.002, 0.3
LINEAR, SQUARED = "norm(v_i) * normalize(v_i)", "norm(v_i)^2 * normalize(v_i)"


def thrown(drag, seed=0, n_scenes=6, n_rows=60):
    """Throws with a drag ``drag(t, place, speed)`` per unit of velocity, m/s^2 per m/s."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.5, n_rows)
    scenes = []
    for s in range(n_scenes):
        start = [*rng.uniform((-1, 3), (1, 5)), *rng.uniform((-8, 1), (8, 9))]

        def rate(time, y):
            v = y[2:]
            return [*v, *(np.array([0.0, -9.81]) - drag(time, y[:2], np.hypot(*v)) * v)]

        exact = solve_ivp(rate, (0, t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-11).y[:2].T
        places = exact[:, None] + SIGMA * rng.standard_normal((n_rows, 1, 2))
        scenes.append(Scene(str(s), t, places, (Entity("ball", properties={"mass": MASS}),)))
    return Dataset("thrown", tuple(scenes), noise=(SIGMA,), units=SI)


def found_in(dataset, law):
    """The constancy of a law that was found beside gravity."""
    formula = law_of(f"c1 * ({law})").terms[0].formula
    hypothesis = Hypothesis.from_laws(dataset, (GRAVITY,))
    hypothesis = with_term(hypothesis, Term(formula), {"c1": -0.05})
    fitted = fit(hypothesis, dataset)
    view = View(fitted, continued(hypothesis, fitted), dataset, np.random.default_rng(0))
    return constancy(view)


def test_powers_are_read_off_factors():
    text = "c1 * (inverse(norm(p_i - p_j)^2) * norm(p_i - p_j) * (p_i - p_j))"
    (base,) = (part for part in law_of("norm(p_i - p_j) * e_x").terms[0].formula.args
               if part.type.shape == "scalar")  # fmt: skip
    assert power_of(base, law_of(text).terms[0].formula) == 0.0, "the vector has a length as well"
    unit = text.replace("(p_i - p_j))", "normalize(p_i - p_j))")
    assert power_of(base, law_of(unit).terms[0].formula) == -1.0


@pytest.mark.parametrize(("law", "power"), [(LINEAR, 1.0), (SQUARED, 2.0)])
def test_a_true_law_is_constant_and_its_power_within_the_interval(law, power):
    answers = []
    for seed in range(4):
        data = thrown(lambda t, p, v: 0.15 * v ** (power - 1), seed)
        found = found_in(data, law)
        (speed,) = found.exponents
        assert to_text(speed.of) == "norm(v_i)" and speed.stated == power
        answers.append((speed.value - power) / speed.error)
        assert min(v.p_value for v in found.varies) > 1e-3
    assert np.abs(answers).max() < 3.5 and np.std(answers) > 0.1


@pytest.mark.parametrize("law", [LINEAR, SQUARED])
def test_a_power_between_is_told(law):
    found = found_in(thrown(lambda t, p, v: 0.15 * v**0.5), law)
    (speed,) = found.exponents
    assert speed.low < 1.5 < speed.high or abs(speed.value - 1.5) < 0.2  # to first order
    assert found.varies[0].p_value < 1e-6 and found.varies[0].share > 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drag", "variable"),
    [
        (lambda t, p, v: 0.2 * np.exp(-p[1] / 2.0), "y"),
        (lambda t, p, v: 0.05 + 0.2 * t, "time"),
        (lambda t, p, v: 0.15 + 0.1 * np.tanh(p[0]), "x"),
    ],
)
def test_the_variable_in_which_a_strength_changes_is_named(drag, variable):
    first = found_in(thrown(drag), LINEAR).varies[0]
    assert first.variable == variable and first.p_value < 1e-6


@pytest.mark.slow
def test_a_law_that_is_not_constant_is_a_description_only():
    data = thrown(lambda t, p, v: 0.15 + 0.12 * np.sin(2.5 * p[0]), n_scenes=8)
    report = close_loop(
        data, (GRAVITY,), rng=np.random.default_rng(0), n_bootstrap=0, max_rounds=1
    )
    (done,) = report.rounds
    assert done.adopted
    powers = [e for e in done.effect.exponents if e["of"] == "norm(v_i)"]
    assert powers and all(e["low"] < e["value"] < e["high"] for e in powers)
    assert not done.effect.is_fact, "the power is none of those that were tried"
    says_so = (report.verdict, done.reason) == ("effective law", "strength_varies")
    assert says_so == bool(done.effect.varies_with)


def test_a_power_is_as_stated_where_its_neighbours_are_excluded():
    (speed,) = found_in(thrown(lambda t, p, v: 0.15), LINEAR).exponents
    assert speed.is_as_stated(Criteria())
    assert not replace(speed, error=0.2).is_as_stated(Criteria()), "a half next to it may be"
    assert not replace(speed, value=1.5).is_as_stated(Criteria())
    near = replace(speed, value=1.002, error=1e-4)
    assert near.is_as_stated(Criteria()), "some weaker effect always shows"


@pytest.mark.slow
def test_what_stands_beside_a_description_is_none_the_surer():
    def drag(t, p, v):  # a function of two variables, which is bred of none
        return 0.15 + 0.12 * np.sin(2.5 * p[0]) * np.sin(2.5 * p[1])

    data = thrown(drag, n_scenes=8)
    report = close_loop(data, (GRAVITY,), rng=np.random.default_rng(0), n_bootstrap=0, max_rounds=2)
    first, second = report.rounds
    assert report.verdict == "effective law"
    assert first.reason == "strength_varies" and not first.effect.is_fact
    # Weight that differs from scene to scene makes up for what the description lacks, in these
    # scenes and in no others.
    assert not second.adopted and second.reason == "predictions_worse"
    adopted = replace(first, verdict="effect adopted", reason="adopted",
                      effect=replace(first.effect, is_fact=True))  # fmt: skip
    _, beside = judged_together([first, adopted])
    assert beside.verdict == "effective law" and beside.reason == "beside_description"
    assert not beside.effect.is_fact


def test_powers_of_forms_that_differ_in_nothing_else():
    types = input_types({"mass": Unit.of(kg=1)})

    def sum_of(*texts):
        return tuple(parse_formula(text, types) for text in texts)

    speed = parse_formula("norm(v_i)", types)
    own = sum_of("c1 * e_x", "c2 * (m_i * normalize(v_i))")
    rivals = [
        sum_of("c1 * (m_i * e_x)", "c2 * v_i"),
        sum_of("c2 * (norm(v_i)^3 * normalize(v_i))", "c1 * e_x"),
        sum_of("c1 * e_y", "c2 * v_i"), sum_of("c2 * v_i"),
        sum_of("c1 * e_x", "c2 * (dot(p_i - origin, e_x) * e_x)"),
    ]  # fmt: skip
    assert list(powers_beside(speed, own[1], own, rivals)) == [1.0, 3.0]
