"""The page of states and watchdogs, from the tables in the code; `tools/reference.py` writes it."""

from __future__ import annotations

from collections.abc import Iterator

from smarttac_can.nodes.lock import OF_PLATE, OF_STIMULATOR, Place, Table
from smarttac_can.nodes.states import (
    STAGE_TRANSITIONS,
    TRANSITIONS,
    Guard,
    StageState,
)
from smarttac_can.od.cia import EmergencyCode, ErrorRegister
from smarttac_can.od.object_reference import table
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.states import Control, State
from smarttac_can.vocabulary.watchdogs import FORGOTTEN, WATCHDOGS

_WITHOUT_GUARD = ""
_OF_THE_PLATE = (
    (
        EmergencyCode.RPDO_TIME_OUT,
        ErrorRegister.COMMUNICATION,
        "no RPDO 1 within its deadline, 1400h sub-index 5, 20 ms by default; the next row is what "
        "puts the plate at 0 V then",
        "an RPDO 1 whose values are within their limits",
    ),
    (
        FaultCode.DRIVE_LOST,
        ErrorRegister.COMMUNICATION,
        "a plate that was driven has gone to 0 V by itself: within the deadline no drive that "
        "counts (none, corrupt, out of range, of another tick), three drives in a row with "
        "a wrong check, or fewer again and again, OPERATIONAL left, a watched "
        "heartbeat lost, transmit queue full, 1006h not 1000 us. Sent in OPERATIONAL, unless one "
        "of those below was",
        "a drive of 0 V",
    ),
    (
        FaultCode.DOUBLE,
        ErrorRegister.COMMUNICATION,
        "another node has sent with an identifier of the plate: EMCY, measurement, SDO response, "
        "heartbeat or boot-up; remote frames do not count",
        "a drive of 0 V, after 3 s without such a frame",
    ),
    (
        FaultCode.VOLTAGE,
        ErrorRegister.VOLTAGE,
        "a drive above `Limit.Voltage` of the plate",
        "a drive of 0 V",
    ),
    (
        FaultCode.STAGE,
        ErrorRegister.VOLTAGE,
        "a power stage that puts out more than 1 V more or less than it was told: at once where it "
        "reads itself back, as in the simulation; by `Stage read-back`, once mapped, for 3 cycles "
        "in a row or fewer again and again, where a reading may be a cycle old: 5 cycles at most. "
        "Sent again for each voltage that is asked for after 0 V",
        "a drive of 0 V, once the reading is right; by `Stage read-back` after "
        f"{FORGOTTEN + 1} such cycles",
    ),
    (
        FaultCode.NOT_ENABLED,
        ErrorRegister.MANUFACTURER,
        "`Enable` is mapped and 0, or an RPDO with `Enable` or `Stage read-back` in its mapping is "
        "valid and was not heard within its event timer. Sent if the stage was in use, and for "
        "each voltage that is asked for after 0 V",
        "a drive of 0 V, once enabled and heard",
    ),
    (
        FaultCode.TEMPERATURE,
        ErrorRegister.TEMPERATURE,
        "a sample above `Limit.Temperature` of the plate",
        "a drive of 0 V, after a sample that is not",
    ),
)
"""What `smarttac_can/nodes/plate_node.py` and its RPDO 1 report: code, register, cause and end."""


def _title(name: str | None) -> str:
    return (name or "").lower().replace("_", " ")


def _guard(guard: Guard) -> str:
    return _title(guard.name) if guard else _WITHOUT_GUARD


def _where(place: Place) -> str:
    """Name the objects of a place."""
    where = f"{place.first:04X}h"
    if place.last != place.first:
        where += f" to {place.last:04X}h"
    if place.subindices:
        where += " sub-index " + ", ".join(str(subindex) for subindex in place.subindices)
    return where


def _stricter(laxer: Table) -> Iterator[str]:
    """List what a write does not make laxer under a drive."""
    return table(
        ("Object", "Laxer is"),
        *((f"`{name}`", rule.text) for name, rule in laxer.by_name.items()),
        *((_where(place), place.rule.text) for place in laxer.by_index),
    )


def _stage() -> list[str]:
    """List the states of the plate's power stage, and what leads from one to another."""
    return [
        *table(("State", "What it is"), *((_title(s.name), s.value) for s in StageState)),
        *table(
            ("State", "Event", "What it is", "Next"),
            *(
                (
                    _title(row.state.name),
                    _title(row.event.name),
                    row.event.value,
                    _title(row.next.name),
                )
                for row in STAGE_TRANSITIONS
            ),
        ),
    ]


def safety() -> str:
    """Return states, transitions and watchdogs as Markdown."""
    lines = [
        "# States and watchdogs",
        "",
        "Made by `tools/reference.py` from `smarttac_can/nodes/states.py` and "
        "`smarttac_can/vocabulary/watchdogs.py`: change those. "
        "[Safety](../explanation/safety.md) says why it is so.",
        "",
        "## States",
        "",
        "![What leads from one state to another](../images/states.svg)",
        "",
        *table(
            ("Number", "State"),
            *((f"{int(state)}", _title(state.name)) for state in State),
        ),
        "## Transitions",
        "",
        "Every other pair of state and event is refused, and the state unchanged. *clear*: no "
        "latched fault is present any more. *prepared*: no fault is present, NMT OPERATIONAL, "
        "measurements come, the gauges have a zero.",
        "",
        *table(
            ("State", "Event", "What it is", "Guard", "Next"),
            *(
                (
                    _title(row.state.name),
                    _title(row.event.name),
                    row.event.value,
                    _guard(row.guard),
                    _title(row.next.name),
                )
                for row in TRANSITIONS
            ),
        ),
        "## Controlword",
        "",
        *table(
            ("Bit", "Command"),
            *((f"{int(bit).bit_length() - 1}", _title(bit.name)) for bit in Control),
        ),
        "## Watchdogs of the stimulator",
        "",
        "*Bit* is that of `Diagnosis.Present` and `Diagnosis.Latched`, and the first manufacturer "
        "byte of the emergency. *Bound* is in cycles, from the first faulty one to a drive of 0 V, "
        "where every cycle is faulty. *Forgets* is what sound cycles in between do to the count: "
        "where it forgets slowly, faulty cycles that are spread add up. If a share s of the cycles "
        f"is faulty, it trips after about {FORGOTTEN}/({FORGOTTEN + 1} s - 1) times the bound; "
        f"with 1 faulty cycle in {FORGOTTEN + 1} or fewer it never does. "
        "Every row sets the generic bit of the error register as well.",
        "",
        *table(
            (
                "Bit",
                "Fault",
                "Looks at",
                "EMCY",
                "Error register",
                "Bound",
                "Why",
                "Forgets",
                "Limit",
            ),
            *(
                (
                    f"{int(watchdog)}",
                    row.text,
                    row.looks_at,
                    f"{row.code:04X}h",
                    f"{int(row.register):02X}h",
                    f"{row.bound}",
                    row.why,
                    row.forgets,
                    row.limit,
                )
                for watchdog, row in WATCHDOGS.items()
            ),
        ),
        "The reset, once the cause is gone: 0, 80h, 0 in the controlword. [With frames]"
        "(pdos-and-states.md#reset-a-fault), [with python-canopen]"
        "(../how-to/integrate-with-a-master.md#with-python-canopen); a bench script has "
        "`reset_fault()`.",
        "",
        "## Limits and watches while armed or running",
        "",
        "From `smarttac_can/nodes/lock.py`. While the stimulator is armed or running, a write "
        "that makes one of these laxer is refused with 08000022h. The present value, a stricter "
        "one and a watch where there was none are taken. The public TPDOs 1 to 4 are free. "
        "Entries of a mapping are refused before, with 06010000h, while sub-index 0 is not 0. "
        "The mappings of the loop are constant: 06010002h in every state.",
        "",
        *_stricter(OF_STIMULATOR),
        "The plate does the same while its power stage is *in use*:",
        "",
        *_stricter(OF_PLATE),
        "## Power stage of the plate",
        "",
        "From `smarttac_can/nodes/states.py`. Every other event changes nothing.",
        "",
        *_stage(),
        "## Watchdogs of the plate",
        "",
        "The plate protects itself, whatever the stimulator says. Each of these puts it at 0 V at "
        "once, and there it takes no voltage before a drive of 0 V, which a stimulator in FAULT "
        "sends by itself. It has no state machine and needs no reset.",
        "",
        *table(
            ("EMCY", "Error register", "What trips it", "Over with"),
            *(
                (f"{code:04X}h", f"{int(register):02X}h", cause, end)
                for code, register, cause, end in _OF_THE_PLATE
            ),
        ),
    ]
    return "\n".join(lines)
