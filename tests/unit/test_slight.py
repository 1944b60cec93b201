"""What takes up a little of the little that is left, and leaves the rest, is not adopted."""

from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.loop.decide import Decision
from bsp_gp.loop.slight import is_slight, without_the_slight
from bsp_gp.loop.table import Row
from tests.loop_views import throws


def left(size):
    """A fit that leaves so much."""
    return SimpleNamespace(
        residual=np.full((50, 2), size), noise=SimpleNamespace(adding=None), shows_tracks=True
    )


def adopted(before, after, kind="force"):
    row = Row(3, "law", "c2 * v_i", "laws", "converged", 0.0, 0.0, 0.0, 5, kind)
    decision = Decision("effect adopted", "adopted", row, True)
    return SimpleNamespace(decision=decision, entering=left(before), fits={3: left(after)})


@pytest.mark.parametrize(
    ("before", "after", "kind", "is_it"),
    [
        (0.03, 0.02, "force", True),  # a third of two per cent of all
        (0.03, 0.02, "measurement", False),
        (0.03, 0.012, "force", False),  # most of it
        (0.3, 0.25, "force", False),  # of much
        (0.007, 0.005, "force", False),  # nothing but noise is left
    ],
)
def test_a_third_of_little_is_slight(before, after, kind, is_it):
    data = throws(np.random.default_rng(0), n_rows=80)
    assert is_slight(left(1.0), adopted(before, after, kind), data) == is_it


def test_a_declared_law_that_leaves_as_little_makes_nothing_slight():
    data = throws(np.random.default_rng(0), n_rows=80)
    done = adopted(0.03, 0.02)
    assert without_the_slight(left(0.05), done, data) is done
