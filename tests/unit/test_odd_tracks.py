"""One odd track, of which more is missing than of all others, hides no law of textbooks."""

import numpy as np
import pytest

from bsp_gp.fitting.parts.cut_short import CutShort
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.render import to_text
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.proposers.odd_tracks import without_odd_track
from tests.fitted_tracks import body, dataset_of, scene_of
from tests.loop_views import view_of

PUSH = 0.3


def pushed(odd, n_scenes=6, sigma=0.002, longest=None):
    """Bodies under a uniform push along x; that of scene `odd` is struck on its way."""
    rng, scenes = np.random.default_rng(2), []
    for k in range(n_scenes):
        times = np.linspace(0.0, 5.0 if k == longest else 1.0, 31)
        x = rng.uniform(-1, 1) + rng.uniform(-1, 1) * times + 0.5 * PUSH * times**2
        y = rng.uniform(-1, 1) + rng.uniform(-1, 1) * times
        if k == odd:
            x, y = x - 8 * np.maximum(times - 0.5, 0), y + 6 * np.maximum(times - 0.5, 0)
        places = np.stack([x, y], axis=1)[:, None]
        places = places + rng.normal(0, sigma, places.shape)
        scenes.append(scene_of(times, (body("ball"),), places, name=f"s{k}"))
    return dataset_of(tuple(scenes), noise=(sigma,))


def without_one(data):
    family = Laws(load_grammar("physics"), data).propose(view_of(data, "nothing"))
    return [p for p in family.proposals if any(isinstance(c, CutShort) for c in p.hypothesis.parts)]


def test_a_law_that_explains_all_tracks_but_one_is_proposed_with_that_one_cut():
    data = pushed(odd=3)
    (proposal,) = without_one(data)
    assert to_text(*proposal.formulas) in ("c1 * e_x", "c1 * (m_i * e_x)")
    (cut,) = (part for part in proposal.hypothesis.parts if isinstance(part, CutShort))
    assert (cut.scene, cut.bodies) == ("s3", ("ball",)) and 13 <= cut.row <= 17
    found = proposal.fitted(view_of(data, "nothing").near, data, criteria=Criteria())
    assert found.status == "converged"
    assert found.values[0] == pytest.approx(PUSH, rel=0.05)


@pytest.mark.parametrize(
    "data", [pushed(odd=None), pushed(odd=0, n_scenes=3), pushed(odd=None, longest=2)]
)
def test_no_track_is_cut_where_none_is_odd_or_they_are_few(data):
    """Nor where most is missing of one that lasts longer, and the law explains it too."""
    assert not without_one(data)


def test_a_grammar_without_laws_of_textbooks_has_none_to_propose():
    chosen, _, gain, cut = without_odd_track(view_of(pushed(odd=3), "nothing"), [], None)
    assert chosen == () and gain == 0.0 and cut is None
