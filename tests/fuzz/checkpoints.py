"""Checkpoints of searches, sound and altered, that a search takes up again."""

import functools
import json
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.pieces import damaged
from tests.fuzz.trial import ERROR

NAMES = ("cross_entropy", "genetic", "random")


@functools.cache
def _objective():
    from bsp_gp.search.objective import Objective
    from tests.unit.test_run_search import world

    return Objective(*world(), "pair")


def _search(name, steps, path):
    from bsp_gp.search.cross_entropy import CrossEntropy, RandomSearch
    from bsp_gp.search.genetic import Genetic
    from bsp_gp.search.run import Budget, run_search

    strategy = {
        "cross_entropy": CrossEntropy(population=20, elite=5, patience=2),
        "genetic": Genetic(population=10, offspring=20, patience=2),
        "random": RandomSearch(population=20),
    }[name]
    rng = np.random.default_rng(1)
    objective = _objective().fresh()
    return run_search(strategy, objective, Budget(n_steps=steps), rng=rng, checkpoint=path)


def resume(name):
    """Take up ``run.json`` of the working folder; the exit status of a command."""
    import sys

    from bsp_gp.errors import BspError

    before = Path("run.json").read_bytes()
    try:
        _search(name, 4, "run.json")
    except BspError as error:
        if Path("run.json").read_bytes() != before:
            raise AssertionError("a refused checkpoint was changed") from error
        print(f"{ERROR}{error}", file=sys.stderr)
        return 2
    return 0


@functools.cache
def _sound(name):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.json"
        _search(name, 2, path)
        return path.read_text("utf-8")


_ODD = (None, True, False, 0, -1, 1, 2**63, -(2**70), 1e308, float("nan"), "", "a", "1", [], {},
        [[]], [0], {"a": 1}, [[[0, []]]], 10**400)  # fmt: skip


@st.composite
def _altered(draw, text):
    """The same with one value anywhere in it replaced, left out, or doubled."""
    content = json.loads(text)
    node = content
    for _ in range(draw(st.integers(1, 7))):
        keys = sorted(node) if isinstance(node, dict) else range(len(node))
        if not keys:
            break
        key = draw(st.sampled_from(keys))
        if isinstance(node[key], dict | list) and node[key] and draw(st.integers(0, 4)):
            node = node[key]
            continue
        how = draw(st.sampled_from(("odd", "odd", "drop", "add")))
        if how == "odd":
            node[key] = draw(st.sampled_from(_ODD))
        elif how == "drop":
            del node[key]
        elif isinstance(node, list):
            node.insert(0, draw(st.sampled_from(_ODD)))
        else:
            node["added"] = draw(st.sampled_from(_ODD))
        break
    return json.dumps(content)


@st.composite
def cases(draw):
    """A checkpoint, altered where JSON lets it, or damaged, and the search that goes on from it."""
    name = draw(st.sampled_from(NAMES))
    text = _sound(name)
    if draw(st.integers(0, 3)):
        text = draw(_altered(text))
    content = draw(damaged(text.encode(), 4))
    return Case("checkpoints", ("@resume", name), {"run.json": content})
