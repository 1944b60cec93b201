"""The classes of tries, how they are made, and how many of ten thousand are of each."""

import random

import hypothesis
from hypothesis import HealthCheck, settings

from tests.fuzz import closing, films, grammars, laws, options, tables, trackers, worlds

KINDS = {
    "folders": (tables.folders, 2000),
    "tables": (tables.lone, 2200),
    "laws": (laws.cases, 1900),
    "grammars": (grammars.cases, 1400),
    "trackers": (trackers.cases, 700),
    "films": (films.cases, 400),
    "options": (options.cases, 800),
    "worlds": (worlds.cases, 500),
    "closing": (closing.cases, 100),
}
BATCH = 20
BUFFER = 8192


def batch(kind, seed, number):
    """The cases of one batch, the same whenever they are asked for."""
    return [made(kind, f"{kind}/{seed}/{number}/{k}") for k in range(BATCH)]


def made(kind, name):
    """One case, drawn from bytes that follow from its name alone."""
    found = []

    @settings(database=None, deadline=None, suppress_health_check=list(HealthCheck))
    @hypothesis.given(KINDS[kind][0]())
    def collect(case):
        found.append(case)

    rng = random.Random(name)
    while not found:  # bytes that run out, or that a filter refuses
        collect.hypothesis.fuzz_one_input(rng.randbytes(BUFFER))
    return found[0]


def schedule(n_tries):
    """Batches (kind, number) of so many tries, classes mixed; the same for every call."""
    total = sum(share for _, share in KINDS.values())
    places = []
    for kind, (_, share) in KINDS.items():
        n_batches = max(1, round(n_tries * share / total / BATCH))
        places += [((k + 0.5) / n_batches, kind, k) for k in range(n_batches)]
    return [(kind, number) for _, kind, number in sorted(places)]
