"""Frequencies of a law that rows are too far apart to show."""

import math
from collections.abc import Mapping

import numpy as np

from bsp_gp.data.scene import CHECK
from bsp_gp.language.formula import Call, evaluate, walk
from bsp_gp.language.render import to_text
from bsp_gp.units import SECOND

WAVES = ("sin", "cos")
SAME = 0.9
"""Resultant length of the phases by which two frequencies differ, from which on rows are alike."""


def aliasing_notes(law, scenes, units):
    """Notes of the waves in time of a law that turn faster than half of the row rate.

    Rows at a step d show the angular frequencies w and w - 2 pi k / d alike. Rows at uneven times
    do not, and nothing is said of them.
    """
    second = units.text(SECOND)
    grids = [_step(scene.times) for scene in scenes]
    for wave, label, speed in dict.fromkeys(_speeds(law, scenes[0].times)):
        pairs = zip(scenes, grids, strict=True)
        if not all(_is_alike(scene.times, step, speed) for scene, step in pairs):
            continue
        finest = min(grids)
        slow = abs(speed - _turns(speed, finest) * math.tau / finest)
        alias = (
            f"turns once in {math.tau / slow:.4g} {second}"
            if slow * finest > 1e-6
            else "does not turn at all"
        )
        yield (
            f"{CHECK}{wave}{label} turns once in {math.tau / speed:.4g} {second}, which is less "
            f"than two rows take ({2 * finest:.4g} {second}): these rows cannot tell it from a "
            f"wave that {alias}"
        )


def _speeds(law, times):
    """Text, entity and angular frequency of every sin and cos of a linear function of time."""
    ends = np.array([times[0], (times[0] + times[-1]) / 2, times[-1]])
    for term in law.terms:
        for node in walk(term.formula):
            if not (isinstance(node, Call) and node.operator in WAVES and node.inputs == {"t"}):
                continue
            for label, constants in _constants(law, node):
                phase = np.broadcast_to(evaluate(node.args[0], {"t": ends}, constants), (3,))
                speed = abs(phase[2] - phase[0]) / (ends[2] - ends[0])
                bend = abs(phase[0] - 2 * phase[1] + phase[2])
                if math.isfinite(speed) and bend <= 1e-6 * abs(phase[2] - phase[0]):
                    yield to_text(node), label, float(speed)


def _constants(law, node):
    """Values of the constants of a formula: once, or for every entity that has its own."""
    values = {name: law.constants[name] for name in node.constants}
    own = {name: value for name, value in values.items() if isinstance(value, Mapping)}
    for entity in next(iter(own.values()), [""]):
        label = f" of {entity}" if entity else ""
        yield label, values | {name: value.get(entity, math.nan) for name, value in own.items()}


def _step(times):
    """The step of a grid on which the times lie, gaps or not; of uneven times a typical one."""
    gaps = np.diff(times)
    return float(gaps.sum() / np.maximum(np.round(gaps / np.median(gaps)), 1).sum())


def _turns(speed, step):
    return round(speed * step / math.tau)


def _is_alike(times, step, speed):
    """Whether a frequency is beyond half of the row rate, and looks like one that is not."""
    turns = _turns(speed, step)
    if speed * step <= math.pi * (1 + 1e-6) or not turns:
        return False
    phases = turns * math.tau / step * (times - times[0])
    return bool(abs(np.mean(np.exp(1j * phases))) > SAME)
