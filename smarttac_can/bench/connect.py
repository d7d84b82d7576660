"""Ways to a stimulator: over any CAN bus, or simulated inside this process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import can
import canopen

from smarttac_can.bench.can_link import CanLink
from smarttac_can.bench.errors import BenchError
from smarttac_can.bench.local_link import LocalLink
from smarttac_can.bench.local_network import LocalNetwork
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.host.bus import LogHook
from smarttac_can.host.eds_files import read_eds
from smarttac_can.host.local_bus import LocalBus
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.eds import load_eds

STIMULATOR_ID = 32
"""Node-ID of the stimulator unless another is given."""
PLATE_ID = 33
"""Node-ID of the plate node unless another is given."""


def stimulator_od(node_id: int = STIMULATOR_ID) -> ObjectDictionary:
    """Load the EDS of the stimulator for a node-ID, 1..127."""
    return load_eds(read_eds("stimulator.eds"), node_id)


def plate_od(node_id: int = PLATE_ID) -> ObjectDictionary:
    """Load the EDS of the plate for a node-ID, 1..127."""
    return load_eds(read_eds("plate.eds"), node_id)


def connect(
    *,
    interface: str | None = None,
    channel: str | None = None,
    node_id: int = STIMULATOR_ID,
    plate_node_id: int | None = None,
    lockstep: bool = False,
    timeout: float = 1.0,
    **options: Any,
) -> Stimulator:
    """Connect to a stimulator on a CAN bus and start it, and its plate node if it has one.

    Parameters
    ----------
    interface, channel, options
        As python-can has them; what is not given comes from python-can's configuration.
    node_id
        Node-ID of the stimulator, 1..127.
    plate_node_id
        Node-ID of the plate node, 1..127; None with the plate inside the stimulator.
    lockstep
        Whether the nodes were started with ``--lockstep``: the bench then produces the SYNC.
    timeout
        Longest wait for an SDO answer in s.

    Raises
    ------
    BenchError
        If the bus cannot be opened, no node answers, or it is another device.
    """
    where = f"{interface or 'the configured bus'}:{channel or 'default'}"
    network = canopen.Network()
    try:
        network.connect(interface=interface, channel=channel, **options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        raise BenchError(f"cannot open {where}: {error}") from error
    return _over_can(
        network, node_id, plate_node_id, where=where, lockstep=lockstep, timeout=timeout
    )


def simulate(
    link: Literal["local", "bus"] = "bus",
    *,
    plate_inside: bool = False,
    presets: Mapping[str, int] | None = None,
    log: LogHook | None = None,
) -> Stimulator:
    """Simulate a stimulator and its plate inside this process, without threads or waiting.

    Parameters
    ----------
    link
        ``bus`` for two CANopen nodes and this bench on a virtual CAN bus, in lockstep; ``local``
        for their function blocks without CANopen.
    plate_inside
        Whether the plate is inside the stimulator node; without a bus it always is.
    presets
        Raw values by name that replace defaults of the stimulator's EDS.
    log
        Called with the time stamp in us and the frame, for every frame.
    """
    if link == "local":
        block = StimulatorBlock(stimulator_od(), PlateBlock(plate_od()))
        for name, raw in (presets or {}).items():
            block.write(name, raw)
        return Stimulator(LocalLink(block), block.od)
    bus = LocalBus(log=log)
    if plate_inside:
        bus.attach(StimulatorNode(stimulator_od(), PlateBlock(plate_od()), presets=presets))
    else:
        bus.attach(PlateNode(plate_od()))
        bus.attach(StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, presets=presets))
    return _over_can(
        LocalNetwork(bus),
        STIMULATOR_ID,
        None if plate_inside else PLATE_ID,
        where="the local bus",
        lockstep=True,
        timeout=0.0,
    )


def _over_can(
    network: canopen.Network,
    node_id: int,
    plate_node_id: int | None,
    *,
    where: str,
    lockstep: bool,
    timeout: float,
) -> Stimulator:
    try:
        od = stimulator_od(node_id)
        plate = None if plate_node_id is None else plate_od(plate_node_id)
        link = CanLink(network, od, plate, where=where, lockstep=lockstep, timeout=timeout)
    except BaseException:
        network.disconnect()
        raise
    return Stimulator(link, od)
