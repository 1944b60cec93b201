"""What is trained on and what is held out."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bsp_gp.data.scene import Scene
from bsp_gp.errors import DataError, in_python

MIN_SCENES = 4
TEST_SHARE = 0.25
HELD_OUT_TIME = 0.3
MAX_GAP = 0.1
MEMORIES = 3.0
"""Correlation times of the noise that a gap is long at least."""
MIN_ROWS, TURNS = 3, 4
"""Rows of each side at least, and nights of a star of which one is held out."""
MAX_NAMES = 5
"""Held-out scenes that are named."""


class Split(NamedTuple):
    """Scenes to train on, scenes held out, and a line for the report.

    ``whole`` are the scenes of which rows are held out, () where scenes are held out as they are.
    """

    train: tuple[Scene, ...]
    test: tuple[Scene, ...]
    note: str
    whole: tuple[Scene, ...] = ()

    @property
    def learned(self):
        """Scenes from which the form of a law is learned.

        Of a few recordings all rows: the end of a track tells most of a weak force. What is said
        of held-out rows is then said by numbers that were fitted to `train` alone.
        """
        return self.whole or self.train

    @property
    def told(self):
        """The line for the report, where laws are learned from `learned`."""
        if not self.whole:
            return self.note
        return (
            f"{self.note}; laws are found in all rows, and for errors on what is held out their "
            "numbers are fitted to the rest"
        )

    @property
    def swapped(self):
        """What was held out to train on, and the other way round."""
        note = "train and test swapped: nothing was missing from what was to train on"
        return Split(self.test, self.train, f"{self.note}; {note}")


def choose_split(dataset, rng):
    """Divide a data set into scenes to train on and scenes held out.

    A declared split wins. Without one, from four scenes on a random quarter is held out; with
    fewer, one row of four of a star's velocities, and of anything else the last 30 % of the time of
    every scene, after a gap of one correlation time of the motion or three of the noise (where it
    is declared to have a memory), at most a tenth. The generator is used for the random quarter
    alone.
    """
    if dataset.train or dataset.test:
        return _declared(dataset)
    if len(dataset.scenes) >= MIN_SCENES:
        return _random(dataset, rng)
    is_star = dataset.is_of_sight and not dataset.noise_memory
    return _by_turns(dataset) if is_star else _in_time(dataset)


def _declared(dataset):
    chosen = set(dataset.train) | set(dataset.test)
    rest = tuple(scene.name for scene in dataset.scenes if scene.name not in chosen)
    train, test = dataset.train or rest, dataset.test or rest
    if not train:
        raise DataError(
            "every scene is declared as test, so nothing is left to train on",
            remedy="name fewer scenes in test",
        )
    if not test:
        raise DataError(
            "every scene is declared as train, so nothing is held out",
            remedy="name fewer scenes in train; to fit as much as there is, hold out the one that "
            "says least, with --test",
        )
    note = f"declared split: {len(train)} scenes to train on, {len(test)} held out"
    return Split(dataset.select(train), dataset.select(test), note)


def _random(dataset, rng):
    n_scenes = len(dataset.scenes)
    n_test = max(1, round(TEST_SHARE * n_scenes))
    held_out = set(rng.permutation(n_scenes)[:n_test].tolist())
    test = tuple(scene for k, scene in enumerate(dataset.scenes) if k in held_out)
    train = tuple(scene for k, scene in enumerate(dataset.scenes) if k not in held_out)
    names = ", ".join(scene.name for scene in test[:MAX_NAMES])
    names += ", …" if n_test > MAX_NAMES else ""
    note = in_python(
        f"no split declared: {n_test} of {n_scenes} scenes held out at random ({names}) and not "
        "fitted, --test chooses others"
    )
    return Split(train, test, note)


def _by_turns(dataset):
    """Every so many of the nights on which a star was looked at.

    Of a companion that takes as long as the star was watched the last of them show another part of
    the orbit than all before, which no law could foresee.
    """
    train, test = [], []
    for scene in dataset.scenes:
        rows = np.arange(len(scene.times))
        is_held = (rows % TURNS == TURNS // 2) & (rows < len(rows) - 1)
        if is_held.sum() < MIN_ROWS or (~is_held).sum() < MIN_ROWS:
            train.append(scene)
            continue
        train.append(scene.of_rows(~is_held, has_first=True))
        test.append(replace(scene.of_rows(is_held), name=f"{scene.name} (held out)"))
    if not test:
        return Split(tuple(train), (), "no split declared, and the scenes are too short for one")
    note = (
        f"no split declared and fewer than {MIN_SCENES} scenes: one row of {TURNS} is held out, "
        "from the first to the last"
    )
    return Split(tuple(train), tuple(test), note, dataset.scenes)


def _in_time(dataset):
    train, test, gaps = [], [], []
    for scene in dataset.scenes:
        gap = _correlation_rows(scene, dataset.noise_memory or 0.0)
        begin = scene.times[0] + (1 - HELD_OUT_TIME) * (scene.times[-1] - scene.times[0])
        start = int(np.searchsorted(scene.times, begin))
        start = min(start, len(scene.times) - MIN_ROWS)
        stop = start - gap
        if stop < MIN_ROWS or start < MIN_ROWS:
            train.append(scene)
            continue
        train.append(scene.rows(0, stop))
        test.append(replace(scene.rows(start, None), name=f"{scene.name} (held out)"))
        gaps.append(gap)
    if not test:
        return Split(tuple(train), (), "no split declared, and the scenes are too short for one")
    note = (
        f"no split declared and fewer than {MIN_SCENES} scenes: the last {HELD_OUT_TIME:.0%} of "
        f"the time held out after a gap of {max(gaps)} row(s)"
    )
    return Split(tuple(train), tuple(test), note, dataset.scenes)


def _correlation_rows(scene, memory):
    """Correlation time of the velocity fluctuations in rows, at least 1, at most a tenth.

    And no less than three correlation times of the noise, `memory` in seconds.
    """
    most = max(1, int(MAX_GAP * len(scene.times)))
    longest = max(1, int(np.ceil(MEMORIES * memory / np.median(np.diff(scene.times)))))
    for entity in scene.dynamic:
        for axis in range(scene.n_dims):
            x = scene.positions[:, entity, axis]
            known = np.isfinite(x)
            if np.count_nonzero(known) < 2 * MIN_ROWS or np.ptp(x[known]) == 0:
                continue
            v = np.diff(x[known]) / np.diff(scene.times[known])
            longest = max(longest, _decay_lag(v, most))
    return min(longest, most)


def _decay_lag(v, most):
    """First lag at which the autocorrelation of `v`, less its linear trend, is below 1/e."""
    rows = np.linspace(-1.0, 1.0, len(v))
    fluctuation = v - v.mean() - rows * (v @ rows) / (rows @ rows)
    power = fluctuation @ fluctuation
    if power <= 1e-20 * (v @ v):
        return 1
    for lag in range(1, min(most, len(v) - 1) + 1):
        if fluctuation[lag:] @ fluctuation[:-lag] < power / np.e:
            return lag
    return most
