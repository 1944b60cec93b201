"""What is told while work goes on: what is done of a stage, and how long the rest may take."""

import sys

import pytest

from bsp_gp import cli_progress
from bsp_gp.cli_progress import Progress, time_left


@pytest.fixture
def clock(monkeypatch):
    """A clock of our own: seconds that a test sets."""
    now = [0.0]
    monkeypatch.setattr(cli_progress.time, "perf_counter", lambda: now[0])
    return now


def test_time_left_follows_from_the_pace_so_far(clock, capsys):
    said = {0.0: "reading", 2.0: "round 1: laws (1 of 4)", 12.0: "round 1: inside (2 of 4)",
            20.0: "fit 1 of 3: c * v_i", 50.0: "fit 2 of 3: c", 80.0: "writing up"}  # fmt: skip
    progress = Progress()
    for moment, text in said.items():
        clock[0] = moment
        progress(text)
    assert capsys.readouterr().err.splitlines() == [
        "    0 s  reading", "    2 s  round 1: laws (1 of 4)",
        "   12 s  round 1: inside (2 of 4) [about 30 s left of these]",
        "   20 s  fit 1 of 3: c * v_i", "   50 s  fit 2 of 3: c [about 60 s left of these]",
        "   80 s  writing up",
    ]  # fmt: skip


def test_a_terminal_has_one_line_with_share_and_time_left(clock, monkeypatch):
    shown = []

    class Bar:
        def __init__(self, **kwargs):
            pass

        def set_description_str(self, text, refresh):
            shown.append(text)

        def close(self):
            shown.append("closed")

    monkeypatch.setattr("tqdm.tqdm", Bar)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "60")
    with Progress() as progress:
        progress("fit 1 of 4: a")
        clock[0] = 40.0
        progress("fit 2 of 4: " + "b" * 100)
    assert shown[0] == "  0 %: fit 1 of 4: a"
    assert shown[1].startswith(" 25 %, about 2 min left: fit 2 of 4: bb") and len(shown[1]) < 60
    assert shown[2] == "closed"


def test_quick_or_quiet_work_says_nothing(clock, capsys):
    Progress()("reading")
    Progress(quiet=True)("fit 1 of 2: a")
    assert capsys.readouterr().err == ""


def test_a_duration_as_people_say_it():
    assert [time_left(s) for s in (42.3, 125, 7300)] == ["42 s", "2 min", "2 h"]
