"""Connecting to nodes that are there, that are others, or that go away; and leaving them at 0 V."""

import struct
import time
from contextlib import AbstractContextManager, nullcontext
from itertools import count
from typing import Any

import can
import pytest
from nodes_on_a_bus import GUARD_S, both, in_threads, stimulator_with_plate, until

from smarttac_can.bench import (
    BenchError,
    HeartbeatLostError,
    Mode,
    NodeNotFoundError,
    NotReadyError,
    NotRunningError,
    RefusedError,
    Stimulator,
    WrongDeviceError,
)
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode


def test_an_option_that_the_bus_would_swallow_is_refused() -> None:
    with pytest.raises(TypeError, match=r"virtual has no option .*; perhaps 'rx_queue_size'$"):
        Stimulator.connect(interface="virtual", rx_queue_sise=1)
    with pytest.raises(BenchError, match=r"; perhaps 'socketcan'$"):
        Stimulator.connect(interface="scoketcan")


@pytest.mark.parametrize(
    ("given", "meant"),
    [("plate_node", "plate_node_id"), ("nodeid", "node_id"), ("lock_step", "lockstep")],
)
def test_a_misspelt_argument_is_no_option_of_the_bus(
    virtual: dict[str, Any], given: str, meant: str
) -> None:
    with pytest.raises(TypeError, match=f"no argument '{given}', perhaps '{meant}'"):
        Stimulator.connect(**virtual, **{given: 33})


def test_no_node_answers(virtual: dict[str, Any]) -> None:
    with pytest.raises(NodeNotFoundError, match=r"no node 32 answers on virtual:.*: is it running"):
        Stimulator.connect(**virtual, timeout=0.05)


def test_another_node_id(virtual: dict[str, Any]) -> None:
    with in_threads(virtual, stimulator_with_plate()):
        with pytest.raises(NodeNotFoundError, match="no node 31 answers"):
            Stimulator.connect(**virtual, node_id=31, timeout=0.05)
        with pytest.raises(NodeNotFoundError, match="no node 33 answers"):
            Stimulator.connect(**virtual, plate_node_id=33)


def test_the_plate_is_not_the_stimulator(virtual: dict[str, Any]) -> None:
    with in_threads(virtual, *both()):
        with pytest.raises(WrongDeviceError, match=r"node 33 on .* has product code 534D5402, a "):
            Stimulator.connect(**virtual, node_id=33)
        with pytest.raises(WrongDeviceError, match=r"node 32 on .* has product code 534D5401, a "):
            Stimulator.connect(**virtual, plate_node_id=32)


def test_other_node_ids(virtual: dict[str, Any]) -> None:
    nodes = PlateNode(plate_od(2)), StimulatorNode(stimulator_od(1), plate_node_id=2)
    with (
        in_threads(virtual, *nodes),
        Stimulator.connect(**virtual, node_id=1, plate_node_id=2, lockstep=True) as bench,
    ):
        assert len(bench.run(0.05)) == 50


def test_the_interface_from_the_configuration(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(can.rc, "interface", "virtual")
    monkeypatch.setitem(can.rc, "channel", virtual["channel"])
    with in_threads(virtual, stimulator_with_plate()), Stimulator.connect(lockstep=True) as bench:
        assert len(bench.run(0.01)) == 10


@pytest.mark.parametrize("inside", [True, False])
def test_lockstep_with_a_node_in_real_time_is_named(virtual: dict[str, Any], inside: bool) -> None:
    nodes: tuple[StimulatorNode | PlateNode, ...] = (stimulator_with_plate(lockstep=False),)
    if not inside:
        stimulator = StimulatorNode(stimulator_od(), plate_node_id=33, produce_sync=True)
        nodes = (PlateNode(plate_od()), stimulator)
    with (
        in_threads(virtual, *nodes, lockstep=False),
        Stimulator.connect(**virtual, plate_node_id=None if inside else 33, lockstep=True) as bench,
    ):
        cure = (
            "node 32 runs in real time: connect without lockstep=True, or start all nodes with "
            "--lockstep"
        )
        # Whether it has tared itself by now decides on its first request.
        unready = f"^(the stimulator is not ready: )?{cure}"
        with pytest.raises((NotReadyError, NotRunningError), match=unready):
            bench.mode = "amplitude"
        for unwatched in (0, 1):
            bench.set("Drive unwatched", unwatched)
            with pytest.raises(NotRunningError, match=f"^{cure}"):
                bench.run(0.05)


@pytest.mark.parametrize("inside", [True, False])
def test_real_time_with_nodes_in_lockstep_is_named(
    virtual: dict[str, Any], inside: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.bench.can_link.GRACE_S", 0.2)
    nodes = (stimulator_with_plate(),) if inside else both()
    stands = (
        r"the time of node 32 stands still without SYNC: connect with lockstep=True, or start all "
        "nodes without --lockstep$"
    )
    with (
        in_threads(virtual, *nodes),
        Stimulator.connect(**virtual, plate_node_id=None if inside else 33) as bench,
    ):
        with pytest.raises(NotRunningError, match=f"^{stands}"):
            bench.run(0.01)
        with pytest.raises(NotRunningError, match=f"^{stands}"):
            bench.mode = "amplitude"


def test_connect_in_lockstep_names_a_missing_node_after_any_time(virtual: dict[str, Any]) -> None:
    with (
        in_threads(virtual, stimulator_with_plate()),
        Stimulator.connect(**virtual, lockstep=True) as bench,
    ):
        bench.set("Tare at power-on", 0)
        bench.start_run()
        with pytest.raises(NotReadyError, match="it has to be tared"):
            bench.arm()


def test_a_heartbeat_that_stays_away(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr("smarttac_can.bench.remote_device.monotonic", lambda: now)
    heartbeat = can.Message(arbitration_id=0x720, data=[5], is_extended_id=False)
    with (
        in_threads(virtual, stimulator_with_plate()),
        can.Bus(**virtual) as other,
        Stimulator.connect(**virtual) as bench,
    ):
        device = bench._link._stimulator  # type: ignore[attr-defined]
        device.heartbeat_at = None
        other.send(heartbeat)
        until(lambda: device.heartbeat_at is not None)
        now = device.heartbeat_at + 2.9
        bench._link._check()  # type: ignore[attr-defined]
        now = device.heartbeat_at + 3.1
        with pytest.raises(HeartbeatLostError, match=r"no heartbeat for 3\.1 s: it has stopped"):
            bench.read()


def test_a_node_that_stops_answering(virtual: dict[str, Any]) -> None:
    with in_threads(virtual, stimulator_with_plate()):
        bench = Stimulator.connect(**virtual, lockstep=True, timeout=0.2)
        bench.run(0.01)
    with pytest.raises(HeartbeatLostError, match="cannot read Mode: node 32 does not answer"):
        bench.get("Mode")
    with pytest.raises(HeartbeatLostError, match="node 32 does not answer"), bench:
        pass


def test_run_refuses_tpdos_without_the_recorded_objects(virtual: dict[str, Any]) -> None:
    node = stimulator_with_plate()
    with in_threads(virtual, node):
        with Stimulator.connect(**virtual, lockstep=True) as bench:
            record = bench._link._stimulator  # type: ignore[attr-defined]
            record.write(record.od.entry(0x1803, 1), 0x800004A0)
        with (
            Stimulator.connect(**virtual, lockstep=True) as bench,
            pytest.raises(NotRunningError, match=r"do not map all of .* restore their default"),
        ):
            bench.run(0.01)


@pytest.mark.parametrize(
    "failure",
    [None, ValueError("of the script"), RefusedError("of the device"), KeyboardInterrupt()],
)
def test_it_leaves_0_v_whatever_happens(
    failure: BaseException | None, virtual: dict[str, Any]
) -> None:
    node = StimulatorNode(stimulator_od(), PlateBlock(plate_od()))
    with in_threads(virtual, node, lockstep=False):
        raised: AbstractContextManager[Any] = (
            nullcontext() if failure is None else pytest.raises(type(failure))
        )
        with raised, Stimulator.connect(**virtual) as bench:
            bench.amplitude = 1.0
            bench.mode = "amplitude"
            until(lambda: bench.get("Vibration.Voltage") > 10_000)
            if failure is not None:
                raise failure
        until(lambda: node.od["Drive.Voltage"].value == 0)
        assert node.od["Mode"].value == Mode.OFF


def counted(bench: Stimulator) -> tuple[tuple[float, float], float]:
    """Times in ms between which the ticks of a node were counted, and how many there were."""
    before = time.monotonic()
    ticks = bench.get("Cycle.Cycles") + bench.get("Cycle.Missed deadlines")
    return (1000 * before, 1000 * time.monotonic()), ticks


def test_live_data_by_the_clock(virtual: dict[str, Any]) -> None:
    node = stimulator_with_plate(lockstep=False)
    with in_threads(virtual, node, lockstep=False), Stimulator.connect(**virtual) as bench:
        bench.finger.stroke(1)
        bench.start_run()
        begun, ticks = counted(bench)
        trace = bench.run(0.3)
        assert len(trace) == 300
        until(lambda: bench.read().age < 0.2)
        ended, more = counted(bench)
        # Every tick of the clock had a cycle or was missed, and is counted once.
        assert ended[0] - begun[1] - 2 <= more - ticks <= ended[1] - begun[0] + 2


def test_a_cycle_that_the_event_timer_repeats_is_recorded_once(virtual: dict[str, Any]) -> None:
    """A node is now and then held up for longer than the event time of its TPDOs."""
    calls = count(1)

    def pause_s() -> float:
        return 0.12 if next(calls) % 25 == 0 else 0.0

    node = stimulator_with_plate(lockstep=False)
    with (
        in_threads(virtual, node, lockstep=False, pause_s=pause_s),
        Stimulator.connect(**virtual) as bench,
    ):
        trace = bench.run(0.2)
        assert len(set(trace.tick.tolist())) == 200
        assert bench.get("Cycle.Missed deadlines") > 100


def test_connect_in_real_time_takes_sync_of_the_stimulator(virtual: dict[str, Any]) -> None:
    plate = PlateNode(plate_od())
    stimulator = StimulatorNode(stimulator_od(), plate_node_id=33, produce_sync=True)
    with (
        in_threads(virtual, plate, stimulator, lockstep=False),
        Stimulator.connect(**virtual, plate_node_id=33) as bench,
    ):
        trace = bench.run(0.2)
        assert len(trace) > 100
    until(lambda: plate.od["Stage.Voltage"].read() == 0)


def test_without_sync_the_loop_gives_no_cycles(
    virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.bench.can_link.GRACE_S", 0.02)
    with (
        in_threads(virtual, *both(lockstep=False), lockstep=False),
        Stimulator.connect(**virtual, plate_node_id=33) as bench,
        pytest.raises(NotRunningError, match="does one produce SYNC"),
    ):
        bench.run(0.01)


def test_reading_after_connect_waits_for_the_first_values(virtual: dict[str, Any]) -> None:
    node = stimulator_with_plate(lockstep=False)
    with (
        in_threads(virtual, node, lockstep=False),
        Stimulator.connect(**virtual, timeout=GUARD_S) as bench,
    ):
        assert bench.read().mode is Mode.OFF


def test_a_reading_of_nodes_in_lockstep_names_the_cure(virtual: dict[str, Any]) -> None:
    with (
        in_threads(virtual, stimulator_with_plate()),
        Stimulator.connect(**virtual, timeout=0.3) as bench,
        pytest.raises(NotRunningError, match="stands still without SYNC: connect with lockstep"),
    ):
        bench.read()


def test_a_reading_waits_for_no_longer_than_the_time_out(virtual: dict[str, Any]) -> None:
    with (
        in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False),
        Stimulator.connect(**virtual, timeout=0.3) as bench,
    ):
        bench.read()
        link: Any = bench._link
        subscribers, link._network.subscribers = link._network.subscribers, {}
        link._pdos[2].received = None
        with pytest.raises(NotRunningError, match=r"'Contact.Position' has not been published yet"):
            bench.read()
        link._network.subscribers = subscribers


def test_nothing_is_read_of_a_stimulator_that_is_not_operational(virtual: dict[str, Any]) -> None:
    def state() -> int:
        return bench._link._stimulator.state  # type: ignore[attr-defined, no-any-return]

    def nmt(command: int) -> None:
        master.send(can.Message(arbitration_id=0, data=[command, 32], is_extended_id=False))

    with (
        in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False),
        can.Bus(**virtual) as master,
        Stimulator.connect(**virtual) as bench,
    ):
        bench.run(0.1)
        assert bench.read().age < 1.0
        nmt(0x80)
        until(lambda: state() == 0x7F)
        with pytest.raises(NotRunningError, match=r"node 32 is pre-operational: a master, or"):
            bench.read()
        nmt(0x01)
        until(lambda: state() == 5)
        assert bench.read().age < 1.0


def test_closing_twice() -> None:
    bench = Stimulator.simulate("bus")
    bench._link.close()
    bench._link.close()


def test_frames_of_a_foreign_length_are_not_taken(virtual: dict[str, Any]) -> None:
    data = struct.pack("<H", 7)
    with (
        in_threads(virtual, stimulator_with_plate()),
        can.Bus(**virtual) as other,
        Stimulator.connect(**virtual, lockstep=True) as bench,
    ):
        for can_id in (0x1A0, 0x2A0, 0x3A0, 0x4A0):
            other.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        assert len(bench.run(0.02)) == 20


@pytest.mark.parametrize(("lockstep", "wait_s"), [(False, 1.0), (True, 5.0)])
def test_in_lockstep_a_slow_answer_is_waited_for(
    lockstep: bool, wait_s: float, virtual: dict[str, Any]
) -> None:
    with (
        in_threads(virtual, stimulator_with_plate(lockstep=lockstep), lockstep=lockstep),
        Stimulator.connect(**virtual, lockstep=lockstep) as bench,
    ):
        link = bench._link
        waits = link._stimulator._sdo.RESPONSE_TIMEOUT  # type: ignore[attr-defined]
        assert waits == wait_s
