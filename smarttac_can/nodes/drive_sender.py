"""Who sends the drives that a plate takes: their check says it, and whether it is in FAULT."""

from __future__ import annotations

from typing import Final

from smarttac_can.nodes.frame_check import last_unsent
from smarttac_can.nodes.loop_frames import LATCHED
from smarttac_can.nodes.watches import full_bucket, leaked
from smarttac_can.od.dictionary import ObjectDictionary

WRONG_MAX: Final = 3
"""Drives with a wrong check in a row that disturb; those now and then fill a leaky bucket."""
_FULL: Final = full_bucket(WRONG_MAX)
_NOBODY: Final = 0
_NEVER: Final = -1


class DriveSender:
    """The stimulator that a plate works with: the first that tells it 0 V.

    One drive alone does not name it for good: a check over the session before, or over anything,
    names some node as well. Until a second one of the same comes, 0 V of another takes its place.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.

    Attributes
    ----------
    latched
        Whether the sender of the last drive was in FAULT.
    disturbed
        Whether too many drives had a wrong check.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._corrupt = od["Cycle.Corrupt drives"]
        self.forget()

    def forget(self) -> None:
        """Work with whoever comes first."""
        self._node_id = _NOBODY
        self._wrong = 0
        self._undisturbed = True
        self.disturbed = False
        self.latched = False

    def follow(self) -> None:
        """Begin a cycle; one without a wrong check makes up for some of those before."""
        if self._wrong and self._undisturbed:
            self._count(False)
        self._undisturbed = True

    @property
    def level(self) -> float:
        """How near wrong checks are to a bar; 1.0 or more while they bar."""
        return self._wrong / _FULL

    def sound(self, data: bytes, session: int, *, off: bool) -> bool:
        """Take a drive; tell whether it is this sender's. A wrong one is counted.

        Parameters
        ----------
        data
            Its bytes.
        session
            That of the plate, 0..255.
        off
            Whether it asks for 0 V.
        """
        if self._node_id == _NOBODY and not off:
            return False
        named = last_unsent(data, bytes((session,)))
        self.latched = named >= LATCHED
        node_id = named % LATCHED
        if self._node_id == _NOBODY:
            self._node_id, self._once_in = node_id, session
        elif node_id == self._node_id:
            self._once_in = _NEVER
        elif off and session == self._once_in:
            self._node_id = node_id
        if node_id != _NOBODY and node_id == self._node_id and (off or not self.latched):
            return True
        self._corrupt.count()
        self._undisturbed = False
        self._count(True)
        return False

    def _count(self, wrong: bool) -> None:
        self._wrong = leaked(self._wrong, _FULL, wrong)
        self.disturbed = self._wrong >= _FULL
