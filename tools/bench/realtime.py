"""How well the loop keeps real time on this machine, for as long as you like.

    tools/bench/measure realtime --seconds S [--realtime P] [--deadline MS] [BESIDE] [--json]
    tools/bench/measure realtime --seconds S --against TREE [--pairs N] [BESIDE] [--json]

Plate, stimulator and a bench that records are processes of their own over udp_multicast. The bench
starts a run, tares, regulates the friction of a finger for 5 s and stops, again and again; a fault
is counted and reset. A passive listener times the frames. On each core a sleeper of the highest
priority sees whether the machine itself stands still: if one was late by more than 1 ms, the run
promises nothing and is void; each trip tells how long the machine had stood still just before it.
Linux only; exit code 1 if the loop never ran.

`--against TREE` runs this tool and that of another working tree in turn, `--pairs` times, each with
the package of its tree; every second pair starts with the other tree. It prints the mean over the
runs of each tree, their ratio (this tree / other tree), and the 95 % bootstrap interval of the
ratio. The interval is left out where a resample of the other tree sums to 0. Processor time is user
+ system per tick.

BESIDE names other load: `--hogs N` processes that keep the cores busy; `--panel`, a `smarttac
panel` with a page that answers each update as a browser does; `--sdo BYTES`, a client that reads an
object of the stimulator, and moves so many bytes to and from a plain device on the same bus by
block transfer, with python-canopen. Its rates are shares of the bare one, that of a python-can send
and receive of one frame after the other; a transfer that fails or changes the data is an error.
With `--against .` each pair is the loop with panel and client, and without.

Example: tools/bench/measure realtime --seconds 600 --hogs 4
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import can
import canopen
import click
import harness
import numpy as np
from canopen.sdo.exceptions import SdoError
from harness import (
    ROOT,
    add_against,
    by_turns,
    finished,
    own_bus,
    parser_of,
    results_in,
    show,
    tree_of,
)
from stage_watch import StageWatch
from standstill import Machine, forked, watching_machine

from smarttac_can.assurance.timing.loop_run import (
    COF,
    listening,
    loop_processes,
    node_command,
    node_process,
    regulate_friction,
    require_free,
)
from smarttac_can.assurance.timing.loop_timing import Delays, LoopTiming
from smarttac_can.bench.errors import FaultError
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Trace
from smarttac_can.canopen.bus.bus import BusError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.host.kernel_filter import receive_only
from smarttac_can.vocabulary.signals import MEASUREMENT_RPDOS
from smarttac_can.vocabulary.states import State

BUS = own_bus("239.74.163.78")
RECORDED_S = 5.0
SHORTEST_S = 0.5
SETTLED_TICKS = 1000
COF_BAND = 0.05
TOOL, NAME = "tools/bench/measure", "realtime"
NICE = -10
PAUSE_S = 0.2
STARTING_S, PARTING_S = 60.0, 10.0
"""Most time for the start and end of a run, and for a process that has been told to end."""
LAG_MS = 20
"""By how much longer a standstill takes effect: a node that comes late hears its queue."""
EMCY_IDS = frozenset(cia.EMCY_ID + node_id for node_id in (PLATE_ID, STIMULATOR_ID))
RICH_EDS = ROOT / "tests" / "eds" / "rich.eds"
DEVICE_ID = 5
BARE_ID = 0x601
BARE_S = 3.0
LOST_S = 2.0
READS = 200
"""SDO reads before each pair of transfers."""
SEGMENT = 7
SUB_BLOCK = 127
Beside = tuple[dict[str, int], Callable[[], dict[str, Any]]]
"""Process IDs by name, and the source of the figures until now."""


class Trip(NamedTuple):
    """A run that ended in a fault: why, and between which times in s since the epoch."""

    message: str
    begin: float
    end: float


@dataclass
class Tally:
    """Figures of the bench."""

    deadline_ms: dict[str, int] = field(default_factory=dict)
    cycles_recorded: int = 0
    cycles_running: int = 0
    trips: list[Trip] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    """Why runs could not be started or recorded."""
    cof_error: list[float] = field(default_factory=list)
    """Median distance of the COF from its reference in each recording, while touching."""


def hog() -> None:
    """Keep a core busy."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    while True:
        pass


def regulate(end: float, pipe: Connection) -> None:
    """Regulate friction and record it, again and again; send the tally when the time is over."""
    tally = Tally()
    try:
        tally.deadline_ms = deadlines()
        bench = Stimulator.connect(plate_node_id=PLATE_ID, **BUS)
    except BenchError as error:
        pipe.send(error)
        return
    pipe.send(None)
    try:
        with bench:
            while (left := end - time.monotonic()) > SHORTEST_S:
                try:
                    record(bench, min(RECORDED_S, left), tally)
                except BenchError as error:
                    tally.refused.append(str(error))
                    time.sleep(PAUSE_S)
    except BenchError as error:
        tally.refused.append(str(error))
    pipe.send(tally)


def record(bench: Stimulator, seconds: float, tally: Tally) -> None:
    """Regulate and record once, and stop; a fault that comes is noted, one that is there reset."""
    begin = time.time()
    bench.disarm()
    bench.reset_fault()
    try:
        regulate_friction(bench)
        count(tally, bench.run(seconds))
    except FaultError as error:
        if error.trace is not None:
            count(tally, error.trace)
    finally:
        if bench.state is State.FAULT:
            tally.trips.append(Trip(bench.message, begin, time.time()))


def count(tally: Tally, trace: Trace) -> None:
    """Count cycles, and see that the friction is regulated: only mode friction has a reference."""
    running = trace.cof_reference > 0
    tally.cycles_recorded += len(trace)
    tally.cycles_running += int(running.sum())
    settled = running & (trace.cof > 0) & (np.arange(len(trace)) >= SETTLED_TICKS)
    if settled.any():
        tally.cof_error.append(float(np.median(np.abs(trace.cof[settled] - COF))))


def received(pipe: Connection) -> Any:
    """Receive something from a process of the tool, or raise its BenchError."""
    try:
        what = pipe.recv()
    except EOFError:
        raise BenchError("a process that measures has ended") from None
    if isinstance(what, BenchError):
        raise what
    return what


def deadlines() -> dict[str, int]:
    """Ask the nodes for the deadlines of measurement and drive in ms."""
    index = cia.RPDO_COMMUNICATION + MEASUREMENT_RPDOS[0] - 1
    with StageWatch(**BUS) as watch:
        measurement = watch.read(STIMULATOR_ID, stimulator_od().entry(index, cia.PDO_EVENT))
        return {"measurement": measurement, "drive": watch.deadline_ms()}


@contextmanager
def panel_beside() -> Iterator[Beside]:
    """Run a panel that only looks on, and a page."""
    options = ("panel", "--plate-node", f"{PLATE_ID}", "--port", "0")
    with subprocess.Popen(
        node_command(options, BUS, None), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            first = process.stdout.readline()
            if not first:
                raise BenchError("smarttac panel has ended")
            updates = multiprocessing.get_context("fork").Value("q", 0)
            url = first.split(": ")[1].partition("/#")[0]
            with forked(look_on, url, updates) as page:
                while not updates.value:
                    if not page.is_alive():
                        raise BenchError("the page of the panel has ended")
                    time.sleep(PAUSE_S)
                before, begun = updates.value, time.monotonic()

                def figures() -> dict[str, Any]:
                    rate = (updates.value - before) / (time.monotonic() - begun)
                    return {"updates_per_s": round(rate, 1)}

                yield {"panel": process.pid}, figures
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(PARTING_S)
            process.kill()


def look_on(url: str, updates: Any) -> None:
    """Be a page: answer each update, and count them."""
    from aiohttp import ClientSession  # noqa: PLC0415 - an extra

    async def answer() -> None:
        async with (
            ClientSession() as session,
            session.ws_connect(f"{url}/live", headers={"Origin": url}) as socket,
        ):
            async for message in socket:
                update = json.loads(message.data)
                if "n" in update:
                    await socket.send_str(json.dumps({"do": "seen", "n": update["n"]}))
                    updates.value += 1

    asyncio.run(answer())


@contextmanager
def sdo_beside(size: int) -> Iterator[Beside]:
    """Run a plain device, and a client that reads and moves so many bytes again and again."""
    plain = ["device", "--eds", str(RICH_EDS), "--node-id", str(DEVICE_ID)]
    here, there = multiprocessing.get_context("fork").Pipe()
    with node_process(plain, BUS, None), forked(be_client, size, there):
        there.close()
        bare = received(here)
        rounds: list[tuple[list[float], float, float]] = []

        def figures() -> dict[str, Any]:
            while here.poll():
                rounds.append(received(here))
            if not rounds:
                return {"transfers": 0}
            times, down, up = zip(*rounds, strict=True)
            return {
                "transfers": len(rounds),
                "answer_p50_ms": round(float(np.percentile(times, 50)), 3),
                "answer_p99_ms": round(float(np.percentile(times, 99)), 3),
                "bare_frames_per_s": round(bare),
                "block_download_share_of_bare": round(min(down) / bare, 3),
                "block_upload_share_of_bare": round(min(up) / bare, 3),
            }

        yield {}, figures


def be_client(size: int, pipe: Connection) -> None:
    """Send the bare rate, then the figures of each round, or the error."""
    od = load_eds(RICH_EDS.read_text(encoding="ascii"), DEVICE_ID)
    domain = next(e for e in od if e.data_type.name == "DOMAIN" and e.writable)
    cof = stimulator_od()["Contact.COF"]
    network = canopen.Network()
    try:
        pipe.send(bare_rate())
        network.connect(**BUS)
        # It would hear itself and the loop as well, which is more than python-canopen can take.
        receive_only(network.bus, [cia.SDO_TX_ID + DEVICE_ID])
        sdo = network.add_node(DEVICE_ID, canopen.ObjectDictionary()).sdo
        sdo.RESPONSE_TIMEOUT = 2.0
        # It takes the answers to its own requests alone: the bench is a client of the node as well.
        with StageWatch(**BUS) as watch:
            while True:
                times = []
                for _ in range(READS):
                    start = time.perf_counter()
                    watch.read(STIMULATOR_ID, cof)
                    times.append((time.perf_counter() - start) * 1e3)
                pipe.send((times, *block_rates(sdo, domain.index, size)))
    except (BenchError, SdoError, can.CanError) as error:
        pipe.send(BenchError(f"the client failed: {error}"))
    finally:
        network.disconnect()


def bare_rate() -> float:
    """Frames/s of a send and receive of one frame after the other, between all others."""
    message = can.Message(arbitration_id=BARE_ID, data=bytes(8), is_extended_id=False)
    frames, start = 0, time.perf_counter()
    with can.Bus(**BUS) as sender, can.Bus(**BUS) as receiver:
        while (sent := time.perf_counter()) < start + BARE_S:
            sender.send(message)
            # A lost frame would be waited for without end, because others always come.
            while (left := sent + LOST_S - time.perf_counter()) > 0:
                came = receiver.recv(left)
                if came is not None and came.arbitration_id == BARE_ID:
                    break
            else:
                raise BenchError("a frame of the bare rate was lost")
            frames += 1
    return frames / (time.perf_counter() - start)


def block_rates(sdo: canopen.sdo.SdoClient, index: int, size: int) -> tuple[float, float]:
    """Frames/s of a block download and of a block upload of so many bytes."""
    data = os.urandom(size)
    start = time.perf_counter()
    with sdo.open(
        index, 0, "wb", size=size, block_transfer=True, buffering=SEGMENT * SUB_BLOCK
    ) as stream:
        stream.write(data)
    down = time.perf_counter() - start
    start = time.perf_counter()
    with sdo.open(index, 0, "rb", block_transfer=True) as stream:
        back = stream.read()
    up = time.perf_counter() - start
    if data != back:
        raise BenchError("the block transfer changed the data")
    return size / SEGMENT / down, size / SEGMENT / up


def cpu_seconds(pid: int) -> float:
    """Processor time that a process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def bounded(seconds: float) -> Iterator[None]:
    """Raise BenchError in any wait after so many seconds, and again in the next ones."""

    def late(_number: int, _frame: FrameType | None) -> None:
        raise BenchError(f"the run has not ended after {seconds:.0f} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds, PARTING_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def measured(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run everything, and return the results.

    Raises
    ------
    BenchError, BusError
        If the bus is in use, or a node ends.
    """
    realtime = arguments.realtime
    require_free(BUS)
    with bounded(arguments.seconds + STARTING_S), ExitStack() as stack:
        machine = stack.enter_context(watching_machine(realtime))
        for _ in range(arguments.hogs):
            stack.enter_context(forked(hog))
        processes = stack.enter_context(loop_processes(BUS, realtime))
        nodes = dict(zip(("plate", "node"), processes, strict=True))
        pids = {name: node.pid for name, node in nodes.items()}
        if arguments.deadline is not None:
            with StageWatch(**BUS) as watch:
                watch.set_deadlines(arguments.deadline)
        beside = []
        if arguments.panel:
            beside.append(stack.enter_context(panel_beside()))
        if arguments.sdo is not None:
            beside.append(stack.enter_context(sdo_beside(arguments.sdo)))
        for others, _ in beside:
            pids |= others
        if realtime is not None:
            # Bench and listener have to keep up beside the hogs; with SCHED_FIFO they would take
            # the share that the kernel leaves to such processes in all.
            with suppress(PermissionError):
                os.setpriority(os.PRIO_PROCESS, 0, NICE)
        here, there = multiprocessing.get_context("fork").Pipe()
        bench = stack.enter_context(forked(regulate, time.monotonic() + arguments.seconds, there))
        there.close()
        received(here)
        timing = LoopTiming(plate_od())
        emergencies: list[float] = []
        before = {name: cpu_seconds(pid) for name, pid in pids.items()}
        start = time.monotonic()

        def feed(stamp: float, frame: Frame) -> None:
            timing.feed(stamp, frame)
            if frame.can_id in EMCY_IDS and any(frame.data[:2]):
                emergencies.append(stamp)

        bar = click.progressbar(length=int(arguments.seconds), label="loop", file=sys.stderr)
        with listening(BUS, timing.can_ids | EMCY_IDS, feed), bar:
            machine.forget()  # the start took its time
            while not here.poll(SHORTEST_S) and bench.is_alive():
                for node in nodes.values():
                    node.require_alive()
                bar.update(int(time.monotonic() - start) - bar.pos)
                for _, figures in beside:
                    figures()  # a client that waits for its pipe would measure that
            elapsed = time.monotonic() - start
        cpu = {name: (cpu_seconds(pid) - before[name]) / elapsed for name, pid in pids.items()}
        tally = received(here)
        return {
            "seconds": round(elapsed, 1),
            "realtime": realtime,
            "hogs": arguments.hogs,
            **tallied(tally),
            **explained(tally, emergencies, machine),
            **timed(timing),
            "cpu_share": {name: round(share, 3) for name, share in cpu.items()},
            **{key: value for _, of in beside for key, value in of().items()},
            **shown(machine),
        }


def explained(tally: Tally, emergencies: list[float], machine: Machine) -> dict[str, Any]:
    """Return the trips, and for how long the machine stood still just before each, in ms."""
    before = (max(tally.deadline_ms.values()) + LAG_MS) * 1e-3
    trips = []
    for trip in tally.trips:
        told = max((t for t in emergencies if trip.begin <= t <= trip.end), default=trip.end)
        stood = machine.stood_s(told - before, told)
        trips.append({"message": trip.message, "stood_ms": round(stood * 1e3, 1)})
    return {"trips": trips, "trips_of_the_loop": sum(not trip["stood_ms"] for trip in trips)}


def shown(machine: Machine) -> dict[str, Any]:
    """Return the figures of the machine itself."""
    longest = [round(late * 1e6, 1) for late in machine.longest_s]
    standstills = machine.standstills
    return {
        "void": bool(standstills),
        "standstills": len(standstills),
        "sleepers": [
            {"core": core, "fifo": machine.fifo, "max_us": late}
            for core, late in zip(machine.cores, longest, strict=True)
        ],
    }


def tallied(tally: Tally) -> dict[str, Any]:
    """Return the figures of the bench, with the share of the cycles that ran."""
    share = tally.cycles_running / tally.cycles_recorded if tally.cycles_recorded else 0.0
    errors = tally.cof_error
    return asdict(tally) | {
        "running_share": round(share, 6),
        "cof_error": round(max(errors), 4) if errors else None,
    }


def timed(timing: LoopTiming) -> dict[str, Any]:
    """Return the figures of the listener."""
    if not timing.ran:
        raise BenchError("the loop never ran: no drive came")
    return {
        "ticks": timing.ticks,
        "missed": timing.missed,
        "missed_share": timing.missed / timing.ticks,
        "lost": timing.lost,
        "sync": quantiles(timing.sync),
        "measurement": quantiles(timing.measurement),
        "drive": quantiles(timing.drive),
        "gap_max_us": round(timing.gap_s * 1e6),
    }


def quantiles(delays: Delays) -> dict[str, int]:
    """Return the figures of `smarttac jitter`, and 99.99 %."""
    return delays.as_json() | {"p9999_us": delays.quantile_us(0.9999)}


def judged(results: dict[str, Any]) -> None:
    """Raise BenchError if another loop than the regulated one was measured."""
    if not results["cycles_running"]:
        reasons = [trip["message"] for trip in results["trips"]] + results["refused"]
        raise BenchError(f"the loop never ran: {reasons[-1] if reasons else 'no time'}")
    error = results["cof_error"]
    if error is not None and error > COF_BAND:
        raise BenchError(f"the COF was {error:.3f} beside its reference of {COF}")


def against(tree: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Run the tool of another tree and this one by turns, and return the compared figures."""
    options = ["--seconds", str(arguments.seconds), "--hogs", str(arguments.hogs), "--json"]
    for name in ("realtime", "deadline"):
        if (value := getattr(arguments, name)) is not None:
            options += [f"--{name}", str(value)]
    beside = ["--panel"] if arguments.panel else []
    beside += ["--sdo", str(arguments.sdo)] if arguments.sdo is not None else []
    here, other = by_turns(
        [
            lambda: results_in(ROOT, ROOT / TOOL, NAME, *options, *beside),
            lambda: results_in(tree, tree / TOOL, NAME, *options),
        ],
        arguments.pairs,
    )
    return compared(other, here)


def compared(other: list[dict[str, Any]], here: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of pairs of results, with their ratios where these can be told."""
    results: dict[str, Any] = {"pairs": len(here)}
    for name in figures(here[0]):
        before, now = ([figures(run)[name] for run in runs] for runs in (other, here))
        results[name] = harness.compared(before, now)
    for name in ("trips_of_the_loop", "standstills"):
        before, now = (sum(run[name] for run in runs) for runs in (other, here))
        results[name] = {"other": before, "here": now}
    if "updates_per_s" in here[0]:
        results["panel"] = {
            "cpu_share": [run["cpu_share"]["panel"] for run in here],
            "updates_per_s": [run["updates_per_s"] for run in here],
        }
    return results


def figures(run: dict[str, Any]) -> dict[str, float]:
    """Return the compared figures of a run."""
    tick_us = run["seconds"] * 1e6 / run["ticks"]
    return {
        "plate_us": run["cpu_share"]["plate"] * tick_us,
        "node_us": run["cpu_share"]["node"] * tick_us,
        "missed_per_1000": 1000 * run["missed_share"],
        "p50_us": run["drive"]["p50_us"],
        "p99_us": run["drive"]["p99_us"],
    }


def main() -> int:
    """Measure and print."""
    parser = parser_of(__doc__, realtime=True)
    parser.add_argument("--seconds", type=float, required=True, help="how long, 2 or more")
    parser.add_argument("--hogs", type=int, default=0, help="busy processes beside (default 0)")
    parser.add_argument("--panel", action="store_true", help="run a panel and a page beside")
    parser.add_argument("--sdo", type=int, metavar="BYTES", help="run an SDO client beside")
    parser.add_argument("--deadline", type=int, metavar="MS", help="of the loop, 1..100 (nodes')")
    add_against(parser, 10)
    arguments = parser.parse_args()
    if not 2 <= arguments.seconds < float("inf"):
        parser.error(f"--seconds {arguments.seconds} is below 2")
    if arguments.hogs < 0:
        parser.error(f"--hogs {arguments.hogs} is below 0")
    tree = None if arguments.against is None else tree_of(parser, arguments, TOOL)
    return finished(partial(run, arguments, tree), BenchError, BusError)


def run(arguments: argparse.Namespace, tree: Path | None) -> int:
    """Measure, or compare with another tree, and print."""
    results = measured(arguments) if tree is None else against(tree, arguments)
    show(results, as_json=arguments.json)
    if tree is None:
        judged(results)
    return 0
