"""Random kicks: an exact likelihood, the right terms, and no kicks where there are none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.kinks import kinks
from bsp_gp.fitting.langevin import Track, _Model, _Part, exponentials, models_of
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.proposers.kicks import _likeliest, is_kicked, leaps, shared
from bsp_gp.report.page import page_of
from bsp_gp.report.sentences import verdict_sentence
from bsp_gp.units import UnitSystem


def kicked(rng, *, drag=1.0, trap=0.0, power=2.0, noise=0.02, n_rows=400, step=0.1, centre=0.0):
    """A track in two dimensions by exact steps."""
    f, q, _ = _Model(False, drag, trap, max(power, 1e-30), noise).transitions(np.array([step]))
    factor = np.linalg.cholesky(q[0])
    state, out = np.stack([np.zeros(2), rng.standard_normal(2)]), np.empty((n_rows, 2))
    for row in range(n_rows):
        out[row] = state[0]
        state = f[0] @ state + factor @ rng.standard_normal((2, 2))
    return Track(step * np.arange(n_rows), out + centre + noise * rng.standard_normal(out.shape))


@pytest.mark.parametrize("is_overdamped", [True, False])
def test_the_density_is_that_of_the_joint_normal(is_overdamped):
    rng = np.random.default_rng(0)
    model = _Model(is_overdamped, 0.0 if is_overdamped else 0.3, 0.2, 0.5, 0.4)
    times = np.array([0.0, 1.0, 1.5, 4.0, 5.0])
    kinds, number = np.unique(np.diff(times), return_inverse=True)
    part = _Part(times, rng.standard_normal((5, 1)), number)
    f, q, push = model.transitions(kinds)
    n = f.shape[1]
    first = np.diag(np.array([3.0, 2.0][:n]) ** 2)
    spread, means, crossed = [first], [np.zeros(n)], {}
    for k in part.number:
        spread.append(f[k] @ spread[-1] @ f[k].T + q[k])
        means.append(f[k] @ means[-1] + push[k])
    covariance = np.empty((5, 5))
    for a in range(5):
        crossed = spread[a]
        covariance[a, a] = crossed[0, 0]
        for b in range(a + 1, 5):
            crossed = f[part.number[b - 1]] @ crossed
            covariance[a, b] = covariance[b, a] = crossed[0, 0]
    covariance += 0.16 * np.eye(5)
    height, right, square = part.density(model, model.transitions(kinds), 2.0, 3.0)
    rows = part.places[:, 0]
    assert height == pytest.approx(multivariate_normal(np.zeros(5), covariance).logpdf(rows))
    pushed = multivariate_normal([m[0] for m in means], covariance).logpdf(rows)
    assert height + right[0] - square / 2 == pytest.approx(pushed)


@pytest.mark.parametrize(
    ("settings", "terms"),
    [
        ({}, {"kicks", "drag"}), ({"drag": 0.0}, {"kicks"}), ({"power": 0.0}, {"drag"}),
        ({"trap": 4.0, "centre": 7.0}, {"kicks", "drag", "trap"}),
    ],
)  # fmt: skip
@pytest.mark.slow
def test_the_terms_are_found_and_intervals_hold(settings, terms):
    track = kicked(np.random.default_rng(1), **settings)
    best = models_of([track])[0]
    assert set(best.terms) == terms
    truth = {"drag_rate": 1.0, "trap_rate": 4.0, "kick_power": 2.0, "noise": 0.02, "centre_x": 7.0}
    for name in set(best.values) & set(truth):
        value, low, high = best.values[name]
        assert value - 2.5 * (value - low) < truth[name] < value + 2.5 * (high - value)


@pytest.mark.slow
def test_units_of_length_and_time_are_of_no_matter():
    track = kicked(np.random.default_rng(3))
    other = Track(60 * track.times, 1e-6 * track.places)
    one, two = (models_of([t])[0] for t in (track, other))
    assert one.terms == two.terms
    assert two.values["diffusion"][0] == pytest.approx(one.values["diffusion"][0] / 6e13, rel=1e-2)


@pytest.mark.slow
def test_kicks_are_told_by_the_loop():
    track = kicked(np.random.default_rng(2), trap=4.0)
    bead = Entity("bead", properties={"mass": 1e-15})
    scene = Scene("bead", track.times, 1e-6 * track.places[:, None], (bead,))
    units = UnitSystem.from_declared({"length": "um", "time": "s", "mass": "kg"})
    report = close_loop(Dataset("bead", (scene,), units=units), "nothing", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted" and report.stop_reason == "nothing_left"
    page = page_of(report)
    assert verdict_sentence(page) == "Random kicks with drag and a trap act on these."
    known = {c.name: c for c in page.constants}
    assert known["diffusion"].unit == "um^2/s"
    assert known["diffusion"].low < 1.0 < known["diffusion"].high
    assert known["temperature"].unit == "K"
    stiffness = known["stiffness"]
    assert abs(stiffness.value - 4e-15) < stiffness.high - stiffness.low  # of 90 %: 3.3 sigma


def sinking(n_beads=4):
    """Beads without inertia in several scenes that sink by 1 um/s; one may pass for a far trap."""
    rng, times, scenes = np.random.default_rng(2), 0.05 * np.arange(190), []
    for k in range(n_beads):
        steps = np.sqrt(2 * 0.21 * 0.05) * rng.standard_normal((190, 2)) + [0.0, 0.05]
        places = rng.uniform(0, 50, 2) + np.cumsum(steps, axis=0)
        places += 0.035 * rng.standard_normal(places.shape)
        scenes.append(Scene(f"bead {k}", times, 1e-6 * places[:, None], (Entity("bead"),)))
    units = UnitSystem.from_declared({"length": "um", "time": "s"})
    return Dataset("beads", tuple(scenes), units=units)


def seen_for(exposure, heavy=False, n_rows=400, fine=40):
    """Three beads without inertia, D = 0.43, of which each row is the mean over an exposure."""
    rng, tracks = np.random.default_rng(5), []
    for _ in range(3):
        steps = rng.standard_normal((n_rows * fine, 2)) * np.sqrt(2 * 0.43 / 30 / fine)
        if heavy:  # out of focus at times
            steps *= np.repeat(rng.uniform(0.6, 1.3, n_rows * fine // 800), 800)[:, None]
        walk = np.cumsum(steps, axis=0).reshape(n_rows, fine, 2)
        places = walk[:, -max(round(exposure * fine), 1) :].mean(axis=1)
        places += 0.02 * rng.standard_normal((n_rows, 2))
        tracks.append(Track(np.arange(n_rows) / 30, places))
    return tracks


@pytest.mark.parametrize("exposure", [0.0, 0.8])
def test_what_a_camera_blurs_is_no_inertia(exposure):
    models = [m for m in models_of(seen_for(exposure)) if m.terms == {"kicks", "drag"}]
    assert models[0].is_overdamped and models[0].is_blurred == (exposure > 0)
    value, low, high = models[0].values["diffusion"]
    assert value - 2 * (value - low) < 0.43 < value + 2 * (high - value)
    if exposure:
        instant = next(m for m in models if m.is_overdamped and not m.is_blurred)
        assert instant.values["diffusion"][2] < 0.43  # too few without it
        assert models[0].values["exposure"][2] <= 1 / 30


def test_the_density_of_blurred_places_is_that_of_the_joint_normal():
    part = _Part(np.array([0.0, 1.0, 2.5]), np.array([[0.0], [0.4], [0.1]]), np.arange(2))
    model = _Model(True, 0.0, 0.0, 0.5, 0.4, exposure=0.6)
    # Means over [t - 0.6, t] of a walk of 2 D = 1 that begins 0.6 before the first row.
    fine = np.arange(1, 3101) * 0.001
    walk = np.minimum(fine[:, None], fine)
    weights = np.stack([(fine > t - 0.6) & (fine <= t) for t in (0.6, 1.6, 3.1)]) / 600.0
    covariance = weights @ walk @ weights.T
    far = 300.0  # so that where the walk begins is of no matter
    joint = covariance - covariance[0, 0] + far**2 + 0.16 * np.eye(3)
    moves = model.transitions(np.array([1.0, 1.5]))
    height = part.density(model, moves, 2.0, far)[0]
    expected = multivariate_normal(np.zeros(3), joint).logpdf(part.places[:, 0])
    assert height == pytest.approx(expected, abs=0.02)


def test_tails_that_are_a_little_heavy_hide_no_kicks():
    best = models_of(seen_for(0.0, heavy=True))[0]
    assert best.terms == {"kicks", "drag"} and best.oddity > 0.01


def test_beads_that_sink_are_pushed_and_in_no_trap_far_away():
    tracks = [Track(s.times, s.positions[:, 0]) for s in sinking().scenes]
    best = models_of(tracks)[0]
    assert best.terms == {"kicks", "drag", "push"} and best.is_overdamped and best.oddity > 0.01
    value, low, high = best.values["push_y"]
    assert low < 1e-6 < high and high - low < 0.6e-6


@pytest.mark.slow
def test_kicks_are_not_refused_for_rows_that_another_noise_foretells():
    """The noise had a memory beside no kicks; without it, held-out scenes seemed to refuse them."""
    report = close_loop(sinking(), "nothing", rng=0, n_bootstrap=0)
    assert report.verdict == "effect adopted" and report.rounds[0].effect.code == "kicks"


@pytest.mark.slow
def test_a_swing_that_can_be_foreseen_is_no_matter_of_kicks():
    """A spring with drag as the square of the speed was told as kicks in a trap with drag."""
    times = np.linspace(0.0, 6.0, 241)

    def motion(t, state):
        return [state[1], -25.0 * state[0] - 0.4 * state[1] - 3.0 * abs(state[1]) * state[1]]

    track = solve_ivp(motion, (0, 6), [0.3, 0.0], t_eval=times, rtol=1e-9, atol=1e-12).y[0]
    places = np.zeros((241, 1, 2))
    places[:, 0, 0] = 0.7 + track + 1e-3 * np.random.default_rng(4).standard_normal(241)
    bob = Entity("bob", "disc", radius=0.01, properties={"mass": 0.2})
    units = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
    data = Dataset("spring", (Scene("s", times, places, [bob]),), units=units)
    report = close_loop(data, (), rng=0, n_bootstrap=0, max_rounds=1)
    effect = report.rounds[0].effect
    assert effect.code == "law" and "centre_x1" in effect.law and "norm(v_i)^2" in effect.law


def recorded(track):
    scene = Scene("one", track.times, track.places[:, None], (Entity("bead"),))
    return Dataset(
        "bead", (scene,), units=UnitSystem.from_declared({"length": "m", "time": "s"})
    )


def test_what_shakes_all_beads_alike_kicks_none_of_them():
    rng = np.random.default_rng(4)
    camera = kicked(rng, drag=5.0, power=20.0, n_rows=200).places
    places, names = [], []
    for k in range(3):
        own = kicked(rng, drag=5.0, power=20.0, n_rows=200)
        places.append([own.places + k + own.times[:, None], 0.1 * own.places + k + camera])
        names.append(Entity(str(k), properties={"mass": 1.0}))
    for is_shaken, has_kicks in ((0, True), (1, False)):
        positions = np.stack([p[is_shaken] for p in places], axis=1)
        data = Dataset("beads", (Scene("a", own.times, positions, tuple(names)),))
        base = fit(Hypothesis.from_laws(data, "nothing"), data)
        assert (shared(data, [0, 1]) > 0.9) != has_kicks
        assert is_kicked(data, base, Criteria()) == has_kicks


def test_a_kick_that_is_larger_than_others_cuts_no_recording(monkeypatch):
    """One of eight recordings of random kicks had been cut as if the body had been hit."""
    data = recorded(kicked(np.random.default_rng(1), noise=0.05, n_rows=300))
    (scene,) = data.scenes
    assert kinks(scene.times, scene.positions[:, 0]), "its velocity jumps by chance"
    begun = fit(Hypothesis.from_laws(data, "nothing"), data)
    assert is_kicked(data, begun, Criteria())
    smooth = np.stack([np.cos(scene.times), 0.4 * np.sin(1.7 * scene.times)], axis=1)
    hit = smooth + np.maximum(scene.times - 14.05, 0)[:, None] * [3.0, -2.0]
    noise = 0.05 * np.random.default_rng(0).standard_normal(hit.shape)
    data = recorded(Track(scene.times, hit + noise))
    assert not is_kicked(data, fit(Hypothesis.from_laws(data, "nothing"), data), Criteria())


@pytest.mark.slow
def test_what_is_kicked_at_random_is_taken_whole():
    data = recorded(kicked(np.random.default_rng(1), noise=0.05, n_rows=300))
    report = close_loop(data, "nothing", rng=0, n_bootstrap=0)
    (done,) = [r for r in report.rounds if r.adopted]
    assert done.effect.code == "kicks"


@pytest.mark.parametrize("lasts, are_kicks", [(1.0, False), (0.0, True)])
def test_a_force_that_goes_on_is_no_kick(lasts, are_kicks):
    rng = np.random.default_rng(4)
    pushes = rng.standard_normal((400, 2))
    keep = np.exp(-0.1 / lasts) if lasts else 0.0
    for row in range(1, 400):
        pushes[row] = keep * pushes[row - 1] + np.sqrt(1 - keep**2) * pushes[row]
    speeds = np.cumsum(pushes * 0.1, axis=0)
    places = np.cumsum(speeds * 0.1, axis=0) + 2e-3 * rng.standard_normal((400, 2))
    best = models_of([Track(0.1 * np.arange(400), places)], near=1.0)[0]
    assert "kicks" in best.terms and best.are_kicks is are_kicks


def test_what_swings_undisturbed_is_not_kicked():
    """Its rates alone were looked for too far off, and kicks of no size stood in their place."""
    rng, times = np.random.default_rng(0), np.arange(500) / 20
    rate = -0.03 + 1j * np.sqrt(5.3 - 0.03**2)
    swing = np.exp(rate * times)
    places = np.stack([(0.2 * swing).real, (0.13j * swing).real], axis=1)
    best = models_of([Track(times, places + 0.001 * rng.standard_normal(places.shape))])[0]
    assert best.terms == {"drag", "trap"}
    assert best.values["trap_rate"][0] == pytest.approx(5.3, rel=1e-3)
    assert best.values["drag_rate"][0] == pytest.approx(0.06, rel=0.05)


def wandering(rate=5.0, noise=0.02, n_rows=2000, step=0.01):
    """A bead in a trap, in which no inertia is seen."""
    rng, kept = np.random.default_rng(4), np.exp(-rate * step)
    places = np.zeros((n_rows, 2))
    spread = np.sqrt(0.9 / rate * (1 - kept**2))
    for row in range(1, n_rows):
        places[row] = kept * places[row - 1] + spread * rng.standard_normal(2)
    places += noise * rng.standard_normal(places.shape) + [5.0, 7.0]
    return Track(step * np.arange(n_rows), places)


def test_a_stiff_trap_is_found_from_the_steps_between_rows():
    """From wider steps the fit ended in no trap at all."""
    best = models_of([wandering()])[0]
    assert best.terms == {"kicks", "drag", "trap"} and best.is_overdamped
    value, low, high = best.values["trap_rate"]
    assert 0.8 * low < 5.0 < 1.25 * high and value == pytest.approx(5.0, rel=0.4)


@pytest.mark.slow
def test_who_is_kicked_in_a_trap_may_be_noise_with_a_memory():
    """It was told as noise alone: both are the same process."""
    report = close_loop(recorded(wandering()), [], rng=0, n_bootstrap=0)
    assert report.verdict == "cannot tell"
    told = verdict_sentence(page_of(report))
    assert "random kicks with a trap" in told and "noise with a memory" in told


def test_a_track_that_leaps_to_another_bead_is_cut_there():
    rng = np.random.default_rng(3)
    steps = rng.normal(0.0, 0.1, (400, 2))
    steps[250] = 3.0, -2.0
    places = np.cumsum(steps, axis=0)
    assert leaps(np.arange(400.0), places).tolist() == [250]
    fast = np.cumsum(steps + 2.0 * np.exp(-np.arange(400)[:, None] / 5.0), axis=0)
    assert 1 not in leaps(np.arange(400.0), fast)  # what is fast at first is no leap


def test_a_drift_is_no_trap_far_away():
    track = wandering(1e-3, n_rows=1500)
    drifting = replace(track, places=track.places + 1.5 * track.times[:, None])
    data = Dataset("bead", (Scene("a", track.times, drifting.places[:, None], (Entity("bead"),)),))
    base = fit(Hypothesis.from_laws(data, "nothing"), data)
    best, _ = _likeliest([drifting], base, Criteria())
    assert "push" in best.terms and "trap" not in best.terms


def test_what_shakes_a_little_hides_no_kicks():
    """A table or a camera that shakes makes errors of forecasts alike, if one looks for long."""
    track = wandering(1e-3, noise=0.05, n_rows=4000)
    shake = 0.05 * np.sin(2 * np.pi * track.times / 0.05)[:, None]
    shaken = replace(track, places=track.places + shake)
    best = models_of([shaken], near=8.0)[0]
    assert "kicks" in best.terms and best.oddity > 0.01


def test_noise_that_is_not_seen_has_a_limit():
    rng = np.random.default_rng(4)
    walk = Track(np.arange(400.0), np.cumsum(rng.standard_normal((400, 2)), axis=0))
    best = next(m for m in models_of([walk]) if m.terms == {"kicks", "drag"} and m.is_overdamped)
    assert best.values["noise"][2] < 1.0


@pytest.mark.parametrize("n", [2, 4, 6])
def test_exponentials_of_short_and_long_steps_are_those_of_scipy(n):
    rng = np.random.default_rng(n)
    matrix, times = rng.normal(size=(n, n)), 10 ** rng.uniform(-6, 1, 200)
    ours, theirs = exponentials(matrix, times), expm(matrix * times[:, None, None])
    # Each to its own digits: of the shortest steps what they change is about as exact.
    for own, other in ((ours, theirs), (ours - np.eye(n), theirs - np.eye(n))):
        size = np.abs(other).max(axis=(1, 2))
        assert (np.abs(own - other).max(axis=(1, 2)) < 1e-12 * size + 4e-16).all()


def test_exponentials_of_nothing_and_of_no_number():
    assert exponentials(np.zeros((2, 2)), np.array([0.0, 3.0])) == pytest.approx(
        np.tile(np.eye(2), (2, 1, 1))
    )
    assert np.isnan(exponentials(np.array([[np.inf]]), np.array([1.0]))).all()
