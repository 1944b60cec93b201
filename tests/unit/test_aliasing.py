"""Frequencies that rows are too far apart to show are told."""

import math

import numpy as np
import pytest

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.hypothesis import declared_law
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.loop.close import close_loop
from bsp_gp.physics.aliasing import aliasing_notes
from bsp_gp.physics.force import ForceLaw
from tests.planted import SI

STEP = 0.05
BALL = Entity("ball", properties={"mass": 1.0})


def shaken(frequency, times=None, sigma=1e-3):
    """A ball that is pushed to and fro."""
    times = STEP * np.arange(80) if times is None else times
    x = -np.sin(frequency * times) / frequency**2
    p = np.stack([x, 0.3 * times], axis=1)[:, None]
    p = p + sigma * np.random.default_rng(0).standard_normal(p.shape)
    return Dataset("shaken", (Scene("a", times, p, (BALL,)),), units=SI, noise=(sigma,))


def notes_of(text, *scenes, **constants):
    data = Dataset("d", scenes or shaken(3.0).scenes, units=SI)
    law = declared_law(data, [text])
    return tuple(aliasing_notes(law.with_constants({"c": 1.0} | constants), data.scenes, SI))


def test_a_frequency_beyond_half_of_the_row_rate_is_told_with_its_alias():
    speed = math.tau / STEP - 3.0
    (note,) = notes_of("c * m_i * sin(w * t + f) * e_x", w=speed, f=0.3)
    assert "sin(w * t + f) turns once in 0.05122 s" in note
    assert "two rows take (0.1 s)" in note
    assert f"turns once in {math.tau / 3:.4g} s" in note
    (note,) = notes_of("c * m_i * cos(125.66370614359172 [1/s] * t) * e_x")
    assert "does not turn at all" in note


@pytest.mark.parametrize("wave", ["sin(3 [1/s] * t)", "cos(60 [1/s] * t)", "sin(-w * t)"])
def test_a_frequency_that_rows_show_is_no_news(wave):
    assert notes_of(f"c * m_i * {wave} * e_x", w=62.8) == ()


def test_rows_at_uneven_times_show_more():
    rng = np.random.default_rng(1)
    uneven = np.cumsum(rng.uniform(0.02, 0.08, 80))
    assert notes_of("c * m_i * sin(100 [1/s] * t) * e_x", *shaken(3.0, uneven).scenes) == ()
    gaps = np.delete(STEP * np.arange(80), [5, 6, 30, 31, 32])  # but not rows that are missing
    assert len(notes_of("c * m_i * sin(100 [1/s] * t) * e_x", *shaken(3.0, gaps).scenes)) == 1
    rounded = np.round(np.arange(80) / 30, 3)
    assert len(notes_of("c * m_i * sin(150 [1/s] * t) * e_x", *shaken(3.0, rounded).scenes)) == 1


def test_of_bodies_with_frequencies_of_their_own_the_one_is_named():
    data = shaken(3.0)
    law = declared_law(data, ["c * m_i * sin(w * t) * e_x"])
    law = ForceLaw(law.terms, {"c": 1.0, "w": {"ball": 3.0, "feather": 100.0}})
    (note,) = aliasing_notes(law, data.scenes, SI)
    assert note.startswith("check: sin(w * t) of feather")


@pytest.mark.slow
def test_fit_and_close_tell_it():
    data = shaken(3.0)
    fast = "c * m_i * sin(-122.66370614359172 [1/s] * t) * e_x"
    slow = "c * m_i * sin(3 [1/s] * t) * e_x"
    fits = [fit_law(data, [law], rng=np.random.default_rng(0)) for law in (fast, slow)]
    assert "two rows take" in fits[0].text() and "two rows take" not in fits[1].text()
    report = close_loop(
        data, [fast], rng=np.random.default_rng(0), max_rounds=1, n_bootstrap=0, max_levels=4,
    )  # fmt: skip
    assert any("two rows take" in note for note in report.dataset["notes"])
