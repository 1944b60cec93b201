"""Friction that turns with the velocity: descents are not lost where it does."""

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from bsp_gp import Dataset
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.response import respond

STIFFNESS, DRAG, FRICTION = 8.0, 0.03, 0.12


def swings(times):
    """Places of a cart on a spring that is let go at 0.3 m, half a swing after the other."""
    place, now, out = 0.3, 0.0, np.empty(len(times))
    while now <= times[-1]:
        way = -np.sign(place)

        def rates(_, z, way=way):
            return [z[1], -STIFFNESS * z[0] - DRAG * z[1] - FRICTION * way]

        def turns(t, z, way=way, now=now):
            return z[1] * way if t > now + 1e-3 else 1.0

        turns.terminal, turns.direction = True, -1
        found = solve_ivp(rates, (now, now + 5), [place, 0.0], "DOP853", dense_output=True,
                          events=turns, rtol=1e-11, atol=1e-12)  # fmt: skip
        here = (times >= now) & (times <= found.t[-1])
        if here.any():
            out[here] = found.sol(times[here])[0]
        place, now = found.y[0, -1], found.t[-1]
    return out


def test_spring_drag_and_friction_are_found_from_the_tracks_of_no_force_at_all():
    """Nodes that pass the instants at which it turns make chi-squared jump: steps crept there."""
    t = (0.01 * np.arange(1069)).round(2)
    noise = np.random.default_rng(6).normal(0, 5e-4, 4000)
    frame = pd.DataFrame({"t": t, "entity": "cart", "x": (swings(t) + noise[: len(t)]).round(4)})
    data = Dataset.from_frames(frame, units={"length": "m", "time": "s"})
    laws = ["c1 * m_i * (centre_x - x_i) * e_x", "-c2 * m_i * v_i", "-c3 * m_i * normalize(v_i)"]
    base = fit(Hypothesis.from_laws(data, ["1e-6 [1/s] * m_i * v_i"]), data)
    base = replace(base, nodes=respond(base, data).nodes)
    starts = {"c1": 7.97, "centre_x": -6e-4, "c2": 0.077, "c3": 0.1}
    found = fit(Hypothesis.from_laws(data, laws), data, near=base, starts=starts, effort=600)
    assert found.status == "converged"
    values = dict(zip(found.parameters, found.values, strict=True))
    assert abs(values["c1", ""] - STIFFNESS) < 0.01
    assert abs(values["c2", ""] - DRAG) < 0.005
    assert abs(values["c3", ""] - FRICTION) < 0.002
