"""Named constants of CiA 301, 302 and 306; the only place with hexadecimal indices."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class DataType(IntEnum):
    """Static data types of CiA 301, table 44."""

    BOOLEAN = 0x01
    INTEGER8 = 0x02
    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    REAL32 = 0x08
    VISIBLE_STRING = 0x09
    OCTET_STRING = 0x0A
    UNICODE_STRING = 0x0B
    TIME_OF_DAY = 0x0C
    TIME_DIFFERENCE = 0x0D
    DOMAIN = 0x0F
    INTEGER24 = 0x10
    REAL64 = 0x11
    INTEGER40 = 0x12
    INTEGER48 = 0x13
    INTEGER56 = 0x14
    INTEGER64 = 0x15
    UNSIGNED24 = 0x16
    UNSIGNED40 = 0x18
    UNSIGNED48 = 0x19
    UNSIGNED56 = 0x1A
    UNSIGNED64 = 0x1B


class ObjectType(IntEnum):
    """Object codes of CiA 301, table 42."""

    NULL = 0
    DOMAIN = 2
    DEFTYPE = 5
    DEFSTRUCT = 6
    VAR = 7
    ARRAY = 8
    RECORD = 9


class AbortCode(IntEnum):
    """SDO abort codes of CiA 301, table 22."""

    TOGGLE = 0x05030000
    TIME_OUT = 0x05040000
    COMMAND = 0x05040001
    BLOCK_SIZE = 0x05040002
    SEQUENCE = 0x05040003
    CRC = 0x05040004
    MEMORY = 0x05040005
    ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    PARAMETER = 0x06040043
    HARDWARE = 0x06060000
    LENGTH = 0x06070010
    TOO_LONG = 0x06070012
    TOO_SHORT = 0x06070013
    NO_SUBINDEX = 0x06090011
    VALUE = 0x06090030
    TOO_HIGH = 0x06090031
    TOO_LOW = 0x06090032
    GENERAL = 0x08000000
    STORE = 0x08000020
    LOCAL_CONTROL = 0x08000021
    STATE = 0x08000022
    NO_DATA = 0x08000024


ABORT_TEXT: Final = {
    AbortCode.TOGGLE: "toggle bit not alternated",
    AbortCode.TIME_OUT: "SDO protocol timed out",
    AbortCode.COMMAND: "command specifier not valid or unknown",
    AbortCode.BLOCK_SIZE: "invalid block size",
    AbortCode.SEQUENCE: "invalid sequence number",
    AbortCode.CRC: "CRC error",
    AbortCode.MEMORY: "out of memory",
    AbortCode.ACCESS: "unsupported access to an object",
    AbortCode.WRITE_ONLY: "attempt to read a write only object",
    AbortCode.READ_ONLY: "attempt to write a read only object",
    AbortCode.NO_OBJECT: "object does not exist in the object dictionary",
    AbortCode.NOT_MAPPABLE: "object cannot be mapped to the PDO",
    AbortCode.PDO_LENGTH: "mapped objects would exceed the PDO length",
    AbortCode.PARAMETER: "general parameter incompatibility",
    AbortCode.HARDWARE: "access failed due to a hardware error",
    AbortCode.LENGTH: "data type or length does not match",
    AbortCode.TOO_LONG: "length of service parameter too high",
    AbortCode.TOO_SHORT: "length of service parameter too low",
    AbortCode.NO_SUBINDEX: "sub-index does not exist",
    AbortCode.VALUE: "invalid value for parameter",
    AbortCode.TOO_HIGH: "value written too high",
    AbortCode.TOO_LOW: "value written too low",
    AbortCode.GENERAL: "general error",
    AbortCode.STORE: "data cannot be transferred or stored to the application",
    AbortCode.LOCAL_CONTROL: "data cannot be transferred because of local control",
    AbortCode.STATE: "data cannot be transferred because of the present device state",
    AbortCode.NO_DATA: "no data available",
}


class Abort(Exception):  # noqa: N818 - the term of CiA 301
    """Refusal of an access to the object dictionary.

    Parameters
    ----------
    code
        SDO abort code, which the client receives unchanged.
    reason
        Details beyond the code: what was refused and what to do, in one line; empty without
        details. It is not part of the exception text, which contains only what a client knows from
        the code.
    """

    def __init__(self, code: int, reason: str = "") -> None:
        self.code = code
        self.reason = reason
        text = ABORT_TEXT[AbortCode(code)] if code in ABORT_TEXT else "manufacturer specific"
        super().__init__(f"abort {code:08X}: {text}")

    def explain(self, name: str) -> str:
        """Return the reason why a write to an object was refused, in one line."""
        return self.reason or f"{name}: {self.args[0]}"


class EmergencyCode(IntEnum):
    """Emergency error codes of the communication, by the classes of CiA 301, table 26.

    DATA_STORAGE is from the drive profile, CiA 402. An application has codes of its own.
    """

    RESET = 0x0000
    DATA_STORAGE = 0x5530
    DATA_SET = 0x6300
    ERROR_CONTROL = 0x8130
    BUS_OFF_RECOVERED = 0x8140
    PROTOCOL = 0x8200
    PDO_LENGTH = 0x8210
    PDO_LENGTH_EXCEEDED = 0x8220
    SYNC_LENGTH = 0x8240
    RPDO_TIME_OUT = 0x8250


EMERGENCY_TEXT: Final = {
    0x0000: "error reset or no error",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current, device input side",
    0x2200: "current inside the device",
    0x2300: "current, device output side",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3200: "voltage inside the device",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4200: "device temperature",
    0x5000: "device hardware",
    0x6000: "device software",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data set",
    0x7000: "additional modules",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error",
    0x8140: "recovered from bus-off",
    0x8150: "CAN-ID collision",
    0x8200: "protocol error",
    0x8210: "PDO not processed due to length error",
    0x8220: "PDO length exceeded",
    0x8230: "MPDO not processed, destination object not available",
    0x8240: "unexpected SYNC data length",
    0x8250: "RPDO time-out",
    0x8260: "unexpected TIME data length",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "device specific",
}
"""Texts of the emergency error codes of CiA 301, tables 26 and 27, and of their classes."""


def emergency_text(code: int) -> str:
    """Return the text of an emergency error code, or that of the nearest class that has it."""
    classes = (code, code & 0xFF00, code & 0xF000)
    return next((EMERGENCY_TEXT[c] for c in classes if c in EMERGENCY_TEXT), "not known")


class NMTCommand(IntEnum):
    """Command specifiers of NMT node control, CiA 301, 7.2.8.3.1."""

    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class ErrorRegister(IntEnum):
    """Bits of the error register."""

    GENERIC = 0x01
    CURRENT = 0x02
    VOLTAGE = 0x04
    TEMPERATURE = 0x08
    COMMUNICATION = 0x10
    PROFILE = 0x20
    MANUFACTURER = 0x80


# Communication profile area.
COMMUNICATION_FIRST: Final = 0x1000
COMMUNICATION_LAST: Final = 0x1FFF
DEVICE_TYPE: Final = 0x1000
MANUFACTURER_FIRST: Final = 0x2000
PROFILE_FIRST: Final = 0x6000
PROFILE_LAST: Final = 0x9FFF
LAST_INDEX: Final = 0xFFFF
ERROR_REGISTER: Final = 0x1001
ERROR_FIELD: Final = 0x1003
SYNC_COB_ID: Final = 0x1005
SYNC_PERIOD: Final = 0x1006
SYNC_WINDOW: Final = 0x1007
DEVICE_NAME: Final = 0x1008
HARDWARE_VERSION: Final = 0x1009
SOFTWARE_VERSION: Final = 0x100A
GUARD_TIME: Final = 0x100C
LIFE_TIME_FACTOR: Final = 0x100D
STORE_PARAMETERS: Final = 0x1010
RESTORE_DEFAULTS: Final = 0x1011
TIME_COB_ID: Final = 0x1012
EMCY_COB_ID: Final = 0x1014
EMCY_INHIBIT: Final = 0x1015
HEARTBEAT_CONSUMER: Final = 0x1016
HEARTBEAT_PRODUCER: Final = 0x1017
IDENTITY: Final = 0x1018
SYNC_COUNTER: Final = 0x1019
VERIFY_CONFIGURATION: Final = 0x1020
STORE_EDS: Final = 0x1021
STORE_FORMAT: Final = 0x1022
ERROR_BEHAVIOUR: Final = 0x1029
SDO_SERVER_FIRST: Final = 0x1200
SDO_SERVER_LAST: Final = 0x127F
SDO_CLIENT_LAST: Final = 0x12FF
RPDO_COMMUNICATION: Final = 0x1400
RPDO_MAPPING: Final = 0x1600
TPDO_COMMUNICATION: Final = 0x1800
TPDO_MAPPING: Final = 0x1A00
PDO_COUNT: Final = 0x200
MOST_MAPPED: Final = 64
MULTIPLEXED: Final = (0xFE, 0xFF)
"""Numbers of mapped objects that make a PDO a multiplexed one: with a destination, or a source."""
NMT_STARTUP: Final = 0x1F80

# Sub-indices of the PDO communication parameter record.
PDO_COB_ID: Final = 1
PDO_TRANSMISSION: Final = 2
PDO_INHIBIT: Final = 3
PDO_RESERVED: Final = 4
PDO_EVENT: Final = 5
PDO_SYNC_START: Final = 6

# Transmission types.
ACYCLIC: Final = 0
CYCLIC_LAST: Final = 240
RTR_SYNC: Final = 252
RTR_EVENT: Final = 253
EVENT_MANUFACTURER: Final = 254
EVENT_PROFILE: Final = 255

# COB-ID entries: identifier and flags.
CAN_ID_MASK: Final = 0x7FF
COB_INVALID: Final = 1 << 31
COB_NO_RTR: Final = 1 << 30
COB_SYNC_PRODUCER: Final = 1 << 30
COB_TIME_CONSUMER: Final = 1 << 31
COB_TIME_PRODUCER: Final = 1 << 30
COB_EXTENDED: Final = 1 << 29

# Identifiers of the pre-defined connection set; the node-ID is added to those of a node.
NMT_ID: Final = 0x000
TPDO_IDS: Final = (0x180, 0x280, 0x380, 0x480)
RPDO_IDS: Final = (0x200, 0x300, 0x400, 0x500)
SYNC_ID: Final = 0x080
EMCY_ID: Final = 0x080
TIME_ID: Final = 0x100
SDO_TX_ID: Final = 0x580
SDO_RX_ID: Final = 0x600
HEARTBEAT_ID: Final = 0x700
LSS_SLAVE_ID: Final = 0x7E4
LSS_MASTER_ID: Final = 0x7E5
BOOT_UP: Final = b"\0"
"""Data of the boot-up message. A heartbeat has a state other than 0."""

LAST_NODE_ID: Final = 127
UNCONFIGURED: Final = 255
"""Node-ID of a device that waits for one from LSS."""

# Sizes of a frame and its parts.
FRAME_BYTES: Final = 8
EXPEDITED_BYTES: Final = 4
EMCY_VENDOR_BYTES: Final = 5

SYNC_COUNTER_LAST: Final = 240
LAST_SUBINDEX: Final = 0xFE
STRUCTURE_SUBINDEX: Final = 0xFF
RECORD_TYPES: Final = (
    (IDENTITY, IDENTITY, 0x23),
    (SDO_SERVER_FIRST, SDO_SERVER_LAST, 0x22),
    (RPDO_COMMUNICATION, RPDO_COMMUNICATION + PDO_COUNT - 1, 0x20),
    (RPDO_MAPPING, RPDO_MAPPING + PDO_COUNT - 1, 0x21),
    (TPDO_COMMUNICATION, TPDO_COMMUNICATION + PDO_COUNT - 1, 0x20),
    (TPDO_MAPPING, TPDO_MAPPING + PDO_COUNT - 1, 0x21),
)
"""First and last index of records of CiA 301, and their complex data type."""
_RESTRICTED_IDS: Final = (
    (NMT_ID, 0x07F),
    (0x101, 0x180),
    (SDO_TX_ID + 1, 0x5FF),
    (SDO_RX_ID + 1, 0x67F),
    (0x6E0, CAN_ID_MASK),
)
"""First and last of the CAN-IDs of NMT, SDO and error control, and of reserved ones (table 39)."""


def restricted(can_id: int) -> bool:
    """Return whether a configurable object must not have an 11-bit CAN-ID (CiA 301, table 39)."""
    return any(first <= can_id <= last for first, last in _RESTRICTED_IDS)


_VARIABLES: Final = {
    DEVICE_TYPE: DataType.UNSIGNED32,
    ERROR_REGISTER: DataType.UNSIGNED8,
    SYNC_COB_ID: DataType.UNSIGNED32,
    SYNC_PERIOD: DataType.UNSIGNED32,
    SYNC_WINDOW: DataType.UNSIGNED32,
    DEVICE_NAME: DataType.VISIBLE_STRING,
    HARDWARE_VERSION: DataType.VISIBLE_STRING,
    SOFTWARE_VERSION: DataType.VISIBLE_STRING,
    GUARD_TIME: DataType.UNSIGNED16,
    LIFE_TIME_FACTOR: DataType.UNSIGNED8,
    TIME_COB_ID: DataType.UNSIGNED32,
    EMCY_COB_ID: DataType.UNSIGNED32,
    EMCY_INHIBIT: DataType.UNSIGNED16,
    HEARTBEAT_PRODUCER: DataType.UNSIGNED16,
    SYNC_COUNTER: DataType.UNSIGNED8,
    NMT_STARTUP: DataType.UNSIGNED32,
}
_ARRAYS: Final = {
    ERROR_FIELD: DataType.UNSIGNED32,
    STORE_PARAMETERS: DataType.UNSIGNED32,
    RESTORE_DEFAULTS: DataType.UNSIGNED32,
    HEARTBEAT_CONSUMER: DataType.UNSIGNED32,
    IDENTITY: DataType.UNSIGNED32,
    VERIFY_CONFIGURATION: DataType.UNSIGNED32,
    ERROR_BEHAVIOUR: DataType.UNSIGNED8,
}
_PDO: Final = {
    PDO_COB_ID: DataType.UNSIGNED32,
    PDO_TRANSMISSION: DataType.UNSIGNED8,
    PDO_INHIBIT: DataType.UNSIGNED16,
    PDO_RESERVED: DataType.UNSIGNED8,
    PDO_EVENT: DataType.UNSIGNED16,
    PDO_SYNC_START: DataType.UNSIGNED8,
}
_SDO: Final = {1: DataType.UNSIGNED32, 2: DataType.UNSIGNED32, 3: DataType.UNSIGNED8}
_MAPPING: Final = dict.fromkeys(range(1, MOST_MAPPED + 1), DataType.UNSIGNED32)
_LAST_PDO: Final = PDO_COUNT - 1
_RECORDS: Final = (
    (SDO_SERVER_FIRST, SDO_SERVER_LAST, _SDO),
    (RPDO_COMMUNICATION, RPDO_COMMUNICATION + _LAST_PDO, _PDO),
    (TPDO_COMMUNICATION, TPDO_COMMUNICATION + _LAST_PDO, _PDO),
    (RPDO_MAPPING, RPDO_MAPPING + _LAST_PDO, _MAPPING),
    (TPDO_MAPPING, TPDO_MAPPING + _LAST_PDO, _MAPPING),
)


def standard_type(index: int, subindex: int) -> DataType | None:
    """Return the data type that CiA 301 has for an entry of its profile area, None without one."""
    if index in _VARIABLES or subindex == 0:
        return _VARIABLES.get(index)
    if index in _ARRAYS:
        return _ARRAYS[index]
    for first, last, types in _RECORDS:
        if first <= index <= last:
            return types.get(subindex)
    return None


def is_mapping(index: int) -> bool:
    """Return whether an object is the mapping record of a PDO."""
    return any(0 <= index - first < PDO_COUNT for first in (RPDO_MAPPING, TPDO_MAPPING))
