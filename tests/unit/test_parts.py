"""A part of the rows of long recordings, and what was found in it carried over to all."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp import close_loop
from bsp_gp.data.parts import MOST_ROWS, WINDOW, part_of
from bsp_gp.fitting.hypothesis import Forces, read_law
from bsp_gp.fitting.parts.cut_short import CutShort
from bsp_gp.language.formula import Call, Constant
from bsp_gp.loop.carried import _is_of_all_scenes
from bsp_gp.loop.looks import AGAIN
from bsp_gp.physics.force import ForceLaw, Term, split_linear
from tests.fitted_tracks import body, dataset_of, scene_of

STIFF = 9.0


def swung(n_rows, n_scenes, name="bob", rng=None):
    """Bobs on springs, n rows each, too rough to be averaged."""
    rng, times = rng or np.random.default_rng(3), 0.05 * np.arange(n_rows)
    scenes = []
    for k in range(n_scenes):
        phase, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 1.0)
        x = size * np.cos(np.sqrt(STIFF) * times + phase)
        places = np.stack([x, 0.0 * x], axis=1)[:, None]
        places[..., 0] += 0.01 * rng.standard_normal(places[..., 0].shape)
        scenes.append(scene_of(times, (body(name),), places, name=f"s{k}"))
    return dataset_of(tuple(scenes))


def test_a_part_is_of_scenes_that_are_spread_evenly():
    part = part_of(swung(300, 40))
    names = [scene.name for scene in part.scenes]
    assert sum(len(scene.times) for scene in part.scenes) == MOST_ROWS
    assert names[0] == "s0" and names[-1] == "s39" and len(names) == 10
    assert "3,000 of 12,000 rows" in part.notes[-1]


def test_a_long_recording_is_taken_in_windows():
    whole = swung(20 * WINDOW, 1)
    part = part_of(whole)
    assert [len(scene.times) for scene in part.scenes] == 5 * [WINDOW]
    assert {scene.part_of for scene in part.scenes} == {"s0"}
    assert part.scenes[0].times[0] == whole.scenes[0].times[0]
    assert part.scenes[-1].times[-1] == whole.scenes[0].times[-1]


@pytest.mark.parametrize("data", [
    swung(300, 19), replace(swung(300, 40), test=("s1",)), swung(MOST_ROWS, 2),
], ids=["few", "declared", "short"])  # fmt: skip
def test_no_part_is_taken_of_few_rows_or_of_a_declared_split(data):
    assert part_of(data) is None


@pytest.mark.slow
def test_what_a_part_shows_is_fitted_to_all_rows():
    data = swung(200, 40)
    report = close_loop(data, rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    (strength,) = (c for c in report.constants if c.name == "c1")
    assert abs(strength.value) == pytest.approx(STIFF, rel=0.01)
    assert not any("there was time" in note for note in report.dataset["notes"])
    assert report.residuals is None or len(report.residuals) > MOST_ROWS


@pytest.mark.slow
def test_where_the_time_does_not_do_for_all_rows_the_part_is_told(monkeypatch):
    monkeypatch.setattr("bsp_gp.loop.looks.AGAIN", 1e6 * AGAIN)
    report = close_loop(swung(200, 40), rng=0, n_bootstrap=0, time_limit=600.0)
    assert "rows" in report.left_out
    assert any("there was time for 3,000 of 8,000 rows" in n for n in report.dataset["notes"])
    assert any(abs(c.value) == pytest.approx(STIFF, rel=0.02) for c in report.constants)


@pytest.mark.parametrize("text, table, is_of_all", [
    ("c * v_i", {"c": -0.1}, True),
    ("c[body] * v_i", {"c[body]": {"bob": -0.1}}, True),
    ("c[scene] * v_i", {"c[scene]": {"s0": -0.1}}, False),
])  # fmt: skip
def test_a_force_with_a_number_of_a_scene_is_not_carried_over(text, table, is_of_all):
    data = swung(60, 4)
    (term,) = read_law(data, [text.replace("[scene]", "").replace("[body]", "")]).terms
    _, rest = split_linear(term.formula)
    own = Term(Call("mul", Constant(next(iter(table))), rest), "field")
    assert _is_of_all_scenes(Forces(ForceLaw((own,), table))) is is_of_all


def test_a_track_that_is_cut_is_not_carried_over():
    assert not _is_of_all_scenes(CutShort("s0", 4, bodies=("bob",), n_left_out=9, extent=1.0))
