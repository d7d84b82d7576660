"""Scan of a bus: its devices, with state, identity and EDS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from time import sleep
from typing import Final, NamedTuple

import can
import canopen
from canopen.sdo.exceptions import SdoError

from smarttac_can.canopen.commissioning.node_ids import (
    ASKS_DEVICE_TYPE,
    Identity,
    unconfigured,
    wait_until,
)
from smarttac_can.canopen.device.nmt import UNKNOWN, state_text
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.master.sdo_client import SharedSdoClient
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary

UNCONFIGURED: Final = "unconfigured"

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
    network: canopen.Network,
    eds_files: Mapping[str, ObjectDictionary],
    timeout: float,
    progress: Callable[[float], None] = lambda _share: None,
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
    progress
        Function called with the fraction of the fastscan for a device that is done, 0..1.

    Raises
    ------
    BenchError
        If the bus accepts no frames.
    """
    states: dict[int, str] = {}

    def hear(can_id: int, data: bytearray, _timestamp: float) -> None:
        if len(data) == 1:
            # The top bit is the toggle bit of node guarding.
            states[can_id - cia.HEARTBEAT_ID] = state_text(data[0] & 0x7F)

    answers: Counter[int] = Counter()

    def count(can_id: int, _data: bytearray, _timestamp: float) -> None:
        answers[can_id - cia.SDO_TX_ID] += 1

    for node_id in _NODE_IDS:
        network.subscribe(cia.HEARTBEAT_ID + node_id, hear)
        network.subscribe(cia.SDO_TX_ID + node_id, count)
    network.scanner.reset()
    for node_id in _NODE_IDS:
        _send(network, cia.SDO_RX_ID + node_id, ASKS_DEVICE_TYPE)
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
    for identity in unconfigured(network, progress):
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
        vendor, product, revision = (od.number(cia.IDENTITY, subindex) for subindex in (1, 2, 3))
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

    vendor = read(cia.IDENTITY, 1)
    if not vendor:
        return FoundDevice(node_id, UNKNOWN, "", None, "")
    rest = (read(cia.IDENTITY, subindex) for subindex in (2, 3, 4))
    identity = Identity(*(int.from_bytes(data, "little") for data in (vendor, *rest)))
    name = read(cia.DEVICE_NAME).decode("latin-1").strip("\0 ")
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
        period = int.from_bytes(client.upload(cia.HEARTBEAT_PRODUCER, 0), "little")
    except SdoError:
        period = 0
    if not period:
        _send(network, cia.HEARTBEAT_ID + node_id, b"", remote=True)
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
