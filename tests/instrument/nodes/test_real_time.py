"""The deadlines of the loop in real time: in microseconds, by default, and for a late process."""

from __future__ import annotations

from typing import Any

import pytest
from driven import STATE, driven, driven_within, write, write_entry
from hypothesis import example, given
from hypothesis import strategies as st
from line import (
    DRIVE,
    EMCY_STIMULATOR,
    MEASUREMENT,
    PREOP,
    START,
    drive,
    driven_both,
    driven_plate,
    measurement,
    stage,
)

from smarttac_can.assurance.trials.fault_cases import calm, disturb
from smarttac_can.bench.simulation import PLATE_ID, stimulator_od
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.host.faulty_bus import FrameFault
from smarttac_can.instrument.nodes.bus_loop import LateAnswers
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.watchdogs import UNSEEN_CYCLES, WATCHDOGS, Watchdog

DEFAULT_US = 20_000
SAVE = int.from_bytes(b"save", "little")


@pytest.mark.parametrize(("deadline_ms", "deadline_us"), [(None, DEFAULT_US), (3, 3000)])
def test_a_plate_without_drives_is_at_0_v_to_the_microsecond(
    deadline_ms: int | None, deadline_us: int
) -> None:
    _, plate = driven_plate(deadline_ms=deadline_ms)
    plate.advance(deadline_us - 1)
    assert stage(plate) == 2000
    plate.advance(1)
    assert stage(plate) == 0
    assert plate.block.inhibited


def test_new_deadline_counts_from_the_last_drive() -> None:
    line, plate = driven_plate(deadline_ms=None)
    plate.advance(4000)
    assert line.write_entry(plate, plate.od.entry(0x1400, 5), 5) == 0
    plate.advance(999)
    assert stage(plate) == 2000
    plate.advance(1)
    assert stage(plate) == 0


def test_late_plate_is_at_0_v_before_it_hears_queued_frames() -> None:
    _, plate = driven_plate(deadline_ms=None)
    plate.clock.now += DEFAULT_US - 1
    assert plate.overdue() == []
    assert stage(plate) == 2000
    plate.clock.now += 1
    plate.overdue()
    assert stage(plate) == 0
    for frame in (drive(2000, 0), requests.sync(), drive(2000, 1)):
        plate.receive(frame)
        assert stage(plate) == 0, "the queue is full of sound drives"


def running_stimulator() -> StimulatorNode:
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID)
    node.start()
    node.receive(requests.nmt(START))
    node.od["Gauge zero.Zero of S1"].value = 1
    node.block.start_run()
    for frame in (requests.sync(), *measurement(0)):
        node.receive(frame)
    for word in (0, 1, 3):
        node.block.write("Controlword", word)
    assert node.block.state is State.RUNNING
    return node


def test_missing_measurements_are_a_fault_to_the_microsecond() -> None:
    node = running_stimulator()
    node.advance(DEFAULT_US - 1000)
    node.receive(requests.sync())
    assert EMCY_STIMULATOR not in [f.can_id for f in node.advance(999)]
    assert node.block.state is State.RUNNING
    sent = node.advance(1)
    assert node.block.state is State.FAULT
    assert node.block.supervisor.latched == 1 << Watchdog.MEASUREMENT
    assert EMCY_STIMULATOR in [frame.can_id for frame in sent]


def test_late_stimulator_is_in_fault_before_queued_frames() -> None:
    node = running_stimulator()
    node.clock.now += DEFAULT_US
    sent = node.overdue()
    assert node.block.state is State.FAULT
    assert 0x200 + PLATE_ID in [frame.can_id for frame in sent], "0 V for the plate"
    for frame in measurement(1):
        node.receive(frame)
    assert node.block.state is State.FAULT


@pytest.mark.parametrize("server", [0x20, 0x21])
def test_nothing_is_stored_while_something_drives(server: int) -> None:
    rig = driven(Mode.AMPLITUDE)
    node = rig.stimulator if server == 0x20 else rig.plate

    def save() -> int:
        return write_entry(rig, node.od.entry(0x1010, 1), SAVE, server)

    assert save() == STATE
    with pytest.raises(Abort):
        node.on_store()
    rig.cycle(5)
    assert rig.state is State.RUNNING
    assert write(rig, "Controlword", 0) == 0
    rig.cycle(2)
    assert save() == 0


def test_stimulator_reports_late_drives_when_the_plate_does() -> None:
    line, plate, node = driven_both()
    plate.receive(requests.sync())  # two SYNCs that the stimulator does not hear the answer to
    plate.receive(requests.sync())
    plate.advance(3000)
    assert stage(plate) == 0
    line.sync()
    assert node.block.state is State.FAULT
    assert node.od["Message"].value == "the plate went to 0 V by itself: its drives were late"
    assert node.block.supervisor.latched == 1 << Watchdog.PLATE
    assert MEASUREMENT[0] in [frame.can_id for frame in line.sync()], "the loop goes on at 0 V"


@pytest.mark.parametrize(("amplitude", "lost"), [(100, 10), (100, 17), (1500, 17)])
def test_drives_that_are_late_are_no_fault_before_the_deadline(amplitude: int, lost: int) -> None:
    rig = driven_within(20, Mode.AMPLITUDE)
    rig.write("Setpoint.Amplitude", amplitude)
    disturb(FrameFault.LOSS, DRIVE)(rig)
    rig.cycle(lost)
    calm(rig)
    rig.cycle(50)
    assert rig.state is State.RUNNING, rig.od["Message"].value
    assert abs(rig.plate.od["Vibration.W_d"].value - 10 * amplitude) < 200


@pytest.mark.sources
def test_late_drives_above_a_lowered_limit_end_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In time the drive is cut to the limit; a late one leaves the drive before in force."""
    rig = driven()
    rig.write("Limit.Amplitude by drive", 500)
    rig.cycle(20)
    assert rig.state is State.RUNNING
    monkeypatch.setattr(LateAnswers, "late", lambda *_: True)
    rig.write("Limit.Amplitude by drive", 100)
    rig.cycle(UNSEEN_CYCLES - 1)
    assert rig.state is State.RUNNING
    rig.cycle()
    assert rig.state is State.FAULT
    assert rig.od["Diagnosis.Code"].value == WATCHDOGS[Watchdog.UNSEEN].code
    assert rig.od["Diagnosis.Latched"].value == 1 << Watchdog.UNSEEN
    assert rig.stage.read() == 0


WAIT = st.tuples(st.just("wait"), st.sampled_from([1, 999, 1000, 3000]))
ANSWER = st.tuples(st.just("drive"), st.tuples(st.sampled_from([0, 2000]), st.integers(0, 3)))
NMT = st.tuples(st.just("nmt"), st.sampled_from([START, PREOP]))


SYNC: tuple[str, Any] = ("sync", None)


@given(st.lists(WAIT | ANSWER | NMT | st.just(SYNC), max_size=60))
@example([("wait", 999), ("drive", (0, 3)), SYNC, SYNC, ("drive", (2000, 1)), ("wait", 2001)])
def test_voltage_lasts_at_most_a_deadline_after_a_drive_in_time(acts: list[Any]) -> None:
    _, plate = driven_plate()
    in_time = plate.clock.now
    for kind, what in acts:
        if kind == "wait":
            plate.advance(what)
        elif kind == "nmt":
            plate.receive(requests.nmt(what))
        elif kind == "sync":
            plate.receive(requests.sync())
        else:
            voltage, age = what
            if age == 0:
                in_time = plate.clock.now
            plate.receive(drive(voltage, plate.block.tick.value - age & 0xFF))
        assert stage(plate) == 0 or plate.clock.now < in_time + 3000
    plate.advance(3000)
    assert stage(plate) == 0
