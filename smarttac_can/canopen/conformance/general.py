"""EDS file; identity, storage, error behaviour and restricted CAN-IDs (OTHER)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from smarttac_can.canopen.conformance import refusals
from smarttac_can.canopen.conformance.case import (
    COMMANDS,
    Failure,
    Group,
    NotApplicable,
    case,
    needs_object,
)
from smarttac_can.canopen.conformance.emcy import lose_node, needs_consumer, needs_emcy
from smarttac_can.canopen.conformance.error_control import needs_producer, set_period
from smarttac_can.canopen.conformance.examiner import (
    Examiner,
    download,
    number,
    try_number,
    upload,
    write_number,
)
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, NMTCommand
from smarttac_can.canopen.od.data_types import pack
from smarttac_can.canopen.od.eds import load_eds

UNIT_NOT_KNOWN = "taken as part of the name"
_SAVE = b"save"
_LOAD = b"load"
_PERIOD_MS = 50
_STORE_TIME_OUTS = 10
_RESTRICTED = (0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x701, 0x7FF)
_has_store = needs_object(cia.STORE_PARAMETERS, 1)
_has_restore = needs_object(cia.RESTORE_DEFAULTS, 1)


@case(
    Group("EDS"),
    1,
    "CiA 306: nothing in it is odd, and 1000h, 1001h, 1018h and an identity are there.",
)
def eds_file(examiner: Examiner) -> None:
    """EDS file."""
    # The notation of units in names is a convention of this package, not a rule for EDS files.
    # Characters that are not ASCII are common in files that CiA's own checker accepts.
    ascii_only = examiner.sheet.text.encode("ascii", "replace").decode()
    faults = load_eds(ascii_only, examiner.node_id).warnings
    examiner.remarks += [w for w in examiner.sheet.od.warnings if w not in faults]
    faults = [w for w in faults if not w.endswith(UNIT_NOT_KNOWN)]
    for index in (cia.DEVICE_TYPE, cia.ERROR_REGISTER, cia.IDENTITY):
        if index not in examiner.sheet.od.objects:
            faults.append(f"mandatory {index:04X}h is missing")
    if faults:
        raise Failure("; ".join(faults[:3]))


_other = Group("OTHER")


@case(
    _other,
    1,
    "7.5.2.1, .18: device type, vendor-ID, product code and revision are those of the EDS.",
)
def identity(examiner: Examiner) -> None:
    """Identity."""
    for index, subindex in (
        (cia.DEVICE_TYPE, 0),
        (cia.IDENTITY, 1),
        (cia.IDENTITY, 2),
        (cia.IDENTITY, 3),
    ):
        entry = examiner.sheet.od.get(index, subindex)
        if entry is None or not examiner.sheet.states_default(entry):
            continue
        got = number(examiner, index, subindex)
        if got != entry.default:
            raise Failure(f"{entry.name} is {got:X}h, the EDS says {entry.default:X}h")


@case(_other, 2, "7.5.2.2: 0 after a reset without an error.")
def error_register(examiner: Examiner) -> None:
    """Error register."""
    register = number(examiner, cia.ERROR_REGISTER)
    if register:
        raise Failure(f"error register {register:02X}h after a reset")


@case(_other, 3, "7.5.2.8 to .10: device name, hardware and software version are those of the EDS.")
def name_and_versions(examiner: Examiner) -> None:
    """Name and versions."""
    asked = 0
    for index in (cia.DEVICE_NAME, cia.HARDWARE_VERSION, cia.SOFTWARE_VERSION):
        entry = examiner.sheet.od.get(index)
        if entry is None or not examiner.sheet.states_default(entry):
            continue
        asked += 1
        got = upload(examiner, index).rstrip(b"\0")
        if got != pack(entry.data_type, entry.default):
            raise Failure(f"{entry.name} is {got!r}, the EDS says {entry.default!r}")
    if not asked:
        raise NotApplicable("the EDS states neither name nor version")


def _wrong_signatures(examiner: Examiner, index: int, signature: bytes) -> None:
    for wrong in (signature[::-1], signature.upper()):
        with examiner.refused(f"signature {wrong.hex(' ')}", refusals.SIGNATURE):
            download(examiner, index, 1, wrong)


@case(_other, 4, "7.5.2.13: all but 'save', also in reverse, is aborted by 0800002xh.", _has_store)
def store_signature(examiner: Examiner) -> None:
    """Signature for storing."""
    _wrong_signatures(examiner, cia.STORE_PARAMETERS, _SAVE)


def _command(examiner: Examiner, index: int, signature: bytes) -> None:
    """Write a signature to store or restore, which may take longer than other answers.

    Raises
    ------
    NotApplicable
        The device has no storage.
    """
    timeout, examiner.timeout = examiner.timeout, _STORE_TIME_OUTS * examiner.timeout
    try:
        download(examiner, index, 1, signature)
    except Abort as abort:
        raise NotApplicable(f"the device has nowhere to store: {abort}") from None
    finally:
        examiner.timeout = timeout


@case(_other, 5, "7.5.2.13: what was stored is in force after a reset.", _has_store, needs_producer)
def store(examiner: Examiner) -> None:
    """Storing."""
    before = number(examiner, cia.HEARTBEAT_PRODUCER)
    write_number(examiner, cia.HEARTBEAT_PRODUCER, 0, before + 1000)
    _command(examiner, cia.STORE_PARAMETERS, _SAVE)
    examiner.reset(NMTCommand.RESET_NODE)
    got = number(examiner, cia.HEARTBEAT_PRODUCER)
    write_number(examiner, cia.HEARTBEAT_PRODUCER, 0, before)
    _command(examiner, cia.STORE_PARAMETERS, _SAVE)
    if got != before + 1000:
        raise Failure(f"producer time {before + 1000} ms stored, {got} ms after a reset")


@case(
    _other, 6, "7.5.2.14: all but 'load', also in reverse, is aborted by 0800002xh.", _has_restore
)
def restore_signature(examiner: Examiner) -> None:
    """Signature for restoring."""
    _wrong_signatures(examiner, cia.RESTORE_DEFAULTS, _LOAD)


def _values(examiner: Examiner) -> dict[tuple[int, int], bytes]:
    """Read all writable entries, to write them back after the defaults were restored."""
    values = {}
    for entry in examiner.sheet.od:
        if (
            entry.access == "rw"
            and entry.index not in COMMANDS
            and examiner.sheet.scans_read(entry)
            and examiner.sheet.scans_write(entry)
        ):
            try:
                values[entry.index, entry.subindex] = upload(examiner, entry.index, entry.subindex)
            except Abort:
                continue
    return values


def _put_back(examiner: Examiner, values: dict[tuple[int, int], bytes]) -> None:
    changed = {place: data for place, data in values.items() if upload(examiner, *place) != data}
    for (index, subindex), data in changed.items():
        download(examiner, index, subindex, data)
    _command(examiner, cia.STORE_PARAMETERS, _SAVE)


@case(
    _other,
    7,
    "7.5.2.14: the defaults are in force after the next reset, not before.",
    _has_store,
    _has_restore,
    needs_producer,
)
def restore(examiner: Examiner) -> None:
    """Restoring."""
    values = _values(examiner)
    stated = examiner.sheet.od.number(cia.HEARTBEAT_PRODUCER)
    write_number(examiner, cia.HEARTBEAT_PRODUCER, 0, stated + 1000)
    _command(examiner, cia.STORE_PARAMETERS, _SAVE)
    _command(examiner, cia.RESTORE_DEFAULTS, _LOAD)
    at_once = number(examiner, cia.HEARTBEAT_PRODUCER)
    examiner.reset(NMTCommand.RESET_NODE)
    after = number(examiner, cia.HEARTBEAT_PRODUCER)
    _put_back(examiner, values)
    if at_once != stated + 1000:
        raise Failure("restoring changed a value before the reset")
    if after != stated:
        raise Failure(f"producer time {after} ms after restoring, the EDS says {stated} ms")


@case(
    _other,
    8,
    "7.5.2.22: date and time are kept as written and are 0 after a change of configuration.",
    needs_object(cia.VERIFY_CONFIGURATION, 1, writable=True),
    needs_object(cia.VERIFY_CONFIGURATION, 2, writable=True),
)
def verify_configuration(examiner: Examiner) -> None:
    """Verify configuration."""
    before = [number(examiner, cia.VERIFY_CONFIGURATION, subindex) for subindex in (1, 2)]
    try:
        for subindex, value in ((1, 15_000), (2, 43_200_000)):
            write_number(examiner, cia.VERIFY_CONFIGURATION, subindex, value)
        for subindex, value in ((1, 15_000), (2, 43_200_000)):
            got = number(examiner, cia.VERIFY_CONFIGURATION, subindex)
            if got != value:
                raise Failure(f"1020h:{subindex:02X} is {got}, {value} was written")
    finally:
        for subindex, value in zip((1, 2), before, strict=True):
            write_number(examiner, cia.VERIFY_CONFIGURATION, subindex, value)


def _cob_ids(examiner: Examiner) -> Iterator[tuple[int, int]]:
    sheet = examiner.sheet
    for pdo in sheet.usable(sheet.tpdos + sheet.rpdos):
        yield pdo.communication, cia.PDO_COB_ID
    if sheet.writable(cia.EMCY_COB_ID):
        yield cia.EMCY_COB_ID, 0
    for index in range(cia.SDO_SERVER_FIRST + 1, cia.SDO_SERVER_LAST + 1):
        for subindex in (1, 2):
            if sheet.writable(index, subindex):
                yield index, subindex


@case(
    _other,
    9,
    "Table 39: no PDO, EMCY or SDO server takes the CAN-IDs of NMT, SDO and error control.",
)
def restricted_ids(examiner: Examiner) -> None:
    """Restricted CAN-IDs."""
    asked = 0
    for index, subindex in _cob_ids(examiner):
        cob_id = number(examiner, index, subindex)
        if examiner.sheet.limits(index, subindex, cob_id | cia.COB_INVALID) is not None:
            continue
        write_number(examiner, index, subindex, cob_id | cia.COB_INVALID)
        flags = cob_id & ~0x3FFFFFFF & ~cia.COB_INVALID
        for can_id in _RESTRICTED:
            asked += 1
            what = f"CAN-ID {can_id:03X}h in {index:04X}h:{subindex:02X}"
            with examiner.refused(what, refusals.OUT_OF_RANGE):
                try_number(examiner, index, subindex, flags | can_id)
    if not asked:
        raise NotApplicable("the EDS has no COB-ID to write")


@case(
    _other,
    10,
    "7.5.2.32: in OPERATIONAL a lost node leads to PRE-OPERATIONAL, nowhere, or STOPPED.",
    needs_object(cia.ERROR_BEHAVIOUR, 1, writable=True),
    needs_consumer,
    needs_emcy,
    needs_producer,
)
def error_behaviour(examiner: Examiner) -> None:
    """Error behaviour."""
    states = (NMTState.PRE_OPERATIONAL, NMTState.OPERATIONAL, NMTState.STOPPED)
    for value, state in enumerate(states):
        write_number(examiner, cia.ERROR_BEHAVIOUR, 1, value)
        set_period(examiner, _PERIOD_MS)
        examiner.enter(NMTCommand.START)
        lose_node(examiner)
        examiner.settle()
        got = examiner.expect(examiner.heartbeat_id, "heartbeat").data
        if got != bytes((state,)):
            raise Failure(f"error behaviour {value} leads to state {got.hex()}h, not {state:02X}h")
        examiner.reset(NMTCommand.RESET_NODE)


_TELLING: Final = {1: "vendor-ID", 2: "product code"}


def differences(examiner: Examiner) -> list[str]:
    """Return how vendor-ID and product code differ from the EDS; empty if they agree.

    Values that the device does not report, or that the EDS leaves open or at 0, agree.
    """
    od = examiner.sheet.od
    found = []
    for subindex, name in _TELLING.items():
        entry = od.get(cia.IDENTITY, subindex)
        if entry is None or not entry.default:
            continue
        try:
            reported = number(examiner, cia.IDENTITY, subindex)
        except (Failure, Abort):
            continue
        if reported != entry.default:
            found.append(f"{name} is {reported:08X}h, not {entry.default:08X}h")
    return found
