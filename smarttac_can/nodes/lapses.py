"""How many faulty cycles pass before there is a fault."""

from __future__ import annotations

from smarttac_can.vocabulary.watchdogs import FORGOTTEN


class Lapses:
    """Faulty cycles, each of which is forgotten after `FORGOTTEN` sound ones.

    So many in a row are a fault, and so are fewer that come again and again: of any n cycles in
    which there was no fault, fewer than ``(most FORGOTTEN + n)/(FORGOTTEN + 1)`` were faulty.
    """

    __slots__ = ("_level",)

    def __init__(self) -> None:
        self._level = 0

    def clear(self) -> None:
        """Forget all of them."""
        self._level = 0

    def share(self, most: int) -> float:
        """How near a fault is, 1.0 when it is there."""
        return self._level / (most * FORGOTTEN)

    def count(self, faulty: bool, most: int) -> bool:
        """Take a cycle, and say whether there is a fault.

        Parameters
        ----------
        faulty
            Whether the cycle is.
        most
            Faulty cycles in a row that are a fault, 1 or more.
        """
        full = most * FORGOTTEN
        if faulty:
            # The end lets a fault that is gone be forgotten within as many sound cycles.
            self._level = min(self._level + FORGOTTEN, full + FORGOTTEN)
        elif self._level:
            self._level -= 1
        return self._level >= full
