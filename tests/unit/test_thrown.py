"""Bodies that are thrown with known velocities."""

import numpy as np

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis, read_law
from bsp_gp.planning.means import Body, Experiment
from tests.fitted_tracks import dataset_of

SIGMA, TIMES = 0.02, np.linspace(0.0, 20.0, 101)


def bound(count=4):
    """Small fast circles, where free motion from the same states goes far away."""
    rng, scenes = np.random.default_rng(3), []
    for k in range(count):
        radius, rate = rng.uniform(0.4, 0.6), 6.0
        angle = rate * TIMES
        places = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        seen = places + SIGMA * rng.standard_normal(places.shape)
        seen[0] = places[0]
        probe = Body("probe", (radius, 0.0), (0.0, radius * rate), {"mass": 1.0})
        experiment = Experiment((probe,), tuple(TIMES))
        scenes.append(
            experiment.scene(f"s{k}", seen[:, None], sigma=np.full((len(TIMES), 1, 2), SIGMA))
        )
    return dataset_of(scenes, noise=(SIGMA, SIGMA))


def test_free_motion_is_a_fit_however_far_it_leads():
    dataset = bound()
    found = fit(Hypothesis.from_laws(dataset, []), dataset)
    assert found.status == "refuted"
    law = read_law(dataset, ["-k * p_i"])
    spring = fit(Hypothesis.from_laws(dataset, law), dataset, starts={"k": 30.0})
    assert spring.status == "converged" and abs(spring.values[0] - 36.0) < 0.1
