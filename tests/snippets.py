"""The fenced blocks of a page, run from its top to its end in one empty folder.

``sh`` and ``python`` blocks are run, a ``text`` block right below one is what it prints (``...``
stands for anything), and ``<!-- file: NAME -->`` above a block of any kind makes it a file. With
``<!-- not run: WHY -->`` above it a block is left alone; WHY names the file that does it instead.
``<!-- slow -->`` marks a page, and ``<!-- needs: NAME -->`` one that runs where the module, or the
folder of reference data, is there.
"""

import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from bsp_gp.cli import main

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("BSP_GP_DATA", ROOT.parent / "shared" / "data"))
_BLOCK = re.compile(
    r"(?:^<!-- (?P<mark>file|not run): (?P<note>[^\n]*?) -->\n+)?"
    r"^(?P<fence>```+)(?P<kind>[\w-]+|\{[\w-]+\}[^\n]*)?\n(?P<text>.*?)^(?P=fence)$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """One fenced block: its kind, its text, its line, and the mark above it."""

    kind: str
    text: str
    line: int
    mark: str = ""
    note: str = ""


def blocks(text):
    """The blocks of a page, in order."""
    return [
        Block(m["kind"] or "", m["text"], text[: m.start("fence")].count("\n") + 1,
              m["mark"] or "", m["note"] or "")
        for m in _BLOCK.finditer(text)
    ]  # fmt: skip


def pages():
    """Pages whose snippets are run: the README, CONTRIBUTING and whatever lies under docs."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def idle(path):
    """Blocks that nothing runs, makes or compares, and that no named file of the source does."""
    is_run, out = False, []
    for block in blocks(path.read_text("utf-8")):
        named = re.findall(r"[\w./-]+/[\w.-]+", block.note) if block.mark == "not run" else []
        is_meant = any(does(name, block, path.name) for name in named)
        is_shown = block.kind == "text" and is_run
        is_run = block.kind in ("sh", "python") and (block.mark == "" or is_meant)
        is_page = block.kind.startswith("{")  # of the site alone, built by a test
        if not (block.mark == "file" or is_run or is_meant or is_shown or is_page):
            out.append(f"{path.name}:{block.line}")
    return out


def does(name, block, page):
    """Whether a file does what a block of a page says: it reads the page, or has all commands."""
    if not (ROOT / name).is_file():
        return False
    text = (ROOT / name).read_text("utf-8")
    mine, its = (
        {re.sub(r"\s+#.*", "", line).strip() for line in _commands(lines)}
        for lines in (block.text, text)
    )
    mine = {line for line in mine if name not in line}  # but the one that runs the file itself
    return page in text or (bool(mine) and mine <= its)


def is_slow(path):
    return "<!-- slow -->" in path.read_text("utf-8")


def missing(path):
    """What a page needs and is not here; empty if nothing is."""
    for name in re.findall(r"<!-- needs: (\S+) -->", path.read_text("utf-8")):
        if not (DATA / name).is_dir() if "/" in name else find_spec(name) is None:
            return name
    return ""


def prepare(folder, path):
    """Make the folder in which a page runs, with the examples and the data that it needs."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copytree(ROOT / "examples", folder / "examples", dirs_exist_ok=True)
    for name in re.findall(r"<!-- needs: (\S+/\S+) -->", path.read_text("utf-8")):
        shutil.copytree(DATA / name, folder / Path(name).name, dirs_exist_ok=True)


def run_page(path, tell=False):
    """Run the blocks of a page in the current folder; an AssertionError names the line."""
    names, printed = {"__name__": "__main__"}, None
    found = blocks(path.read_text("utf-8"))
    for block, below in zip(found, [*found[1:], Block("", "", 0)], strict=True):
        where = f"{path.name}:{block.line}"
        if block.mark == "not run":
            printed = None
        elif block.mark == "file":
            target = Path(block.note)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(block.text, "utf-8")
        elif block.kind == "sh":
            may_fail = below.kind == "text" and "error:" in below.text  # a page shows one
            printed = "".join(_run(line, where, may_fail) for line in _commands(block.text))
        elif block.kind == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                code = compile("\n" * block.line + block.text, str(path), "exec")
                exec(code, names)
            printed = out.getvalue()
        elif block.kind == "text" and printed is not None:
            compare(block.text, printed, where)
            printed = None
        if tell and printed is not None:
            print(f"--- {where}\n{printed}", flush=True)


def _commands(text):
    """Lines of a shell, those ending in a backslash joined, comments left out."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


def _run(line, where, may_fail):
    """What a line prints, errors too; bsp-gp in this process, where all is imported already."""
    words = shlex.split(re.sub(r"\s#.*", "", line))
    if words[0] == "bsp-gp" and not set(words) & {"|", ">", "&&", "||", ">>", "<"}:
        with (
            contextlib.redirect_stdout(io.StringIO()) as out,
            contextlib.redirect_stderr(io.StringIO()) as err,
        ):
            status = main(words[1:])
        shown = out.getvalue() + "".join(  # progress comes and goes with the time
            f"{text}\n" for text in err.getvalue().splitlines() if text.startswith("bsp-gp:")
        )
        assert status == 0 or may_fail, f"{where}: {line}\n{err.getvalue()}"
        return shown
    with command_folder() as folder:
        env = {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, env=env)
    assert done.returncode == 0, f"{where}: {line}\n{done.stderr}"
    return done.stdout


@contextlib.contextmanager
def command_folder():
    """A folder with the command bsp-gp of this source tree, and its Python as python."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        for name, run in (("bsp-gp", f'"{sys.executable}" -m bsp_gp'),
                          ("python", f'"{sys.executable}"')):  # fmt: skip
            script = Path(folder) / name
            script.write_text(f'#!/bin/sh\nPYTHONPATH="{ROOT}" exec {run} "$@"\n', "utf-8")
            script.chmod(0o755)
        yield folder


def compare(expected, printed, where):
    """Whether what is shown is what was printed, up to blanks at line ends; ``...`` is anything."""
    shown = " ".join(expected.split())
    pattern = r".*?".join(map(re.escape, shown.split("...")))
    real = f" {' '.join(printed.split())} "  # "..." at an end may be nothing
    assert re.search(pattern, real), (
        f"{where} shows\n{expected}\nwhat is printed is\n{printed}"
    )


if __name__ == "__main__":  # python -m tests.snippets PAGE FOLDER: run a page, keep what it makes
    page, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    prepare(folder, page)
    os.chdir(folder)
    run_page(page, tell=True)
