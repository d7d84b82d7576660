"""How a stimulator finds its plate node: COB-IDs, SYNC and heartbeat in its object dictionary."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from smarttac_can.nodes.loop_frames import DRIVE_TPDO, MEASUREMENT_RPDOS
from smarttac_can.nodes.loop_time import set_deadline
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


def links_to_plate(
    od: ObjectDictionary, plate: int, produce_sync: bool
) -> Iterator[tuple[Entry, int]]:
    """Yield what links a stimulator to a plate and has its default, with the value it should have.

    These are the COB-IDs of the PDOs of the loop, the period of SYNC and its producer bit, and the
    watch of the plate's heartbeat. A value that a master has written or stored stays, unless it is
    the default: a master that downloads the defaults of the EDS file means no other plate.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        Node-ID of the plate node, 1..127.
    produce_sync
        Whether the stimulator produces SYNC.
    """
    links = [
        (od.entry(RPDO_COMMUNICATION + rpdo - 1, PDO_COB_ID), base + plate)
        for rpdo, base in zip(MEASUREMENT_RPDOS, TPDO_IDS, strict=False)
    ]
    drive = od.entry(TPDO_COMMUNICATION + DRIVE_TPDO - 1, PDO_COB_ID)
    links += [(drive, RPDO_IDS[0] + plate), (od.entry(SYNC_PERIOD), TICK_US)]
    if produce_sync:
        sync = od.entry(SYNC_COB_ID)
        links.append((sync, sync.default | COB_SYNC_PRODUCER))
    members = od.objects[HEARTBEAT_CONSUMER].entries
    watches = [entry for subindex, entry in members.items() if subindex]
    if plate not in [entry.value >> 16 & 0xFF for entry in watches]:
        links.append((watches[-1], plate << 16 | _PLATE_HEARTBEAT_MS))
    for entry, value in links:
        if entry.value == entry.default:
            yield entry, value
