"""Worker processes: one way to start them, to hand work out, and to end with their parent."""

import contextlib
import itertools
import os
import signal
import sys
import tempfile
import threading
import weakref
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import NamedTuple

from bsp_gp.errors import ResourceError, SettingsError

MOST_KNOWN = 2
"""Shared values that a worker keeps."""
_PR_SET_PDEATHSIG = 1
_PATIENCE = 5.0  # seconds that a pool has to put itself away
_NUMBERS = itertools.count()
_KNOWN: dict = {}
"""Shared values of this process, if it is a worker."""


class Crew:
    """Hands for work whose parts do not hang on each other: those it is given, and this process.

    What a part gives does not depend on whose hands it was in. Processes begin at once, one after
    the other, and load what they need while work is done here; where none is free, this process
    does what is asked for.

    Parameters
    ----------
    workers : concurrent.futures.Executor or distributed.Client, optional
        None: everything is done here.
    needs : callable, optional
        A function whose module, with all that it imports, parts will need.

    Attributes
    ----------
    n_elsewhere : int
        Parts that are under way elsewhere at the most.
    has_others : bool
        Whether any of those it is given have begun.
    """

    def __init__(self, workers=None, needs=None):
        self.client = workers if hasattr(workers, "scatter") else None
        self.executor, self.n_elsewhere, self.has_others = workers, 0, False
        if self.client is not None:
            self.executor = self.client.get_executor(pure=False)
            self.n_elsewhere = sum(self.client.nthreads().values())
        elif workers is not None:
            self.n_elsewhere = getattr(workers, "_max_workers", 1)
        self._wake(self.n_elsewhere, needs)

    def _wake(self, n_more, needs):
        def goes_on(_):
            self.has_others = True
            self._wake(n_more - 1, needs)

        if n_more > 0:
            with contextlib.suppress(RuntimeError):  # of a pool that was ended meanwhile
                self.executor.submit(_loaded, needs).add_done_callback(goes_on)

    def share(self, value):
        """Something that many parts need, as `work` takes it: sent to a worker once."""
        if self.client is not None:
            return self.client.scatter(value, broadcast=True, hash=False)
        from concurrent.futures import ProcessPoolExecutor

        return _Shared(value, isinstance(self.executor, ProcessPoolExecutor))

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
        return [work.result(k) for k in range(len(work.jobs))]

    def each(self, call, value, jobs):
        """Parts as they are done: ``(number, what it gives)``, in whatever order.

        Jobs are taken from the iterable as hands are free, so that few are there at a time; this
        process does none where there are others.
        """
        if self.executor is None:
            yield from ((k, call(value, job)) for k, job in enumerate(jobs))
            return
        from concurrent.futures import FIRST_COMPLETED, wait

        work, todo, most = self.work(call, value, {}), enumerate(jobs), 2 * self.n_elsewhere + 2
        for k, job in itertools.chain(todo, [(None, None)]):
            if k is not None:
                work.jobs[k] = job
                work.submit(k)
            while work.futures and (k is None or len(work.futures) >= most):
                done = wait(work.futures.values(), return_when=FIRST_COMPLETED).done
                for number in [n for n, future in work.futures.items() if future in done]:
                    yield number, work.futures.pop(number).result()
                    del work.jobs[number]


class Work:
    """See `Crew.work`."""

    def __init__(self, crew, call, value, jobs, is_wanted):
        self.crew, self.call, self.value = crew, call, value
        self.jobs, self.is_wanted = jobs, is_wanted
        self.futures, self._shared, self._first, self._is_ended = {}, None, 0, False
        self._lock, self._most = threading.RLock(), 0

    def begin(self):
        """Have the first parts begun elsewhere, since something else will be done here."""
        self._most = max(self.crew.n_elsewhere - 1, 1)
        self._hand_out(self._first)

    def result(self, k):
        """What a part gives, done here if nobody else is free for it."""
        self._most = self.crew.n_elsewhere
        self._hand_out(k)
        with self._lock:
            future = self.futures.pop(k, None)
            self._first = k + 1
        if future is None:
            return self.call(self.value, self.jobs[k])
        return future.result()

    def end(self):
        """Begin no further parts elsewhere: no more are asked for."""
        with self._lock:
            self._is_ended = True

    def _hand_out(self, first):
        """Have parts from this number on begun elsewhere."""
        if not self.crew.has_others:
            return
        with self._lock:
            self._first = first
            free = self._most - sum(not f.done() for f in self.futures.values())
            for k in range(first, 0 if self._is_ended else len(self.jobs)):
                if free <= 0:
                    break
                if k not in self.futures and (k == first or self.is_wanted(self.jobs[k])):
                    self.submit(k).add_done_callback(self._go_on)
                    free -= 1

    def _go_on(self, _):
        """Give who has done a part the next at once, whatever is done here meanwhile."""
        with contextlib.suppress(RuntimeError):  # of a pool that broke or was ended meanwhile
            self._hand_out(self._first)

    def submit(self, k):
        """Have a part begun elsewhere."""
        if self._shared is None:
            self._shared = self.crew.share(self.value)
        shared = self._shared.sent if isinstance(self._shared, _Shared) else self._shared
        self.futures[k] = self.crew.executor.submit(_part, self.call, shared, self.jobs[k])
        return self.futures[k]


class _Shared:
    """A value as it is now: what is done here meanwhile changes what lazy values remember.

    With `in_file` others read it from a file, as processes of this machine can; else it goes along
    with every part.
    """

    def __init__(self, value, in_file):
        data, path = bytes(ForkingPickler.dumps(value)), None
        if in_file:
            handle, path = tempfile.mkstemp(prefix="bsp_gp-")
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            weakref.finalize(self, _removed, path)
        self.sent = _Sent((os.getpid(), next(_NUMBERS)), path, b"" if in_file else data)


class _Sent(NamedTuple):
    """The name of a shared value, and where it is, or itself."""

    token: tuple
    path: str | None
    data: bytes

    def value(self):
        """The value; it is read once."""
        if self.token not in _KNOWN:
            while len(_KNOWN) >= MOST_KNOWN:
                _KNOWN.pop(next(iter(_KNOWN)), None)
            _KNOWN[self.token] = ForkingPickler.loads(
                Path(self.path).read_bytes() if self.path else self.data
            )
        return _KNOWN[self.token]


def _removed(path):
    with contextlib.suppress(OSError):
        os.remove(path)


def _loaded(call):
    """Nothing; what the function needs was loaded where it came to."""


def _part(call, shared, job):
    """A part, at a worker."""
    return call(shared.value() if isinstance(shared, _Sent) else shared, job)


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
    with it, however it ends. They are ended at once where the work is done, raises or is
    interrupted, whatever they are at.

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

    before, threads = set(multiprocessing.active_children()), set(threading.enumerate())
    # The system's signal at the parent's death is one at the death of the thread that started us.
    by_system = threading.current_thread() is threading.main_thread()
    pool = ProcessPoolExecutor(
        n_workers, mp_context=multiprocessing.get_context("spawn"), initializer=_begin,
        initargs=(os.getpid(), by_system),
    )  # fmt: skip
    try:
        yield pool
    except BrokenProcessPool as error:
        raise ResourceError(
            f"one of {n_workers} worker processes ended before its work was done, most often "
            f"for want of memory; use fewer workers, fewer scenes or fewer levels"
        ) from error
    finally:  # what is still under way nobody has asked for
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        # The interpreter's end would wake the pool's thread while that one closes its pipe.
        for thread in set(threading.enumerate()) - threads:
            if not thread.daemon:
                thread.join(_PATIENCE)


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
