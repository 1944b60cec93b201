"""Rounds as text and back, so that a run that was interrupted goes on from them.

What was fitted is not kept: fits are made without chance, and made again they are the same.
"""

import importlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from fractions import Fraction

import numpy as np

from bsp_gp.errors import DataError
from bsp_gp.language.formula import Formula
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.loop import Round
from bsp_gp.loop.proposal import Family, continued
from bsp_gp.loop.view import View
from bsp_gp.loop.writing_up import LEAST_LIKELY
from bsp_gp.physics.force import ForceLaw

BARE = ("entering", "fits", "families")
"""Fields of a round that are made again."""


def text_of(rounds):
    """Rounds as JSON text."""
    out = []
    for done in rounds:
        told = told_rows(done)
        kept = {
            "hypotheses": {k: done.hypotheses[k] for k in told},
            "proposals": {k: done.proposals[k] for k in told},
            "fitted": tuple(k for k in told if k in done.fits),
            "families": tuple((f.name, f.certificate) for f in done.families),
        }
        names = [f.name for f in fields(Round) if f.name not in (*BARE, *kept)]
        out.append(_packed({**{name: getattr(done, name) for name in names}, **kept}))
    return json.dumps(out)


def told_rows(done):
    """Numbers of the hypotheses of which a report tells the law or the constants."""
    best = done.decision.best
    likely = (row.id for row in done.table.rows if row.probability >= LEAST_LIKELY)
    plain = None if done.usual is None else done.usual.decision.best
    told = dict.fromkeys((*(row.id for row in (best, plain) if row is not None), *likely))
    return [k for k in told if k in done.proposals]


def joined_texts(texts):
    """The rounds of several texts as one text; None is no rounds."""
    return json.dumps([each for text in texts if text is not None for each in json.loads(text)])


def rounds_from(text, hypothesis, dataset, begun, *, bounds=None, criteria=None):
    """Rounds of `text_of`, their fits made again.

    Parameters
    ----------
    text : str
    hypothesis : Hypothesis
        The declared one.
    dataset : Dataset
        Training scenes.
    begun : Fit
        What is declared.
    bounds : dict, optional
    criteria : Criteria, optional
        As of `run_rounds`.

    Raises
    ------
    DataError
        If the text is none of this version.
    """
    criteria = criteria or Criteria()
    found, rounds = begun, []
    try:
        kept = [_unpacked(each) for each in json.loads(text)]
    except (ValueError, TypeError, KeyError, AttributeError, ImportError) as error:
        raise DataError("kept rounds cannot be read", remedy="start anew") from error
    for each in kept:
        fits, near = {0: found}, found
        if each["proposals"] and found.shows_tracks:
            entering = continued(hypothesis, found)
            near = View(found, entering, dataset, np.random.default_rng(0), criteria).near
        for number in each.pop("fitted"):
            proposal = each["proposals"][number]
            fits[number] = proposal.fitted(near, dataset, criteria=criteria, bounds=bounds)
        each["hypotheses"] = {0: hypothesis, **each["hypotheses"]}
        each["families"] = tuple(Family(name, certificate=c) for name, c in each["families"])
        done = Round(entering=found, fits=fits, **each)
        rounds.append(done)
        found, hypothesis = done.after, done.continuing
    return rounds


def _packed(value):
    """What JSON can hold of a value; floats keep every bit."""
    if value is None or isinstance(value, str | bool):
        return value
    if hasattr(value, "dtype"):
        value = value.item()
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return {"f": value.hex()}
    if isinstance(value, tuple | list):
        return [_packed(v) for v in value]
    if isinstance(value, Mapping):
        return {"d": [[_packed(k), _packed(v)] for k, v in value.items()]}
    if isinstance(value, Formula | ForceLaw | Fraction):
        kind, arguments, *_ = value.__reduce__()
        return {"c": _name(kind), "a": [_packed(v) for v in arguments]}
    if is_dataclass(value):
        own = {f.name: _packed(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"c": _name(type(value)), "k": own}
    raise TypeError(f"{type(value).__name__} cannot be kept")


def _unpacked(value):
    if isinstance(value, list):
        return tuple(_unpacked(v) for v in value)
    if not isinstance(value, dict):
        return value
    if "f" in value:
        return float.fromhex(value["f"])
    if "d" in value:
        return {_unpacked(k): _unpacked(v) for k, v in value["d"]}
    kind = _kind(value["c"])
    if "a" in value:
        return kind(*map(_unpacked, value["a"]))
    return kind(**{name: _unpacked(v) for name, v in value["k"].items()})


def _name(kind):
    return f"{kind.__module__}:{kind.__qualname__}"


def _kind(name):
    """A class of this package by its name; no others are made."""
    module, _, own = name.partition(":")
    if name == _name(Fraction):
        return Fraction
    kind = getattr(importlib.import_module(module), own) if module.startswith("bsp_gp.") else None
    if not (isinstance(kind, type) and (is_dataclass(kind) or issubclass(kind, Formula))):
        raise TypeError(f"{name} is nothing that is kept")
    return kind
