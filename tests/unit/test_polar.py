"""Tables of distances and angles."""

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError

HEAD = "t,distance,angle\n"
TOML = '[units]\nlength = "m"\ntime = "s"\nangle = "deg"\n'


def loaded(tmp_path, text, toml=TOML):
    (tmp_path / "trajectories.csv").write_text(text)
    (tmp_path / "dataset.toml").write_text(toml)
    return load_dataset(tmp_path)


def circle(turns=1.25, n=26):
    """Angles that pass 360 degrees, written modulo a turn."""
    angle = 360 * np.linspace(0, turns, n)
    rows = [f"{k * 0.1:g},2.0,{a % 360:.12g}" for k, a in enumerate(angle)]
    return angle, HEAD + "\n".join(rows) + "\n"


def test_angles_count_modulo_a_turn(tmp_path):
    angle, text = circle()
    (scene,) = loaded(tmp_path, text).scenes
    expected = 2 * np.stack([np.cos(np.radians(angle)), np.sin(np.radians(angle))], axis=1)
    np.testing.assert_allclose(scene.positions[:, 0], expected, atol=1e-9)


def test_position_angles_run_from_north_through_east(tmp_path):
    toml = TOML + '[axes]\nangle_from = "y"\nangle_turns = "clockwise"\n'
    text = HEAD + "0,2,0\n1,2,90\n2,2,180\n"
    (scene,) = loaded(tmp_path, text, toml).scenes
    np.testing.assert_allclose(scene.positions[:, 0], [[0, 2], [2, 0], [0, -2]], atol=1e-12)


def test_errors_are_carried_over(tmp_path):
    text = "t,distance,angle,sdistance,sangle\n0,2,0,0.1,3\n1,2,90,0.1,3\n2,2,45,0.1,0\n"
    (scene,) = loaded(tmp_path, text).scenes
    across = 2 * np.radians(3)
    expected = [[0.1, across], [across, 0.1], [0.1 / np.sqrt(2)] * 2]
    np.testing.assert_allclose(scene.sigma[:, 0], expected, atol=1e-12)


def test_units_of_the_header_are_read(tmp_path):
    text = "t (s),distance (cm),angle (rad)\n0,200,0\n1,200,1\n2,200,2\n"
    (scene,) = loaded(tmp_path, text, toml="").scenes
    expected = [[2 * np.cos(a), 2 * np.sin(a)] for a in range(3)]
    np.testing.assert_allclose(scene.positions[:, 0], expected, atol=1e-12)


def test_beside_x_and_y_they_are_no_places(tmp_path):
    data = loaded(tmp_path, "t,x,y,distance,angle\n0,1,2,9,9\n1,1,2,9,9\n2,1,2,9,9\n")
    np.testing.assert_array_equal(data.scenes[0].positions[:, 0], [[1, 2]] * 3)
    assert any(note == "not used: distance" for note in data.notes)
    assert list(data.scenes[0].inputs) == ["angle"]  # whose unit is declared


@pytest.mark.parametrize(
    ("text", "toml", "words"),
    [
        (HEAD + "0,2,0\n1,2,1\n", TOML.replace('angle = "deg"\n', ""), "the angle has no unit"),
        (HEAD + "0,2,0\n1,2,1\n2,2,2\n", TOML.replace("deg", "kg"), "no unit of an angle"),
        (HEAD + "0,2,0\n1,-2,1\n", TOML, "must not be negative, got -2"),
        (HEAD + "0,2,0\n1,2,\n", TOML, "without an angle"),
        ("t,distance,angle,sangle\n0,2,0,1\n1,2,1,1\n", TOML, "no column 'sdistance'"),
        (HEAD + "0,2,0\n1,2,1\n2,2,2\n", TOML + '[axes]\nangle_from = "z"\n', "one of x, y"),
    ],
)
def test_bad_input_is_refused(tmp_path, text, toml, words):
    with pytest.raises(DataError, match=words):
        loaded(tmp_path, text, toml)
