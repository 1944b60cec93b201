"""The loop on many data sets: one row for each, in one table and one page.

Every data set is closed as `close_loop` closes it alone, with the same seed, so that its row does
not depend on its neighbours, on how many work, or on how often the sweep was stopped and taken up.
"""

import csv
import hashlib
import io
import json
import os
import traceback
from pathlib import Path

import numpy as np

from bsp_gp.data.cells import safe_cell
from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import BspError, DataError, SettingsError
from bsp_gp.loop.close import close_loop
from bsp_gp.loop.writing_up import versions
from bsp_gp.output.mark import MARK, Mark, write_mark
from bsp_gp.output.place import claim, whole_file
from bsp_gp.report.sweep_page import sweep_page
from bsp_gp.workers import Crew

KIND = "sweep"
ROWS, SUMMARY, PAGE = "rows.jsonl", "summary.csv", "index.html"
COLUMNS = (
    "dataset", "n_scenes", "n_rows", "verdict", "probability", "effect", "kind", "law", "constants",
    "equivalents", "unit", "before", "after", "floor", "ratio", "ratio_low", "ratio_high",
    "p_value", "complete", "error",
)  # fmt: skip
"""Of the table: `law` is the final one, the errors are those of rollouts on held-out rows, and
`error` says why a data set has no verdict."""
_TABLES = (".csv", ".tsv", ".txt", ".parquet", ".pq", ".trk")
_TRACKS = ("trajectories.csv", "trajectories.parquet")


def find_datasets(words):
    """Data sets of folders, folders of folders, globs, lone tables and tables of paths.

    Returns
    -------
    dict of str to Path
        By a name: the path below what all of them lie in.

    Raises
    ------
    DataError
        If a word leads to no data set.
    """
    found = []
    for word in map(str, words):
        here = _of(word)
        if not here:
            raise DataError(
                "there is no data set here", file=word,
                remedy="give folders with trajectories.csv, folders of such, tables, globs, or a "
                "table of paths with the column path",
            )  # fmt: skip
        found += here
    paths = list(dict.fromkeys(Path(os.path.abspath(path)) for path in found))
    top = os.path.commonpath([path.parent for path in paths])
    return {path.relative_to(top).as_posix(): path for path in paths}


def _of(word):
    path = Path(word)
    if any(c in word for c in "*?[") and not path.exists():
        parent = Path(path.anchor) if path.is_absolute() else Path()
        pattern = str(path.relative_to(parent)) if path.is_absolute() else word
        return [p for p in sorted(parent.glob(pattern)) if p.is_file() or _is_dataset(p)]
    if path.is_file():
        return _listed(path) or [path]
    if not path.is_dir():
        return []
    if _is_dataset(path):
        return [path]
    inside = sorted(path.rglob("*"))
    folders = [p for p in inside if p.is_dir() and _is_dataset(p)]
    tables = [
        p for p in inside
        if p.is_file() and p.suffix.lower() in _TABLES and not _is_dataset(p.parent)
        and not any(folder in p.parents for folder in folders)
    ]  # fmt: skip
    return sorted([*folders, *tables])


def _is_dataset(path):
    return path.is_dir() and any((path / name).is_file() for name in _TRACKS)


def _listed(table):
    """Paths of a table with a column path, from its folder; none if it has no such column."""
    if table.suffix.lower() not in (".csv", ".tsv", ".txt"):
        return []
    try:
        with table.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file, delimiter="\t" if table.suffix == ".tsv" else ","))
    except (UnicodeDecodeError, csv.Error):
        return []
    if not rows or "path" not in rows[0]:
        return []
    paths = [table.parent / row["path"].strip() for row in rows if (row["path"] or "").strip()]
    for path in paths:
        if not path.exists():
            raise DataError(f"names {path}, which is not there", file=table, column="path")
    return paths


def sweep(
    datasets, declared, out, *, workers=None, resume=False, overwrite=False, read=load_dataset,
    progress=None, **settings,
):  # fmt: skip
    """Close the loop on many data sets, and write a table and a page.

    A data set that cannot be read or closed has a row that says why, and the others go on. What
    was done is kept after each of them, so that a sweep that was stopped, however, is taken up.

    Parameters
    ----------
    datasets : dict of str to path
        See `find_datasets`.
    out : path
        Folder of the table, the page, and the rows as they come.
    resume : bool
        Go on with what is in the folder; a sweep with other laws or settings is refused.
    overwrite : bool
        Begin anew in the folder of an older sweep.
    read : callable
        ``read(path) -> Dataset``.
    **settings
        Of `close_loop`; `seed` seeds each data set alike.

    Returns
    -------
    list of dict
        Rows of `COLUMNS`, in the order of the data sets.

    Raises
    ------
    SettingsError
        If the folder is of another sweep.
    OutputError
        See `bsp_gp.output.place.claim`.
    """
    says = progress or (lambda text: None)
    inputs = list(datasets.values())
    with claim(out, KIND, overwrite=overwrite or resume) as place:
        is_new = not (place.path / MARK).exists() or (overwrite and not resume)
        for path in inputs:
            if place.path == path or place.path in path.parents:
                raise SettingsError(f"--out {out} holds the data set {path}; choose another folder")
        if is_new:
            with place.fill(KIND, True):
                pass
            write_mark(place.path, Mark(KIND, dict.fromkeys((ROWS, SUMMARY, PAGE), "")))
        key = _key([declared, settings, versions()])
        known = _known(place.path / ROWS)
        if resume and known and all(row["sweep"] != key for row in known.values()):
            raise SettingsError(
                f"{place.path} is of a sweep with other laws, settings or versions; give these, "
                "or begin anew with --overwrite"
            )
        prints = {name: fingerprint(path) for name, path in datasets.items()}
        rows = {
            name: known[name]["row"] for name in datasets
            if name in known and (known[name]["sweep"], known[name]["data"]) == (key, prints[name])
        }  # fmt: skip
        todo = [name for name in datasets if name not in rows]
        says(f"{len(rows)} of {len(datasets)} data sets are done")
        shared = {"declared": tuple(declared), "read": read, **settings}
        jobs = (_job(name, datasets[name], read, workers) for name in todo)
        with (place.path / ROWS).open("ab") as file:
            for number, row in Crew(workers).each(_closed, shared, jobs):
                name = todo[number]
                rows[name] = json.loads(json.dumps(row))
                _append(file, {"sweep": key, "data": prints[name], "row": row})
                says(f"{len(rows)} of {len(datasets)}: {name}: {row['verdict'] or row['error']}")
        ordered = [rows[name] for name in datasets]
        with whole_file(place.path / SUMMARY) as part:
            part.write_text(_table(ordered), encoding="utf-8")
        with whole_file(place.path / PAGE) as part:
            part.write_text(sweep_page(ordered, declared), encoding="utf-8")
    return ordered


def _job(name, path, read, workers):
    """A data set as it is sent: read here for other machines, else by whoever closes it."""
    if not hasattr(workers, "scatter"):
        return name, path
    try:
        return name, read(path)
    except (BspError, OSError) as error:
        return name, error


def _closed(shared, job):
    """The row of a data set."""
    name, data = job
    settings = dict(shared)
    declared, read = settings.pop("declared"), settings.pop("read")
    row = {**dict.fromkeys(COLUMNS, ""), "dataset": name}
    try:
        if isinstance(data, Exception):
            raise data
        dataset = read(data) if isinstance(data, (str, Path)) else data
        row |= {
            "n_scenes": len(dataset.scenes), "n_rows": sum(len(s.times) for s in dataset.scenes)
        }
        rng = np.random.default_rng(settings.get("seed"))
        return row | _told(close_loop(dataset, declared, rng=rng, **settings))
    except (BspError, OSError, MemoryError) as error:
        return row | {"error": " ".join(str(error).split()) or type(error).__name__}
    except Exception:  # the others go on; the command says so, and ends with an error
        return row | {"error": f"a defect of bsp_gp: {traceback.format_exc()}"}


def _told(report):
    """What a report says, in the columns of the table."""
    data = report.to_dict()
    effects = [r["effect"] for r in data["rounds"] if r["effect"]]
    total, ratio = data["total"], data["total"]["ratio"]
    constants = [
        f"{c['name']}{'[' + c['entity'] + ']' if c['entity'] else ''} = {c['value']:.6g} "
        f"({c['low']:.6g} to {c['high']:.6g}) {c['unit']}".strip()
        for c in data["law"]["constants"]
        if None not in (c["value"], c["low"], c["high"])
    ]
    return {
        "verdict": data["verdict"], "probability": data["probability"],
        "effect": "; ".join(e["name"] for e in effects),
        "kind": "; ".join(e["code"] for e in effects), "law": data["law"]["text"],
        "constants": "; ".join(constants), "equivalents": "; ".join(data["equivalents"]),
        "unit": total["before"]["unit"],
        **{k: total[k]["rollout_rmse"] for k in ("before", "after", "floor")},
        "ratio": ratio["value"], "ratio_low": ratio["low"], "ratio_high": ratio["high"],
        "p_value": data["rounds"][0]["missing"]["p_value"], "complete": data["complete"],
    }  # fmt: skip


# --- what is kept ---------------------------------------------------------------------------------


def fingerprint(path):
    """SHA-256 of a table, or of the files of a data set's folder with their names."""
    path = Path(path)
    files = sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]
    whole = hashlib.sha256()
    for file in files:
        with file.open("rb") as opened:
            digest = hashlib.file_digest(opened, "sha256").hexdigest()
        whole.update(f"{file.name}\0{digest}\0".encode())
    return whole.hexdigest()


def _key(values):
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _known(file):
    """Rows that are kept, by name; a last line that a killed run has not finished is cut off."""
    if not file.exists():
        return {}
    content = file.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if whole != content:
        os.truncate(file, len(whole))
    lines = [json.loads(line) for line in whole.splitlines()]
    return {line["row"]["dataset"]: line for line in lines}


def _append(file, line):
    file.write(json.dumps(line).encode() + b"\n")
    file.flush()
    os.fsync(file.fileno())


def _table(rows):
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        writer.writerow([_cell(row[name]) for name in COLUMNS])
    return out.getvalue()


def _cell(value):
    if value is None:
        return ""
    return safe_cell(value) if isinstance(value, str) else repr(value)
