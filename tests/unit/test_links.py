"""Pieces of tracks that are joined tell as much of slow forces as whole tracks do."""

import numpy as np
import pytest

from bsp_gp.fitting import pieces
from bsp_gp.fitting.links import Links, link, orthonormal
from tests.unit.test_response import GRAVITY, score, thrown, view_of


def shown(monkeypatch, dataset, text, most):
    monkeypatch.setattr(pieces, "MOST_COORDINATES", most)
    view = view_of(dataset, GRAVITY)
    return len(view.response.regression.batches), score(view, text)


@pytest.mark.parametrize("text", ["m_i * e_x", "v_i", "norm(v_i) * v_i"])
def test_a_slow_force_shows_in_pieces_as_in_whole_tracks(monkeypatch, text):
    dataset = thrown(0.01, n_scenes=2, n_rows=120)
    count, whole = shown(monkeypatch, dataset, text, 10**6)
    assert count == 1
    count, joined = shown(monkeypatch, dataset, text, 48)  # five pieces of 24 rows
    assert count == 2
    assert joined.statistic == pytest.approx(whole.statistic, rel=0.02)
    assert joined.amplitudes == pytest.approx(whole.amplitudes, rel=0.02)


def test_moments_of_links_are_noise_of_size_one(monkeypatch):
    monkeypatch.setattr(pieces, "MOST_COORDINATES", 48)
    squares, counts = 0.0, 0
    for seed in range(12):
        view = view_of(thrown(n_scenes=2, n_rows=120, seed=seed), GRAVITY)
        batch = view.response.regression.batches[1]
        squares += np.square(batch.moments[batch.kept[..., 0, 0]]).sum()
        counts += int(batch.kept.sum())
    assert abs(squares / counts - 1) < 4 * np.sqrt(2 / counts)


def test_nothing_is_joined_where_pieces_do_not_follow_one_another():
    class Apart:
        leads = np.array([False, False])

        def runs(self, most):
            return [[0], [1]]

    arrays = map(np.zeros, ((5, 2, 4, 15), (2, 6, 15), (2, 1, 2, 5, 2)))
    assert link(Apart(), *arrays, 4) is None


def test_columns_without_effect_have_no_direction():
    matrix = np.zeros((1, 6, 2))
    matrix[0, :, 0] = 3.0
    q = orthonormal(matrix)[0]
    assert np.square(q).sum() == pytest.approx(1.0)


def test_where_much_is_left_a_part_of_it_is_not_believed():
    much = np.array([[300.0, 400.0]])
    links = Links(np.array([[0, 1]]), np.ones((1, 2, 2, 3)), np.ones((1, 2, 1)), much,
                  np.ones((1, 2)))  # fmt: skip
    size = np.hypot(1.0, 0.02 * np.sqrt(np.mean(np.square(much))))
    assert links.believed(0.02).left == pytest.approx(much / size)
    assert links.believed(0.02).by_force == pytest.approx(1 / size)
    assert links.believed(0.0).left == pytest.approx(much)
