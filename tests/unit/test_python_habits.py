"""From Python: seeds or none, short accounts, axes in and out, one class that fits and predicts."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import bsp_gp
from bsp_gp.data.scene import Dataset
from bsp_gp.errors import (
    BspError,
    DataError,
    LawError,
    OutputError,
    SettingsError,
    in_python,
    on_command_line,
)
from bsp_gp.randomness import generator
from tests.unit import report_sample as sample

T = np.linspace(0, 2, 40)
G, C = 9.81, 0.4
UNITS = {"length": "m", "time": "s"}


def fall(start, seed):
    """A fall with linear drag, per unit of mass, with a little noise."""
    y = start - G / C * T + G / C**2 * (1 - np.exp(-C * T))
    y = y + np.random.default_rng(seed).normal(0, 1e-3, T.shape)
    return pd.DataFrame({"t": T, "x": 0.3 / C * (1 - np.exp(-C * T)), "y": y})


@pytest.fixture(scope="module")
def data():
    frames = {f"drop{k}": fall(20 + k, k) for k in range(4)}
    return Dataset.from_frames(frames, name="falls", units=UNITS, up="y", noise=1e-3)


@pytest.mark.parametrize("rng", [None, 0, np.random.default_rng(0), np.int64(0)])
def test_a_generator_is_made_of_a_seed_or_none(rng):
    assert generator(rng).random() == np.random.default_rng(0).random()


@pytest.mark.parametrize("rng", ["0", 1.5, -1, True, np.random.RandomState(0)])
def test_anything_else_is_no_generator(rng):
    with pytest.raises(SettingsError, match="seed or None"):
        generator(rng)


def test_one_text_is_a_law_and_a_fit_needs_no_more(data):
    found = bsp_gp.fit_law(data, "-c * m_i * v_i + 9.81 [m/s^2] * m_i * down")
    assert found.constants[0].value == pytest.approx(C, rel=0.02)
    lines = repr(found).splitlines()
    assert 3 < len(lines) <= 10 and "c" in repr(found)
    assert repr(found).splitlines()[1].strip() in found._repr_html_()
    again = bsp_gp.simulate_law(data, found.law)
    assert np.abs(again.scenes[0].positions - data.scenes[0].positions).max() < 0.01
    noisy = [bsp_gp.simulate_law(data, found.law, noise=0.01, rng=r) for r in (None, 0, 1)]
    one, two, three = (d.scenes[0].positions for d in noisy)
    assert (one == two).all() and not (one == three).any()


def test_a_law_moves_bodies_from_any_start(data):
    law = bsp_gp.declared_law(data, ["-c * m_i * v_i", "9.81 [m/s^2] * m_i * down"])
    law = law.with_constants({"c": C})
    scene = data.scenes[0]
    times = np.linspace(0, 4, 9)
    made = law.simulate(scene, {"object": ([1.0, 5.0], [2.0, 0.0])}, times, up="y")
    expected = 5 - G / C * times + G / C**2 * (1 - np.exp(-C * times))
    assert made.positions[:, 0, 1] == pytest.approx(expected, rel=1e-6)
    x = 1 + 2 / C * (1 - np.exp(-C * times))
    assert made.positions[:, 0, 0] == pytest.approx(x, rel=1e-6)
    own = law.predict(scene, up="y")
    assert np.abs(own.positions - scene.positions).max() < 0.1
    with pytest.raises(SettingsError, match="'ball'.*moving are object"):
        law.simulate(scene, {"ball": ([0, 0], [0, 0])}, up="y")
    with pytest.raises(SettingsError, match="2 numbers"):
        law.simulate(scene, {"object": ([0, 0, 0], [0, 0, 0])}, up="y")


def test_the_class_has_the_habits_of_scikit_learn(data):
    model = bsp_gp.LawRegressor("-c * m_i * v_i + 9.81 [m/s^2] * m_i * down", search=False)
    assert repr(model).startswith("LawRegressor(declared=") and "rng" not in repr(model)
    with pytest.raises(SettingsError, match="call fit first"):
        model.predict(data)
    assert model.fit(data) is model
    assert model.constants_["c"] == pytest.approx(C, rel=0.02)
    assert [p.shape for p in model.predict(data)] == [s.positions.shape for s in data.scenes]
    assert 0.9999 < model.score(data) < 1.0
    wrong = bsp_gp.LawRegressor("9.81 [m/s^2] * m_i * down", search=False).fit(data)
    assert wrong.score(data) < model.score(data) - 1e-4
    copy = type(model)(**model.get_params())
    assert copy.get_params() == model.get_params()
    assert copy.set_params(search=True, max_rounds=1).max_rounds == 1
    with pytest.raises(SettingsError, match="'depth'.*max_levels"):
        copy.set_params(depth=3)


def test_accounts_are_ten_lines_at_most(data):
    law = bsp_gp.declared_law(data, ["-c[scene] * m_i * v_i", "g * m_i * down"])
    posterior = bsp_gp.Posterior(
        names=tuple(f"m{k}" for k in range(20)), draws=np.ones((5, 20)), weights=np.full(5, 0.2),
        log_prob=np.zeros(5), method="emcee", n_eff=np.ones(20), r_hat=np.ones(20),
    )  # fmt: skip
    told = {"Dataset 'falls': 4 scenes": data, "ForceLaw: F_i = ": law,
            "Posterior by emcee": posterior, "LoopReport of 'Thrown balls': effect adopted":
            sample.adopted()}  # fmt: skip
    for words, thing in told.items():
        text = repr(thing)
        assert text.startswith(words) and len(text.splitlines()) <= 10
        assert max(map(len, text.splitlines())) < 200
        assert "<pre>" in thing._repr_html_()
    assert "<script" not in sample.hostile()._repr_html_()


def test_pictures_take_axes_and_give_them_back(data):
    figure = Figure()
    axes = figure.subplots(1, 3)
    assert data.plot(axes[0], scene="drop1") is axes[0]
    assert axes[0].get_xlabel() == "x (m)" and "drop1" in axes[0].get_title()
    report = sample.adopted()
    assert report.plot(axes[1]) is axes[1]
    assert axes[1].get_title() in [f"{o.scene}: ball" for o in report.overlays]
    assert len(axes[1].lines) == 3
    found = bsp_gp.fit_law(data, "g * m_i * down")
    assert found.plot(axes[2]) is axes[2] and "g" in axes[2].get_yticklabels()[0].get_text()
    figure.savefig("/dev/null", format="png")


def test_motion_along_one_axis_is_drawn_over_time():
    axes = Figure().subplots()
    frame = pd.DataFrame({"t": T, "y": T**2})
    Dataset.from_frames(frame, name="lift", units=UNITS).plot(axes)
    assert axes.get_xlabel() == "t (s)" and axes.get_ylabel() == "y (m)"


@pytest.mark.parametrize(
    ("text", "python"),
    [
        ("say --columns t=\"...\" x='Weg cm', please", 'say columns={"t": "...", "x": "Weg cm"}, '
         "please"),
        ("or --up y", 'or up="y"'),
        ("give a longer --time-limit, or --start near", "give a longer time_limit, or starts near"),
        ("choose --max-levels 5 or fewer", "choose max_levels=5 or fewer"),
        ("pass --overwrite to replace", "pass overwrite=True to replace"),
        ("(--bounds n=0..4)", '(bounds={"n": "0..4"})'),
        ("no -- option, a--b", "no -- option, a--b"),
    ],
)  # fmt: skip
def test_options_are_arguments_in_python(text, python):
    assert in_python(text) == python
    for kind in (BspError, DataError, LawError, OutputError):
        assert python in str(kind(text))
    with on_command_line():
        assert in_python(text) == text and str(LawError(text)) == text


def test_a_law_of_a_fit_knows_what_is_up(data):
    law = bsp_gp.fit_law(data, "g * m_i * down").law
    start = {"object": ([0.0, 2.0], [0.0, 0.0])}
    scene = law.predict(data.scenes[0], start, times=[0.0, 0.05, 0.1])
    assert scene.positions[2, 0, 1] == pytest.approx(2.0 - 0.5 * law.constants["g"] * 0.01)
