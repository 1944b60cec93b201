"""Experiments at the ends of what can be chosen: a law that is only nearly right does not stand."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bsp_gp import discover
from bsp_gp.planning.apparatus import Recording, Refused
from bsp_gp.planning.ends import at_the_ends
from bsp_gp.planning.means import means_from

SIGMA = 0.01


def means(**more):
    return means_from({
        "bodies": {"probe": {"x": "-6..6", "y": "-6..6", "vx": "-1..1", "vy": "-1..1",
                             "size": "0.1..10"},
                   "source": {"dynamic": 0, "x": 0, "y": 0}},
        "units": {"size": "1"},
        "look": {"until": 4.0, "rows": 11, "noise": SIGMA, **more},
    })  # fmt: skip


def gap(experiment):
    return float(np.hypot(*experiment.bodies[0].position))


def test_ends_lie_beyond_all_that_was_tried():
    rng = np.random.default_rng(0)
    tried = [means().draw(rng) for _ in range(12)]
    chosen = at_the_ends(means(), tried, rng, count=6)
    assert gap(chosen[0]) < min(map(gap, tried)) and gap(chosen[1]) > max(map(gap, tried))
    assert len({id(e) for e in chosen}) == len(chosen) == 6
    (first,) = at_the_ends(means(), tried, rng, count=1)
    assert gap(first) < min(map(gap, tried))


def test_nothing_is_chosen_where_no_end_is_left():
    still = means_from(
        {"bodies": {"probe": {"x": 1, "y": 0}}, "look": {"until": 1.0, "noise": SIGMA}}
    )
    rng = np.random.default_rng(0)
    assert at_the_ends(still, [still.draw(rng)], rng) == []


@pytest.mark.slow
def test_what_a_force_does_close_by_is_found_though_chance_seldom_looks_there():
    """A pull as 1/r that is much stronger within one metre."""
    noise = np.random.default_rng(1)

    def run(experiment):
        probe = experiment.bodies[0]

        def rate(t, y):
            r = np.hypot(*y[:2])
            return [*y[2:], *(-y[:2] / r * (0.3 / r + 1.5 * np.exp(-r / 0.4)))]

        times = np.array(experiment.times)
        found = solve_ivp(rate, (0, times[-1]), [*probe.position, *probe.velocity], t_eval=times,
                          rtol=1e-9, atol=1e-12).y[:2].T  # fmt: skip
        seen = found + np.where(times[:, None] > 0, noise.normal(0, SIGMA, found.shape), 0)
        places = np.stack([seen, 0 * seen], axis=1)
        return Recording(times, places, np.full(places.shape, SIGMA))

    found = discover(run, means(at_once=8), rounds=8, rng=0, time_limit=60)
    close = min(gap(e) for e in found.experiments)
    assert close < 1.0
    assert not (found.stands and len(found.law.terms) == 1 and "exp" not in found.law.text())


def test_in_place_of_an_experiment_that_is_refused_another_is_made():
    asked = []

    def run(experiment):
        asked.append(experiment)
        if len(asked) % 3 == 1:
            raise Refused("./apparatus: too close")
        times = np.array(experiment.times)
        places = np.array([np.array(b.position) + np.outer(times, b.velocity)
                           for b in experiment.bodies]).swapaxes(0, 1)  # fmt: skip
        return Recording(times, places, np.full(places.shape, SIGMA))

    found = discover(run, means(at_once=4), rounds=1, rng=0, time_limit=5)
    assert len(found.experiments) == 4 < len(asked)

    def never(experiment):
        raise Refused("./apparatus: the laser is off")

    with pytest.raises(Refused, match="the laser is off"):
        discover(never, means(at_once=2), rounds=2, rng=0)
