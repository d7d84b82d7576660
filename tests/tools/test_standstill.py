"""The sleepers that see whether the machine stands still."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import standstill
from nodes_on_a_bus import GUARD_S, until
from standstill import forked, watching_machine

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="priorities and signals of Linux")


def test_standstill_watch_keeps_a_sleeper_on_each_processor() -> None:
    before = set(psutil.Process().children())
    with watching_machine() as machine:
        sleepers = set(psutil.Process().children()) - before
        assert machine.cores == sorted(os.sched_getaffinity(0))
        assert len(sleepers) == len(machine.cores) == len(machine.longest_s)
    assert not any(sleeper.is_running() for sleeper in sleepers)


def test_a_sleeper_that_is_stopped_stands_for_a_machine_that_was() -> None:
    with watching_machine() as machine:
        (sleeper, *_) = psutil.Process().children()
        machine.forget()
        begin = time.time()
        sleeper.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        sleeper.send_signal(signal.SIGCONT)
        # Its length is known before where it was.
        until(lambda: max(machine.longest_s) >= 0.09 and machine.standstills)
        longest = max(machine.standstills, key=lambda stood: stood.end - stood.begin)
        # It is seen from when it woke up last, before it was stopped, until it does so again.
        assert longest.begin < begin + 0.1 <= longest.end <= time.time()
        assert machine.stood_s(begin + 0.04, begin + 0.05) == longest.end - longest.begin
        assert machine.stood_s(begin - 2.0, begin - 1.0) == 0.0
        machine.forget()
        assert machine.stood_s(begin, begin + 0.1) == 0.0


def test_forked_sleeper_ends_with_the_block_even_if_stopped() -> None:
    with forked(signal.pause) as process:
        os.kill(process.pid, signal.SIGSTOP)
    assert process.exitcode == -signal.SIGKILL


def test_forked_sleeper_ends_with_a_killed_parent() -> None:
    script = (
        "import signal; from standstill import forked\n"
        "with forked(signal.pause) as one, forked(signal.pause) as other:\n"
        "    print(one.pid, other.pid, flush=True)\n"
        "    signal.pause()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, cwd=Path(standstill.__file__).parent
    ) as parent:
        assert parent.stdout is not None
        forks = [psutil.Process(int(pid)) for pid in parent.stdout.readline().split()]
        parent.kill()
        _, alive = psutil.wait_procs(forks, GUARD_S)
        for process in alive:
            process.kill()
    assert (len(forks), alive) == (2, [])
