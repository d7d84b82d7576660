"""State tables of both nodes: the stimulator, and the power stage of the plate.

The stimulator; its commands are those of the controlword::

                 prepared            arm              run
    NOT_READY <-----------> READY ---------> ARMED <--------> RUNNING
        ^      unprepared     ^  <--------- |     stop         |
        |                     |    disarm   |                  |
        | reset, or NMT left  | disarm      | quick stop       | quick stop
        |                     +--------- QUICK_STOP <----------+
        |                     | reset       | a watchdog       | a watchdog
        +-------------------- FAULT <-------+------------------+

The power stage of the plate, which has a voltage only IN_USE::

    WAITING, TRIPPED --- 0 V ---> FREE --- voltage ---> IN_USE --- inhibit ---> TRIPPED
        ^                          |  <-- switch off ----- |
        +-- 0 V in FAULT, inhibit -+---- 0 V in FAULT -----+
"""

from __future__ import annotations

from enum import Enum, IntFlag
from typing import Final, NamedTuple

from smarttac_can.vocabulary.states import CONTROL_MASK, Control, State


class Event(Enum):
    """Events that cause a transition."""

    PREPARED = "all conditions are met"
    UNPREPARED = "a condition is no longer met"
    ARM = "controlword: arm rises"
    RUN = "controlword: run rises"
    STOP = "controlword: run falls"
    DISARM = "controlword: arm, run and quick stop are 0"
    QUICK_STOP = "controlword: quick stop"
    RESET = "controlword: fault reset rises"
    START_RUN = "start run"
    LEAVE = "NMT leaves OPERATIONAL"
    FAULT = "a watchdog trips"
    ILLEGAL = "any other controlword"


class Guard(IntFlag):
    """Conditions of a transition."""

    NONE = 0
    CLEAR = 1
    """No latched fault is present any more."""
    PREPARED = 2
    """No fault is present, the loop runs in OPERATIONAL, and the plate is tared and calibrated."""
    SUPERVISED = 4
    """A loss of the commander would be detected, or detection is not required."""


class Transition(NamedTuple):
    """One row of the table."""

    state: State
    event: Event
    guard: Guard
    next: State


_S, _E, _G = State, Event, Guard
TRANSITIONS: Final = (
    Transition(_S.NOT_READY, _E.PREPARED, _G.PREPARED, _S.READY),
    Transition(_S.NOT_READY, _E.DISARM, _G.NONE, _S.NOT_READY),
    Transition(_S.READY, _E.UNPREPARED, _G.NONE, _S.NOT_READY),
    Transition(_S.READY, _E.DISARM, _G.NONE, _S.READY),
    Transition(_S.READY, _E.ARM, _G.PREPARED | _G.SUPERVISED, _S.ARMED),
    Transition(_S.ARMED, _E.RUN, _G.PREPARED, _S.RUNNING),
    Transition(_S.RUNNING, _E.STOP, _G.NONE, _S.ARMED),
    *(Transition(state, _E.DISARM, _G.NONE, _S.READY) for state in (_S.ARMED, _S.RUNNING)),
    *(Transition(state, _E.QUICK_STOP, _G.NONE, _S.QUICK_STOP) for state in (_S.ARMED, _S.RUNNING)),
    Transition(_S.QUICK_STOP, _E.QUICK_STOP, _G.NONE, _S.QUICK_STOP),
    Transition(_S.QUICK_STOP, _E.DISARM, _G.NONE, _S.READY),
    Transition(_S.FAULT, _E.DISARM, _G.NONE, _S.FAULT),
    Transition(_S.FAULT, _E.RESET, _G.PREPARED, _S.READY),
    Transition(_S.FAULT, _E.RESET, _G.CLEAR, _S.NOT_READY),
    *(
        Transition(state, _E.START_RUN, _G.NONE, _S.READY)
        for state in (_S.ARMED, _S.RUNNING, _S.QUICK_STOP)
    ),
    *(
        Transition(state, _E.LEAVE, _G.NONE, _S.NOT_READY)
        for state in (_S.READY, _S.ARMED, _S.RUNNING, _S.QUICK_STOP)
    ),
    *(Transition(state, _E.FAULT, _G.NONE, _S.FAULT) for state in (_S.ARMED, _S.RUNNING)),
)
"""All transitions. Of rows with the same state and event, the first whose guard holds applies."""

_TABLE: Final[dict[tuple[State, Event], list[Transition]]] = {}
for _row in TRANSITIONS:
    _TABLE.setdefault((_row.state, _row.event), []).append(_row)


_ARM, _RUN, _QUICK_STOP, _RESET = (int(bit) for bit in Control)
_COMMANDS: Final = _ARM | _RUN | _QUICK_STOP
_RISING: Final = {(_ARM, _ARM): Event.ARM, (_ARM | _RUN, _RUN): Event.RUN}
"""Event of a rising command, by (all commands in the controlword, those that have risen)."""
_ASKS_FOR_WHAT_IS: Final = {State.ARMED: _ARM, State.RUNNING: _ARM | _RUN}


class StateMachine:
    """The state of one device.

    Arm, run and fault reset act on a rising bit; stop, disarm and quick stop act on the level. A
    command bit that is still set when the device disarms by itself acts again only after it was
    cleared.

    Attributes
    ----------
    state
        Present state.
    """

    __slots__ = ("_previous", "state")

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Reset to the state after power-on, with all command bits cleared."""
        self.state = State.NOT_READY
        self._previous = 0

    def take_as_given(self, word: int) -> None:
        """Record bits as set before, so that they act only after they were cleared."""
        self._previous |= word

    def handle(self, event: Event, holds: Guard) -> bool:
        """Make the transition for an event if its guard holds.

        Parameters
        ----------
        event
            Event to handle.
        holds
            Guards that hold.

        Returns
        -------
        bool
            False if no transition is allowed; the state is then unchanged.
        """
        for row in _TABLE.get((self.state, event), ()):
            if row.guard & holds == row.guard:
                self.state = row.next
                return True
        return False

    def command(self, word: int, holds: Guard) -> bool:
        """Make the transition that a controlword asks for.

        Parameters
        ----------
        word
            Bits of `Control`.
        holds
            Guards that hold.

        Returns
        -------
        bool
            False if the command is illegal; the state is then unchanged.
        """
        if word & ~CONTROL_MASK:
            return False
        event = self._event(word, word & ~self._previous)
        if event is not None and not self.handle(event, holds):
            return False
        self._previous = word
        return True

    def _event(self, word: int, rising: int) -> Event | None:
        """Return the event of a controlword; None if it asks for the present state."""
        state = self.state
        asked = word & _COMMANDS
        if asked & _QUICK_STOP:
            return Event.QUICK_STOP
        if not asked:
            return Event.RESET if rising & _RESET and state is State.FAULT else Event.DISARM
        if _ASKS_FOR_WHAT_IS.get(state) == asked:
            return None
        if asked == _ARM and state is State.RUNNING:
            return Event.STOP
        # RUNNING needs two controlwords: arm, then run.
        return _RISING.get((asked, rising & _COMMANDS), Event.ILLEGAL)


class StageState(Enum):
    """States of the power stage; only IN_USE may have a voltage."""

    WAITING = "0 V; ignores voltages until a drive of 0 V has come, as after the start"
    TRIPPED = "as *waiting*, after it went to 0 V by itself while it was in use"
    FREE = "0 V; accepts a voltage"
    IN_USE = "has accepted a voltage, and stays in use at drives of 0 V"


class StageEvent(Enum):
    """Events that cause a transition of the power stage."""

    ZERO = "a drive of 0 V from a stimulator that is not in FAULT"
    LATCHED = "a drive of 0 V from a stimulator in FAULT"
    VOLTAGE = "a drive with a voltage above 0 V that the plate accepts"
    SWITCH_OFF = "commanded to switch off"
    INHIBIT = "goes to 0 V by itself: see the watchdogs of the plate"
    START_RUN = "start run"


class StageTransition(NamedTuple):
    """One row of the table."""

    state: StageState
    event: StageEvent
    next: StageState


STAGE_TRANSITIONS: Final = (
    StageTransition(StageState.WAITING, StageEvent.ZERO, StageState.FREE),
    StageTransition(StageState.TRIPPED, StageEvent.ZERO, StageState.FREE),
    StageTransition(StageState.FREE, StageEvent.LATCHED, StageState.WAITING),
    StageTransition(StageState.IN_USE, StageEvent.LATCHED, StageState.WAITING),
    StageTransition(StageState.FREE, StageEvent.VOLTAGE, StageState.IN_USE),
    StageTransition(StageState.IN_USE, StageEvent.SWITCH_OFF, StageState.FREE),
    StageTransition(StageState.FREE, StageEvent.INHIBIT, StageState.WAITING),
    StageTransition(StageState.IN_USE, StageEvent.INHIBIT, StageState.TRIPPED),
    *(
        StageTransition(state, StageEvent.START_RUN, StageState.WAITING)
        for state in StageState
        if state is not StageState.WAITING
    ),
)
"""All transitions; any other event leaves the state unchanged."""
_STAGE_NEXT: Final = {(row.state, row.event): row.next for row in STAGE_TRANSITIONS}


def stage_after(state: StageState, event: StageEvent) -> StageState:
    """Return the state after an event; unchanged if the table has no transition for it."""
    return _STAGE_NEXT.get((state, event), state)
