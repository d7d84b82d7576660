"""NMT states and commands (CiA 301, 7.2.8 and 7.3.2)."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from smarttac_can.canopen.od.cia import NMTCommand


class NMTState(IntEnum):
    """NMT states; the number of a lasting state is that in the heartbeat.

    STOPPED, OPERATIONAL and PRE_OPERATIONAL last. INITIALISING is the 0 of the boot-up message. The
    two resets are transient, and no frame carries their numbers.
    """

    INITIALISING = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    RESET_APPLICATION = 0x06
    RESET_COMMUNICATION = 0x07
    PRE_OPERATIONAL = 0x7F


STATES: Final[dict[int, str]] = {
    NMTState.INITIALISING: "boot-up",
    NMTState.STOPPED: "stopped",
    NMTState.OPERATIONAL: "operational",
    NMTState.PRE_OPERATIONAL: "pre-operational",
}
"""Texts of the NMT states in a heartbeat."""
UNKNOWN: Final = "unknown"


def state_text(number: int) -> str:
    """Return the text of an NMT state in a heartbeat, or `UNKNOWN`."""
    return STATES.get(number, UNKNOWN)


COMMANDS: Final[dict[int, NMTState]] = {
    NMTCommand.START: NMTState.OPERATIONAL,
    NMTCommand.STOP: NMTState.STOPPED,
    NMTCommand.ENTER_PRE_OPERATIONAL: NMTState.PRE_OPERATIONAL,
    NMTCommand.RESET_NODE: NMTState.RESET_APPLICATION,
    NMTCommand.RESET_COMMUNICATION: NMTState.RESET_COMMUNICATION,
}

# NMT states in which a service is active (CiA 301, table 38).
ALL_STATES: Final = frozenset(
    {NMTState.STOPPED, NMTState.OPERATIONAL, NMTState.PRE_OPERATIONAL},
)
CONFIGURABLE: Final = frozenset({NMTState.OPERATIONAL, NMTState.PRE_OPERATIONAL})
OPERATIONAL_ONLY: Final = frozenset({NMTState.OPERATIONAL})
