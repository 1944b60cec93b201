"""Worker processes: one way to start them, to hand work out, and to end with their parent."""

import contextlib
import itertools
import math
import os
import signal
import sys
import threading
import time
from pathlib import Path

from bsp_gp.errors import ResourceError, SettingsError

WORTH_S = 3.0
"""Seconds that parts have taken here before others are handed out: starting a process costs one."""
MOST_KNOWN = 2
"""Shared values that a worker keeps."""
_PR_SET_PDEATHSIG = 1
_NUMBERS = itertools.count()
_KNOWN: dict = {}
"""Shared values of this process, if it is a worker."""
_NOT_KNOWN = "this worker does not have the shared value"


class Crew:
    """Hands for work whose parts do not hang on each other: this process, and those it is given.

    A part is done by whoever is free, this process among them; what it gives does not depend on
    whom. Nothing is handed out to new processes before parts have shown that they take long.

    Parameters
    ----------
    workers : concurrent.futures.Executor or distributed.Client, optional
        None: everything is done here.

    Attributes
    ----------
    n_elsewhere : int
        Parts that are under way elsewhere at the most.
    """

    def __init__(self, workers=None):
        self.client = workers if hasattr(workers, "scatter") else None
        self.executor, self.n_elsewhere, self.spent = workers, 0, 0.0
        if self.client is not None:
            self.executor = self.client.get_executor(pure=False)
            self.n_elsewhere, self.spent = sum(self.client.nthreads().values()), math.inf
        elif workers is not None:
            self.n_elsewhere = getattr(workers, "_max_workers", 2) - 1

    def share(self, value):
        """Something that many parts need, as `work` takes it: sent to a worker once."""
        if self.client is not None:
            return self.client.scatter(value, broadcast=True, hash=False)
        return _Shared((os.getpid(), next(_NUMBERS)), value, self.n_elsewhere)

    def work(self, call, value, jobs, is_wanted=None):
        """Parts ``call(value, job)``, to be asked for in the order of the jobs.

        Parameters
        ----------
        call : callable
            A function of a module, and a pure one.
        jobs : list
            May grow.
        is_wanted : callable, optional
            ``is_wanted(job)``: whether it is likely to be asked for, else it is not begun early.
        """
        return Work(self, call, value, jobs, is_wanted or (lambda job: True))

    def map(self, call, value, jobs):
        """What all parts give, in order."""
        work = self.work(call, value, list(jobs))
        return [work.result(k, meanwhile=True) for k in range(len(work.jobs))]

    def each(self, call, value, jobs):
        """Parts as they are done: ``(number, what it gives)``, in whatever order.

        Jobs are taken from the iterable as hands are free, so that few are there at a time; this
        process does none where there are others.
        """
        if self.executor is None:
            yield from ((k, call(value, job)) for k, job in enumerate(jobs))
            return
        from concurrent.futures import FIRST_COMPLETED, wait

        self.spent = math.inf
        work, todo, most = self.work(call, value, {}), enumerate(jobs), 2 * self.n_elsewhere + 2
        for k, job in itertools.chain(todo, [(None, None)]):
            if k is not None:
                work.jobs[k] = job
                work.submit(k)
            while work.futures and (k is None or len(work.futures) >= most):
                done = wait(work.futures.values(), return_when=FIRST_COMPLETED).done
                for number in [n for n, future in work.futures.items() if future in done]:
                    yield number, work.received(number)
                    del work.jobs[number]


class Work:
    """See `Crew.work`."""

    def __init__(self, crew, call, value, jobs, is_wanted):
        self.crew, self.call, self.value = crew, call, value
        self.jobs, self.is_wanted = jobs, is_wanted
        self._shared, self.futures, self._done = None, {}, {}

    def result(self, k, meanwhile=False):
        """What a part gives, done here unless it is under way.

        With `meanwhile` other parts are done here while it is waited for.
        """
        self._hand_out(k + 1)
        if k not in self.futures and k not in self._done:
            self._do(k)
        while meanwhile and k not in self._done and not self.futures[k].done():
            others = (j for j in range(k + 1, len(self.jobs)) if self._is_open(j))
            other = next(others, None)
            if other is None:
                break
            self._do(other)
            self._hand_out(k + 1)
        if k not in self._done:
            self._done[k] = self.received(k)
            self._hand_out(k + 1)
        return self._done.pop(k)

    def _is_open(self, k):
        return k not in self.futures and k not in self._done

    def _do(self, k):
        began = time.monotonic()
        self._done[k] = self.call(self.value, self.jobs[k])
        self.crew.spent += time.monotonic() - began

    def _hand_out(self, first):
        """Have parts from this number on begun elsewhere."""
        if not self.crew.n_elsewhere or self.crew.spent < WORTH_S:
            return
        free = self.crew.n_elsewhere - sum(not f.done() for f in self.futures.values())
        for k in range(first, len(self.jobs)):
            if free <= 0:
                break
            if self._is_open(k) and self.is_wanted(self.jobs[k]):
                self.submit(k)
                free -= 1

    def submit(self, k, again=False):
        """Have a part begun elsewhere."""
        if self._shared is None:
            self._shared = self.crew.share(self.value)
        shared = self._shared
        if isinstance(shared, _Shared):
            shared = shared.to_send(again)
        self.futures[k] = self.crew.executor.submit(_part, self.call, shared, self.jobs[k])

    def received(self, k):
        """What a part gave that was begun elsewhere."""
        found = self.futures[k].result()
        while isinstance(found, str) and found == _NOT_KNOWN:
            self.submit(k, again=True)
            found = self.futures[k].result()
        del self.futures[k]
        return found


class _Shared:
    """A value and its name; the first that are sent have it with them."""

    def __init__(self, token, value, n_first):
        self.token, self.value, self._left = token, value, n_first

    def to_send(self, again):
        self._left -= 1
        is_first = again or self._left >= 0
        return _Sent(self.token, self.value, True) if is_first else _Sent(self.token, None, False)


class _Sent:
    def __init__(self, token, value, has_value):
        self.token, self.value, self.has_value = token, value, has_value


def _part(call, shared, job):
    """A part, at a worker."""
    if isinstance(shared, _Sent):
        if shared.has_value:
            while len(_KNOWN) >= MOST_KNOWN:
                del _KNOWN[next(iter(_KNOWN))]
            _KNOWN[shared.token] = shared.value
        elif shared.token not in _KNOWN:
            return _NOT_KNOWN
        shared = _KNOWN[shared.token]
    return call(shared, job)


@contextlib.contextmanager
def hands(n_workers=1, cluster=None):
    """What work is handed to: processes of this machine, or those of a Dask cluster.

    Parameters
    ----------
    cluster : str, optional
        Address of a scheduler, ``tcp://HOST:PORT``.

    Yields
    ------
    ProcessPoolExecutor, distributed.Client or None

    Raises
    ------
    SettingsError
        If no scheduler answers, or dask is not installed.
    ResourceError
        If the scheduler or all workers went away.
    """
    if cluster is None:
        with worker_pool(n_workers) as pool:
            yield pool
        return
    try:
        from distributed import Client
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker
    except ImportError:
        raise SettingsError(
            "--cluster needs dask: pip install 'bsp_gp[cluster]', here and on the workers"
        ) from None
    try:
        client = Client(cluster, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SettingsError(
            f"--cluster {cluster}: no scheduler answers there ({error or type(error).__name__})"
        ) from None
    try:
        with client:
            yield client
    except (FutureCancelledError, KilledWorker, OSError) as error:
        if client.status == "running" and isinstance(error, OSError):
            raise
        raise ResourceError(
            f"the cluster at {cluster} went away ({type(error).__name__}); start it again and use "
            "--resume"
        ) from error


@contextlib.contextmanager
def worker_pool(n_workers, *, own_process=False):
    """An executor of so many processes, for one piece of work.

    The processes are started afresh (no copies of this one), leave Ctrl-C to this process, and end
    with it, however it ends. They are ended at once where the work raises or is interrupted.

    Parameters
    ----------
    own_process : bool
        A process even where one is enough; by default one worker is this process itself.

    Yields
    ------
    ProcessPoolExecutor or None
        None: do it here.

    Raises
    ------
    ResourceError
        If a process ended before its work did, most often for want of memory.
    """
    if n_workers == 1 and not own_process:
        yield None
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool

    before = set(multiprocessing.active_children())
    # The system's signal at the parent's death is one at the death of the thread that started us.
    by_system = threading.current_thread() is threading.main_thread()
    pool = ProcessPoolExecutor(
        n_workers, mp_context=multiprocessing.get_context("spawn"), initializer=_begin,
        initargs=(os.getpid(), by_system),
    )  # fmt: skip
    try:
        yield pool
    except BaseException as error:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        if isinstance(error, BrokenProcessPool):
            raise ResourceError(
                f"one of {n_workers} worker processes ended before its work was done, most often "
                f"for want of memory; use fewer workers, fewer scenes or fewer levels"
            ) from error
        raise
    pool.shutdown()


def python_path():
    """Where a process looks for packages, first of all where this one is."""
    here = str(Path(__file__).resolve().parent.parent)
    return os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))


def _begin(parent, by_system):
    """Set up a worker process: deaf to Ctrl-C, and gone soon after its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if by_system and sys.platform == "linux":
        _ask_for_signal()
    threading.Thread(target=_end_with_parent, args=(parent,), daemon=True).start()


def _ask_for_signal():
    """Have the system end this process when the parent dies; at once, even amid compiled code."""
    import ctypes

    with contextlib.suppress(OSError, AttributeError):  # a C library without prctl
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)


def _end_with_parent(parent):
    """Wait for the parent's end, on any system; also where it came before the signal was asked."""
    from multiprocessing import parent_process
    from multiprocessing.connection import wait

    if os.name != "posix" or os.getppid() == parent:
        wait([parent_process().sentinel])
    os._exit(1)
