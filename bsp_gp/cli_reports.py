"""Reports that there are already: shown again, and run again."""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from bsp_gp.errors import DataError, SettingsError
from bsp_gp.workers import python_path

_ALONE = ("--overwrite", "--resume", "--json", "--quiet")
_WITH_VALUE = ("--out",)
_CHANGES = ("wall_s", "seconds", "versions")
"""What two runs of the same need not have in common."""


def run_record(folder):
    """Where a run began, from the folder of its report, for ``run.json``."""
    with contextlib.suppress(ValueError):  # on another drive
        return {"started_in": os.path.relpath(os.getcwd(), folder)}
    return {}


def run_again(folder, quiet=False):
    """Run what made a report once more, into a folder that is thrown away.

    Parameters
    ----------
    folder : path
        Of the report.

    Returns
    -------
    difference : str
        Where the two answers first differ; "" where they are the same bit for bit.
    notes : list of str

    Raises
    ------
    DataError
        If there is no report with its ``run.json``, or it cannot be run again.
    """
    folder = Path(folder)
    run, old = _read(folder / "run.json"), _read(folder / "report.json")
    argv = run.get("argv")
    if not isinstance(argv, list) or argv[:1] != ["bsp-gp"]:
        raise SettingsError(
            f"{folder}: this report was made from Python; run.json has its settings, and no command"
        )
    start = (folder / run.get("started_in", ".")).resolve()
    if not start.is_dir():
        raise DataError(f"it was run in a folder that is gone: {start}", file=folder)
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "report"
        words = [*_kept(argv[1:]), "--out", str(out), *(["--quiet"] if quiet else [])]
        done = subprocess.run(
            [sys.executable, "-m", "bsp_gp", *words], cwd=start, stdout=subprocess.DEVNULL,
            check=False, env={**os.environ, "PYTHONPATH": python_path()},
        )  # fmt: skip
        if done.returncode == 130:
            raise KeyboardInterrupt
        if done.returncode:
            raise DataError("the run did not end, as told above", file=folder)
        new = _read(out / "report.json")
    notes = [
        f"{name} was {was}, and is {new['versions'].get(name)} now"
        for name, was in old["versions"].items() if was != new["versions"].get(name)
    ]  # fmt: skip
    if old.get("left_out"):
        notes.append("its time limit was met, which no two runs meet alike")
    return first_difference(old, new), notes


def _kept(argv):
    """The words of a command that say what is computed."""
    out, rest = [], list(argv)
    while rest:
        word = rest.pop(0)
        if word in _WITH_VALUE:
            rest = rest[1:]
        elif word not in _ALONE and not word.startswith(tuple(f"{w}=" for w in _WITH_VALUE)):
            out.append(word)
    return out


def _read(file):
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise DataError("there is no such file", file=file,
                        remedy="give the folder of a report") from error  # fmt: skip
    except ValueError as error:
        raise DataError(f"the file cannot be read: {error}", file=file) from error


def first_difference(one, other, where="report"):
    """Where two records first differ, as ``report.rounds[0].p_value: 1 and 2``; "" if nowhere."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys((*one, *other)):
            if key not in _CHANGES:
                found = first_difference(one.get(key), other.get(key), f"{where}.{key}")
                if found:
                    return found
        return ""
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        found = (first_difference(a, b, f"{where}[{k}]") for k, (a, b) in pairs)
        return next(filter(None, found), "")
    return "" if one == other else f"{where}: {one!r:.60} and {other!r:.60}"
