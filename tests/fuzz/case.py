"""One try of the fuzzer: files and a command line, and how they are kept as JSON."""

import base64
import json
import zlib
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent
CORPUS = HERE / "corpus"
"""Found cases that are mended; `make test` replays them."""
PENDING = HERE / "pending"
"""Found cases that are not mended yet; a replay only says what became of them."""
LONG = 2000
"""Bytes of a file that is kept compressed."""


@dataclass(frozen=True)
class Case:
    """Files in an empty folder, and the command that is run there.

    Attributes
    ----------
    kind : str
        Class of the try, a key of `tests.fuzz.kinds.KINDS`.
    argv : tuple of str
        Arguments of ``bsp-gp``; paths are relative to the folder.
    files : dict of str to bytes
    why : str
        What was found with it.
    """

    kind: str
    argv: tuple
    files: dict = field(default_factory=dict)
    why: str = ""

    def to_json(self):
        files = {name: _packed(content) for name, content in self.files.items()}
        content = {"kind": self.kind, "why": self.why, "argv": list(self.argv), "files": files}
        return json.dumps(content, indent=1) + "\n"

    @classmethod
    def from_json(cls, text):
        content = json.loads(text)
        files = {name: _unpacked(packed) for name, packed in content["files"].items()}
        return cls(content["kind"], tuple(content["argv"]), files, content["why"])

    def write(self, folder):
        """Write the files into a folder."""
        for name, content in self.files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


def _packed(content):
    if len(content) > LONG:
        return {"zlib": base64.b64encode(zlib.compress(content, 9)).decode("ascii")}
    try:
        return {"text": content.decode("utf-8")}
    except UnicodeDecodeError:
        return {"base64": base64.b64encode(content).decode("ascii")}


def _unpacked(packed):
    if "text" in packed:
        return packed["text"].encode("utf-8")
    if "zlib" in packed:
        return zlib.decompress(base64.b64decode(packed["zlib"]))
    return base64.b64decode(packed["base64"])


def kept(folder):
    """Cases kept in a folder, by name."""
    return {path.stem: Case.from_json(path.read_text("utf-8")) for path in folder.glob("*.json")}
