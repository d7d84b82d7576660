"""NMT: behaviour of a device in each state (STATE), and its state changes (TRANS)."""

from __future__ import annotations

from collections.abc import Iterator

from smarttac_can.canopen.conformance.case import Failure, Group, case
from smarttac_can.canopen.conformance.error_control import STATES, needs_producer, set_period
from smarttac_can.canopen.conformance.examiner import Examiner, download, number, upload
from smarttac_can.canopen.conformance.pdo import can_id, configure, tpdo
from smarttac_can.canopen.conformance.sdo import other_value
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import DataType, NMTCommand
from smarttac_can.canopen.od.entry import Entry

_PERIOD_MS = 50
_NAMES: dict[int, str] = {state: state.name.replace("_", "-") for state in STATES.values()}


def _watch(examiner: Examiner) -> None:
    """Enable the heartbeat, which shows the state."""
    set_period(examiner, _PERIOD_MS)


def _expect_state(examiner: Examiner, state: NMTState, when: str) -> None:
    """Raise `Failure` unless the heartbeat has the state, at the latest after the time-out."""
    examiner.settle()
    data = b""
    for arrival in examiner.arrivals(examiner.timeout):
        if arrival.frame.can_id == examiner.heartbeat_id and not arrival.frame.rtr:
            data = arrival.frame.data
            if data == bytes((state,)):
                return
    got = _NAMES.get(data[0], "unknown state") if data else "no heartbeat"
    limit = f"within {examiner.timeout:g} s (--timeout)"
    raise Failure(f"{got} {when}, not {_NAMES[state]} {limit}")


def _sync_answered(examiner: Examiner, timeout: float) -> bool | None:
    """Return whether a TPDO of type 1 is sent at SYNC in time; None if there is no such TPDO."""
    sheet = examiner.sheet
    if not sheet.has(cia.SYNC_COB_ID) or not sheet.usable(sheet.tpdos):
        return None
    examiner.drain()
    examiner.sync()
    return examiner.wait(can_id(examiner, tpdo(examiner)), timeout) is not None


def _prepare(examiner: Examiner) -> None:
    examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    _watch(examiner)
    if examiner.sheet.has(cia.SYNC_COB_ID) and examiner.sheet.usable(examiner.sheet.tpdos):
        configure(examiner, tpdo(examiner), 1)


_state = Group("STATE", (needs_producer,))


@case(_state, 1, "7.3.2.1: PRE-OPERATIONAL; OPERATIONAL if 1F80h has bit 2 clear (CiA 302-2).")
def after_boot_up(examiner: Examiner) -> None:
    """After boot-up."""
    _watch(examiner)
    own = examiner.sheet.starts_itself
    state = NMTState.OPERATIONAL if own else NMTState.PRE_OPERATIONAL
    _expect_state(examiner, state, "after boot-up")


@case(_state, 2, "Table 38: SDO and error control, no PDO.")
def pre_operational(examiner: Examiner) -> None:
    """PRE-OPERATIONAL."""
    _prepare(examiner)
    _expect_state(examiner, NMTState.PRE_OPERATIONAL, "after enter pre-operational")
    upload(examiner, cia.DEVICE_TYPE)
    if _sync_answered(examiner, examiner.watch):
        raise Failure("TPDO in PRE-OPERATIONAL")


@case(_state, 3, "Table 38: SDO, PDO and error control.")
def operational(examiner: Examiner) -> None:
    """OPERATIONAL."""
    _prepare(examiner)
    examiner.enter(NMTCommand.START)
    _expect_state(examiner, NMTState.OPERATIONAL, "after start")
    upload(examiner, cia.DEVICE_TYPE)
    if _sync_answered(examiner, examiner.timeout) is False:
        raise Failure("no TPDO in OPERATIONAL")


@case(_state, 4, "Table 38: NMT and error control only.")
def stopped(examiner: Examiner) -> None:
    """STOPPED."""
    _prepare(examiner)
    examiner.enter(NMTCommand.STOP)
    _expect_state(examiner, NMTState.STOPPED, "after stop")
    examiner.sdo_send(b"\x40" + cia.DEVICE_TYPE.to_bytes(2, "little"))
    examiner.silence(cia.SDO_TX_ID + examiner.node_id, "SDO response in STOPPED")
    if _sync_answered(examiner, examiner.watch):
        raise Failure("TPDO in STOPPED")


_trans = Group("TRANS", (needs_producer,))


@case(_trans, 1, "Figure 49: start, stop and enter pre-operational lead from any state to theirs.")
def transitions(examiner: Examiner) -> None:
    """Between the states."""
    _watch(examiner)
    for first in STATES:
        for second, state in STATES.items():
            examiner.nmt(first)
            examiner.nmt(second)
            _expect_state(examiner, state, f"after {first:02X}h, {second:02X}h")


@case(
    _trans, 2, "7.2.8.3.1: 0 is for all nodes; those for others, unknown or malformed do nothing."
)
def addressee(examiner: Examiner) -> None:
    """Whom a command is for."""
    _watch(examiner)
    examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    examiner.nmt(NMTCommand.START, 0)
    _expect_state(examiner, NMTState.OPERATIONAL, "after start of all")
    examiner.nmt(NMTCommand.STOP, examiner.node_id % 127 + 1)
    examiner.nmt(0x55)
    examiner.send(cia.NMT_ID, bytes((NMTCommand.STOP,)))
    _expect_state(examiner, NMTState.OPERATIONAL, "after commands that are not for it")


def _parameter(examiner: Examiner) -> Entry | None:
    kinds = (DataType.UNSIGNED32, DataType.UNSIGNED16, DataType.INTEGER32, DataType.INTEGER16)
    return next(
        (
            e
            for e in examiner.sheet.od
            if e.index > cia.COMMUNICATION_LAST and e.access == "rw" and e.data_type in kinds
            and e.high > e.low and examiner.sheet.scans_write(e)
        ),
        None,
    )  # fmt: skip


def _reset_in_each_state(
    examiner: Examiner, reset: NMTCommand
) -> Iterator[tuple[Entry, bytes, bytes]]:
    """Reset from each state; yield a parameter, its original bytes, and those written.

    Raises
    ------
    Failure
        The producer time differs from that of the EDS after a reset.
    """
    stated = examiner.sheet.od.number(cia.HEARTBEAT_PRODUCER)
    for command in STATES:
        _watch(examiner)
        entry = _parameter(examiner)
        before = data = b""
        if entry is not None:
            before, data = (
                upload(examiner, entry.index, entry.subindex),
                other_value(examiner, entry),
            )
            download(examiner, entry.index, entry.subindex, data)
        examiner.enter(command)
        examiner.reset(reset)
        got = number(examiner, cia.HEARTBEAT_PRODUCER)
        if got != stated:
            raise Failure(f"producer time {got} ms after a reset, the EDS says {stated} ms")
        if entry is not None:
            yield entry, before, data


@case(
    _trans, 3, "7.3.2.2.2: from each state; 1000h to 1FFFh get their reset values, the others stay."
)
def reset_communication(examiner: Examiner) -> None:
    """Reset communication."""
    for entry, _, written in _reset_in_each_state(examiner, NMTCommand.RESET_COMMUNICATION):
        if upload(examiner, entry.index, entry.subindex) != written:
            raise Failure(f"reset communication changed {entry.name}")


@case(_trans, 4, "7.3.2.2.1: from each state; all objects get their reset values.")
def reset_node(examiner: Examiner) -> None:
    """Reset node."""
    for entry, before, _ in _reset_in_each_state(examiner, NMTCommand.RESET_NODE):
        if upload(examiner, entry.index, entry.subindex) != before:
            raise Failure(f"reset node does not reset {entry.name}")
