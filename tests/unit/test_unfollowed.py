"""Laws that no path follows: what is missing is found all the same, from the data."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposal import continued
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.proposers.unfollowed import Unfollowed
from bsp_gp.loop.view import View

SIGMA, STEEP = 0.013, 0.011
PULL, STEEPER = "-GM * m_i * p_i / norm(p_i)^3", "-q * m_i * p_i / norm(p_i)^5"


def moons(seed=0):
    """Two moons of an oblate body, seen in nights over many turns of the inner one."""
    rng = np.random.default_rng(seed)
    nights = np.sort(rng.choice(80, 17, replace=False)) * 1.7
    times = np.sort(np.concatenate([night + rng.uniform(0, 0.9, 4) for night in nights]))
    tables = []
    for name, a, e, phase in (("inner", 1.0, 0.045, 0.4), ("outer", 2.0, 0.03, 2.0)):
        speed = np.sqrt((1 - e) / (1 + e) * (1 / a + STEEP / a**3))
        far, way = a * (1 + e), np.array([np.cos(phase), np.sin(phase)])
        start = [*far * way, *speed * np.array([-way[1], way[0]])]

        def rate(t, s):
            r = np.hypot(*s[:2])
            return [*s[2:], *(-s[:2] * (1 / r**3 + STEEP / r**5))]

        found = solve_ivp(rate, (0, times[-1]), start, t_eval=times, rtol=1e-11, atol=1e-12).y[:2]
        x, y = found + SIGMA * rng.standard_normal(found.shape)
        tables.append(pd.DataFrame({"t": times, "entity": name, "x": x, "y": y}))
    units = {"length": "m", "time": "s"}
    return bsp_gp.Dataset.from_frames({"sky": pd.concat(tables)}, None, units=units, noise=(SIGMA,))


def test_moments_of_sparse_nights_are_those_of_the_fit():
    """Forces are asked of what the fit leaves: no error of the way between nights is in it."""
    dataset = moons()
    hypothesis = Hypothesis.from_laws(dataset, (PULL, STEEPER))
    found = fit(hypothesis, dataset)
    assert found.status == "converged" and found.chi2_red < 1.4
    view = View(found, continued(hypothesis, found), dataset, np.random.default_rng(0))
    assert view.left @ view.left <= 1.01 * found.chisqr


def test_beside_a_law_that_no_path_follows_its_kin_are_tried_from_the_data():
    dataset = moons()
    hypothesis = Hypothesis.from_laws(dataset, (PULL,))
    found = fit(hypothesis, dataset, starts={"GM": 1.0})
    proposer = Unfollowed(Laws(load_grammar("physics"), dataset, max_levels=3))
    for status, count in (("converged", 0), ("unconverged", 7)):
        state = replace(found, status=status)
        view = View(state, continued(hypothesis, state), dataset, np.random.default_rng(0))
        proposals = proposer.propose(view).proposals
        assert len(proposals) >= count and bool(proposals) == bool(count)
        assert all(p.is_afresh and p.rank == 1 for p in proposals)
    texts = [p.text for p in proposals]
    assert "c1 * (m_i * norm(p_i - origin)^-4 * normalize(p_i - origin))" in texts
    assert not any("^-2 " in text for text in texts)  # what is declared


@pytest.mark.slow
def test_what_steepens_a_pull_is_found_over_many_turns():
    dataset = moons()
    report = close_loop(dataset, (PULL,), rng=0, n_bootstrap=0, max_rounds=2)
    assert report.verdict == "effect adopted"
    values = [c.value for c in report.constants]
    assert values[0] == pytest.approx(1.0, abs=0.02)
    assert values[1] == pytest.approx(-STEEP, rel=0.25)
    assert "norm(p_i - origin)^-4" in report.law_text
