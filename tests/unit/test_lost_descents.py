"""A descent that ends nowhere: no force is asked for what it leaves."""

from types import SimpleNamespace

import pytest

from bsp_gp.fitting.climb import Climb
from bsp_gp.fitting.fit import _Run


def is_lost(status, n_agree, n_starts, is_allowed=False):
    climb = SimpleNamespace(_is_allowed=lambda minimum: is_allowed)
    minimum = SimpleNamespace(status=status, n_agree=n_agree, n_starts=n_starts)
    return Climb.is_lost(climb, minimum)


def test_a_descent_is_lost_that_ended_nowhere_and_alone():
    assert is_lost("unconverged", 1, 10)
    assert not is_lost("converged", 1, 10)
    assert not is_lost("unconverged", 2, 10)  # stalled, but twice at one place
    assert not is_lost("unconverged", 1, 1)  # there was no other start
    assert not is_lost("unconverged", 1, 10, is_allowed=True)


@pytest.mark.parametrize("lost", [True, False])
def test_what_a_lost_descent_leaves_is_not_made_noise(lost):
    asked = []
    run = SimpleNamespace(
        hypothesis=SimpleNamespace(noise="begun with", has_given_noise=False),
        has_misfit=lambda minimum: asked.append(minimum), estimated=lambda *args: "estimated",
    )  # fmt: skip
    climb = SimpleNamespace(is_lost=lambda minimum: lost)
    found = _Run.noise_beside(run, climb, "minimum", False)
    assert found == ("begun with" if lost else "estimated")
    assert asked == ([] if lost else ["minimum"])
