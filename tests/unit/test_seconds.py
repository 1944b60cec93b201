"""Two causes at once, where a first one alone leaves much of what is missing."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.demo import _parts
from bsp_gp.loop.proposal import Proposal, both_of
from bsp_gp.loop.proposers.hidden import pulls_of
from bsp_gp.loop.turn import Turn
from bsp_gp.physics.bodies import stack
from bsp_gp.planning.means import Body, Experiment, means_from
from tests.loop_views import GRAVITY, throws, view_of

PULL, WIND, SIGMA = 9.0, 0.07, 0.3


def round_a_heavy_body(n_scenes, rng):
    """Three bodies on orbits and three probes, beside a heavy body at rest and in a wind.

    Ten places each, a second apart, of which the first is known.
    """
    means = means_from({
        "bodies": {"body": {"x": 0.0, "y": 0.0}}, "look": {"until": 10.0, "noise": SIGMA}
    })  # fmt: skip
    angle, radius = rng.uniform(0, 2 * np.pi, 3), rng.uniform(3, 14, 3)
    out, along = np.stack([np.cos(angle), np.sin(angle)], 1), np.sqrt(PULL) * rng.uniform(0.8, 1.1)
    places, speeds = radius[:, None] * out, along * np.stack([-out[:, 1], out[:, 0]], 1)
    times, scenes = np.arange(1.0, 11.0), []

    def rate(_, z):
        p, v = z.reshape(2, -1, 2)
        a = -PULL * p / np.square(p).sum(axis=1, keepdims=True) + (WIND, 0.0)
        return np.concatenate([v.ravel(), a.ravel()])

    for k in range(n_scenes):
        p = np.vstack([places, rng.uniform(-15, 15, (3, 2))])
        v = np.vstack([speeds, rng.uniform(-2, 2, (3, 2))])
        found = solve_ivp(rate, (0, 10), np.concatenate([p.ravel(), v.ravel()]), t_eval=times,
                          rtol=1e-8, atol=1e-9).y  # fmt: skip
        seen = found[: p.size].T.reshape(len(times), -1, 2)
        seen = np.concatenate([p[None], seen + SIGMA * rng.standard_normal(seen.shape)])
        crew = [Body("heavy", (0.0, 0.0), (0.0, 0.0), {"mass": 1e7}, True)]
        crew += [Body(f"body {j}", tuple(p[j]), tuple(v[j]), {"mass": float(1 + j % 3)})
                 for j in range(len(p))]  # fmt: skip
        whole = np.concatenate([np.zeros((len(seen), 1, 2)), seen], axis=1)
        made = Experiment(tuple(crew), (0.0, *times))
        scenes.append(made.scene(str(k), whole, sigma=np.full(whole.shape, SIGMA)))
    return means.dataset(scenes)


@pytest.mark.slow
def test_a_pull_and_a_wind_are_found_though_neither_alone_is_likely():
    data = round_a_heavy_body(6, np.random.default_rng(5))
    found = bsp_gp.close_loop(data, rng=0, n_bootstrap=0)
    assert found.verdict == "effect adopted"
    law = found.fit.law
    place, still = np.array([[[4.0, 0.0], [0.0, 0.0]]]), np.zeros((1, 2, 2))
    probe = Experiment((Body("a", (4.0, 0.0), (0.0, 0.0), {"mass": 1.0}),
                        Body("heavy", (0.0, 0.0), (0.0, 0.0), {"mass": 1e7}, True)),
                       (0.0, 1.0, 2.0)).scene("x")  # fmt: skip
    (batch,) = stack((probe,))
    force = law.acceleration(batch.bodies, place, still, np.zeros(1))[0, 0]
    assert force == pytest.approx([-PULL / 4 + WIND, 0.0], abs=0.03)


@pytest.mark.parametrize(
    ("left", "formulas", "count"), [(9.0, ("f",), 1), (1.2, ("f",), 0), (9.0, ("f", "g"), 0)]
)
def test_a_second_is_asked_for_beside_single_laws_that_leave_much(left, formulas, count):
    rows = [
        SimpleNamespace(id=k, is_fit=True, log_posterior=float(k), source="laws") for k in (0, 1, 2)
    ]
    proposals = {
        1: SimpleNamespace(code="period", formulas=(), lead="p"),
        2: SimpleNamespace(code="law", formulas=formulas, lead="f"),
    }
    turn = SimpleNamespace(
        rows=rows, proposals=proposals, fits={1: 20.0, 2: left}, _left=lambda found: found
    )
    assert [row.id for row in Turn._firsts(turn)] == [2] * count


def test_terms_of_the_demo_are_told_apart_also_where_they_have_a_place():
    place = "norm(origin + centre_x1 * e_x - p_i)"
    assert _parts(f"c1 * a + c2 * {place} * b") == ["c1 * a", f"c2 * {place} * b"]


def test_two_causes_are_one_with_the_terms_of_both():
    first = Proposal("law", "a", None, -2.0, 10.0, formulas=("f",), starts={"a": 1.0})
    second = Proposal("law", "b", "both", -3.0, 4.0, 2, {"b": 2.0}, formulas=("g",))
    both = both_of(first, second)
    assert (both.text, both.hypothesis, both.formulas) == ("a + b", "both", ("f", "g"))
    assert (both.log_prior, both.gain, both.rank) == (-5.0, 14.0, 3)
    assert both.starts == {"b": 2.0}  # the first begins where it was found


def test_a_force_that_hangs_on_no_place_is_no_pull_of_an_unseen_body():
    data = throws(np.random.default_rng(0), n_bodies=2)
    assert pulls_of(view_of(data, GRAVITY, "-c * (v_i - v_j)"), "M") == []
    assert len(pulls_of(view_of(data, GRAVITY, "-k * (p_i - p_j)"), "M")) == 1
