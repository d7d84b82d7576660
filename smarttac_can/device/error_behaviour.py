"""Error behaviour: which NMT state follows an error (CiA 301, 7.5.2.32; CiA 404)."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Any, ClassVar, Final

from smarttac_can.device.nmt import ALL_STATES, NMTState
from smarttac_can.device.port import Port
from smarttac_can.device.service import Service
from smarttac_can.od.cia import ERROR_BEHAVIOUR, Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry


class ErrorClass(IntEnum):
    """Sub-indices of the error behaviour."""

    COMMUNICATION = 1
    ANALOGUE_INPUT = 3


_PRE_OPERATIONAL: Final = 0
_NO_CHANGE: Final = 1
_STOPPED: Final = 2


class ErrorBehaviour(Service):
    """Changes the NMT state after an error, as the object says.

    Parameters
    ----------
    enter_state
        Brings the device into another NMT state.
    """

    states: ClassVar = ALL_STATES

    def __init__(
        self, port: Port, od: ObjectDictionary, enter_state: Callable[[NMTState], None]
    ) -> None:
        super().__init__(port, od, (ERROR_BEHAVIOUR,))
        self._enter_state = enter_state
        self._state = NMTState.INITIALISING

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse a value that CiA 301 does not define: 0, 1 and 2 are."""
        if entry.subindex and not _PRE_OPERATIONAL <= value <= _STOPPED:
            raise Abort(AbortCode.VALUE)

    def apply(self, entry: Entry) -> None:
        """Do nothing: the value is read at the next error."""

    def enter(self, state: NMTState | None) -> None:
        """Remember the NMT state, from which an error may lead."""
        super().enter(state)
        if state is not None:
            self._state = state

    def react(self, error_class: ErrorClass = ErrorClass.COMMUNICATION) -> None:
        """Follow an error; without the object only a communication error ends OPERATIONAL."""
        absent = _PRE_OPERATIONAL if error_class is ErrorClass.COMMUNICATION else _NO_CHANGE
        behaviour = self.od.number(ERROR_BEHAVIOUR, error_class, absent)
        if behaviour == _PRE_OPERATIONAL and self._state is NMTState.OPERATIONAL:
            self._enter_state(NMTState.PRE_OPERATIONAL)
        elif behaviour == _STOPPED and self.alive and self._state is not NMTState.STOPPED:
            self._enter_state(NMTState.STOPPED)
