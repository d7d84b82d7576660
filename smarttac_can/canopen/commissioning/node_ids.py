"""Node-IDs for devices that are addressed by their identity, by LSS (CiA 305)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic, sleep
from types import SimpleNamespace
from typing import Any, Final, NamedTuple, Self

import canopen
from canopen import lss
from canopen.lss import LssError

from smarttac_can.canopen.master.errors import NodeNotFoundError, RefusedError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import NMTCommand

_FASTSCAN_S: Final = 0.1
"""Time in s without an answer that counts as no; half of the 132 questions of fastscan get none."""
_QUESTIONS: Final = 133
"""Questions of a fastscan that finds a device: the first, and 33 for each part of its identity."""
_LATE_S: Final = 1.0
"""Time in s to listen for an answer that comes too late, to tell it from none."""
_TOO_LATE: Final = (
    f"a device without node-ID answers fastscan later than the {_FASTSCAN_S:g} s that it may take: "
    "give the device's identity, which waits for the time-out"
)
_NO_ANSWER: Final = (
    "no device without node-ID answers fastscan; one that has a node-ID already takes another by "
    "its identity"
)
_MOST_UNCONFIGURED: Final = 127
_POLL_S: Final = 0.01
ASKS_DEVICE_TYPE: Final = bytes((0x40, cia.DEVICE_TYPE & 0xFF, cia.DEVICE_TYPE >> 8, 0, 0, 0, 0, 0))
"""SDO request that reads an object that every device has."""


class Identity(NamedTuple):
    """The four numbers of the object Identity, which are unique for each device."""

    vendor: int
    product: int
    revision: int
    serial: int

    def __str__(self) -> str:
        """Return the identity in the form of the commands."""
        return ":".join(f"{number:08X}" for number in self)


class Assigned(NamedTuple):
    """Result of assigning a node-ID to a device."""

    identity: Identity
    previous: int | None
    """Node-ID before; None if the device had none."""
    booted: bool
    """Whether the boot-up message with the new node-ID was received."""


def unconfigured(
    network: canopen.Network, progress: Callable[[float], None] = lambda _share: None
) -> Iterator[Identity]:
    """Find devices without node-ID, one after the other, by fastscan.

    A device that was found does not answer until the scan has ended.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    progress
        Function called with the fraction of the search for each device that is done, 0..1.
    """
    with _waiting_afterwards(network):
        for _ in range(_MOST_UNCONFIGURED):
            with _counted(network, progress):
                identity = _fast_scan(network)
            if identity is None:
                return
            yield identity


def assign_node_id(
    network: canopen.Network,
    node_id: int,
    *,
    identity: Identity | None,
    store: bool,
    timeout: float,
    force: bool,
    progress: Callable[[float], None] = lambda _share: None,
) -> Assigned:
    """Assign a node-ID to a device and let it start with that.

    Unless forced, it first checks whether another device answers with that node-ID.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    node_id
        New node-ID, 1..127.
    identity
        Identity of the device; None for the first one without node-ID that fastscan finds.
    store
        Whether the device stores the node-ID permanently.
    timeout
        Longest wait for an answer, and for the boot-up message, in s.
    force
        Whether to skip the check that the node-ID is free.
    progress
        Function called with the fraction of a fastscan that is done, 0..1.

    Raises
    ------
    NodeNotFoundError
        If no such device answers in time. The message says if an answer came too late.
    RefusedError
        If the node-ID is in use, or the device does not accept or store it.
    """
    master = network.lss
    booted: list[bytes] = []
    with _waiting_afterwards(network), _Answers(network) as answers:
        if identity is None:
            with _counted(network, progress):
                identity = _fast_scan(network)
            if identity is None:
                raise NodeNotFoundError(_TOO_LATE if answers.late(since=0) else _NO_ANSWER)
        else:
            _select(network, identity, timeout, answers)
        master.RESPONSE_TIMEOUT = timeout
        with _refusals("tell its node-ID", answers):
            present = master.inquire_node_id()
        if not force and present != node_id:
            _require_unused(network, node_id, timeout)
        network.subscribe(
            cia.HEARTBEAT_ID + node_id, lambda _id, data, _at: booted.append(bytes(data))
        )
        with _refusals(f"take node-ID {node_id}", answers):
            master.configure_node_id(node_id)
        if store:
            with _refusals("store it", answers):
                master.store_configuration()
    previous = present if 1 <= present <= cia.LAST_NODE_ID else None
    if previous is not None:
        # A device that has already started accepts another node-ID only by a reset.
        network.send_message(cia.NMT_ID, [NMTCommand.RESET_COMMUNICATION, previous])
    wait_until(lambda: cia.BOOT_UP in booted, timeout)
    network.unsubscribe(cia.HEARTBEAT_ID + node_id)
    return Assigned(identity, previous, cia.BOOT_UP in booted)


def _require_unused(network: canopen.Network, node_id: int, timeout: float) -> None:
    """Refuse a node-ID if a device with it sends a frame, or answers SDO or node guarding."""
    heard: list[int] = []

    def hear(can_id: int, _data: bytearray, _timestamp: float) -> None:
        heard.append(can_id)

    listened = (cia.HEARTBEAT_ID + node_id, cia.SDO_TX_ID + node_id)
    for can_id in listened:
        network.subscribe(can_id, hear)
    try:
        network.send_message(cia.SDO_RX_ID + node_id, ASKS_DEVICE_TYPE)
        # A stopped device does not answer SDO, and may send no heartbeat.
        network.send_message(cia.HEARTBEAT_ID + node_id, b"", remote=True)
        wait_until(lambda: bool(heard), timeout)
    finally:
        for can_id in listened:
            network.unsubscribe(can_id, hear)
    if heard:
        raise RefusedError(
            f"node-ID {node_id} is in use: a device answers with it; choose another one (a scan "
            "shows those in use), or force it"
        )


def wait_until(come: Callable[[], bool], seconds: float) -> None:
    """Wait until `come` returns True, for at most `seconds` s."""
    end = monotonic() + seconds
    while not come() and monotonic() < end:
        sleep(_POLL_S)


def _fast_scan(network: canopen.Network) -> Identity | None:
    network.lss.RESPONSE_TIMEOUT = _FASTSCAN_S
    found, numbers = network.lss.fast_scan()
    return Identity(*numbers) if found else None


class _Answers:
    """Counts the answers of devices to LSS, also those that come after the time to wait for them.

    Parameters
    ----------
    network
        Connected network of python-canopen, at which it listens during a block.
    """

    def __init__(self, network: canopen.Network) -> None:
        self._network = network
        self.count = 0

    def __enter__(self) -> Self:
        self._network.subscribe(cia.LSS_SLAVE_ID, self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        self._network.unsubscribe(cia.LSS_SLAVE_ID, self._hear)

    def _hear(self, _can_id: int, _data: bytearray, _timestamp: float) -> None:
        self.count += 1

    def late(self, since: int) -> bool:
        """Return whether there are more than so many answers, now or within a second."""
        wait_until(lambda: self.count > since, _LATE_S)
        return self.count > since


@contextmanager
def _counted(network: canopen.Network, progress: Callable[[float], None]) -> Iterator[None]:
    """Report the progress of a fastscan during the block, by the questions that it sends."""
    asked = 0

    def send(*frame: Any, **options: Any) -> None:
        nonlocal asked
        asked += 1
        progress(min(asked / _QUESTIONS, 1.0))
        network.send_message(*frame, **options)

    network.lss.network = SimpleNamespace(send_message=send)
    try:
        yield
    finally:
        network.lss.network = network


def _select(
    network: canopen.Network, identity: Identity, timeout: float, answers: _Answers
) -> None:
    network.lss.RESPONSE_TIMEOUT = timeout
    # Otherwise a device that is still selected would be configured as well.
    network.lss.send_switch_state_global(lss.LssMaster.WAITING_STATE)
    try:
        selected = network.lss.send_switch_state_selective(*identity)
    except LssError:
        selected = False
    if not selected and answers.late(since=0):
        raise NodeNotFoundError(
            f"the device with the identity {identity} answers later than the time-out of "
            f"{timeout:g} s: give it a longer one"
        )
    if not selected:
        raise NodeNotFoundError(
            f"no device with the identity {identity} answers; one that is OPERATIONAL takes no "
            "LSS: stop it, by NMT enter pre-operational"
        )


@contextmanager
def _waiting_afterwards(network: canopen.Network) -> Iterator[None]:
    try:
        yield
    finally:
        network.lss.send_switch_state_global(lss.LssMaster.WAITING_STATE)


@contextmanager
def _refusals(action: str, answers: _Answers) -> Iterator[None]:
    before = answers.count
    try:
        yield
    except LssError as error:
        if answers.count == before and answers.late(before):
            raise NodeNotFoundError(
                f"the device was asked to {action}, and answers later than the time-out: give it "
                "a longer one"
            ) from error
        raise RefusedError(f"the device does not {action}: {error}") from error
