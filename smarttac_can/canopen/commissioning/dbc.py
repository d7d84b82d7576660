"""DBC, the format of bus analysers, from the default PDOs of an EDS. Needs cantools."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Final, NamedTuple

from cantools.database.can import Database, Message, Node, Signal
from cantools.database.conversion import BaseConversion
from cantools.database.namedsignalvalue import NamedSignalValue

from smarttac_can.canopen.device.nmt import STATES
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.data_types import REAL, SIGNED
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import BitField, Entry
from smarttac_can.canopen.od.units import EXACT


class Names(NamedTuple):
    """Names for the numbers of a device."""

    fields: Mapping[str, Sequence[BitField]] = {}
    """Fields by the name of the object; bits in no field of it are omitted from the DBC."""
    emergencies: Mapping[int, str] = {}
    """Names by emergency error code."""


NO_NAMES: Final = Names()


def make_dbc(od: ObjectDictionary, names: Names = NO_NAMES) -> str:
    """Return a DBC of the PDOs that are valid by default, of EMCY and of the heartbeat.

    A message is named after product, node-ID and PDO, a signal after its object. Scale and unit
    come from the brackets at the end of the parameter names.

    Parameters
    ----------
    od
        Object dictionary from the EDS, loaded for the device's node-ID.
    names
        Names of values, and of bits that become separate signals.

    Raises
    ------
    ValueError
        If a default mapping is invalid: it names objects that do not exist, or more than 64 bits.
    """
    product = od.info.get("productname") or "device"
    node = identifier(f"{product}_{od.node_id}")
    messages = [
        *_pdos(od, node, "TPDO", (cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING), names),
        *_pdos(od, node, "RPDO", (cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING), names),
        *_emergency(od, node, names),
        *_heartbeat(od, node),
    ]
    database = Database(
        messages=messages, nodes=[Node(node, comment=f"{product}, node-ID {od.node_id}")]
    )
    # cantools writes the line ends of Windows, as the first tools for the format did.
    return database.as_dbc_string().replace("\r\n", "\n")


def identifier(name: str) -> str:
    """Return a name with all characters replaced that a DBC does not allow."""
    made = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return made if made[:1].isalpha() else f"_{made}"


def _pdos(
    od: ObjectDictionary, node: str, kind: str, records: tuple[int, int], names: Names
) -> Iterator[Message]:
    first, mapping = records
    for index in [i for i in od.objects if first <= i < first + cia.PDO_COUNT]:
        cob_id = od.number(index, cia.PDO_COB_ID, cia.COB_INVALID)
        mapped = index - first + mapping
        if cob_id & (cia.COB_INVALID | cia.COB_EXTENDED) or not od.number(mapped):
            continue
        number = index - first + 1
        if od.number(mapped) in cia.MULTIPLEXED:
            yield _multiplexed(od, index, f"{node}_{kind}{number}", node, kind)
            continue
        receivers = [node] if kind == "RPDO" else []
        places = list(_places(od, mapped, f"{kind} {number}"))
        signals = list(_signals(places, receivers, names))
        bits = sum(length for _, _, length in places)
        yield Message(
            cob_id & cia.CAN_ID_MASK,
            f"{node}_{kind}{number}",
            -(-bits // 8),
            signals,
            senders=[node] if kind == "TPDO" else [],
            cycle_time=od.number(index, cia.PDO_EVENT) or None,
        )


def _multiplexed(od: ObjectDictionary, index: int, name: str, node: str, kind: str) -> Message:
    """Return the message of an MPDO, of which each frame names the object that it carries."""
    receivers = [node] if kind == "RPDO" else []
    places = {"Node": (0, 7), "To_destination": (7, 1), "Index": (8, 16), "Subindex": (24, 8)}
    signals = [Signal(name, *place, receivers=receivers) for name, place in places.items()]
    return Message(
        od.number(index, cia.PDO_COB_ID) & cia.CAN_ID_MASK,
        name,
        cia.FRAME_BYTES,
        [*signals, Signal("Data", 32, 32, receivers=receivers)],
        comment="Multiplexed PDO: each frame names the object that it carries",
        senders=[node] if kind == "TPDO" else [],
        cycle_time=od.number(index, cia.PDO_EVENT) or None,
    )


def _places(
    od: ObjectDictionary, mapped: int, where: str
) -> Iterator[tuple[Entry | None, int, int]]:
    """Yield entry, first bit and length of each mapped object; the entry is None for a dummy."""
    start = 0
    for position in range(1, od.number(mapped) + 1):
        value = od.number(mapped, position)
        index, subindex, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
        entry = od.get(index, subindex)
        if not bits or start + bits > 8 * cia.FRAME_BYTES:
            raise ValueError(f"{where} maps no bit or more than 64")
        if entry is None and index not in od.dummies:
            raise ValueError(f"{where} maps {index:04X}h sub-index {subindex}, which is not there")
        yield entry, start, bits
        start += bits


def _signals(
    places: list[tuple[Entry | None, int, int]], receivers: list[str], names: Names
) -> Iterator[Signal]:
    taken: set[str] = set()
    for position, (entry, start, bits) in enumerate(places, 1):
        if entry is None:
            continue
        name = identifier(entry.name)
        if name in taken:
            name = f"{name}_{position}"
        taken.add(name)
        fields = names.fields.get(entry.name)
        if fields is None:
            yield _signal(entry, name, start, bits, receivers)
            continue
        for field in fields:
            yield Signal(
                identifier(f"{name} {field.name}"),
                start + field.start,
                field.length,
                conversion=_choices(field.values),
                comment=f"{entry.name} {field.name}".rstrip(),
                receivers=receivers,
            )


def _choices(values: Mapping[int, str]) -> BaseConversion:
    choices: OrderedDict[int, str | NamedSignalValue] = OrderedDict(sorted(values.items()))
    return BaseConversion.factory(choices=choices or None)


def _signal(entry: Entry, name: str, start: int, bits: int, receivers: list[str]) -> Signal:
    real = entry.data_type in REAL
    ordered = entry.low < entry.high and not real
    return Signal(
        name,
        start,
        bits,
        is_signed=entry.data_type in SIGNED,
        conversion=BaseConversion.factory(scale=float(entry.unit.number), is_float=real),
        minimum=_scaled(entry.low, entry.unit.number) if ordered else None,
        maximum=_scaled(entry.high, entry.unit.number) if ordered else None,
        unit=entry.unit.symbol or None,
        comment=entry.name,
        receivers=receivers,
    )


def _scaled(raw: float, size: Decimal) -> float:
    """Scale a limit without the rounding of binary fractions; keep a whole number as int."""
    value = EXACT.multiply(int(raw), size)
    return int(value) if value == value.to_integral_value() else float(value)


def _emergency(od: ObjectDictionary, node: str, names: Names) -> Iterator[Message]:
    cob_id = od.number(cia.EMCY_COB_ID, absent=cia.COB_INVALID)
    if not cob_id & cia.COB_INVALID:
        signals = [
            Signal("Error_code", 0, 16, conversion=_choices(names.emergencies)),
            Signal("Error_register", 16, 8),
            Signal("Manufacturer_specific", 24, 40),
        ]
        can_id = cob_id & cia.CAN_ID_MASK
        yield Message(can_id, f"{node}_EMCY", 8, signals, senders=[node])


def _heartbeat(od: ObjectDictionary, node: str) -> Iterator[Message]:
    if od.get(cia.HEARTBEAT_PRODUCER) is not None:
        yield Message(
            cia.HEARTBEAT_ID + od.node_id,
            f"{node}_Heartbeat",
            1,
            [Signal("NMT_state", 0, 7, conversion=_choices(STATES))],
            senders=[node],
            cycle_time=od.number(cia.HEARTBEAT_PRODUCER) or None,
        )
