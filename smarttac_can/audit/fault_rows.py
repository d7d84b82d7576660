"""Rows of the fault matrix recomputed from the log of its frames, and compared.

Of a row nothing is believed but its name, its mode, and when the fault came.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

from smarttac_can.audit.log_frames import Stamped, parts
from smarttac_can.audit.stage_signs import Signs, cycles_to_zero
from smarttac_can.device.frame import Frame
from smarttac_can.od.cia import CAN_ID_MASK, PDO_COB_ID, SYNC_ID, TPDO_COMMUNICATION
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import State, known_state

NOT_SHOWN: Final = {
    "cycles_to_zero": (
        # No frame of the plate passes; more SYNCs than its time has room for; no plate that acts.
        "a node babbles",
        "SYNC twice a cycle",
        "plate paused for 2 s",
    ),
    "held": (
        # What the plate had to send meanwhile comes when the way is free again.
        "a node babbles",
    ),
    "state_after": (
        # A stimulator that is not OPERATIONAL, or is not heard, publishes no statusword.
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
"""Faults of which the log does not show a field, by the field."""
_LONGEST_S: Final = 1e9
_RUN_CYCLES: Final = 400
"""A run that goes on has done so for that long; an identification ends by itself soon after."""
LEAST_HOLD: Final = 200
"""Cycles at 0 V, which the log leaves out, that are enough to tell its parts."""
_MODES: Final = {
    **{mode.name.lower(): mode for mode in Mode},
    "friction_predictive": Mode.FRICTION,
}
"""Modes by what rows call them; the last is under other laws, of which no frame tells."""


class DifferenceError(ValueError):
    """What a row says is not what the log shows."""


class Verified(NamedTuple):
    """How much was compared."""

    rows: int
    fields: int
    not_shown: int
    """Fields of rows that the log does not show."""


class _Claim(NamedTuple):
    """What is taken from a row, and the row for comparison."""

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
    """Recompute rows from a log and compare.

    Parameters
    ----------
    frames
        The log: time stamps in us and frames.
    rows
        The rows as JSON has them.
    stimulator, plate
        The EDS files, loaded for their node-IDs.

    Raises
    ------
    DifferenceError
        At the first difference, with row, field and both values; where the log lacks what a row
        needs; and if a fault took longer than its bound.
    ValueError
        If the rows are none, or the log is out of order.
    """
    claims = _claims(rows)
    _require_hold(claims)
    signs = [Signs(stimulator, plate, inside=inside) for inside in (False, True)]
    measured = plate.number(TPDO_COMMUNICATION, PDO_COB_ID) & CAN_ID_MASK
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
            said = claim.row.get(name, "missing")
            if _as_text(said) != _as_text(value):
                raise claim.differs(
                    f"{name} is {_as_text(said)} in the row, {_as_text(value)} in the log"
                )
            fields += 1
        _require_bound(claim, shown["cycles_to_zero"])
    if next(rest, None) is not None:
        raise DifferenceError(f"the log goes on after the {len(claims)} rows")
    return Verified(len(claims), fields, not_shown)


class _Shown:
    """What a log shows of one fault.

    Parameters
    ----------
    claim
        Name, mode and time.
    signs
        What its frames show.
    fault, recovery
        The frames around the fault, and those of the recovery.
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
        if all(frame.can_id != SYNC_ID for _, frame in self._before):
            raise claim.differs("the log has no SYNC before the fault")
        self._require_told()

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
        """Whether the stage is still at 0 V when the log goes on."""
        signs = (self._signs.driven(frame) for _, frame in self._recovery)
        return next((driven for driven in signs if driven is not None), None) is False

    def _recovered(self) -> bool:
        """Whether a run in the same mode goes on to the end, for long enough, with a voltage."""
        signs, frames = self._signs, self._recovery
        cycles = 0
        for _, frame in reversed(frames):
            word = signs.status.read(frame)
            if word is not None and known_state(word) is not State.RUNNING:
                break
            cycles += frame.can_id == SYNC_ID
        return (
            cycles >= _RUN_CYCLES
            and signs.last(signs.mode, frames) == self._claim.mode
            and bool(signs.last(signs.stage, frames))
        )

    def _require_told(self) -> None:
        """Refuse a log without the stage in each cycle that has to show it."""
        signs = self._signs
        drive: int | None = None
        told = True
        for time, frame in self._before:
            told = self._follow_sync(time, frame, told)
            voltage = signs.stage.read(frame)
            if None not in (voltage, drive) and voltage != drive and not signs.inside:
                raise self._claim.differs(
                    f"the stage shows {voltage} x 10 mV at {time * 1e-6:.6f} s, "
                    f"the drive before it {drive} x 10 mV"
                )
            answer = signs.drive.read(frame)
            drive = drive if answer is None else answer
        if signs.inside or self._claim.fault in NOT_SHOWN["cycles_to_zero"]:
            return
        for time, frame in self._after:
            if signs.gone(frame):
                return
            told = self._follow_sync(time, frame, told)

    def _follow_sync(self, time: int, frame: Frame, told: bool) -> bool:
        """Return whether the stage was shown since the last SYNC."""
        if frame.can_id != SYNC_ID:
            return told or self._signs.stage.read(frame) is not None
        if not told:
            raise self._claim.differs(
                f"the log does not show the stage in the cycle before {time * 1e-6:.6f} s"
            )
        return False


def _claims(rows: object) -> list[_Claim]:
    """Take name, mode and time from rows.

    Raises
    ------
    ValueError
        If one of them is missing, or makes no sense.
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
    """Refuse rows of a short hold: their log does not show where the recovery begins."""
    for claim in claims:
        cycles = claim.row.get("cycles_at_zero")
        if claim.row.get("held") is True and isinstance(cycles, int) and cycles < LEAST_HOLD:
            raise claim.differs(
                f"was held for {cycles} cycles, of which the log shows nothing: only one made "
                f"with --hold {LEAST_HOLD} or more can be verified"
            )


def _require_bound(claim: _Claim, cycles: object) -> None:
    """Refuse a fault that was detected too late, by the log; the row says only when that is."""
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
