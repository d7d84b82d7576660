"""A run of the 1 kHz loop on a bus of sockets, timed by who only listens."""

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

from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.device.frame import Frame
from smarttac_can.host.background import Background
from smarttac_can.host.bus import BusError
from smarttac_can.host.drivers import opening
from smarttac_can.host.kernel_filter import hear_only, hold_more
from smarttac_can.host.python_can import kept_here, received, to_frame, to_message
from smarttac_can.master.errors import BenchError
from smarttac_can.master.requests import upload
from smarttac_can.od.cia import DEVICE_TYPE, HEARTBEAT_ID, SDO_TX_ID, SYNC_ID
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.timing.loop_timing import LoopTiming
from smarttac_can.vocabulary.states import Mode, State

_OWN_OPTIONS: Final = ("interface", "channel", "bitrate")
_OUTPUT_BYTES: Final = 4096
_QUIET_S: Final = 0.2
_ANSWER_S: Final = 0.6
"""For an answer, or the heartbeat of a node that is stopped: one comes every 500 ms."""
_PARTING_S: Final = 5.0
_BEGIN: Final = (
    "from smarttac_can.host.process_signals import end_with_parent; end_with_parent(); "
    "from smarttac_can.cli import main; main(prog_name='smarttac')"
)
_FETCH_S: Final = 0.005
_READY_POLL_S: Final = 0.02
COF: Final = 0.35
"""Friction that a timed run regulates."""
_POLL_S: Final = 0.1
_TRIES: Final = 5


class NodeProcess:
    """``smarttac node`` or ``plate`` as a process; `node_process` makes one.

    Parameters
    ----------
    name
        The command.
    process
        The process.
    output
        File that takes its output; a pipe that nobody reads would block it.

    Attributes
    ----------
    refused
        What the system refused it of ``--realtime``, a line each; known when it is ready.
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
        """Return when the process has reported that it is ready.

        Raises
        ------
        BenchError
            If it has ended.
        """
        while b" ready on " not in self._last_output():
            self.require_alive()
            sleep(_READY_POLL_S)
        lines = self._last_output().decode().split("\n")
        self.refused = tuple(line for line in lines if line.startswith("real time: "))

    def require_alive(self) -> None:
        """Do nothing while the process lives.

        Raises
        ------
        BenchError
            With the last line of its output, if it has ended.
        """
        if self._process.poll() is not None:
            lines = self._last_output().decode().split("\n")
            last = next((line for line in reversed(lines) if line), "without any output")
            raise BenchError(f"{self._name} has ended: {last.removeprefix('Error: ')}")

    def end(self) -> None:
        """Have it leave the plate at 0 V, and end it in any case."""
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_PARTING_S)
        self._process.kill()

    def _last_output(self) -> bytes:
        # Without seek, which would move the place at which the process writes, too.
        file = self._output.fileno()
        return os.pread(file, _OUTPUT_BYTES, max(0, os.fstat(file).st_size - _OUTPUT_BYTES))


def smarttac_command(*arguments: str) -> list[str]:
    """Return the command line of a ``smarttac`` that ends with the process that begins it.

    Its standard input has to be a pipe of that process, which writes nothing to it.
    """
    return [sys.executable, "-c", _BEGIN, *arguments]


@contextmanager
def node_process(
    arguments: Sequence[str], bus: Mapping[str, Any], realtime: int | None
) -> Iterator[NodeProcess]:
    """Run ``smarttac node`` or ``plate`` as a process, from when it is ready to the block's end.

    If this process is killed, the node ends as by SIGTERM, at 0 V.

    Parameters
    ----------
    arguments
        The command and its own options.
    bus
        Options of `can.Bus`.
    realtime
        SCHED_FIFO priority for ``--realtime``; None without it.

    Raises
    ------
    BenchError
        With the last line of its output, if it ends before it is ready.
    """
    command = node_command(arguments, bus, realtime)
    with (
        TemporaryFile() as output,
        # In a session of its own: Ctrl-C does not end it before the bench has let go of it.
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
    """Run the stimulator, and before it its plate unless it is there; as `node_process` does.

    Parameters
    ----------
    bus
        Options of `can.Bus`.
    realtime
        SCHED_FIFO priority for ``--realtime``; None without it.
    plate_node
        Node-ID of a plate that is there already; None simulates one.

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
    """Return the command line of `node_process`, whose standard input has to be a pipe."""
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
    """Open a bus whose frames bear the kernel's time stamps, with room for many of them.

    Raises
    ------
    BusError
        If it cannot be opened, or is of an interface without such time stamps.
    """
    with opening(bus.get("interface"), bus.get("channel"), BusError):
        opened = can.Bus(**kept_here(bus))
    with opened:
        if not isinstance(opened, SocketcanBus | UdpMulticastBus):
            raise BusError(
                "the loop is timed by the kernel's time stamps, between processes: "
                f"socketcan or udp_multicast have them, {opened.channel_info} has not"
            )
        hold_more(opened)
        yield opened


@contextmanager
def listening(
    bus: Mapping[str, Any], can_ids: Iterable[int], feed: Callable[[float, Frame], None]
) -> Iterator[None]:
    """Feed frames on a bus, with the kernel's time stamps in s, until the block ends.

    A thread fetches them every 5 ms: were it woken by each, the loop that it times would wait for
    it. What came before the end is fed before the block is left.

    Raises
    ------
    BusError
        If the bus cannot be opened, or is of an interface without such time stamps; after the
        block, if it failed before.
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
                # Frames may come without end: what came later is not fed.
                while (message := received(opened, 0.0)) is not None and message.timestamp <= end:
                    frame = to_frame(message)
                    if frame is not None:
                        feed(message.timestamp, frame)
        except (can.CanError, OSError) as error:
            broken.append(error)

    with _stamped(bus) as opened:
        hear_only(opened, can_ids)
        with Background("listener", work, stop):
            yield
    if broken:
        raise BusError(f"the loop was timed until its bus failed: {broken[0]}") from broken[0]


def require_quiet(bus: Mapping[str, Any]) -> None:
    """Raise BusError if the bus cannot be timed, BenchError if a loop runs there already."""
    with _stamped(bus) as opened:
        end = monotonic() + _QUIET_S
        while (left := end - monotonic()) > 0:
            message = received(opened, left)
            if message is not None and message.arbitration_id == SYNC_ID:
                raise BenchError("somebody produces SYNC on this bus: end that loop first")


def require_free(bus: Mapping[str, Any], *ods: ObjectDictionary) -> None:
    """Raise BenchError if a node is on the bus with the node-ID of one of these.

    Raises
    ------
    BenchError
        If one answers, or its heartbeat comes.
    BusError
        If the bus cannot be timed, or carries no frames.
    """
    ids = {base + od.node_id: od.node_id for od in ods for base in (SDO_TX_ID, HEARTBEAT_ID)}
    with _stamped(bus) as opened:
        try:
            for od in ods:
                opened.send(to_message(upload(od.node_id, od.entry(DEVICE_TYPE))))
            end = monotonic() + _ANSWER_S
            while (left := end - monotonic()) > 0:
                message = received(opened, left)
                if message is not None and message.arbitration_id in ids:
                    raise BenchError(
                        f"a node {ids[message.arbitration_id]} is on this bus already, and two "
                        "would have one node-ID: end it, or give it another by LSS or --node-id"
                    )
        except can.CanError as error:
            raise BusError(f"the bus carries no frames: {error}") from error


@dataclass(frozen=True)
class LoopRun:
    """Outcome of a timed run of the loop."""

    timing: LoopTiming
    ran: bool
    """Whether it ever was in RUNNING."""
    state: State | None
    """State of the stimulator at the end; None if it did not answer."""
    message: str
    """Why it did not run, or not to the end; empty if it did, or was not to."""
    refused: tuple[str, ...]
    """What the system refused its processes of their real-time priority, a line each."""


def regulate_friction(bench: Stimulator) -> None:
    """Start a run in mode friction, with a finger that strokes, and fail as `Stimulator` does."""
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
    """Start a stimulator, and its plate unless it is there; time the loop; end what was started.

    Parameters
    ----------
    bus
        Options of `can.Bus`.
    plate_node
        Node-ID of a plate that is there already, which stays at 0 V; None simulates one, with a
        finger, and regulates its friction.
    realtime
        SCHED_FIFO priority of the processes; None without.
    seconds
        How long to measure.
    stop
        Ends it early; asked ten times a second.
    progress
        Called as often with the seconds that have passed and what there is until now.

    Raises
    ------
    BenchError
        If a process ends, a node does not answer, or another loop runs on the bus, or a node with
        the node-ID of one that would be started.
    BusError
        If the bus cannot be opened, or has no time stamps.
    """
    require_free(bus, stimulator_od(), *([plate_od()] if plate_node is None else []))
    require_quiet(bus)
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
        # It need not answer any more: the nodes end next, which leaves 0 V as well.
        with suppress(BenchError), bench:
            pass


def _try_to_run(bench: Stimulator) -> str:
    """Regulate friction, at the first try or a later one; return what is wrong with the last."""
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
    """Return the state at the end, and why it is not RUNNING."""
    try:
        return bench.state, reason or bench.message
    except BenchError as error:
        return None, str(error)
