"""Snippets of tracks under a law that other rows tell, each from a state of its own."""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import EvaluationError, FitError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import states_alone
from bsp_gp.fitting.hypothesis import Hypothesis, TrackNoise
from bsp_gp.fitting.noise_model import NoiseModel

EFFORT = 2000
"""Steps after which a law that is fitted to the other rows is taken for none that could tell."""


def snippets_under(law, told, snippets):
    """The fit of the states alone of snippets, under a law and the noise of tracks.

    None where the law cannot be fitted, or the snippets not under it. Constants of the law, as it
    is declared, are fitted to the rows `told`.
    """
    noise = NoiseModel.of(told)
    hypothesis = Hypothesis.from_laws(told, law)
    law, steps = hypothesis.law, bool(hypothesis.paper_steps)
    try:
        if hypothesis.parameters:
            known = TrackNoise(replace(noise, sources=("declared",) * len(noise.levels)))
            found = fit(hypothesis + known, told, effort=EFFORT)
            if found.is_failed:
                return None
            law, steps = found.law, found.paper_steps
        found = states_alone(law, steps, noise, replace(told, scenes=tuple(snippets)))
    except (EvaluationError, FitError, np.linalg.LinAlgError, FloatingPointError):
        return None
    return None if found.is_failed else found
