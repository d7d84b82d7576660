"""Whether a device on the bus reads as its EDS says."""

from __future__ import annotations

from collections.abc import Iterator

import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from smarttac_can.od.cia import COMMUNICATION_LAST, Abort, AbortCode
from smarttac_can.od.data_types import unpack
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.od.finding import Finding, Sections


def compare_reads(
    network: canopen.Network, od: ObjectDictionary, sections: Sections, timeout: float
) -> Iterator[Finding]:
    """Read every object of a device over SDO and compare it with the default of the EDS.

    Objects without a default and process data, which are mappable or, outside the communication
    profile area, read only, need only be readable.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    od
        The EDS, loaded for the device's node-ID.
    sections
        The same, as it is written.
    timeout
        Longest wait for an answer in s.

    Yields
    ------
    Finding
        For each object that the device refuses or reads otherwise. A device that does not answer
        is the last one.
    """
    client = network.add_node(od.node_id, canopen.ObjectDictionary()).sdo
    client.RESPONSE_TIMEOUT = timeout
    client.MAX_RETRIES = 1
    for entry in od:
        if not entry.readable:
            continue
        section = _section(entry, sections)
        try:
            found = unpack(entry.data_type, client.upload(entry.index, entry.subindex))
        except SdoAbortedError as error:
            if error.code != AbortCode.NO_DATA:
                yield Finding(section, f"the device refuses to read it: {Abort(error.code)}")
        except SdoCommunicationError:
            yield Finding(section, f"node {od.node_id} does not answer")
            return
        except Abort as error:
            yield Finding(section, f"the device reads as no {entry.data_type.name}: {error}")
        else:
            keys = sections.get(section, {})
            stated = keys.get("parametervalue") or keys.get("defaultvalue")
            if stated and not _is_process_data(entry) and found != entry.default:
                yield Finding(section, f"the device reads {found!r}, not {entry.default!r}")


def _is_process_data(entry: Entry) -> bool:
    return entry.pdo or (entry.access == "ro" and entry.index > COMMUNICATION_LAST)


def _section(entry: Entry, sections: Sections) -> str:
    """Return the section of an entry; that of the object for a CompactSubObj."""
    name = f"{entry.index:04x}"
    for member in (f"{name}sub{entry.subindex:x}", f"{name}sub{entry.subindex:02x}"):
        if member in sections:
            return member
    return name
