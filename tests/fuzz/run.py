"""Try hostile inputs by the thousand, and count by class what became of them.

python tests/fuzz/run.py --tries 10000 --seed 0 --workers 2 --out runs/fuzz
python tests/fuzz/run.py --minutes 5

Every case is a function of the seed, its class and its number. A run that is broken off goes on
where it was; the table is made anew from the log. Cases with a fault are kept in OUT/found, to be
moved to tests/fuzz/corpus once they are mended.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from tests.fuzz import trial  # noqa: E402
from tests.fuzz.kinds import KINDS, batch, schedule  # noqa: E402

FAULTS = ("traceback", "warning", "hang", "partial", "died", "message", "status", "inputs",
          "evaluated", "json")  # fmt: skip
PLURAL = {"traceback": "tracebacks", "warning": "warnings", "hang": "hangs", "died": "crashes"}


def main(argv=None):
    args = _arguments(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    log = args.out / "tries.jsonl"
    done = {(row["kind"], row["batch"]) for row in _rows(log, args.seed)}
    trial.warm()
    ends = None if args.minutes is None else time.monotonic() + 60 * args.minutes
    for kind, number in schedule(args.tries):
        if (kind, number) in done or (args.only and kind not in args.only):
            continue
        if ends is not None and time.monotonic() > ends:
            break
        outcomes = _tried(batch(kind, args.seed, number), args.workers)
        rows = [
            _row(case, outcome, kind, number, k, args)
            for k, (case, outcome) in enumerate(outcomes)
        ]
        with log.open("a", encoding="utf-8") as file:  # a batch at a time: all of it or nothing
            file.write("".join(f"{json.dumps(row)}\n" for row in rows))
    text = table(_rows(log, args.seed))
    (args.out / "table.txt").write_text(f"{text}\n", encoding="utf-8")
    print(text)
    return int(any(row["faults"] for row in _rows(log, args.seed)))


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tries", type=int, default=10_000)
    parser.add_argument("--minutes", type=float, help="stop after so long")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=tuple(KINDS), help="these classes only")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "fuzz")
    return parser.parse_args(argv)


def _tried(cases, n_workers):
    """(case, outcome) of every case in order, so many children at a time."""
    waiting, running, ended = list(enumerate(cases)), {}, {}
    while waiting or running:
        while waiting and len(running) < n_workers:
            k, case = waiting.pop(0)
            child = trial.start(case)
            running[child.pid] = k, child
        pid, status = os.wait()
        if pid in running:
            k, child = running.pop(pid)
            ended[k] = child.case, trial.finish(child, status)
    return [ended[k] for k in range(len(cases))]


def _row(case, outcome, kind, number, k, args):
    if outcome.faults:
        folder = args.out / "found"
        folder.mkdir(exist_ok=True)
        name = f"{kind}-{args.seed}-{number}-{k}"
        (folder / f"{name}.json").write_text(case.to_json(), encoding="utf-8")
        details = "\n\n".join(f"{fault}: {detail}" for fault, detail in outcome.faults)
        (folder / f"{name}.txt").write_text(f"{case.argv}\n\n{details}\n", encoding="utf-8")
    return {
        "kind": kind, "seed": args.seed, "batch": number, "try": k, "rc": outcome.rc,
        "faults": sorted(outcome.kinds), "seconds": round(outcome.seconds, 3),
        "message": outcome.message if outcome.rc == 2 else "",
    }  # fmt: skip


def _rows(log, seed):
    if not log.exists():
        return []
    rows = [json.loads(line) for line in log.read_text("utf-8").splitlines()]
    return [row for row in rows if row["seed"] == seed]


def table(rows):
    """The counts by class as text."""
    shown = FAULTS[:4] + tuple(f for f in FAULTS[4:] if any(f in row["faults"] for row in rows))
    heads = ["class", "tries", "ok", "refused", *(PLURAL.get(f, f) for f in shown), "slowest"]
    lines = [heads]
    for kind in (*KINDS, "all"):
        own = [row for row in rows if kind in ("all", row["kind"])]
        if own:
            counts = [sum(f in row["faults"] for row in own) for f in shown]
            status = [sum(row["rc"] == rc for row in own) for rc in (0, 2)]
            slowest = max(row["seconds"] for row in own)
            lines.append([kind, len(own), *status, *counts, f"{slowest:.1f} s"])
    widths = [max(len(str(line[k])) for line in lines) for k in range(len(heads))]
    return "\n".join(
        "  ".join(f"{cell!s:{'<' if k == 0 else '>'}{widths[k]}}" for k, cell in enumerate(line))
        for line in lines
    )


if __name__ == "__main__":
    sys.exit(main())
