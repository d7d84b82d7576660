"""Data types that CiA 301 lays down for the objects of the communication profile area."""

from __future__ import annotations

from typing import Final

from smarttac_can.od import cia
from smarttac_can.od.cia import DataType

_VARIABLES: Final = {
    cia.DEVICE_TYPE: DataType.UNSIGNED32,
    cia.ERROR_REGISTER: DataType.UNSIGNED8,
    cia.SYNC_COB_ID: DataType.UNSIGNED32,
    cia.SYNC_PERIOD: DataType.UNSIGNED32,
    cia.SYNC_WINDOW: DataType.UNSIGNED32,
    cia.DEVICE_NAME: DataType.VISIBLE_STRING,
    cia.HARDWARE_VERSION: DataType.VISIBLE_STRING,
    cia.SOFTWARE_VERSION: DataType.VISIBLE_STRING,
    cia.GUARD_TIME: DataType.UNSIGNED16,
    cia.LIFE_TIME_FACTOR: DataType.UNSIGNED8,
    cia.EMCY_COB_ID: DataType.UNSIGNED32,
    cia.EMCY_INHIBIT: DataType.UNSIGNED16,
    cia.HEARTBEAT_PRODUCER: DataType.UNSIGNED16,
    cia.SYNC_COUNTER: DataType.UNSIGNED8,
    cia.NMT_STARTUP: DataType.UNSIGNED32,
}
_MEMBERS: Final = {
    cia.ERROR_FIELD: DataType.UNSIGNED32,
    cia.STORE_PARAMETERS: DataType.UNSIGNED32,
    cia.RESTORE_DEFAULTS: DataType.UNSIGNED32,
    cia.HEARTBEAT_CONSUMER: DataType.UNSIGNED32,
    cia.IDENTITY: DataType.UNSIGNED32,
    cia.VERIFY_CONFIGURATION: DataType.UNSIGNED32,
    cia.ERROR_BEHAVIOUR: DataType.UNSIGNED8,
}
_PDO: Final = {
    cia.PDO_COB_ID: DataType.UNSIGNED32,
    cia.PDO_TRANSMISSION: DataType.UNSIGNED8,
    cia.PDO_INHIBIT: DataType.UNSIGNED16,
    cia.PDO_EVENT: DataType.UNSIGNED16,
    cia.PDO_SYNC_START: DataType.UNSIGNED8,
}
_SDO: Final = {1: DataType.UNSIGNED32, 2: DataType.UNSIGNED32, 3: DataType.UNSIGNED8}
_MAPPING: Final = dict.fromkeys(range(1, 65), DataType.UNSIGNED32)
_LAST_PDO: Final = cia.PDO_COUNT - 1
_RECORDS: Final = (
    (cia.SDO_SERVER_FIRST, cia.SDO_SERVER_LAST, _SDO),
    (cia.RPDO_COMMUNICATION, cia.RPDO_COMMUNICATION + _LAST_PDO, _PDO),
    (cia.TPDO_COMMUNICATION, cia.TPDO_COMMUNICATION + _LAST_PDO, _PDO),
    (cia.RPDO_MAPPING, cia.RPDO_MAPPING + _LAST_PDO, _MAPPING),
    (cia.TPDO_MAPPING, cia.TPDO_MAPPING + _LAST_PDO, _MAPPING),
)


def standard_type(index: int, subindex: int) -> DataType | None:
    """Return the data type an entry must have; None where CiA 301 leaves it open."""
    if index in _VARIABLES or subindex == 0:
        return _VARIABLES.get(index)
    if index in _MEMBERS:
        return _MEMBERS[index]
    for first, last, types in _RECORDS:
        if first <= index <= last:
            return types.get(subindex)
    return None
