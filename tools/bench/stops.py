"""How long the plate keeps a voltage after something has happened, measured at its stage.

    tools/bench/measure stops [--realtime P] [--repeats N] [--json]

Plate, stimulator and a bench that drives 40 V in open loop are processes of their own over
udp_multicast, in real time, new ones for each repeat of each case. The stage's voltage is read by
SDO as fast as it goes. The figure is the time of the first reading of 0 V; the stage was at
0 V at some time after the last reading above 0 V was asked for, which is the uncertainty: a bound
is broken if that reading was asked for later than the bound and the longest standstill of the
machine together, as sleepers of a higher priority have seen it in that repeat. What the loop
does not live to see is not measured, and said. Linux only; exit code 1 if a bound was broken, or
0 V did not last.

Example: tools/bench/measure stops --repeats 5
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from time import monotonic, sleep
from typing import Any, NamedTuple

import click
from harness import finished, own_bus, parser_of, show
from stage_watch import Moment, StageWatch
from standstill import Machine, forked, watching_machine

from smarttac_can.assurance.timing.loop_run import NodeProcess, loop_processes, require_free
from smarttac_can.bench.remote_device import bench_id
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.instrument.nodes.loop_frames import crc8
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.states import Mode
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, watchdogs_in

BUS = own_bus("239.74.163.79")
VOLTAGE_V = 40.0
LAG_MS = 20
"""By how much device time may be behind the clock: in every bound by a heartbeat."""
BENCH_MS = 1000 + LAG_MS
"""The watch of the bench; its last heartbeat was up to 100 ms before."""
BENCH_EARLIEST_MS = 900
MASTER_MS = 500
TOLD_MS = 1000
PAUSE_S = 0.2
RUNNING_S = 1.0
"""How long the loop has to run under a flood before it is ended."""
LASTING_S = 0.2
LONGEST_MS = 100
"""Longest deadline of the loop, where the deadline is not the bound."""
GUARD_S = 30.0
TRIES = 5
FOREIGN_ID = 0x333
SDO_ABORT = b"\x80" + bytes(7)
"""A server has no answer to it."""
_FORK = multiprocessing.get_context("fork")


class BoundError(Exception):
    """0 V did not come, did not last, or was not told as it has to be."""


class TripError(Exception):
    """The loop did not run any more before the case began."""


class Stop(NamedTuple):
    """0 V came after one time and before the other, in s since something happened."""

    after: float
    before: float


def drive(pipe: Connection) -> None:
    """Be a bench script that drives; tell why not, or that it does, and stay."""
    reason = ""
    with Stimulator.connect(plate_node_id=PLATE_ID, **BUS) as bench:
        for _ in range(TRIES):
            try:
                bench.disarm()
                bench.reset_fault()
                bench.start_run()
                bench.tare()
                bench.voltage = VOLTAGE_V
                bench.mode = Mode.OPEN_LOOP
            except BenchError as error:
                reason = str(error)
            else:
                reason = ""
                break
        pipe.send(reason)
        signal.pause()


def flood(can_id: int, count: Any) -> None:
    """Send a frame as fast as the socket takes it."""
    bus = PythonCanBus(**BUS)
    frame = Frame(can_id, SDO_ABORT)
    while True:
        with suppress(QueueFullError):
            bus.send(frame)
            count.value += 1


@dataclass
class Scene:
    """A loop that drives, and the watch over its stage."""

    watch: StageWatch
    nodes: dict[str, NodeProcess]
    bench: Any
    deadline_ms: int
    notes: dict[str, Any] = field(default_factory=dict)

    def require_voltage(self) -> None:
        """Raise TripError if the stage is at 0 V."""
        if not self.watch.read_stage().raw:
            raise TripError(self.reason())

    def reason(self) -> str:
        """Return why the loop does not run any more."""
        bits = self.watch.read(STIMULATOR_ID, stimulator_od()["Diagnosis.Latched"])
        texts = [WATCHDOGS[watchdog].text for watchdog in watchdogs_in(bits)]
        return "; ".join(texts) or "no fault"

    def wait_for_voltage(self) -> None:
        """Return at the first reading above 0 V; raises TripError."""
        end = monotonic() + RUNNING_S
        while not self.watch.read_stage().raw:
            if monotonic() > end:
                raise TripError(self.reason())

    def keep_running(self) -> None:
        """Read a voltage for some time; raises TripError."""
        end = monotonic() + RUNNING_S
        while monotonic() < end:
            self.require_voltage()

    def send(self, party: str, number: int) -> Moment:
        """Send a signal to a process; return when."""
        begun = monotonic()
        os.kill((self.nodes | {"bench": self.bench})[party].pid, number)
        return Moment(begun, monotonic())

    def require_parting(self, party: str) -> None:
        """Return when a node has ended; raises BoundError unless its last word is that of 0 V."""
        end = monotonic() + GUARD_S
        try:
            while monotonic() < end:
                self.nodes[party].require_alive()
                sleep(1e-3)
        except BenchError as error:
            if not str(error).endswith("stopped at 0 V"):
                raise BoundError(str(error)) from None
        else:
            raise BoundError("the process does not end")

    def rest(self, since: Moment) -> Stop:
        """Read until the stage is at 0 V, and see that it stays there."""
        last = since.over
        while (reading := self.watch.read_stage()).raw:
            last = reading.asked
            if last > since.over + GUARD_S:
                raise BoundError(f"a voltage after {GUARD_S:.0f} s")
        self.require_rest()
        return Stop(last - since.over, reading.answered - since.begun)

    def require_rest(self) -> None:
        """Raise BoundError if there is a voltage again."""
        end = monotonic() + LASTING_S
        while monotonic() < end:
            if self.watch.read_stage().raw:
                raise BoundError("a voltage after 0 V")


Act = Callable[[Scene], Stop]


def signalled(party: str, number: int) -> Act:
    """End or stop a process."""

    def act(scene: Scene) -> Stop:
        scene.require_voltage()
        return scene.rest(scene.send(party, number))

    return act


def told(party: str) -> Act:
    """Tell a node to end; that of a plate that is gone cannot be read, but its end can be seen."""

    def act(scene: Scene) -> Stop:
        scene.require_voltage()
        since = scene.send(party, signal.SIGTERM)
        stop = None if party == "plate" else scene.rest(since)
        scene.require_parting(party)
        return stop or Stop(0.0, monotonic() - since.begun)

    return act


def paused(scene: Scene) -> Stop:
    """Stop the plate, have drives of its next ticks wait in its queue, and let it go on."""
    watch = scene.watch
    watch.forget_errors(PLATE_ID)
    scene.require_voltage()
    scene.send("plate", signal.SIGSTOP)
    # Before the stimulator notices, whose 0 V would allow a voltage again.
    for tick in range(watch.tick, watch.tick + 4):
        values = struct.pack("<HIB", round(VOLTAGE_V * 100), 4_339_000, tick & 0xFF)
        watch.send(cia.RPDO_IDS[0] + PLATE_ID, values + bytes((crc8(values),)))
    watch.ask()
    watch.listen(PAUSE_S)
    stop = scene.rest(scene.send("plate", signal.SIGCONT))
    if FaultCode.DRIVE_LOST not in watch.errors(PLATE_ID):
        raise BoundError("the plate does not say 8253h")
    return stop


def flooded(node_id: int, can_id: int) -> Act:
    """Fall silent, as the master that a node watches, in a flood."""

    def act(scene: Scene) -> Stop:
        watch = scene.watch
        ods = {PLATE_ID: plate_od(), STIMULATOR_ID: stimulator_od()}
        # The master takes the place of the bench, whose watch no write takes away from a run:
        # python-canopen in a flood would take a processor.
        watch.beats_as = bench_id(STIMULATOR_ID)
        watch.beats = True
        watch.listen(PAUSE_S)
        scene.send("bench", signal.SIGKILL)
        entries = [ods[node_id].entry(cia.HEARTBEAT_CONSUMER, subindex) for subindex in range(1, 5)]
        own = [e for e in entries if watch.read(node_id, e) >> 16 == watch.beats_as]
        watch.write(node_id, (own or entries)[0], watch.beats_as << 16 | MASTER_MS)
        scene.keep_running()
        count = _FORK.RawValue("Q")
        start = monotonic()
        with forked(flood, can_id, count):
            try:
                scene.keep_running()
                watch.beats = False
                return scene.rest(watch.beaten)
            finally:
                scene.notes["flood_per_s"] = round(count.value / (monotonic() - start))

    return act


class Case(NamedTuple):
    """An event, and the time after it within which the stage has to be at 0 V."""

    name: str
    bound_ms: int | None
    """None for the deadline of the plate, 1400h sub-index 5."""
    act: Act
    earliest_ms: int = 0
    """A sooner end of the loop is by another watch."""


CASES = (
    Case("stimulator, SIGKILL", None, signalled("stimulator", signal.SIGKILL)),
    Case("stimulator, SIGSTOP", None, signalled("stimulator", signal.SIGSTOP)),
    Case("stimulator, SIGTERM", None, told("stimulator")),
    Case("bench, SIGKILL", BENCH_MS, signalled("bench", signal.SIGKILL), BENCH_EARLIEST_MS),
    Case("bench, SIGSTOP", BENCH_MS, signalled("bench", signal.SIGSTOP), BENCH_EARLIEST_MS),
    Case("bench, SIGTERM", BENCH_MS, signalled("bench", signal.SIGTERM), BENCH_EARLIEST_MS),
    Case("plate, SIGTERM: process ended", TOLD_MS, told("plate")),
    Case("plate, SIGSTOP 200 ms, from SIGCONT", 0, paused),
    *(
        Case(
            f"{name} misses a master, {what} flood",
            MASTER_MS + LAG_MS,
            flooded(node, can_id),
            MASTER_MS,
        )
        for name, node in (("stimulator", STIMULATOR_ID), ("plate", PLATE_ID))
        for what, can_id in (("foreign", FOREIGN_ID), ("SDO", cia.SDO_RX_ID + node))
    ),
)


@contextmanager
def scene(case: Case, realtime: int | None, refused: set[str]) -> Iterator[Scene]:
    """Have a loop that drives.

    Raises
    ------
    BenchError
        If a process does not start.
    TripError
        If it did not come to drive.
    """
    with ExitStack() as stack:
        watch = stack.enter_context(StageWatch(**BUS))
        plate, stimulator = stack.enter_context(loop_processes(BUS, realtime))
        nodes = {"plate": plate, "stimulator": stimulator}
        for node in nodes.values():
            refused.update(node.refused)
            # One that is stopped would not hear that it has to end.
            stack.callback(let_go_on, node.pid)
        if case.bound_ms is not None:
            watch.set_deadlines(LONGEST_MS)
        here, there = _FORK.Pipe()
        bench = stack.enter_context(forked(drive, there))
        there.close()
        if not here.poll(GUARD_S):
            raise BenchError("the bench says nothing")
        try:
            reason = here.recv()
        except EOFError:
            raise BenchError("the bench has ended") from None
        if reason:
            raise TripError(reason)
        made = Scene(watch, nodes, bench, watch.deadline_ms())
        made.wait_for_voltage()
        yield made


def let_go_on(pid: int) -> None:
    """Continue a process, if it is there."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)


def measured(
    case: Case, realtime: int | None, repeats: int, refused: set[str], machine: Machine
) -> dict[str, Any]:
    """Have a case happen again and again, and return its row."""
    bound_ms = case.bound_ms
    stops: list[Stop] = []
    late = 0
    stalled_ms = [0.0]
    broken: list[str] = []
    tripped: list[str] = []
    emergencies: dict[tuple[int, int], None] = {}
    notes: dict[str, Any] = {}
    while len(stops) + len(broken) < repeats and len(tripped) < TRIES + repeats:
        try:
            with scene(case, realtime, refused) as here:
                bound_ms = here.deadline_ms if case.bound_ms is None else case.bound_ms
                here.watch.emergencies.clear()
                machine.forget()
                try:
                    stop = case.act(here)
                    stood_ms = max(machine.longest_s) * 1e3
                    if stood_ms > LAG_MS:
                        raise TripError(f"the machine stood still for {stood_ms:.0f} ms")
                    if stop.before * 1e3 < case.earliest_ms:
                        raise TripError(here.reason())
                    stops.append(stop)
                    stalled_ms.append(stood_ms)
                    late += stop.after * 1e3 > bound_ms + stood_ms
                finally:
                    emergencies.update(dict.fromkeys(here.watch.emergencies))
                    notes.update(here.notes)
        except BoundError as error:
            broken.append(str(error))
        except TripError as error:
            tripped.append(str(error))
    before = [round(stop.before * 1e3, 1) for stop in stops]
    return {
        "case": case.name,
        "bound_ms": bound_ms,
        "at_0_v_after_ms": [min(before), max(before)] if before else None,
        "uncertainty_ms": max((round((s.before - s.after) * 1e3, 1) for s in stops), default=None),
        "ok": not late and not broken if stops or broken else None,
        "measured": len(stops),
        "late": late,
        "stalled_ms": round(max(stalled_ms), 1),
        "broken": broken,
        "tripped_before": tripped,
        "emergencies": [f"{node_id}: {code:04X}h" for node_id, code in emergencies],
        **notes,
    }


def run(realtime: int | None, repeats: int) -> dict[str, Any]:
    """Measure all cases; raises BenchError or BusError if that cannot be done."""
    load = [round(os.getloadavg()[0], 1)]
    refused: set[str] = set()
    require_free(BUS)
    with (
        watching_machine(realtime) as machine,
        click.progressbar(CASES, label="cases", file=sys.stderr) as bar,
    ):
        rows = [measured(case, realtime, repeats, refused, machine) for case in bar]
    load.append(round(os.getloadavg()[0], 1))
    return {
        "realtime": realtime,
        "refused": sorted(refused),
        "processors": len(machine.cores),
        "sleepers_fifo": machine.fifo,
        "load": load,
        "cases": rows,
    }


def main() -> int:
    """Measure and print."""
    parser = parser_of(__doc__, realtime=True)
    parser.add_argument("--repeats", type=int, default=5, help="of each case (default 5)")
    arguments = parser.parse_args()
    if arguments.repeats < 1:
        parser.error(f"--repeats {arguments.repeats} is below 1")

    def measure() -> int:
        results = run(arguments.realtime, arguments.repeats)
        show(results, as_json=arguments.json)
        broken = sum(row["ok"] is False for row in results["cases"])
        if not arguments.json:
            print(f"{len(CASES)} cases, {broken} with a bound that was broken")
        return int(broken > 0)

    return finished(measure, BenchError, BusError)
