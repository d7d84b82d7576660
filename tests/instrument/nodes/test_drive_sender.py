"""Whose drives a plate takes, without a node: each rule, and each number from both sides."""

from __future__ import annotations

import pytest
from line import packed

from smarttac_can.bench.simulation import plate_od
from smarttac_can.instrument.nodes.loop_frames import received_drive
from smarttac_can.instrument.nodes.plate_node import DriveSender

ONE, OTHER = 32, 127
IN_FAULT = 0x80
V20 = 2000


class Plate:
    """The sender's side of a plate."""

    def __init__(self) -> None:
        self.od = plate_od()
        self.sender = DriveSender(self.od)
        self._sent = received_drive(plate_od())

    def sound(self, voltage: int, source: int = ONE, session: int = 0, of: int = 0) -> bool:
        """Whether a drive of a source, made in one session, is sound in another."""
        return self.sender.sound(self.drive(voltage, source, of), session, off=not voltage)

    def drive(self, voltage: int, source: int = ONE, session: int = 0) -> bytes:
        self._sent.entries[0].value = voltage
        return packed(self._sent, bytes((session, source)))

    @property
    def corrupt(self) -> int:
        return int(self.od["Cycle.Corrupt drives"].value)


def works_with_one() -> Plate:
    """Return a plate that has had two drives of its stimulator."""
    plate = Plate()
    assert plate.sound(0)
    assert plate.sound(V20)
    assert plate.corrupt == 0
    return plate


@pytest.mark.parametrize("voltage", [1, V20])
def test_nobody_begins_with_a_voltage_and_it_is_not_corrupt(voltage: int) -> None:
    plate = Plate()
    assert not plate.sound(voltage)
    assert (plate.corrupt, plate.sender.level) == (0, 0.0)
    assert plate.sound(0)
    assert plate.sound(voltage)


def test_a_drive_with_a_wrong_bit_is_corrupt() -> None:
    plate = works_with_one()
    data = plate.drive(V20)
    assert plate.sender.sound(data, 0, off=False)
    for bit in range(64):
        wrong = int.from_bytes(data, "little") ^ 1 << bit
        assert not plate.sender.sound(wrong.to_bytes(8, "little"), 0, off=False), f"bit {bit}"
    assert plate.corrupt == 64


def test_stimulator_confirmed_by_two_drives_stays() -> None:
    plate = works_with_one()
    for voltage in (0, V20, 0):
        assert not plate.sound(voltage, OTHER)
    assert plate.corrupt == 3
    assert plate.sound(V20)


def test_unconfirmed_stimulator_is_replaced_by_0_v_of_another() -> None:
    plate = Plate()
    assert plate.sound(0, OTHER)
    assert not plate.sound(V20)
    assert plate.sound(0)
    assert plate.sound(V20)
    assert not plate.sound(0, OTHER)


@pytest.mark.parametrize("session", [0, 1, 254, 255])
def test_but_only_in_the_session_in_which_it_came(session: int) -> None:
    plate = Plate()
    assert plate.sound(0, OTHER, session, session)
    after = session + 1 & 0xFF
    assert not plate.sound(0, ONE, after, after)
    assert plate.sound(0, OTHER, after, after)


def test_0_v_of_a_session_before_is_none_of_its_own() -> None:
    plate = works_with_one()
    assert not plate.sound(0, session=1, of=0)
    assert plate.sound(0, session=1, of=1)


def test_in_fault_it_sends_0_v_alone() -> None:
    plate = works_with_one()
    assert plate.sound(0, ONE | IN_FAULT)
    assert plate.sender.latched
    assert not plate.sound(V20, ONE | IN_FAULT)
    assert plate.corrupt == 1
    assert plate.sound(V20)
    assert not plate.sender.latched


def test_drive_of_node_0_is_corrupt_in_fault_or_not() -> None:
    plate = Plate()
    assert not plate.sound(0, 0)
    assert not plate.sound(0, IN_FAULT)
    assert plate.sender.latched
    assert plate.corrupt == 2
    assert plate.sound(0, ONE)


def test_three_wrong_ones_disturb_until_20_cycles_without_one() -> None:
    plate = works_with_one()
    sender = plate.sender
    for wrong, level in ((1, 1 / 3), (2, 2 / 3), (3, 1.0)):
        assert not sender.disturbed
        plate.sound(V20, OTHER)
        assert sender.level == pytest.approx(level, rel=1e-12)
        assert plate.corrupt == wrong
        assert sender.disturbed == (wrong == 3)
        # The cycle had a wrong one: it makes up for none.
        sender.follow()
    assert sender.disturbed
    sender.follow()
    assert not sender.disturbed
    for _ in range(58):
        sender.follow()
        assert sender.level > 0.0
    sender.follow()
    assert sender.level == 0.0


@pytest.mark.parametrize("first", range(16))
def test_wrong_ones_disturb_wherever_their_first_falls(first: int) -> None:
    """Three in cycles 14 to 17 are as many as three in cycles 0 to 3."""
    plate = works_with_one()
    for _ in range(first):
        plate.sender.follow()
    for _ in range(3):
        assert not plate.sender.disturbed
        plate.sound(V20, OTHER)
        plate.sound(V20)
        plate.sender.follow()
    assert plate.sender.disturbed


@pytest.mark.parametrize(
    ("every", "wrong"), [(1, 3), (2, 4), (8, 5), (16, 9), (20, 41), (21, None)]
)
def test_how_many_that_come_again_and_again_disturb(every: int, wrong: int | None) -> None:
    plate = works_with_one()
    for count in range(1, 200):
        plate.sound(V20, OTHER)
        if plate.sender.disturbed:
            assert count == wrong
            return
        for _ in range(every):
            plate.sender.follow()
    assert wrong is None


def test_wrong_checks_are_forgotten_within_21_cycles() -> None:
    plate = works_with_one()
    for _ in range(100):
        plate.sound(V20, OTHER)
    plate.sender.follow()
    for _ in range(20):
        assert plate.sender.disturbed
        plate.sender.follow()
    plate.sender.follow()
    assert not plate.sender.disturbed


def test_the_count_begins_anew_when_the_sender_is_forgotten() -> None:
    plate = works_with_one()
    for _ in range(3):
        plate.sound(V20, OTHER)
    assert plate.sender.disturbed
    plate.sender.forget()
    assert not plate.sender.disturbed
    assert plate.sender.level == 0.0


def test_forgotten_stimulator_is_foreign() -> None:
    plate = works_with_one()
    assert plate.sound(0, ONE | IN_FAULT)
    plate.sender.forget()
    assert not plate.sender.latched
    assert not plate.sound(V20)
    assert plate.sound(0, OTHER)
    assert plate.sound(V20, OTHER)
