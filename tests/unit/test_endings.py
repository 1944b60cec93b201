"""Ends of rounds."""

from dataclasses import replace

import numpy as np

from bsp_gp.loop.close import close_loop
from bsp_gp.report.sentences import verdict_parts
from tests.worlds import WEIGHT, flights, wind


def test_what_shows_in_held_out_tracks_alone_is_not_called_nothing():
    """A close pass, a gust: what acts in the held-out scenes only cannot be learned."""
    calm = flights(2, lambda t, p, v, m, q: np.zeros_like(p))
    windy = flights(2, wind)
    held = set(calm.test)
    pairs = zip(calm.scenes, windy.scenes, strict=True)
    scenes = tuple(w if c.name in held else c for c, w in pairs)
    assert held and held != {c.name for c in calm.scenes}
    report = close_loop(replace(calm, scenes=scenes), [WEIGHT], rng=np.random.default_rng(0))
    (done,) = report.rounds
    assert not done.missing.is_missing and done.effect is None
    assert report.verdict == "cannot tell" and "held-out ones leave" in done.reason
    assert done.missing_held_out.is_missing and done.is_something_missing
    sentence, detail = verdict_parts(report)
    assert "cannot tell whether anything is missing" in sentence and "held-out" in detail
    same = close_loop(calm, [WEIGHT], rng=np.random.default_rng(0))
    assert same.verdict == "nothing missing"
