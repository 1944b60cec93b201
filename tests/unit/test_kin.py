"""Kin of declared terms: other powers of what they name, other strengths in some direction."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import with_term
from bsp_gp.loop.proposers.kin import kin_of
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.report.naming import change
from bsp_gp.report.page import page_of

UNITS = {"length": "m", "time": "s", "mass": "kg"}


def recorded(frames):
    bodies = pd.DataFrame({"entity": ["object"], "mass": [0.2]})
    return bsp_gp.Dataset.from_frames(frames, bodies, units=UNITS, train=list(frames)[:-1])


def moved(acceleration, start, t, sigma, seed):
    """A recording of a body that a force per mass moves."""
    n = len(start) // 2

    def rate(_, state):
        return np.concatenate([state[n:], acceleration(state[:n], state[n:])])

    places = solve_ivp(rate, t[[0, -1]], start, t_eval=t, rtol=1e-9, atol=1e-9).y[:n]
    places = places + sigma * np.random.default_rng(seed).standard_normal(places.shape)
    return pd.DataFrame(dict(zip("xyz", places, strict=False)) | {"t": t})


def texts_of_kin(*texts, n_dims=2):
    t = np.linspace(0.0, 1.0, 20)
    places = {"x": t, "y": t * t} | ({"z": t**3} if n_dims == 3 else {})
    data = recorded({"s": pd.DataFrame({"t": t, **places}), "r": pd.DataFrame({"t": t, **places})})
    formulas = [parse_formula(text, dataset_types(data), units=data.units) for text in texts]
    names = dict.fromkeys((n for f in formulas for n in f.constants), 1.0)
    law = ForceLaw(tuple(Term(f, is_declared=True) for f in formulas), names)
    return [to_text(formula) for formula in kin_of(law, n_dims)]


def test_a_spring_has_kin_of_higher_powers_of_its_stretch_and_of_its_distance():
    found = texts_of_kin("-k * (norm(p_i - origin) - 0.3 [m]) * normalize(p_i - origin)")
    assert "c1 * ((norm(p_i - origin) - 0.3 [m])^3 * normalize(p_i - origin))" in found
    assert sum(text.startswith("c1 * (abs(norm(p_i - origin) - 0.3 [m])") for text in found) == 1
    assert "c1 * (norm(p_i - origin)^-4 * normalize(p_i - origin))" in found
    assert len(found) == len(set(found)) == 10


def test_a_constant_inside_is_shared():
    found = texts_of_kin("-k * (x_i - X) * e_x")
    assert found == ["c1 * (abs(x_i - X) * (x_i - X) * e_x)", "c1 * ((x_i - X)^3 * e_x)"]


def test_a_hardening_spring_shares_the_rest_point_that_is_fitted():
    """The point was a number of either term: one was never told, and no fit came to an end."""
    t, rest = np.linspace(0.0, 12.0, 240), 0.3
    frames = {
        f"run {k}": moved(lambda p, v: -9 * (p - rest) - 40 * (p - rest) ** 3 - 0.1 * v,
                          (rest + 0.2 + 0.05 * k, 0.0), t, 1e-3, k)
        for k in range(3)
    }  # fmt: skip
    data = recorded(frames)
    base = Hypothesis.from_laws(data, ["-k * m_i * (x_i - X) * e_x", "-c * m_i * v_i"])
    term = Term(parse_formula("b * m_i * (x_i - X)^3 * e_x", dataset_types(data)))
    both = with_term(base, term, {"b": -30.0, "X": rest})
    assert [p.name for p in both.parameters].count("X") == 1
    found = fit(both, data, near=fit(base, data))
    assert found.status == "converged"
    known = dict(zip((name for name, _ in found.parameters), found.values, strict=True))
    assert known["b"] == pytest.approx(-40.0, abs=1.0)
    assert known["X"] == pytest.approx(rest, abs=1e-3)


@pytest.mark.parametrize(("n_dims", "count"), [(2, 4), (3, 8)])
def test_friction_has_kin_in_every_direction(n_dims, count):
    found = texts_of_kin("-mu * m_i * normalize(v_i)", n_dims=n_dims)
    assert "c1 * (dot(normalize(v_i), e_y) * (m_i * normalize(v_i)))" in found
    assert len(found) == len(set(found)) == count


def test_a_sine_has_the_cosine_and_the_product_of_both():
    found = texts_of_kin("-k * sin(x_i / 2 [m]) * e_x")
    assert "c1 * (cos(x_i / 2 [m]) * e_x)" in found
    assert "c1 * (sin(x_i / 2 [m]) * cos(x_i / 2 [m]) * e_x)" in found


@pytest.mark.slow
def test_a_hoop_that_is_spun_is_a_torque_of_its_own():
    """Told as a force along x, as the third power of the sine."""
    t, frames = np.arange(0.0, 6.0, 1 / 30), {}
    for k, start in enumerate((2.1, -0.9, 1.6, 1.1)):
        pull = lambda p, v: -32.7 * np.sin(p) - 0.17 * v + 3.6 * np.sin(p) * np.cos(p)  # noqa: E731
        turned = moved(pull, [start, 0.0], t, 0.01, k)
        frames[f"r{k}"] = turned.rename(columns={"x": "theta"})
    table = pd.concat(frame.assign(scene=name) for name, frame in frames.items())
    data = bsp_gp.Dataset.from_frames(table, units={"theta": "rad", "time": "s"})
    laws = ["-k * m_i * sin(theta_i)", "-c * m_i * omega_i"]
    report = bsp_gp.close_loop(data, laws, rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    effect = page_of(report).rounds[0].effect
    assert effect.name == "torque, as sin(angle) times cos(angle)"
    (c1,) = (c for c in report.constants if c.name == "c1")
    assert c1.low < 3.6 < c1.high


def test_forces_of_the_grammar_alone_have_none():
    assert not texts_of_kin("9.81 [m/s^2] * m_i * e_y", "c * e_x", "-mu * perp(v_i)")


@pytest.mark.slow
def test_a_spring_that_softens_is_found_with_its_number():
    def pull(p, v):
        stretch = np.linalg.norm(p) - 0.3
        return -(60.0 * stretch - 900.0 * stretch**3) * p / np.linalg.norm(p) - 0.1 * v

    t = np.linspace(0.0, 5.0, 150)
    frames = {
        f"s{k}": moved(pull, (0.4 + 0.02 * k, 0.05, 0.1 * k, 0.4), t, 0.002, k) for k in range(4)
    }
    report = bsp_gp.close_loop(
        recorded(frames),
        ["-k * (norm(p_i - origin) - 0.3 [m]) * normalize(p_i - origin)", "-c * v_i"],
        rng=0, n_bootstrap=0,
    )  # fmt: skip
    assert report.verdict == "effect adopted"
    assert page_of(report).rounds[0].effect.name == "force along the line to origin, as stretch³"
    found = {c.name: c for c in report.constants}
    assert found["k"].value == pytest.approx(60.0 * 0.2, rel=0.02)
    assert found["c1"].value == pytest.approx(900.0 * 0.2, rel=0.1)


@pytest.mark.slow
def test_a_friction_that_is_weaker_one_way_is_found():
    def brake(p, v):
        way = v / np.linalg.norm(v)
        return -0.7 * (1 - 0.25 * way[0]) * way

    frames = {}
    for k in range(8):
        t, angle = np.linspace(0.0, 1.2, 50), 0.8 * k
        start = (0.0, 0.0, 1.4 * np.cos(angle), 1.4 * np.sin(angle))
        frames[f"s{k}"] = moved(brake, start, t, 0.004, k)
    law = "-mu * m_i * normalize(v_i)"
    report = bsp_gp.close_loop(recorded(frames), law, rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    name = page_of(report).rounds[0].effect.name
    assert "cosine of its angle to x" in name
    found = {c.name: c.value for c in report.constants}
    assert found["c1"] == pytest.approx(0.7 * 0.25, abs=0.02)


@pytest.mark.parametrize(
    ("code", "name", "said"),
    [
        ("number", "number of 9.81 [m/s^2] * m_i * down", "another number in 9.81 [m/s^2] * m_i"),
        ("exponent", "exponent of norm(v_i) in -c * v_i", "another power of speed in -c * v_i"),
        ("exponent", "exponent of norm(p_i - origin) in A", "another power of distance in A"),
        ("constant_per_scene", "-c[scene] * v_i", "a constant for each scene in -c[scene] * v_i"),
    ],
)
def test_a_change_of_a_declared_term_is_said_in_words(code, name, said):
    assert change(code, name).startswith(said)
