"""Limits and watchdogs may be tightened while a drive is possible, but not relaxed.

This holds for both nodes. To relax means to allow more, or to detect a fault later.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from smarttac_can.canopen.device.error_control import supervised_node
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.parameters import CALIBRATION, GAUGE_ZERO, LIMIT, MODEL, NULL
from smarttac_can.vocabulary.signals import (
    DRIVE_RPDO,
    DRIVE_TPDO,
    MEASUREMENT_RPDOS,
    MEASUREMENT_TPDOS,
)


class Rule(NamedTuple):
    """Rule that tells which writes relax an object."""

    text: str
    forbids: Callable[[int, int], bool]
    """Function of the present and the new raw value: whether the write relaxes the object."""


def _lasts_longer(present: int, value: int) -> bool:
    return present != 0 and (value == 0 or value > present)


def _supervises_less(present: int, value: int) -> bool:
    if not supervised_node(present):
        return False
    other = supervised_node(value) != supervised_node(present)
    return other or value & 0xFFFF > present & 0xFFFF


HIGHER: Final = Rule("a higher value", lambda present, value: value > present)
LOWER: Final = Rule("a lower value", lambda present, value: value < present)
LONGER: Final = Rule("a longer time, or 0 if the present time is not 0", _lasts_longer)
ELSEWHERE: Final = Rule(
    "for an entry that supervises a node: a longer time, 0, or another node", _supervises_less
)
OTHER: Final = Rule("any but the present value", lambda present, value: value != present)


class Place(NamedTuple):
    """Objects of the communication profile, and the rule for them."""

    first: int
    last: int
    rule: Rule
    subindices: tuple[int, ...] = ()
    """Sub-indices to which the rule applies; empty for all."""


class Table(NamedTuple):
    """Rules of one node."""

    by_name: Mapping[str, Rule]
    """Rules by object or record name; the name of an object precedes that of its record."""
    by_index: tuple[Place, ...]
    """Rules for SYNC, guarding, heartbeats, and the PDOs of a drive."""
    condition: str
    """When the rules apply, and what ends that."""


def _wiring(communication: int, pdos: Sequence[int]) -> Place:
    """Return the place of PDO communication records: all of a TPDO, COB-ID and type of an RPDO."""
    first, last = communication + pdos[0] - 1, communication + pdos[-1] - 1
    parts = (
        (cia.PDO_COB_ID, cia.PDO_TRANSMISSION) if communication == cia.RPDO_COMMUNICATION else ()
    )
    return Place(first, last, OTHER, parts)


_LAST_RPDO: Final = cia.RPDO_COMMUNICATION + MEASUREMENT_RPDOS[-1] - 1
_LAST_PUBLIC_RPDO: Final = MEASUREMENT_RPDOS[0] - 1
"""Last RPDO with a variable mapping. The mappings of the loop's own PDOs are constant."""
_DRIVE: Final = cia.RPDO_COMMUNICATION + DRIVE_RPDO - 1
_COMMON: Final = (
    Place(cia.SYNC_COB_ID, cia.SYNC_PERIOD, OTHER),
    Place(cia.GUARD_TIME, cia.LIFE_TIME_FACTOR, LONGER),
    Place(cia.EMCY_COB_ID, cia.EMCY_COB_ID, OTHER),
    # A producer heartbeat disables life guarding.
    Place(cia.HEARTBEAT_PRODUCER, cia.HEARTBEAT_PRODUCER, OTHER),
    Place(cia.HEARTBEAT_CONSUMER, cia.HEARTBEAT_CONSUMER, ELSEWHERE),
)
OF_STIMULATOR: Final = Table(
    {
        LIMIT: HIGHER,
        f"{LIMIT}.Lowest frequency": LOWER,
        CALIBRATION: OTHER,
        GAUGE_ZERO: OTHER,
        NULL: OTHER,
        MODEL: OTHER,
        "Drive unwatched": HIGHER,
    },
    (
        *_COMMON,
        _wiring(cia.RPDO_COMMUNICATION, range(1, MEASUREMENT_RPDOS[-1] + 1)),
        Place(cia.RPDO_MAPPING, cia.RPDO_MAPPING + _LAST_PUBLIC_RPDO - 1, OTHER),
        Place(cia.RPDO_COMMUNICATION, _LAST_RPDO, LONGER, (cia.PDO_EVENT,)),
        _wiring(cia.TPDO_COMMUNICATION, (DRIVE_TPDO,)),
    ),
    "while armed or running; disarm first",
)
"""Rules of the stimulator while armed or running. They do not cover its public TPDOs."""
OF_PLATE: Final = Table(
    {LIMIT: HIGHER},
    (
        *_COMMON,
        _wiring(cia.RPDO_COMMUNICATION, (DRIVE_RPDO,)),
        # For the drive a deadline of 0 means no time at all.
        Place(_DRIVE, _DRIVE, HIGHER, (cia.PDO_EVENT,)),
        _wiring(cia.TPDO_COMMUNICATION, MEASUREMENT_TPDOS),
    ),
    "while the stage is in use; disarm, and take the plate out of OPERATIONAL",
)
"""Rules of the plate while its power stage is in use."""


class Lock:
    """Refuse writes that relax limits or watchdogs.

    Parameters
    ----------
    od
        Object dictionary of the node.
    table
        Rules of the node.

    Attributes
    ----------
    rules
        Every locked entry, with its rule.
    """

    def __init__(self, od: ObjectDictionary, table: Table) -> None:
        self._condition = table.condition
        self.rules: dict[Entry, Rule] = {}
        for entry in od:
            by_name = table.by_name
            rule = by_name.get(entry.name) or by_name.get(entry.name.partition(".")[0])
            for place in table.by_index:
                meant = not place.subindices or entry.subindex in place.subindices
                if place.first <= entry.index <= place.last and meant:
                    rule = place.rule
            if rule is not None and entry.writable:
                self.rules[entry] = rule

    def require(self, entry: Entry, value: Any) -> None:
        """Raise `Abort` with STATE and the reason if a raw value relaxes the present one."""
        rule = self.rules.get(entry)
        if rule is not None and rule.forbids(entry.value, value):
            raise Abort(
                AbortCode.STATE,
                f"{entry.name} {entry.shown(value)} is refused, present value "
                f"{entry.shown(entry.value)}: {rule.text} is refused {self._condition}",
            )
