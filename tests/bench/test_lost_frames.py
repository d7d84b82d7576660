"""A node that dies ends a run with an error that says so; nothing waits for ever."""

import random
import time
from collections import deque
from typing import Any

import can
import pytest
from nodes_on_a_bus import GUARD_S, both, in_threads, stimulator_with_plate

from smarttac_can.bench import HeartbeatLostError, NotRunningError, Stimulator
from smarttac_can.bench.can_link import over_can
from smarttac_can.bench.network import LocalNetwork
from smarttac_can.canopen.bus.local_bus import Connection, LocalBus
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.host.python_can import PythonCanBus


def local_bench() -> tuple[Stimulator, list[Connection]]:
    bus = LocalBus()
    ports = [bus.attach(node) for node in both()]
    bench = Stimulator(
        *over_can(LocalNetwork(bus), 32, 33, where="local", lockstep=True, timeout=0.0)
    )
    return bench, ports


def answer_within(bench: Stimulator, seconds: float) -> None:
    """Wait no longer from now on for SDO answers, of which none is expected."""
    for device in bench._link._devices:  # type: ignore[attr-defined]
        device._sdo.RESPONSE_TIMEOUT = seconds


def test_a_node_pulled_off_in_the_middle_of_a_run() -> None:
    bench, (plate, _) = local_bench()
    syncs = 0

    def pull(_can_id: int, _data: bytes, _time: float) -> None:
        nonlocal syncs
        syncs += 1
        if syncs == 50:
            plate.close()

    link = bench._link
    link._network.subscribe(0x221, pull)  # type: ignore[attr-defined]
    with pytest.raises(NotRunningError, match="3 cycles in a row were lost"):
        bench.run(1.0)
    assert syncs == 50


def test_a_cycle_with_a_lost_tpdo_gives_no_row() -> None:
    """TPDO 2 of the fourth cycle: the values of the third one are not those of its row."""
    bench, _ = local_bench()
    heard = bench._link._network.subscribers[0x2A0]  # type: ignore[attr-defined]
    (hear,) = heard
    cycles = 0

    def lossy(*message: Any) -> None:
        nonlocal cycles
        cycles += 1
        if cycles != 4:
            hear(*message)

    heard[:] = [lossy]
    assert bench.run(0.006).tick.tolist() == [0, 1, 2, 4, 5]


@pytest.mark.parametrize("who", [0, 1], ids=["plate", "stimulator"])
def test_a_node_that_dies(
    who: int, virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes = both()
    with in_threads(virtual, nodes[1 - who]), in_threads(virtual, nodes[who]) as death:
        bench = Stimulator.connect(**virtual, plate_node_id=33, lockstep=True)
        cycles = 0

        def kill(_can_id: int, _data: bytes, _time: float) -> None:
            nonlocal cycles
            cycles += 1
            if cycles == 50:
                death.set()
                # Only of a node that is dead it is not waited for.
                monkeypatch.setattr("smarttac_can.bench.can_link.SILENT_S", 0.5)
                answer_within(bench, 0.5)

        with pytest.raises(HeartbeatLostError, match=r"^node 3[23] has answered nothing"), bench:
            bench._link._network.subscribe(0x2A0, kill)  # type: ignore[attr-defined]
            bench.run(1000.0)


class SlowBus(PythonCanBus):
    """Its party is held up in the 20th cycle, until the nodes have been asked twice."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.syncs = 0
        read = self.read

        def slow(frames: deque[Frame]) -> bool:
            before = len(frames)
            more = read(frames)
            for frame in list(frames)[before:]:
                if frame.can_id == cia.SYNC_ID:
                    self.syncs += 1
                    if self.syncs == 20:
                        time.sleep(1.5)
            return more

        self.read = slow


@pytest.mark.parametrize("inside", [True, False])
def test_a_slow_cycle_is_no_lost_one(
    inside: bool, virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nodes_on_a_bus.PythonCanBus", SlowBus)
    nodes = (stimulator_with_plate(),) if inside else both()
    plate = {} if inside else {"plate_node_id": 33}
    with (
        in_threads(virtual, *nodes),
        Stimulator.connect(**virtual, **plate, lockstep=True) as bench,
    ):
        assert bench.run(0.05).tick.tolist() == list(range(50))


def test_a_lost_cycle_is_known_without_waiting_for_the_clock(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.bench.can_link.SILENT_S", GUARD_S)
    plate, stimulator = both()
    with (
        in_threads(virtual, plate, stimulator),
        Stimulator.connect(**virtual, plate_node_id=33, lockstep=True) as bench,
    ):
        bench.run(0.01)
        link = bench._link
        device = link._plate  # type: ignore[attr-defined]
        device.write(device.od.entry(0x1801, 1), 0x800002A1)
        with pytest.raises(NotRunningError, match="3 cycles in a row were lost"):
            bench.run(10.0)
        assert plate.od["Cycle.Ticks"].value == 13


class LossyBus(PythonCanBus):
    """Loses one frame in 250 of those that carry the loop."""

    def __init__(self, seed: int, options: dict[str, Any]) -> None:
        super().__init__(**options)
        draw, send = random.Random(seed), self.send

        def lossy(frame: Frame) -> None:
            if not 0x180 <= frame.can_id < 0x500 or draw.random() >= 0.004:
                send(frame)

        self.send = lossy


def test_lost_frames_cost_rows_and_no_more(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds = iter((1, 2))
    monkeypatch.setattr("nodes_on_a_bus.PythonCanBus", lambda **bus: LossyBus(next(seeds), bus))
    with (
        in_threads(virtual, *both()),
        Stimulator.connect(**virtual, plate_node_id=33, lockstep=True) as bench,
    ):
        bench.amplitude = 1.0
        bench.mode = "amplitude"
        trace = bench.run(0.4)
        assert 300 < len(trace) < 400
        assert trace.tick[-1] - trace.tick[0] > 380, "the plate goes on"
        assert bench.get("Cycle.Lost cycles") > 0
        # A row is never mixed of two cycles, nor a drive applied twice.
        assert abs(trace.amplitude_um[-50:].mean() - 1.0) < 0.1


@pytest.mark.parametrize(
    ("command", "message"),
    [(0x80, "3 cycles in a row were lost"), (0x02, "node 32 does not answer")],
)
def test_run_ends_when_another_master_stops_the_stimulator(
    command: int, message: str, virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def nmt(command: int) -> None:
        master.send(can.Message(arbitration_id=0, data=[command, 32], is_extended_id=False))

    with (
        in_threads(virtual, stimulator_with_plate()),
        can.Bus(**virtual) as master,
        Stimulator.connect(**virtual, lockstep=True) as bench,
    ):
        bench.run(0.005)
        monkeypatch.setattr("smarttac_can.bench.can_link.SILENT_S", 1.0)
        answer_within(bench, 1.0)
        nmt(command)
        with pytest.raises(BenchError, match=message):
            bench.run(0.05)
        nmt(0x01)
        assert len(bench.run(0.05)) == 50
