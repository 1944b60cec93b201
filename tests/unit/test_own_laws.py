"""Laws of their own for each of two bodies: found body by body, and in noise alone not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.proposers.own_laws import OwnLaws
from bsp_gp.loop.view import selected
from tests.loop_views import throws, view_of
from tests.throws import SI

SIGMA = 0.01


def chases(n_scenes=4):
    """One hunts at a constant push, one flees as 1 / r; both slow down; per unit mass."""
    rng, scenes, t = np.random.default_rng(7), [], np.linspace(0.0, 3.0, 61)

    def rate(t, state):
        (p, q), (v, w) = state.reshape(2, 2, 2)
        apart = q - p
        r = np.linalg.norm(apart)
        hunts, flees = 0.8 * apart / r - 0.8 * v, 0.45 * apart / r**2 - 0.8 * w
        return np.concatenate([v, w, hunts, flees])

    for k in range(n_scenes):
        places = rng.uniform((-1, -1, 0.3, 0.3), (-0.3, -0.3, 1, 1))
        first = np.concatenate([places, rng.uniform(-0.5, 0.5, 4)])
        path = solve_ivp(rate, (0, 3), first, t_eval=t, rtol=1e-9).y[:4].T.reshape(-1, 2, 2)
        path = path + SIGMA * rng.standard_normal(path.shape)
        scenes.append(Scene(str(k), t, path, (Entity("pike"), Entity("roach"))))
    return Dataset("chases", tuple(scenes), noise=(SIGMA,), units=SI)


@pytest.mark.slow
def test_a_hunter_and_its_prey_have_laws_of_their_own():
    report = close_loop(chases(), "-c * v_i", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert report.rounds[0].effect.code == "law_by_body"
    found = {(c.name.split("[")[0], c.entity): c for c in report.constants}
    law = report.law_text
    hunts = next(n for n in ("c1", "c2") if f"{n}[body] * normalize(p_i - p_j)" in law)
    flees = next(n for n in ("c1", "c2") if n != hunts)
    assert f"{flees}[body] * (norm(p_i - p_j)^-1 * normalize(p_i - p_j))" in law
    assert found[hunts, "pike"].value == pytest.approx(-0.8, abs=0.03)
    assert found[flees, "roach"].value == pytest.approx(0.45, abs=0.03)
    assert abs(found[hunts, "roach"].value) < 0.03
    assert report.rounds[-1].reason == "not_significant"


@pytest.mark.slow
def test_noise_alone_has_no_laws_of_its_own():
    grammar, chances = load_grammar("physics"), []
    for seed in range(6):
        data = throws(np.random.default_rng([32, seed]), n_bodies=2)
        view = view_of(data, seed=seed)
        laws = Laws(grammar, data)
        laws.propose(view)
        family = OwnLaws(laws).propose(view)
        assert family.proposals == ()
        chances.append(selected(family.gain, family.rank, family.null, view.noise_dof))
    assert min(chances) > 0.003
