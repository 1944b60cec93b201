"""The oldest versions that setup.cfg allows, as constraints for pip: `python tests/oldest.py`."""

import configparser
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def constraints(extras=("test",)):
    """Lines ``name==VERSION.*``, one for every requirement with a least version."""
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    texts = [config["options"]["install_requires"]]
    texts += [config["options.extras_require"][extra] for extra in extras]
    found = []
    for line in "\n".join(texts).split("\n"):
        match = re.fullmatch(r"\s*([\w.-]+)\s*>=\s*([\d.]+)\s*", line)
        if match:
            found.append(f"{match[1]}=={match[2]}.*")
    return found


if __name__ == "__main__":
    print("\n".join(constraints(sys.argv[1:] or ("test",))))
