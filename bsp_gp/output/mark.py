"""The mark of our result folders: which files in them are ours, with the digest of each.

What the mark does not list, or lists with another digest, belongs to the user.
"""

import hashlib
import json
import os
import stat
from dataclasses import dataclass, field

MARK = ".bsp_gp"
_SCHEMA = "bsp_gp/mark/1"
_REPORT = b'"schema": "bsp_gp/report/'
_REPORT_FILES = ("law.tex", "law.txt", "report.html", "report.json", "residuals.csv", "run.json")


@dataclass(frozen=True)
class Mark:
    """What a folder of ours holds.

    Attributes
    ----------
    kind : str
        Of the result, such as "report".
    files : dict
        Digest by path inside the folder, with "/"; an empty one stands for any content.
    beside : dict
        The same of files that lie beside the folder and belong to it, by name.
    """

    kind: str
    files: dict = field(default_factory=dict)
    beside: dict = field(default_factory=dict)


def read_mark(folder):
    """The mark of a folder, or None; a report from before there were marks is known by its schema.

    Raises
    ------
    OSError
        If the folder cannot be read.
    """
    try:
        with open(os.path.join(folder, MARK), "rb") as file:
            content = json.load(file)
        if content["schema"] != _SCHEMA:
            return None
        return Mark(str(content["kind"]), dict(content["files"]), dict(content["beside"]))
    except FileNotFoundError:
        return _mark_of_report(folder)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _mark_of_report(folder):
    try:
        with open(os.path.join(folder, "report.json"), "rb") as file:
            if _REPORT not in file.read(4096):
                return None
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None
    names = [name for name in all_files(folder) if name in _REPORT_FILES or _is_figure(name)]
    return Mark("report", {name: file_digest(os.path.join(folder, name)) for name in names})


def _is_figure(name):
    folder, _, file = name.rpartition("/")
    return folder == "figures" and file.endswith((".svg", ".png"))


def write_mark(folder, mark):
    """Put a mark into a folder, whole."""
    about = "Written by bsp-gp: the files here that it may replace. All others are yours."
    content = {"schema": _SCHEMA, "about": about, **vars(mark)}
    part = os.path.join(folder, f"{MARK}-part")
    with open(part, "w", encoding="utf-8") as file:
        file.write(json.dumps(content, indent=1, ensure_ascii=True) + "\n")
    os.replace(part, os.path.join(folder, MARK))


def mark_folder(folder, kind, beside=None):
    """Mark a folder that holds what is ours alone."""
    digests = {name: file_digest(os.path.join(folder, name)) or "" for name in all_files(folder)}
    write_mark(folder, Mark(kind, digests, beside or {}))


def file_digest(path):
    """The SHA-256 of a regular file, or None of anything else, or of what cannot be read."""
    try:
        if not stat.S_ISREG(os.lstat(path).st_mode):
            return None
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (PermissionError, FileNotFoundError):
        return None


def all_files(folder, inside=""):
    """Paths of everything in a folder, with "/"; a folder in it is there as NAME/ if it is empty.

    Symbolic links are not followed.
    """
    names = []
    with os.scandir(os.path.join(folder, inside)) as entries:
        for entry in sorted(entries, key=lambda e: e.name):
            name = f"{inside}{entry.name}"
            if entry.is_dir(follow_symlinks=False):
                names += all_files(folder, f"{name}/") or [f"{name}/"]
            else:
                names.append(name)
    return names


def strangers(folder, mark):
    """Paths of what is in a folder and not ours: not in the mark, or altered since."""
    return [name for name in all_files(folder) if not _is_ours(folder, name, mark)]


def _is_ours(folder, name, mark):
    if name in (MARK, f"{MARK}-part"):
        return True
    if mark is None or name not in mark.files:
        return False
    return not mark.files[name] or mark.files[name] == file_digest(os.path.join(folder, name))
