"""Threads of the linear algebra beneath NumPy and SciPy: small matrices want one."""

from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries():
    """What is loaded; looking for it takes milliseconds, and fits are many."""
    return ThreadpoolController()


def one_thread():
    """A context in which BLAS uses one thread: sums are then the same on every machine."""
    return _libraries().limit(limits=1, user_api="blas")
