"""Values of a device, by its EDS or DCF: read and compared, or written by the rules of CiA 301."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final

import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from smarttac_can.od.cia import (
    COB_INVALID,
    COMMUNICATION_LAST,
    PDO_COB_ID,
    PDO_COUNT,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    Abort,
    AbortCode,
)
from smarttac_can.od.data_types import unpack
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.eds import Sections
from smarttac_can.od.eds_check import Finding
from smarttac_can.od.entry import Entry

_PDOS: Final = ((RPDO_COMMUNICATION, RPDO_MAPPING), (TPDO_COMMUNICATION, TPDO_MAPPING))


def compare_reads(
    network: canopen.Network, od: ObjectDictionary, sections: Sections, timeout: float
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

    Yields
    ------
    Finding
        One for each object that the device refuses, or that has another value. If the device does
        not answer, that is the last one.
    """
    client = _client(network, od, timeout)
    for entry in od:
        if entry.readable:
            keys = sections.get(_section(entry, sections), {})
            stated = keys.get("parametervalue") or keys.get("defaultvalue")
            judged = bool(stated) and not _is_process_data(entry)
            try:
                yield from _read(client, entry, sections, judged=judged)
            except SdoCommunicationError:
                yield _silent(od, entry, sections)
                return


def write_dcf(
    network: canopen.Network, od: ObjectDictionary, sections: Sections, timeout: float
) -> Iterator[Finding]:
    """Write the values of a DCF to its device, and read each of them back.

    PDO parameters are written by the procedure of CiA 301, 7.5.2.36: COB-ID invalid, number of
    entries 0, entries, number, COB-ID. Values that the device refuses are skipped.

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

    Yields
    ------
    Finding
        One for each value that the device refuses, or reads back differently. If the device does
        not answer, that is the last one.
    """
    client = _client(network, od, timeout)
    values = stated_values(od, sections)
    refused = set()
    try:
        for entry, data in _writes(od, values):
            try:
                client.download(entry.index, entry.subindex, data)
            except SdoAbortedError as error:
                if entry not in refused:
                    text = f"the device refuses {entry.default!r}: {Abort(error.code)}"
                    yield Finding(_section(entry, sections), text)
                refused.add(entry)
        for entry in values:
            if entry.readable and entry not in refused:
                yield from _read(client, entry, sections, judged=True)
    except SdoCommunicationError:
        yield _silent(od, entry, sections)


def stated_values(od: ObjectDictionary, sections: Sections) -> list[Entry]:
    """Return the writable entries to which a DCF gives a ParameterValue."""
    return [
        entry
        for entry in od
        if entry.writable and "parametervalue" in sections.get(_section(entry, sections), {})
    ]


def _writes(od: ObjectDictionary, entries: Iterable[Entry]) -> Iterator[tuple[Entry, bytes]]:
    """Yield each entry with its bytes, in the order that a device requires."""
    pdos: dict[tuple[int, int], list[Entry]] = {}
    for entry in entries:
        for communication, mapping in _PDOS:
            number = entry.index - (mapping if entry.index >= mapping else communication)
            if entry.index >= communication and 0 <= number < PDO_COUNT:
                key = communication + number, mapping + number
                pdos.setdefault(key, []).append(entry)
                break
        else:
            yield entry, entry.pack()
    for (communication, mapping), members in pdos.items():
        cob_id, count = od.entry(communication, PDO_COB_ID), od.entry(mapping, 0)
        if cob_id.writable:
            yield cob_id, (cob_id.default | COB_INVALID).to_bytes(4, "little")
        if any(entry.index == mapping for entry in members) and count.writable:
            yield count, bytes(1)
            for position in range(1, count.default + 1):
                yield (mapped := od.entry(mapping, position)), mapped.pack()
            yield count, count.pack()
        for entry in members:
            if entry.index == communication and entry is not cob_id:
                yield entry, entry.pack()
        if cob_id.writable:
            yield cob_id, cob_id.pack()


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


def _is_process_data(entry: Entry) -> bool:
    return entry.pdo or (entry.access == "ro" and entry.index > COMMUNICATION_LAST)


def _section(entry: Entry, sections: Sections) -> str:
    """Return the name of the section of an entry."""
    name = f"{entry.index:04x}"
    for member in (f"{name}sub{entry.subindex:x}", f"{name}sub{entry.subindex:02x}"):
        if member in sections:
            return member
    return name
