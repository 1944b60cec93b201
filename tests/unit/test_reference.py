"""Tables of places from a body that the others pull: its acceleration is a cause of its own."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.reference import pulls_on_origin
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.proposers.reference import References
from bsp_gp.loop.view import View
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import Term

G = 39.4769
PULL = f"{G} [au^3/Msun/yr^2] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
MASSES = np.array([1.0, 3e-3, 1e-3])
NAMES = ("star", "inner", "outer")


def system(sigma=1e-3, n_rows=50):
    """Two heavy planets of a star, seen from it."""
    radii, angles = np.array([3.0, 6.5]), np.array([0.3, 2.2])
    speeds = np.sqrt(G / radii)
    out = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    places = np.concatenate([[[0, 0]], out * radii[:, None]])
    ways = np.concatenate([[[0, 0]], out[:, ::-1] * (-1, 1) * speeds[:, None]])

    def rate(t, state):
        p, v = state.reshape(2, 3, 2)
        apart = p[None] - p[:, None]
        cube = (np.square(apart).sum(axis=2) + np.eye(3)) ** 1.5
        pull = G * (MASSES[None, :, None] * apart / cube[..., None]).sum(axis=1)
        return np.concatenate([v.ravel(), pull.ravel()])

    t = np.linspace(0.0, 12.0, n_rows)
    begin = np.concatenate([places.ravel(), ways.ravel()])
    found = solve_ivp(rate, t[[0, -1]], begin, "DOP853", t, rtol=1e-11, atol=1e-11)
    tracks = found.y[:6].reshape(3, 2, n_rows)
    tracks = tracks - tracks[:1]
    rng = np.random.default_rng(3)
    tracks[1:] += sigma * rng.standard_normal(tracks[1:].shape)
    table = pd.concat([
        pd.DataFrame({"t": t, "entity": name, "x": x, "y": y})
        for name, (x, y) in zip(NAMES, tracks, strict=True)
    ])  # fmt: skip
    bodies = pd.DataFrame({"entity": NAMES, "mass": MASSES, "dynamic": [0, 1, 1]})
    units = {"length": "au", "time": "yr", "mass": "Msun"}
    return bsp_gp.Dataset.from_frames(table, bodies, units=units)


def test_pulls_on_the_origin_are_those_of_all_others_and_of_oneself():
    types = dataset_types(system())
    pair, field = pulls_on_origin(Term(parse_formula(PULL, types)))
    assert (pair.kind, field.kind) == ("pair", "field")
    assert "p_i" not in to_text(pair.formula) and "p_j" not in to_text(field.formula)
    spring = Term(parse_formula("-2 [kg/s^2] * (p_i - p_j)", types))
    assert pulls_on_origin(spring) == ()  # who knows how heavy what it pulls at is


@pytest.mark.parametrize("strength", [f"{G} [au^3/Msun/yr^2]", "Gn"])
def test_the_acceleration_of_the_star_is_found(strength):
    data = system()
    pull = PULL.replace(f"{G} [au^3/Msun/yr^2]", strength)
    report = close_loop(data, [pull], rng=np.random.default_rng(0), n_bootstrap=0, max_rounds=2)
    first = report.rounds[0]
    assert first.adopted and first.effect.code == "reference"
    assert report.rounds[-1].verdict == "nothing missing"


def test_a_star_that_is_seen_to_move_is_no_reference():
    data = system()
    (scene,) = data.scenes
    moved = np.array(scene.positions)
    moved[:, scene.names.index("star")] += 1e9
    data = replace(data, scenes=(replace(scene, positions=moved),))
    hypothesis = Hypothesis.from_laws(data, [PULL])
    found = fit(hypothesis, data)
    family = References().propose(View(found, hypothesis, data, np.random.default_rng(0)))
    assert family.proposals == ()
