"""What the gauges may show without a load: a tare that finds more would hide a finger."""

from __future__ import annotations

from typing import Final

from smarttac_can.control.tribometer import Forces
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.objects import NOT_TARED

NULL: Final = "Gauge null"
"""Name of the record."""


class NullWindow:
    """The null that each gauge had when it was calibrated, and how far it may have drifted.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._window = od[f"{NULL}.Window"]
        self._nulls = [od[f"{NULL}.Null of S{number}"] for number in range(1, 7)]

    def require(self, zeros: Forces) -> None:
        """Refuse zeros in N of which one is outside.

        Raises
        ------
        ValueError
            In one line with the gauge that is furthest off, its reading and the window.
        """
        off = [zero - null.si_value for zero, null in zip(zeros, self._nulls, strict=True)]
        worst = max(range(len(off)), key=lambda at: abs(off[at]))
        if abs(off[worst]) > self._window.si_value:
            raise ValueError(
                f"{NOT_TARED}S{worst + 1} reads {_mN(zeros[worst])}, more than "
                f"{_mN(self._window.si_value)} from its null of "
                f"{_mN(self._nulls[worst].si_value)}: lift what rests on the plate, and tare"
            )


def _mN(newton: float) -> str:
    return f"{newton * 1e3:.0f} mN"
