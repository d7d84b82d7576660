"""A run of the 1 kHz loop on a bus of sockets, timed by a passive listener."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from math import inf
from tempfile import TemporaryFile
from time import monotonic, sleep, time
from typing import IO, Any, Final

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus

from smarttac_can.assurance.timing.loop_timing import LoopTiming
from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.canopen.bus.bus import BusError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.master.requests import upload
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.host.background import Background
from smarttac_can.host.can_socket import to_frame, to_message
from smarttac_can.host.drivers import opening
from smarttac_can.host.kernel_filter import enlarge_buffer, receive_only
from smarttac_can.host.python_can import open_bus
from smarttac_can.vocabulary.states import Mode, State

_OWN_OPTIONS: Final = ("interface", "channel", "bitrate")
_OUTPUT_BYTES: Final = 4096
_ANSWER_S: Final = 0.6
"""Time in s for an answer, or for the heartbeat of a stopped node, which comes every 500 ms."""
_PARTING_S: Final = 5.0
_BEGIN: Final = (
    "from smarttac_can.host.process_signals import end_with_parent; end_with_parent(); "
    "from smarttac_can.cli import main; main(prog_name='smarttac')"
)
_FETCH_S: Final = 0.005
_READY_POLL_S: Final = 0.02
COF: Final = 0.35
"""COF to which a timed run regulates."""
_POLL_S: Final = 0.1
_TRIES: Final = 5


class NodeProcess:
    """A process of ``smarttac node`` or ``smarttac plate``, created by `node_process`.

    Parameters
    ----------
    name
        Name of the command.
    process
        Process of the command.
    output
        File for its output; a pipe without a reader would block it.

    Attributes
    ----------
    refused
        A line for each request of ``--realtime`` that the system has refused; set when it is ready.
    """

    def __init__(self, name: str, process: subprocess.Popen[bytes], output: IO[bytes]) -> None:
        self._name = name
        self._process = process
        self._output = output
        self.refused: tuple[str, ...] = ()

    @property
    def pid(self) -> int:
        """Its process ID."""
        return self._process.pid

    def wait_until_ready(self) -> None:
        """Wait until the process has reported that it is ready.

        Raises
        ------
        BenchError
            If the process has ended.
        """
        while b" ready on " not in self._last_output():
            self.require_alive()
            sleep(_READY_POLL_S)
        lines = self._last_output().decode().split("\n")
        self.refused = tuple(line for line in lines if line.startswith("real time: "))

    def require_alive(self) -> None:
        """Check that the process is alive.

        Raises
        ------
        BenchError
            If it has ended, with the last line of its output.
        """
        if self._process.poll() is not None:
            lines = self._last_output().decode().split("\n")
            last = next((line for line in reversed(lines) if line), "without any output")
            raise BenchError(f"{self._name} has ended: {last.removeprefix('Error: ')}")

    def end(self) -> None:
        """Terminate the process, which leaves the plate at 0 V, and kill it after 5 s."""
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_PARTING_S)
        self._process.kill()

    def _last_output(self) -> bytes:
        # Without seek, which would also move the position at which the process writes.
        file = self._output.fileno()
        return os.pread(file, _OUTPUT_BYTES, max(0, os.fstat(file).st_size - _OUTPUT_BYTES))


def smarttac_command(*arguments: str) -> list[str]:
    """Return the command line of a ``smarttac`` that ends together with its parent.

    Its standard input must be a pipe from the parent, which writes nothing to it.
    """
    return [sys.executable, "-c", _BEGIN, *arguments]


@contextmanager
def node_process(
    arguments: Sequence[str], bus: Mapping[str, Any], realtime: int | None
) -> Iterator[NodeProcess]:
    """Run ``smarttac node`` or ``smarttac plate`` as a process; the block begins when it is ready.

    If this process is killed, the node ends as by SIGTERM, at 0 V.

    Parameters
    ----------
    arguments
        Name and options of the command.
    bus
        Options of `can.Bus`.
    realtime
        SCHED_FIFO priority for ``--realtime``; None without it.

    Raises
    ------
    BenchError
        If the process ends before it is ready, with the last line of its output.
    """
    command = node_command(arguments, bus, realtime)
    with (
        TemporaryFile() as output,
        # In a separate session, so that Ctrl-C does not end it before the bench has disconnected.
        subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        ) as process,
    ):
        node = NodeProcess(f"smarttac {arguments[0]}", process, output)
        try:
            node.wait_until_ready()
            yield node
        finally:
            node.end()


@contextmanager
def loop_processes(
    bus: Mapping[str, Any], realtime: int | None, *, plate_node: int | None = None
) -> Iterator[list[NodeProcess]]:
    """Run a stimulator, preceded by its plate unless there is one, as `node_process` does.

    Parameters
    ----------
    bus
        Options of `can.Bus`.
    realtime
        SCHED_FIFO priority for ``--realtime``; None without it.
    plate_node
        Node-ID of a plate that is already on the bus; None to simulate one.

    Yields
    ------
    list of NodeProcess
        The plate if it was started, and the stimulator, which produces SYNC.
    """
    plate_id = PLATE_ID if plate_node is None else plate_node
    commands: list[tuple[str, ...]] = [("node", "--plate-node", str(plate_id), "--produce-sync")]
    if plate_node is None:
        commands.insert(0, ("plate",))
    with ExitStack() as stack:
        yield [stack.enter_context(node_process(each, bus, realtime)) for each in commands]


def node_command(
    arguments: Sequence[str], bus: Mapping[str, Any], realtime: int | None
) -> list[str]:
    """Return the command line for `node_process`; its standard input must be a pipe."""
    command = smarttac_command(*arguments)
    for key, value in bus.items():
        if key in _OWN_OPTIONS:
            command += [f"--{key}", str(value)]
        else:
            command += ["--bus-option", f"{key}={value}"]
    if realtime is not None:
        command += ["--realtime", str(realtime)]
    return command


@contextmanager
def _stamped(bus: Mapping[str, Any]) -> Iterator[can.BusABC]:
    """Open a bus with time stamps of the kernel, and a large receive buffer.

    Raises
    ------
    BusError
        If the bus cannot be opened, or its interface has no such time stamps.
    """
    with opening(bus.get("interface"), bus.get("channel"), BusError):
        opened = open_bus(bus)
    with opened:
        if not isinstance(opened, SocketcanBus | UdpMulticastBus):
            raise BusError(
                "the loop is timed by the kernel's time stamps, between processes: "
                f"socketcan or udp_multicast have them, {opened.channel_info} has not"
            )
        enlarge_buffer(opened)
        yield opened


@contextmanager
def listening(
    bus: Mapping[str, Any], can_ids: Iterable[int], feed: Callable[[float, Frame], None]
) -> Iterator[None]:
    """Pass frames on a bus, with the time stamps of the kernel in s, to `feed` during the block.

    A thread fetches them every 5 ms. Waking it for each frame would delay the loop that is timed.
    All frames until the end of the block are passed before the block is left.

    Raises
    ------
    BusError
        If the bus cannot be opened, or its interface has no such time stamps; after the block, if
        the bus failed during it.
    """
    ended = threading.Event()
    end = inf
    broken: list[Exception] = []

    def stop() -> None:
        nonlocal end
        end = time()
        ended.set()

    def work() -> None:
        over = False
        try:
            while not over:
                over = ended.wait(_FETCH_S)
                # Frames may come endlessly: stop at those that came after the end.
                while (message := opened.recv(0.0)) is not None and message.timestamp <= end:
                    frame = to_frame(message)
                    if frame is not None:
                        feed(message.timestamp, frame)
        except (can.CanError, OSError) as error:
            broken.append(error)

    with _stamped(bus) as opened:
        receive_only(opened, can_ids)
        with Background("listener", work, stop):
            yield
    if broken:
        raise BusError(f"the loop was timed until its bus failed: {broken[0]}") from broken[0]


def require_free(bus: Mapping[str, Any], *ods: ObjectDictionary) -> None:
    """Refuse a bus that already has a node with one of these node-IDs, or another loop.

    Raises
    ------
    BenchError
        If such a node answers, its heartbeat comes, or there is SYNC.
    BusError
        If the bus cannot be timed, or carries no frames.
    """
    ids = {
        base + od.node_id: od.node_id for od in ods for base in (cia.SDO_TX_ID, cia.HEARTBEAT_ID)
    }
    with _stamped(bus) as opened:
        try:
            for od in ods:
                opened.send(to_message(upload(od.node_id, od.entry(cia.DEVICE_TYPE))))
            end = monotonic() + _ANSWER_S
            while (left := end - monotonic()) > 0:
                message = opened.recv(left)
                if message is None:
                    continue
                if message.arbitration_id == cia.SYNC_ID:
                    raise BenchError("somebody produces SYNC on this bus: end that loop first")
                if message.arbitration_id in ids:
                    raise BenchError(
                        f"a node {ids[message.arbitration_id]} is on this bus already, and two "
                        "would have one node-ID: end it, or give it another by LSS or --node-id"
                    )
        except can.CanError as error:
            raise BusError(f"the bus carries no frames: {error}") from error


@dataclass(frozen=True)
class LoopRun:
    """Result of a timed run of the loop."""

    timing: LoopTiming
    ran: bool
    """Whether the stimulator reached the state RUNNING."""
    state: State | None
    """State of the stimulator at the end; None if it did not answer."""
    message: str
    """Why it did not run, or not to the end; empty if it did, or was not meant to."""
    refused: tuple[str, ...]
    """A line for each request for real-time priority that the system has refused."""


def regulate_friction(bench: Stimulator) -> None:
    """Start a run in mode friction with a stroking finger; raises as `Stimulator`."""
    bench.disarm()
    bench.reset_fault()
    bench.finger.stroke(2, force=0.5, speed=50.0)
    bench.start_run()
    bench.tare()
    bench.cof = COF
    bench.mode = Mode.FRICTION


def measure_loop(
    bus: Mapping[str, Any],
    *,
    plate_node: int | None,
    realtime: int | None,
    seconds: float,
    stop: Callable[[], bool],
    progress: Callable[[float, LoopTiming], None],
) -> LoopRun:
    """Start a stimulator, and a plate unless there is one; time the loop; end both.

    Parameters
    ----------
    bus
        Options of `can.Bus`.
    plate_node
        Node-ID of a plate that is already on the bus; it stays at 0 V. None to simulate one with
        a finger, and regulate its friction.
    realtime
        SCHED_FIFO priority of the processes; None without.
    seconds
        Duration of the measurement in s.
    stop
        Function called ten times a second; True ends the measurement early.
    progress
        Function called as often with the elapsed time in s and the present result.

    Raises
    ------
    BenchError
        If a process ends, a node does not answer, another loop runs on the bus, or a node on the
        bus has the node-ID of a node to be started.
    BusError
        If the bus cannot be opened, or has no time stamps.
    """
    require_free(bus, stimulator_od(), *([plate_od()] if plate_node is None else []))
    plate_id = PLATE_ID if plate_node is None else plate_node
    with (
        loop_processes(bus, realtime, plate_node=plate_node) as nodes,
        _connected(plate_id, bus) as bench,
    ):
        reason = _try_to_run(bench) if plate_node is None else ""
        timing = LoopTiming(plate_od(plate_id))
        with listening(bus, timing.can_ids, timing.feed):
            start = monotonic()
            while not stop() and (left := start + seconds - monotonic()) > 0:
                sleep(min(left, _POLL_S))
                for node in nodes:
                    node.require_alive()
                progress(monotonic() - start, timing)
        refused = tuple(dict.fromkeys(line for node in nodes for line in node.refused))
        return LoopRun(timing, plate_node is None and not reason, *_end(bench, reason), refused)


@contextmanager
def _connected(plate_id: int, bus: Mapping[str, Any]) -> Iterator[Stimulator]:
    bench = Stimulator.connect(plate_node_id=plate_id, **bus)
    try:
        yield bench
    finally:
        # The stimulator need not answer: its process ends next, which also leaves 0 V.
        with suppress(BenchError), bench:
            pass


def _try_to_run(bench: Stimulator) -> str:
    """Start regulating friction, with several tries; return the last error, or ""."""
    reason = ""
    for _ in range(_TRIES):
        try:
            regulate_friction(bench)
        except BenchError as error:
            reason = str(error)
        else:
            return ""
    return reason


def _end(bench: Stimulator, reason: str) -> tuple[State | None, str]:
    """Return the state at the end, and the reason if it is not RUNNING."""
    try:
        return bench.state, reason or bench.message
    except BenchError as error:
        return None, str(error)
