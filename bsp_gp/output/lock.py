"""A lock per result, held by one process and gone with it, however it ends."""

import contextlib
import errno
import os

from bsp_gp.errors import OutputError

_BUSY = {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK}
_UNSUPPORTED = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL}
_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
_TRIES = 100


class Lock:
    """A lock that is held; `is_real` is False where the file system knows no locks."""

    def __init__(self, path, handle, is_real):
        self.path = path
        self.is_real = is_real
        self._handle = handle

    def release(self):
        """Give it up and clear its file away, which is done while the lock is still held."""
        with contextlib.suppress(OSError):
            if self.is_real and os.fstat(self._handle).st_size == 0:
                os.unlink(self.path)
        with contextlib.suppress(OSError):
            os.close(self._handle)


def take_lock(path, target):
    """Lock the empty file `path` for as long as this process lives.

    Parameters
    ----------
    path : Path
        Made if it is missing; a process that was killed leaves it behind, unlocked.
    target : Path
        What it guards, for the message.

    Raises
    ------
    OutputError
        If another process holds it.
    """
    for _ in range(_TRIES):
        handle = os.open(path, _FLAGS, 0o666)
        try:
            is_real = _lock_now(handle)
            if is_real is None:
                raise OutputError(
                    f"{target}: another process is writing there; wait for its end or choose "
                    "another --out"
                )
            if _is_still(path, handle):
                return Lock(path, handle, is_real)
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)  # its holder ended and cleared the file away in between
    raise OutputError(f"{target}: other processes write there by turns; choose another --out")


def _lock_now(handle):
    """True: locked; None: another holds it; False: the file system knows no locks."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        call = (msvcrt.locking, handle, msvcrt.LK_NBLCK, 1)
    else:
        call = (fcntl.flock, handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    function, *arguments = call
    try:
        function(*arguments)
    except OSError as error:
        if error.errno in _UNSUPPORTED:
            return False
        if error.errno in _BUSY:
            return None
        raise
    return True


def _is_still(path, handle):
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path, follow_symlinks=False))
    except FileNotFoundError:
        return False
