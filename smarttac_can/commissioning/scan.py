"""Scan of a bus, comparison of a device with its EDS, and download of a DCF."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from time import sleep
from typing import Any, Final, NamedTuple

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError, SdoError

from smarttac_can.commissioning.node_ids import ASKS_DEVICE_TYPE, Identity, unconfigured, wait_until
from smarttac_can.device.nmt import UNKNOWN, state_text
from smarttac_can.master.errors import BenchError
from smarttac_can.master.sdo_client import SharedSdoClient
from smarttac_can.od.cia import (
    COB_INVALID,
    COMMUNICATION_LAST,
    DEVICE_NAME,
    HEARTBEAT_ID,
    HEARTBEAT_PRODUCER,
    IDENTITY,
    PDO_COB_ID,
    PDO_COUNT,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    SDO_RX_ID,
    SDO_TX_ID,
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

UNCONFIGURED: Final = "unconfigured"

_PDOS: Final = ((RPDO_COMMUNICATION, RPDO_MAPPING), (TPDO_COMMUNICATION, TPDO_MAPPING))
_NODE_IDS: Final = range(1, 128)
_SEND_PAUSE_S: Final = 0.001
_SEND_TRIES: Final = 100
_HEARTBEATS_WAITED: Final = 1.5


class FoundDevice(NamedTuple):
    """A device on the bus, as far as it is known."""

    node_id: int | None
    """Node-ID; None for a device without one, found by LSS."""
    state: str
    """NMT state from heartbeat or node guarding, or `UNKNOWN`, or `UNCONFIGURED`."""
    name: str
    identity: Identity | None
    eds: str
    """Name of the EDS that describes the device; empty if there is none."""
    doubled: bool = False
    """Whether more than one device has answered for the node-ID."""


def scan(
    network: canopen.Network, eds_files: Mapping[str, ObjectDictionary], timeout: float
) -> list[FoundDevice]:
    """Find all devices: with an answer to SDO, with a heartbeat, or without node-ID.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    eds_files
        Object dictionaries of EDS files to compare with, by name.
    timeout
        Time in s to listen, and longest wait for each answer.

    Raises
    ------
    BenchError
        If the bus accepts no frames.
    """
    states: dict[int, str] = {}

    def hear(can_id: int, data: bytearray, _timestamp: float) -> None:
        if len(data) == 1:
            # The top bit is the toggle bit of node guarding.
            states[can_id - HEARTBEAT_ID] = state_text(data[0] & 0x7F)

    answers: Counter[int] = Counter()

    def count(can_id: int, _data: bytearray, _timestamp: float) -> None:
        answers[can_id - SDO_TX_ID] += 1

    for node_id in _NODE_IDS:
        network.subscribe(HEARTBEAT_ID + node_id, hear)
        network.subscribe(SDO_TX_ID + node_id, count)
    network.scanner.reset()
    for node_id in _NODE_IDS:
        _send(network, SDO_RX_ID + node_id, ASKS_DEVICE_TYPE)
    sleep(timeout)
    # One request gets one answer per device.
    doubled = {node_id for node_id, number in answers.items() if number > 1}
    found = []
    for node_id in sorted({*network.scanner.nodes, *states}):
        # The second answer of a doubled node-ID must not be taken for that to the next request.
        client = SharedSdoClient(network, node_id, timeout)
        client.MAX_RETRIES = 1
        device = _ask(client, node_id, eds_files)
        _wait_for_state(network, client, node_id, states, timeout)
        state = states.get(node_id, UNKNOWN)
        found.append(device._replace(state=state, doubled=node_id in doubled))
    for identity in unconfigured(network):
        found.append(
            FoundDevice(None, UNCONFIGURED, "", identity, matching_eds(identity, eds_files.items()))
        )
    return found


def matching_eds(identity: Identity, eds_files: Iterable[tuple[str, ObjectDictionary]]) -> str:
    """Return the name of the EDS with the vendor and product of a device.

    An EDS of another revision comes second, and is named with ``(revision differs)``.
    """
    second = ""
    for name, od in eds_files:
        vendor, product, revision = (od.number(IDENTITY, subindex) for subindex in (1, 2, 3))
        if (vendor, product) == (identity.vendor, identity.product):
            if revision == identity.revision:
                return name
            second = second or f"{name} (revision differs)"
    return second


def _ask(
    client: SharedSdoClient, node_id: int, eds_files: Mapping[str, ObjectDictionary]
) -> FoundDevice:

    def read(index: int, subindex: int = 0) -> bytes:
        try:
            return bytes(client.upload(index, subindex))
        except SdoError:
            return b""

    vendor = read(IDENTITY, 1)
    if not vendor:
        return FoundDevice(node_id, UNKNOWN, "", None, "")
    rest = (read(IDENTITY, subindex) for subindex in (2, 3, 4))
    identity = Identity(*(int.from_bytes(data, "little") for data in (vendor, *rest)))
    name = read(DEVICE_NAME).decode("latin-1").strip("\0 ")
    return FoundDevice(node_id, UNKNOWN, name, identity, matching_eds(identity, eds_files.items()))


def _wait_for_state(
    network: canopen.Network,
    client: SharedSdoClient,
    node_id: int,
    states: dict[int, str],
    timeout: float,
) -> None:
    """Wait for the heartbeat, or request the state by node guarding if there is none."""
    if node_id in states:
        return
    try:
        period = int.from_bytes(client.upload(HEARTBEAT_PRODUCER, 0), "little")
    except SdoError:
        period = 0
    if not period:
        _send(network, HEARTBEAT_ID + node_id, b"", remote=True)
    wait_until(lambda: node_id in states, _HEARTBEATS_WAITED * period * 1e-3 if period else timeout)


def _send(network: canopen.Network, can_id: int, data: bytes, *, remote: bool = False) -> None:
    """Send a frame, and try again while a short transmit queue is full."""
    for _ in range(_SEND_TRIES):
        try:
            network.send_message(can_id, data, remote)
        except (can.CanError, OSError) as error:
            reason = error
            sleep(_SEND_PAUSE_S)
        else:
            return
    raise BenchError(f"the bus takes no frames: {reason}")


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
