"""Processes that share work leave none behind, whoever is interrupted or killed."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from nodes_on_a_bus import until

from smarttac_can.assurance.trials import workers

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
SOAK = ("soak", "--hours", "3")
FAULTS = ("faults", "--hold", "1000000000")
"""A row of it lasts longer than anybody waits."""


def group(leader: int) -> dict[int, str]:
    """Processes of a group that run, with their states."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            name_and_more = stat.read_text().rpartition(") ")[2].split()
        except OSError:
            continue
        if int(name_and_more[2]) == leader and name_and_more[0] != "Z":
            found[int(stat.parent.name)] = name_and_more[0]
    return found


def busy(pid: int) -> bool:
    """Whether a process has used two seconds of a processor: it works."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return int(fields[11]) > 2 * os.sysconf("SC_CLK_TCK")


@contextmanager
def sharing(*work: str) -> Iterator[subprocess.Popen[str]]:
    """Run a command that two processes share, in a group of its own; in the end none is left."""
    # A shell starts background jobs deaf to Ctrl-C, and so it would these tests.
    command = ["env", "--default-signal=INT", sys.executable, "-m", "smarttac_can.assurance"]
    command += [*work, "--jobs", "2"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as begun:
        try:
            yield begun
            until(lambda: not group(begun.pid), pause=0.1)
        finally:
            if group(begun.pid):
                os.killpg(begun.pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ("work", "number", "early", "to_all", "again"),
    [
        (SOAK, signal.SIGINT, False, True, False),
        (SOAK, signal.SIGINT, True, True, False),
        pytest.param(SOAK, signal.SIGINT, False, False, False, marks=pytest.mark.long),
        pytest.param(SOAK, signal.SIGTERM, False, False, False, marks=pytest.mark.long),
        pytest.param(FAULTS, signal.SIGINT, False, True, True, marks=pytest.mark.long),
        pytest.param(FAULTS, signal.SIGKILL, False, False, False, marks=pytest.mark.long),
    ],
)
def test_no_process_is_left(
    work: tuple[str, ...], number: int, early: bool, to_all: bool, again: bool
) -> None:
    """Ctrl-C goes to all processes of a terminal; as soon as they begin, or while they work."""
    with sharing(*work) as begun:
        leader = begun.pid
        # Two that work, and that of multiprocessing which tracks resources.
        until(lambda: len(group(leader)) == 4, pause=0.1)
        if not early:
            until(lambda: sum(map(busy, group(leader))) >= 2, pause=0.1)
        (os.killpg if to_all else os.kill)(leader, number)
        if again:
            time.sleep(0.05)
            os.killpg(leader, number)
        _, errors = begun.communicate(timeout=60.0)
    if again:
        # The second may come when the first has ended all but the process itself.
        assert begun.returncode in (1, -number)
    elif number == signal.SIGKILL:
        assert "Traceback" not in errors
    else:
        assert begun.returncode == 1
        assert errors.split() == ["Aborted!"]


def test_interrupt_of_another_thread_waits_for_the_end_of_the_block() -> None:
    over = threading.Event()
    other = threading.Thread(target=over.wait)  # takes the signal, as the threads of numpy do
    other.start()
    passed = False
    try:
        with pytest.raises(KeyboardInterrupt), workers._interrupts_held():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.05)
            passed = True
    finally:
        over.set()
        other.join()
    assert passed
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_process_that_is_killed_ends_the_work_in_one_line() -> None:
    with sharing(*SOAK) as begun:

        def working() -> list[int]:
            return [pid for pid in group(begun.pid) if pid != begun.pid and busy(pid)]

        until(working, pause=0.1)
        os.kill(working()[0], signal.SIGKILL)
        _, errors = begun.communicate(timeout=60.0)
    assert begun.returncode == 1
    assert errors.splitlines()[-1] == "Error: a process that shared the work was killed"
    assert "Traceback" not in errors
