"""The instrument simulated: the one place where a client makes nodes, plate and controllers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from smarttac_can.host.files import read_eds
from smarttac_can.host.local_bus import LocalBus
from smarttac_can.nodes.parameters import NULL
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.eds import load_eds
from smarttac_can.vocabulary.objects import SIMULATION
from smarttac_can.vocabulary.signals import KNOWN_WINDOW_MN, SHORT_DEADLINE_MS

STIMULATOR_ID: Final = 32
"""Node-ID of the stimulator unless another is given."""
PLATE_ID: Final = 33
"""Node-ID of the plate node unless another is given."""


def stimulator_od(node_id: int = STIMULATOR_ID) -> ObjectDictionary:
    """Load the EDS of the stimulator for a node-ID, 1..127."""
    return load_eds(read_eds("stimulator.eds"), node_id)


def plate_od(node_id: int = PLATE_ID) -> ObjectDictionary:
    """Load the EDS of the plate for a node-ID, 1..127."""
    return load_eds(read_eds("plate.eds"), node_id)


def know_nulls(od: ObjectDictionary, nulls: Iterable[float]) -> None:
    """Have a plate's nulls, S1..S6 in N, be the defaults; what is stored or preset replaces them.

    The window is then as narrow as after a calibration, and a tare under a finger is refused.
    """
    values = {f"{NULL}.Null of S{n}": f"{null} N" for n, null in enumerate(nulls, 1)}
    for name, text in (values | {f"{NULL}.Window": f"{KNOWN_WINDOW_MN} mN"}).items():
        entry = od[name]
        entry.default = entry.value = entry.counts(text)


def od_and_plate() -> tuple[ObjectDictionary, PlateBlock]:
    """Return the object dictionary of a stimulator that knows the nulls of a plate, and the plate.

    A tare under a finger is refused then, as after a calibration.
    """
    od, plate = stimulator_od(), PlateBlock(plate_od())
    know_nulls(od, plate.plate.nulls)
    return od, plate


def simulated_block(presets: Mapping[str, int]) -> StimulatorBlock:
    """Return a stimulator with the plate inside and no CANopen, at the start of a run.

    Parameters
    ----------
    presets
        Raw values by name that replace defaults of the EDS.
    """
    block = StimulatorBlock(*od_and_plate())
    for name, raw in presets.items():
        block.write(name, raw)
    block.start_run()
    return block


def stimulator_with_plate(presets: Mapping[str, int] | None = None) -> StimulatorNode:
    """Return a stimulator node for lockstep with the plate inside."""
    return StimulatorNode(*od_and_plate(), lockstep=True, presets=presets)


def lockstep_nodes(
    *, plate_inside: bool, presets: Mapping[str, int]
) -> list[PlateNode | StimulatorNode]:
    """Return a stimulator for lockstep, and before it a plate node if the plate is not inside.

    What is simulated is simulated by the plate: a plate node has the presets of that.
    """
    if plate_inside:
        return [stimulator_with_plate(presets)]
    simulated = {n: raw for n, raw in presets.items() if n.partition(".")[0] in SIMULATION}
    plate = PlateNode(plate_od(), simulated, deadline_ms=SHORT_DEADLINE_MS)
    od = stimulator_od()
    know_nulls(od, plate.block.plate.nulls)
    stimulator = StimulatorNode(
        od,
        plate_node_id=PLATE_ID,
        lockstep=True,
        deadline_ms=SHORT_DEADLINE_MS,
        presets={name: raw for name, raw in presets.items() if name not in simulated},
    )
    return [plate, stimulator]


def attach_nodes(bus: LocalBus, *, plate_inside: bool, presets: Mapping[str, int]) -> None:
    """Attach what `lockstep_nodes` returns."""
    for node in lockstep_nodes(plate_inside=plate_inside, presets=presets):
        bus.attach(node)
