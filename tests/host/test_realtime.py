"""What a process asks of the system; what concerns a whole process is asked in one of its own."""

import gc
import json
import os
import platform
import signal
import subprocess
import sys
import weakref
from pathlib import Path
from typing import Any

import pytest

import smarttac_can
from smarttac_can.host import realtime
from smarttac_can.host.realtime import (
    collecting_between_cycles,
    keep_processors_awake,
    request_real_time,
)

NOBODY = 65534
MEGABYTE = 1 << 20
ALLOWED = sorted(os.sched_getaffinity(0))
"""Processors of this process, and of those that it begins."""


class Garbage:
    """An object in a cycle, which only garbage collection frees."""

    def __init__(self) -> None:
        self.itself = self


def garbage() -> "weakref.ref[Garbage]":
    return weakref.ref(Garbage())


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The clock of the module: set its only item."""
    time = [100.0]
    monkeypatch.setattr(realtime, "monotonic", lambda: time[0])
    return time


def test_garbage_is_collected_when_asked_for_and_once_a_second(now: list[float]) -> None:
    with collecting_between_cycles() as collect:
        first = garbage()
        for now[0] in (100.0, 100.5, 100.999):
            collect()
            assert first() is not None
        now[0] = 101.0
        assert first() is not None, "nothing is collected by itself"
        collect()
        assert first() is None
        second = garbage()
        now[0] = 101.9
        collect()
        assert second() is not None
        now[0] = 105.0
        collect()
        assert second() is None


def test_garbage_collection_ignores_objects_from_before_the_loop() -> None:
    before = [Garbage()]
    with collecting_between_cycles():
        assert gc.get_freeze_count() > 0
        assert not any(thing is before[0] for thing in gc.get_objects())
    assert gc.get_freeze_count() == 0
    assert any(thing is before[0] for thing in gc.get_objects())


def test_garbage_from_before_the_loop_is_collected() -> None:
    before = garbage()
    with collecting_between_cycles():
        assert before() is None


@pytest.mark.parametrize("enabled", [True, False])
@pytest.mark.parametrize("fails", [True, False])
def test_garbage_collection_is_as_it_was(enabled: bool, fails: bool) -> None:
    assert gc.isenabled()
    if not enabled:
        gc.disable()
    try:
        with collecting_between_cycles():
            assert not gc.isenabled()
            if fails:
                raise ZeroDivisionError
    except ZeroDivisionError:
        assert fails
    finally:
        left = gc.isenabled()
        gc.enable()
    assert left is enabled
    assert gc.get_freeze_count() == 0


ASK = """
import json, os, resource, sys, threading
from pathlib import Path
from smarttac_can.host.realtime import request_real_time

priority, cpu, unprivileged, locked = json.loads(sys.argv[1])
if unprivileged:
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (locked, locked))
    if os.geteuid() == 0:
        os.setgroups([])
        os.setgid(unprivileged)
        os.setuid(unprivileged)
before = resource.getrlimit(resource.RLIMIT_RTTIME)
refused = request_real_time(priority, cpu)
threads = []
thread = threading.Thread(target=lambda: threads.append(os.sched_getscheduler(0)))
thread.start()
thread.join()
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(json.dumps({
    "refused": refused,
    "policy": os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK,
    "priority": os.sched_getparam(0).sched_priority,
    "thread": threads[0],
    "before": before,
    "limits": resource.getrlimit(resource.RLIMIT_RTTIME),
    "locked_kb": int(status["VmLck"].split()[0]),
    "cpus": sorted(os.sched_getaffinity(0)),
}))
"""


def child(program: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run a Python program; it must end by itself."""
    root = Path(smarttac_can.__file__).parents[1]
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", program, *arguments],
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )


def ask(
    priority: int, cpu: int | None = None, *, unprivileged: bool = False, locked: int = 0
) -> dict[str, Any]:
    """Grants of a process that asks for real time, or may have nothing but little memory."""
    asked = json.dumps([priority, cpu, NOBODY if unprivileged else 0, locked])
    done = child(ASK, asked)
    assert (done.returncode, done.stderr) == (0, "")
    return dict(json.loads(done.stdout))


def cure_of_priority(priority: int) -> str:
    return (
        f"real time: SCHED_FIFO {priority} is refused, going on without: allow it by a line "
        f"'USER - rtprio {priority}' in /etc/security/limits.conf, or CAP_SYS_NICE"
    )


def cure_of_memory(reason: str) -> str:
    return (
        f"real time: locking the memory is refused ({reason}), going on without: allow it by a "
        "line 'USER - memlock unlimited' in /etc/security/limits.conf, or CAP_IPC_LOCK"
    )


GRANT = """
import ctypes, json, os, sys

answer = {"memory": ctypes.CDLL(None).mlockall(3) == 0, "priority": True}
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(sys.argv[1])))
except PermissionError:
    answer["priority"] = False
print(json.dumps(answer))
"""


def granted(priority: int) -> dict[str, bool]:
    """Grants of the system for a process like ours."""
    return dict(json.loads(child(GRANT, str(priority)).stdout))


def test_each_is_given_or_its_cure() -> None:
    answer, given = ask(42), granted(42)
    assert answer["cpus"] == ALLOWED, "none was asked for"
    assert answer["thread"] == os.SCHED_OTHER, "threads from then on are ordinary"
    cures = []
    if given["priority"]:
        assert (answer["policy"], answer["priority"]) == (os.SCHED_FIFO, 42)
        assert answer["limits"] == [1_000_000, 3_000_000]
    else:
        cures.append(cure_of_priority(42))
    if given["memory"]:
        assert answer["locked_kb"] > 1000
    else:
        cures.append(answer["refused"][-1])
        assert cures[-1] in map(cure_of_memory, ("ENOMEM", "EPERM"))
    assert answer["refused"] == cures


@pytest.mark.parametrize(
    ("locked", "reason", "cpu"), [(0, "EPERM", ALLOWED[0]), (MEGABYTE, "ENOMEM", ALLOWED[-1])]
)
def test_ordinary_user_gets_a_processor_and_the_cure_of_the_rest(
    locked: int, reason: str, cpu: int
) -> None:
    answer = ask(7, cpu, unprivileged=True, locked=locked)
    assert answer["cpus"] == [cpu]
    assert answer["refused"] == [cure_of_priority(7), cure_of_memory(reason)]
    assert all("\n" not in line for line in answer["refused"])
    assert (answer["policy"], answer["priority"]) == (os.SCHED_OTHER, 0)
    assert answer["limits"] == answer["before"], "of no use without"
    assert answer["locked_kb"] == 0


@pytest.mark.parametrize("cpu", [1023, 10**6, 10**12, 10**30])
def test_missing_processor_is_refused_with_those_that_exist(cpu: int) -> None:
    given = ",".join(str(number) for number in ALLOWED)
    with pytest.raises(ValueError) as told:
        request_real_time(10, cpu)
    words = "is none of those that this process may use"
    assert str(told.value) == f"processor {cpu} {words}: {given}"
    assert sorted(os.sched_getaffinity(0)) == ALLOWED
    assert os.sched_getscheduler(0) == os.SCHED_OTHER, "nothing else was asked for"


def test_a_system_without_that_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    refused = request_real_time(10, 0)
    assert refused == ["real time: win32 has no SCHED_FIFO for us, going on without"]
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_processors_are_kept_awake_while_the_process_lives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = tmp_path / "cpu_dma_latency"
    asked.write_bytes(b"....")
    monkeypatch.setattr(realtime, "_LATENCY_REQUEST", asked)
    before = open_files()
    assert keep_processors_awake() == []
    assert asked.read_bytes() == bytes(4), "0 us, as the kernel takes it"
    (request,) = open_files() - before
    assert os.path.samestat(os.fstat(request), asked.stat())
    os.close(request)


def open_files() -> set[int]:
    # The listing has one for itself, which is closed by now.
    return {int(file.name) for file in Path("/proc/self/fd").iterdir() if file.exists()}


def test_processors_that_may_sleep_are_told_with_the_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = tmp_path / "cpu_dma_latency"
    monkeypatch.setattr(realtime, "_LATENCY_REQUEST", missing)
    assert keep_processors_awake() == [
        f"real time: processors that sleep are woken late, and {missing} is refused "
        "(No such file or directory): let this user write it, by udev, or give it to the container"
    ]


def test_no_processor_is_kept_awake_on_another_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    before = open_files()
    assert keep_processors_awake() == []
    assert open_files() == before


LIMITED = """
import json, resource, sys
from smarttac_can.host.realtime import _limit_time_without_sleep

limits = []
for most in 9_000_000, 2_000_000, 500_000:
    resource.setrlimit(resource.RLIMIT_RTTIME, (most, most))
    _limit_time_without_sleep()
    limits.append(resource.getrlimit(resource.RLIMIT_RTTIME))
print(json.dumps(limits))
"""


def test_a_limit_that_is_lower_already_is_not_raised() -> None:
    done = child(LIMITED)
    limits = [[1_000_000, 3_000_000], [1_000_000, 2_000_000], [500_000, 500_000]]
    assert (done.stderr, json.loads(done.stdout)) == ("", limits)


SPIN = """
import platform
import signal
from smarttac_can.host.process_signals import stop_on_signals
from smarttac_can.host.realtime import request_real_time

with stop_on_signals() as stop:
    refused = request_real_time(1, None)
    print(*refused, sep="\\n", flush=True)
    if any("SCHED_FIFO" in line for line in refused):
        signal.alarm(1)
    while not stop():
        pass
    print("ended")
"""


def test_a_process_that_never_sleeps_is_told_to_end() -> None:
    done = child(SPIN)
    lines = done.stdout.splitlines()
    if cure_of_priority(1) in lines:
        assert done.returncode == -signal.SIGALRM, "nobody ends an ordinary process"
    else:
        assert (done.returncode, done.stderr, lines[-1]) == (0, "", "ended")


SLICE = """
import ctypes, os, platform, struct
from smarttac_can.host.realtime import request_short_slices
os.nice(3)
request_short_slices()
attributes = ctypes.create_string_buffer(56)
number = {"x86_64": 315, "aarch64": 275}[platform.machine()]
assert ctypes.CDLL(None).syscall(number, 0, attributes, 56, 0) == 0
size, policy, flags, nice, priority, runtime = struct.unpack_from("=IIQiIQ", attributes)
print(policy, nice, runtime)
"""


@pytest.mark.skipif(
    sys.platform != "linux"
    or platform.machine() not in ("x86_64", "aarch64")
    or tuple(int(part) for part in platform.release().split(".")[:2]) < (6, 12),
    reason="Linux takes slices of ordinary processes from 6.12 on",
)
def test_an_ordinary_process_asks_for_short_slices_and_stays_one() -> None:
    run = subprocess.run([sys.executable, "-c", SLICE], capture_output=True, text=True, check=True)
    assert run.stdout.split() == [str(os.SCHED_OTHER), str(os.nice(0) + 3), "100000"]
