"""Walls through which no start can be flown leave the other ways to a minimum."""

from types import SimpleNamespace

from bsp_gp.fitting import climb
from bsp_gp.fitting.fit import _Patience


def test_a_way_that_ends_nowhere_is_not_the_last(monkeypatch):
    monkeypatch.setattr(climb, "walls_of", lambda law: (True,))
    monkeypatch.setattr(climb, "_agree", lambda one, other: True)
    monkeypatch.setattr(climb, "_height", lambda end: 0.0)
    monkeypatch.setattr(climb, "replace", lambda end, **known: end)
    end = SimpleNamespace()
    fake = SimpleNamespace(
        _from_near=lambda: None, first_points=list, paper_steps=False, is_coarse=False, _grown=None,
        run=SimpleNamespace(
            parameters=(), law=SimpleNamespace(unseen=()), is_over=_Patience(0.0, None, -1.0)
        ),
        _climbed=lambda points: [end], _flown=lambda points: [], is_grouped=False, is_behind=False,
        _is_enough=lambda ends: min(ends) is None, _finish=lambda found: found,
    )  # fmt: skip
    assert climb.Climb.best(fake) is end
