"""A wrong declared term is put out of the law where the found one explains the data alone."""

import numpy as np
import pytest

from bsp_gp.language.render import to_text
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.replacing import blurred_constants
from tests.unit.test_rounds import fit
from tests.worlds import WEIGHT, flights, linear_drag


def friction(t, p, v, m, q, c=1.0):
    return -c * v / np.linalg.norm(v)


def both(t, p, v, m, q):
    return friction(t, p, v, m, q) + linear_drag(t, p, v, m, q)


def close(force, *laws, seed):
    return close_loop(
        flights(seed, force), laws, rng=np.random.default_rng(seed), max_levels=6, n_null=99
    )


def declared_terms(report):
    return [to_text(t.formula) for t in report.law.terms if t.is_declared]


@pytest.mark.parametrize(
    ("force", "declared", "name"),
    [
        (linear_drag, "f0 * normalize(v_i)", "drag, linear in speed"),
        (friction, "f0 * v_i", "friction of constant size"),
    ],
)
def test_a_wrong_declared_friction_is_replaced_by_the_true_one(force, declared, name):
    report = close(force, WEIGHT, declared, seed=1)
    first = report.rounds[0]
    assert first.adopted
    assert first.effect.name == name
    assert "takes the place of the declared" in first.reason
    assert first.rivals[0].kind == "declared_term_change"
    assert first.rivals[0].reason.startswith("refuted")
    assert first.rivals[0].delta_bic > 0
    assert len(declared_terms(report)) == 1  # the weight, whose number is believed
    assert first.after.rollout_rmse < 1.1 * first.floor.rollout_rmse
    assert report.rounds[-1].effect is None


def test_a_true_declared_friction_stays_beside_what_is_found():
    report = close(both, WEIGHT, "f0 * normalize(v_i)", seed=1)
    first = report.rounds[0]
    assert first.adopted
    assert first.effect.name == "drag, linear in speed"
    assert "takes the place" not in first.reason
    assert len(declared_terms(report)) == 2


def test_blurred_constants_are_named_with_both_errors():
    before = fit(1.0, [10.0, 5.0], [0.1, 0.1])
    after = fit(1.0, [10.0, 5.0, 1.0], [5.0, 0.1, 0.1])
    assert blurred_constants(before, after) == [
        ("c1", pytest.approx(0.01), pytest.approx(0.5)),
    ]
