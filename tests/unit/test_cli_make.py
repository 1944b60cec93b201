"""``bsp-gp make``: what it writes, what it refuses, the same bits for the same seed."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bsp_gp.cli import main
from bsp_gp.data.tables import load_dataset

ROOT = Path(__file__).resolve().parents[2]


def run(capsys, *words):
    status = main(["make", *map(str, words), "--quiet"])
    out, err = capsys.readouterr()
    return status, out, err


def digest(folder):
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_data_truth_model_and_picture(capsys, tmp_path):
    out = tmp_path / "orbits"
    status, text, err = run(
        capsys, "nbody", "--scenes", 6, "--seed", 1, "--frames", 9, "--effect", "drag=0.1",
        "--undeclared", "--out", out,
    )  # fmt: skip
    assert (status, err) == (0, "")
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "orbits", "orbits-model.toml", "orbits-scenes.png", "orbits-truth",
    ]  # fmt: skip
    assert text.splitlines()[0] == f"Data set: {out}"
    assert "contacts" not in text
    dataset = load_dataset(out)
    assert len(dataset.scenes) == 6 and len(dataset.scenes[0].times) == 9
    truth = json.loads((tmp_path / "orbits-truth" / "truth.json").read_text())
    assert truth["seed"] == 1 and truth["effects"][0]["parameters"] == {"value": 0.1}
    assert "drag" not in (tmp_path / "orbits-model.toml").read_text()
    assert b"PNG" in (tmp_path / "orbits-scenes.png").read_bytes()[:8]
    status, _, err = (main(["fit", str(out), "--model", f"{out}-model.toml"]),
                           *capsys.readouterr())  # fmt: skip
    assert status == 0, err


def test_bodies_that_hit_each_other_are_told(capsys, tmp_path):
    words = ("nbody", "--frames", 9, "--set", "has_contacts=yes", "--out", tmp_path / "orbits")
    status, text, _ = run(capsys, *words)
    assert status == 0 and "the declared model has no contacts; --set has_contacts=no" in text


@pytest.mark.slow
def test_scenes_that_frames_cannot_follow_are_drawn_again(capsys, tmp_path):
    words = ("nbody", "--scenes", 30, "--seed", 1, "--effect", "drag=0.1", "--undeclared",
             "--noise", 0)  # fmt: skip
    assert run(capsys, *words, "--out", tmp_path / "orbits")[0] == 0
    assert run(capsys, *words, "--set", "is_followed=no", "--out", tmp_path / "any")[0] == 0

    def sharpest(name):
        """Largest change of a velocity between frames, over its usual size, of every scene."""
        states = []
        for scene in load_dataset(tmp_path / name).scenes:
            v = np.diff(scene.positions, axis=0)
            usual = np.sqrt((v**2).sum(axis=-1).mean(axis=0))
            states.append((np.linalg.norm(np.diff(v, axis=0), axis=-1) / usual).max())
        return np.array(states)

    followed, anyhow = sharpest("orbits"), sharpest("any")
    assert followed.max() < 1.2 < anyhow.max()
    assert not (followed == anyhow)[anyhow > 1.2].any() and (followed == anyhow).any()


@pytest.mark.slow
def test_same_seed_same_bits_in_two_processes(tmp_path):
    for k in (1, 2):
        (tmp_path / str(k)).mkdir()
        subprocess.run(
            [sys.executable, "-m", "bsp_gp", "make", "bounce", "--scenes", "3", "--seed", "5",
             "--frames", "12", "--effect", "pair=9,column=colour", "--undeclared", "pair",
             "--noise", "0.1", "--film", "--size", "160x120", "--grain", "3",
             "--out", str(tmp_path / str(k) / "d")],
            cwd=ROOT, check=True, capture_output=True,
            env={**os.environ, "PYTHONHASHSEED": str(k)},
        )  # fmt: skip
    one, two = digest(tmp_path / "1"), digest(tmp_path / "2")
    assert one == two and "d-film/scene-1.mp4" in one


def test_films_come_with_their_truth(capsys, tmp_path):
    status, text, _ = run(
        capsys, "spring", "--scenes", 3, "--frames", 6, "--film", 2, "--png", "--size", "200x160",
        "--exposure", 0.5, "--blur", 0.5, "--quality", 80, "--out", tmp_path / "s",
    )  # fmt: skip
    assert status == 0 and f"Film: {tmp_path / 's-film'}" in text
    film = tmp_path / "s-film"
    assert sorted(p.name for p in film.iterdir()) == [
        ".bsp_gp", "camera.toml", "scene-1", "scene-1.mp4", "scene-2", "scene-2.mp4",
    ]  # fmt: skip
    assert len(list((film / "scene-2").glob("*.png"))) == 6
    pixels = pd.read_csv(tmp_path / "s-truth" / "pixels.csv")
    assert list(pixels.columns) == ["scene", "frame", "t", "entity", "x_px", "y_px"]
    assert len(pixels) == 2 * 6 * 2
    assert pixels.x_px.between(0, 199).all() and pixels.y_px.between(0, 159).all()


def test_numbers_are_set(capsys, tmp_path):
    run(
        capsys, "bounce", "--set", "n_bodies=2", "mass=1..2", "restitution=0", "--fps", 25,
        "--substeps", 3, "--noise", 0.5, "--set", "memory=0.5", "--out", tmp_path / "b",
    )  # fmt: skip
    dataset = load_dataset(tmp_path / "b")
    assert len(dataset.scenes[0].entities) == 6
    np.testing.assert_allclose(np.diff(dataset.scenes[0].times), 0.04)
    assert dataset.noise == (0.5,)
    assert not (tmp_path / "b-model.toml").exists()


def test_older_results_are_kept_unless_asked(capsys, tmp_path):
    words = ("spring", "--frames", 5, "--out", tmp_path / "s")
    assert run(capsys, *words, "--film")[0] == 0
    before = digest(tmp_path)
    status, _, err = run(capsys, *words, "--seed", 2)
    assert status == 2 and "exists already; pass --overwrite" in err
    assert digest(tmp_path) == before
    assert run(capsys, *words, "--seed", 2, "--overwrite")[0] == 0
    after = digest(tmp_path)
    assert after["s/trajectories.csv"] != before["s/trajectories.csv"]
    assert not any(name.startswith("s-film") for name in after)  # of data that are gone
    (tmp_path / "s-truth" / "mine.txt").write_text("x")
    status, _, err = run(capsys, *words, "--seed", 2, "--overwrite")
    assert status == 0 and "kept" in err and "s-truth/mine.txt" in err
    mine = "s-truth/mine.txt"
    assert {k: v for k, v in digest(tmp_path).items() if k != mine} == after
    assert (tmp_path / mine).read_text() == "x"


def test_a_folder_in_the_place_of_a_file_is_left_alone(capsys, tmp_path):
    (tmp_path / "s-scenes.png").mkdir()
    status, _, err = run(capsys, "spring", "--out", tmp_path / "s", "--overwrite")
    assert status == 2 and "s-scenes.png: exists already" in err
    (tmp_path / "s-scenes.png").rmdir()
    (tmp_path / "s-film").mkdir()
    (tmp_path / "s-film" / "mine.txt").write_text("x")
    status, _, err = run(capsys, "spring", "--out", tmp_path / "s", "--overwrite")
    assert status == 2 and "holds other files (mine.txt)" in err
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["planets"], "preset must be one of nbody"),
        (["nbody", "--scenes", "0"], "must be a whole number"),
        (["nbody", "--effect", "drag=x"], "drag of an effect must be a finite number"),
        (["nbody", "--effect", "drog=1"], "effect must be one of"),
        (["nbody", "--undeclared"], "--undeclared needs an --effect"),
        (["nbody", "--effect", "drag=1", "--undeclared", "wind"], "no --effect of that name"),
        (["nbody", "--set", "colour=1"], "there is no number 'colour'"),
        (["nbody", "--set", "mass=x"], "mass must be a number or a range"),
        (["nbody", "--noise", "1", "--set", "noise=2"], "noise is given twice"),
        (["nbody", "--film", "2"], "there are only 1 scenes"),
        (["nbody", "--size", "640"], "must be WIDTHxHEIGHT"),
        (["nbody", "--fps", "0"], "must be a finite number"),
    ],
)
def test_bad_words_are_named_in_one_line(capsys, tmp_path, words, message):
    status, out, err = run(capsys, *words, "--out", tmp_path / "d")
    assert status == 2 and message in err and err.count("\n") == 1 and not out
    assert not list(tmp_path.iterdir())
