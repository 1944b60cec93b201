"""Run one case in a forked child with bounds on time and memory, and say what it did wrong.

A fault is a pair (kind, detail). Allowed are status 0, and 2 with one line on stderr and a folder
that is as it was; everything else is a fault.
"""

import contextlib
import faulthandler
import gc
import hashlib
import io
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

from bsp_gp.output.mark import MARK

LIMIT_S = 60
"""Of computing without a stage of progress: a hang. The machine may be busy with other work, so
that computing is what counts; of waiting, `PATIENCE` times as much."""
PATIENCE = 3
MEMORY = 3 << 30
CANARY = "evaluated"
"""A file of this name is made by texts that are evaluated."""
ERROR = "bsp-gp: error: "
LONGEST = 1500
"""Characters of a line that a person reads."""
_HIDDEN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)


@dataclass(frozen=True)
class Outcome:
    """What became of a case."""

    rc: int | None
    faults: tuple
    message: str
    seconds: float

    @property
    def kinds(self):
        return {kind for kind, _ in self.faults}


@dataclass(frozen=True)
class Running:
    """A case that a child is at work on."""

    case: object
    pid: int
    place: Path
    before: dict
    started: float

    @property
    def folder(self):
        return self.place / "work"


def warm():
    """Import everything and fill caches before the first fork, so that a child starts at once."""
    import cv2
    import matplotlib

    matplotlib.use("Agg")
    cv2.setNumThreads(1)
    import matplotlib.pyplot as plt

    plt.close("all")
    import bsp_gp.cli  # noqa: F401
    import bsp_gp.cli_latents  # noqa: F401
    import bsp_gp.cli_make  # noqa: F401
    import bsp_gp.fitting.law_fit  # noqa: F401
    import bsp_gp.loop.close  # noqa: F401
    import bsp_gp.report.drawing  # noqa: F401
    import bsp_gp.report.folder  # noqa: F401
    import bsp_gp.report.scenes  # noqa: F401
    import bsp_gp.search.comparison  # noqa: F401
    import bsp_gp.simulate.truth  # noqa: F401
    import bsp_gp.vision.recording  # noqa: F401
    from bsp_gp.cli import main

    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        table = Path(folder) / "falls.csv"
        noise = (0.001 * (k * k * k % 7) for k in range(12))
        rows = (f"{k / 20},{k * k / 90 + e},{e}\n" for k, e in enumerate(noise))
        table.write_text("t,x,y\n" + "".join(rows), encoding="utf-8")
        main(["grammar", "show", "newtonian", "--data", str(table)])
        main(["fit", str(table), "--law=c * e_x", "--units", "length=m,time=s"])
    gc.freeze()  # a collection in a child would copy the pages of all that is here


def run(case, limit_s=LIMIT_S):
    """Run a case and wait for its outcome."""
    running = start(case, limit_s)
    _, status = os.waitpid(running.pid, 0)
    return finish(running, status)


def start(case, limit_s=LIMIT_S):
    """Run a case in a child of its own."""
    place = Path(tempfile.mkdtemp(prefix="fuzz-"))
    running = Running(case, 0, place, {}, time.perf_counter())
    running.folder.mkdir()
    case.write(running.folder)
    before = digests(running.folder)
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads
        pid = os.fork()
    if pid == 0:
        _child(case, place, limit_s)
    return Running(case, pid, place, before, running.started)


def finish(running, status):
    """The outcome of a child that has ended with this status of `os.wait`."""
    place, case = running.place, running.case
    seconds = time.perf_counter() - running.started
    text = (place / "stderr").read_text("utf-8", "replace") if (place / "stderr").exists() else ""
    stuck = (place / "stuck").read_text("utf-8") if (place / "stuck").exists() else ""
    try:
        told = json.loads((place / "told").read_text("utf-8"))
    except (OSError, ValueError):
        told = None
    if told is None:
        faults = [("hang", stuck)] if stuck else [("died", f"status {status}\n{text[-2000:]}")]
        rc = None
    else:
        rc = told["rc"]
        faults = [("warning", text) for text in told["warnings"]]
        if told["traceback"]:
            faults.append(("traceback", told["traceback"]))
        else:
            faults += _faults_of_text(case, rc, text)
    faults += _faults_of_files(running, rc)
    shutil.rmtree(place, ignore_errors=True)
    return Outcome(rc, tuple(faults), text[-300:], seconds)


def _faults_of_text(case, rc, text):
    lines = text.splitlines()
    is_quiet = "--quiet" in case.argv or case.argv[:1] == ("grammar",)
    if rc == 2:
        errors = [line for line in lines if line.startswith(ERROR)]
        is_one = len(errors) == 1 and lines[-1] == errors[0] and len(errors[0]) <= LONGEST
        if not is_one or (is_quiet and len(lines) > 1):
            return [("message", text)]
    elif rc != 0:
        return [("status", f"{rc}: {text}")]
    elif "Traceback" in text or "Warning" in text:
        return [("message", text)]
    elif is_quiet and lines and "--json" not in case.argv:
        return [("message", text)]
    return []


def _faults_of_files(running, rc):
    after, before = digests(running.folder), running.before
    changed = sorted(n for n in {*before, *after} if before.get(n) != after.get(n))
    faults = []
    if any(CANARY in Path(name).parts for name in after):
        faults.append(("evaluated", ""))
    if rc != 0:
        if changed:
            faults.append(("partial", f"status {rc}, and these changed: {changed[:8]}"))
        return faults
    own = [n for n in changed if n in before and not n.startswith("out")]
    if own:
        faults.append(("inputs", f"changed: {own[:8]}"))
    debris = [n for n in changed if any(p.startswith(".") and p != MARK for p in Path(n).parts)]
    if debris:
        faults.append(("partial", f"left behind: {debris[:8]}"))
    for name in changed:
        if name.endswith(".json") and name in after:
            faults += _faults_of_json(running.folder / name)
    return faults


def _faults_of_json(path):
    def refuse(word):
        raise ValueError(f"{word} is no JSON")

    try:
        json.loads(path.read_text("utf-8"), parse_constant=refuse)
    except ValueError as error:
        return [("json", f"{path.name}: {error}")]
    return []


def digests(folder):
    """What is in a folder: path -> digest of a file, target of a link, or an empty text."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            found[name] = f"-> {os.readlink(path)}"
        elif path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        else:
            found[name] = ""
    return found


# --- in the child ---------------------------------------------------------------------------------


def _child(case, place, limit_s):
    """Run the case; never returns."""
    try:
        told = _work(case, place, limit_s)
        (place / "told").write_text(json.dumps(told), "utf-8")
    finally:
        os._exit(0)


def _work(case, place, limit_s):
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for name, number in (("stdout", 1), ("stderr", 2)):
        with open(place / name, "wb") as file:
            os.dup2(file.fileno(), number)
        stream = io.TextIOWrapper(
            open(number, "wb", closefd=False), encoding="utf-8", errors="backslashreplace",
            line_buffering=True,
        )  # fmt: skip
        setattr(sys, name, stream)
    os.chdir(place / "work")
    os.environ["HOME"] = str(place)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _expect_progress(limit_s, open(place / "stuck", "w"))
    told = {"rc": None, "traceback": "", "warnings": []}

    def note(message, category, filename, lineno, file=None, line=None):
        stack = "".join(traceback.format_stack()[-12:-1])
        told["warnings"].append(f"{category.__name__}: {message}\n{stack}")

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for category in _HIDDEN:
            warnings.simplefilter("ignore", category)
        warnings.showwarning = note
        try:
            told["rc"] = _call(case)
        except BaseException:
            told["traceback"] = traceback.format_exc()
    faulthandler.cancel_dump_traceback_later()
    sys.stdout.flush()
    sys.stderr.flush()
    return told


def _expect_progress(limit_s, stuck):
    """End this process, and tell where it was, once it computes for so long on one stage."""
    from bsp_gp import cli

    report = cli._Progress.__call__
    faulthandler.register(signal.SIGXCPU, file=stuck, chain=True)

    def alive():
        used = resource.getrusage(resource.RUSAGE_SELF)
        seconds = int(used.ru_utime + used.ru_stime) + limit_s
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, resource.RLIM_INFINITY))
        faulthandler.dump_traceback_later(PATIENCE * limit_s, exit=True, file=stuck)
        signal.alarm(PATIENCE * limit_s + 10)

    def reported(self, text):
        alive()
        report(self, text)

    cli._Progress.__call__ = reported
    alive()


def _call(case):
    from bsp_gp import cli

    cli._unwarned = lambda quiet: contextlib.nullcontext()  # what --quiet hides is a fault as well
    return cli.main(list(case.argv))
