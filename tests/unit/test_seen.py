"""What is seen of bodies through an instrument: maps, exact derivatives, fits that find them."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import held_out_errors
from bsp_gp.fitting.hypothesis import Hypothesis, Positions
from bsp_gp.fitting.parts.instrument import Instrument
from bsp_gp.fitting.rolling import roll
from bsp_gp.fitting.shooting import Shooting, cut_windows
from bsp_gp.fitting.tracks import ChainNoise
from bsp_gp.physics.engine.seen import sight
from tests.fitted_tracks import (
    body,
    dataset_of,
    differences,
    disc,
    flow_of,
    law_of,
    reference,
    scene_of,
    values_of,
)

PICTURE = {"middle": (0.3, -0.2), "size": 2.0}
KINDS = {
    "scale": (Instrument("scale"), (0.1,)),
    "clock": (Instrument("clock"), (-0.12,)),
    "tilt": (Instrument("tilt", (0, 1)), (0.2,)),
    "slant": (Instrument("slant", (1,), **PICTURE), (0.15,)),
    "perspective": (Instrument("perspective", (0,), **PICTURE), (0.1,)),
    "lens": (Instrument("lens", (0, 1), **PICTURE), (0.08,)),
    "tangential": (Instrument("tangential", (0, 1), **PICTURE), (0.08, 0.02, -0.03)),
    "decentred": (Instrument("decentred", (0, 1), **PICTURE), (0.08, 0.2, -0.3)),
    "zoom": (Instrument("zoom", (0, 1), 0.2, epoch=0.5, **PICTURE), (0.1, 0.02, -0.03)),
    "drift": (Instrument("drift", (0, 1), 1.0, epoch=0.5), (0.2, -0.1)),
    "drift by scene": (
        Instrument("drift", (0, 1), 1.0, whose=("s", "other")),
        (0.2, -0.1, 5.0, 5.0),
    ),
    "offset": (Instrument("offset", (0, 1), 1.0), (0.1, -0.15)),
}
CREW = (body("a", 1.0), body("b", 2.0), body("post", is_static=True))
LAW = law_of(
    "-b * (p_i - p_j) * (1 + norm(v_i - v_j) / (5 [m/s]))", "-c * norm(v_i) * v_i",
    "d * sin(3 [1/s] * t) * e_x", "-d * e_y", b=1.3, c=0.1, d=0.4,
)  # fmt: skip
TIMES = np.linspace(0.0, 1.5, 7)
START = np.array([[[1.0, 0.2], [-0.6, 0.9]], [[0.0, 1.5], [0.7, -0.4]]])
POST = np.array([0.4, -0.5])


def through(law, *kinds):
    """The law seen through parts at values."""
    values = {n: v for part, own in kinds for n, v in zip(part.names, own, strict=True)}
    frame = (*law.frame, *(part for part, _ in kinds))
    return replace(law, frame=frame, constants={**law.constants, **values})


def world(law=LAW, times=TIMES):
    places, velocities = reference(law, scene_of(times, CREW, [*START[0], POST]), *START, times)
    return places, velocities


def true_of(name, seen, time, is_driven, values):
    """The true place and time of what is seen, written for a single place."""
    middle, size = np.array(PICTURE["middle"]), PICTURE["size"]
    away = (seen - middle) / size
    if name == "scale":
        return seen / (1 + values[0]), time
    if name == "clock":
        return seen, time / (1 + values[0])
    if name == "tilt":
        c, s = np.cos(values[0]), np.sin(values[0])
        return np.array([[c, s], [-s, c]]) @ seen, time
    if name == "slant":
        return seen + values[0] * (seen - middle) * [0, 1], time
    if name == "perspective":
        return middle + (seen - middle) * (1 + values[0] * away[0]), time
    if name == "lens":
        bend = values[0] * away @ away
        roots = np.roots([bend, 0.0, -1.0, 1.0])
        return middle + (seen - middle) * roots[np.argmin(np.abs(roots - 1.0))].real, time
    if name == "tangential":  # Brown's two numbers beside the radial one
        (bend, *aside), square = values, away @ away
        roots = np.roots([bend * square, 0.0, -1.0, 1.0])
        radial = (seen - middle) * roots[np.argmin(np.abs(roots - 1.0))].real
        place = middle + radial
        own = (place - middle) / size
        return place + size * (2 * own * (own @ aside) + own @ own * np.array(aside)), time
    if name == "decentred":
        shift = size * np.array(values[1:])
        place, _ = true_of("lens", seen - shift, time, is_driven, values[:1])
        return place + shift, time
    if name == "zoom":
        late = time - 0.5
        away = seen - middle - size * np.array(values[1:]) * late
        return middle + away / (1 + values[0] * late), time
    if name == "offset":
        return seen - is_driven * np.array(values), time
    epoch = 0.5 if name == "drift" else 0.0
    return seen - (1 - is_driven) * np.array(values[:2]) * (time - epoch), time


def seen_of(name, true, true_time, is_driven, values):
    time = true_time * (1 + values[0]) if name == "clock" else true_time
    seen = true
    for _ in range(80):  # maps are near to the identity
        seen = seen + true - true_of(name, seen, time, is_driven, values)[0]
    return seen, time


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_a_law_moves_to_seen_coordinates(name):
    part, values = KINDS[name]
    places, velocities = world()
    h = 1e-5
    seen, speeds = np.empty_like(places), np.empty((2, 2))
    times = np.array([seen_of(name, POST, t, True, values)[1] for t in TIMES])
    for r in range(2):
        for row, t in enumerate(TIMES):
            seen[row, r] = seen_of(name, places[row, r], t, False, values)[0]
        ends = [
            seen_of(name, places[0, r] + s * h * velocities[0, r], s * h, False, values)
            for s in (1, -1)
        ]
        speeds[r] = (ends[0][0] - ends[1][0]) / (ends[0][1] - ends[1][1])
    post = np.stack([seen_of(name, POST, t, True, values)[0] for t in TIMES])
    data = np.concatenate([seen, post[:, None]], axis=1)
    law = through(LAW, (part, values))
    flow = flow_of(law, [scene_of(times, CREW, data)])
    first = np.stack([seen[0], speeds])[..., None]
    nodes = roll(law, flow.chains, first, np.full(1, 1e-10))
    np.testing.assert_allclose(np.moveaxis(nodes[0], (-2, -1), (0, 1))[:, 0], seen, atol=2e-8)
    assert np.abs(seen - places).max() > 0.01 or name == "clock" or name == "offset"


@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [[name] for name in KINDS] + [["tilt", "clock", "drift"], ["lens", "scale"]]
)
def test_derivatives_are_differences(names):
    law = through(LAW, *(KINDS[name] for name in names))
    flow = flow_of(law, [scene_of(TIMES, CREW, [*START[0], POST])])
    assert values_of(law).shape == (3 + sum(len(KINDS[n][1]) for n in names),)
    rng = np.random.default_rng(0)
    shape = (2, 2, 2, len(TIMES), 1)
    nodes = START[..., None, None] + 0.1 * rng.standard_normal(shape)
    mesh = flow.mesh(nodes)
    _, transitions = flow.run(nodes, mesh)
    expected = differences(flow, nodes, mesh)
    np.testing.assert_allclose(transitions, expected, rtol=1e-6, atol=2e-7)
    n = flow.n_state
    assert np.abs(expected[..., n:]).max(axis=(0, 1))[: len(KINDS[names[0]][1])].max() > 1e-3


@pytest.mark.slow
def test_derivatives_are_differences_in_three_dimensions():
    law = law_of("-b * (p_i - p_j)", "-c * norm(v_i) * v_i", n_dims=3, b=1.3, c=0.2)
    picture = {"middle": (0.1, 0.2, -0.3), "size": 2.0}
    law = through(
        law, (Instrument("perspective", (2,), **picture), (0.15,)),
        (Instrument("tilt", (0, 2)), (0.3,)), (Instrument("lens", (0, 1), **picture), (0.1,)),
    )  # fmt: skip
    flow = flow_of(law, [scene_of(TIMES, CREW, 0.5 * np.eye(3))])
    nodes = np.random.default_rng(0).uniform(-1, 1, (2, 2, 3, len(TIMES), 1))
    mesh = flow.mesh(nodes)
    expected = differences(flow, nodes, mesh)
    np.testing.assert_allclose(flow.run(nodes, mesh)[1], expected, rtol=1e-6, atol=2e-7)
    assert (np.abs(expected[..., flow.n_state :]).max(axis=(0, 1)) > 1e-3).all()


def test_contacts_are_where_bodies_truly_are():
    """Discs that touch only in true lengths."""
    law = law_of("c1 * (p_i - p_j) * does_collide(s_i, p_i, s_j, p_j)", c1=5.0)
    crew = (disc("a", 0.6), disc("b", 0.6))
    flows = [
        flow_of(law, [scene_of(TIMES, crew, [[0.0, 0.0], [1.3, 0.0]])])
        for law in (law, through(law, (Instrument("scale"), (0.2,))))
    ]
    state = np.zeros((2, 2, 2, 1))
    state[0, 1, 0] = 1.3
    pushes = []
    for flow in flows:
        points = flow.points(state, np.zeros(1), np.zeros(1, dtype=int))
        pushes.append(flow.motion.acceleration(points)[0, 0, 0])
    assert pushes[0] == 0.0
    np.testing.assert_allclose(pushes[1], -5.0 * 1.3)


LAGS = (
    (Instrument("delay", (), 1.0, whose=("b",)), (0.02,)),
    (Instrument("exposure", (), 1.0), (0.0009,)),
)


SHUTTER = Instrument("shutter", (1,), 1.0, middle=(0.3, 0.2))


def lagged(times=TIMES, lags=LAGS):
    places, velocities = world(times=times)
    data = np.concatenate([places, np.broadcast_to(POST, (len(times), 1, 2))], axis=1)
    flow = flow_of(through(LAW, *lags), [scene_of(times, CREW, data)])
    return flow, np.moveaxis(np.stack([places, velocities]), 1, -1)[..., None]


def test_what_is_seen_late_and_for_a_while():
    flow, nodes = lagged()
    times = np.linspace(0.0, 1.5, 1501)
    fine, speeds = world(times=times)
    track = CubicHermiteSpline(times, fine, speeds)
    found = sight(flow, nodes).places[:, 0]
    bend = track.derivative(2)
    late, variance = LAGS[0][1][0], LAGS[1][1][0]
    inner = slice(1, -1)
    for body_, delay in ((0, 0.0), (1, late)):
        at = TIMES[inner]
        expected = track(at - delay)[:, body_] + variance / 2 * bend(at - delay)[:, body_]
        np.testing.assert_allclose(found[inner, body_], expected, atol=8e-5)
        assert (
            np.abs(found - np.moveaxis(nodes[0], (-2, -1), (0, 1))[:, 0])[inner, body_].max() > 4e-4
        )


def test_what_a_shutter_sees_row_by_row():
    by = 0.01
    flow, nodes = lagged(lags=((SHUTTER, (by,)),))
    times = np.linspace(0.0, 1.5, 1501)
    fine, speeds = world(times=times)
    track = CubicHermiteSpline(times, fine, speeds)
    found, inner = sight(flow, nodes).places[1:-1, 0], TIMES[1:-1]
    for k in (0, 1):
        late = np.zeros(len(inner))
        for _ in range(20):  # a row is read when the body is there
            late = by * (track(inner + late)[np.arange(len(inner)), k, 1] - SHUTTER.middle[1])
        np.testing.assert_allclose(found[:, k], track(inner + late)[:, k], atol=8e-5)
    places = np.moveaxis(nodes[0], (-2, -1), (0, 1))[1:-1, 0]
    assert np.abs(found - places).max() > 1e-3


@pytest.mark.slow
def test_derivatives_of_what_is_seen_late_are_differences():
    lags = (LAGS[0][0], (0.2,)), (LAGS[1][0], (0.04,)), (SHUTTER, (0.05,))
    flow, nodes = lagged(TIMES[:4], lags)
    shooting = Shooting(
        flow, ChainNoise(flow.chains.times, np.ones(flow.chains.observed.shape)),
        cut_windows(flow.chains.lengths),
    )  # fmt: skip
    values, mesh, n = values_of(flow.motion.law), flow.mesh(nodes), flow.n_state
    condensed = shooting.linearise(values, nodes, mesh)[-1]
    own, shared = shooting.columns(condensed, n)

    def seen(start, constants):
        law = flow.motion.law.with_values(flow.motion.parameters, constants)
        rolled = roll(law, flow.chains, start.reshape(2, 2, 2, 1), np.full(1, 1e-8))
        flow.motion.set_constants(constants)
        return sight(flow, rolled).places

    first, h = nodes[..., 0, 0].ravel(), 1e-3
    for k in range(n + len(values)):
        ends = []
        for sign in (1, -1):
            start, constants = first.copy(), values.copy()
            (start if k < n else constants)[k if k < n else k - n] += sign * h
            ends.append(seen(start, constants))
        expected = (ends[0] - ends[1]) / (2 * h)
        column = own[k] if k < n else shared[k - n]
        np.testing.assert_allclose(column, expected, atol=2e-4)
        assert np.abs(expected).max() > 1e-2


# --- fits -----------------------------------------------------------------------------------------

WEIGHT = "9.81 [m/s^2] * m_i * down"


def throws(n=5, sigma=0.004, seed=3, drag=0.0):
    """Balls under their weight (and a drag), as they are."""
    rng = np.random.default_rng(seed)
    law = law_of("9.81 [m/s^2] * m_i * down", "-c * v_i", c=drag)
    times, out = np.linspace(0.0, 1.2, 40), []
    for k in range(n):
        start = np.array([[[0.0, 2.0]], [[rng.uniform(-3, 3), rng.uniform(2, 6)]]])
        scene = scene_of(times, (body("ball", rng.uniform(0.5, 2)),), start[0], str(k))
        out.append((scene, reference(law, scene, *start, times)[0]))
    return out, sigma, rng


def photographed(made, change):
    """Data of tracks that a camera changes."""
    tracks, sigma, rng = made
    scenes = []
    for scene, places in tracks:
        times, seen = change(scene.times, places)
        seen = seen + sigma * rng.standard_normal(seen.shape)
        scenes.append(replace(scene, times=times, positions=seen))
    return dataset_of(scenes, noise=(sigma, sigma))


def turned(angle, places):
    c, s = np.cos(angle), np.sin(angle)
    return places @ np.array([[c, s], [-s, c]])


def through_lens(kappa, middle, size, places):
    """What a lens makes of places: x - M = (1 - kappa r^2) (X - M)."""
    r2 = np.square((places - middle) / size).sum(axis=-1, keepdims=True)
    return middle + (places - middle) * (1 - kappa * r2)


def check_found(found, **truth):
    assert found.status == "converged" and found.chi2_red < 1.4
    names = [name for name, _ in found.parameters]
    assert set(truth) == set(names)
    for name, value in truth.items():
        k = names.index(name)
        assert found.errors[k] < 0.4 * abs(value), name
        assert abs(found.values[k] - value) < 3.5 * found.errors[k], name
        assert found.law.constants[name] == found.values[k]


def test_a_tilted_camera_with_another_scale_is_found():
    data = photographed(throws(), lambda t, x: (t, turned(0.06, 1.03 * x)))
    plain = Hypothesis.from_laws(data, [WEIGHT])
    both = plain + Instrument("scale") + Instrument("tilt", (0, 1))
    assert [p.name for p in both.parameters] == ["scale", "tilt_xy"]
    assert "x = R(tilt_xy) X" in both.describe()
    assert fit(plain, data).chi2_red > 2
    check_found(fit(both, data), scale=0.03, tilt_xy=0.06)


def test_a_lens_is_found_where_flights_are_declared():
    middle, size = np.array([0.0, 2.0]), 3.0
    data = photographed(throws(sigma=0.002), lambda t, x: (t, through_lens(0.05, middle, size, x)))
    part = Instrument("lens", (0, 1), middle=tuple(middle), size=size)
    check_found(fit(Hypothesis.from_laws(data, [WEIGHT]) + part, data), lens_xy=0.05)


def test_a_clock_is_found_beside_a_drag():
    data = photographed(throws(drag=0.8), lambda t, x: (1.04 * t, x))
    found = fit(Hypothesis.from_laws(data, [WEIGHT, "-c * v_i"]) + Instrument("clock"), data)
    check_found(found, c=0.8, clock=0.04)


def test_a_delay_and_an_exposure_are_found_on_an_orbit():
    pull = law_of("-g * m_i * m_j * inverse(square(norm(p_i - p_j))) * normalize(p_i - p_j)", g=1.0)
    crew = (body("a", 1.0), body("b", 3.0))
    start = np.array([[[1.0, 0.0], [-0.3, 0.0]], [[0.0, 1.2], [0.0, -0.4]]])
    times, sigma = np.linspace(0.0, 5.0, 251), 0.001
    fine = np.linspace(0.0, 5.0, 5001)
    scene = scene_of(times, crew, start[0])
    places, velocities = reference(pull, scene, *start, fine)
    track = CubicHermiteSpline(fine, places, velocities)
    seen = track(times)
    seen[:, 0] = track(times - 0.01)[:, 0]
    width = 0.05
    seen += width**2 / 2 * track.derivative(2)(times)
    seen += sigma * np.random.default_rng(0).standard_normal(seen.shape)
    data = dataset_of([replace(scene, positions=seen)], noise=(sigma, sigma))
    text = "-m_i * m_j * (1 [N*m^2/kg^2]) * inverse(square(norm(p_i - p_j))) * normalize(p_i - p_j)"
    parts = Hypothesis(
        (Instrument("delay", (), 0.06, whose=("a",)), Instrument("exposure", (), 0.0036))
    )
    found = fit(Hypothesis.from_laws(data, [text]) + parts, data)
    check_found(found, delay_a=0.01, exposure=width**2)


def test_held_out_tracks_are_foreseen_as_they_are_seen():
    data = photographed(throws(n=8), lambda t, x: (t, turned(0.05, x)))
    train = replace(data, scenes=data.scenes[:5])
    plain = Hypothesis.from_laws(data, [WEIGHT])
    errors = [
        held_out_errors(fit(h, train), data, data.scenes[5:]).rollout_rmse
        for h in (plain, plain + Instrument("tilt", (0, 1)))
    ]
    assert errors[1] < 0.3 * errors[0]


def test_bounds_of_a_part_hold():
    data = photographed(throws(), lambda t, x: (t, turned(0.2, x)))
    found = fit(Hypothesis.from_laws(data, [WEIGHT]) + Instrument("tilt", (0, 1), limit=0.05), data)
    assert found.status == "at_bound" and found.values[0] == pytest.approx(0.05)


def test_the_first_instrument_takes_nothing():
    data = photographed(throws(n=1), lambda t, x: (t, x))
    plain = Hypothesis.from_laws(data, [WEIGHT])
    assert plain.law.frame == () and (plain + Positions()).law.frame == ()


def test_a_seen_law_keeps_its_frame():
    law = through(LAW, KINDS["tilt"])
    for other in (
        pickle.loads(pickle.dumps(law)), law.with_constants({"b": 2.0}), law.without(0),
        law.plus(LAW.terms[0]),
    ):  # fmt: skip
        assert other.frame == law.frame and "tilt_xy" in other.names
        assert other.constants["tilt_xy"] == law.constants["tilt_xy"]
    assert Instrument("tilt", (0, 1)).at({"tilt_xy": 0.3}).parameters[0].start == 0.3
