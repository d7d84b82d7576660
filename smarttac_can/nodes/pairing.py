"""What the plate's three TPDOs of a cycle have to be, together, before they are answered."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smarttac_can.nodes.frame_check import holds
from smarttac_can.nodes.loop_frames import MEASUREMENT_RPDOS, received_measurement
from smarttac_can.nodes.plate_block import TICK_MASK
from smarttac_can.od.dictionary import ObjectDictionary

UNUSABLE_MAX: Final = 3
"""Measurements in a row, incomplete, corrupt or of a foreign tick, before it is a fault. Spread
ones do not add up: CAN may deliver a frame twice, and a doubled first PDO begins one that stays
incomplete. `MissedTime` counts ticks without a cycle."""
_FIRST, *_, _LAST = MEASUREMENT_RPDOS
_NOTHING: Final = -1


class Pairing:
    """Pairs the measurement PDOs of a tick; counts what cannot be used.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    unusable
        Called when a measurement begins after `UNUSABLE_MAX` that were no good.
    foreign
        Called with each sound one of another session, or that repeats the tick answered last.

    Attributes
    ----------
    values
        Of the last accepted measurement, in the order of the bus; empty before the first.
    """

    def __init__(
        self, od: ObjectDictionary, unusable: Callable[[], None], foreign: Callable[[], None]
    ) -> None:
        self._unusable = unusable
        self._on_foreign = foreign
        self._frames = frames = received_measurement(od)
        self._tick_at = frames.entries.index(od["Plate input.Tick"])
        self._gauge_tick_at = frames.entries.index(od["Plate input.Gauge tick"])
        self.values: tuple[int, ...] = ()
        self._lost = od["Cycle.Lost cycles"]
        self._foreign = od["Cycle.Foreign ticks"]
        self._corrupt = od["Cycle.Corrupt measurements"]
        self._come: dict[int, bytes] = {}
        self.forget()

    def forget(self) -> None:
        """Begin anew: no measurement is under way, none was answered."""
        self._come.clear()
        self._begun = 0
        self._session = self._next_session = _NOTHING
        self.start_run()

    def start_run(self) -> None:
        """Accept any tick as the next one."""
        self._answered = _NOTHING

    def take(self, rpdo: int, data: bytes) -> bool:
        """Keep the bytes of a PDO; those of the last one complete a measurement.

        Returns
        -------
        bool
            Whether they complete one that is sound, of this session and of a new tick. Its values
            are then in `values` and in the object dictionary.
        """
        come = self._come
        if rpdo == _FIRST:
            self._begin()
        come[rpdo] = data
        # A cycle's last PDO ends it, so that those of two cycles are never mixed.
        if rpdo != _LAST or len(come) < len(MEASUREMENT_RPDOS):
            return False
        data = b"".join(map(come.__getitem__, MEASUREMENT_RPDOS))
        come.clear()
        if not holds(data):
            self._corrupt.count()
            return False
        values = self._frames.unpack(data)
        tick = values[self._tick_at]
        session = values[self._gauge_tick_at] - tick & TICK_MASK
        if self._session == _NOTHING or session == self._next_session:
            self._session = session
        if session != self._session or tick == self._answered:
            self._next_session = session
            self._foreign.count()
            self._on_foreign()
            return False
        self._next_session = _NOTHING
        self._begun = 0
        self.values = values
        self._frames.keep(values)
        return True

    @property
    def session(self) -> int:
        """Number of the plate's session, 0..255, by which its second tick is ahead of the first.

        Another one is that of the plate when two measurements in a row have it.
        """
        return max(0, self._session)

    @property
    def level(self) -> float:
        """How near measurements that cannot be used are to a fault, of 1.0."""
        return self._begun / UNUSABLE_MAX

    def answered(self) -> int:
        """Note that the last accepted measurement got its drive; return its tick, 0..255."""
        self._answered = self.values[self._tick_at]
        return self._answered

    def _begin(self) -> None:
        if self._come:
            self._lost.count()
        self._come.clear()
        if self._begun >= UNUSABLE_MAX:
            self._unusable()
        self._begun += 1
