"""An unseen planet that the law moves: found, fitted, foreseen, and not invented."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import held_out_rows
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.law_fit import constant_estimates
from bsp_gp.fitting.parts.hidden import HiddenBody
from bsp_gp.loop.kept import rounds_from, text_of
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.proposers.companions import Companions
from bsp_gp.loop.proposers.hidden import Hidden
from bsp_gp.loop.view import selected
from bsp_gp.loop.writing_up import told
from bsp_gp.report.hidden_map import draw_hidden_map
from tests.loop_views import view_of
from tests.throws import SI

LAW = "1 [m^3/kg/s^2] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
MASSES = np.array([20.0, 0.05, 0.05, 0.05])
RADII = np.array([0.0, 3.0, 6.0, 4.4])
SIGMA = 1e-3


def planets(seed, unseen=MASSES[-1]):
    """A star, two planets on circles, and a third one that no row shows; 40 rows and 15 later on.

    Returns
    -------
    train : Dataset
    later : Scene
    first : ndarray, shape (4,)
        State of the unseen one at the first row.
    track : ndarray, shape (55, 2)
        Where it is.
    """
    rng = np.random.default_rng(seed)
    masses = np.append(MASSES[:-1], unseen)
    angle = rng.uniform(0, 2 * np.pi, 4)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    speed = np.sqrt(np.where(RADII > 0, 20.0 / np.maximum(RADII, 1.0), 0.0))
    start = np.stack([RADII[:, None] * out, speed[:, None] * out[:, ::-1] * [-1, 1]])

    def motion(t, y):
        p, v = y.reshape(2, 4, 2)
        gap = p - p[:, None]
        r = np.linalg.norm(gap, axis=-1) + np.eye(4)
        pull = np.einsum("j,ijd->id", masses, gap / r[..., None] ** 3)
        return np.concatenate([v.ravel(), pull.ravel()])

    times = np.linspace(0.0, 11.0, 55)
    made = solve_ivp(motion, (0, 11), start.ravel(), t_eval=times, method="DOP853", rtol=1e-11,
                     atol=1e-11).y.T.reshape(55, 2, 4, 2)  # fmt: skip
    seen = made[:, 0, :3] + SIGMA * rng.standard_normal((55, 3, 2))
    crew = tuple(Entity(f"body{k}", properties={"mass": m}) for k, m in enumerate(masses[:3]))
    scene = Scene("sky", times, seen, crew)
    train = Dataset("planets", (scene.rows(0, 40),), noise=(SIGMA,), units=SI)
    return train, replace(scene.rows(40, 55), name="later"), made[0, :, 3].ravel(), made[:, 0, 3]


@pytest.fixture(scope="module")
def world():
    return planets(1)


@pytest.fixture(scope="module")
def family(world):
    return Companions().propose(view_of(world[0], LAW))


@pytest.fixture(scope="module")
def found(world, family):
    best = family.proposals[0]
    return fit(best.hypothesis, world[0], starts=best.starts, bounds=best.bounds)


def truth_of(found, first):
    values = dict(zip((*found.law.unseen[0].names, "M1"), (*first, MASSES[-1]), strict=True))
    return np.array([values[name] for name, _ in found.parameters])


def test_the_unseen_planet_is_found_within_its_intervals(world, family, found):
    train, _, first, track = world
    assert selected(family.gain, family.rank, family.null, is_continuum=True) < 1e-6
    assert family.gain > 1.1 * Hidden().propose(view_of(train, LAW)).gain
    assert found.status == "converged"
    truth = truth_of(found, first)
    assert np.all(np.abs(found.values - truth) < 3 * found.errors)
    names = [name for name, _ in found.parameters]
    starts = dict(zip(names, truth, strict=True))
    held = {name: (value, value) for name, value in starts.items()}
    at_truth = fit(family.proposals[0].hypothesis, train, starts=starts, bounds=held)
    assert 0 < at_truth.chisqr - found.chisqr < 20.5  # chi-squared of 5: 99.9 %
    k = found.groups[0].bodies[0].index("unseen1")
    assert np.abs(found.nodes[0][0, k, :, :, 0].T - track[:40]).max() < 0.3


def test_it_is_a_body_of_the_motion(found):
    """Its nodes join under the law, and the first of them is what the constants say."""
    (body,) = found.law.unseen
    k = found.groups[0].bodies[0].index(body.entity)
    first = found.nodes[0][:, k, :, 0, 0].ravel()
    assert first == pytest.approx([found.law.constants[n] for n in body.names], rel=1e-9)
    assert found.n_free == 2 * 3 * 2 + 5


def test_derivatives_by_its_state_are_those_of_the_tracks(world, family):
    """Tracks of two fits without constants, a little apart, against the columns between them."""
    train, *_ = world
    best = family.proposals[0]
    at = fit(best.hypothesis, train, starts=best.starts, bounds=best.bounds)
    number = [name for name, _ in at.parameters].index("h_x1")
    step = 1e-3
    ends = []
    for sign in (1, -1):
        values = dict(zip([n for n, _ in at.parameters], at.values, strict=True))
        values["h_x1"] += sign * step
        held = {name: (value, value) for name, value in values.items()}
        ends.append(fit(best.hypothesis, train, starts=values, bounds=held))
    change = (ends[1].residual - ends[0].residual) / (2 * step)  # initial states refitted
    seen = at.channels.seen
    whole = np.where(seen, at.shared_columns[number], 0.0)
    own = np.where(seen, at.local_columns, 0.0).reshape(len(at.local_columns), -1).T
    left = whole.ravel() - own @ np.linalg.lstsq(own, whole.ravel(), rcond=1e-9)[0]
    expected = np.where(seen, change, 0.0).ravel()
    assert left == pytest.approx(expected, abs=2e-3 * np.abs(expected).max())


def test_its_track_goes_on_into_what_was_held_out(world, found, family):
    train, later, _, track = world
    before = view_of(train, LAW).fit
    errors = [held_out_rows(f, train, (later,))[0]["track"] for f in (before, found)]
    sizes = [np.sqrt(np.nanmean(np.square(e))) for e in errors]
    assert sizes[1] < 0.5 * sizes[0]


def test_nothing_is_invented_and_a_mass_is_never_negative():
    for seed in range(3):
        train, *_ = planets(seed, unseen=0.0)
        family = Companions().propose(view_of(train, LAW))
        assert selected(family.gain, family.rank, family.null, is_continuum=True) > 0.01
        for proposal in family.proposals:
            assert proposal.starts["M1"] > 0 and proposal.bounds["M1"][0] == 0


def test_laws_that_say_nothing_of_its_motion_have_no_companions(world):
    view = view_of(world[0], "c * (p_j - p_i)")
    assert not Companions().propose(view).proposals


def test_rounds_adopt_it_and_go_on_from_what_was_kept(world):
    train, *_ = world
    hypothesis = Hypothesis.from_laws(train, (LAW,))
    rounds = run_rounds(
        hypothesis, train, [Hidden(), Companions()], rng=np.random.default_rng(0), max_rounds=3
    )
    assert [r.decision.verdict for r in rounds] == ["effect adopted", "nothing missing"]
    (part,) = [p for p in rounds[0].continuing.parts if isinstance(p, HiddenBody)]
    assert {p.name: p.prior is not None for p in part.parameters} == {
        "h_x1": True, "h_y1": True, "u_x1": True, "u_y1": True, "M1": False,
    }  # fmt: skip
    text = text_of(rounds)
    json.loads(text)
    again = rounds_from(text, hypothesis, train, fit(hypothesis, train))
    assert again[0].after.values == pytest.approx(rounds[0].after.values, rel=0, abs=0)


def test_draws_are_of_the_fit_and_make_a_map(world, family, found):
    train, _, first, _ = world
    view = view_of(train, LAW)
    details = Companions().details(view, family.proposals[0], found, np.random.default_rng(0))
    again = Companions().details(view, family.proposals[0], found, np.random.default_rng(0))
    assert json.loads(json.dumps(details)) == details == again
    at = [[n for n, _ in found.parameters].index(n) for n in details["names"]]
    draws = np.array(details["draws"])
    assert draws.std(axis=0) == pytest.approx(found.errors[at], rel=0.15)
    truth = np.append(first, MASSES[-1])
    assert np.all(np.abs(truth - draws.mean(axis=0)) < 3 * draws.std(axis=0))
    kind = (details["motion"], details["property"], details["unit"])
    assert kind == ("under the law", "mass", "kg")
    assert np.allclose(details["track"][0], details["best"][:2], atol=1e-6)
    figure = draw_hidden_map({**details, "p_value": 0.0}, truth=first[:2])
    assert len(figure.axes) == 2


def test_a_report_tells_the_intervals_of_the_draws(world, family, found):
    train, *_ = world
    view = view_of(train, LAW)
    details = Companions().details(view, family.proposals[0], found, np.random.default_rng(0))
    laplace = constant_estimates(found, train)
    draws = dict(zip(details["names"], np.array(details["draws"]).T, strict=True))
    for constant in told(laplace, details, found):
        ends = np.quantile(draws[constant.name], [0.05, 0.95])
        assert (constant.low, constant.high) == pytest.approx(ends)
    other = {**details, "best": [value + 1e-6 for value in details["best"]]}
    assert told(laplace, other, found) == laplace  # those are draws of another fit
    assert {c.name: c.unit for c in laplace} == {
        "h_x1": "m", "h_y1": "m", "u_x1": "m/s", "u_y1": "m/s", "M1": "kg",
    }  # fmt: skip
