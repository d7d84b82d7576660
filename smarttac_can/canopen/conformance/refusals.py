"""Abort codes with which a device may refuse a request, by the cases that provoke a refusal.

CiA 301 has one abort code for each reason (table 22), but a device may also answer by a more
general one. CiA's own conformance tool takes several codes in most cases. Its log of a device that
passed shows them as "Valid abort codes" and "Allowing error codes": CANopenNode/CANopenDemo,
``test/test_report_CCT.md``. Each row below has the codes of the standard and those of that log.

A device that refuses by yet another code has refused, so the case passes, with a remark.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from smarttac_can.canopen.od.cia import AbortCode as Code


class Refusal(NamedTuple):
    """What a device refuses, and by which abort codes."""

    what: str
    """Request that the device refuses."""
    cases: str
    """Cases with this request."""
    codes: tuple[Code, ...]
    """Codes that are accepted without a remark."""
    source: str
    """Clause of CiA 301 and case of the log, whose numbers differ from those of this suite."""


TOGGLE: Final = Refusal(
    "segment whose toggle did not alternate", "SDO-07, SDO-08", (Code.TOGGLE,), "table 22"
)
COMMAND: Final = Refusal(
    "unknown or unexpected command specifier",
    "SDO-09, SDO-10, SDO-11",
    (Code.COMMAND, Code.GENERAL),
    "table 22; log, SDO 07",
)
NO_OBJECT: Final = Refusal(
    "object that does not exist",
    "SDO-14",
    (Code.NO_OBJECT, Code.GENERAL),
    "table 22; log, SDO 06, 28, 29, 30",
)
NO_SUBINDEX: Final = Refusal(
    "sub-index that does not exist",
    "SDO-15",
    (Code.NO_SUBINDEX, Code.GENERAL),
    "table 22; log, SDO 05",
)
NO_STRUCTURE: Final = Refusal(
    "sub-index FFh of a device that has none",
    "OD-09",
    (Code.NO_SUBINDEX, Code.GENERAL),
    "7.4.7.2; log, OD 05",
)
READ_ONLY: Final = Refusal(
    "write to a read-only entry",
    "SDO-16, OD-04",
    (Code.READ_ONLY, Code.ACCESS, Code.GENERAL),
    "table 22; log, SDO 03, OD 03",
)
WRITE_ONLY: Final = Refusal(
    "read of a write-only entry",
    "SDO-17, OD-05",
    (Code.WRITE_ONLY, Code.ACCESS, Code.GENERAL),
    "table 22; log, OD 04",
)
TOO_LONG: Final = Refusal(
    "more bytes than the entry has",
    "SDO-18",
    (Code.TOO_LONG, Code.LENGTH, Code.GENERAL),
    "table 22; log, SDO 08",
)
TOO_SHORT: Final = Refusal(
    "fewer bytes than the entry has, or than announced",
    "SDO-19, SDO-20",
    (Code.TOO_SHORT, Code.LENGTH, Code.GENERAL),
    "table 22; log, SDO 09",
)
CRC: Final = Refusal("block with a wrong CRC", "SDO-28", (Code.CRC,), "table 22")
BLOCK_SIZE: Final = Refusal(
    "block size 0 or 128",
    "SDO-29",
    (Code.BLOCK_SIZE, Code.COMMAND, Code.GENERAL),
    "table 22; log, SDO 26",
)
SEQUENCE: Final = Refusal(
    "acknowledged sequence number 128",
    "SDO-30",
    (Code.SEQUENCE, Code.COMMAND, Code.GENERAL),
    "table 22; log, SDO 27",
)
OUT_OF_RANGE: Final = Refusal(
    "value out of range",
    "OD-06, EMCY-04, SYNC-03, SYNC-08, OTHER-09",
    (Code.VALUE, Code.TOO_HIGH, Code.TOO_LOW, Code.GENERAL),
    "table 22; log, SDO 10",
)
NO_DATA: Final = Refusal(
    "read of an empty place of the history",
    "EMCY-04",
    (Code.NO_DATA, Code.NO_SUBINDEX, Code.GENERAL),
    "7.5.2.2 and table 22",
)
TAKEN_NODE: Final = Refusal(
    "second heartbeat consumer of one node", "HB-07", (Code.PARAMETER,), "7.5.2.19"
)
PERIOD_SET: Final = Refusal(
    "overflow value of the SYNC counter while the period is not 0",
    "SYNC-08",
    (Code.STATE,),
    "7.5.2.21; log, Synchronization 09",
)
SIGNATURE: Final = Refusal(
    "wrong signature for storing or restoring",
    "OTHER-04, OTHER-06",
    (Code.STORE, Code.LOCAL_CONTROL, Code.STATE),
    "7.5.2.13 and .14; log, Testing other 03, 05, 07",
)
MAPPING_ORDER: Final = Refusal(
    "mapping entry written without the procedure",
    "PDO-28",
    (Code.ACCESS, Code.NOT_MAPPABLE, Code.GENERAL),
    "7.5.2.38; log, PDO 23, 24",
)
TOO_MANY_ENTRIES: Final = Refusal(
    "more entries than the mapping has sub-indices",
    "PDO-29",
    (Code.PDO_LENGTH, Code.NOT_MAPPABLE, Code.NO_OBJECT, Code.ACCESS, Code.VALUE, Code.TOO_HIGH),
    "7.5.2.38 and table 22; log, PDO 25",
)
TOO_MANY_BITS: Final = Refusal(
    "mapping of more than 64 bits",
    "PDO-30",
    (Code.PDO_LENGTH, Code.NOT_MAPPABLE, Code.NO_OBJECT, Code.ACCESS),
    "7.5.2.38; log, PDO 26",
)
NOT_MAPPABLE: Final = Refusal(
    "mapping of an entry that this PDO cannot carry",
    "PDO-31, PDO-32, PDO-33",
    (Code.NOT_MAPPABLE, Code.NO_OBJECT),
    "7.5.2.38; log, PDO 28, 29, 31, 32",
)

REFUSALS: Final = tuple(row for row in tuple(globals().values()) if isinstance(row, Refusal))
"""All rows, in the order of this file."""
