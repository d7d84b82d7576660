"""Values of a device, by its EDS or DCF: read and compared, or written by the rules of CiA 301."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from typing import Any, Final, NamedTuple

import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from smarttac_can.canopen.device.service import settable
from smarttac_can.canopen.master.errors import NodeNotFoundError, WrongDeviceError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, DataType
from smarttac_can.canopen.od.data_types import pack, unpack
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import Sections, parse_integer
from smarttac_can.canopen.od.eds_check import Finding
from smarttac_can.canopen.od.entry import Entry

_PDOS: Final = (
    (cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING),
    (cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING),
)
_SYNC: Final = (cia.SYNC_COB_ID, cia.SYNC_PERIOD, cia.SYNC_WINDOW, cia.SYNC_COUNTER)
_COMMANDS: Final = (cia.ERROR_FIELD, cia.STORE_PARAMETERS, cia.RESTORE_DEFAULTS)
_COB_IDS: Final = (1, 2)
"""Sub-indices of the COB-IDs of an SDO server or client."""
_IDENTITY: Final = {
    1: ("vendor-ID", True),
    2: ("product code", True),
    3: ("revision number", False),
    4: ("serial number", False),
}
"""Numbers of the identity by sub-index, and whether another one means another kind of device."""
_LONGEST_SHOWN: Final = 60
_NOT_ON_SCAN: Final = 2
"""Bit of ObjFlags (CiA 306) of an object that is not to be read by a scan of all objects."""

Progress = Callable[[float], None]


def compare_reads(
    network: canopen.Network,
    od: ObjectDictionary,
    sections: Sections,
    timeout: float,
    *,
    progress: Progress = lambda _share: None,
) -> Iterator[Finding]:
    """Read every object of a device over SDO and compare it with the default of the EDS.

    Objects without a default, and process data, need only be readable. Process data are mappable
    objects, and read-only objects outside the communication profile area.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    od
        Object dictionary from the EDS, loaded for the device's node-ID.
    sections
        Sections of the same EDS, with its compact forms written out.
    timeout
        Longest wait for an answer in s.
    progress
        Function called with the fraction of the objects that are done, 0..1.

    Yields
    ------
    Finding
        One for each object that the device refuses, or that has another value. If the device does
        not answer, that is the last one.
    """
    client = _client(network, od, timeout)
    for entry in _showing(od, progress):
        if entry.readable and not _flags(entry, sections) & _NOT_ON_SCAN:
            keys = sections.get(_section(entry, sections), {})
            stated = keys.get("parametervalue") or keys.get("defaultvalue")
            judged = bool(stated) and not _is_process_data(entry)
            try:
                yield from _read(client, entry, sections, judged=judged)
            except SdoCommunicationError:
                yield _silent(od, entry, sections)
                return


def write_dcf(
    network: canopen.Network,
    od: ObjectDictionary,
    sections: Sections,
    timeout: float,
    *,
    any_device: bool = False,
    progress: Progress = lambda _share: None,
) -> Iterator[Finding]:
    """Write the values of a DCF to its device, and read each of them back.

    The identity (1018h) is compared before anything is written. Communication parameters are
    written by the procedures of CiA 301: a COB-ID is invalid while it changes, a PDO while its
    mapping does, and so on. A PDO whose mapping the device refuses is left invalid.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    od
        Object dictionary from the DCF, loaded for the device's node-ID.
    sections
        Sections of the same DCF, with its compact forms written out.
    timeout
        Longest wait for an answer in s.
    any_device
        Whether to write to a device of another vendor or product.
    progress
        Function called with the fraction of the values that are read back, 0..1.

    Yields
    ------
    Finding
        One for each value that the device refuses, or reads back differently, and a warning for
        another revision or serial number. If the device stops answering, that is the last one.

    Raises
    ------
    NodeNotFoundError
        Nothing was written, as the device does not answer.
    WrongDeviceError
        Nothing was written, as the device has another vendor-ID or product code.
    """
    client = _client(network, od, timeout)
    yield from compare_identity(client, od, any_device=any_device)
    values = stated_values(od, sections)
    writer = _Writer(client, od)
    try:
        writer.write_all(values)
        for entry, text in writer.refused.items():
            yield Finding(_section(entry, sections), text)
        for entry in _showing(values, progress):
            readable = entry.readable and entry.data_type is not DataType.DOMAIN
            if readable and entry not in writer.refused:
                yield from _read(client, entry, sections, judged=True)
    except SdoCommunicationError:
        yield Finding("", f"node {od.node_id} does not answer any more")


def compare_identity(
    client: Any, od: ObjectDictionary, *, any_device: bool = False
) -> Iterator[Finding]:
    """Compare the identity of a device with that of its EDS, where that is stated.

    Yields
    ------
    Finding
        A warning for each number that differs.

    Raises
    ------
    NodeNotFoundError
        The device does not answer.
    WrongDeviceError
        Vendor-ID or product code differ, unless `any_device`.
    """
    for subindex, (name, telling) in _IDENTITY.items():
        stated = od.number(cia.IDENTITY, subindex)
        try:
            found = int.from_bytes(client.upload(cia.IDENTITY, subindex), "little")
        except SdoAbortedError:
            continue
        except SdoCommunicationError:
            raise NodeNotFoundError(f"node {od.node_id} does not answer") from None
        if not stated or found == stated:
            continue
        text = f"the device has the {name} {found:X}h, the file {stated:X}h"
        if telling and not any_device:
            raise WrongDeviceError(
                f"node {od.node_id} is another device, and nothing is written: {text}"
            )
        yield Finding(f"{cia.IDENTITY:04x}sub{subindex}", text, error=False)


class ReadValues(NamedTuple):
    """What a device has in the entries that a DCF may state."""

    values: dict[Entry, Any]
    """Raw values by entry."""
    unread: list[Finding]
    """A finding for each entry that could not be read, and a warning for another revision."""
    serial: int
    """Serial number (1018h:4), 0 without one."""


def read_values(
    network: canopen.Network,
    od: ObjectDictionary,
    sections: Sections,
    timeout: float,
    *,
    any_device: bool = False,
    progress: Progress = lambda _share: None,
) -> ReadValues:
    """Read what a DCF of a device would state: each value that can be read and written.

    The identity (1018h) is compared first. Left out are entries that the ObjFlags keep from a scan,
    what `write_dcf` does not write, and process data, which no DCF should write back: entries of
    access rww or rwr, and what an RPDO of the device maps, as a control word.

    Parameters
    ----------
    network, od, sections, timeout, any_device
        As for `write_dcf`.
    progress
        Function called with the fraction of the objects that are done, 0..1.

    Raises
    ------
    NodeNotFoundError
        The device does not answer.
    WrongDeviceError
        The device has another vendor-ID or product code.
    """
    client = _client(network, od, timeout)
    values: dict[Entry, Any] = {}
    unread = list(compare_identity(client, od, any_device=any_device))
    for entry in _showing(od, progress):
        if not (_in_dcf(entry) and entry.readable) or _flags(entry, sections) & _NOT_ON_SCAN:
            continue
        try:
            data = client.upload(entry.index, entry.subindex)
            values[entry] = unpack(entry.data_type, data)
        except SdoCommunicationError:
            raise NodeNotFoundError(f"node {od.node_id} does not answer any more") from None
        except SdoAbortedError as error:
            reason = f"the device refuses to read it: {Abort(error.code)}"
            unread.append(Finding(_section(entry, sections), reason))
        except Abort as error:
            reason = f"the device reads as no {entry.data_type.name}: {error}"
            unread.append(Finding(_section(entry, sections), reason))
    try:
        serial = int.from_bytes(client.upload(cia.IDENTITY, 4), "little")
    except SdoAbortedError:
        serial = 0
    mapped = {
        (value >> 16, value >> 8 & 0xFF)
        for entry, value in values.items()
        if 0 <= entry.index - cia.RPDO_MAPPING < cia.PDO_COUNT and entry.subindex
    }
    kept = {
        entry: value
        for entry, value in values.items()
        if entry.access not in ("rww", "rwr") and (entry.index, entry.subindex) not in mapped
    }
    return ReadValues(kept, unread, serial)


class Difference(NamedTuple):
    """An entry that has two values; None where it is not described."""

    address: str
    """Index and sub-index, as 2010h:1."""
    name: str
    first: Any
    second: Any

    def __str__(self) -> str:
        first, second = ("-" if v is None else _shown(v) for v in (self.first, self.second))
        return f"{self.address} {self.name}: {first} | {second}"


def compare_values(first: Mapping[Entry, Any], second: Mapping[Entry, Any]) -> list[Difference]:
    """Compare raw values by index and sub-index, in their order.

    Parameters
    ----------
    first, second
        Values by entry, of two DCFs, or of a DCF and a device.
    """
    names = {(e.index, e.subindex): e.name for e in (*second, *first)}
    one, other = ({(e.index, e.subindex): v for e, v in d.items()} for d in (first, second))
    return [
        Difference(f"{at[0]:04X}h:{at[1]}", names[at], one.get(at), other.get(at))
        for at in sorted(names)
        if one.get(at) != other.get(at)
    ]


def read_device_eds(network: canopen.Network, node_id: int, timeout: float) -> bytes:
    """Read the EDS that a device has in 1021h.

    Raises
    ------
    NodeNotFoundError
        The device does not answer.
    WrongDeviceError
        It has no EDS, or one that is compressed (1022h).
    """
    client = _client(network, ObjectDictionary(node_id, []), timeout)
    try:
        data = bytes(client.upload(cia.STORE_EDS, 0))
        with suppress(SdoAbortedError):
            if (kind := int.from_bytes(client.upload(cia.STORE_FORMAT, 0), "little")) != 0:
                text = f"node {node_id} has its EDS in the format {kind} (1022h), not as a text"
                raise WrongDeviceError(text)
    except SdoAbortedError as error:
        text = f"node {node_id} has no EDS in 1021h ({Abort(error.code)})"
        raise WrongDeviceError(text) from error
    except SdoCommunicationError:
        raise NodeNotFoundError(f"node {node_id} does not answer") from None
    return data


def _in_dcf(entry: Entry) -> bool:
    """Whether a value in a DCF is written to a device; see `stated_values`."""
    default_sdo = entry.index == cia.SDO_SERVER_FIRST and entry.subindex in _COB_IDS
    return entry.writable and entry.index not in _COMMANDS and not default_sdo


def stated_values(od: ObjectDictionary, sections: Sections) -> list[Entry]:
    """Return the writable entries to which a DCF gives a ParameterValue or a DownloadFile.

    Commands are left out: to clear the errors (1003h), to store and to restore (1010h, 1011h). So
    are the COB-IDs of the default SDO, over which they would be written.
    """
    return [
        entry
        for entry in od
        if _in_dcf(entry)
        and {"parametervalue", "downloadfile"} & sections.get(_section(entry, sections), {}).keys()
    ]


def take_files(entries: Iterable[Entry], sections: Sections, read: Callable[[str], bytes]) -> None:
    """Set the values of the entries with a DownloadFile (CiA 306) to the content of that file.

    Parameters
    ----------
    read
        Function that returns the content of a file by its name in the DCF.

    Raises
    ------
    ValueError
        The content is no value of the entry.
    """
    for entry in entries:
        name = sections.get(section := _section(entry, sections), {}).get("downloadfile", "")
        if name:
            try:
                entry.default = entry.value = unpack(entry.data_type, read(name))
            except Abort as error:
                where = f"[{section}] DownloadFile={name}"
                raise ValueError(f"{where} is no {entry.data_type.name}: {error}") from error


class _Writer:
    """Write values to a device in the order and by the steps of CiA 301.

    Attributes
    ----------
    refused
        Entries whose last write was refused, and why.
    """

    def __init__(self, client: Any, od: ObjectDictionary) -> None:
        self._client = client
        self._od = od
        self.refused: dict[Entry, str] = {}

    def write_all(self, values: Iterable[Entry]) -> None:
        """Write values: services first, then PDOs, and last the date of the configuration."""
        objects: dict[int, list[Entry]] = {}
        pdos: dict[int, list[Entry]] = {}
        last: list[Entry] = []
        for entry in values:
            if entry.index == cia.VERIFY_CONFIGURATION:
                last.append(entry)  # a write of anything else would make it invalid
            elif (pdo := _communication_record(entry.index)) is not None:
                pdos.setdefault(pdo, []).append(entry)
            else:
                objects.setdefault(
                    cia.SYNC_COB_ID if entry.index in _SYNC else entry.index, []
                ).append(entry)
        for index, entries in objects.items():
            self._write_object(index, entries)
        for communication, entries in pdos.items():
            self._write_pdo(communication, entries)
        for entry in last:
            self._write(entry)

    def _write_object(self, index: int, entries: list[Entry]) -> None:
        """Write the entries of one object, or of all those of SYNC."""
        if index == cia.SYNC_COB_ID:
            self._write_sync({entry.index: entry for entry in entries})
            return
        if index == cia.EMCY_COB_ID:
            self._write(entries[0], entries[0].default | cia.COB_INVALID)
        elif index == cia.TIME_COB_ID:
            self._write(
                entries[0], entries[0].default & ~(cia.COB_TIME_CONSUMER | cia.COB_TIME_PRODUCER)
            )
        elif index == cia.HEARTBEAT_CONSUMER:
            for entry in entries:  # so that no two of them supervise the same node meanwhile
                if entry.subindex:
                    self._write(entry, 0)
        elif cia.SDO_SERVER_FIRST < index <= cia.SDO_CLIENT_LAST:
            for entry in entries:
                if entry.subindex in _COB_IDS:
                    self._write(entry, entry.default | cia.COB_INVALID)
        # COB-IDs come last: from then on the object is in use.
        late = cia.SDO_SERVER_FIRST < index <= cia.SDO_CLIENT_LAST
        for entry in sorted(entries, key=lambda entry: late and entry.subindex in _COB_IDS):
            self._write(entry)

    def _write_sync(self, stated: dict[int, Entry]) -> None:
        """Write SYNC: the CAN-ID while it produces none, the counter while it has no period."""
        cob_id, period = stated.get(cia.SYNC_COB_ID), stated.get(cia.SYNC_PERIOD)
        counter = stated.get(cia.SYNC_COUNTER)
        if cob_id is not None:
            self._write(cob_id, cob_id.default & ~cia.COB_SYNC_PRODUCER)
        present = period or self._od.get(cia.SYNC_PERIOD)
        if counter is not None and present is not None:
            if period is None:
                present.default = self._present(present)
            if self._write(present, 0):
                period = present
        for entry in (stated.get(cia.SYNC_WINDOW), counter, period, cob_id):
            if entry is not None:
                self._write(entry)

    def _write_pdo(self, communication: int, entries: list[Entry]) -> None:
        """Write a PDO by 7.5.2.36: invalid, no objects, objects, their number, and valid."""
        mapping = communication + cia.RPDO_MAPPING - cia.RPDO_COMMUNICATION
        cob_id, count = self._od.get(communication, cia.PDO_COB_ID), self._od.get(mapping, 0)
        if cob_id is not None and cob_id not in entries:
            cob_id.default = self._present(cob_id)
        if cob_id is not None and cob_id.default != cob_id.default | cia.COB_INVALID:
            self._write(cob_id, cob_id.default | cia.COB_INVALID)
        mapped = [entry for entry in entries if entry.index == mapping]
        whole = not mapped or self._write_mapping(mapping, count, mapped)
        for entry in entries:
            if entry.index == communication and entry is not cob_id:
                self._write(entry)
        if cob_id is not None and not whole:
            self.refused[cob_id] = "the PDO is left invalid, as its mapping is refused"
        elif cob_id is not None and (cob_id in entries or cob_id.writable):
            self._write(cob_id)

    def _write_mapping(self, mapping: int, count: Entry | None, stated: list[Entry]) -> bool:
        """Write the objects of a mapping; return whether the device has taken all."""
        if count is None or not settable(count, 0):
            written = [self._write(entry) for entry in stated]
            return all(written)
        self._write(count, 0)
        number = count.default if count.default <= cia.MOST_MAPPED else cia.LAST_SUBINDEX
        objects = (self._od.get(mapping, position) for position in range(1, number + 1))
        written = [self._write(entry) for entry in objects if entry is not None]
        return all(written) and self._write(count)

    def _write(self, entry: Entry, raw: int | None = None) -> bool:
        """Write the value of the DCF, or a step before that; return whether it was accepted.

        A step that the limits of the EDS rule out is left out, as the device cannot require it.
        """
        if raw is not None and not settable(entry, raw):
            return False
        data = pack(entry.data_type, entry.default if raw is None else raw)
        try:
            self._client.download(entry.index, entry.subindex, data)
        except SdoAbortedError as error:
            value = _shown(entry.default if raw is None else raw)
            self.refused[entry] = f"the device refuses {value}: {Abort(error.code)}"
            return False
        self.refused.pop(entry, None)
        return True

    def _present(self, entry: Entry) -> Any:
        """Return the value that the device has, or that of the file if it cannot be read."""
        try:
            return unpack(entry.data_type, self._client.upload(entry.index, entry.subindex))
        except (SdoAbortedError, Abort):
            return entry.default


def _shown(value: object) -> str:
    """Return a value in one short line."""
    text = repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def _communication_record(index: int) -> int | None:
    """Return the index of the communication record of a PDO's object, None for another object."""
    for communication, mapping in _PDOS:
        for first in (communication, mapping):
            if 0 <= index - first < cia.PDO_COUNT:
                return index - first + communication
    return None


def _showing(entries: Iterable[Entry], progress: Progress) -> Iterator[Entry]:
    """Yield entries, and report how many of them are done."""
    every = list(entries)
    for number, entry in enumerate(every):
        progress(number / len(every))
        yield entry
    progress(1.0)


def _client(network: canopen.Network, od: ObjectDictionary, timeout: float) -> Any:
    client = network.add_node(od.node_id, canopen.ObjectDictionary()).sdo
    client.RESPONSE_TIMEOUT = timeout
    client.MAX_RETRIES = 1
    return client


def _read(client: Any, entry: Entry, sections: Sections, *, judged: bool) -> Iterator[Finding]:
    """Read an entry; yield a finding if it cannot be read or, when `judged`, its value differs."""
    section = _section(entry, sections)
    try:
        found = unpack(entry.data_type, client.upload(entry.index, entry.subindex))
    except SdoAbortedError as error:
        if error.code != AbortCode.NO_DATA:
            yield Finding(section, f"the device refuses to read it: {Abort(error.code)}")
    except Abort as error:
        yield Finding(section, f"the device reads as no {entry.data_type.name}: {error}")
    else:
        if judged and found != entry.default:
            yield Finding(section, f"the device reads {found!r}, not {entry.default!r}")


def _silent(od: ObjectDictionary, entry: Entry, sections: Sections) -> Finding:
    return Finding(_section(entry, sections), f"node {od.node_id} does not answer")


def _flags(entry: Entry, sections: Sections) -> int:
    """Return the ObjFlags of an entry, or else of its object."""
    own = sections.get(_section(entry, sections), {}).get("objflags")
    text = own or sections.get(f"{entry.index:04x}", {}).get("objflags", "")
    return parse_integer(text, "ObjFlags") if text else 0


def _is_process_data(entry: Entry) -> bool:
    return entry.pdo or (entry.access == "ro" and entry.index > cia.COMMUNICATION_LAST)


def _section(entry: Entry, sections: Sections) -> str:
    """Return the name of the section of an entry."""
    name = f"{entry.index:04x}"
    for member in (f"{name}sub{entry.subindex:x}", f"{name}sub{entry.subindex:02x}"):
        if member in sections:
            return member
    return name
