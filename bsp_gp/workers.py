"""Worker processes: one way to start them, and to be sure that they end with their parent."""

import contextlib
import os
import signal
import sys
import threading

from bsp_gp.errors import ResourceError

__all__ = ["worker_pool"]

_PR_SET_PDEATHSIG = 1


@contextlib.contextmanager
def worker_pool(n_workers, *, own_process=False):
    """An executor of so many processes, for one piece of work.

    The processes are started afresh (no copies of this one), leave Ctrl-C to this process, and end
    with it, however it ends. They are ended at once where the work raises or is interrupted.

    Parameters
    ----------
    n_workers : int
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
