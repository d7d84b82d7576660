"""The loop over the bus: accept the measurements of a plate node, and supervise their timing.

`Pairing` joins the three TPDOs of the plate to one measurement. SYNC is the tick of the plate.
Three things are compared with it: device time (`SyncWatch`), the measurements that follow it
(`SourceWatch`), and the ticks that are answered (`LateAnswers`).

Notes
-----
The classes of the loop that count one thing against another, with those of `loop_time` and
`plate_node`. They share no step, so they are no rows of one table as the watches of a cycle are
(`watches`): they are stepped by different events, and some judge at once, some at the end of an
interval, and two only count.

============== ===================== ==================== ====================== =================
Class          Stepped by            Counts               Against                Result
============== ===================== ==================== ====================== =================
_Window        SYNC received         SYNCs                periods of device time SYNC irregular
SyncWatch      SYNC received         us without a SYNC    the deadline           SYNC lost
SourceWatch    SYNC, measurement     credits, 0..deadline one measurement a SYNC double sources
LateAnswers    SYNC, answer          SYNCs less the tick  the least of the past  a remark
MissedTime     own cycle             cycles               periods of device time ticks missed
LateDrives     tick, drive           us since the tick    the instant of a drive an object
DriveSender    drive, tick           wrong check sums     a leaky bucket         0 V at the plate
============== ===================== ==================== ====================== =================

What opens and clears them differs as well: a window of the deadline and one of 1000 periods, a
first SYNC, silence, a full second, a session of the plate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from smarttac_can.canopen.device.device import GONE_AFTER_US, Device
from smarttac_can.canopen.device.port import Clock
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.loop_frames import is_sound, received_measurement
from smarttac_can.instrument.nodes.loop_time import Deadline
from smarttac_can.instrument.nodes.plate_block import TICK_MASK
from smarttac_can.vocabulary.signals import MEASUREMENT_RPDOS, TICK_US
from smarttac_can.vocabulary.watchdogs import (
    SYNC_DRIFT_WINDOW,
    Watchdog,
    sync_drift_tolerance,
    sync_tolerance,
)

UNUSABLE_MAX: Final = 3
"""Unusable measurements in a row (incomplete, corrupt or of a foreign tick) before the fault.
Single ones do not add up: CAN may deliver a frame twice, and a doubled first PDO begins a
measurement that stays incomplete. `MissedTime` counts ticks without a cycle."""
_FIRST_RPDO, *_, _LAST_RPDO = MEASUREMENT_RPDOS
_NOTHING: Final = -1


class Pairing:
    """Join the measurement PDOs of a tick, and count unusable measurements.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    unusable
        Function that is called when a measurement begins after `UNUSABLE_MAX` unusable ones.
    foreign
        Function that is called with each sound measurement of another session or of the tick that
        was answered last.

    Attributes
    ----------
    values
        Values of the last accepted measurement, in the order of the bus; empty before the first.
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
        """Restart without a measurement in progress, and without an answered tick."""
        self._come.clear()
        self._begun = 0
        self._session = self._next_session = _NOTHING
        self.start_run()

    def start_run(self) -> None:
        """Accept any tick as the next one."""
        self._answered = _NOTHING

    def take(self, rpdo: int, data: bytes) -> bool:
        """Store the bytes of a PDO; the last PDO completes a measurement.

        Returns
        -------
        bool
            Whether this PDO completes a measurement that is sound, of this session and of a new
            tick. Its values are then in `values` and in the object dictionary.
        """
        come = self._come
        if rpdo == _FIRST_RPDO:
            self._begin()
        come[rpdo] = data
        # The last PDO of a cycle ends it, so PDOs of two cycles are never mixed.
        if rpdo != _LAST_RPDO or len(come) < len(MEASUREMENT_RPDOS):
            return False
        data = b"".join(map(come.__getitem__, MEASUREMENT_RPDOS))
        come.clear()
        if not is_sound(data):
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
        """Session number of the plate, 0..255: the difference of the two ticks of a measurement.

        A new session number is accepted when two measurements in a row have it.
        """
        return max(0, self._session)

    @property
    def level(self) -> float:
        """Level of unusable measurements; 1.0 is a fault."""
        return self._begun / UNUSABLE_MAX

    def answered(self) -> int:
        """Record that the last accepted measurement was answered; return its tick, 0..255."""
        self._answered = self.values[self._tick_at]
        return self._answered

    def _begin(self) -> None:
        if self._come:
            self._lost.count()
        self._come.clear()
        if self._begun >= UNUSABLE_MAX:
            self._unusable()
        self._begun += 1


Observe = Callable[[Watchdog, bool], None]
"""Function that takes a watchdog, and whether its fault is present."""
BACKLOG: Final = 1000
"""Most measurements that may have waited in queues and arrive late: those of 1 s."""
ANSWERS: Final = 20
"""Number of recent drives among which late ones are counted."""
_HALF: Final = TICK_MASK // 2
_LAST: Final = (1 << ANSWERS) - 1


class BusLoop:
    """Supervise SYNC, the measurements that follow it, and the deadline of their answers.

    The deadline is the shortest event timer of RPDO 5 to 7. It applies even if these PDOs are not
    valid.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    clock
        Device time.
    deadline
        Deadline of the loop.
    observe
        Function that is called when the fault of a watchdog comes or goes.
    unanswered
        Function that is called when the deadline has elapsed.

    Attributes
    ----------
    source
        Detection of other nodes that send frames of the loop.
    late_answers
        Count of answers that are sent after the next SYNC.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        clock: Clock,
        deadline: Deadline,
        observe: Observe,
        unanswered: Callable[[], None],
    ) -> None:
        self._clock = clock
        self._deadline = deadline
        self._observe = observe
        self._sync = SyncWatch(od, clock, deadline, observe)
        self.source = SourceWatch(od, clock, deadline, observe)
        self._unanswered = clock.timer(unanswered)
        self._pairing = Pairing(
            od, lambda: observe(Watchdog.MEASUREMENT, True), self.source.unexpected
        )
        self._missed = od["Cycle.Missed deadlines"]
        self.late_answers = LateAnswers(deadline)

    def start_run(self) -> None:
        """Accept any tick as the next one."""
        self._pairing.start_run()
        self.late_answers.restart()

    def leave(self) -> None:
        """Wait for a first SYNC and a first measurement, as NMT has left OPERATIONAL."""
        self._pairing.forget()
        self.late_answers.restart()
        self._sync.restart()
        self.source.restart()
        self._observe(Watchdog.MEASUREMENT, False)

    def sync(self, device: Device) -> None:
        """Check the time, the counter and the sender of a SYNC."""
        sync = device.sync
        if sync.own:
            self._missed.count(sync.missed)
            self._sync.produced()
        elif sync.produces:
            return
        else:
            self._sync.heard(sync.counter)
        self.source.sync()
        self.late_answers.sync()

    def take(self, rpdo: int, data: bytes) -> bool:
        """Take a PDO; return whether it completes a measurement that has to be answered."""
        return self._pairing.take(rpdo, data) and self.source.may_answer()

    def answer(self) -> bool:
        """Record that the measurement is answered; return whether the answer is late."""
        tick = self._pairing.answered()
        self._unanswered.start(self._deadline.ms * TICK_US)
        self._observe(Watchdog.MEASUREMENT, False)
        return self.late_answers.late(tick)

    @property
    def measurement(self) -> tuple[int, ...]:
        """Values of the last accepted measurement, in the order of the bus."""
        return self._pairing.values

    @property
    def session(self) -> int:
        """Number of the plate's session, 0..255."""
        return self._pairing.session

    def on_write(self, entry: Entry, value: Any) -> None:
        """Apply a write to one of the deadlines, even while a deadline is running."""
        ms = self._deadline.with_write(entry, value)
        if ms is not None:
            self._unanswered.follow(ms * TICK_US)

    def overdue(self) -> None:
        """Fire the deadline if it has elapsed."""
        if self._unanswered.due <= self._clock.now:
            self._unanswered.fire()

    def levels(self) -> dict[Watchdog, float]:
        """Return the level of each watchdog of the loop at the end of this tick; 1.0 is a fault."""
        lost, irregular = self._sync.levels(TICK_US)
        unanswered = self._clock.level((self._unanswered,), TICK_US)
        return {
            Watchdog.MEASUREMENT: max(unanswered, self._pairing.level),
            Watchdog.SYNC_LOST: lost,
            Watchdog.SYNC_IRREGULAR: irregular,
            Watchdog.DOUBLE: self.source.level,
        }


class _Window:
    """Count of the SYNCs in an interval of device time.

    Parameters
    ----------
    clock
        Device time.
    judge
        Function that is called at the end with the number of SYNCs received and of those expected.
    tolerance
        Function that returns for a deadline how many SYNCs too many or too few are accepted.

    Attributes
    ----------
    count
        Number of SYNCs received.
    open
        Whether an interval is in progress.
    tolerance
        SYNCs too many or too few that are accepted, by the deadline at the start of the interval.
    most
        Number of SYNCs above which SYNC is irregular at once.
    """

    def __init__(
        self,
        clock: Clock,
        judge: Callable[[int, int], None],
        tolerance: Callable[[int], int],
    ) -> None:
        self._clock = clock
        self._tolerance_of = tolerance
        self._judge = judge
        self._timer = clock.timer(self._end)
        self.count = self.tolerance = self.most = 0
        self.open = False
        self._begun = 0

    def begin(self, periods: int, deadline_ms: int) -> None:
        """Start an interval of so many periods."""
        self.open = True
        self.count = 0
        self.tolerance = self._tolerance_of(deadline_ms)
        self.most = periods + self.tolerance
        self._begun = self._clock.now
        self._timer.start(periods * TICK_US)

    def level(self, ahead: int) -> float:
        """Return the level, 1.0 for a fault, if the interval ends ``ahead`` us from now."""
        if not self.open:
            return 0.0
        off = self.count - (self._clock.now + ahead - self._begun) // TICK_US
        return abs(off) / (self.tolerance + 1) if off else 0.0

    def stop(self) -> None:
        """Stop counting."""
        self.open = False
        self._timer.stop()
        self.count = 0

    def _end(self) -> None:
        self.open = False
        self._judge(self.count, (self._clock.now - self._begun) // TICK_US)


class SyncWatch:
    """Compare SYNC with device time, from the first SYNC on.

    Parameters
    ----------
    od, clock, deadline, observe
        As for `BusLoop`.
    """

    def __init__(
        self, od: ObjectDictionary, clock: Clock, deadline: Deadline, observe: Observe
    ) -> None:
        self._clock = clock
        self._deadline = deadline
        self._observe = observe
        self._overflow = od.entry(cia.SYNC_COUNTER)
        self._silence = clock.timer(self._on_silence)
        self._window = _Window(clock, self._judge, sync_tolerance)
        self._long = _Window(clock, self._judge_drift, sync_drift_tolerance)
        self.restart()

    def restart(self) -> None:
        """Wait for a first SYNC."""
        self._silence.stop()
        self._window.stop()
        self._long.stop()
        self._counter = 0
        self._drifts = False
        self._observe(Watchdog.SYNC_LOST, False)
        self._observe(Watchdog.SYNC_IRREGULAR, False)

    def produced(self) -> None:
        """Stop the supervision, as this node produces SYNC itself."""
        if self._window.open:
            self.restart()

    def heard(self, counter: int) -> None:
        """Take a SYNC of another node and its counter; 0 if it has no counter."""
        deadline_ms = self._deadline.ms
        window = self._window
        if not window.open:
            window.begin(self._deadline.window, deadline_ms)
        if not self._long.open:
            self._long.begin(SYNC_DRIFT_WINDOW, deadline_ms)
        window.count += 1
        self._long.count += 1
        if window.count > window.most:
            # At once, because without progress of device time the window never ends.
            self._irregular()
        self._silence.start(deadline_ms * TICK_US)
        self._observe(Watchdog.SYNC_LOST, False)
        before, self._counter = self._counter, counter
        if before and counter and counter != before % self._overflow.value + 1:
            self._observe(Watchdog.SYNC_COUNTER, True)

    def levels(self, ahead: int) -> tuple[float, float]:
        """Return the levels of lost and irregular SYNC ``ahead`` us from now; 1.0 is a fault."""
        silence = self._clock.level((self._silence,), ahead)
        return silence, max(self._window.level(ahead), self._long.level(ahead))

    def _on_silence(self) -> None:
        self._forget_drift()
        self._observe(Watchdog.SYNC_LOST, True)

    def _irregular(self) -> None:
        self._forget_drift()
        self._observe(Watchdog.SYNC_IRREGULAR, True)

    def _forget_drift(self) -> None:
        """Restart the long window: a lost SYNC or a burst is no drift of the clock."""
        self._long.stop()
        self._drifts = False

    def _judge(self, count: int, periods: int) -> None:
        if abs(count - periods) > self._window.tolerance:
            self._irregular()
        elif not self._drifts:
            self._observe(Watchdog.SYNC_IRREGULAR, False)
        self._window.begin(self._deadline.window, self._deadline.ms)

    def _judge_drift(self, count: int, periods: int) -> None:
        self._drifts = abs(count - periods) > self._long.tolerance
        if self._drifts:
            self._observe(Watchdog.SYNC_IRREGULAR, True)
        self._long.begin(SYNC_DRIFT_WINDOW, self._deadline.ms)


class SourceWatch:
    """Grant one answer for each SYNC, and trip if another node sends frames of the loop.

    Parameters
    ----------
    od, clock, observe
        As for `SyncWatch`.
    deadline
        Deadline of the loop. As many SYNCs may wait for their measurement.

    Notes
    -----
    A SYNC that the plate has received and this node has not leaves one measurement too many.
    `SyncWatch` tolerates one less than the deadline in its window; this class the same in as many
    SYNCs.
    """

    def __init__(
        self, od: ObjectDictionary, clock: Clock, deadline: Deadline, observe: Observe
    ) -> None:
        self._clock = clock
        self._deadline = deadline
        self._observe = observe
        self._surplus = od["Cycle.Surplus measurements"]
        self._quiet = self._clock.timer(self._on_quiet)
        self._collision = False
        self._owed = 0
        self.restart()

    def restart(self) -> None:
        """Wait for a first SYNC; measurements that waited in queues may still arrive."""
        self._credits = self._heard = 0
        self._begin_window()

    def forget(self) -> None:
        """Clear the fault."""
        self._quiet.stop()
        self._collision = False
        self._observe(Watchdog.DOUBLE, False)

    def sync(self) -> None:
        """Take a SYNC that is the tick of the plate: one measurement belongs to it.

        Measurements that arrive while SYNC is lost, or late, do not indicate another source.
        """
        deadline = self._deadline
        before, self._heard = self._heard, self._clock.now
        if self._heard - before > deadline.ms * TICK_US:
            self._begin_window()
        self._credits = min(self._credits + 1, deadline.ms)
        self._owed = min(self._owed + 1, BACKLOG)
        self._syncs += 1
        if self._unexpected > deadline.tolerance:
            self.plate_reports_another()
        if self._syncs >= deadline.window:
            if self._measured == self._syncs:
                self._owed = 0
                self._credits = min(self._credits, 1)
            self._begin_window()

    def may_answer(self) -> bool:
        """Take a measurement; return whether it belongs to a SYNC. Otherwise count it as surplus.

        On a bus of sockets a measurement may overtake its SYNC, so after a first SYNC one answer
        may be ahead of it.
        """
        self._measured += 1
        late = self._owed > 0
        if late:
            self._owed -= 1
        if self._credits > 0 or (self._credits == 0 and self._heard):
            self._credits -= 1
            return True
        self._surplus.count()
        if not late:
            self.unexpected()
        return False

    def unexpected(self) -> None:
        """Record a measurement without a SYNC, or of another session or an answered tick."""
        self._unexpected += 1

    @property
    def level(self) -> float:
        """Level of measurements without a SYNC; 1.0 is a fault."""
        return self._unexpected / (self._deadline.tolerance + 1)

    def plate_reports_another(self) -> None:
        """Record that the plate reports another source of its frames."""
        self._quiet.start(GONE_AFTER_US)
        self._observe(Watchdog.DOUBLE, True)

    def collide(self, heard: bool) -> None:
        """Record whether another node uses an identifier of this node."""
        self._collision = heard
        if heard:
            self._observe(Watchdog.DOUBLE, True)
        elif not self._quiet.running:
            self._observe(Watchdog.DOUBLE, False)

    def _begin_window(self) -> None:
        self._syncs = self._measured = self._unexpected = 0

    def _on_quiet(self) -> None:
        if not self._collision:
            self._observe(Watchdog.DOUBLE, False)


class LateAnswers:
    """Count answers that are late, by comparing SYNCs with the ticks of the plate.

    The number of SYNCs minus the tick, modulo 256, is smallest for an answer in time. It is larger
    by 1 if a SYNC came between the measurement and its drive: the plate then begins its next cycle
    without this drive.

    Parameters
    ----------
    deadline
        Deadline of the loop.

    Notes
    -----
    If the plate misses a SYNC, all later answers look late. So do those of a loop that is never in
    time; the deadline of the plate ends its voltage. After as many late answers in a row as the
    deadline has ms, their difference is taken as the smallest. A measurement that overtook its SYNC
    looks early; if two of the last `ANSWERS` do, their difference is taken as the smallest. Frames
    that wait in a queue of this node are not detected.
    """

    __slots__ = ("_ahead", "_deadline", "_early", "_history", "_in_a_row", "_syncs")

    def __init__(self, deadline: Deadline) -> None:
        self._deadline = deadline
        self._syncs = 0
        self.restart()

    def restart(self) -> None:
        """Take the next answer as in time, and clear the history."""
        self._ahead: int | None = None
        self._in_a_row = self._early = self._history = 0

    def sync(self) -> None:
        """Take a SYNC that is the tick of the plate."""
        self._syncs = self._syncs + 1 & TICK_MASK

    def late(self, tick: int) -> bool:
        """Count the answer to a tick, 0..255, that is sent next; return whether it is late."""
        late = self._is_late(self._syncs - tick & TICK_MASK)
        self._history = (self._history << 1 | late) & _LAST
        return late

    def summary(self) -> str:
        """Return how many of the last answers were late; empty if none was."""
        late = self._history.bit_count()
        return f"{late} of the last {ANSWERS} drives late" if late else ""

    def _is_late(self, ahead: int) -> bool:
        if self._ahead is None:
            self._ahead = ahead
        more = ahead - self._ahead & TICK_MASK
        early = more > _HALF
        self._early = (self._early << 1 | early) & _LAST
        if more == 0:
            self._in_a_row = 0
        elif early:
            if self._early.bit_count() > 1:
                self._take_for_least(ahead)
        else:
            self._in_a_row += 1
            if self._in_a_row <= self._deadline.ms:
                return True
            self._take_for_least(ahead)
        return False

    def _take_for_least(self, ahead: int) -> None:
        self._ahead = ahead
        self._in_a_row = self._early = 0
