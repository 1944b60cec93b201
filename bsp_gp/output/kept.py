"""What a long run has found so far, in a file beside the place of its result."""

import contextlib
import json
import os
from pathlib import Path

from bsp_gp.errors import OutputError, SettingsError


class Kept:
    """A file that is there while a run is under way.

    Parameters
    ----------
    target : path
        Of the result.
    key : dict
        What must be the same for another run to go on from it; plain values.
    """

    def __init__(self, target, key):
        target = Path(target)
        self.path = target.with_name(f"{target.name}.rounds.json")
        self.key = json.loads(json.dumps(key))

    def save(self, text):
        """Replace what is kept."""
        part = self.path.with_name(f"{self.path.name}-part")
        try:
            part.parent.mkdir(parents=True, exist_ok=True)
            part.write_text(json.dumps({"key": self.key, "text": text}), encoding="utf-8")
            os.replace(part, self.path)
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror}") from error

    def load(self):
        """What is kept; None where there is nothing.

        Raises
        ------
        SettingsError
            If it is of another run.
        """
        try:
            kept = json.loads(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            kept = None
        if not isinstance(kept, dict) or kept.get("key") != self.key:
            raise SettingsError(
                f"{self.path} is of a run with other data or settings; run without --resume, or "
                "with what that run had"
            )
        return kept["text"]

    def clear(self):
        """Take it away once the result is there."""
        with contextlib.suppress(OSError):
            self.path.unlink()
