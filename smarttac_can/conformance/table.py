"""All cases, in the order in which they run."""

from __future__ import annotations

from typing import Final

from smarttac_can.conformance import (
    dictionary,
    emcy,
    general,
    guarding,
    guarding_or_heartbeat,
    heartbeat,
    mapping,
    nmt,
    rpdo,
    sdo,
    sdo_aborts,
    sdo_block,
    sync,
    tpdo,
    tpdo_parameters,
)
from smarttac_can.conformance.case import Case

GROUPS: Final = {
    "EDS": "Data sheet",
    "SDO": "SDO server",
    "PDO": "Process data",
    "OD": "Object dictionary",
    "EMCY": "Emergency",
    "SYNC": "Synchronisation",
    "GUARD": "Node and life guarding",
    "HB": "Heartbeat",
    "BOTH": "Guarding and heartbeat together",
    "OTHER": "Identity, storage, error behaviour, CAN-IDs",
    "STATE": "NMT states",
    "TRANS": "NMT transitions",
}
"""What the first part of a case's number stands for."""

_MODULES = (
    sdo, sdo_block, sdo_aborts, tpdo, tpdo_parameters, rpdo, mapping, dictionary, emcy, sync,
    guarding, heartbeat, guarding_or_heartbeat, general, nmt,
)  # fmt: skip
_ORDER = list(GROUPS)

CASES: Final = tuple(
    sorted(
        (c for module in _MODULES for c in vars(module).values() if isinstance(c, Case)),
        key=lambda c: (_ORDER.index(c.group), c.number),
    )
)
