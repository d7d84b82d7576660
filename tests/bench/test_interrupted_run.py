"""Ctrl-C, or a node that is lost, ends a run: 0 V, and its rows are kept."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from nodes_on_a_bus import in_threads, stimulator_with_plate

from smarttac_can.bench import BenchError, RunInterruptedError, Stimulator
from smarttac_can.bench.can_link import over_can
from smarttac_can.bench.network import LocalNetwork
from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.host.process_signals import interrupt_waits


@contextmanager
def interrupt_in(seconds: float) -> Iterator[None]:
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()


@pytest.mark.parametrize("bench", ["local", "bus", "virtual"], indirect=True)
def test_ctrl_c_keeps_the_rows_and_disarms(bench: Stimulator) -> None:
    bench.finger.lift()
    bench.start_run()
    bench.tare()
    bench.voltage = 20
    bench.mode = "open_loop"
    words = r"interrupted after \d+ of 3600000 c"
    with pytest.raises(RunInterruptedError, match=words) as caught, interrupt_in(0.5):
        bench.run(3600)
    assert isinstance(caught.value, KeyboardInterrupt)
    assert isinstance(caught.value, BenchError)
    trace = caught.value.trace
    assert str(caught.value).startswith(f"interrupted after {len(trace)} of")
    assert caught.value.__notes__ == [
        f".trace holds the {len(trace)} cycles until then",
        "the stimulator was disarmed",
    ]
    assert trace.lost == 0
    assert trace.voltage_v[-1] == 20.0
    assert bench.get("Mode") == 0
    assert bench.run(0.01).voltage_v.tolist() == [0.0] * 10
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("bench", ["local", "bus", "virtual"], indirect=True)
def test_ctrl_c_before_the_first_cycle(bench: Stimulator, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def at_once() -> Iterator[Any]:
        yield lambda: True

    monkeypatch.setattr("smarttac_can.bench.stimulator.interrupt_waits", at_once)
    with pytest.raises(RunInterruptedError, match="after 0 of 1000") as caught:
        bench.run(1)
    assert caught.value.trace is None


def test_ctrl_c_in_real_time(virtual: dict[str, Any]) -> None:
    with (
        in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False),
        Stimulator.connect(**virtual) as bench,
    ):
        with pytest.raises(RunInterruptedError) as caught, interrupt_in(0.5):
            bench.run(3600)
        assert len(caught.value.trace) > 10
        # It only read: nothing was disarmed.
        assert len(caught.value.__notes__) == 1


def test_a_second_ctrl_c_does_not_wait() -> None:
    with pytest.raises(KeyboardInterrupt), interrupt_waits() as interrupted:
        signal.raise_signal(signal.SIGINT)
        assert interrupted()
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_handler_of_somebody_else_stays() -> None:
    came = []
    before = signal.signal(signal.SIGINT, lambda number, _frame: came.append(number))
    try:
        with interrupt_waits() as interrupted:
            signal.raise_signal(signal.SIGINT)
            assert (came, interrupted()) == ([signal.SIGINT], False)
    finally:
        signal.signal(signal.SIGINT, before)


def test_another_thread_leaves_signals_alone() -> None:
    found: list[Any] = []

    def look() -> None:
        with interrupt_waits() as interrupted:
            found.append((signal.getsignal(signal.SIGINT), interrupted()))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert found == [(signal.default_int_handler, False)]


def test_a_lost_node_keeps_the_rows() -> None:
    bus = LocalBus()
    port = bus.attach(stimulator_with_plate())
    bench = Stimulator(
        *over_can(LocalNetwork(bus), 32, None, where="local", lockstep=True, timeout=0.0)
    )
    cycles = 0

    def pull(_can_id: int, _data: bytes, _time: float) -> None:
        nonlocal cycles
        cycles += 1
        if cycles == 50:
            port.close()

    bench._link._network.subscribe(0x4A0, pull)  # type: ignore[attr-defined]
    with pytest.raises(BenchError) as caught:
        bench.run(1.0)
    assert len(caught.value.trace) == 50
    assert caught.value.__notes__ == [
        ".trace holds the 50 cycles until then",
        "it could not be disarmed: it stops when it misses the heartbeat of this bench",
    ]
    with pytest.raises(BenchError):
        bench.close()


def test_a_node_that_falls_silent_in_real_time(virtual: dict[str, Any]) -> None:
    node = stimulator_with_plate(lockstep=False)
    node.od.entry(0x1017).value = node.od.entry(0x1017).default = 100
    with (
        in_threads(virtual, node, lockstep=False) as stop,
        Stimulator.connect(**virtual, timeout=0.2) as bench,
    ):
        timer = threading.Timer(1.0, stop.set)
        timer.start()
        with pytest.raises(BenchError, match=r"no heartbeat for|does not answer") as caught:
            bench.run(3600)
        timer.join()
    assert len(caught.value.trace) > 10
