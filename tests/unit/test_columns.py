"""What columns span, whatever the size of their numbers."""

import numpy as np
import pytest

from bsp_gp.search.columns import balanced, orthonormal


@pytest.mark.parametrize("size", [1e-305, 1e-200, 1.0, 1e200, 1e305])
def test_columns_whose_squares_overflow_or_vanish_span_what_they_span(size):
    columns = np.random.default_rng(0).standard_normal((20, 3))
    q = orthonormal(columns * [1.0, size, 1.0], 20)
    assert q.shape == (20, 3)
    assert np.abs(columns - q @ (q.T @ columns)).max() < 1e-14 * 20


def test_balanced_columns_have_the_same_digits_and_directions():
    columns = np.random.default_rng(1).standard_normal((20, 4)) * [3.0, 1e-7, 0.0, 1e9]
    even = balanced(columns)
    ratio = columns[0, [0, 1, 3]] / even[0, [0, 1, 3]]
    assert (np.frexp(ratio)[0] == 0.5).all() and not even[:, 2].any()
    sizes, even_sizes = np.linalg.norm(columns, axis=0), np.linalg.norm(even, axis=0)
    live = sizes > 0
    assert (columns[:, live] / sizes[live] == even[:, live] / even_sizes[live]).all()
    assert balanced(np.zeros((20, 0))).shape == (20, 0)
