"""Ticks without a cycle, and a SYNC whose clock is not that of the rig."""

import struct

import pytest
from driven import MASTER, STATE, driven_within, reset_fault
from line import PREOP, START, Line, measurement, plate_alone, ready_inside

from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import PLATE_ID, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.port import Clock
from smarttac_can.canopen.master import requests
from smarttac_can.instrument.nodes.loop_time import MissedTime
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import Watchdog

OPEN_LOOP = 1


def running_inside(**presets: int) -> tuple[Line, StimulatorNode]:
    line, node = ready_inside(**presets)
    line.write(node, "Setpoint.Voltage", 2000)
    line.run(node, OPEN_LOOP)
    return line, node


def sleep_through(node: StimulatorNode, of_ten: int, seconds: int) -> None:
    """Let a node be late by so many of ten ticks, for some seconds."""
    for _ in range(100 * seconds):
        node.advance(1000 * (of_ten + 1))
        for _ in range(9 - of_ten):
            node.advance(1000)


@pytest.mark.parametrize(
    ("of_ten", "limit", "fault"), [(3, 20, True), (2, 20, False), (2, 15, True)]
)
def test_a_run_with_too_many_missed_ticks_ends(of_ten: int, limit: int, fault: bool) -> None:
    line, node = running_inside(Limit__Missed_ticks=limit)
    sleep_through(node, of_ten, 2)
    od = node.od
    assert od["Cycle.Missed deadlines"].value == 200 * of_ten
    assert (node.block.state is State.FAULT) == fault
    assert od["Diagnosis.Latched"].value == fault << Watchdog.MISSED_TIME
    assert od["Diagnosis.Code"].value == (0x6180 if fault else 0)
    assert bool(od["Drive.Voltage"].value) != fault
    if fault:
        assert line.write(node, "Controlword", 0) == 0
        assert line.write(node, "Controlword", 0x80) == 0, "at once"


@pytest.mark.parametrize("slept", [1, 2, 3])
def test_missed_ticks_message_has_count_cause_and_cure(slept: int) -> None:
    _, node = running_inside(Limit__Missed_ticks=5)
    sleep_through(node, slept, 2)
    # A sleep of one tick is a slow cycle.
    stood, cure = (
        (0, "cycles take too long") if slept == 1 else (100 * slept, "start the node with")
    )
    message = node.od["Message"].value
    assert message.startswith(
        f"too many ticks of a second had no cycle; {100 * slept} of 1000 ticks missed, {stood} of "
        f"them while the machine stood still or gave this process no time; {cure}"
    )
    assert message in node.od["Fault memory.Fault 1"].value


def test_node_with_sync_and_no_measurement_is_not_standing_still() -> None:
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, produce_sync=True)
    node.start()
    node.receive(requests.nmt(START))
    for tick in range(1100):
        node.advance(1000)
        # Of ten ticks four have no measurement in a row.
        for frame in measurement(tick & 0xFF) if tick % 10 < 6 else ():
            node.receive(frame)
    assert node._missed_time.summary().startswith(
        "400 of 1000 ticks missed, 0 of them while the machine stood still or gave this process no "
        "time; cycles take too long or the plate answers late"
    )


def test_ticks_missed_before_a_run_are_no_fault() -> None:
    line, node = ready_inside()
    sleep_through(node, 5, 1)
    line.run(node, OPEN_LOOP)
    line.advance(3000)
    assert node.block.state is State.RUNNING


def test_ticks_missed_while_armed_are_no_fault_in_the_run() -> None:
    line, node = ready_inside()
    assert line.write(node, "Controlword", 1) == 0
    sleep_through(node, 5, 3)
    assert node.od["Diagnosis.Latched"].value == 0
    # The first ends a second, the second is of the one in which the run begins.
    for _ in range(2):
        node.advance(400_000)
    assert line.write(node, "Controlword", 3) == 0
    line.advance(3000)
    assert node.block.state is State.RUNNING


@pytest.mark.parametrize(("period_us", "missed"), [(800, 0), (1000, 0), (2000, 500)])
def test_missed_ticks_are_reported_at_the_end_of_a_second(period_us: int, missed: int) -> None:
    clock = Clock()
    time = MissedTime(clock)
    assert (time.missed, time.cycle(), time.missed) == (0, 0, 0)
    cycles = 1_000_000 // period_us
    for at in range(1, 2 * cycles + 1):
        clock.advance(period_us)
        assert time.cycle() == (0 if at % cycles else missed)
        assert time.missed == missed * (at % cycles) // cycles


@pytest.mark.parametrize(
    ("pauses", "slow_cycles", "cure"),
    [(10, 20, "cycles take too long"), (10, 19, "start the node with"), (1, 0, "start the node")],
)
def test_missed_ticks_message_takes_the_cause_of_the_majority(
    pauses: int, slow_cycles: int, cure: str
) -> None:
    clock = Clock()
    time = MissedTime(clock)
    time.cycle()
    # A pause misses 2 ticks, a slow cycle 1.
    gaps = [3] * pauses + [2] * slow_cycles
    gaps += [1] * (1000 - sum(gaps))
    for gap in gaps:
        clock.advance(1000 * gap)
        missed = time.cycle()
    assert missed == 2 * pauses + slow_cycles
    assert time.summary().startswith(
        f"{missed} of 1000 ticks missed, {2 * pauses} of them while the machine stood still or "
        f"gave this process no time; {cure}"
    )


def test_the_plate_counts_the_ticks_without_sync() -> None:
    _, plate = plate_alone()
    plate.receive(requests.nmt(START))
    for count in range(1500):
        plate.advance(1000)
        if count % 5:
            plate.receive(requests.sync())
    assert 195 <= plate.od["Cycle.Missed deadlines"].value <= 200


def test_ticks_out_of_operational_are_not_missed() -> None:
    _, plate = plate_alone()
    for command in (START, PREOP, START):
        plate.receive(requests.nmt(command))
        for _ in range(600):
            plate.advance(1000)
            if command == START:
                plate.receive(requests.sync())
    assert plate.od["Cycle.Missed deadlines"].value == 0


@pytest.mark.parametrize(("produce_sync", "missed"), [(True, 240), (False, 182)])
def test_tick_without_cycle_counts_once_with_any_sync_producer(
    produce_sync: bool, missed: int
) -> None:
    """SYNC of another producer is counted at the end of each second: 91 of 1001 ticks."""
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, produce_sync=produce_sync)
    node.start()
    node.receive(requests.nmt(START))
    for tick in range(2400):
        node.advance(1000 if tick % 10 else 2000)
        if not produce_sync:
            node.receive(requests.sync())
        for frame in measurement(tick & 0xFF):
            node.receive(frame)
    assert node.od["Cycle.Cycles"].value == 2400
    assert node.od["Cycle.Missed deadlines"].value == missed


def spaced(rig: Rig, period_us: int, periods: int) -> None:
    """Let SYNC come with another period than 1000 us, and the rest in time."""
    for _ in range(periods):
        if rig.state is not State.RUNNING:
            return
        rig.bus.advance(period_us)
        rig.master.send(
            requests.heartbeat(MASTER), Frame(0x320, struct.pack("<HI", 2000, 4_339_000))
        )
        rig.master.sync()


@pytest.mark.parametrize(
    ("deadline_ms", "period_us", "fault"), [(3, 950, True), (20, 1050, True), (20, 1005, False)]
)
def test_a_sync_that_drifts_ends_a_run(deadline_ms: int, period_us: int, fault: bool) -> None:
    rig = driven_within(deadline_ms)
    spaced(rig, period_us, 3000)
    assert (rig.state is State.FAULT) == fault
    assert rig.od["Diagnosis.Latched"].value == fault << Watchdog.SYNC_IRREGULAR
    if fault:
        assert rig.stage.read() == 0
        assert reset_fault(rig) == STATE
        rig.cycle(2001)
        assert reset_fault(rig) == 0
