"""Work that is handed out gives what it gives here, in the same order, and is sent once."""

import os
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

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


def failing(value, job):
    if job == 3:
        raise ArithmeticError("three")
    return job


@pytest.fixture
def eager(monkeypatch):
    monkeypatch.setattr(workers, "WORTH_S", 0.0)


@pytest.fixture(scope="module")
def pool():
    with worker_pool(3) as pool:
        yield pool


@pytest.mark.slow
@pytest.mark.usefixtures("eager")
def test_a_map_is_the_same_wherever_it_is_done(pool):
    expected = [7 * k for k in range(40)]
    SENT.clear()
    assert Crew().map(times, Counted(7), range(40)) == expected
    assert not SENT
    assert Crew(pool).map(times, Counted(7), range(40)) == expected
    assert len(SENT) <= 4  # once to a worker, and not with every part
    with ThreadPoolExecutor(2) as threads:
        assert Crew(threads).map(times, Counted(7), range(40)) == expected


def test_short_work_is_not_handed_out():
    with ProcessPoolExecutor(2) as idle:
        assert Crew(idle).map(times, Counted(1), range(5)) == list(range(5))
        assert not idle._processes


@pytest.mark.usefixtures("eager")
def test_work_is_asked_for_in_order_and_may_grow(pool):
    jobs = [1, 2]
    work = Crew(pool).work(times, Counted(5), jobs, is_wanted=lambda job: job != 2)
    assert work.result(0) == 5
    jobs.append(3)
    assert [work.result(1), work.result(2)] == [10, 15]


@pytest.mark.parametrize("others", [False, True])
def test_each_part_comes_once(pool, others):
    found = dict(Crew(pool if others else None).each(times, Counted(2), iter(range(9))))
    assert found == {k: 2 * k for k in range(9)}


@pytest.mark.usefixtures("eager")
def test_an_error_comes_out_where_its_part_is_asked_for(pool):
    with pytest.raises(ArithmeticError, match="three"):
        Crew(pool).map(failing, None, range(6))


def test_shared_values_of_other_runs_are_forgotten():
    for number in range(5):
        workers._part(times, workers._Sent((os.getpid(), -number), Counted(number), True), 1)
    assert len(workers._KNOWN) <= workers.MOST_KNOWN
    lost = workers._Sent((os.getpid(), 10**9), None, False)
    assert workers._part(times, lost, 1) == workers._NOT_KNOWN


@pytest.mark.slow
@pytest.mark.usefixtures("eager")
@pytest.mark.parametrize("n_scenes, n_times", [(1, 80), (6, 20)])
def test_a_report_has_the_same_bits_whoever_fits(pool, n_scenes, n_times):
    data = throws(n_scenes, n_times, sigma=0.003, dt=0.02)

    def told(workers):
        report = close_loop(data, GRAVITY, rng=3, n_bootstrap=4, workers=workers).to_dict()
        rounds = [{**done, "seconds": 0.0} for done in report["rounds"]]
        return {**report, "wall_s": 0.0, "rounds": rounds}

    assert repr(told(pool)) == repr(told(None))
