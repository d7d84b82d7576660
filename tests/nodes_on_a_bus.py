"""Nodes for a bench to connect to: in threads of this process, or as processes of their own."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from queue import Empty, Queue
from typing import Any

import can

from smarttac_can.bench import Stimulator
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.host.runner import run_node
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode

GUARD_S = 60.0
"""Only ever waited for by a test that is about to fail."""

ALL_TICKS = 100
"""Percent of a second; more than nodes take as their limit."""

BENCH_WATCH = 0x7F << 16 | 1000
"""Entry of the consumer heartbeat time for a bench that drives."""

ODS = {PLATE_ID: plate_od(), STIMULATOR_ID: stimulator_od()}

Node = PlateNode | StimulatorNode


def until(holds: Callable[[], object], *, pause: float = 0.005) -> None:
    """Look every so many s for an event; the bound is a guard."""
    guard = time.monotonic() + GUARD_S
    while not holds():
        assert time.monotonic() < guard, "it did not come"
        time.sleep(pause)


def watched(bench: Stimulator) -> list[int]:
    """Return the consumer heartbeat times of a bench's stimulator."""
    device = bench._link._stimulator  # type: ignore[attr-defined]
    return [device.read(device.od.entry(0x1016, number)) for number in range(1, 5)]


class HesitantBus(PythonCanBus):
    """A bus whose party takes its time before it looks for the next frame."""

    def __init__(self, pause_s: Callable[[], float], options: Mapping[str, Any]) -> None:
        super().__init__(**options)
        read = self.read

        def hesitant(frames: deque[Frame]) -> bool:
            time.sleep(pause_s())
            return read(frames)

        self.read = hesitant


def stimulator_with_plate(*, lockstep: bool = True) -> StimulatorNode:
    return StimulatorNode(stimulator_od(), PlateBlock(plate_od()), lockstep=lockstep)


def both(*, lockstep: bool = True) -> tuple[PlateNode, StimulatorNode]:
    plate = PlateNode(plate_od(), deadline_ms=3)
    stimulator = StimulatorNode(
        stimulator_od(), plate_node_id=PLATE_ID, lockstep=lockstep, deadline_ms=3
    )
    return plate, stimulator


@contextmanager
def in_threads(
    options: Mapping[str, Any],
    *nodes: Node,
    lockstep: bool = True,
    pause_s: Callable[[], float] | None = None,
) -> Iterator[threading.Event]:
    """Run nodes, until the block ends or the event that it gets is set.

    Each pauses for `pause_s()` before it looks for a frame.
    In real time no run ends by 6180h, however busy the machine is.
    """
    if not lockstep:
        for node in nodes:
            if isinstance(node, StimulatorNode):
                node.od["Limit.Missed ticks"].default = ALL_TICKS
    buses = [HesitantBus(pause_s, options) if pause_s else PythonCanBus(**options) for _ in nodes]
    stop = threading.Event()
    with ThreadPoolExecutor(max_workers=len(nodes)) as executor:
        runs = [
            executor.submit(run_node, node, bus, stop.is_set, lockstep=lockstep)
            for node, bus in zip(nodes, buses, strict=True)
        ]
        try:
            yield stop
        finally:
            stop.set()
        for run in runs:
            run.result(timeout=GUARD_S)


class NodeProcess:
    """``smarttac node`` or ``smarttac plate`` as a process of its own."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-W", "error", "-m", "smarttac_can", *arguments]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.lines: Queue[str] = Queue()
        self._complaints = ""
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.put(line.rstrip("\n"))

    def wait_for(self, line: str) -> None:
        """Return once the process has said so; it must live, and the bound is a guard."""
        guard = time.monotonic() + GUARD_S
        said = ""
        while said != line:
            try:
                said = self.lines.get(timeout=0.1)
            except Empty:
                alive = self.process.poll() is None and time.monotonic() < guard
                assert alive, f"{line!r} was not said"

    def end(self, number: int = signal.SIGTERM) -> tuple[int, list[str], str]:
        """Send a signal; return the exit status, the lines not yet seen, and stderr."""
        with self.process as process:
            if process.poll() is None:
                process.send_signal(number)
            try:
                process.wait(GUARD_S)
            finally:
                process.kill()
                self._reader.join(GUARD_S)
            assert process.stderr is not None
            if not process.stderr.closed:
                self._complaints = process.stderr.read()
        return process.returncode, list(self.lines.queue), self._complaints


def multicast_options(bus: Mapping[str, Any]) -> list[str]:
    """Options of ``smarttac`` commands for a bus."""
    options = ["--interface", bus["interface"], "--channel", bus["channel"]]
    return [*options, "--bus-option", f"port={bus['port']}"]


@contextmanager
def driven_voltages(bus: Mapping[str, Any]) -> Iterator[list[int]]:
    """Voltages of the drives, in 10 mV; read as they come: a socket keeps the oldest only."""
    heard: list[int] = []

    def hear(message: can.Message) -> None:
        if message.arbitration_id == 0x221:
            heard.append(int.from_bytes(message.data[:2], "little"))

    with can.Bus(**bus) as listener, can.Notifier(listener, [hear], timeout=0.02):
        yield heard


def regulate_friction(bench: Stimulator) -> None:
    """Regulate the friction for 0.4 s, at first of one reference and then of two."""
    bench.amplitude = 1.0
    bench.cof = 0.35
    bench.mode = "friction"
    bench.run(0.2)
    bench.cof = (0.2, 0.3)
    bench.run(0.2)
    bench.disarm()


@contextmanager
def processes(bus: Mapping[str, Any], *commands: str) -> Iterator[list[NodeProcess]]:
    """Run ``smarttac`` commands such as ``node --lockstep`` on a bus until the block ends."""
    options = multicast_options(bus)
    started: list[NodeProcess] = []
    try:
        for command in commands:
            started.append(NodeProcess(*command.split(), *options))
        for command, process in zip(commands, started, strict=True):
            name = "plate 33" if command.startswith("plate") else "stimulator 32"
            process.wait_for(f"{name} ready on {bus['interface']}:{bus['channel']}")
        yield started
    finally:
        with ExitStack() as ends:
            for process in started:
                ends.callback(process.end)
