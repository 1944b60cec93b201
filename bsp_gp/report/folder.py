"""The report folder: written whole or not at all."""

import csv
import io
import json
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bsp_gp.data.cells import safe_cell
from bsp_gp.loop.outcome import LoopReport
from bsp_gp.output.place import claim
from bsp_gp.report.figures import build_figures
from bsp_gp.report.html import render_html
from bsp_gp.report.numbers import format_constant, is_number
from bsp_gp.report.page import page_of
from bsp_gp.report.typeset import law_document

KIND = "report"

RESIDUALS = (
    "scene", "entity", "split", "t", "speed", "distance", "before", "after", "before_along",
    "after_along",
)  # fmt: skip


def write_report(
    report: LoopReport, folder: str | os.PathLike, *, overwrite: bool = False,
    run_info: Mapping | None = None,
) -> Path:  # fmt: skip
    """Write report.html, report.json, the law, residuals, figures and run.json.

    Parameters
    ----------
    folder : path
        Made, with its parents; must be empty or, with `overwrite`, hold an older report; what
        else it holds is kept.
    run_info : mapping, optional
        What else belongs into run.json (``argv``, settings); plain values only.

    Raises
    ------
    OutputError
        See `bsp_gp.output.place.claim`; also if the disk refuses. Nothing is left behind then,
        and an older report is still there.
    """
    with claim(folder, KIND, overwrite=overwrite) as place:
        files = _contents(report, dict(run_info or {}))
        with place.fill(KIND, overwrite) as fresh:
            for name, data in files.items():
                path = fresh / name
                path.parent.mkdir(exist_ok=True)
                path.write_bytes(data)
    return place.path


def _contents(report, run_info):
    """Every file of the folder as bytes."""
    figures = build_figures(report)
    data = report.to_dict()
    run = {key: data[key] for key in ("seed", "alpha", "versions", "grammar", "wall_s")}
    run["dataset"] = {key: data["dataset"].get(key) for key in ("name", "fingerprint")}
    run.update(run_info)
    files = {
        "report.html": render_html(report, run_info, figures),
        "report.json": _json(data),
        "law.txt": _law_text(page_of(report)),
        "law.tex": law_document(report),
        "residuals.csv": _residuals(report.residuals),
        "run.json": _json(run),
    }
    out = {name: text.encode("utf-8", "replace") for name, text in files.items()}
    for name, figure in figures.items():
        out[f"figures/{name}.svg"] = figure.svg.encode("utf-8")
        out[f"figures/{name}.png"] = figure.png
    return out


def _json(value):
    return json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _law_text(report):
    """The law on the first line; what it was fitted under and its constants as comments below."""
    lines = [" ".join(report.law_text.split())]
    lines += [f"# with {c['name']}: {' '.join(c['text'].split())}" for c in report.corrections]
    for c in report.constants:
        name = f"{c.name} of {c.entity}" if c.entity else c.name
        lines.append(f"# {' '.join(name.split())} = {format_constant(c)}")
    return "\n".join(lines) + "\n"


def _residuals(table):
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(RESIDUALS)
    if table is not None:
        writer.writerows(zip(*(_csv_cells(getattr(table, n)) for n in RESIDUALS), strict=True))
    return out.getvalue()


def _csv_cells(column):
    """A column as it is written; a text, such as the name of a scene, is looked at once."""
    values = np.asarray(column)
    if values.dtype.kind == "f":
        return [
            repr(value) if is_known else ""
            for value, is_known in zip(values.tolist(), np.isfinite(values).tolist(), strict=True)
        ]
    told = {value: _csv_cell(value) for value in set(values.tolist())}
    return [told[value] for value in values.tolist()]


def _csv_cell(value):
    if isinstance(value, str):
        return safe_cell(value)
    return repr(float(value)) if is_number(value) else ""
