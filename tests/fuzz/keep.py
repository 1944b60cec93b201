"""Keep a case that `run.py` found: in the corpus if it is mended, else among the pending ones.

python tests/fuzz/keep.py runs/fuzz/found/laws-0-3-7.json a_name_for_it "what was found with it"
python tests/fuzz/keep.py mended    # move those pending cases that are mended by now
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.fuzz import trial  # noqa: E402
from tests.fuzz.case import CORPUS, PENDING, Case, kept  # noqa: E402


def main(argv):
    trial.warm()
    if argv == ["mended"]:
        for name, case in kept(PENDING).items():
            (PENDING / f"{name}.json").unlink()
            keep(name, case)
    else:
        path, name, why = argv
        keep(name, dataclasses.replace(Case.from_json(Path(path).read_text("utf-8")), why=why))


def keep(name, case):
    """Write a case where it belongs, and say where that is."""
    faults = ", ".join(sorted(trial.run(case).kinds))
    folder = PENDING if faults else CORPUS
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.json").write_text(case.to_json(), encoding="utf-8")
    print(f"{folder.name}/{name}: {faults or 'no fault'}")


if __name__ == "__main__":
    main(sys.argv[1:])
