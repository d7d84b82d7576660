"""How a stimulator finds its plate node: COB-IDs, SYNC and heartbeat in its object dictionary."""

from __future__ import annotations

from typing import Final

from smarttac_can.nodes.loop_frames import DRIVE_TPDO, MEASUREMENT_RPDOS
from smarttac_can.nodes.loop_period import set_deadline
from smarttac_can.od.cia import (
    COB_SYNC_PRODUCER,
    HEARTBEAT_CONSUMER,
    PDO_COB_ID,
    RPDO_COMMUNICATION,
    RPDO_IDS,
    SYNC_COB_ID,
    SYNC_PERIOD,
    TPDO_COMMUNICATION,
    TPDO_IDS,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.signals import TICK_US

_FIRST_SERIAL: Final = 1
"""That of the packaged EDS files."""
_FIRST_NODE_ID: Final = 33
_PLATE_HEARTBEAT_MS: Final = 2000
"""Four heartbeats of a plate that has not been configured."""


def plate_serial(entry: Entry, node_id: int) -> int:
    """Return the serial number of a plate, or that which its calibration is for.

    Parameters
    ----------
    entry
        Holds it; a default that is not that of the packaged EDS is the answer.
    node_id
        Of the plate, 1..127: no two simulated ones on a bus have one number; that of 33 has 1.
    """
    default = int(entry.default)
    simulated = (node_id - _FIRST_NODE_ID) % 127 + _FIRST_SERIAL
    return simulated if default == _FIRST_SERIAL else default


def expect_plate(od: ObjectDictionary, plate: int, deadline_ms: int | None) -> None:
    """Have the defaults of a stimulator be those for a plate node.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``, of a node that was not started yet.
    plate
        Node-ID of the plate node, 1..127.
    deadline_ms
        Default of the event timers of the measurements; None for that of the EDS.
    """
    if deadline_ms is not None:
        set_deadline(od, MEASUREMENT_RPDOS, deadline_ms)
    serial = od["Calibration.Plate serial number"]
    serial.default = serial.value = plate_serial(serial, plate)


def link_to_plate(od: ObjectDictionary, plate: int, produce_sync: bool) -> None:
    """Give the PDOs of the loop the plate's COB-IDs, SYNC the loop's period, and watch the plate.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        Node-ID of the plate node, 1..127.
    produce_sync
        Whether the stimulator produces SYNC.
    """
    for rpdo, base in zip(MEASUREMENT_RPDOS, TPDO_IDS, strict=False):
        od.entry(RPDO_COMMUNICATION + rpdo - 1, PDO_COB_ID).value = base + plate
    od.entry(TPDO_COMMUNICATION + DRIVE_TPDO - 1, PDO_COB_ID).value = RPDO_IDS[0] + plate
    od.entry(SYNC_PERIOD).value = TICK_US
    _watch_heartbeat(od, plate)
    if produce_sync:
        od.entry(SYNC_COB_ID).value |= COB_SYNC_PRODUCER


def _watch_heartbeat(od: ObjectDictionary, plate: int) -> None:
    """Watch the plate by the last entry, unless that or the plate is taken."""
    members = od.objects[HEARTBEAT_CONSUMER].entries
    watched = [entry for subindex, entry in members.items() if subindex]
    if watched[-1].value == 0 and plate not in [e.value >> 16 & 0xFF for e in watched]:
        watched[-1].value = plate << 16 | _PLATE_HEARTBEAT_MS
