"""What the fuzzer found once stays mended, and the fuzzer itself finds what it looks for."""

import sys

import pytest

from tests.fuzz import trial
from tests.fuzz.case import CORPUS, PENDING, Case, kept
from tests.fuzz.kinds import BATCH, KINDS, batch, schedule
from tests.fuzz.run import table

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="bounds on the memory of a forked child"
)
SLOW = (
    "an_infer_that_took_minutes",
    "a_fit_with_stops_that_takes_minutes",
    "a_friction_that_no_start_fits",
)
SOUND = b"t,x,y\n" + b"".join(b"%.2f,%.3f,1\n" % (k / 20, k * k / 9) for k in range(8))


@pytest.fixture(scope="module", autouse=True)
def warmed():
    trial.warm()


def found():
    """Names of the mended cases, the slow ones marked."""
    marks = {name: [pytest.mark.slow] for name in SLOW}
    return [pytest.param(name, marks=marks.get(name, ())) for name in sorted(kept(CORPUS))]


@pytest.mark.slow
@pytest.mark.parametrize("name", found())
def test_a_found_case_stays_mended(name):
    outcome = trial.run(kept(CORPUS)[name])
    assert not outcome.faults, "\n".join(f"{kind}: {detail}" for kind, detail in outcome.faults)


def test_kept_cases_name_their_class_and_why_they_are_kept():
    for case in (*kept(CORPUS).values(), *kept(PENDING).values()):
        assert case.kind in KINDS and case.why
        assert Case.from_json(case.to_json()) == case


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted(KINDS))
def test_cases_follow_from_the_seed(kind):
    first = batch(kind, 5, 0)
    assert first == batch(kind, 5, 0) != batch(kind, 6, 0)
    assert len(first) == BATCH and len({case.to_json() for case in first}) > BATCH // 2


def test_the_schedule_has_every_class_in_its_share():
    planned = schedule(10_000)
    assert len(planned) * BATCH == 10_000 == len(set(planned)) * BATCH
    for kind, (_, share) in KINDS.items():
        assert sum(k == kind for k, _ in planned) * BATCH == share


# --- what is a fault ------------------------------------------------------------------------------


def tried(body, monkeypatch, argv=("grammar", "show", "newtonian"), limit_s=20):
    monkeypatch.setattr(trial, "_call", body)
    return trial.run(Case("options", argv, {"data.csv": SOUND}), limit_s)


def test_a_traceback_a_warning_and_a_wrong_status_are_faults(monkeypatch):
    import warnings

    def warn(case):
        warnings.warn("odd", RuntimeWarning, stacklevel=1)
        return 0

    assert tried(lambda case: 1 / 0, monkeypatch).kinds == {"traceback"}
    assert tried(warn, monkeypatch).kinds == {"warning"}
    assert tried(lambda case: 1, monkeypatch).kinds == {"status"}
    assert tried(lambda case: 0, monkeypatch).kinds == set()


def test_a_refusal_is_one_line(monkeypatch):
    def say(*lines):
        def refuse(case):
            print(*lines, sep="\n", file=sys.stderr)
            return 2

        return tried(refuse, monkeypatch)

    assert say("bsp-gp: error: no").kinds == set()
    assert say("bsp-gp: error: no", "bsp-gp: error: no").kinds == {"message"}
    assert say("[mp4] odd", "bsp-gp: error: no").kinds == {"message"}
    assert say("bsp-gp: error: " + "a" * 2000).kinds == {"message"}
    assert say("no").kinds == {"message"}


@pytest.mark.slow
def test_a_hang_a_crash_and_too_much_memory_are_faults(monkeypatch):
    import os
    import time

    from bsp_gp import cli

    def compute(case):
        while True:
            pass

    def advance(case):
        with cli._Progress(quiet=True) as progress:
            for _ in range(5):
                began = time.process_time()
                while time.process_time() - began < 0.5:
                    pass
                progress("one more stage")
        return 0

    assert tried(lambda case: time.sleep(30), monkeypatch, limit_s=1).kinds == {"hang"}
    assert tried(compute, monkeypatch, limit_s=1).kinds == {"hang"}
    assert tried(advance, monkeypatch, limit_s=2).kinds == set()
    assert tried(lambda case: os.kill(os.getpid(), 9), monkeypatch).kinds == {"died"}
    assert tried(lambda case: bytearray(8 << 30) and 0, monkeypatch).kinds == {"traceback"}


@pytest.mark.parametrize(
    ("name", "rc", "kinds"),
    [
        ("out", 0, set()),
        ("out", 2, {"partial", "message"}),
        ("data.csv", 0, {"inputs"}),
        (".out-123", 0, {"partial"}),
        (trial.CANARY, 0, {"evaluated"}),
        ("out.json", 0, {"json"}),
    ],
)
def test_what_happens_to_the_folder_is_looked_at(name, rc, kinds, monkeypatch):
    def write(case):
        with open(name, "w", encoding="utf-8") as file:
            file.write("NaN")
        return rc

    assert tried(write, monkeypatch).kinds == kinds


def test_a_sound_case_is_no_fault():
    case = Case("tables", ("grammar", "show", "newtonian", "--data", "data.csv"),
                {"data.csv": SOUND})  # fmt: skip
    outcome = trial.run(case)
    assert (outcome.rc, outcome.faults) == (0, ())


def test_the_table_counts_by_class():
    row = {"kind": "laws", "rc": 2, "faults": ["warning"], "seconds": 1.0}
    text = table([row, {**row, "rc": 0, "faults": []}])
    assert [line.split()[:8] for line in text.splitlines()[1:]] == [
        [name, "2", "1", "1", "0", "1", "0", "0"] for name in ("laws", "all")
    ]
