from itertools import combinations

import numpy as np
import pytest

from bsp_gp.search.subsets import best_subsets


def problem(seed, n=40, m=9):
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((n, m)) * 10.0 ** rng.uniform(-3, 3, m)
    # A proxy: nearly the sum of two others, so that greedy addition takes it first.
    unit = columns / np.linalg.norm(columns, axis=0)
    columns[:, 0] = unit[:, 1] + unit[:, 2] + 0.02 * rng.standard_normal(n)
    target = unit[:, 1] + 0.9 * unit[:, 2] + 0.01 * rng.standard_normal(n)
    return columns, target


def loss(columns, target, chosen):
    columns = columns / np.linalg.norm(columns, axis=0)
    fitted = np.linalg.lstsq(columns[:, chosen], target, rcond=None)[0]
    return 0.5 * float(np.square(target - columns[:, chosen] @ fitted).sum())


@pytest.mark.parametrize("seed", range(5))
def test_equals_brute_force(seed):
    columns, target = problem(seed)
    found = best_subsets(columns, target, 3)
    assert set(found) == {1, 2, 3}
    for size, sets in found.items():
        true = sorted((loss(columns, target, list(c)), c) for c in combinations(range(9), size))
        assert [c for _, c in sets] == [c for _, c in true[:40]]
        np.testing.assert_allclose([v for v, _ in sets], [v for v, _ in true[:40]], rtol=1e-9)


def test_a_proxy_taken_first_is_parted_with():
    found = best_subsets(*problem(0), 2)
    assert found[1][0][1] == (0,)
    assert found[2][0][1] == (1, 2)


def test_duplicate_columns_are_not_put_in_one_set():
    columns, target = problem(1, m=4)
    doubled = np.column_stack([columns, 3 * columns[:, 1]])  # column 4 is column 1
    found = best_subsets(doubled, target, 4)
    assert all(not {1, 4} <= set(chosen) for sets in found.values() for _, chosen in sets)
    # Both spellings of the best pair are there, with one loss.
    (a, first), (b, second) = found[2][:2]
    assert {first, second} == {(1, 2), (2, 4)}
    assert a == pytest.approx(b, rel=1e-12)


def test_columns_without_values_are_left_out():
    columns, target = problem(2, m=4)
    columns = np.column_stack([np.zeros(40), columns, np.full(40, np.nan), np.full(40, np.inf)])
    found = best_subsets(columns, target, 2)
    assert {k for sets in found.values() for _, chosen in sets for k in chosen} == {1, 2, 3, 4}


def test_fewer_columns_than_wanted():
    columns, target = problem(3, m=3)
    found = best_subsets(columns[:, 1:], target, 5)
    assert set(found) == {1, 2}
    assert best_subsets(np.zeros((40, 2)), target, 2) == {}


def test_nuisance_terms_projected_out_of_both_give_joint_losses():
    columns, target = problem(4)
    rng = np.random.default_rng(0)
    nuisance = np.linalg.qr(rng.standard_normal((40, 3)))[0]
    target = target + nuisance @ [3.0, -2.0, 5.0]

    def without(values):
        return values - nuisance @ (nuisance.T @ values)

    found = best_subsets(without(columns), without(target), 2)
    for value, chosen in found[2][:5]:
        both = np.column_stack([columns[:, chosen], nuisance])
        assert value == pytest.approx(loss(both, target, list(range(5))), rel=1e-6)
    assert found[2][0][1] == (1, 2)


def test_a_narrow_beam_and_few_kept():
    columns, target = problem(5)
    assert [len(sets) for sets in best_subsets(columns, target, 3, keep=2).values()] == [2, 2, 2]
    # One set of each size is kept: not worse than greedy addition, which stays with the proxy.
    narrow = best_subsets(columns, target, 2, beam=1)
    greedy = min(loss(columns, target, [0, k]) for k in range(1, 9))
    assert narrow[2][0][0] <= greedy * (1 + 1e-9)
