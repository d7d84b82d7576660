"""``tools/bench/measure realtime``: its figures and its end, not how good a machine is."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import psutil
import pytest
from nodes_on_a_bus import GUARD_S, until

from smarttac_can.canopen.master.errors import BenchError

TOOL = Path(__file__).parents[2] / "tools" / "bench" / "measure"
TRIES = 6
QUANTILES = {"p50_us", "p99_us", "p999_us", "p9999_us", "max_us"}


@pytest.fixture
def tool(load: Callable[[str], ModuleType]) -> ModuleType:
    return load("bench/realtime.py")


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, str(TOOL), "realtime", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.terminate()


def results_of(*arguments: str) -> tuple[dict[str, Any], bool]:
    """Return the results of a run, and whether it ended well or said why its loop ended.

    On a machine that is too busy a run may fail before there are results, but not each time.
    """
    for _ in range(TRIES):
        with running(*arguments, "--json") as process:
            said, complaints = process.communicate()
        assert "changed the data" not in complaints
        if said:
            break
    stopped = complaints.splitlines()[-1:]
    return json.loads(said), process.returncode == 0 or stopped[0].startswith("Error: the ")


def test_the_results() -> None:
    results, explained = results_of("--seconds", "4", "--hogs", "1")
    assert results["ticks"] > 0
    for name in ("sync", "measurement", "drive"):
        assert set(results[name]) == QUANTILES
    assert results["missed_share"] == results["missed"] / results["ticks"]
    assert set(results["deadline_ms"]) == {"measurement", "drive"}
    assert all(deadline > 0 for deadline in results["deadline_ms"].values())
    assert 0 <= results["running_share"] <= 1
    assert 0 <= results["cycles_running"] <= results["cycles_recorded"]
    assert [sleeper["core"] for sleeper in results["sleepers"]] == sorted(os.sched_getaffinity(0))
    assert results["void"] == any(sleeper["max_us"] > 1000 for sleeper in results["sleepers"])
    assert set(results["cpu_share"]) == {"plate", "node"}
    assert explained


@pytest.mark.long
def test_a_panel_runs_beside() -> None:
    results, explained = results_of("--seconds", "4", "--panel")
    assert results["cpu_share"]["panel"] > 0
    assert 0 < results["updates_per_s"] <= 10.5
    assert explained


@pytest.mark.long
def test_an_sdo_client_runs_beside() -> None:
    results, _ = results_of("--seconds", "5", "--sdo", "5000", "--deadline", "100")
    assert set(results["deadline_ms"].values()) == {100}
    assert results["transfers"] > 0
    assert 0 < results["answer_p50_ms"] <= results["answer_p99_ms"]
    assert results["bare_frames_per_s"] > 0
    for way in ("down", "up"):
        assert results[f"block_{way}load_share_of_bare"] > 0


@pytest.mark.long
def test_a_signal_ends_all_of_it() -> None:
    with running("--seconds", "3600", "--hogs", "1") as process:
        tool = psutil.Process(process.pid)
        # Sleepers, hog, two nodes, bench.
        until(lambda: len(tool.children()) >= len(os.sched_getaffinity(0)) + 4, pause=0.1)
        children = tool.children()
        process.terminate()
        process.communicate(timeout=GUARD_S)
    assert process.returncode == 128 + signal.SIGTERM
    assert not any(child.is_running() for child in children)


def run_of(plate: float, missed: int) -> dict[str, Any]:
    """Figures of a run of 10 s, of which the plate takes a share of a core."""
    return {
        "seconds": 10.0,
        "ticks": 10_000,
        "missed_share": missed / 10_000,
        "cpu_share": {"plate": plate, "node": 0.4},
        "drive": {"p50_us": 300, "p99_us": 600},
        "trips_of_the_loop": 1,
        "standstills": 2,
    }


def test_two_trees_are_compared_by_pairs(tool: ModuleType) -> None:
    compared = tool.compared
    other = [run_of(0.2, 0), run_of(0.4, 10), run_of(0.3, 0)]
    results = compared(other, [run_of(0.1, 5), run_of(0.2, 0), run_of(0.15, 0)])
    assert results["pairs"] == 3
    assert results["plate_us"] == {"other": 300.0, "here": 150.0, "ratio": 0.5, "range": [0.5, 0.5]}
    assert results["node_us"]["ratio"] == 1.0
    assert results["missed_per_1000"] == {"other": 0.33, "here": 0.17}, "a draw without any"
    assert results["trips_of_the_loop"] == {"other": 3, "here": 3}
    uneven = compared([run_of(0.2, 10)] * 3, [run_of(share, 5) for share in (0.1, 0.2, 0.3)])
    assert uneven["missed_per_1000"]["range"] == [0.5, 0.5]
    assert uneven["plate_us"]["ratio"] == 1.0
    assert uneven["plate_us"]["range"] == [0.5, 1.5]


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ((), "required: --seconds"),
        (("--seconds", "1"), "--seconds 1.0 is below 2"),
        (("--seconds", "5", "--hogs", "-1"), "--hogs -1 is below 0"),
        (("--seconds", "2", "--against", "{empty}"), "has no tools/bench/measure"),
    ],
)
def test_wrong_arguments(
    arguments: tuple[str, ...],
    error: str,
    tool: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    call: Callable[..., int],
) -> None:
    with pytest.raises(SystemExit, match=r"^2$"):
        call(tool, *(each.format(empty=tmp_path) for each in arguments))
    assert error in capsys.readouterr().err


def test_a_run_that_does_not_end_is_ended(tool: ModuleType) -> None:
    with pytest.raises(BenchError, match="not ended after 0 s"), tool.bounded(0.05):
        time.sleep(GUARD_S)
