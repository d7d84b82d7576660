"""A campaign that is run: rows that do not depend on their worker, and workers that fail."""

import subprocess
import sys
import threading
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from smarttac_can.science.population.compiled import can_compile
from smarttac_can.science.population.trial import Campaign
from smarttac_can.studies.campaign import runner
from smarttac_can.studies.campaign.runner import (
    COLUMNS,
    SIZE,
    ClusterError,
    Record,
    chunks_of,
    run_campaign,
    run_chunk,
)

pytestmark = pytest.mark.usefixtures("compiled_once")
CAMPAIGN = Campaign(seed=5, dead_time=540e-6)
FINGERS = 2 * SIZE + 3


@pytest.fixture(scope="module")
def rows(compiled_once):
    return run_campaign(CAMPAIGN, FINGERS, workers=1).rows


def test_campaign_rows_are_equal_for_any_number_of_workers(rows):
    for workers in (2, 5):
        again = run_campaign(CAMPAIGN, FINGERS, workers=workers).rows
        assert again.tobytes() == rows.tobytes()
    assert run_campaign(CAMPAIGN, 7, workers=2).rows.tobytes() == rows[:7].tobytes()


def test_every_finger_has_a_row(rows):
    assert rows.shape == (FINGERS, len(COLUMNS))
    assert (rows[:, -1] > 5.0).all()
    assert (rows[:, COLUMNS.index("rise_time_ms")] > 0.0).all()


def test_progress_rises_to_all():
    shares = []
    result = run_campaign(CAMPAIGN, FINGERS, workers=2, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert result.ran_s == pytest.approx(result.rows[:, -1].sum())
    assert result.wall_s > 0.0


def test_progress_begins_while_the_loop_is_compiled(monkeypatch):
    def prepare(progress):
        progress(0.5)
        progress(0.9)
        return "not kept"

    monkeypatch.setattr(runner, "prepare", prepare)
    shares = []
    result = run_campaign(CAMPAIGN, 2, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[:2] == pytest.approx([0.5, 0.9], abs=0.002)  # compiling takes far longer
    assert shares[-1] == 1.0
    assert result.not_kept == "not kept"


def test_progress_without_numba_rises_with_each_finger(monkeypatch):
    made = np.zeros((1, len(COLUMNS)))
    monkeypatch.setattr(runner, "can_compile", lambda: False)
    monkeypatch.setattr(runner, "prepare", lambda *_: pytest.fail("there is nothing to compile"))
    monkeypatch.setattr(runner, "run_chunk", lambda _, numbers, __: (numbers, made))
    shares = []
    run_campaign(CAMPAIGN, 4, progress=shares.append)
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_an_interrupted_campaign_goes_on_with_the_same_bits(rows, tmp_path):
    file = tmp_path / "rows"

    def interrupt(share):
        if share > 0.4:
            raise KeyboardInterrupt

    with Record(file, CAMPAIGN) as record, pytest.raises(KeyboardInterrupt):
        run_campaign(CAMPAIGN, FINGERS, workers=2, record=record, progress=interrupt)
    assert threading.active_count() == 1
    with Record(file, CAMPAIGN) as record:
        result = run_campaign(CAMPAIGN, FINGERS, workers=2, record=record)
    assert result.rows.tobytes() == rows.tobytes()
    assert 0.0 < result.ran_s < 0.7 * rows[:, -1].sum()
    with Record(file, CAMPAIGN) as record:
        again = run_campaign(CAMPAIGN, FINGERS, record=record)
    assert again.rows.tobytes() == rows.tobytes()
    assert again.ran_s == 0.0


def test_a_worker_that_fails_ends_it(monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("in the loop")

    monkeypatch.setattr(runner, "run_chunk", fail)
    with pytest.raises(ZeroDivisionError, match="in the loop"):
        run_campaign(CAMPAIGN, FINGERS, workers=2)
    assert threading.active_count() == 1


def test_few_chunks_are_under_way_at_a_time(monkeypatch):
    """Memory stays bounded: fingers not begun are a range."""
    most, under_way = 0, set()

    class Pool:
        def __init__(self, workers):
            self.workers = workers

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def submit(self, run, campaign, numbers, compiled):
            nonlocal most
            future = Future()
            future.set_result((numbers, np.zeros((len(numbers), len(COLUMNS)))))
            under_way.add(numbers)
            most = max(most, len(under_way))
            return future

        def shutdown(self, **_):
            pass

    monkeypatch.setattr(runner, "ThreadPoolExecutor", Pool)
    for numbers, _ in runner._in_threads(CAMPAIGN, [range(n, n + 1) for n in range(500)], 3, True):
        under_way.discard(numbers)
    assert most <= 6


def test_chunks_are_of_neighbours_that_are_missing():
    missing = np.array([0, 1, 2, 10, 11, *range(40, 40 + SIZE + 2)])
    assert chunks_of(missing, SIZE) == [
        range(3),
        range(10, 12),
        range(40, 40 + SIZE),
        range(40 + SIZE, 42 + SIZE),
    ]
    assert chunks_of(np.array([], dtype=np.intp), SIZE) == []


def test_uncompiled_worker_among_compiled_ones_is_refused():
    with pytest.raises(RuntimeError, match="numba"):
        run_chunk(CAMPAIGN, range(1), not can_compile())


# A campaign on a Dask cluster of this machine.


MANY = 40
TESTS = Path(__file__).parent.parent.parent


CLUSTER = """
import sys
sys.path.append(sys.argv.pop(1))
from compile_once import compile_once
from smarttac_can.studies.campaign import runner
from distributed import LocalCluster
workers, preload = int(sys.argv[1]), sys.argv[2:]
if preload == ["lacking"]:
    compile_once()
    runner.can_compile = lambda: False
    preload = []
with LocalCluster(
    n_workers=workers,
    threads_per_worker=1,
    processes=bool(preload),
    preload=preload,
    protocol="tcp",
    dashboard_address=":0",
) as local:
    print(local.scheduler_address, flush=True)
    sys.stdin.read()
"""


@contextmanager
def cluster_of(*arguments):
    """Give the address of a cluster, and end it: of threads of another process, or of processes."""
    command = [sys.executable, "-c", CLUSTER, str(TESTS), *arguments]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            yield process.stdout.readline().strip()
        finally:
            process.stdin.close()


def test_campaign_survives_a_killed_and_a_slow_worker(rows, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "SIZE", 2)
    monkeypatch.setenv("CLUSTER_WORKERS", str(tmp_path))
    file, shares, preload = tmp_path / "rows", [], Path(__file__).with_name("cluster_worker.py")
    with cluster_of("4", str(preload)) as address, Record(file, CAMPAIGN) as record:
        there = run_campaign(CAMPAIGN, MANY, cluster=address, record=record, progress=shares.append)
    assert (tmp_path / "killed").exists()
    assert (tmp_path / "slow").exists()
    assert there.rows.tobytes() == rows[:MANY].tobytes()
    kept = np.full_like(there.rows, np.nan)
    with Record(file, CAMPAIGN) as record:
        record.fill(kept)
    assert kept.tobytes() == there.rows.tobytes()
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_worker_that_fails_is_one_error():
    lacking = "a worker of the cluster failed: a worker lacks numba"
    with cluster_of("1", "lacking") as address, pytest.raises(ClusterError, match=lacking):
        run_campaign(CAMPAIGN, MANY, cluster=address)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x"])
def test_no_scheduler_is_one_line(address):
    """In a process of its own: a client that finds nobody leaves a thread behind."""
    code = (
        "from smarttac_can.studies.campaign import runner; runner.PATIENCE_S = 1;"
        "from smarttac_can.__main__ import run; run()"
    )
    command = [sys.executable, "-c", code, "campaign", "--fingers", "3", "--dask", address]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    last = run.stderr.splitlines()[-1]
    assert last.startswith(f"Error: no Dask scheduler at '{address}': ")
    assert "Traceback" not in run.stderr


def test_a_cluster_without_workers_is_one_error():
    with cluster_of("0") as address, pytest.raises(ClusterError, match=r"has no workers$"):
        run_campaign(CAMPAIGN, MANY, cluster=address)


def test_campaign_without_dask_names_the_extra(monkeypatch):
    monkeypatch.setattr(runner, "find_spec", lambda _: None)
    with pytest.raises(ClusterError, match=r"pip install 'smarttac-can\[dask\]'$"):
        run_campaign(CAMPAIGN, MANY, cluster="tcp://127.0.0.1:9")
