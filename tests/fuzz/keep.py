"""Keep a case that `run.py` found: in the corpus if it is mended, else among the pending ones.

python tests/fuzz/keep.py runs/fuzz/found/laws-0-3-7.json a_name_for_it "what was found with it"
"""

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.fuzz import trial  # noqa: E402
from tests.fuzz.case import CORPUS, PENDING, Case  # noqa: E402


def main(argv):
    path, name, why = argv
    case = dataclasses.replace(Case.from_json(Path(path).read_text("utf-8")), why=why)
    trial.warm()
    outcome = trial.run(case)
    folder = PENDING if outcome.faults else CORPUS
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.json").write_text(case.to_json(), encoding="utf-8")
    print(f"{folder / name}.json: {', '.join(sorted(outcome.kinds)) or 'no fault'}")


if __name__ == "__main__":
    main(sys.argv[1:])
