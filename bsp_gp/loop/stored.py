"""A report that was written, read back: everything but the fit itself."""

import dataclasses
import json
import math
import os
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

from bsp_gp.errors import DataError, LawError
from bsp_gp.fitting.estimates import ConstantEstimate, Errors
from bsp_gp.language.formula import Call
from bsp_gp.language.inputs import input_types
from bsp_gp.language.operators import Type
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.accounts import Ratio
from bsp_gp.loop.outcome import SCHEMA, Effect, LoopReport, Missing, RoundRecord
from bsp_gp.loop.trace import Channel, Trace
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.units import Unit, UnitSystem

_TUPLES = ("hypotheses", "held_out", "varies_with", "noise_findings", "equivalents", "entities",
           "exponents", "at", "values", "errors")  # fmt: skip


def load_report(path: str | os.PathLike) -> LoopReport:
    """Read a report that `write_report` or ``bsp-gp close`` wrote.

    Parameters
    ----------
    path : path-like
        The folder, or its ``report.json``.

    Returns
    -------
    LoopReport
        Its law can be evaluated and simulated; the fit and the tracks of the pictures are not
        stored, and a law with parts other than forces has its forces only.

    Raises
    ------
    DataError
        If there is no report, or one of another schema.
    """
    path = Path(path)
    file = path / "report.json" if path.is_dir() else path
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        if data["schema"] != SCHEMA:
            raise DataError(f"this is a report of schema {data['schema']!r}, not {SCHEMA!r}",
                            file=file, remedy="close the loop on its data anew")  # fmt: skip
        return _report(data, _residuals(file.with_name("residuals.csv")))
    except FileNotFoundError as error:
        raise DataError("there is no report", file=file, remedy="give its folder") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(f"this is no report that can be read ({error})", file=file) from error


def _report(data, residuals):
    law = law_of(data["law"], data["dataset"])
    rounds = tuple(_round(record, data["dataset"]) for record in data["rounds"])
    total = {name: _errors(data["total"][name]) for name in ("before", "after", "floor")}
    kept = ("dataset", "grammar", "search", "seed", "criteria", "noise", "verdict", "stop_reason",
            "n_fits", "versions", "wall_s")  # fmt: skip
    constants = tuple(_made(ConstantEstimate, c) for c in data["law"]["constants"])
    return LoopReport(
        **{name: data[name] for name in kept}, declared=tuple(data["declared"]), rounds=rounds,
        law=law, law_text=data["law"]["text"], law_latex=data["law"]["latex"], constants=constants,
        total={**total, "ratio": _made(Ratio, data["total"]["ratio"]), "ratios": {}},
        probability=_number(data["probability"]), equivalents=tuple(data["equivalents"]),
        left_out=tuple(data["left_out"]), hidden_bound=data.get("hidden_bound"),
        residuals=residuals, extras=tuple(data["extras"]),
    )  # fmt: skip


def _number(value):
    return math.nan if value is None else value


def _made(cls, record, **changes):
    """A dataclass of its fields; what JSON has no number for is nan."""
    if record is None:
        return None
    fields = {f.name: f for f in dataclasses.fields(cls)}
    values = {name: value for name, value in record.items() if name in fields} | changes
    for name, value in values.items():
        if value is None and fields[name].type is float:
            values[name] = math.nan
        elif isinstance(value, list) and name in _TUPLES:
            values[name] = tuple(value)
    return cls(**values)


def _errors(record):
    intervals = {} if record is None else {
        name: tuple(map(_number, pair)) for name, pair in record["intervals"].items()
    }  # fmt: skip
    return _made(Errors, record, **({"intervals": intervals} if record else {}))


def _round(record, dataset):
    effect = record["effect"]
    if effect is not None:
        effect = _made(
            Effect, effect, formula=_formula(effect["law"], dataset),
            constants=tuple(_made(ConstantEstimate, c) for c in effect["constants"]),
        )  # fmt: skip
    trace = record["trace"]
    if trace is not None:
        channels = tuple(_made(Channel, c) for c in trace["channels"])
        # Where the tracks tell nothing an error is infinite, which JSON cannot say.
        errors = tuple(math.inf if e is None else e for e in trace["errors"])
        trace = _made(Trace, trace, channels=channels, errors=errors)
    parts = {name: _errors(record[name]) for name in ("before", "after", "floor")}
    return _made(
        RoundRecord, record, missing=_made(Missing, record["missing"]), effect=effect, trace=trace,
        ratio=_made(Ratio, record["ratio"]), **parts,
    )  # fmt: skip


def formula_of(text, dataset):
    """The formula of a law; None where it is no force, or needs what is not stored.

    Parameters
    ----------
    text : str
    dataset : mapping
        What a report says of its data.
    """
    properties, inputs = dataset.get("properties") or {}, dataset.get("inputs") or {}
    units = {name: _unit(known) for name, known in properties.items()}
    vectors = [name for name, known in properties.items() if known["is_vector"]]
    types = input_types(units, vectors=vectors, n_dims=dataset["n_dims"], up=dataset["up"])
    for name, known in inputs.items():
        types[name] = Type("vector" if known["is_vector"] else "scalar", _unit(known))
    # Laws of a table have base units, whatever the data are in.
    for system in (UnitSystem.from_declared(dataset["units"]), UnitSystem()):
        try:
            return parse_formula(text, types, units=system) if text else None
        except LawError:
            continue
    return None


def _formula(text, dataset):
    """The formula of one term; None as above."""
    formula = formula_of(text, dataset)
    is_sum = isinstance(formula, Call) and formula.operator in ("add", "sub")
    return None if is_sum else formula  # of several forces found as one there is no one formula


def _unit(known):
    return Unit(tuple(map(_power, known["unit"])))


def _power(text):
    power = Fraction(text)
    return int(power) if power.denominator == 1 else power


def law_of(record, dataset):
    """A law of its record in ``report.json``; terms that are no force are left out.

    Parameters
    ----------
    record : mapping
        With ``terms`` and ``values``.
    dataset : mapping
        That of the report.
    """
    terms = []
    for told in record.get("terms") or ():
        formula = _formula(told["text"], dataset)
        if formula is not None:
            terms.append(Term(formula, told["kind"], told["is_declared"]))
    values = {
        name: {k: _number(v) for k, v in value.items()}
        if isinstance(value, Mapping) else _number(value)
        for name, value in (record.get("values") or {}).items()
    }  # fmt: skip
    law = ForceLaw(tuple(terms), values)
    return ForceLaw(law.terms, {n: law.constants[n] for n in law.names if n in law.constants})


def _residuals(file):
    import pandas as pd

    if not file.is_file():
        return None
    table = pd.read_csv(file, dtype=str, keep_default_na=False)
    numbers = [name for name in table.columns if name not in ("scene", "entity", "split")]
    return table.assign(**{name: table[name].replace("", "nan").astype(float) for name in numbers})
