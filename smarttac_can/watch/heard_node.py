"""A node as a listener hears it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from smarttac_can.commissioning.scan import STATES, UNKNOWN
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    EMCY_COB_ID,
    HEARTBEAT_ID,
    PDO_COB_ID,
    PDO_COUNT,
    SDO_TX_ID,
    TPDO_COMMUNICATION,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.watch.view import Peer

SILENT_S: Final = 3.0
"""Three heartbeats by default."""
_SPEAKS: Final = ("", STATES[NMTState.OPERATIONAL])


class HeardNode:
    """What a listener hears of one node.

    Parameters
    ----------
    od
        Its EDS, loaded for its node-ID.
    name
        What to call it.

    Attributes
    ----------
    emergency_id
        CAN-ID of its emergency messages.
    rested
        Time in s at which it last said that it is not OPERATIONAL; None if it has not.
    """

    def __init__(self, od: ObjectDictionary, name: str) -> None:
        self.node_id, self.name = od.node_id, name
        self.emergency_id = od.number(EMCY_COB_ID) & CAN_ID_MASK
        cob_ids = [
            od.number(TPDO_COMMUNICATION + offset, PDO_COB_ID, COB_INVALID)
            for offset in range(PDO_COUNT)
        ]
        self._pdo_ids = {cob & CAN_ID_MASK for cob in cob_ids if not cob & COB_INVALID}
        self._nmt: int | None = None
        self._heard: float | None = None
        self.rested: float | None = None

    def take(self, now: float, frame: Frame) -> bool:
        """Take any frame of the bus; return whether it was the boot-up of this node."""
        can_id = frame.can_id
        if can_id == HEARTBEAT_ID + self.node_id and frame.data and not frame.rtr:
            self._heard, self._nmt = now, frame.data[0] & 0x7F
            if self._nmt != NMTState.OPERATIONAL:
                self.rested = now
            return self._nmt == NMTState.INITIALISING
        if can_id in self._pdo_ids:
            # PDOs are OPERATIONAL's alone; the next heartbeat may be a second away.
            self._heard, self._nmt = now, NMTState.OPERATIONAL
        elif can_id in (self.emergency_id, SDO_TX_ID + self.node_id):
            self._heard = now
        return False

    def at(self, now: float) -> Peer:
        """Return what is to be shown of it."""
        nmt = "" if self._nmt is None else STATES.get(self._nmt, UNKNOWN)
        silent = None if self._heard is None else now - self._heard
        return Peer(self.node_id, self.name, nmt, silent)


def gone(peer: Peer) -> bool:
    """Tell whether a node is not there, or no longer."""
    return peer.silent is None or peer.silent > SILENT_S


def notes_of(peer: Peer, listened: float) -> Iterator[str]:
    """Say why a node is not heard after so many s of listening."""
    who = f"node {peer.node_id} ({peer.name})"
    if peer.silent is None:
        if listened > SILENT_S:
            yield (
                f"nothing has been heard of {who} for {listened:.0f} s: "
                "is it running on this bus, with that node-ID?"
            )
    elif peer.silent > SILENT_S:
        yield f"{who} has been silent for {peer.silent:.0f} s: it has stopped or left the bus"
    elif peer.nmt not in _SPEAKS:
        yield f"{who} is {peer.nmt}: it publishes nothing until a master starts it"
