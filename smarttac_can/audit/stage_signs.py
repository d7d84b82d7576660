"""What the frames of a log show of the power stage and of the stimulator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from smarttac_can.audit.log_frames import Field, Stamped, find_field
from smarttac_can.device.frame import Frame
from smarttac_can.od.cia import (
    BOOT_UP,
    EMCY_ID,
    FRAME_BYTES,
    HEARTBEAT_ID,
    NMT_ID,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    SYNC_ID,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    EmergencyCode,
    NMTCommand,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.timing import frame_bits
from smarttac_can.vocabulary.fault_codes import FaultCode
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.states import Status

_NMT_BYTES: Final = 2
_WENT_OFF: Final = (EmergencyCode.RPDO_TIME_OUT, FaultCode.VOLTAGE, FaultCode.STAGE)
"""Emergencies that a plate sends when it goes to 0 V by itself between two SYNCs."""
_SYNC_LATE_US: Final = 1900
"""A SYNC may be late by as much as frames hold the bus; one that is later is not the next."""


class Signs:
    """Who has the power stage, and in which frames the log shows it.

    Parameters
    ----------
    stimulator, plate
        The EDS files, loaded for their node-IDs.
    inside
        Whether the plate is inside the stimulator.
    """

    def __init__(
        self, stimulator: ObjectDictionary, plate: ObjectDictionary, *, inside: bool
    ) -> None:
        self.inside = inside
        self.owner = (stimulator if inside else plate).node_id
        self.emcy_ids = (EMCY_ID + stimulator.node_id, EMCY_ID + plate.node_id)
        self.status = _sent(stimulator, 1, "Statusword")
        self.mode = _sent(stimulator, 1, "Mode display")
        self.stage = (
            _sent(stimulator, 4, "Vibration.Voltage")
            if inside
            else _sent(plate, 4, "Stage.Voltage")
        )
        self.drive = find_field(plate, RPDO_COMMUNICATION, RPDO_MAPPING, "Drive.Voltage")
        self.volt = plate["Stage.Voltage"].si

    def emergency(self, frame: Frame) -> int:
        """Return the code of an emergency message of either node; 0 for any other frame."""
        if frame.can_id not in self.emcy_ids or len(frame.data) != FRAME_BYTES:
            return 0
        return int.from_bytes(frame.data[:2], "little")

    def gone(self, frame: Frame) -> bool:
        """Whether a frame shows that who has the stage is not OPERATIONAL, and so at 0 V."""
        if frame.can_id == NMT_ID and len(frame.data) == _NMT_BYTES:
            command, node_id = frame.data
            return command != NMTCommand.START and node_id in (0, self.owner)
        return frame.can_id == HEARTBEAT_ID + self.owner and frame.data == BOOT_UP

    def driven(self, frame: Frame) -> bool | None:
        """Whether a frame shows the stage with a voltage, at 0 V (False), or not at all (None)."""
        voltage = self.stage.read(frame)
        if voltage is not None:
            return voltage > 0
        if self.inside:
            status = self.status.read(frame)
            off = status is not None and not status & Status.DRIVING
        else:
            own = frame.can_id == EMCY_ID + self.owner
            off = self.drive.read(frame) == 0 or (own and self.emergency(frame) in _WENT_OFF)
        return False if off or self.gone(frame) else None

    def last(self, field: Field, frames: Sequence[Stamped]) -> int | None:
        """Return the last raw value of a field; None if there is none."""
        values = (field.read(frame) for _, frame in reversed(frames))
        return next((value for value in values if value is not None), None)


def _sent(od: ObjectDictionary, number: int, name: str) -> Field:
    return find_field(od, TPDO_COMMUNICATION + number - 1, TPDO_MAPPING + number - 1, name)


def cycles_to_zero(signs: Signs, before: Sequence[Stamped], after: Sequence[Stamped]) -> int | None:
    """Count the cycles from a fault until the stage is at 0 V and stays there; None if it does not.

    Parameters
    ----------
    signs
        What the frames show.
    before, after
        Frames before and after the fault; SYNC is among those before.
    """
    zero: int | None = None
    fresh = False
    for cycle, frame in _in_cycles(signs, before, after):
        driven = signs.driven(frame)
        if frame.can_id == SYNC_ID:
            fresh = False
        elif driven:
            zero, fresh = None, False
        elif driven is False and (zero is None or (fresh and frame.can_id == signs.stage.can_id)):
            # A statusword just before the stage of its cycle is of that cycle.
            zero, fresh = cycle, True
    return zero


def _in_cycles(
    signs: Signs, before: Sequence[Stamped], after: Sequence[Stamped]
) -> Iterator[tuple[int, Frame]]:
    """Yield frames with the number of their cycle, 0 up to the first that begins after the fault.

    SYNC is sent in the middle of a cycle, after what its beginning has caused. What is caused
    follows at once: a frame before which the bus was idle is one of the next cycle, and so is the
    stage of a plate inside, which is told at the beginning.
    """
    sync = max(time for time, frame in before if frame.can_id == SYNC_ID)
    end = before[-1][0]
    cycle, begun = 0, False
    for time, frame in after:
        begun = (
            begun
            or time - frame_bits(len(frame.data)) > end
            or (signs.inside and frame.can_id == signs.stage.can_id)
        )
        end = time
        if frame.can_id == SYNC_ID:
            cycle += _ticks(time - sync)
            sync, begun = time, False
            yield cycle, frame
        elif time - sync > _SYNC_LATE_US:
            yield cycle + (time - sync + frame_bits(0)) // TICK_US, frame
        else:
            yield cycle + begun, frame


def _ticks(microseconds: int) -> int:
    """Return how many cycles passed between two SYNCs; without any in between 1."""
    return round(microseconds / TICK_US) if microseconds > _SYNC_LATE_US else 1
