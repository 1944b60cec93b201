"""Of the sky a push along an axis of the picture is a description, and no cause."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from bsp_gp import Dataset, close_loop
from bsp_gp.loop.writing_up import doubt_of_axes

GM = 4 * np.pi**2  # au^3/yr^2
PULL = "c1 * norm(p_i - p_j)^-2 * normalize(p_j - p_i)"


def pushed(rng, length):
    """An orbit that is pushed along x, of so many metres or other units in an au."""
    t = np.linspace(0, 3, 150)

    def rates(_, z):
        return [z[2], z[3], *(-GM * z[:2] / np.hypot(*z[:2]) ** 3 + [0.15, 0.0])]

    z = solve_ivp(rates, (0, 3), [1.3, 0, 0, np.sqrt(GM / 1.3)], t_eval=t, rtol=1e-10).y
    x, y = z[:2] + rng.normal(0, 1e-4, (2, len(t)))
    frame = pd.concat([
        pd.DataFrame({"t": t, "entity": "rock", "x": x, "y": y}),
        pd.DataFrame({"t": t, "entity": "Sun", "x": 0.0 * t, "y": 0.0}),
    ])  # fmt: skip
    return Dataset.from_frames(frame, units={"length": length, "time": "yr"})


def test_a_push_along_an_axis_of_the_sky_describes_and_one_in_a_laboratory_acts():
    for length, told in (("au", ("effective law", "laboratory")), ("m", ("effect adopted",))):
        data = pushed(np.random.default_rng(1), length)
        report = close_loop(
            data, PULL, rng=np.random.default_rng(0), n_bootstrap=0, max_rounds=2
        )
        first = report.rounds[0]
        assert first.effect.name == "c2 * e_x"
        assert (first.verdict, first.reason)[: len(told)] == told


def test_whoever_declares_a_centre_knows_what_is_there():
    data = pushed(np.random.default_rng(1), "au")
    formula = SimpleNamespace(inputs={"p_i", "origin"})
    law = lambda *names: SimpleNamespace(  # noqa: E731
        law=SimpleNamespace(terms=[SimpleNamespace(formula=SimpleNamespace(inputs=set(names)))])
    )
    for known, said in (("p_j", "laboratory"), ("origin", "")):
        done = SimpleNamespace(
            number=1, entering=law(known), decision=SimpleNamespace(
                is_adopted=True, best=SimpleNamespace(id=1)
            ),
            proposals={1: SimpleNamespace(code="law", formulas=[formula])},
        )  # fmt: skip
        assert doubt_of_axes([done], (), data) == said
