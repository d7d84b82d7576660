"""Rows of the fault matrix, recomputed from the log of its frames and compared.

    python tests/fault_log.py LOG ROWS

LOG and ROWS come from `tools/pages/make faults --log LOG --json ROWS`. Only the name, the
mode, and the time of the fault are taken from a row without a check. Nothing is imported of what
has made them: nodes, bench and trials.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import EmergencyCode, NMTCommand
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.timing import frame_bits
from smarttac_can.host.files import read_eds
from smarttac_can.host.log_file import read_candump
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.states import Mode, State, Status, known_state

NODES: Final = {"stimulator": 32, "plate": 33}
NOT_SHOWN: Final = {
    "cycles_to_zero": (
        # In turn: no frame of the plate passes; SYNC counts no cycles; the plate does nothing.
        "a node babbles",
        "SYNC twice a cycle",
        "plate paused for 2 s",
    ),
    "held": (
        # The plate sends the waiting frames when the bus is free again.
        "a node babbles",
    ),
    "state_after": (
        # A stimulator that is not OPERATIONAL, or is off the bus, publishes no statusword.
        "NMT stop",
        "NMT pre-operational",
        "NMT reset node",
        "NMT reset communication",
        "NMT stop, plate inside",
        "bus-off",
        "a node babbles",
        "stimulator restarts",
        "stimulator restarts, plate inside",
        "stimulator paused for 2 s",
    ),
}
"""By field: faults for which the log does not show the field."""
_LONGEST_S: Final = 1e9
_RUN_CYCLES: Final = 400
"""Least cycles of a run that goes on; an identification ends by itself soon after."""
LEAST_HOLD: Final = 200
"""Least cycles at 0 V, omitted from the log, by which its parts are separated."""
_MODES: Final = {
    **{mode.name.lower(): mode for mode in Mode},
    "friction_predictive": Mode.FRICTION,
}
"""Modes by their names in rows; no frame shows the other laws of the last one."""
_NMT_BYTES: Final = 2
_WENT_OFF: Final = (EmergencyCode.RPDO_TIME_OUT, FaultCode.VOLTAGE, FaultCode.STAGE)
"""Emergencies of a plate that goes to 0 V by itself between two SYNCs."""
_SYNC_LATE_US: Final = 1900
"""Longest period of SYNC in us, with other frames on the bus; a longer one means a lost SYNC."""
Stamped = tuple[int, Frame]
"""A frame with its time stamp in us."""
_SILENCE_US: Final = 120_000
"""Longest silence in us within a part of a log, as a heartbeat comes every 100 ms."""


class DifferenceError(ValueError):
    """A row differs from the log."""


class Verified(NamedTuple):
    """Extent of a comparison."""

    rows: int
    fields: int
    not_shown: int
    """Number of fields that the log does not show."""


class _Claim(NamedTuple):
    number: int
    fault: str
    mode: Mode
    injected: int
    """Time stamp in us of the last frame before the fault."""
    row: dict[str, Any]

    def differs(self, what: str) -> DifferenceError:
        return DifferenceError(f"row {self.number} ({self.fault}, {self.row['mode']}): {what}")


def verify_rows(
    frames: Iterable[Stamped], rows: object, stimulator: ObjectDictionary, plate: ObjectDictionary
) -> Verified:
    """Recompute the rows of a fault matrix from its log and compare.

    Parameters
    ----------
    frames
        Frames of the log, with time stamps in us.
    rows
        Rows from JSON.
    stimulator, plate
        Object dictionaries, loaded for their node-IDs.

    Raises
    ------
    DifferenceError
        At the first difference, with row, field and both values; also if the log lacks data for a
        row, or a fault took longer than its bound.
    ValueError
        If `rows` is not a list of rows, or the log is out of order.
    """
    claims = _claims(rows)
    _require_hold(claims)
    signs = [Signs(stimulator, plate, inside=inside) for inside in (False, True)]
    measured = plate.number(cia.TPDO_COMMUNICATION, cia.PDO_COB_ID) & cia.CAN_ID_MASK
    fields = not_shown = 0
    rest = parts(frames)
    for claim in claims:
        fault, recovery = next(rest, []), next(rest, [])
        if not recovery:
            raise claim.differs("the log ends before its recovery")
        inside = all(frame.can_id != measured for _, frame in fault)
        shown = _Shown(claim, signs[inside], fault, recovery).fields()
        for name, value in shown.items():
            if claim.fault in NOT_SHOWN.get(name, ()):
                not_shown += 1
                continue
            stated = claim.row.get(name, "missing")
            if _as_text(stated) != _as_text(value):
                raise claim.differs(
                    f"{name} is {_as_text(stated)} in the row, {_as_text(value)} in the log"
                )
            fields += 1
        _require_bound(claim, shown["cycles_to_zero"])
    if next(rest, None) is not None:
        raise DifferenceError(f"the log goes on after the {len(claims)} rows")
    return Verified(len(claims), fields, not_shown)


class _Shown:
    """The fields of one fault, computed from its log.

    Parameters
    ----------
    claim
        Name, mode and time of the fault.
    signs
        Decoder of the frames.
    fault, recovery
        Frames around the fault, and those of the recovery.
    """

    def __init__(
        self, claim: _Claim, signs: Signs, fault: list[Stamped], recovery: list[Stamped]
    ) -> None:
        self._claim, self._signs = claim, signs
        self._before = [item for item in fault if item[0] <= claim.injected]
        self._after = fault[len(self._before) :]
        self._recovery = recovery
        if not (self._before and self._after and self._before[-1][0] == claim.injected):
            raise claim.differs(
                f"the log has no frame at injected_at_s {claim.injected * 1e-6:.6f}"
            )
        if all(frame.can_id != cia.SYNC_ID for _, frame in self._before):
            raise claim.differs("the log has no SYNC before the fault")
        self._require_stage()

    def fields(self) -> dict[str, object]:
        """Return the fields of the row by name."""
        signs = self._signs
        codes = [f"{code:04X}h" for _, frame in self._after if (code := signs.emergency(frame))]
        codes = list(dict.fromkeys(codes))
        voltage = signs.last(signs.stage if signs.inside else signs.drive, self._before)
        word = signs.last(signs.status, self._after)
        state = None if word is None else known_state(word)
        return {
            "voltage_before_v": None if voltage is None else round(voltage * signs.volt, 2),
            "cycles_to_zero": cycles_to_zero(signs, self._before, self._after),
            "emcy_codes": codes,
            "emcy_code": codes[0] if codes else None,
            "state_after": None if state is None else state.name.lower(),
            "held": self._held(),
            "recovered": self._recovered(),
        }

    def _held(self) -> bool:
        """Return whether the stage is still at 0 V when the log goes on."""
        signs = (self._signs.driven(frame) for _, frame in self._recovery)
        return next((driven for driven in signs if driven is not None), None) is False

    def _recovered(self) -> bool:
        """Return whether a run in the same mode lasts to the end, long enough, with a voltage."""
        signs, frames = self._signs, self._recovery
        cycles = 0
        for _, frame in reversed(frames):
            word = signs.status.read(frame)
            if word is not None and known_state(word) is not State.RUNNING:
                break
            cycles += frame.can_id == cia.SYNC_ID
        return (
            cycles >= _RUN_CYCLES
            and signs.last(signs.mode, frames) == self._claim.mode
            and bool(signs.last(signs.stage, frames))
        )

    def _require_stage(self) -> None:
        """Refuse a log that does not show the stage in each cycle that must show it."""
        signs = self._signs
        drive: int | None = None
        shown = True
        for time, frame in self._before:
            shown = self._follow_sync(time, frame, shown)
            voltage = signs.stage.read(frame)
            if voltage is not None and drive is not None and voltage != drive and not signs.inside:
                raise self._claim.differs(
                    f"the stage shows {voltage * 0.01:.2f} V at {time * 1e-6:.6f} s, "
                    f"the drive before it {drive * 0.01:.2f} V"
                )
            answer = signs.drive.read(frame)
            drive = drive if answer is None else answer
        if signs.inside or self._claim.fault in NOT_SHOWN["cycles_to_zero"]:
            return
        for time, frame in self._after:
            if signs.gone(frame):
                return
            shown = self._follow_sync(time, frame, shown)

    def _follow_sync(self, time: int, frame: Frame, shown: bool) -> bool:
        """Return whether the log has shown the stage since the last SYNC."""
        if frame.can_id != cia.SYNC_ID:
            return shown or self._signs.stage.read(frame) is not None
        if not shown:
            raise self._claim.differs(
                f"the log does not show the stage in the cycle before {time * 1e-6:.6f} s"
            )
        return False


def _claims(rows: object) -> list[_Claim]:
    """Return name, mode and time of each row.

    Raises
    ------
    ValueError
        If one of them is missing or invalid.
    """
    if not isinstance(rows, list) or not rows:
        raise ValueError("there is no list of rows")
    claims = []
    for number, row in enumerate(rows, 1):
        if not isinstance(row, dict):
            raise ValueError(f"row {number} is no object")
        fault, mode, injected = (row.get(key) for key in ("fault", "mode", "injected_at_s"))
        if not isinstance(fault, str):
            raise ValueError(f"row {number}: fault {_as_text(fault)} is no name")
        if not isinstance(mode, str) or mode not in _MODES:
            raise ValueError(f"row {number}: mode {_as_text(mode)} is none of {', '.join(_MODES)}")
        if not isinstance(injected, int | float) or not 0 < injected < _LONGEST_S:
            raise ValueError(
                f"row {number}: injected_at_s {_as_text(injected)} is not in 0..{_LONGEST_S:g}"
            )
        claims.append(_Claim(number, fault, _MODES[mode], round(injected * 1e6), row))
    return claims


def _require_hold(claims: list[_Claim]) -> None:
    """Refuse rows with a short hold: their log does not show where the recovery begins."""
    for claim in claims:
        cycles = claim.row.get("cycles_at_zero")
        if claim.row.get("held") is True and isinstance(cycles, int) and cycles < LEAST_HOLD:
            raise claim.differs(
                f"was held for {cycles} cycles, of which the log shows nothing: only one made "
                f"with --hold {LEAST_HOLD} or more can be verified"
            )


def _require_bound(claim: _Claim, cycles: object) -> None:
    """Refuse a fault that was detected too late by the log; the row gives only the bound."""
    bound = claim.row.get("detection_bound_cycles", "missing")
    if type(bound) is not int:
        raise claim.differs(f"detection_bound_cycles is {_as_text(bound)}, no number of cycles")
    if claim.fault in NOT_SHOWN["cycles_to_zero"]:
        return
    if not isinstance(cycles, int) or cycles > bound + 1:
        raise claim.differs(
            f"detection_bound_cycles is {bound}, and the cycles to 0 V in the log are "
            f"{_as_text(cycles)}"
        )


def _as_text(value: object) -> str:
    return json.dumps(value)


class Signs:
    """Decodes which frames show the power stage of plate or stimulator.

    Parameters
    ----------
    stimulator, plate
        Object dictionaries, loaded for their node-IDs.
    inside
        Whether the plate is inside the stimulator.
    """

    def __init__(
        self, stimulator: ObjectDictionary, plate: ObjectDictionary, *, inside: bool
    ) -> None:
        self.inside = inside
        self.owner = (stimulator if inside else plate).node_id
        self.emcy_ids = (cia.EMCY_ID + stimulator.node_id, cia.EMCY_ID + plate.node_id)
        self.status = _sent(stimulator, 1, "Statusword")
        self.mode = _sent(stimulator, 1, "Mode display")
        self.stage = (
            _sent(stimulator, 4, "Vibration.Voltage")
            if inside
            else _sent(plate, 4, "Stage.Voltage")
        )
        self.drive = find_field(plate, cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING, "Drive.Voltage")
        self.volt = plate["Stage.Voltage"].si

    def emergency(self, frame: Frame) -> int:
        """Return the code of an emergency message of either node; 0 for any other frame."""
        if frame.can_id not in self.emcy_ids or len(frame.data) != cia.FRAME_BYTES:
            return 0
        return int.from_bytes(frame.data[:2], "little")

    def gone(self, frame: Frame) -> bool:
        """Return whether a frame shows that the stage's owner is not OPERATIONAL, so at 0 V."""
        if frame.can_id == cia.NMT_ID and len(frame.data) == _NMT_BYTES:
            command, node_id = frame.data
            return command != NMTCommand.START and node_id in (0, self.owner)
        return frame.can_id == cia.HEARTBEAT_ID + self.owner and frame.data == cia.BOOT_UP

    def driven(self, frame: Frame) -> bool | None:
        """Return True for a stage with a voltage, False for 0 V, None if not shown by the frame."""
        voltage = self.stage.read(frame)
        if voltage is not None:
            return voltage > 0
        if self.inside:
            status = self.status.read(frame)
            off = status is not None and not status & Status.DRIVING
        else:
            own = frame.can_id == cia.EMCY_ID + self.owner
            off = self.drive.read(frame) == 0 or (own and self.emergency(frame) in _WENT_OFF)
        return False if off or self.gone(frame) else None

    def last(self, field: Field, frames: Sequence[Stamped]) -> int | None:
        """Return the last raw value of a field; None if there is none."""
        values = (field.read(frame) for _, frame in reversed(frames))
        return next((value for value in values if value is not None), None)


def _sent(od: ObjectDictionary, number: int, name: str) -> Field:
    return find_field(od, cia.TPDO_COMMUNICATION + number - 1, cia.TPDO_MAPPING + number - 1, name)


def cycles_to_zero(signs: Signs, before: Sequence[Stamped], after: Sequence[Stamped]) -> int | None:
    """Return the cycles from a fault until the stage stays at 0 V; None if it does not.

    Parameters
    ----------
    signs
        Decoder of the frames.
    before, after
        Frames before and after the fault; those before contain a SYNC.
    """
    zero: int | None = None
    fresh = False
    for cycle, frame in _in_cycles(signs, before, after):
        driven = signs.driven(frame)
        if frame.can_id == cia.SYNC_ID:
            fresh = False
        elif driven:
            zero, fresh = None, False
        elif driven is False and (zero is None or (fresh and frame.can_id == signs.stage.can_id)):
            # A statusword just before the stage belongs to the same cycle.
            zero, fresh = cycle, True
    return zero


def _in_cycles(
    signs: Signs, before: Sequence[Stamped], after: Sequence[Stamped]
) -> Iterator[tuple[int, Frame]]:
    """Yield frames with the number of their cycle, 0 until the first cycle after the fault.

    SYNC is sent in the middle of a cycle, after the frames of its beginning. Frames that follow
    from another follow at once. So a frame after an idle bus belongs to the next cycle, and so does
    the stage of a plate inside, which is sent at the beginning of a cycle.
    """
    sync = max(time for time, frame in before if frame.can_id == cia.SYNC_ID)
    end = before[-1][0]
    cycle, begun = 0, False
    for time, frame in after:
        begun = (
            begun
            or time - frame_bits(len(frame.data)) > end
            or (signs.inside and frame.can_id == signs.stage.can_id)
        )
        end = time
        if frame.can_id == cia.SYNC_ID:
            cycle += _ticks(time - sync)
            sync, begun = time, False
            yield cycle, frame
        elif time - sync > _SYNC_LATE_US:
            yield cycle + (time - sync + frame_bits(0)) // TICK_US, frame
        else:
            yield cycle + begun, frame


def _ticks(microseconds: int) -> int:
    """Return the number of cycles between two SYNCs; 1 if they are close."""
    return round(microseconds / TICK_US) if microseconds > _SYNC_LATE_US else 1


class Field(NamedTuple):
    """Position of an unsigned object in the PDO that maps it."""

    can_id: int
    first: int
    last: int
    """First byte, and the byte after the last one."""
    size: int
    """Number of bytes of the PDO."""

    def read(self, frame: Frame) -> int | None:
        """Return the raw value in a frame; None if the frame does not carry it."""
        if frame.can_id != self.can_id or frame.rtr or len(frame.data) != self.size:
            return None
        return int.from_bytes(frame.data[self.first : self.last], "little")


def find_field(od: ObjectDictionary, communication: int, mapping: int, name: str) -> Field:
    """Return the position of an object in a PDO that maps it by default, even if it is invalid.

    Parameters
    ----------
    od
        Object dictionary, loaded for the node-ID.
    communication, mapping
        Indices of the communication and mapping parameters of the PDO.
    name
        Name of an object of whole bytes.

    Raises
    ------
    ValueError
        If the PDO does not map the object.
    """
    wanted = od[name]
    can_id = od.number(communication, cia.PDO_COB_ID) & cia.CAN_ID_MASK
    mapped = [od.number(mapping, place) for place in range(1, od.number(mapping) + 1)]
    size = sum(value & 0xFF for value in mapped) // 8
    first = 0
    for value in mapped:
        last = first + (value & 0xFF) // 8
        if value >> 8 == wanted.index << 8 | wanted.subindex:
            return Field(can_id, first, last, size)
        first = last
    raise ValueError(f"{name} is not mapped in {communication:04X}h")


def parts(frames: Iterable[Stamped]) -> Iterator[list[Stamped]]:
    """Split a log at its silences, where frames are omitted.

    Raises
    ------
    ValueError
        If time runs backwards.
    """
    part: list[Stamped] = []
    before = 0
    for time, frame in frames:
        if time < before:
            raise ValueError(f"time runs backwards at {time * 1e-6:.6f} s")
        if part and time - before > _SILENCE_US:
            yield part
            part = []
        part.append((time, frame))
        before = time
    if part:
        yield part


def main(log: str, rows: str) -> str:
    """Return how much of the rows in a file a log confirms."""
    with Path(rows).open("rb") as file:
        stated = json.load(file)
    nodes = [load_eds(read_eds(f"{name}.eds"), node_id) for name, node_id in NODES.items()]
    found = verify_rows(read_candump(Path(log)), stated, *nodes)
    return (
        f"rows: {found.rows}, fields as the log shows them: {found.fields}, "
        f"fields it does not show: {found.not_shown}"
    )


if __name__ == "__main__":
    print(main(*sys.argv[1:]))
