"""What the study of machines makes, and takes for right: `experiments/mechanics.py`."""

import sys
from pathlib import Path

import numpy as np
import pytest

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"


@pytest.fixture(scope="module")
def study():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS))
        import causes
        import mechanics

        yield mechanics, causes.Cause
    for name in ("mechanics", "causes", "common", "power", "made_worlds"):
        sys.modules.pop(name, None)


@pytest.mark.slow
def test_every_kind_moves_as_its_velocities_say_and_lacks_something(study):
    mechanics, _ = study
    for name, kind in mechanics.KINDS.items():
        data, speeds, missing = mechanics.made(name, kind.strength, 3)
        for scene, speed, lacks in zip(data.scenes, speeds, missing, strict=True):
            told = np.gradient(scene.positions[:, 0], scene.times, axis=0)[2:-2]
            assert np.abs(told - speed[2:-2]).max() < 0.02, name
            assert np.isfinite(lacks).all() and np.abs(lacks).max() > 1e-4, name


@pytest.mark.parametrize(
    ("name", "code", "text", "is_right"),
    [
        ("rod with quadratic drag", "law", "c1 * (norm(v_i)^2 * normalize(v_i))", True),
        ("rod with quadratic drag", "law", "c1 * v_i", False),
        ("joint viscous", "law", "c1 * (m_i * norm(v_i) * normalize(v_i))", True),
        ("joint dry", "law", "c1 * (norm(v_i) * normalize(v_i))", False),
        ("spin by scene", "law_by_scene", "c1[scene] * perp(v_i)", True),
        ("spin by scene", "law", "c1 * perp(v_i)", False),
        ("late thrust", "late_log", "thrust acts as logged at t - delay_thrust", True),
        ("late thrust", "number", "number of thrust * up", False),
    ],
)
def test_right_is_what_has_the_form_of_what_is_missing(study, name, code, text, is_right):
    mechanics, cause = study
    referee = mechanics.Referee(name, *mechanics.made(name, mechanics.KINDS[name].strength, 3))
    assert referee.is_right(cause(code, text)) is is_right
