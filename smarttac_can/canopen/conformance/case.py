"""Definition of a case of the suite, and of the device description that the cases use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import DataType
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds, parse_integer, read_sections
from smarttac_can.canopen.od.entry import Entry

if TYPE_CHECKING:
    from smarttac_can.canopen.conformance.examiner import Examiner


Need = Callable[["DeviceDescription"], str | None]
"""Function that returns why a case does not apply to such a device, None if it does."""


class Failure(Exception):  # noqa: N818 - an outcome, not a mistake of the suite
    """The device violates the rule; the message is one line."""


class NotApplicable(Exception):  # noqa: N818 - an outcome
    """The device does not support an optional feature; the message is one line."""


@dataclass(frozen=True, slots=True)
class Case:
    """One case of the suite.

    Attributes
    ----------
    number
        Identifier, such as ``SDO-07``.
    title
        Subject of the case.
    rule
        Rule for the device, with the clause of CiA 301 (4.2), 302 or 306.
    needs
        Requirements on the EDS for the case to apply.
    check
        Function that examines the device; it raises `Failure` or `NotApplicable`.
    """

    number: str
    title: str
    rule: str
    needs: tuple[Need, ...]
    check: Callable[[Examiner], None]

    @property
    def group(self) -> str:
        """First part of the number."""
        return self.number.partition("-")[0]


class Group(NamedTuple):
    """Cases of one subject that share requirements."""

    name: str
    """First part of their numbers."""
    needs: tuple[Need, ...] = ()


def case(
    group: Group, number: int, rule: str, *needs: Need
) -> Callable[[Callable[[Examiner], None]], Case]:
    """Return a decorator that makes a case of a function, whose docstring, a noun, is the title.

    The case needs what the group needs, and its own needs.
    """

    def made(check: Callable[[Examiner], None]) -> Case:
        title = (check.__doc__ or "").rstrip(".")
        return Case(f"{group.name}-{number:02d}", title, rule, (*group.needs, *needs), check)

    return made


class Result(NamedTuple):
    """Result of a case.

    Attributes
    ----------
    verdict
        ``pass``, ``fail`` or ``not applicable``.
    reason
        Reason for the verdict; empty for a pass.
    trace
        Last frames of a failed case, ``>`` to and ``<`` from the device.
    remarks
        What is unusual and no fault, such as a refusal by an abort code of another meaning.
    """

    case: Case
    verdict: str
    reason: str = ""
    trace: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


COMMANDS: Final = frozenset({cia.STORE_PARAMETERS, cia.RESTORE_DEFAULTS})
"""Objects in which a write is a command, so that their values are never written back."""


NO_AUTOSTART: Final = 4
"""Bit 2 of 1F80h (CiA 302-2): the device does not enter OPERATIONAL by itself."""
_REFUSES_WRITE, _REFUSES_READ = 1, 2
"""Bits of ObjFlags (CiA 306): what a scan of the whole dictionary must leave out."""


class Pdo(NamedTuple):
    """Indices of one PDO."""

    communication: int
    mapping: int


class DeviceDescription:
    """Description of a device under test by its EDS.

    Parameters
    ----------
    text
        Content of the EDS.
    node_id
        Node-ID of the device, 1..127.
    """

    def __init__(self, text: str, node_id: int) -> None:
        self.text = text
        self.od: ObjectDictionary = load_eds(text, node_id)
        self.node_id = node_id
        self.sections = read_sections(text, [])
        self.tpdos = self._pdos(cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING)
        self.rpdos = self._pdos(cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING)

    def _pdos(self, communication: int, mapping: int) -> list[Pdo]:
        objects = self.od.objects
        return [
            Pdo(communication + n, mapping + n)
            for n in range(cia.PDO_COUNT)
            if communication + n in objects and mapping + n in objects
        ]

    def has(self, index: int, subindex: int = 0) -> bool:
        """Return whether the EDS describes an entry."""
        return self.od.get(index, subindex) is not None

    def writable(self, index: int, subindex: int = 0) -> bool:
        """Return whether the EDS describes an entry that can be written."""
        entry = self.od.get(index, subindex)
        return entry is not None and entry.writable

    def limits(self, index: int, subindex: int, value: int) -> str | None:
        """Return why a value is beyond the limits of the EDS for an entry, None if it is not."""
        entry = self.od.entry(index, subindex)
        if entry.low <= value <= entry.high:
            return None
        span = f"{entry.low:.0f} to {entry.high:.0f}"
        return f"the EDS limits {index:04X}h:{subindex:02X} to {span}, this case writes {value}"

    def _flags(self, entry: Entry) -> int:
        """Return the ObjFlags of an entry, else those of its object."""
        for name in (f"{entry.index:04x}sub{entry.subindex:x}", f"{entry.index:04x}"):
            if flags := self.sections.get(name, {}).get("objflags"):
                return parse_integer(flags, f"[{name}] ObjFlags")
        return 0

    def scans_write(self, entry: Entry) -> bool:
        """Return whether a scan may write an entry: its ObjFlags do not refuse it."""
        return not self._flags(entry) & _REFUSES_WRITE

    def scans_read(self, entry: Entry) -> bool:
        """Return whether a scan may read an entry: its ObjFlags do not refuse it."""
        return not self._flags(entry) & _REFUSES_READ

    @property
    def starts_itself(self) -> bool:
        """Whether the device enters OPERATIONAL by itself (1F80h, CiA 302-2)."""
        return not self.od.number(cia.NMT_STARTUP, absent=NO_AUTOSTART) & NO_AUTOSTART

    @property
    def produces_sync(self) -> bool:
        """Whether the device produces SYNC by its default values."""
        producer = self.od.number(cia.SYNC_COB_ID) & cia.COB_SYNC_PRODUCER
        return bool(producer and self.od.number(cia.SYNC_PERIOD))

    @property
    def sends_emcy(self) -> bool:
        """Whether EMCY exists and is valid by its default value."""
        return self.has(cia.EMCY_COB_ID) and not self.od.number(cia.EMCY_COB_ID) & cia.COB_INVALID

    @property
    def pdo_ids(self) -> set[int]:
        """CAN-IDs of all PDOs by their default values."""
        pdos = self.tpdos + self.rpdos
        return {self.od.number(pdo.communication, cia.PDO_COB_ID) & cia.CAN_ID_MASK for pdo in pdos}

    def allows_rtr(self, pdo: Pdo) -> bool:
        """Return whether a PDO allows remote frames by its default COB-ID (bit 30)."""
        return not self.od.number(pdo.communication, cia.PDO_COB_ID) & cia.COB_NO_RTR

    def states_default(self, entry: Entry) -> bool:
        """Return whether the EDS states a default value of an entry."""
        for name in (f"{entry.index:04x}sub{entry.subindex:x}", f"{entry.index:04x}"):
            section = self.sections.get(name, {})
            if value := section.get("defaultvalue") or section.get("parametervalue"):
                return value.isascii()  # the bytes of other characters are not known
        values = self.sections.get(f"{entry.index:04x}value", {})
        return bool(values.get(str(entry.subindex)))

    def mapped(self, pdo: Pdo) -> list[int]:
        """Return the default mapping of a PDO in the EDS."""
        return [self.od.number(pdo.mapping, n) for n in range(1, self.od.number(pdo.mapping) + 1)]

    def usable(self, pdos: list[Pdo]) -> list[Pdo]:
        """Return the PDOs that have a mapping and can be configured."""
        return [
            pdo
            for pdo in pdos
            if self.mapped(pdo)
            and self.writable(pdo.communication, cia.PDO_COB_ID)
            and self.writable(pdo.communication, cia.PDO_TRANSMISSION)
            and self.od.number(pdo.communication, cia.PDO_COB_ID) & cia.CAN_ID_MASK
        ]

    def mappable(self, pdos: list[Pdo]) -> list[Pdo]:
        """Return the usable PDOs with a writable mapping."""
        return [
            pdo
            for pdo in self.usable(pdos)
            if self.writable(pdo.mapping) and self.writable(pdo.mapping, 1)
        ]

    def number_entries(self) -> list[Entry]:
        """Return the rw numbers of 4 bytes, those without side effects first."""
        harmless = [
            self.od.get(cia.VERIFY_CONFIGURATION, 1),
            self.od.get(cia.HEARTBEAT_CONSUMER, 1),
        ]
        words = (e for e in self.od if e.index > cia.COMMUNICATION_LAST)
        return [
            entry
            for entry in (*harmless, *words)
            if entry is not None
            and entry.access == "rw"
            and entry.data_type == DataType.UNSIGNED32
            and entry.high > entry.low
            and self.scans_write(entry)
        ]

    def long_entry(self) -> Entry | None:
        """Return a readable entry that needs more than one frame; None if there is none."""
        name = self.od.get(cia.DEVICE_NAME)
        candidates = ([] if name is None else [name]) + list(self.od)
        return next(
            (e for e in candidates if e.readable and _length(e) > cia.EXPEDITED_BYTES), None
        )

    def long_writable(self) -> Entry | None:
        """Return an rw entry of the application with more than 4 bytes; None if there is none."""
        return next(
            (
                entry
                for entry in self.od
                if entry.index > cia.COMMUNICATION_LAST
                and entry.access == "rw"
                and _length(entry) > cia.EXPEDITED_BYTES
                and self.scans_write(entry)
            ),
            None,
        )


def _length(entry: Entry) -> int:
    return entry.size or len(entry.default)


def needs_object(index: int, subindex: int = 0, *, writable: bool = False) -> Need:
    """Require that the EDS describes an entry, which can be written if ``writable``."""

    def reason(sheet: DeviceDescription) -> str | None:
        if not sheet.has(index, subindex):
            return f"the EDS has no {index:04X}h:{subindex:02X}"
        if writable and not sheet.writable(index, subindex):
            return f"{index:04X}h:{subindex:02X} cannot be written"
        return None

    return reason


needs_sync = needs_object(cia.SYNC_COB_ID)


def needs_tpdo(sheet: DeviceDescription) -> str | None:
    """Require a TPDO that can be configured."""
    return None if sheet.usable(sheet.tpdos) else "the EDS has no TPDO that can be configured"


def needs_rpdo(sheet: DeviceDescription) -> str | None:
    """Require an RPDO that can be configured."""
    return None if sheet.usable(sheet.rpdos) else "the EDS has no RPDO that can be configured"


def needs_mapping(sheet: DeviceDescription) -> str | None:
    """Require a TPDO whose mapping can be changed."""
    return None if sheet.mappable(sheet.tpdos) else "the EDS has no TPDO with a writable mapping"


def needs_number(sheet: DeviceDescription) -> str | None:
    """Require a number of 4 bytes that can be written."""
    return None if sheet.number_entries() else "the EDS has no rw number of 4 bytes to write"
