"""NMT: what a device does in each state (STATE), and how it changes it (TRANS)."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, case
from smarttac_can.conformance.pdo_setup import can_id, configure, tpdo
from smarttac_can.conformance.probe import Probe
from smarttac_can.conformance.sdo import other_value
from smarttac_can.conformance.sdo_client import download, upload, write_number
from smarttac_can.conformance.sheet import needs_object
from smarttac_can.od.cia import (
    COMMUNICATION_LAST,
    DEVICE_TYPE,
    HEARTBEAT_PRODUCER,
    NMT_ID,
    NMT_STARTUP,
    SDO_TX_ID,
    SYNC_COB_ID,
    DataType,
    NMTCommand,
)
from smarttac_can.od.dictionary import Entry

_PERIOD_MS = 50
_STOPPED, _OPERATIONAL, _PRE_OPERATIONAL = 0x04, 0x05, 0x7F
_NO_AUTOSTART = 4
_COMMANDS = {
    NMTCommand.START: _OPERATIONAL,
    NMTCommand.STOP: _STOPPED,
    NMTCommand.ENTER_PRE_OPERATIONAL: _PRE_OPERATIONAL,
}
_NAMES = {_STOPPED: "STOPPED", _OPERATIONAL: "OPERATIONAL", _PRE_OPERATIONAL: "PRE-OPERATIONAL"}
_has_heartbeat = needs_object(HEARTBEAT_PRODUCER, writable=True)


def _watch(probe: Probe) -> None:
    """Make the state visible by a heartbeat."""
    write_number(probe, HEARTBEAT_PRODUCER, 0, _PERIOD_MS)


def _expect_state(probe: Probe, state: int, when: str) -> None:
    probe.settle()
    data = probe.expect(probe.heartbeat_id, "heartbeat").data
    if data != bytes((state,)):
        got = _NAMES.get(data[0], "unknown") if data else "empty"
        raise Failure(f"{got} {when}, not {_NAMES[state]}")


def _sync_answered(probe: Probe) -> bool | None:
    """Tell whether a TPDO of type 1 comes at SYNC; None if there is none to ask."""
    sheet = probe.sheet
    if not sheet.has(SYNC_COB_ID) or not sheet.usable(sheet.tpdos):
        return None
    probe.drain()
    probe.sync()
    return probe.wait(can_id(probe, tpdo(probe))) is not None


def _prepare(probe: Probe) -> None:
    probe.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    _watch(probe)
    if probe.sheet.has(SYNC_COB_ID) and probe.sheet.usable(probe.sheet.tpdos):
        configure(probe, tpdo(probe), 1)


@case(
    "STATE-01",
    "7.3.2.1: PRE-OPERATIONAL; OPERATIONAL if 1F80h has bit 2 clear (CiA 302-2).",
    _has_heartbeat,
)
def after_boot_up(probe: Probe) -> None:
    """After boot-up."""
    _watch(probe)
    startup = probe.sheet.od.number(NMT_STARTUP, absent=_NO_AUTOSTART)
    state = _PRE_OPERATIONAL if startup & _NO_AUTOSTART else _OPERATIONAL
    _expect_state(probe, state, "after boot-up")


@case(
    "STATE-02",
    "Table 38: SDO and error control, no PDO.",
    _has_heartbeat,
)
def pre_operational(probe: Probe) -> None:
    """PRE-OPERATIONAL."""
    _prepare(probe)
    _expect_state(probe, _PRE_OPERATIONAL, "after enter pre-operational")
    upload(probe, DEVICE_TYPE)
    if _sync_answered(probe):
        raise Failure("TPDO in PRE-OPERATIONAL")


@case("STATE-03", "Table 38: SDO, PDO and error control.", _has_heartbeat)
def operational(probe: Probe) -> None:
    """OPERATIONAL."""
    _prepare(probe)
    probe.enter(NMTCommand.START)
    _expect_state(probe, _OPERATIONAL, "after start")
    upload(probe, DEVICE_TYPE)
    if _sync_answered(probe) is False:
        raise Failure("no TPDO in OPERATIONAL")


@case("STATE-04", "Table 38: NMT and error control only.", _has_heartbeat)
def stopped(probe: Probe) -> None:
    """STOPPED."""
    _prepare(probe)
    probe.enter(NMTCommand.STOP)
    _expect_state(probe, _STOPPED, "after stop")
    probe.sdo_send(b"\x40" + DEVICE_TYPE.to_bytes(2, "little"))
    probe.silence(SDO_TX_ID + probe.node_id, "SDO response in STOPPED")
    if _sync_answered(probe):
        raise Failure("TPDO in STOPPED")


@case(
    "TRANS-01",
    "Figure 49: start, stop and enter pre-operational lead from any state to theirs.",
    _has_heartbeat,
)
def transitions(probe: Probe) -> None:
    """Between the states."""
    _watch(probe)
    for first in _COMMANDS:
        for second, state in _COMMANDS.items():
            probe.nmt(first)
            probe.nmt(second)
            _expect_state(probe, state, f"after {first:02X}h, {second:02X}h")


@case(
    "TRANS-02",
    "7.2.8.3.1: 0 is for all nodes; those for others, unknown or malformed do nothing.",
    _has_heartbeat,
)
def addressee(probe: Probe) -> None:
    """Whom a command is for."""
    _watch(probe)
    probe.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    probe.nmt(NMTCommand.START, 0)
    _expect_state(probe, _OPERATIONAL, "after start of all")
    probe.nmt(NMTCommand.STOP, probe.node_id % 127 + 1)
    probe.nmt(0x55)
    probe.send(NMT_ID, bytes((NMTCommand.STOP,)))
    _expect_state(probe, _OPERATIONAL, "after commands that are not for it")


def _parameter(probe: Probe) -> Entry | None:
    """Find a number of the application that takes other values; None if there is none."""
    kinds = (DataType.UNSIGNED32, DataType.UNSIGNED16, DataType.INTEGER32, DataType.INTEGER16)
    return next(
        (
            e
            for e in probe.sheet.od
            if e.index > COMMUNICATION_LAST and e.access == "rw" and e.data_type in kinds
            and e.high > e.low
        ),
        None,
    )  # fmt: skip


def _change(probe: Probe, entry: Entry) -> tuple[bytes, bytes]:
    """Write another value to an entry; return the bytes before and after."""
    before = upload(probe, entry.index, entry.subindex)
    data = other_value(probe, entry)
    download(probe, entry.index, entry.subindex, data)
    return before, data


@case(
    "TRANS-03",
    "7.3.2.2.2: from each state; 1000h to 1FFFh get their reset values, the others stay.",
    _has_heartbeat,
)
def reset_communication(probe: Probe) -> None:
    """Reset communication."""
    for command in _COMMANDS:
        _watch(probe)
        entry = _parameter(probe)
        written = None if entry is None else _change(probe, entry)
        probe.enter(command)
        probe.reset(NMTCommand.RESET_COMMUNICATION)
        _expect_default_period(probe)
        if entry is not None and written is not None:
            got = upload(probe, entry.index, entry.subindex)
            if got != written[1]:
                raise Failure(f"reset communication changed {entry.name}")


@case(
    "TRANS-04",
    "7.3.2.2.1: from each state; all objects get their reset values.",
    _has_heartbeat,
)
def reset_node(probe: Probe) -> None:
    """Reset node."""
    for command in _COMMANDS:
        _watch(probe)
        entry = _parameter(probe)
        written = None if entry is None else _change(probe, entry)
        probe.enter(command)
        probe.reset(NMTCommand.RESET_NODE)
        _expect_default_period(probe)
        if entry is not None and written is not None:
            got = upload(probe, entry.index, entry.subindex)
            if got != written[0]:
                raise Failure(f"reset node does not reset {entry.name}")


def _expect_default_period(probe: Probe) -> None:
    got = int.from_bytes(upload(probe, HEARTBEAT_PRODUCER), "little")
    stated = probe.sheet.od.number(HEARTBEAT_PRODUCER)
    if got != stated:
        raise Failure(f"producer time {got} ms after a reset, the EDS says {stated} ms")
