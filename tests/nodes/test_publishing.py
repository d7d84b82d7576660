"""What a stimulator tells the bus unasked, without a node: which PDOs, and which emergencies."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from smarttac_can.bench.simulation import STIMULATOR_ID, stimulator_od
from smarttac_can.nodes.loop_frames import crc8
from smarttac_can.nodes.stimulator_node import Publishing
from smarttac_can.vocabulary.states import State

STATUS, DRIVE = 1, 5
NMT, BUS_OFF, STUCK = 1 << 0, 1 << 7, 1 << 15
NMT_CODE, BUS_OFF_CODE, STUCK_CODE = 0x8180, 0x8141, 0x5211


class Told:
    """A publishing, and what its device was asked to send."""

    def __init__(self) -> None:
        self.od = stimulator_od()
        self.triggered: list[int] = []
        self.emergencies: list[tuple[int, int, bytes]] = []
        self.cleared: list[int] = []
        self.supervisor = SimpleNamespace(state=State.READY, latched=0)
        device = SimpleNamespace(
            od=self.od,
            trigger=self.triggered.append,
            emergency=lambda *emergency: self.emergencies.append(emergency),
            clear_emergency=self.cleared.append,
        )
        stand_ins: tuple[Any, Any] = (device, self.supervisor)
        self.publishing = Publishing(*stand_ins)

    def tell(self, latched: int) -> None:
        self.supervisor.latched = latched
        self.publishing.report()


@pytest.mark.parametrize("event_driven", [(), (2,), (3,), (4,), (2, 3, 4)])
def test_a_cycle_publishes_the_status_and_what_has_type_254(event_driven: tuple[int, ...]) -> None:
    told = Told()
    for number in (1, *event_driven):
        told.od.entry(0x1800 + number - 1, 2).value = 254
    told.publishing.cycle()
    assert told.triggered == [STATUS, *event_driven]


def test_a_state_is_the_status_alone_and_the_last_time_is_all() -> None:
    told = Told()
    told.publishing.status()
    assert told.triggered == [STATUS]
    told.triggered.clear()
    told.publishing.all()
    assert told.triggered == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("state", "source"),
    [(State.RUNNING, STIMULATOR_ID), (State.READY, STIMULATOR_ID), (State.FAULT, 0xA0)],
)
def test_the_check_of_a_drive_says_who_sends_it_and_whether_in_fault(
    state: State, source: int
) -> None:
    told = Told()
    told.supervisor.state = state
    for name, raw in (("Voltage", 2000), ("Frequency", 4_339_000), ("Tick", 7)):
        told.od[f"Drive.{name}"].value = raw
    told.publishing.drive(9)
    sent = (2000).to_bytes(2, "little") + (4_339_000).to_bytes(4, "little") + bytes((7, 9, source))
    assert told.od["Drive.Check"].value == crc8(sent)
    assert told.triggered == [DRIVE]


def test_what_is_latched_is_told_once_and_taken_back_when_it_is_reset() -> None:
    told = Told()
    told.tell(NMT)
    assert told.emergencies == [(NMT_CODE, 0x10, bytes((0,)))]
    assert told.triggered == [STATUS]
    told.tell(NMT)
    told.tell(NMT | STUCK)
    assert told.emergencies[1:] == [(STUCK_CODE, 0x80, bytes((15,)))]
    assert told.cleared == []
    told.tell(0)
    assert told.cleared == [NMT_CODE, STUCK_CODE]
    assert len(told.emergencies) == 2
    assert told.triggered == [STATUS, STATUS]


def test_nothing_latched_is_nothing_told() -> None:
    told = Told()
    told.tell(0)
    told.publishing.report_all()
    assert (told.emergencies, told.cleared, told.triggered) == ([], [], [])


def test_what_was_latched_in_a_reset_or_before_is_told_after_it() -> None:
    told = Told()
    told.tell(BUS_OFF)
    told.supervisor.latched |= NMT
    told.publishing.mark_reported()
    told.publishing.report()
    assert [code for code, *_ in told.emergencies] == [BUS_OFF_CODE]
    told.publishing.report_all()
    assert [code for code, *_ in told.emergencies] == [BUS_OFF_CODE, NMT_CODE, BUS_OFF_CODE]
    assert told.cleared == []
