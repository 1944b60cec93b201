"""One star that goes round what nobody sees: found, placed, weighed, told in its units."""

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset
from bsp_gp.errors import LawError
from bsp_gp.fitting.estimates import ConstantEstimate
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.proposers.hidden import Hidden
from bsp_gp.loop.told import Told
from bsp_gp.loop.view import View
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import verdict_sentence
from bsp_gp.units import parse_unit
from tests.lone_orbit import MASS, PLACE, dataset

AU, SUN = parse_unit("au")[0], parse_unit("Msun")[0]


def test_nothing_is_a_declaration_of_its_own():
    data = dataset()
    assert not read_law(data, "nothing").terms
    with pytest.raises(LawError, match="leave out the others"):
        read_law(data, ["nothing", "-k * v_i"])


def test_an_attraction_to_a_point_is_proposed_where_nothing_is_declared():
    data = dataset()
    hypothesis = Hypothesis.from_laws(data, "nothing")
    found = fit(hypothesis, data)
    view = View(found, hypothesis, data, np.random.default_rng(0), Criteria())
    family = Hidden().propose(view)
    best = next(p for p in family.proposals if p.text.startswith("at rest"))
    new = best.fitted(found, data, criteria=Criteria())
    mass, *place = (new.values[[n for n, _ in new.parameters].index(name)]
                    for name in ("M1", "h_x1", "h_y1"))  # fmt: skip
    assert new.status == "converged"
    assert mass / SUN == pytest.approx(MASS, rel=0.1)
    assert np.array(place) / AU == pytest.approx(np.array(PLACE), abs=0.6)


@pytest.mark.slow
def test_it_is_found_and_told_in_the_units_of_the_data():
    report = close_loop(dataset(), "nothing", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert [r.effect.code for r in report.rounds if r.adopted] == ["hidden_body"]
    page = page_of(report)
    mass = next(c for c in page.constants if c.name == "M1")
    assert mass.unit == "Msun" and mass.low < MASS < mass.high
    assert "an unseen body of 2." in verdict_sentence(page).lower().replace("1.9", "2.")
    assert "how it moves is not told by these data" in verdict_sentence(page)
    metres = close_loop(dataset(unit="m"), "nothing", rng=0, n_bootstrap=0)
    assert metres.verdict == report.verdict
    assert [c.value for c in metres.constants] == [c.value for c in report.constants]


def test_constants_are_told_in_the_units_of_the_data():
    told = Told({"length": "au", "time": "yr"}, {"kg": "mass"})
    pull = told.constant(ConstantEstimate("c", 6.6743e-11, 6e-11, 7e-11, "m^3/(kg s^2)"))
    assert pull.unit == "au^3/(Msun yr^2)" and pull.value == pytest.approx(4 * np.pi**2, rel=1e-4)
    drag = told.constant(ConstantEstimate("c", 1.0, 0.5, 2.0, "mass/s"))
    assert drag.unit == "mass/yr" and drag.value == pytest.approx(parse_unit("yr")[0])
    assert told.unit("1/mol") == (1.0, "1/mol")
    assert Told({"length": "m", "time": "ms"}, {}).unit("m/s^2") == (1.0, "m/s^2")
    counts = Told({"length": "0.16 um", "time": "s"}, {})  # of a camera: told in what they count
    assert counts.unit("m/s") == (pytest.approx(1e6), "um/s")
    assert told.text("2 [m] * e_x + 3 * v_i") == f"{2 / AU:.6g} [au] * e_x + 3 * v_i"


@pytest.mark.parametrize(
    ("text", "same"),
    [("AU", "au"), ("Msun", "1.98841e30 kg"), ("M☉", "Msun"), ("mas", "1e-3 arcsec"),
     ("RJ", "7.1492e7 m"), ("R_jup", "Rjup"), ("R☉", "Rsun"), ("R⊕", "R_earth")],
)
def test_words_of_the_trade_are_units(text, same):
    number, _, unit = same.rpartition(" ")
    assert parse_unit(text)[0] == pytest.approx(float(number or 1) * parse_unit(unit)[0])


@pytest.mark.slow
def test_planets_of_few_rows_a_turn_go_round_one_body_that_nobody_sees():
    """Of the fastest there are twelve rows a turn: three forces were told as fact."""
    rng, times, columns = np.random.default_rng(1), np.arange(0, 3, 0.02), {}
    pull = 4 * np.pi**2
    for name, (axis, oval) in {"hermes": (0.39, 0.2), "venus": (0.72, 0.01), "terra": (1.0, 0.02),
                               "mars": (1.52, 0.09)}.items():  # fmt: skip
        near, turn = axis * (1 - oval), rng.uniform(0, 6)
        way = np.array([np.cos(turn), np.sin(turn)])
        speed = np.sqrt(pull * (1 + oval) / near) * np.array([-way[1], way[0]])
        path = solve_ivp(
            lambda _, s: [*s[2:], *(-pull * s[:2] / np.hypot(*s[:2]) ** 3)], (0, 3),
            [*(near * way), *speed], t_eval=times, rtol=1e-9, atol=1e-11,
        ).y[:2]  # fmt: skip
        seen = path + 1e-3 * rng.standard_normal(path.shape)
        columns |= {f"{axis}_{name}": row for axis, row in zip("xy", seen, strict=True)}
    data = Dataset.from_frames(
        pd.DataFrame({"t": times, **columns}), units={"length": "au", "time": "yr"}
    )
    report = close_loop(data, "nothing", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted"
    assert [r.effect.code for r in report.rounds if r.adopted] == ["hidden_body"]
    mass = next(c for c in page_of(report).constants if c.name == "M1")
    assert mass.value == pytest.approx(1.0, abs=2e-3)
