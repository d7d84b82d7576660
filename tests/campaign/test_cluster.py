"""A campaign on a Dask cluster of this machine."""

import subprocess
import sys
from contextlib import contextmanager

import pytest

from smarttac_can.campaign import runner
from smarttac_can.campaign.runner import ClusterError, run_campaign
from smarttac_can.population.trial import Campaign

CAMPAIGN = Campaign(seed=5, dead_time=540e-6)
FINGERS = 40


CLUSTER = """
import sys
from smarttac_can.campaign import record
from distributed import LocalCluster
workers, lacking = int(sys.argv[1]), sys.argv[2:]
if lacking:
    record.can_compile = lambda: False
with LocalCluster(
    n_workers=workers, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=":0"
) as local:
    print(local.scheduler_address, flush=True)
    sys.stdin.read()
"""


@contextmanager
def cluster_of(*arguments):
    """Give the address of a cluster in another process, and end it."""
    command = [sys.executable, "-c", CLUSTER, *arguments]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            yield process.stdout.readline().strip()
        finally:
            process.stdin.close()


def test_the_rows_of_a_cluster_are_those_of_threads():
    here = run_campaign(CAMPAIGN, FINGERS, workers=2)
    shares = []
    with cluster_of("2") as address:
        there = run_campaign(CAMPAIGN, FINGERS, cluster=address, progress=shares.append)
    assert there.rows.tobytes() == here.rows.tobytes()
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_worker_that_fails_is_one_error():
    lacking = "a worker of the cluster failed: a worker lacks numba"
    with cluster_of("1", "lacking") as address, pytest.raises(ClusterError, match=lacking):
        run_campaign(CAMPAIGN, FINGERS, cluster=address)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x"])
def test_no_scheduler_is_one_line(address):
    """In a process of its own: a client that finds nobody leaves a thread behind."""
    command = [sys.executable, "-m", "smarttac_can", "campaign", "--fingers", "3"]
    run = subprocess.run([*command, "--dask", address], capture_output=True, text=True, check=False)
    assert run.returncode == 1
    last = run.stderr.splitlines()[-1]
    assert last.startswith(f"Error: no Dask scheduler at '{address}': ")
    assert "Traceback" not in run.stderr


def test_a_cluster_without_workers_is_one_error():
    with cluster_of("0") as address, pytest.raises(ClusterError, match=r"has no workers$"):
        run_campaign(CAMPAIGN, FINGERS, cluster=address)


def test_without_dask_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(runner, "find_spec", lambda _: None)
    with pytest.raises(ClusterError, match=r"pip install 'smarttac-can\[dask\]'$"):
        run_campaign(CAMPAIGN, FINGERS, cluster="tcp://127.0.0.1:9")
