"""A process that ends disarms what it has armed; one that was forked, or only reads, does not."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from nodes_on_a_bus import (
    GUARD_S,
    NodeProcess,
    in_threads,
    processes,
    stimulator_with_plate,
    watched,
)

from smarttac_can.bench import BenchError, Mode, State, Stimulator
from smarttac_can.bench.stimulator import _close_all, _disown_all

DRIVE = """
import os, sys
from smarttac_can.bench import BenchError, Stimulator

def drive():
    bench = Stimulator.connect(**{bus})
    bench.set("Limit.Missed ticks", 50)  # a busy machine
    bench.voltage = 20.0
    bench.mode = "open_loop"
    print(bench.state, flush=True)
    return bench
"""
FORK = """
from multiprocessing import get_context

def work(_):
    try:
        bench.read()
    except BenchError as error:
        print(error, flush=True)

bench = drive()
with bench.record(sys.argv[1]) as recording:
    if not os.fork():
        work(0)
        sys.exit()  # through the block of the recording
    os.wait()
    with get_context("fork").Pool(1) as pool:
        pool.map(work, [0])
    child = get_context("fork").Process(target=work, args=(0,))
    child.start()
    child.join()
    bench.run(0.1)
print(bench.state, recording.summary.lost, bench.state, flush=True)
bench.close()
"""


@pytest.fixture
def lockstep(request: pytest.FixtureRequest) -> bool:
    return getattr(request, "param", False)


@pytest.fixture
def node(multicast: dict[str, Any], *, lockstep: bool) -> Iterator[NodeProcess]:
    with processes(multicast, "node --finger none" + lockstep * " --lockstep") as (made,):
        yield made


@pytest.fixture
def script(
    multicast: dict[str, Any], *, lockstep: bool
) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run what follows on the start of a script in a process."""
    bus = {**multicast, "lockstep": lockstep}

    def run(rest: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", DRIVE.format(bus=bus) + rest, *arguments],
            capture_output=True,
            text=True,
            timeout=GUARD_S,
            check=False,
        )

    return run


@pytest.mark.usefixtures("node")
@pytest.mark.parametrize(
    ("rest", "status", "error"),
    [
        ("drive(); sys.exit(3)  # kept by nobody", 3, ""),
        ("bench = drive(); raise RuntimeError('mine')", 1, "RuntimeError: mine"),
    ],
)
def test_a_script_that_ends_disarms_and_leaves_no_fault(
    multicast: dict[str, Any],
    script: Callable[..., subprocess.CompletedProcess[str]],
    rest: str,
    status: int,
    error: str,
) -> None:
    ended = script(rest)
    assert (ended.returncode, ended.stderr.strip().rpartition("\n")[2]) == (status, error)
    assert ended.stdout == "RUNNING\n"
    with Stimulator.connect(**multicast) as bench:
        assert (bench.state, bench.message) == (State.READY, "")


def test_the_end_disarms_and_waits_for_no_heartbeat(
    virtual: dict[str, Any],
) -> None:
    stimulator = stimulator_with_plate(lockstep=False)
    stimulator.od["Finger.Motion"].value = 0
    with in_threads(virtual, stimulator, lockstep=False):
        reader = Stimulator.connect(**virtual)
        bench = Stimulator.connect(**virtual)
        bench.mode = "open_loop"
        reader.close()
        assert bench.state is State.RUNNING, "a reader disarms nobody"
        _close_all()
        with pytest.raises(BenchError, match=r" is closed: connect anew$"):
            bench.read()
        with Stimulator.connect(**virtual) as after:
            assert (after.mode, after.state, after.message) == (Mode.OFF, State.READY, "")
            assert set(watched(after)) == {0}
        _close_all()


def test_a_forked_process_ends_no_connection_and_no_recording(
    virtual: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stimulator = stimulator_with_plate(lockstep=False)
    with (
        in_threads(virtual, stimulator, lockstep=False),
        Stimulator.connect(**virtual) as bench,
        bench.record(tmp_path / "run.h5") as recording,
    ):
        bench.mode = "open_loop"
        link, log = bench._link, recording._log
        with monkeypatch.context() as child:
            child.setattr("os.getpid", lambda: -1)
            _disown_all()
            for act in (bench.read, bench.disarm, lambda: bench.run(0.1)):
                with pytest.raises(BenchError, match=r" belongs to the process from which this"):
                    act()
            recording.__exit__(None, None, None)
            bench.close()
            _close_all()
            assert recording.log_path.exists()
            assert not recording.path.exists()
        bench._link = link
        recording._log = log
        assert bench.state is State.RUNNING


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.usefixtures("node")
@pytest.mark.parametrize("lockstep", [True], indirect=True)  # starting processes takes long
def test_forked_processes_disarm_nothing_and_say_why(
    script: Callable[..., subprocess.CompletedProcess[str]],
    tmp_path: Path,
) -> None:
    ended = script(FORK, str(tmp_path / "run.h5"))
    _, *children, last = ended.stdout.splitlines()
    assert len(children) == 3, ended.stderr
    for text in children:
        assert text.endswith(" belongs to the process from which this one was forked: connect here")
    assert last == "RUNNING 0 RUNNING"


def test_a_bench_that_cannot_be_disarmed_at_the_end_says_so(
    node: NodeProcess,
    script: Callable[..., subprocess.CompletedProcess[str]],
) -> None:
    ended = script(f"bench = drive(); os.kill({node.process.pid}, 9)")
    assert "could not be disarmed at the end: cannot write" in ended.stderr
    assert ended.returncode == 0
