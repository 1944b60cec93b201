"""Programs as apparatus: one experiment as a line of JSON in, one line of what was seen out."""

import json
import shlex
import subprocess
import sys
from dataclasses import dataclass

import numpy as np

from bsp_gp.errors import DataError, SettingsError


@dataclass(frozen=True, eq=False)
class Recording:
    """What was seen of an experiment.

    Attributes
    ----------
    times : ndarray, shape (T,), s
    positions : ndarray, shape (T, N, d), m
        In the order of the bodies; nan = not seen.
    sigma : ndarray, shape (T, N, d), m, or None
    """

    times: np.ndarray
    positions: np.ndarray
    sigma: np.ndarray | None = None


class Refused(DataError):
    """An apparatus does not make an experiment, and says so; others it may make."""


class Command:
    """A program that stays running: ``{"id", "entities", "times"}`` in, ``{"id", "rows"}`` out.

    Parameters
    ----------
    command : str
        As in a shell, without its operators.
    """

    def __init__(self, command):
        try:
            words = shlex.split(command)
        except ValueError as error:
            raise SettingsError(f"--command {command!r} cannot be read: {error}") from error
        if not words:
            raise SettingsError("--command is empty; name a program")
        self.command, self._count = command, 0
        try:
            self.process = subprocess.Popen(
                words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=sys.stderr, text=True,
                encoding="utf-8",
            )  # fmt: skip
        except OSError as error:
            raise SettingsError(f"--command {command!r} cannot be run: {error}") from error

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.process.stdin.close()
        try:
            self.process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()

    def __call__(self, experiment):
        """Run one experiment; `Refused` where the program says what cannot be, DataError else."""
        self._count += 1
        asked = {"id": self._count, **experiment.to_dict()}
        try:
            self.process.stdin.write(json.dumps(asked) + "\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline()
        except (BrokenPipeError, OSError, UnicodeDecodeError) as error:
            raise DataError(f"{self.command}: no answer ({error})") from error
        if not line:
            status = self.process.poll()
            raise DataError(f"{self.command} ended (status {status}) without an answer")
        try:
            answer = json.loads(line)
        except ValueError as error:
            raise DataError(f"{self.command} answered no JSON: {line!r:.80}") from error
        if not isinstance(answer, dict) or answer.get("id") != self._count:
            raise DataError(f"{self.command} must answer the id {self._count}, got {line!r:.80}")
        if "error" in answer:
            raise Refused(f"{self.command}: {answer['error']}")
        return recording_of(answer, experiment)


def recording_of(answer, experiment):
    """A recording of ``rows`` of (entity, t, x, y[, z]) and of ``sigma``, if it is there.

    Parameters
    ----------
    answer : mapping or Recording

    Raises
    ------
    DataError
        If a row is none of the experiment, or there are too few.
    """
    if isinstance(answer, Recording):
        return answer
    names = [b.name for b in experiment.bodies]
    n_axes = len(experiment.bodies[0].position)
    try:
        rows = [(str(r[0]), float(r[1]), [np.nan if x is None else float(x) for x in r[2:]])
                for r in answer["rows"]]  # fmt: skip
        sigma = answer.get("sigma")
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise DataError(f"a recording must have rows of entity, t, x, y, z ({error!r})") from error
    times = np.unique([t for _, t, _ in rows])
    if len(times) < 3:
        raise DataError(f"a recording must have at least 3 times, got {len(times)}")
    positions = np.full((len(times), len(names), n_axes), np.nan)
    for name, t, x in rows:
        if name not in names or len(x) != n_axes:
            raise DataError(f"a row must be of one of {', '.join(names)} with {n_axes} "
                            f"coordinates, got {[name, t, *x]}")  # fmt: skip
        positions[np.searchsorted(times, t), names.index(name)] = x
    for k, body in enumerate(experiment.bodies):  # what does not move need not be told
        if body.is_static and not np.isfinite(positions[:, k]).any():
            positions[:, k] = body.position
    if sigma is None:
        return Recording(times, positions)
    try:
        return Recording(times, positions, np.broadcast_to(np.asarray(sigma, float),
                                                           positions.shape))  # fmt: skip
    except ValueError as error:
        raise DataError(f"sigma must be a number or one per axis, got {sigma!r:.60}") from error
