"""The default PDOs of an EDS as a DBC, the format of bus analysers. Needs cantools."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Iterator
from decimal import Decimal
from typing import Final

from cantools.database.can import Database, Message, Node, Signal
from cantools.database.conversion import BaseConversion
from cantools.database.namedsignalvalue import NamedSignalValue

from smarttac_can.od import cia
from smarttac_can.od.data_types import REAL, SIGNED
from smarttac_can.od.dictionary import Entry, ObjectDictionary

_STATES: Final[dict[int, str | NamedSignalValue]] = {
    0: "boot-up",
    4: "stopped",
    5: "operational",
    127: "pre-operational",
}


def make_dbc(od: ObjectDictionary) -> str:
    """Write a DBC of the PDOs that are valid by default, of EMCY and of the heartbeat.

    A message is named after product, node-ID and PDO, a signal after its object. Scale and unit
    come from the brackets at the end of the parameter names.

    Parameters
    ----------
    od
        The EDS, loaded for the device's node-ID.

    Raises
    ------
    ValueError
        A default mapping is not to be read: it names objects that do not exist, or more than
        64 bits.
    """
    product = od.info.get("productname") or "device"
    node = identifier(f"{product}_{od.node_id}")
    messages = [
        *_pdos(od, node, "TPDO", cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING),
        *_pdos(od, node, "RPDO", cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING),
        *_emergency(od, node),
        *_heartbeat(od, node),
    ]
    database = Database(
        messages=messages, nodes=[Node(node, comment=f"{product}, node-ID {od.node_id}")]
    )
    # cantools writes the line ends of Windows, as the format's first tools did.
    return database.as_dbc_string().replace("\r\n", "\n")


def identifier(name: str) -> str:
    """Return a name with all that a DBC does not take in names replaced."""
    made = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return made if made[:1].isalpha() else f"_{made}"


def _pdos(
    od: ObjectDictionary, node: str, kind: str, first: int, mapping: int
) -> Iterator[Message]:
    for index in [i for i in od.objects if first <= i < first + cia.PDO_COUNT]:
        cob_id = od.number(index, cia.PDO_COB_ID, cia.COB_INVALID)
        mapped = index - first + mapping
        if cob_id & (cia.COB_INVALID | cia.COB_EXTENDED) or not od.number(mapped):
            continue
        number = index - first + 1
        receivers = [node] if kind == "RPDO" else []
        signals = list(_signals(od, mapped, f"{kind} {number}", receivers))
        bits = max(signal.start + signal.length for signal in signals) if signals else 0
        yield Message(
            cob_id & cia.CAN_ID_MASK,
            f"{node}_{kind}{number}",
            -(-bits // 8),
            signals,
            senders=[node] if kind == "TPDO" else [],
            cycle_time=od.number(index, cia.PDO_EVENT) or None,
        )


def _signals(
    od: ObjectDictionary, mapped: int, where: str, receivers: list[str]
) -> Iterator[Signal]:
    names: set[str] = set()
    start = 0
    for position in range(1, od.number(mapped) + 1):
        value = od.number(mapped, position)
        index, subindex, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
        entry = od.get(index, subindex)
        if not bits or start + bits > 8 * cia.FRAME_BYTES:
            raise ValueError(f"{where} maps no bit or more than 64")
        if entry is not None:
            name = identifier(entry.name)
            if name in names:
                name = f"{name}_{position}"
            names.add(name)
            yield _signal(entry, name, start, bits, receivers)
        elif index not in od.dummies:
            raise ValueError(f"{where} maps {index:04X}h sub-index {subindex}, which is not there")
        start += bits


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
    """Scale a limit without the rounding of binary fractions; a whole number stays one."""
    value = Decimal(raw) * size
    return int(value) if value == value.to_integral_value() else float(value)


def _emergency(od: ObjectDictionary, node: str) -> Iterator[Message]:
    cob_id = od.number(cia.EMCY_COB_ID, absent=cia.COB_INVALID)
    if not cob_id & cia.COB_INVALID:
        signals = [
            Signal("Error_code", 0, 16),
            Signal("Error_register", 16, 8),
            Signal("Manufacturer_specific", 24, 40),
        ]
        can_id = cob_id & cia.CAN_ID_MASK
        yield Message(can_id, f"{node}_EMCY", 8, signals, senders=[node])


def _heartbeat(od: ObjectDictionary, node: str) -> Iterator[Message]:
    if od.get(cia.HEARTBEAT_PRODUCER) is not None:
        states = BaseConversion.factory(choices=OrderedDict(_STATES))
        yield Message(
            cia.HEARTBEAT_ID + od.node_id,
            f"{node}_Heartbeat",
            1,
            [Signal("NMT_state", 0, 7, conversion=states)],
            senders=[node],
            cycle_time=od.number(cia.HEARTBEAT_PRODUCER) or None,
        )
