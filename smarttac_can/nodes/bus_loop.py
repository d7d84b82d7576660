"""The loop over the bus: which measurement of a plate node is answered, and what is watched."""

from __future__ import annotations

from collections.abc import Callable

from smarttac_can.device.device import Device
from smarttac_can.device.timer import Clock
from smarttac_can.nodes.late_answers import LateAnswers
from smarttac_can.nodes.loop_frames import MEASUREMENT_RPDOS
from smarttac_can.nodes.loop_period import deadlines, shortest_ms
from smarttac_can.nodes.pairing import Pairing
from smarttac_can.nodes.source_watch import SourceWatch
from smarttac_can.nodes.sync_watch import SyncWatch
from smarttac_can.nodes.watching import Watching
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.watchdogs import Watchdog


class BusLoop:
    """SYNC, the measurements that follow it, and the deadline within which they are answered.

    The deadline is that of the shortest event timer of RPDO 5 to 7, and holds whatever becomes of
    these PDOs.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    clock
        Device time.
    trip, settle
        Called with a watchdog whose fault comes or goes.
    unanswered
        Called when the deadline is over.

    Attributes
    ----------
    source
        Watch over who else sends.
    late_answers
        Watch over what is answered behind the next SYNC.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        clock: Clock,
        trip: Callable[[Watchdog], None],
        settle: Callable[[Watchdog], None],
        unanswered: Callable[[], None],
    ) -> None:
        self._clock = clock
        self._settle = settle
        self._deadlines = deadlines(od, MEASUREMENT_RPDOS)
        watching = Watching(od, clock, lambda: shortest_ms(self._deadlines), trip, settle)
        self._sync = SyncWatch(watching)
        self.source = SourceWatch(watching)
        self._unanswered = clock.timer(unanswered)
        self._pairing = Pairing(od, lambda: trip(Watchdog.MEASUREMENT), self.source.strange)
        self._missed = od["Cycle.Missed deadlines"]
        self._tick = od["Plate input.Tick"]
        self.late_answers = LateAnswers(watching.deadline_ms)

    def start_run(self) -> None:
        """Accept any tick as the next one."""
        self._pairing.start_run()
        self.late_answers.restart()

    def leave(self) -> None:
        """Follow NMT out of OPERATIONAL: wait for a first SYNC and a first measurement."""
        self._pairing.forget()
        self.late_answers.restart()
        self._sync.restart()
        self.source.restart()
        self._settle(Watchdog.MEASUREMENT)

    def sync(self, device: Device) -> None:
        """Look at when the SYNC comes, at its counter, and whose it is."""
        if device.sync_own:
            self._missed.count(device.sync_missed)
            self._sync.produced()
        elif device.produces_sync:
            return
        else:
            self._sync.heard(device.sync_counter)
        self.source.sync()
        self.late_answers.sync()

    def take(self, rpdo: int) -> bool:
        """Take a PDO; tell whether it completes a measurement that is to be answered."""
        return self._pairing.take(rpdo) and self.source.may_answer()

    def answer(self) -> bool:
        """Take note that the measurement gets its drive; tell whether that is late."""
        self._pairing.answered()
        self._unanswered.start(shortest_ms(self._deadlines) * TICK_US)
        self._settle(Watchdog.MEASUREMENT)
        return self.late_answers.late(self._tick.value)

    @property
    def session(self) -> int:
        """Number of the plate's session, 0..255."""
        return self._pairing.session

    def on_write(self, entry: Entry, value: int) -> None:
        """Follow a write to one of the deadlines, also within one."""
        if entry in self._deadlines:
            shortest = min(value, *(e.value for e in self._deadlines if e is not entry))
            self._unanswered.follow(shortest * TICK_US)

    def overdue(self) -> None:
        """Look whether the deadline is over now."""
        if self._unanswered.due <= self._clock.now:
            self._unanswered.fire()

    def levels(self) -> tuple[float, float, float, float]:
        """How near to a fault, 1.0, measurements, SYNC, its regularity and the source are."""
        return (
            max(self._clock.share((self._unanswered,), TICK_US), self._pairing.level),
            *self._sync.levels(TICK_US),
            self.source.level,
        )
