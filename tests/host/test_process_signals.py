import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path
from textwrap import dedent
from typing import Any

import psutil
import pytest
import toy_node
from nodes_on_a_bus import GUARD_S, until
from toy_node import BOOT_UP, OFF

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.process_signals import endings_interrupt, stop_on_signals
from smarttac_can.host.python_can import PythonCanBus

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU]


@pytest.fixture(autouse=True)
def hangup_ends() -> Iterator[None]:
    """SIGHUP as in a terminal, also where the tests run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", SIGNALS)
def test_signal_is_remembered_and_handlers_come_back(number: signal.Signals) -> None:
    before = [signal.getsignal(n) for n in SIGNALS]
    with stop_on_signals() as stop:
        assert not stop()
        signal.raise_signal(number)
        assert stop()
        signal.raise_signal(number)
        assert stop()
    assert [signal.getsignal(n) for n in SIGNALS] == before


def test_handlers_come_back_after_an_error() -> None:
    before = [signal.getsignal(n) for n in SIGNALS]
    with pytest.raises(ZeroDivisionError), stop_on_signals():
        raise ZeroDivisionError
    assert [signal.getsignal(n) for n in SIGNALS] == before


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_an_ending_interrupts_and_its_handler_comes_back(number: signal.Signals) -> None:
    assert signal.getsignal(number) is signal.SIG_DFL
    with pytest.raises(KeyboardInterrupt), endings_interrupt():
        signal.raise_signal(number)
    assert signal.getsignal(number) is signal.SIG_DFL


def test_a_hangup_that_nohup_ignores_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with endings_interrupt(), stop_on_signals() as stop:
            signal.raise_signal(signal.SIGHUP)
            assert not stop()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_sigterm_is_left_to_an_existing_handler() -> None:
    with endings_interrupt(), stop_on_signals() as stop:
        signal.raise_signal(signal.SIGTERM)
        assert stop()
    with stop_on_signals() as stop, endings_interrupt():
        signal.raise_signal(signal.SIGTERM)
        assert stop()


def test_sigterm_is_left_alone_outside_of_the_main_thread() -> None:
    def look() -> object:
        with endings_interrupt():
            return signal.getsignal(signal.SIGTERM)

    with ThreadPoolExecutor(1) as executor:
        assert executor.submit(look).result(GUARD_S) is signal.SIG_DFL


# The end of the parent


def begun(script: str, *arguments: str) -> subprocess.Popen[str]:
    """A parent that begins a process by a script, says its process ID, and stays."""
    here = Path(toy_node.__file__).parent
    return subprocess.Popen(
        [sys.executable, "-c", dedent(script), *arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(here.parent), str(here)])},
        stdout=subprocess.PIPE,
        text=True,
    )


def has_ended(pid: int) -> bool:
    """Return whether there is no such process, other than one that nobody has waited for."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


CHILD = (
    "from smarttac_can.host.process_signals import end_with_parent\n"
    "end_with_parent()\n"
    "import toy_node\n"
    "toy_node.main()\n"
)
BY_STANDARD_INPUT = f"""
    import subprocess, sys
    command = [sys.executable, "-c", {CHILD!r}, *sys.argv[1:]]
    node = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    print(node.pid, flush=True)
    node.wait()
    """
BY_MULTIPROCESSING = f"""
    import multiprocessing
    node = multiprocessing.get_context("fork").Process(target=exec, args=({CHILD!r},))
    node.start()
    print(node.pid, flush=True)
    node.join()
    """


@pytest.mark.parametrize("script", [BY_STANDARD_INPUT, BY_MULTIPROCESSING])
def test_node_sends_0_v_and_ends_when_its_parent_is_killed(
    script: str, multicast: dict[str, Any]
) -> None:
    def wait_for(can_id: int) -> Frame | None:
        frame = master.receive(GUARD_S)
        while frame is not None and frame.can_id != can_id:
            frame = master.receive(GUARD_S)
        return frame

    group = (multicast["channel"], str(multicast["port"]))
    with closing(PythonCanBus(**multicast)) as master, begun(script, *group) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        try:
            assert wait_for(BOOT_UP + 1) is not None
            parent.kill()
            assert wait_for(OFF + 1) == Frame(OFF + 1, bytes(2))
            until(lambda: has_ended(pid))
        finally:
            parent.kill()
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


DEAF = """
    import multiprocessing, os, signal, time
    from smarttac_can.host import process_signals
    from smarttac_can.host.process_signals import end_with_parent

    def run():
        process_signals._PARTING_S = 0.5
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        end_with_parent()
        print(os.getpid(), flush=True)
        while True:
            time.sleep(1.0)

    multiprocessing.get_context("fork").Process(target=run).start()
    """


def test_process_that_ignores_sigterm_ends_after_5_s() -> None:
    with begun(DEAF) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.kill()
        until(lambda: has_ended(pid))
