"""Stages of long work on stderr, with what is done of a stage and the time that it may yet take."""

import re
import shutil
import sys
import time

QUIET_S = 1.0
"""Work that is done within this time shows no progress."""
LEAST_TOLD_S = 3.0
"""Time left that is worth a word."""
_STEP = re.compile(r"(?P<kind>.*?)\b(?P<done>\d+) of (?P<all>\d+)(?P<rest>.*)", re.DOTALL)
_ELAPSED = len(" [00:00:00]")


class Progress:
    """One changing line on a terminal, else a line for each stage.

    Texts such as ``fit 3 of 8: ...`` and ``round 1: laws (2 of 14)`` are counted: it is told how
    much of them is done, and from the pace so far, how long the rest takes.
    """

    def __init__(self, quiet=False):
        self.quiet = quiet
        self.started = time.perf_counter()
        self.held = []
        self.bar = None
        self.counted = None  # kind and length of what is counted, its first number and moment

    def __enter__(self):
        return self

    def __exit__(self, *error):
        if self.bar is not None:
            self.bar.close()

    def __call__(self, text):
        if self.quiet:
            return
        seconds = time.perf_counter() - self.started
        share, left = self._pace(text, seconds)
        if sys.stderr.isatty():
            self._on_terminal(text, share, left)
            return
        told = f" [about {time_left(left)} left of these]" if left >= LEAST_TOLD_S else ""
        self.held.append(f"{seconds:5.0f} s  {text}{told}")
        if seconds > QUIET_S:
            print(*self.held, sep="\n", file=sys.stderr, flush=True)
            self.held.clear()

    def _pace(self, text, seconds):
        """Share that is done of what is counted (nan without), and seconds left (0 unknown)."""
        step = _STEP.fullmatch(text)
        if step is None:
            self.counted = None
            return float("nan"), 0.0
        kind, done, n = step["kind"].split(":")[0], int(step["done"]) - 1, int(step["all"])
        if self.counted is None or self.counted[0] != kind or done < self.counted[1]:
            self.counted = (kind, done, seconds)
        _, first, since = self.counted
        pace = (seconds - since) / (done - first) if done > first else 0.0
        return done / max(n, 1), pace * (n - done)

    def _on_terminal(self, text, share, left):
        if self.bar is None:
            from tqdm import tqdm

            self.bar = tqdm(bar_format="{desc} [{elapsed}]", leave=False, file=sys.stderr)
        told = [f"{100 * share:3.0f} %"] if share == share else []
        told += [f"about {time_left(left)} left"] if left >= LEAST_TOLD_S else []
        line = f"{', '.join(told)}: {text}" if told else text
        room = max(shutil.get_terminal_size((100, 24)).columns - _ELAPSED, 20)
        self.bar.set_description_str(line[:room], refresh=True)


def time_left(seconds):
    """A duration as people say it.

    Examples
    --------
    >>> time_left(42.3), time_left(125), time_left(7300)
    ('42 s', '2 min', '2 h')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.0f} h"
