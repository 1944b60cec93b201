"""Other laws beside one that leaves nothing: told at its tracks as their own fits would tell."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.proposers.inside import Inside
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.rivals import Explained
from bsp_gp.loop.table import Row
from tests.loop_views import view_of
from tests.throws import SI

SPRING = "-k * (p_i - origin)"
DRAG = "c1 * (norm(v_i) * normalize(v_i))"


def bobs(rate, n_scenes=3, sigma=0.001):
    """A mass on a spring, 12.4 N/m, about 0.58 m where the law says 0, with ``rate(v)`` beside."""
    rng, scenes, t = np.random.default_rng(5), [], 0.05 * np.arange(120)
    for k in range(n_scenes):
        first = [0.58 + rng.uniform(0.05, 0.15), rng.uniform(-0.5, 0.5)]
        path = solve_ivp(
            lambda t, s: [s[1], (-12.4 * (s[0] - 0.58) + rate(s[1])) / 0.25],
            (0, t[-1]), first, t_eval=t, rtol=1e-10, atol=1e-12,
        ).y[0]  # fmt: skip
        seen = np.stack([path + sigma * rng.standard_normal(len(t)), 0 * t], axis=1)[:, None]
        scenes.append(Scene(str(k), t, seen, (Entity("bob", properties={"mass": 0.25}),)))
    return Dataset("bobs", tuple(scenes), noise=(sigma,), units=SI)


@pytest.mark.slow
def test_losses_are_those_of_fits():
    data, criteria = bobs(lambda v: 0.0), Criteria()
    view = view_of(data, SPRING)
    family = Laws(load_grammar("physics"), data).propose(view)
    chosen = [p for p in family.proposals if p.promise > family.proposals[0].promise - 5000]
    push = next(p for p in chosen if p.text == "c1 * e_x")

    def fitted(proposal):
        found = proposal.fitted(view.near, data, criteria=criteria)
        return found, log_evidence(found, proposal.hypothesis, criteria)

    found, evidence = fitted(push)
    assert found.chi2_red == pytest.approx(1.0, abs=0.2)
    row = Row(1, "law", push.text, "laws", found.status, evidence, push.log_prior,
              found.log_likelihood, found.n_free)  # fmt: skip
    told = Explained(row, push, found, data)
    assert told.loss(push) == pytest.approx(0.0, abs=1e-6)
    others = [p for p in chosen if p is not push and abs(told.loss(p)) < 30][:3]
    assert others
    for proposal in others:
        other, _ = fitted(proposal)
        if other.status == "converged":
            loss = found.log_likelihood - other.log_likelihood
            assert told.loss(proposal) == pytest.approx(loss, abs=2.0)


@pytest.mark.slow
def test_far_from_the_tracks_the_plain_law_is_fitted_and_no_sum_beside_it():
    report = close_loop(bobs(lambda v: 0.0), SPRING, rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    first = report.rounds[0]
    assert first.effect.law == "c1 * e_x"
    laws = [h for h in first.hypotheses if h["code"] == "law" and h["source"] != "swings"]
    sums = [h for h in laws if "c2" in h["law"]]
    assert not sums  # neither fitted nor told


@pytest.mark.slow
@pytest.mark.parametrize(("power", "is_included"), [(1.0, True), (1.6, False)])
def test_a_free_power_is_passed_over_only_where_it_gains_nothing(power, is_included):
    data, criteria = bobs(lambda v: -0.05 * np.sign(v) * np.abs(v) ** power), Criteria()
    view = view_of(data, "-k * (x_i - 0.58 [m]) * e_x")
    laws = Laws(load_grammar("physics"), data)
    linear = next(p for p in laws.propose(view).proposals if p.text == DRAG)
    inside = Inside(laws, data).propose(view).proposals
    free = next(p for p in inside if "norm(v_i)^n1 * normalize(v_i)" in p.text)
    found = linear.fitted(view.near, data, criteria=criteria)
    evidence = log_evidence(found, linear.hypothesis, criteria)
    row = Row(1, "law", linear.text, "laws", found.status, evidence, linear.log_prior,
              found.log_likelihood, found.n_free)  # fmt: skip
    told = Explained(row, linear, found, data)
    assert told.includes(free) is is_included
    assert not told.includes(linear)
