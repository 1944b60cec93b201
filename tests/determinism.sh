#!/usr/bin/env bash
# The same seed gives the same report: two processes of different PYTHONHASHSEED and different
# numbers of workers, report.json compared apart from times. Exit status 1 on any difference.
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python}
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT

"$python" -c '
import sys
from tests.throws import throws_folder
throws_folder(sys.argv[1], n_scenes=6, n_times=40, sigma=0.01)
' "$place/throws"

close() {  # NAME HASHSEED WORKERS
    PYTHONHASHSEED=$2 "$python" -m bsp_gp close "$place/throws" --quiet \
        --declare '9.81 [m/s^2] * m_i * down' --seed 3 --workers "$3" --out "$place/$1" >/dev/null
}

close first 0 1
close second 1 2
close third 2 3

"$python" - "$place" first second third <<'PYTHON'
import json
import sys
from pathlib import Path

TIMES = {"wall_s", "seconds"}


def differences(a, b, where="report"):
    if isinstance(a, dict) and isinstance(b, dict) and list(a) == list(b):
        for key in a:
            if key not in TIMES:
                yield from differences(a[key], b[key], f"{where}.{key}")
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for k, pair in enumerate(zip(a, b)):
            yield from differences(*pair, f"{where}[{k}]")
    elif a != b or type(a) is not type(b):
        yield f"{where}: {a!r:.100} is not {b!r:.100}"


folder, first, *others = sys.argv[1:]
reports = {n: json.loads((Path(folder) / n / "report.json").read_text("utf-8"))
           for n in (first, *others)}
assert reports[first]["rounds"] and reports[first]["verdict"], "nothing was done"
found = [f"{name}: {line}" for name in others
         for line in differences(reports[first], reports[name])]
for name in (first, *others):
    if len(list((Path(folder) / name).rglob("*.svg"))) == 0:
        found.append(f"{name}: no figure")
for name in others:
    for file in ("law.txt", "law.tex", "residuals.csv"):
        if (Path(folder) / first / file).read_bytes() != (Path(folder) / name / file).read_bytes():
            found.append(f"{name}: {file} differs")
print(*found, sep="\n", file=sys.stderr, end="\n" if found else "")
verdict = reports[first]["verdict"]
print(f"determinism: {len(others) + 1} reports ({verdict}), {len(found)} differences")
sys.exit(bool(found))
PYTHON
