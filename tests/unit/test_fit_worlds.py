"""The worlds that fits are judged by: right tracks, right bounds, and judges that can fail."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
NAMES = (
    "fit_tracks", "fit_worlds", "fit_orbits", "fit_laws", "fit_reference", "fit_judging",
    "fit_summary", "fit_studies",
)  # fmt: skip


@pytest.fixture(scope="module")
def made():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EXPERIMENTS))
        import fit_studies  # noqa: F401, which loads the others

        yield SimpleNamespace(**{name: sys.modules[name] for name in NAMES})
    for name in (*NAMES, "common", "ranks"):
        sys.modules.pop(name, None)


def accelerations(made, world, shot, n=24):
    """Accelerations along the true track: by differences, and by the typed law."""
    from bsp_gp.language.parse import parse_formula
    from bsp_gp.physics.bodies import dataset_types, stack
    from bsp_gp.physics.force import ForceLaw, Term

    h = (shot.times[-1] - shot.times[0]) / n / 400
    middles = np.linspace(shot.times[0], shot.times[-1], n)[1:-1]
    around = np.sort(np.add.outer(middles, h * np.arange(-2, 3)).ravel())
    times = np.concatenate([[shot.times[0]], around])
    fine = replace(world, shots=(replace(shot, times=times, sigma=np.array(1e-300)),))
    dataset = made.fit_tracks.dataset_of(fine, np.random.default_rng(0))
    p = dataset.scenes[0].positions
    far_before, before, at, after, far_after = (p[1 + k :: 5] for k in range(5))
    by_track = (-far_before + 16 * before - 30 * at + 16 * after - far_after) / (12 * h**2)
    v = (far_before - 8 * before + 8 * after - far_after) / (12 * h)
    types = dataset_types(dataset)
    terms = tuple(Term(parse_formula(text, types, units=dataset.units)) for text in world.laws)
    (batch,) = stack(dataset.scenes, dataset.up)
    by_law = ForceLaw(terms, world.truth).acceleration(
        batch.bodies, at[:, None], v[:, None], middles[:, None]
    )[:, 0]
    return by_track[:, batch.bodies.receivers], by_law


def check_law(made, world, share=0.95):
    for shot in world.shots:
        by_track, by_law = accelerations(made, world, shot)
        size = np.abs(by_law).mean() + np.abs(by_law).max(axis=(1, 2))
        close = np.abs(by_track - by_law).max(axis=(1, 2)) <= 1e-4 * size
        assert close.mean() >= share, world.kind


def laws_of(made):
    return list(made.fit_laws.CASES)


def test_there_are_twenty_laws(made):
    assert len(laws_of(made)) == 20


@pytest.mark.parametrize("index", range(20))
def test_tracks_obey_the_law_as_typed(made, index):
    name = laws_of(made)[index]
    check_law(made, made.fit_laws.case(name, np.random.default_rng([4, index])).world, 0.9)


@pytest.mark.slow
@pytest.mark.parametrize("study", ["oscillators", "orbits", "pushes", "exponent"])
def test_worlds_of_studies_obey_their_laws(made, study):
    seen = set()
    for index in range(5):
        world = made.fit_studies.data_world(study, index, 1)
        (shot,) = world.shots
        # A short stretch: what is asked is the equation of motion.
        until = min(len(shot.times), 40)
        check_law(made, replace(world, shots=(replace(shot, times=shot.times[:until]),)), 0.9)
        seen.add(world.kind)
    assert len(seen) > 1 or study in ("pushes", "exponent")


def test_a_wrong_law_is_told(made):
    world = made.fit_laws.case("screened", np.random.default_rng(0)).world
    with pytest.raises(AssertionError):
        check_law(made, replace(world, laws=(world.laws[0].replace("^2", "^1.9"),)))


def test_energy_of_an_eccentric_orbit_is_conserved(made):
    strength, axis, eccentricity = 3.0, 2.0, 0.9
    acceleration = made.fit_orbits._pulls("static", np.ones(1))
    state = made.fit_orbits._begun(np.random.default_rng(3), axis, eccentricity, strength, 2)
    assert np.square(state[1]).sum() / 2 - strength / np.linalg.norm(state[0]) == pytest.approx(
        -strength / (2 * axis), rel=1e-12
    )
    turns = 2 * np.pi * np.sqrt(axis**3 / strength) * np.arange(4)
    track = made.fit_tracks.integrated(acceleration)
    places = track(turns, {"k": np.array([strength])}, state[None, :, None])[0, :, 0]
    assert np.abs(places - state[0]).max() <= 1e-8 * axis


def test_the_closed_form_is_the_integrated_one(made):
    def acceleration(t, p, v, c):
        return -c["k"] / 2 * p - c["c"] / 2 * v

    times = np.linspace(0, 20, 50)
    states = np.array([[[[1.0, 0.2]], [[0.3, -0.4]]]])
    constants = {"k": np.array([3.0]), "c": np.array([0.2])}
    exact = made.fit_worlds._of_matrix(lambda c: -c["k"][:, None, None] * np.eye(2), 2.0)
    integrated = made.fit_tracks.integrated(acceleration)
    found = [track(times, constants, states) for track in (exact, integrated)]
    assert np.abs(found[0] - found[1]).max() <= 1e-10


def test_the_bound_is_that_of_a_straight_line_fit(made):
    """A free fall: g of one axis from a parabola, in closed form."""
    world = made.fit_laws.case("weight", np.random.default_rng(0)).world
    shot = world.shots[0]
    columns = np.stack([np.ones_like(shot.times), shot.times, shot.times**2 / 2], axis=1) / 0.01
    expected = np.linalg.inv(columns.T @ columns)[2, 2] / len(world.shots)
    assert made.fit_tracks.bound(world)[0, 0] == pytest.approx(expected, rel=1e-5)


# --- judges, with a fit that is scipy's -----------------------------------------------------------


def stand_in(made, monkeypatch, world, spoil=lambda fit: fit):
    def fitted(dataset, laws, **settings):
        found = made.fit_reference.reference(world, dataset)
        fit = SimpleNamespace(
            parameters=tuple((name, "") for name in world.truth), values=found.values,
            covariance=found.covariance, status="converged",
        )  # fmt: skip
        return spoil(fit), {"status": "converged", "cpu_s": 0.0}

    monkeypatch.setattr(made.fit_judging, "fitted", fitted)


def test_a_right_fit_passes(made, monkeypatch):
    world = made.fit_studies.data_world("pushes", 0, 0)
    stand_in(made, monkeypatch, world)
    row = made.fit_judging.judge_bound(world, np.random.default_rng(1), None)
    assert row["passed"] and not row["wrong_converged"]
    assert row["se_ratio"] == pytest.approx(1, abs=0.05)


def test_a_push_backwards_is_the_same_push(made, monkeypatch):
    world = made.fit_studies.data_world("pushes", 0, 0)
    stand_in(made, monkeypatch, world, lambda fit: SimpleNamespace(**{
        **vars(fit), "values": -fit.values}))  # fmt: skip
    row = made.fit_judging.judge_within("w", 4.0)(world, np.random.default_rng(1), None)
    assert row["passed"] and abs(row["deviation"]) < 4


def test_an_alias_that_is_called_converged_is_a_wrong_minimum(made, monkeypatch):
    world = made.fit_studies.data_world("pushes", 0, 0)
    stand_in(made, monkeypatch, world, lambda fit: SimpleNamespace(**{
        **vars(fit), "values": fit.values * [1.0, 0.9]}))  # fmt: skip
    row = made.fit_judging.judge_bound(world, np.random.default_rng(1), None)
    assert row["wrong_converged"] and not row["passed"]


def test_errors_that_are_too_large_do_not_pass(made, monkeypatch):
    world = made.fit_studies.data_world("pushes", 0, 0)
    stand_in(made, monkeypatch, world, lambda fit: SimpleNamespace(**{
        **vars(fit), "covariance": 2 * fit.covariance}))  # fmt: skip
    row = made.fit_judging.judge_bound(world, np.random.default_rng(1), None)
    assert not row["passed"] and not row["wrong_converged"]


def test_agreement_needs_both_values_and_errors(made, monkeypatch):
    case = made.fit_laws.case("linear drag", np.random.default_rng(0))
    for factor, passed in ((1.0, True), (1.05, False)):
        stand_in(made, monkeypatch, case.world, lambda fit, factor=factor: SimpleNamespace(**{
            **vars(fit), "covariance": factor * fit.covariance}))  # fmt: skip
        row = made.fit_judging.judge_agreement(case, np.random.default_rng(1), None)
        assert row["passed"] is passed


@pytest.mark.parametrize(("power", "uniform"), [(1.0, True), (1.6, False)])
def test_ranks_that_are_not_uniform_are_told(made, power, uniform):
    ranks = np.random.default_rng(0).random(400) ** power
    table = pd.DataFrame({"kind": "a", "rank_k": ranks})
    assert made.fit_summary.rank_lines(table)[1] is uniform


def test_a_summary_shows_what_failed(made):
    rows = [
        {"set": k, "kind": "push", "status": "converged", "passed": k > 0, "chi2": 1.0 + k,
         "wrong_converged": k == 0, "cpu_s": 0.1, "error": ""}
        for k in range(100)
    ]  # fmt: skip
    rows[1] |= {"status": "raised", "passed": False, "error": "ValueError: x", "chi2": np.nan}
    study = made.fit_studies.STUDIES["oscillators"]
    text = made.fit_summary.summary("oscillators", study, pd.DataFrame(rows))
    assert "98 of 100 sets pass" in text and "called converged: 1." in text
    assert "| 1 | push | raised |  | 0.1 | ValueError: x |" in text
    # The share is kept, and one wrong minimum is one too many.
    assert "**oscillators: NOT met**" in text
    rows[0]["wrong_converged"] = False
    text = made.fit_summary.summary("oscillators", study, pd.DataFrame(rows))
    assert "**oscillators: met**" in text
