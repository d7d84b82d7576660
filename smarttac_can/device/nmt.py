"""NMT states and commands (CiA 301, 7.2.8 and 7.3.2)."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Final

from smarttac_can.device.frame import Frame


class NMTState(IntEnum):
    """States; the values of those a device stays in are those of its heartbeat."""

    INITIALISING = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    RESET_APPLICATION = 0x06
    RESET_COMMUNICATION = 0x07
    PRE_OPERATIONAL = 0x7F


COMMANDS: Final = {
    0x01: NMTState.OPERATIONAL,
    0x02: NMTState.STOPPED,
    0x80: NMTState.PRE_OPERATIONAL,
    0x81: NMTState.RESET_APPLICATION,
    0x82: NMTState.RESET_COMMUNICATION,
}

# In which states a service lives (CiA 301, table 38).
ALL_STATES: Final = frozenset(
    {NMTState.STOPPED, NMTState.OPERATIONAL, NMTState.PRE_OPERATIONAL},
)
CONFIGURABLE: Final = frozenset({NMTState.OPERATIONAL, NMTState.PRE_OPERATIONAL})
OPERATIONAL_ONLY: Final = frozenset({NMTState.OPERATIONAL})


def commands_to(
    own: Callable[[], int], request: Callable[[NMTState], None]
) -> Callable[[Frame], None]:
    """Make the handler of NMT frames: it requests the state asked of this node or of all."""

    def receive(frame: Frame) -> None:
        data = frame.data
        if len(data) == 2 and data[1] in (0, own()) and data[0] in COMMANDS and not frame.rtr:
            request(COMMANDS[data[0]])

    return receive
