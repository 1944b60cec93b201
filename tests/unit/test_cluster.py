"""A Dask client is handed in as it is; a worker that is killed costs its part, and no more."""

import os
import signal
import time

import pytest

from bsp_gp.cli import main
from bsp_gp.workers import Crew, hands

distributed = pytest.importorskip("distributed", reason="needs the extra [cluster]")
pytestmark = pytest.mark.filterwarnings("ignore")  # dask's own


def slowly(value, job):
    time.sleep(0.2)
    return value[job], os.getpid()


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
    ) as cluster:  # fmt: skip
        yield cluster


@pytest.mark.slow
def test_parts_of_a_killed_worker_are_done_by_another(cluster):
    with hands(cluster=cluster.scheduler_address) as client:
        victim = next(iter(client.run(os.getpid).values()))
        crew, found = Crew(client), {}
        for number, (value, _) in crew.each(slowly, [k * k for k in range(20)], range(20)):
            found[number] = value
            if len(found) == 3:
                os.kill(victim, signal.SIGKILL)
        assert found == {k: k * k for k in range(20)}


@pytest.mark.slow
def test_a_map_shares_the_work_with_the_cluster(cluster):
    with distributed.Client(cluster) as client:
        values, owners = zip(*Crew(client).map(slowly, list(range(12)), range(12)), strict=True)
    assert values == tuple(range(12))
    assert os.getpid() in owners and len(set(owners)) > 1


def test_no_scheduler_is_said_in_one_line(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("t,x,y\n" + "\n".join(f"{k},{k},{k * k}" for k in range(9)))
    words = ["sweep", str(tmp_path / "a.csv"), "--declare", "9.81 [m/s^2] * m_i * down", "--quiet",
             "--out", str(tmp_path / "out"), "--cluster"]  # fmt: skip
    assert main([*words, "nonsense"]) == 2
    assert "no scheduler answers" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
