"""Commands of bsp-gp that the page runs: each a process of its own, a few at a time."""

import asyncio
import contextlib
import os
import re
import secrets
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from bsp_gp.workers import python_path

_STAGE = re.compile(r"\s*\d+ s  (.*)")
_KEPT_LINES = 200
MEMORY_SHARE = 0.75
"""Of the machine's memory that one command may take."""


@dataclass
class Job:
    """One command.

    Attributes
    ----------
    state : str
        "waiting", "running", "done", "failed" or "stopped".
    told : str
        What it printed, at the end.
    stages : list of str
        What it said it was doing.
    """

    key: str
    argv: tuple[str, ...]
    folder: Path
    state: str = "waiting"
    told: str = ""
    stages: list = field(default_factory=list)
    started: float = 0.0
    seconds: float = 0.0
    process: asyncio.subprocess.Process | None = None
    ended: asyncio.Event = field(default_factory=asyncio.Event)

    def to_dict(self):
        """What the page shows."""
        is_running = self.state == "running"
        return {
            "key": self.key, "state": self.state, "told": self.told,
            "stage": self.stages[-1] if self.stages else "", "n_stages": len(self.stages),
            "seconds": time.monotonic() - self.started if is_running else self.seconds,
        }  # fmt: skip


class Jobs:
    """Commands in the order in which they were asked for, a few at a time.

    Parameters
    ----------
    folder : path-like
        Where they run and leave their results; holds nothing that was dropped.
    n_at_once : int
    """

    def __init__(self, folder, n_at_once):
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.jobs = {}
        self.free = asyncio.Semaphore(n_at_once)
        self.tasks = set()

    def start(self, words, data, out=None):
        """Queue ``bsp-gp WORDS DATA``.

        WORDS are the command and its options; `out` is where the result goes, by default the folder
        ``report`` of the job.
        """
        key = secrets.token_hex(8)
        folder = self.folder / key
        folder.mkdir()
        argv = (*words, "--out", str(out or folder / "report"), "--", str(data))
        job = self.jobs[key] = Job(key, argv, folder)
        task = asyncio.get_running_loop().create_task(self._run(job))
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)
        return job

    async def _run(self, job):
        async with self.free:
            if job.state == "stopped":
                job.ended.set()
                return
            job.state, job.started = "running", time.monotonic()
            try:
                code, out, err = await run(job.argv, job.folder, job.stages, job)
            except OSError as error:
                code, out, err = 1, "", f"the command could not be started: {error}"
            job.seconds = time.monotonic() - job.started
            if job.state == "running":
                job.state = "done" if code == 0 else "failed"
            job.told = without_paths(out if code == 0 else err, self.folder.parent)
            job.process = None
            job.ended.set()

    def stop(self, job):
        """End a command as Ctrl-C would; what it wrote whole stays."""
        if job.state in ("waiting", "running"):
            job.state = "stopped"
            _interrupt(job.process)

    async def close(self):
        """End all of them and wait."""
        for job in self.jobs.values():
            self.stop(job)
        if self.tasks:
            _, late = await asyncio.wait(self.tasks, timeout=10)
            for job in self.jobs.values():
                if late and job.process is not None:
                    with contextlib.suppress(ProcessLookupError):
                        job.process.kill()


async def run(argv, folder, stages=None, job=None, time_limit=None, module="bsp_gp"):
    """Run ``bsp-gp ARGV`` in a folder; nothing that lies in the folder is imported (``-P``).

    Returns
    -------
    code : int
    out, err : str
        What was printed, and the complaint if there was one.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-P", "-m", module, *argv, cwd=folder, env=_environment(),
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE, start_new_session=True, limit=2**20,
    )  # fmt: skip
    _limit_memory(process.pid)
    if job is not None:
        job.process = process
    complaints = []
    try:
        out, _ = await asyncio.wait_for(
            asyncio.gather(process.stdout.read(), _listen(process.stderr, stages, complaints)),
            time_limit,
        )
        code = await process.wait()
    except (TimeoutError, asyncio.CancelledError) as stop:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        if isinstance(stop, asyncio.CancelledError):
            raise
        return 1, "", f"this takes longer than {time_limit:g} s; give the file in a terminal"
    said = [line for line in complaints if line.startswith("bsp-gp:")]
    if code and not said:
        said = ["the command ended without a word: there may be too little memory for this"]
    text = "\n".join(said).replace("bsp-gp: error: ", "").replace("bsp-gp: ", "")
    return code, out.decode("utf-8", "replace"), text


async def _listen(stream, stages, complaints):
    """Sort the lines of stderr: stages of the work, and the rest."""
    async for raw in stream:
        line = raw.decode("utf-8", "replace").rstrip()
        if match := _STAGE.fullmatch(line):
            if stages is not None:
                stages.append(match[1])
                del stages[:-_KEPT_LINES]
        else:
            complaints.append(line)
            del complaints[:-_KEPT_LINES]


def without_paths(text, folder):
    """A text without the private folder and the keys in it, which mean nothing to a reader."""
    folder = re.escape(str(folder))
    return re.sub(rf"{folder}/(?:(?:data|runs)/[0-9a-f]{{16}}/)?(?:files/)?", "", text)


def _environment():
    return {
        **os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1",
        "MPLBACKEND": "Agg", "PYTHONIOENCODING": "utf-8", "PYTHONUNBUFFERED": "1",
        "PYTHONPATH": python_path(),
    }  # fmt: skip


def _limit_memory(pid):
    """Bound what a command may take, where the system can (Linux)."""
    with contextlib.suppress(ImportError, AttributeError, ProcessLookupError):
        import resource

        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        resource.prlimit(pid, resource.RLIMIT_AS, (int(MEMORY_SHARE * total),) * 2)


def _interrupt(process):
    if process is not None and process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)
