"""The report folder: written whole or not at all."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from pathlib import Path

from bsp_gp.data.cells import safe_cell
from bsp_gp.errors import OutputError
from bsp_gp.loop.outcome import SCHEMA
from bsp_gp.report.figures import build_figures
from bsp_gp.report.html import render_html
from bsp_gp.report.numbers import format_value, is_number
from bsp_gp.report.typeset import law_document

__all__ = ["check_target", "write_report"]

_COLUMNS = (
    "scene",
    "entity",
    "split",
    "t",
    "speed",
    "distance",
    "before",
    "after",
    "before_along",
    "after_along",
)
_MARK = f'"schema": "{SCHEMA.rpartition("/")[0]}/'


def check_target(folder, overwrite=False):
    """See whether a report can be written there, before hours of work.

    Parameters
    ----------
    folder : path
    overwrite : bool
        Whether an older report may be replaced.

    Returns
    -------
    Path
        The absolute path.

    Raises
    ------
    OutputError
        If something is there that must not be replaced, or nothing can be written there.
    """
    target = Path(folder).expanduser().resolve()
    if Path.cwd().is_relative_to(target):
        raise OutputError(
            f"{target}: a report needs a folder of its own, and this is or holds the current one; "
            "choose another --out"
        )
    if target.exists() and not target.is_dir():
        raise OutputError(f"{target}: is a file, not a folder; choose another --out")
    parent = next(p for p in target.parents if p.exists())
    if not parent.is_dir():
        raise OutputError(f"{target}: {parent} is a file, not a folder; choose another --out")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise OutputError(f"{target}: {parent} is not writable; choose another --out")
    if target.is_dir():
        _check_old(target, overwrite)
    return target


def _check_old(target, overwrite):
    try:
        has_files = any(target.iterdir())
        is_ours = has_files and _is_report(target)
    except OSError as error:
        raise OutputError(f"{target}: cannot be read ({error.strerror})") from error
    if not has_files:
        return
    if not is_ours:
        raise OutputError(
            f"{target}: holds files that are no report of bsp_gp and are never overwritten; "
            "choose another --out"
        )
    if not overwrite:
        raise OutputError(
            f"{target}: holds an older report; pass --overwrite to replace it, or choose "
            "another --out"
        )


def _is_report(target):
    file = target / "report.json"
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        return _MARK.encode() in stream.read(4096)


def write_report(report, folder, *, overwrite=False, run_info=None):
    """Write report.html, report.json, the law, residuals, figures and run.json.

    Parameters
    ----------
    report : LoopReport
    folder : path
        Made, with its parents; must be empty or, with `overwrite`, hold an older report.
    overwrite : bool
    run_info : mapping, optional
        What else belongs into run.json (``argv``, settings); plain values only.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    OutputError
        See `check_target`; also if the disk refuses. Nothing is left behind then, and an
        older report is still there.
    """
    target = check_target(folder, overwrite)
    files = _contents(report, dict(run_info or {}))
    fresh = target.with_name(f".{target.name}.new-{os.getpid()}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        fresh.mkdir()
        try:
            for name, data in files.items():
                path = fresh / name
                path.parent.mkdir(exist_ok=True)
                path.write_bytes(data)
            _put_in_place(fresh, target)
        finally:
            shutil.rmtree(fresh, ignore_errors=True)
    except OSError as error:
        raise OutputError(
            f"{target}: cannot be written ({error.strerror or error}); choose another --out"
        ) from error
    return target


def _put_in_place(fresh, target):
    """Rename the new folder to its place; an older one steps aside until that is done."""
    if not target.exists():
        fresh.rename(target)
        return
    old = target.with_name(f".{target.name}.old-{os.getpid()}")
    target.rename(old)
    try:
        fresh.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


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
        "law.txt": _law_text(report),
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
        lines.append(f"# {' '.join(name.split())} = {format_value(c.value, c.low, c.high, c.unit)}")
    return "\n".join(lines) + "\n"


def _residuals(table):
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    if table is not None:
        columns = [getattr(table, name) for name in _COLUMNS]
        for row in zip(*columns, strict=True):
            writer.writerow([_csv_cell(value) for value in row])
    return out.getvalue()


def _csv_cell(value):
    if isinstance(value, str):
        return safe_cell(value)
    return repr(float(value)) if is_number(value) else ""
