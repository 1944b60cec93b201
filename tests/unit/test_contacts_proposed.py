"""Kicks that nobody declared: found at their instant, with their velocity, and not invented."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import held_out_rows
from bsp_gp.fitting.hypothesis import NOTHING, Hypothesis
from bsp_gp.fitting.law_fit import constant_estimates
from bsp_gp.fitting.parts.contacts import Kick
from bsp_gp.language.grammar import load_grammar
from bsp_gp.loop.forms import without_open_kicks
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.proposal import Proposal
from bsp_gp.loop.proposers.contacts import Contacts
from bsp_gp.loop.proposers.laws import Laws
from bsp_gp.loop.view import selected
from bsp_gp.report.kicks import kick
from tests.loop_views import GRAVITY, edited, throws, view_of

INSTANT, GAIN = 0.433, np.array([0.6, -0.8])


def kicked(rng, gain=GAIN, **settings):
    """Throws of which one body of the second scene gains a velocity between two rows."""
    dataset = throws(rng, **settings)
    since = np.maximum(dataset.scenes[1].times - INSTANT, 0.0)

    def change(positions):
        positions[:, -1] += since[:, None] * gain

    return edited(dataset, change, scene=1)


def p_of(family, view):
    return selected(family.gain, family.rank, family.null, view.noise_dof, family.is_continuum)


@pytest.mark.parametrize("n_bodies", [1, 2])
def test_a_kick_is_found_with_its_instant_and_velocity(n_bodies):
    dataset = kicked(np.random.default_rng(0), n_bodies=n_bodies)
    view = view_of(dataset)
    family = Contacts().propose(view)
    best = family.proposals[0]
    assert p_of(family, view) < 1e-10
    assert best.code == "contact" and best.rank == 3
    (part,) = [p for p in best.hypothesis.parts if isinstance(p, Kick)]
    assert (part.scene, part.entity) == (dataset.scenes[1].name, str(n_bodies))
    found = fit(best.hypothesis, dataset, starts=best.starts, bounds=best.bounds)
    assert found.status == "converged"
    assert found.chisqr == pytest.approx(view.fit.chisqr - family.gain, abs=0.05 * family.gain)
    truth = {"w_x1": GAIN[0], "w_y1": GAIN[1], "t1": INSTANT}
    away = found.values - [truth[name] for name, _ in found.parameters]
    assert away @ np.linalg.solve(found.covariance, away) < 16.3  # chi-squared of 3: 99.9 %
    units = {c.name: c.unit for c in constant_estimates(found, dataset)}
    assert units == {"w_x1": "m/s", "w_y1": "m/s", "t1": "s"}


@pytest.mark.slow
def test_derivatives_are_those_of_the_motion_where_forces_depend_on_the_place():
    """On an oscillator, against fits with a number held a little to either side."""
    rng = np.random.default_rng(1)
    times = 0.05 * np.arange(40)
    dataset = throws(rng, n_scenes=2)
    late = np.maximum(times - INSTANT, 0.0)
    scenes = []
    for k, scene in enumerate(dataset.scenes):
        path = np.stack([np.cos(2 * times), np.sin(2 * times + 0.3)], axis=1)
        path = path + k * 0.5 * np.sin(2 * late)[:, None] * GAIN
        noise = 1e-3 * rng.standard_normal(path.shape)
        scenes.append(replace(scene, times=times, positions=(path + noise)[:, None]))
    dataset = replace(dataset, scenes=tuple(scenes), noise=(1e-3,))
    best = Contacts().propose(view_of(dataset, "-4 [1/s^2] * m_i * (p_i - origin)")).proposals[0]
    at = fit(best.hypothesis, dataset, starts=best.starts)
    names = [name for name, _ in at.parameters]
    assert np.abs(at.values - [{"t1": INSTANT, "w_x1": 0.6, "w_y1": -0.8}[n] for n in names]).max(
    ) < 0.02  # fmt: skip
    seen = at.channels.seen
    own = np.where(seen, at.local_columns, 0.0)
    for number, name in enumerate(names):
        ends = []
        for sign in (1, -1):
            values = dict(zip(names, at.values, strict=True))
            values[name] += sign * 1e-4
            held = {n: (v, v) for n, v in values.items()}
            ends.append(fit(best.hypothesis, dataset, starts=values, bounds=held).residual)
        expected = np.where(seen, ends[1] - ends[0], 0.0) / 2e-4
        left = np.where(seen, at.shared_columns[number], 0.0)
        for chain in np.unique(at.channels.chain):
            mine = at.channels.chain == chain
            basis = own[:, :, mine].reshape(len(own), -1).T
            column = left[:, mine].ravel()
            column = column - basis @ np.linalg.lstsq(basis, column, rcond=1e-9)[0]
            left[:, mine] = column.reshape(left[:, mine].shape)
        assert left == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_noise_alone_shows_no_contact():
    chances = []
    for seed in range(12):
        view = view_of(throws(np.random.default_rng(100 + seed), n_scenes=2))
        chances.append(p_of(Contacts().propose(view), view))
    assert min(chances) > 0.003 and np.median(chances) > 0.2


@pytest.mark.slow
def test_the_loop_adopts_a_kick_and_no_force():
    dataset = kicked(np.random.default_rng(3))
    laws = Laws(load_grammar("physics"), dataset, max_levels=5)
    rounds = run_rounds(
        Hypothesis.from_laws(dataset, (GRAVITY,)), dataset, [laws, Contacts()],
        rng=np.random.default_rng(0), max_rounds=3,
    )  # fmt: skip
    assert [r.decision.verdict for r in rounds] == ["effect adopted", "nothing missing"]
    assert rounds[0].decision.best.code == "contact"


def kicked_thrice():
    """Two kicks of one body, and one in another scene."""
    dataset = kicked(np.random.default_rng(0))
    for scene, instant, gain in ((0, 0.3, (0.2, 0.7)), (1, 0.22, (-0.5, 0.3))):
        since = np.maximum(dataset.scenes[scene].times - instant, 0.0)

        def change(positions, since=since, gain=gain):
            positions[:, -1] += since[:, None] * np.array(gain)

        dataset = edited(dataset, change, scene=scene)
    return dataset


def test_kicks_here_and_there_are_proposed_at_once():
    """Where each lies depends on the others."""
    dataset = kicked_thrice()
    best = max(Contacts().propose(view_of(dataset)).proposals, key=lambda p: p.promise)
    assert best.rank == 9
    found = fit(best.hypothesis, dataset, starts=best.starts, bounds=best.bounds)
    values = {name: value for (name, _), value in zip(found.parameters, found.values, strict=True)}
    instants = sorted(value for name, value in values.items() if name.startswith("t"))
    assert instants == pytest.approx([0.22, 0.3, INSTANT], abs=0.03)
    told = SimpleNamespace(code=best.code, name=best.text, constants=[
        SimpleNamespace(name=name, value=value, unit="s" if name[0] == "t" else "m/s",
                        low=value - 0.01, high=value + 0.01)
        for name, value in values.items()
    ])  # fmt: skip
    text = kick(told)
    assert text.startswith("3 kicks: the velocity of 1 jumps by ")
    assert text.count(" in scene 2") == 2 and text.count(" in scene 1") == 1


@pytest.mark.slow
def test_the_loop_adopts_kicks_here_and_there():
    """Though such kicks, before they are known, are as odd as odd noise."""
    dataset = kicked_thrice()
    laws = Laws(load_grammar("physics"), dataset, max_levels=5)
    rounds = run_rounds(
        Hypothesis.from_laws(dataset, (GRAVITY,)), dataset, [laws, Contacts()],
        rng=np.random.default_rng(0), max_rounds=2,
    )  # fmt: skip
    assert [r.decision.verdict for r in rounds] == ["effect adopted", "nothing missing"]
    assert (rounds[0].decision.best.code, rounds[0].decision.best.text.count("[")) == ("contact", 3)


def test_a_push_is_no_kicks_here_and_there():
    """A few of many instants imitate it, and pay for having been chosen."""

    def move(t, mass):
        return np.outer(0.02 * np.square(t), [1.0, 0.0])

    view = view_of(throws(np.random.default_rng(6), move=move))
    assert view.left @ view.left > 100
    assert {p.rank for p in Contacts().propose(view).proposals} == {3}


def test_other_scenes_do_not_feel_it():
    dataset = kicked(np.random.default_rng(4))
    view = view_of(dataset)
    best = Contacts().propose(view).proposals[0]
    found = fit(best.hypothesis, dataset, starts=best.starts)
    other = throws(np.random.default_rng(5), n_scenes=1).scenes
    rows = [held_out_rows(f, dataset, other)[0] for f in (view.fit, found)]
    assert rows[1]["foreseen"] == pytest.approx(rows[0]["foreseen"], rel=1e-9)


def carts(gained, seed=0):
    """Two carts; at 1.5 s the first runs into the other, by which they gain velocities."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 3.0, 0.02)
    behind = np.maximum(t - 1.5, 0.0)
    x = {"one": 0.6 * t + gained[0] * behind, "two": 0.9 + gained[1] * behind}
    frames = [
        pd.DataFrame({"t": t, "entity": name, "x": place + 1e-3 * rng.standard_normal(len(t))})
        for name, place in x.items()
    ]
    units = {"length": "m", "time": "s"}
    return bsp_gp.Dataset.from_frames(pd.concat(frames), list(map(bsp_gp.Entity, x)), units=units)


@pytest.mark.parametrize(
    ("gained", "code", "bodies"),
    [((-0.4, 0.2), "collision", ["one", "two"]), ((-0.4, 0.0), "contact", ["one"])],
)
def test_two_bodies_that_kick_each_other_as_they_meet_are_one_event(gained, code, bodies):
    family = Contacts().propose(view_of(carts(gained), NOTHING))
    best = max(family.proposals, key=lambda p: p.promise)
    kicks = [part for part in best.hypothesis.parts if isinstance(part, Kick)]
    assert (best.code, sorted(part.entity for part in kicks)) == (code, bodies)


def test_kicks_that_may_be_anywhere_in_their_recording_are_left_out():
    """Of a lift a kick was told at 13 s, give or take 10^17."""
    kicks = [
        Kick.of("a", "ball", f"kicked{k}", {"x": f"w{k}"}, f"t{k}",
                {f"w{k}": 1.0, f"t{k}": 10.0 * k}, (0.0, 60.0), 0.01)
        for k in (1, 2, 3)
    ]  # fmt: skip
    constants = {name: value for kick in kicks for name, value in kick.law.constants.items()}
    names = [name for kick in kicks for name in kick.law.constants]
    base, known = Hypothesis((kicks[2],)), {"t1": 40.0, "t3": 70.0}
    found = SimpleNamespace(
        parameters=[(name, "") for name in names], errors=[known.get(name, 0.1) for name in names],
        law=SimpleNamespace(constants=constants), starts=constants, n_rows=50, n_free=10,
        chisqr=40.0, is_failed=False,
    )  # fmt: skip
    proposal = Proposal("contact", "kick ...", Hypothesis(tuple(kicks)), -20.0, 50.0, rank=4)
    less = without_open_kicks(proposal, found, base)
    assert [kick.mark for kick in less.hypothesis.parts] == ["kicked2", "kicked3"]
    assert less.text == "kick ball[a, 20 s]" and (less.rank, less.log_prior) == (2, -10.0)
    assert without_open_kicks(less, found, base) is None
