"""Why adopted laws only describe the tracks: a constant at its bound, and much that is left."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.data.ephemeris import DAY_S
from bsp_gp.fitting.hypothesis import Parameter
from bsp_gp.fitting.parts.orbits import Orbit
from bsp_gp.loop import writing_up
from bsp_gp.loop.accounts import Ratio
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.writing_up import (
    _own_doubt,
    doubt_of_bounds,
    doubt_of_orbits,
    doubt_of_rest,
    has_odd_power,
    not_foreseen,
)
from tests.fitted_tracks import law_of

PUSH = "c1 * (0.5 * (1 - sign(dot(p_i - origin, e_x) - h_x1)) * e_y)"


def round_of(place, status, low=0.0, high=2.0, is_adopted=True, code="region"):
    """A round that adopts a push up to a place, which may lie between two others."""
    law = law_of(PUSH, c1=1.0, h_x1=place)
    found = SimpleNamespace(law=law, status=status)
    numbers = (Parameter("c1"), Parameter("h_x1", low=low, high=high))
    return SimpleNamespace(
        number=1, fits={2: found}, entering=SimpleNamespace(law=law_of()),
        hypotheses={2: SimpleNamespace(parameters=numbers)},
        decision=SimpleNamespace(
            is_adopted=is_adopted, best=SimpleNamespace(id=2, kind="force", code=code)
        ),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (round_of(2.0, "at_bound"), "at_bound"), (round_of(0.0, "at_bound"), "at_bound"),
        (round_of(1.0, "at_bound"), ""),  # it is another number that is at its bound
        (round_of(1.0, "at_bound", code="orbit"), "at_bound"),  # any number of an orbit
        (round_of(1.0, "converged"), ""), (round_of(2.0, "at_bound", is_adopted=False), ""),
    ],
)  # fmt: skip
def test_a_form_with_a_constant_at_its_bound_is_none_for_sure(made, said):
    """A dead band that ended where the tracks did was a fact, beside a spring and a drag."""
    assert doubt_of_bounds([made], ()) == said
    assert doubt_of_bounds([made], {1}) == ""


def left(size):
    return SimpleNamespace(
        shows_tracks=True, residual=np.full((9, 2), size), noise=SimpleNamespace(adding=None)
    )


@pytest.mark.parametrize(
    ("after", "snr", "verdict", "said"),
    [
        (0.4, 500.0, "cannot tell", "much_left"), (0.4, 500.0, "seen, not adopted", "much_left"),
        (0.2, 500.0, "cannot tell", ""), (0.4, 20.0, "cannot tell", ""),
        (0.4, 500.0, "nothing missing", ""), (0.4, 90.0, "seen, not adopted", "more_left"),
        (0.2, 90.0, "cannot tell", ""), (0.07, 90.0, "seen, not adopted", ""),
    ],
)  # fmt: skip
def test_beside_what_is_left_of_most_of_the_motion_no_law_is_sure(
    after, snr, verdict, said, monkeypatch
):  # fmt: skip
    monkeypatch.setattr(writing_up, "noise_size", lambda found, dataset: 0.05)
    decision = SimpleNamespace(is_adopted=False, verdict=verdict)
    rounds = [SimpleNamespace(number=1, decision=decision)]
    bound = SimpleNamespace(snr=snr)
    assert doubt_of_rest(left(1.0), left(after), rounds, bound, None) == said
    assert doubt_of_rest(left(1.0), left(after), rounds, None, None) == ""


def with_orbits(*days):
    """A round that adds orbits to what is known of a star that was looked at for 7000 days."""
    orbits = tuple(
        Orbit(tuple(Parameter(f"{stem}{k}") for stem in ("P", "K", "longitude")), 0.0)
        for k in range(len(days))
    )
    law = SimpleNamespace(frame=orbits, constants={f"P{k}": p * DAY_S for k, p in enumerate(days)})
    seen = SimpleNamespace(times=np.array([[0.0], [7000.0]]) * DAY_S)
    return SimpleNamespace(
        number=1, fits={2: SimpleNamespace(law=law, channels=seen)},
        entering=SimpleNamespace(law=SimpleNamespace(frame=())),
        decision=SimpleNamespace(is_adopted=True, best=SimpleNamespace(id=2)),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("days", "said"),
    [((1079.0,), ""), ((6200.0,), ""), ((8000.0,), "few_periods"), ((1079.0, 2391.0), ""),
     ((1079.0, 6200.0), "few_periods")],
)  # fmt: skip
def test_of_several_orbits_each_comes_back(days, said, monkeypatch):
    """Two outer planets of 47 UMa were one of 6200 d, a fact whose interval held neither."""
    monkeypatch.setattr(writing_up, "has_alias", lambda found, orbit, separation: False)
    assert doubt_of_orbits([with_orbits(*days)], (), Criteria()) == said


@pytest.mark.parametrize(
    ("days", "said"),
    [(359.0, "season"), (182.0, "season"), (1.0, "season"), (4.23, ""), (405.0, "")],
)
def test_a_companion_that_comes_back_with_the_seasons_is_none_for_sure(days, said, monkeypatch):
    """Beside the planet of a star that was seen for ten years another of 359 d was a fact."""
    monkeypatch.setattr(writing_up, "has_alias", lambda found, orbit, separation: False)
    made = with_orbits(days)
    assert doubt_of_orbits([made], (), Criteria()) == said
    assert doubt_of_orbits([made], {1}, Criteria()) == ""


@pytest.mark.parametrize(
    ("power", "error", "is_odd"), [(0.962, 0.004, True), (0.98, 0.02, False), (1.5, 1e-3, False)]
)
def test_a_power_that_is_surely_no_multiple_of_a_half_is_odd(power, error, is_odd):
    """A torsion balance whose zero moved by a millimetre was a force to the 0.962 and a push."""
    law = law_of("c1 * norm(v_i)^n1 * normalize(v_i)", c1=1.0, n1=power)
    found = SimpleNamespace(
        law=law, parameters=(("c1", ""), ("n1", "")), values=(1.0, power), errors=(0.1, error)
    )
    assert has_odd_power(found) is is_odd


@pytest.mark.parametrize(("is_sky", "said"), [(True, "passage"), (False, "")])
def test_in_the_sky_a_kick_stands_for_a_passage(is_sky, said, monkeypatch):
    """Of an asteroid a kick of 100 m/s was a fact, three months from when the Earth was passed."""
    best = SimpleNamespace(id=1, code="contact", n_pushes=0)
    done = SimpleNamespace(
        decision=SimpleNamespace(best=best), proposals={1: SimpleNamespace()}, fits={}
    )
    monkeypatch.setattr(writing_up, "is_of_the_sky", lambda dataset: is_sky)
    assert _own_doubt(done, SimpleNamespace(exponents=(), law=""), None) == said


def power(term, value, error, stated, is_told=True):
    low, high = value - 1.645 * error, value + 1.645 * error
    return {"term": term, "value": value, "low": low, "high": high, "stated": stated,
            "is_told": is_told}  # fmt: skip


@pytest.mark.parametrize(
    ("exponents", "said"),
    [
        ([power("a", 1.23, 0.02, 1.0)], "another_power"), ([power("a", 1.23, 0.1, 1.0)], ""),
        ([power("a", -2.000003, 1e-9, -2.0)], ""),  # no data are as exact as that
        ([power(term, 1.2, 0.3, 1.0, is_told=False) for term in "ab"], ""),
        ([power(term, 1.2, 0.3, 1.0, is_told=False) for term in "abc"], "open_powers"),
    ],
)  # fmt: skip
def test_powers_that_are_others_or_open_in_many_forces_describe(exponents, said):
    """A delayed force was two drags and a push of other powers; one odd force was three."""
    best = SimpleNamespace(id=1, code="law", n_pushes=0)
    done = SimpleNamespace(
        decision=SimpleNamespace(best=best), proposals={1: SimpleNamespace()}, fits={}
    )
    assert _own_doubt(done, SimpleNamespace(exponents=exponents, law=""), None) == said


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ({"c1": (-1.0, 2.0)}, "undetermined"), ({"c1": (0.5, 2.0)}, ""),
        # What is inside is no strength, and neither is what the bodies had before.
        ({"c1": (-1.0, 2.0), "h_x1": (0.5, 2.0)}, "undetermined"), ({"m": (-1.0, 1.0)}, ""),
    ],
)  # fmt: skip
def test_strengths_that_may_all_be_nothing_describe(ends, said):
    """Three pushes whose intervals all held zero were the effect of a pendulum."""
    best = SimpleNamespace(id=1, code="law", n_pushes=0)
    done = SimpleNamespace(
        decision=SimpleNamespace(best=best), proposals={1: SimpleNamespace()},
        fits={1: SimpleNamespace(law=law_of(PUSH, c1=1.0, h_x1=1.0))},
    )  # fmt: skip
    constants = [SimpleNamespace(name=n, low=low, high=high) for n, (low, high) in ends.items()]
    effect = SimpleNamespace(exponents=(), law="c1", constants=constants)
    assert _own_doubt(done, effect, None) == said


@dataclass(frozen=True)
class Told:
    """A record as far as it is judged by what was held out."""

    effect: object
    verdict: str = "effect adopted"
    reason: str = "adopted"


@pytest.mark.parametrize(
    ("ratio", "is_noise", "is_fact", "said"),
    [
        (Ratio(0.5, 0.2, 3.0), False, True, "adopted"),  # they shrink
        (Ratio(1.2, 0.1, 3.5), False, True, "poorly_foreseen"),  # nothing says that they do
        (Ratio(1.01, 0.97, 1.05), False, True, "adopted"),  # it hardly shows there
        (Ratio(1.4, 0.8, 1.6), False, True, "poorly_foreseen"),
        (Ratio(1.4, 0.8, 1.6), True, True, "adopted"),  # so large is the noise of one track
        (Ratio(1.4, 0.8, 1.6), True, False, "poorly_foreseen"),
        (Ratio(), False, True, "adopted"),  # nothing was held out
    ],
)
def test_what_held_out_rows_do_not_bear_out_is_no_fact(ratio, is_noise, is_fact, said):
    """The turning points of a pendulum had an effect with a ratio of 1.2 [0.1, 3.5]."""
    force, mended = (Told(SimpleNamespace(kind=k, is_fact=is_fact)) for k in ("field", "noise"))
    left = SimpleNamespace(rollout_rmse=1.0)
    accounts = SimpleNamespace(errors=lambda k: left, noisiest=2.0 if is_noise else 0.5)
    told, other = not_foreseen([force, mended], ratio, accounts)
    assert told.reason == said and other.reason == "adopted"
