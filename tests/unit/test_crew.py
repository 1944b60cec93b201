"""Work that is handed out gives what it gives here, in the same order, and is sent once."""

import gc
import os
import pickle
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from bsp_gp import workers
from bsp_gp.loop.close import close_loop
from bsp_gp.workers import Crew, worker_pool
from tests.throws import GRAVITY, throws

SENT = []


class Counted:
    """A value that knows how often it was sent."""

    def __init__(self, number):
        self.number = number

    def __reduce__(self):
        SENT.append(self.number)
        return Counted, (self.number,)


def times(value, job):
    return value.number * job


def what(value, job):
    return value["a"]


def failing(value, job):
    if job == 3:
        raise ArithmeticError("three")
    return job


def crew_of(executor):
    """A crew of which some have begun."""
    crew = Crew(executor)
    while not crew.has_others:
        time.sleep(0.01)
    return crew


def number_of(value, job):
    time.sleep(0.05)
    return os.getpid()


@pytest.fixture(scope="module")
def pool():
    with worker_pool(3) as pool:
        yield pool


@pytest.mark.slow
def test_a_map_is_the_same_wherever_it_is_done(pool):
    expected = [7 * k for k in range(40)]
    SENT.clear()
    assert Crew().map(times, Counted(7), range(40)) == expected
    assert not SENT
    assert crew_of(pool).map(times, Counted(7), range(40)) == expected
    assert len(SENT) == 1  # and not with every part
    with ThreadPoolExecutor(2) as threads:
        assert crew_of(threads).map(times, Counted(7), range(40)) == expected


def test_nothing_waits_for_processes_that_have_not_begun():
    with worker_pool(2) as pool:
        assert Crew(pool).map(times, Counted(1), range(5)) == list(range(5))


def test_others_go_on_while_something_else_is_done_here(pool):
    work = crew_of(pool).work(number_of, None, list(range(9)))
    work.begin()
    deadline = time.monotonic() + 60
    while len(work.futures) < 9 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert os.getpid() not in {work.result(k) for k in range(9)}


def test_what_nobody_has_asked_for_is_not_begun_any_more(pool):
    work = crew_of(pool).work(number_of, None, list(range(50)))
    work.result(0)
    work.end()
    known = len(work.futures)
    time.sleep(0.3)
    assert len(work.futures) == known < 20


def test_a_value_is_sent_as_it_was_when_it_was_shared(pool):
    value = {"a": 1}
    work = crew_of(pool).work(what, value, [0, 1, 2])
    work.begin()
    value["a"] = 2
    assert work.result(0) == 1


def test_files_of_shared_values_are_removed(pool, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    work = crew_of(pool).work(times, Counted(2), [1, 2])
    assert [work.result(0), work.result(1)] == [2, 4]
    assert len(list(tmp_path.iterdir())) == 1
    del work
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_work_is_asked_for_in_order_and_may_grow(pool):
    jobs = [1, 2]
    work = crew_of(pool).work(times, Counted(5), jobs, is_wanted=lambda job: job != 2)
    assert work.result(0) == 5
    jobs.append(3)
    assert [work.result(1), work.result(2)] == [10, 15]


@pytest.mark.parametrize("others", [False, True])
def test_each_part_comes_once(pool, others):
    found = dict(Crew(pool if others else None).each(times, Counted(2), iter(range(9))))
    assert found == {k: 2 * k for k in range(9)}


def test_an_error_comes_out_where_its_part_is_asked_for(pool):
    with pytest.raises(ArithmeticError, match="three"):
        crew_of(pool).map(failing, None, range(6))


def test_shared_values_of_other_runs_are_forgotten():
    for number in range(5):
        sent = workers._Sent((os.getpid(), -1 - number), None, pickle.dumps(Counted(number)))
        assert workers._part(times, sent, 1) == number
    assert len(workers._KNOWN) <= workers.MOST_KNOWN


@pytest.mark.slow
@pytest.mark.parametrize("n_scenes, n_times", [(1, 80), (6, 20)])
def test_a_report_has_the_same_bits_whoever_fits(pool, n_scenes, n_times):
    data = throws(n_scenes, n_times, sigma=0.003, dt=0.02)

    def told(workers):
        report = close_loop(data, GRAVITY, rng=3, n_bootstrap=4, workers=workers).to_dict()
        rounds = [{**done, "seconds": 0.0} for done in report["rounds"]]
        return {**report, "wall_s": 0.0, "rounds": rounds}

    assert repr(told(pool)) == repr(told(None))
