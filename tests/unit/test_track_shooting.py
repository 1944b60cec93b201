"""Nodes joined to tracks: the small problem in the constants is the large one with all states."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp.fitting.coordinates import Coordinates
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.fitting.least_squares import minimise
from bsp_gp.fitting.problem import Settings
from bsp_gp.fitting.shooting import TALL, Shooting, _triangles, cut_windows
from bsp_gp.fitting.tracks import ChainNoise, TrackPoint, TrackProblem
from tests.fitted_tracks import (
    body,
    dataset_of,
    flow_of,
    law_of,
    parameters_of,
    scene_of,
    values_of,
)

SPRING = law_of("-c1 * (p_i - p_j) - c2 * v_i", c1=4.0, c2=0.3)
POST = body("post", is_static=True)
SINGLE = (body("a", 1.0), POST)
PAIR = (body("a", 1.0), body("b", 2.0))


def tracks(crew, lengths, seed=0, missing=()):
    """Smooth curves with noise; `missing` rows of the first body are gaps."""
    rng = np.random.default_rng(seed)
    scenes = []
    for k, n in enumerate(lengths):
        times = np.cumsum(rng.uniform(0.05, 0.15, n))
        places = np.zeros((n, len(crew), 2))
        for m, member in enumerate(crew):
            if member.is_static:
                places[:, m] = [0.0, -3.0]
                continue
            phase = rng.uniform(0, 6, 2)
            places[:, m] = m + np.sin(2 * times[:, None] + phase) + 0.02 * rng.normal(size=(n, 2))
        places[[r for r in missing if r < n], 0] = np.nan
        scenes.append(scene_of(times, crew, places, f"s{k}"))
    return scenes


def setting(law, crew, lengths, rows=None, noise=None, **options):
    """A shooting over scenes, with nodes near the data that do not join."""
    flow = flow_of(law, tracks(crew, lengths, **options), 1e-9)
    chains = flow.chains
    rng = np.random.default_rng(5)
    nodes = np.zeros((2, chains.n_moving, chains.n_dims, *chains.times.shape))
    places = np.moveaxis(chains.observed, (0, 1), (-2, -1))
    nodes[0] = np.where(np.isfinite(places), places, 0.3) + 0.01 * rng.normal(size=places.shape)
    nodes[1] = rng.normal(size=places.shape)
    sigma = 0.02 * (1 + 0.5 * rng.random(chains.observed.shape))
    variance = np.where(np.isfinite(chains.observed), sigma**2, np.nan)
    noise = noise or (lambda times, variance: ChainNoise(times, variance))
    shooting = Shooting(flow, noise(chains.times, variance), cut_windows(chains.lengths, rows))
    return shooting, nodes, flow.mesh(nodes)


def explicit(shooting, nodes, mesh):
    """All rows and all unknowns: changes of every node and of the constants.

    Returns the matrix and right side of the weighted rows and priors, those of the conditions that
    nodes join, and where the nodes of each window stand among the unknowns.
    """
    flow, chains, windows = shooting.flow, shooting.chains, shooting.windows
    flow.motion.set_constants(values_of(flow.motion.law))
    ends, transitions = flow.run(nodes, mesh)
    n, k, half = flow.n_state, flow.n_constants, flow.n_state // 2
    at, count = {}, 0
    for w, (first, stop) in enumerate(zip(windows.first, windows.stop, strict=True)):
        for row in range(first, stop):
            at[w, row] = count
            count += n
    size = count + k
    rows, right, joins, lacks = [], [], [], []
    number = {(r, c): q for q, (r, c) in enumerate(zip(flow.row, flow.chain, strict=True))}
    for (w, row), place in at.items():
        chain = windows.chain[w]
        seen = chains.observed[row, chain].ravel()
        variance = shooting.noise.variance[row, chain].ravel()
        here = nodes[..., row, chain].ravel()
        for q in range(half):
            if np.isfinite(seen[q]):
                line = np.zeros(size)
                line[place + q] = 1 / np.sqrt(variance[q])
                rows.append(line)
                right.append((seen[q] - here[q]) / np.sqrt(variance[q]))
        if row == windows.first[w]:
            for q in range(n):
                line = np.zeros(size)
                line[place + q] = shooting.prior[q, chain]
                rows.append(line)
                right.append(0.0)
        if (w, row + 1) in at:
            own = number[row, chain]
            block = np.zeros((n, size))
            block[:, at[w, row + 1] : at[w, row + 1] + n] = np.eye(n)
            block[:, place : place + n] = -transitions[own][:, :n]
            block[:, count:] = -transitions[own][:, n:]
            joins.append(block)
            lacks.append((ends[..., own] - nodes[..., row + 1, chain]).ravel())
    return np.array(rows), np.array(right), np.vstack(joins), np.concatenate(lacks), at, count


def solved(rows, right, joins, lacks):
    """Least squares under conditions, by their null space."""
    special = np.linalg.lstsq(joins, lacks, rcond=None)[0]
    _, values, vectors = np.linalg.svd(joins)
    null = vectors[len(values) :].T
    free = np.linalg.lstsq(rows @ null, right - rows @ special, rcond=None)[0]
    found = special + null @ free
    return found, float(np.sum(np.square(right - rows @ found)))


CASES = {
    "whole": (SPRING, SINGLE, (9,), {}),
    "two lengths": (SPRING, SINGLE, (11, 5), {}),
    "windows": (SPRING, SINGLE, (13, 7), {"rows": 4}),
    "gaps": (SPRING, SINGLE, (9, 8), {"missing": (3, 4)}),
    "coupled": (SPRING, PAIR, (8, 5), {"missing": (2,)}),
    "bodies alone": (law_of("-c1 * norm(v_i) * v_i + c2 * e_x", c1=0.2, c2=0.5), PAIR, (6,), {}),
}


@pytest.mark.parametrize("name", CASES)
def test_condensing_is_the_large_problem(name):
    law, crew, lengths, options = CASES[name]
    shooting, nodes, mesh = setting(law, crew, lengths, **options)
    residual, jacobian, rests, condensed = shooting.linearise(values_of(law), nodes, mesh)
    rows, right, joins, lacks, at, count = explicit(shooting, nodes, mesh)
    expected, chisqr = solved(rows, right, joins, lacks)
    step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    np.testing.assert_allclose(step, expected[count:], rtol=1e-7)
    assert np.sum(np.square(residual - jacobian @ step)) == pytest.approx(chisqr, rel=1e-9)
    # Constants held where they are: the states alone take `rest` off what the nodes leave.
    held = np.vstack([joins, np.eye(rows.shape[1])[count:]])
    _, without = solved(rows, right, held, np.concatenate([lacks, np.zeros(len(step))]))
    assert np.sum(np.square(residual)) == pytest.approx(without, rel=1e-9)
    special = joined(shooting, condensed)
    whole = np.sum(np.square(right - rows[:, :count] @ special))
    assert rests.sum() + np.sum(np.square(residual)) == pytest.approx(whole, rel=1e-9)


def joined(shooting, condensed):
    """Changes of all nodes that only make them join, from the last column."""
    parts = {}
    for group, part in zip(shooting.groups, condensed, strict=True):
        for w, column in zip(group, np.moveaxis(part.columns[..., -1], 1, 0), strict=True):
            parts[w] = column[: shooting.windows.length[w]].ravel()
    return np.concatenate([parts[w] for w in sorted(parts)])


@pytest.mark.parametrize("name", CASES)
def test_nodes_move_as_the_large_problem_says(name, monkeypatch):
    monkeypatch.setattr("bsp_gp.fitting.shooting.FARTHEST", np.inf)
    law, crew, lengths, options = CASES[name]
    shooting, nodes, mesh = setting(law, crew, lengths, **options)
    residual, jacobian, _, condensed = shooting.linearise(values_of(law), nodes, mesh)
    step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    rows, right, joins, lacks, at, count = explicit(shooting, nodes, mesh)
    expected, _ = solved(rows, right, joins, lacks)
    moved = shooting.move(nodes, condensed, step)
    for (w, row), place in at.items():
        chain = shooting.windows.chain[w]
        change = (moved - nodes)[..., row, chain].ravel()
        np.testing.assert_allclose(
            change, expected[place : place + shooting.flow.n_state], rtol=1e-6, atol=1e-8
        )


def condensed_windows(shooting):
    return range(len(shooting.windows.chain))


def test_no_window_leaves_its_surroundings():
    shooting, nodes, mesh = setting(SPRING, SINGLE, (9,))
    _, _, _, condensed = shooting.linearise(values_of(SPRING), nodes, mesh)
    moved = shooting.move(nodes, condensed, np.array([1e6, 0.0]))
    assert np.isfinite(moved).all()
    extent = np.ptp(shooting.chains.observed, axis=0).max()
    farthest = max(extent, max(shooting._reach(w, nodes) for w in condensed_windows(shooting)))
    assert np.abs((moved - nodes)[0]).max() <= 0.5 * farthest * (1 + 1e-9) < 5 * extent


def test_long_windows_in_blocks_are_those_step_by_step():
    shooting, nodes, mesh = setting(SPRING, SINGLE, (90, 77, 70))
    flow, windows = shooting.flow, shooting.windows
    flow.motion.set_constants(values_of(SPRING))
    ends, transitions = flow.run(nodes, mesh)
    gaps = (ends - nodes[..., flow.row + 1, flow.chain]).reshape(flow.n_state, -1).T
    for group in shooting.groups:
        length = windows.length[group]
        begun = shooting._begun(group, values_of(SPRING), nodes)
        blocks = shooting._columns(group, transitions, gaps, begun)
        steps = shooting._chained(windows.first[group], windows.chain[group], length, transitions,
                                  gaps, begun)  # fmt: skip
        for w, n in enumerate(length):
            scale = np.abs(steps[:n, w]).max()
            np.testing.assert_allclose(blocks[:n, w], steps[:n, w], atol=1e-11 * scale)


def test_windows_share_no_row_and_leave_none_out():
    for lengths in ([3], [10, 4], [100, 37, 5]):
        for rows in (None, 3, 4, 7, 50):
            windows = cut_windows(np.array(lengths), rows)
            covered = [
                (s, r) for s, a, b in zip(windows.chain, windows.first, windows.stop, strict=True)
                for r in range(a, b)
            ]  # fmt: skip
            assert covered == [(s, r) for s, n in enumerate(lengths) for r in range(n)]
            assert windows.length.min() >= 3
            assert rows is not None or len(windows.chain) == len(lengths)


def problem_of(shooting, nodes, mesh, law):
    coordinates = Coordinates(law, parameters_of(law), {})
    return TrackProblem([shooting], [mesh], coordinates), TrackPoint(values_of(law), (nodes,))


@pytest.mark.parametrize("name", ["two lengths", "windows", "gaps", "coupled"])
def test_gaps_are_closed_at_convergence(name):
    law, crew, lengths, options = CASES[name]
    shooting, nodes, mesh = setting(law, crew, lengths, **options)
    problem, start = problem_of(shooting, nodes, mesh, law)
    settled = problem.settled(start, 3)
    found = minimise(problem, settled, settings=Settings(absolute=1e-10, max_linearised=60))
    assert found.status == "converged"
    shooting.flow.motion.set_constants(found.values)
    gaps = shooting.gaps(found.point.nodes[0], mesh)
    windows = shooting.windows
    cuts = {(int(c), int(a)) for c, a in zip(windows.chain, windows.first, strict=True)}
    inside = [
        k for k, (r, c) in enumerate(zip(shooting.flow.row, shooting.flow.chain, strict=True))
        if (int(c), int(r) + 1) not in cuts
    ]  # fmt: skip
    assert np.abs(gaps[..., inside]).max() < 1e-5
    # The gradient vanishes: no first-order change of a constant improves the tracks.
    last = problem.linearise(found.point)
    cosine = last.jacobian.T @ last.residual / np.linalg.norm(last.jacobian, axis=0)
    assert np.abs(cosine).max() < 1e-3 * np.linalg.norm(last.residual)


def test_what_rounding_makes_is_no_gap():
    """Three units in the last place of the largest coordinate are none, a thousand are one."""
    shooting, nodes, mesh = setting(*CASES["two lengths"][:3])
    flow = shooting.flow
    flow.motion.set_constants(values_of(flow.motion.law))
    digit = np.finfo(float).eps * np.nanmax(np.abs(shooting.chains.observed), axis=(0, 2, 3))
    for row in range(int(shooting.chains.lengths.max()) - 1):
        ends, _ = flow.run(nodes, mesh, slopes=False)
        here = np.flatnonzero(flow.row == row)
        nodes[..., row + 1, flow.chain[here]] = ends[..., here]
    for units, is_gap in ((3, False), (1000, True)):
        off = nodes.copy()
        off[0] += units * digit * (np.arange(nodes.shape[-2]) % 2)[:, None]
        assert bool(shooting.gaps(off, mesh).any()) is is_gap


def test_columns_are_changes_of_predicted_places():
    """Of whole tracks that join: a change of the state at the first row, carried on by the law."""
    law = SPRING
    shooting, nodes, mesh = setting(law, SINGLE, (9, 6))
    problem, start = problem_of(shooting, nodes, mesh, law)
    point = problem.settled(start, 4)
    (nodes,) = point.nodes
    _, _, _, condensed = shooting.linearise(values_of(law), nodes, mesh)
    local, shared = shooting.columns(condensed, shooting.flow.n_state)

    def track(change, values):
        shooting.flow.motion.set_constants(values)
        own = nodes.copy()
        own[..., 0, :] += change.reshape(2, 1, 2, 1)
        for row in range(8):
            ends, _ = shooting.flow.run(own, mesh, slopes=False)
            here = np.flatnonzero(shooting.flow.row == row)
            own[..., row + 1, shooting.flow.chain[here]] = ends[..., here]
        return np.moveaxis(own[0], (-2, -1), (0, 1))

    seen = np.isfinite(shooting.chains.times)
    h, values = 1e-5, values_of(law)
    for q in range(4):
        slope = (track(h * np.eye(4)[q], values) - track(-h * np.eye(4)[q], values)) / (2 * h)
        np.testing.assert_allclose(local[q][seen], slope[seen], atol=1e-6)
    for q in range(2):
        more, less = (values + s * h * np.eye(2)[q] for s in (1, -1))
        slope = (track(np.zeros(4), more) - track(np.zeros(4), less)) / (2 * h)
        np.testing.assert_allclose(shared[q][seen], slope[seen], atol=1e-6)


MEMORY, AMPLITUDE = 0.4, 0.03


def with_memory(times, variance):
    amplitude = np.where(np.isfinite(variance), AMPLITUDE, 0.0)
    return ChainNoise(times, variance, amplitude, MEMORY)


def dense_information(shooting, nodes, mesh):
    """Fisher information of the constants with the full covariance of every coordinate."""
    _, _, _, condensed = shooting.linearise(values_of(SPRING), nodes, mesh)
    local, shared = shooting.columns(condensed, shooting.flow.n_state)
    chains, total = shooting.chains, 0.0
    for s, n in enumerate(chains.lengths):
        times = chains.times[:n, s]
        kernel = AMPLITUDE**2 * np.exp(-np.abs(times[:, None] - times) / MEMORY)
        information = np.diag(np.append(shooting.prior[:, s] ** 2, [0.0, 0.0]))
        for axis in range(2):
            seen = np.isfinite(chains.observed[:n, s, 0, axis])
            covariance = kernel + np.diag(shooting.noise.variance[:n, s, 0, axis])
            matrix = np.vstack([local[:, :n, s, 0, axis], shared[:, :n, s, 0, axis]])[:, seen]
            information += matrix @ np.linalg.solve(covariance[np.ix_(seen, seen)], matrix.T)
        own, cross = information[:4, :4], information[:4, 4:]
        total = total + information[4:, 4:] - cross.T @ np.linalg.solve(own, cross)
    return total


@pytest.mark.parametrize("lengths", [(20,), (20, 19), (20, 8)])
def test_noise_with_a_memory_weighs_rows_as_its_covariance_does(lengths):
    shooting, nodes, mesh = setting(SPRING, SINGLE, lengths, noise=with_memory, missing=(6,))
    _, jacobian, _, _ = shooting.linearise(values_of(SPRING), nodes, mesh)
    expected = dense_information(shooting, nodes, mesh)
    np.testing.assert_allclose(jacobian.T @ jacobian, expected, rtol=1e-7)


@pytest.mark.parametrize("n_columns", [3, TALL // 2, TALL + 10])
def test_triangles_of_tall_matrices_keep_their_products_however_wide(n_columns):
    matrices = np.random.default_rng(0).standard_normal((2, 9 * TALL + 5, n_columns))
    factors = _triangles(matrices)  # of more columns than rows in a block it found no end
    assert factors.shape == (2, n_columns, n_columns)
    products = np.swapaxes(matrices, 1, 2) @ matrices
    assert np.allclose(np.swapaxes(factors, 1, 2) @ factors, products)


def test_windows_end_where_gaps_are_and_nights_have_their_own():
    nights = np.concatenate([np.arange(9.0).repeat(3) + np.tile([0.0, 0.05, 0.1], 9), [9.0]])
    windows = cut_windows(np.array([28]), 3, nights[:, None])
    assert windows.stop.tolist() == [*range(3, 28, 3), 28]
    spans = cut_windows(np.array([28]), 60, nights[:, None])  # of three days at the most
    assert (nights[spans.stop - 1] - nights[spans.first]).max() == 3.0 and len(spans.chain) == 3
    assert len(cut_windows(np.array([28]), None, nights[:, None]).chain) == 1
    even = np.arange(28.0)[:, None]
    short = np.array([[0.0, 0.0], [np.nan, 1.0]])
    for rows in (3, None):  # one row, or two, have no gap
        assert cut_windows(np.array([1, 2]), rows, short).stop.tolist() == [1, 2]
    for rows in (3, 8):  # without gaps by their number, however times are
        same = cut_windows(np.array([28]), rows), cut_windows(np.array([28]), rows, even)
        assert same[0].stop.tolist() == same[1].stop.tolist()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3, 8])
def test_an_orbit_seen_in_nights_is_followed_although_its_pericentre_advances(seed):
    rng, gm = np.random.default_rng(seed), 3.9
    clear = np.r_[0:11, 18:24, 30:43].astype(float)
    nights = np.sort(rng.choice(clear, 22, replace=False))
    times = [night + rng.uniform(0.0, 0.25, rng.integers(2, 6)) for night in nights]
    times = np.sort(np.concatenate(times))

    def rate(t, state):
        r = np.linalg.norm(state[:2])
        return [*state[2:], *(-gm * state[:2] / r**3 * (1 + 0.0017 / r**2))]

    start = [0.76, 0.0, 0.0, 2.52]
    places = solve_ivp(rate, (0, 45), start, "DOP853", times, rtol=1e-10, atol=1e-12).y[:2].T
    places += 0.008 * rng.standard_normal(places.shape)
    data = dataset_of([scene_of(times, (body("moon"),), places[:, None])], noise=(0.008, 0.008))
    law = read_law(data, ["GM * m_i * (origin - p_i) / norm(p_i - origin)^3"])
    found = fit(Hypothesis.from_laws(data, law), data)
    assert found.status in ("converged", "refuted") and 2.0 < found.chi2_red < 20.0
    assert found.values[0] == pytest.approx(gm, rel=0.03)
