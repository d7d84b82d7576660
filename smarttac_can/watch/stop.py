"""The stop: a stimulator is disarmed, whoever drives it, until it shows so."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.master import requests
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import State, known_state

PAUSE_S: Final = 0.1
_SHARP: Final = (State.ARMED, State.RUNNING)


class Stop:
    """Writes controlword and mode again and again: a frame may be lost, and another may arm.

    Parameters
    ----------
    od
        EDS of the stimulator, loaded for its node-ID.

    Attributes
    ----------
    asked
        Whether a stop was asked for, and the stimulator has not shown yet that it rests.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._frames = [
            requests.download(od.node_id, od["Controlword"], 0),
            requests.download(od.node_id, od["Mode"], int(Mode.OFF)),
        ]
        self.asked = False
        self._first: float | None = None
        self._next = 0.0

    def ask(self) -> None:
        """Stop from now on; asked for again, it lasts longer."""
        self.asked = True
        self._first = None

    def frames(
        self, now: float, shown: tuple[float, int] | None, rested: float | None
    ) -> list[Frame]:
        """Return the frames to send at a time in s.

        Parameters
        ----------
        now
            The time in s.
        shown
            When the statusword came last, and what it was; None if it never has.
        rested
            When the node last said that it is not OPERATIONAL; None if it never has.
        """
        if not self.asked:
            return []
        if self._first is None:
            self._first = self._next = now
        if _rests(self._first, shown, rested):
            self.asked = False
            return []
        if now < self._next:
            return []
        self._next = now + PAUSE_S
        return list(self._frames)


def _rests(since: float, shown: tuple[float, int] | None, rested: float | None) -> bool:
    if rested is not None and rested > since:
        return True
    return shown is not None and shown[0] > since and known_state(shown[1]) not in _SHARP
