"""The states of the plate's power stage: what it takes before it takes a voltage."""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple


class StageState(Enum):
    """States of the power stage; only the last has a voltage."""

    WAITING = "at 0 V until a drive of 0 V has come, as at the beginning"
    TRIPPED = "the same, after it went to 0 V by itself while it was in use"
    FREE = "at 0 V, takes a voltage"
    IN_USE = "has taken a voltage, and since then whatever the drives say"


class StageEvent(Enum):
    """What moves it from state to state."""

    ZERO = "a drive of 0 V from a stimulator that is not in FAULT"
    LATCHED = "a drive of 0 V from a stimulator in FAULT"
    VOLTAGE = "a drive with a voltage that counts"
    SWITCH_OFF = "told to switch off"
    BAR = "goes to 0 V by itself: see the watchdogs of the plate"
    START_RUN = "start run"


class StageTransition(NamedTuple):
    """One row of the table."""

    state: StageState
    event: StageEvent
    next: StageState


_S, _E = StageState, StageEvent
STAGE_TRANSITIONS: Final = (
    StageTransition(_S.WAITING, _E.ZERO, _S.FREE),
    StageTransition(_S.TRIPPED, _E.ZERO, _S.FREE),
    StageTransition(_S.FREE, _E.LATCHED, _S.WAITING),
    StageTransition(_S.IN_USE, _E.LATCHED, _S.WAITING),
    StageTransition(_S.FREE, _E.VOLTAGE, _S.IN_USE),
    StageTransition(_S.IN_USE, _E.SWITCH_OFF, _S.FREE),
    StageTransition(_S.FREE, _E.BAR, _S.WAITING),
    StageTransition(_S.IN_USE, _E.BAR, _S.TRIPPED),
    *(StageTransition(state, _E.START_RUN, _S.WAITING) for state in _S if state is not _S.WAITING),
)
"""Every transition there is; any other event changes nothing."""
_NEXT: Final = {(row.state, row.event): row.next for row in STAGE_TRANSITIONS}


def follow(state: StageState, event: StageEvent) -> StageState:
    """Return the state after an event; the same if the table has no transition for it."""
    return _NEXT.get((state, event), state)
