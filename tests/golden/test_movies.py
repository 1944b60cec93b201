"""One intuitive-physics movie from its mp4: tracks beside the stored ones, answers beside truth.

The constants are those that `experiments/ullman.py` learns, without labels, on the nine other
worlds; the movie has never been used for them.
"""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
SCENE = "world3_3"


@pytest.fixture(scope="module")
def movie(shared_data):
    if not (shared_data / "ullman").is_dir():
        pytest.skip("no movies in the reference data")
    patch = pytest.MonkeyPatch()
    patch.syspath_prepend(str(EXPERIMENTS))
    patch.setenv("BSP_GP_DATA", str(shared_data))
    from ullman_movies import track_movie

    yield track_movie(SCENE)
    patch.undo()
    for name in ("ullman_movies", "ullman_model", "ullman_inference", "common"):
        sys.modules.pop(name, None)


@pytest.mark.slow
def test_every_disc_is_followed_and_lies_on_the_stored_track(movie, shared_data):
    assert movie.positions.shape == (399, 4, 2)
    assert np.isfinite(movie.positions).all()
    with (shared_data / "ullman" / "tracks" / f"{SCENE}.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    far = []
    for row in rows:
        at = np.array([float(row["x_px"]), float(row["y_px"])])
        mine = [k for k, c in enumerate(movie.colours) if c == row["object_color"]]
        t = int(row["frame"])
        far.append(min(np.linalg.norm(movie.positions[t, k] - at) for k in mine))
    assert np.median(far) < 1.5  # the stored centres are those of 80 px templates, half a pixel off
    assert np.quantile(far, 0.99) < 4


def test_mats_and_walls(movie):
    assert movie.arena == (19.5, 19.5, 619.5, 459.5)
    boxes = {m[0]: m[1:5] for m in movie.mats}
    assert sorted(boxes) == ["brown", "green"]
    np.testing.assert_allclose(boxes["green"], (118, 376, 206, 460), atol=1.0)
    np.testing.assert_allclose(boxes["brown"], (262, 240, 426, 334), atol=1.0)


@pytest.mark.slow
def test_hidden_classes_are_told(movie):
    from ullman_inference import Constants, answers, movie_table
    from ullman_model import Form, summarise

    constants = Constants(gamma=9.8e-4, g=0.302, k=1.505, slack=(1e-3, 0.01, 0.01))
    summaries = summarise(movie, Form())
    told = {
        (category, item): max(posterior, key=posterior.get)
        for category, item, posterior in answers(
            summaries[0], movie_table(summaries, constants)
        )
    }
    assert told == {
        ("mass", "red"): "light", ("mass", "yellow"): "heavy",
        ("friction", "green"): "weak", ("friction", "brown"): "smooth",
        ("global", "global"): "none",
        ("pairwise", "red-red"): "none", ("pairwise", "red-yellow"): "none",
        ("pairwise", "yellow-yellow"): "attract",
    }  # fmt: skip
