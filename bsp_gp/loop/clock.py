"""How much time a run has."""

import math
import time


class TimeIsUp(Exception):
    """Raised out of long work that has no result unless it is finished."""


class Clock:
    """A limit of time.

    Parameters
    ----------
    limit : float, optional
        Seconds from now; None = as long as it takes.
    """

    def __init__(self, limit=None):
        self.limit = limit
        self._end = math.inf if limit is None else time.monotonic() + limit

    def __reduce__(self):  # clocks of other machines begin elsewhere
        return Clock, (self.left,)

    @property
    def left(self):
        """Seconds that are left, at least 0; None = no limit."""
        return None if self.limit is None else max(self._end - time.monotonic(), 0.0)

    @property
    def is_over(self):
        """Whether the time is up."""
        return time.monotonic() >= self._end

    def share(self, part):
        """A clock of a part of the time that is left; this one where there is no limit."""
        return self if self.limit is None else Clock(part * self.left)

    def tick(self, *_):
        """Raise `TimeIsUp` if it is."""
        if self.is_over:
            raise TimeIsUp
