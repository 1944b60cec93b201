"""Known first states: ``[initial]`` read, written, believed by fits and by their tangents."""

from dataclasses import replace

import numpy as np
import pytest

from bsp_gp.data.scene import FirstState
from bsp_gp.data.tables import load_dataset, save_dataset
from bsp_gp.errors import DataError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.response import respond
from tests.throws import C1, DRAG, GRAVITY, throws

SIGMA = 0.02


def _begun(dataset, error, is_placed=False):
    """The throws with their first velocities known."""
    scenes = [
        replace(s, first=FirstState([[3.0 + k, 4.0 - k]], np.full((1, 2), error), is_placed))
        for k, s in enumerate(dataset.scenes)
    ]
    return replace(dataset, scenes=tuple(scenes))


def _folder(path, initial, header="t,entity,x,y", more=""):
    path.mkdir()
    rows = "\n".join(f"{k / 10},ball,{k},{k * k}{more if k == 0 else ',' * more.count(',')}"
                     for k in range(5))  # fmt: skip
    (path / "trajectories.csv").write_text(f"{header}\n{rows}\n")
    units = '[units]\nlength = "cm"\ntime = "s"'
    (path / "dataset.toml").write_text(f"{units}\n[initial]\n{initial}\n")
    return path


def test_velocities_of_first_rows_are_read_in_the_units_of_the_data(tmp_path):
    header = "t,entity,x,y,vx,vy,svx,svy"
    path = _folder(tmp_path / "a", 'velocity = "measured"', header, ",30,-20,0.5,0.5")
    (scene,) = load_dataset(path).scenes
    assert scene.first.velocity == pytest.approx(np.array([[0.3, -0.2]]))
    assert scene.first.velocity_error == pytest.approx(0.005)
    assert not scene.first.is_placed


def test_bodies_that_are_let_go_need_no_columns(tmp_path):
    path = _folder(tmp_path / "a", 'position = "exact"\nvelocity = "rest"')
    (scene,) = load_dataset(path).scenes
    assert not scene.first.velocity.any() and not scene.first.velocity_error.any()
    assert scene.first.is_placed
    assert scene.rows(1, None).first is None  # what begins later is not known


@pytest.mark.parametrize("said", ["exact", "measured"])
def test_velocities_that_are_not_there_are_asked_for(tmp_path, said):
    path = _folder(tmp_path / "a", f'velocity = "{said}"')
    with pytest.raises(DataError, match="needs the column"):
        load_dataset(path)


def test_words_that_mean_nothing_are_refused(tmp_path):
    path = _folder(tmp_path / "a", 'velocity = "known"')
    with pytest.raises(DataError, match="velocity must be one of exact, measured, rest, unknown"):
        load_dataset(path)


@pytest.mark.parametrize("error", [0.0, 0.1])
def test_known_first_states_survive_a_folder(tmp_path, error):
    dataset = _begun(throws(noise=(SIGMA,)), error, is_placed=True)
    again = load_dataset(save_dataset(dataset, tmp_path / "a"))
    for one, other in zip(dataset.scenes, again.scenes, strict=True):
        assert np.array_equal(one.first.velocity, other.first.velocity)
        assert np.array_equal(one.first.velocity_error, other.first.velocity_error)
        assert other.first.is_placed


def test_known_velocities_make_a_constant_surer_and_are_part_of_chi_squared():
    free = throws(sigma=SIGMA, noise=(SIGMA,))
    found = {
        name: fit(Hypothesis.from_laws(data, [GRAVITY, DRAG]), data)
        for name, data in (
            ("free", free), ("exact", _begun(free, 0.0)), ("loose", _begun(free, 1e3)),
            ("wrong", _begun(free, 1e-3)),
        )
    }  # fmt: skip
    assert found["exact"].errors[0] < 0.7 * found["free"].errors[0]
    assert found["exact"].values[0] == pytest.approx(C1, abs=4 * found["exact"].errors[0])
    assert found["exact"].nodes[0][1, 0, :, 0].T == pytest.approx(
        np.array([[3.0 + k, 4.0 - k] for k in range(4)]), abs=1e-3
    )
    assert found["loose"].values == pytest.approx(found["free"].values, abs=1e-6)
    assert found["loose"].n_rows == found["free"].n_rows + 8
    shifted = [
        replace(s, first=replace(s.first, velocity=s.first.velocity + 1.0))
        for s in _begun(free, 1e-3).scenes
    ]
    data = replace(free, scenes=tuple(shifted))
    assert fit(Hypothesis.from_laws(data, [GRAVITY, DRAG]), data).status == "refuted"


def test_forces_show_more_where_first_states_are_known():
    free = throws(sigma=SIGMA, noise=(SIGMA,))
    shown = []
    for data in (free, _begun(free, 0.0)):
        found = fit(Hypothesis.from_laws(data, [GRAVITY]), data)
        response = respond(found, data)
        law = Hypothesis.from_laws(data, [f"-{C1} [kg/s] * v_i"]).law
        shown.append(np.square(response.moments_of(law)).sum())
    assert shown[1] > 2 * shown[0]
