"""How punctual the 1 kHz loop is, from the time stamps of its frames on the bus."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, exp, log
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.device.frame import Frame
from smarttac_can.device.mapping import Direction, compile_mapping
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    PDO_COB_ID,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    SYNC_ID,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.signals import TICK

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHORTEST_MS: Final = 3
"""The deadline that the dose is compared with, in ms."""
_QUIET: Final = 0.05


class FrozenStage(NamedTuple):
    """A stage frozen at a voltage, and a plate of first order at its resonance.

    With the final amplitude as 1, ``tau W' = 1 - W`` until the deadline ends it, then
    ``tau W' = -W``. All times count from the moment at which it freezes.
    """

    deadline_ms: float
    """Deadline of the plate, long enough for 5 % of the final amplitude to be reached."""
    tau_ms: float
    """Time constant of the plate, above 0."""
    voltage_v: float
    final_um: float
    """Amplitude peak-to-peak that this voltage has in the end."""

    @property
    def reached(self) -> float:
        """Share of the final amplitude that a plate at rest reaches, 0..1."""
        return 1.0 - exp(-self.deadline_ms / self.tau_ms)

    @property
    def quiet_ms(self) -> float:
        """Time in ms after which the amplitude of a plate at rest is below 5 % again."""
        return self.deadline_ms + self.tau_ms * log(self.reached / _QUIET)

    @property
    def dose_from_rest(self) -> float:
        """Integral of W^2 over all time, of a plate at rest, in ms of the final amplitude."""
        return self.deadline_ms - self.tau_ms * self.reached

    @property
    def dose_from_final(self) -> float:
        """The same of a plate that has the final amplitude already."""
        return self.deadline_ms + 0.5 * self.tau_ms

    def as_json(self) -> dict[str, Any]:
        """Return what it does; doses relative to those of the shortest deadline."""
        shortest = self._replace(deadline_ms=SHORTEST_MS)
        return {
            "voltage_v": self.voltage_v,
            "final_um": round(self.final_um, 3),
            "reached_share": round(self.reached, 4),
            "below_5_percent_ms": round(self.quiet_ms, 2),
            "dose_ratio": round(self.dose_from_final / shortest.dose_from_final, 2),
            "dose_ratio_from_rest": round(self.dose_from_rest / shortest.dose_from_rest, 2),
        }


def frozen_stage(deadline_ms: float) -> FrozenStage:
    """Return the worst of the default limits: the plate's highest voltage, at its resonance."""
    voltage = plate_od()["Limit.Voltage"].si_value
    model = stimulator_od()
    return FrozenStage(
        deadline_ms,
        tau_ms=model["Model.Tau"].si_value * 1e3,
        voltage_v=voltage,
        final_um=model["Model.Gain per volt"].si_value * voltage * 1e6,
    )


DEADLINE_MIN_MS: Final = 3
DEADLINE_MAX_MS: Final = 100
_MARGIN: Final = 2
DEADLINE_RULE: Final = (
    "twice the longest time between two drives, rounded up to whole ms, "
    f"{DEADLINE_MIN_MS} ms at least and none above {DEADLINE_MAX_MS} ms"
)
_LAST_MEASUREMENT: Final = 3
"""TPDO of the plate that ends a measurement."""
_DRIVE: Final = 1
"""RPDO of the plate."""
_IN_TURN: Final = 50
"""How often SYNC and measurement come in turn until neither can be a whole tick late."""
_TICKS: Final = 256
"""Of which the tick counts show the remainder."""
_WAITING_MAX: Final = DEADLINE_MAX_MS


class Delays:
    """Delays in whole us and how often each came: exact quantiles of any number of them."""

    def __init__(self) -> None:
        self.counts: Counter[int] = Counter()

    def add(self, seconds: float) -> None:
        """Count a delay in s, rounded to whole us."""
        self.counts[round(seconds * 1e6)] += 1

    def quantile_us(self, share: float) -> int:
        """Return the least delay in us that a share, 0..1, of all does not exceed.

        Raises
        ------
        ValueError
            If none was counted.
        """
        left = max(1, ceil(share * self.counts.total()))
        for delay in sorted(self.counts):
            left -= self.counts[delay]
            if left <= 0:
                return delay
        raise ValueError("there are no delays")

    def as_json(self) -> dict[str, int]:
        """Return median, 99 %, 99.9 % and maximum in us."""
        return {
            "p50_us": self.quantile_us(0.5),
            "p99_us": self.quantile_us(0.99),
            "p999_us": self.quantile_us(0.999),
            "max_us": self.quantile_us(1.0),
        }


@dataclass(slots=True)
class _Cycle:
    """A SYNC and what has come since."""

    sync: float
    driven: bool = False
    measurements: int = 0
    """How many ended before the next SYNC, whatever SYNC they answer."""
    unheard: bool = False
    """Whether the listener has not heard the SYNC of one of these."""


class LoopTiming:
    """Statistics of the loop's frames, whoever listens and however late.

    A measurement belongs to the first SYNC that has none yet, a drive to the measurement whose tick
    count it carries. Cycles of which the tick counts say that the listener has not heard them are
    neither ticks nor missed.

    Parameters
    ----------
    plate
        EDS of the plate, loaded for its node-ID.

    Attributes
    ----------
    sync
        How much later than 1 ms after the one before it each SYNC came, 0 if earlier.
    measurement
        From SYNC to the TPDO that ends the measurement.
    drive
        From SYNC to the drive that answers that measurement.
    lost
        Cycles that the listener has not heard.
    """

    def __init__(self, plate: ObjectDictionary) -> None:
        self.sync = Delays()
        self.measurement = Delays()
        self.drive = Delays()
        self.lost = 0
        measurement = TPDO_COMMUNICATION + _LAST_MEASUREMENT - 1
        drive = RPDO_COMMUNICATION + _DRIVE - 1
        first_at = _place(plate, TPDO_MAPPING, Direction.TRANSMIT, "Vibration.Tick")
        measured_at = _place(
            plate, TPDO_MAPPING + _LAST_MEASUREMENT - 1, Direction.TRANSMIT, "Gauge tick"
        )
        driven_at = _place(plate, RPDO_MAPPING + _DRIVE - 1, Direction.RECEIVE, "Drive.Tick")
        self._ticks_of: dict[int, tuple[Callable[[float, int], None], int]] = {
            plate.number(TPDO_COMMUNICATION, PDO_COB_ID) & CAN_ID_MASK: (self._on_first, first_at),
            plate.number(measurement, PDO_COB_ID) & CAN_ID_MASK: (
                self._on_measurement,
                measured_at,
            ),
            plate.number(drive, PDO_COB_ID) & CAN_ID_MASK: (self._on_drive, driven_at),
        }
        self._cycle: _Cycle | None = None
        self._begun = 0.0
        self._driven = 0
        self._doubtful: deque[float] = deque(maxlen=_WAITING_MAX)
        self._unmeasured: deque[_Cycle] = deque(maxlen=_WAITING_MAX)
        self._unanswered: dict[int, _Cycle] = {}
        self._unmatched = 0
        self._first_tick: int | None = None
        self._session = 0
        self._tick: int | None = None
        self._tick_time = 0.0
        self._in_turn = 0
        self._drive_time: float | None = None
        self._gap_s = 0.0

    @property
    def ticks(self) -> int:
        """Ticks of 1 ms between the first SYNC and the last."""
        return self._span - self.lost

    @property
    def missed(self) -> int:
        """Those without a SYNC, and those whose drive did not come before the next SYNC."""
        return max(0, self._span - self._driven - self.lost)

    @property
    def gap_s(self) -> float:
        """Longest time between two drives in s, or from the last one to the last SYNC."""
        if self._cycle is None or self._drive_time is None:
            return self._gap_s
        return max(self._gap_s, self._cycle.sync - self._drive_time)

    @property
    def ran(self) -> bool:
        """Whether there is anything to show: SYNCs, measurements and drives."""
        return all(delays.counts for delays in (self.sync, self.measurement, self.drive))

    def as_json(self) -> dict[str, Any]:
        """Return the figures, and what a stage that freezes does within the deadline."""
        deadline = deadline_ms(self.gap_s)
        return {
            "sync": self.sync.as_json(),
            "measurement": self.measurement.as_json(),
            "drive": self.drive.as_json(),
            "ticks": self.ticks,
            "missed": self.missed,
            "lost": self.lost,
            "gap_max_us": round(self.gap_s * 1e6),
            "deadline_ms": deadline,
            "stage": None if deadline is None else frozen_stage(deadline).as_json(),
        }

    @property
    def can_ids(self) -> frozenset[int]:
        """Identifiers of the frames that it is made from."""
        return frozenset({SYNC_ID, *self._ticks_of})

    def feed(self, time: float, frame: Frame) -> None:
        """Take a frame with its time stamp in s, in the order of the bus; others are ignored."""
        if frame.rtr:
            return
        if frame.can_id == SYNC_ID:
            self._on_sync(time)
        elif frame.can_id in self._ticks_of:
            handler, at = self._ticks_of[frame.can_id]
            if len(frame.data) > at:
                handler(time, frame.data[at])

    @property
    def _span(self) -> int:
        return 0 if self._cycle is None else round((self._cycle.sync - self._begun) / TICK)

    def _on_sync(self, time: float) -> None:
        in_turn = False
        if self._cycle is None:
            self._begun = time
        else:
            self._driven += self._cycle.driven
            in_turn = self._cycle.measurements == 1 and bool(self._unmeasured)
            self._note_delay(self._cycle, max(0.0, time - self._cycle.sync - TICK))
        # Who lags catches up soon: with one measurement to each SYNC, and a SYNC left over, that
        # one gets none any more.
        self._in_turn = self._in_turn + 1 if in_turn else 0
        if self._in_turn == _IN_TURN:
            self._unmeasured.clear()
        self._cycle = _Cycle(time)
        self._unmeasured.append(self._cycle)

    def _note_delay(self, last: _Cycle, late: float) -> None:
        """Count the delay of a SYNC, later on if there may be one between that was not heard."""
        if late < 0.5 * TICK:
            self.sync.add(late)
        elif not last.unheard:
            self._doubtful.append(late)

    def _on_first(self, _time: float, tick: int) -> None:
        self._first_tick = tick

    def _on_measurement(self, time: float, ahead: int) -> None:
        if self._cycle is None:
            return
        # The last tick of a measurement is ahead of the first by the number of the session.
        if self._first_tick is not None:
            self._session, self._first_tick = (ahead - self._first_tick) % _TICKS, None
        tick = (ahead - self._session) % _TICKS
        self._forget_unheard(tick)
        self._tick = tick
        self._cycle.measurements += 1
        if not self._unmeasured:
            self.lost += 1
            self._cycle.unheard = True
            self._drive_time = None
            return
        cycle = self._unanswered[tick] = self._unmeasured.popleft()
        self._tick_time = cycle.sync
        self.measurement.add(time - cycle.sync)

    def _forget_unheard(self, tick: int) -> None:
        """See by the tick count whether cycles seem to be missed that were only not heard.

        A SYNC without measurement and drive is missed: a plate that came late passes over it.
        """
        assert self._cycle is not None
        unheard = 0 if self._tick is None else (tick - self._tick - 1) % _TICKS
        most = round((self._cycle.sync - self._tick_time) / TICK) - 1
        lost = 0
        # A run that starts anew jumps as well, but seldom by no more than the time allows.
        if 0 < unheard <= most:
            unheard += (most - unheard) // _TICKS * _TICKS
            waiting = min(unheard, len(self._unmeasured) - 1)
            for _ in range(waiting):
                self._unmeasured.popleft()
            passed_over = max(0, waiting - self._unmatched)
            lost = unheard - passed_over
        if lost:
            self.lost += lost
            self._drive_time = None
        else:
            for late in self._doubtful:
                self.sync.add(late)
        self._doubtful.clear()
        self._unmatched = 0

    def _on_drive(self, time: float, tick: int) -> None:
        cycle = self._unanswered.pop(tick, None)
        # What was never answered had the same count 256 ticks ago.
        if cycle is None or time - cycle.sync > 0.5 * _TICKS * TICK:
            self._unmatched += 1
            return
        cycle.driven = True
        self.drive.add(time - cycle.sync)
        if self._drive_time is not None:
            self._gap_s = max(self._gap_s, time - self._drive_time)
        self._drive_time = time


def deadline_ms(gap_s: float) -> int | None:
    """Return the deadline that a machine can promise, None if that is too long to be of use.

    Parameters
    ----------
    gap_s
        Longest time between two drives in s; the deadline is by `DEADLINE_RULE`.
    """
    deadline = max(DEADLINE_MIN_MS, ceil(_MARGIN * gap_s * 1e3))
    return deadline if deadline <= DEADLINE_MAX_MS else None


def _place(plate: ObjectDictionary, mapping: int, direction: Direction, name: str) -> int:
    """Return at which byte of a PDO an object of one byte is."""
    entries = compile_mapping(plate, mapping, direction).entries
    names = [entry.name for entry in entries]
    return sum(entry.size for entry in entries[: names.index(name)])


_CURVES: Final = {
    "sync": "SYNC later than 1 ms after the last",
    "measurement": "measurement after SYNC",
    "drive": "drive after SYNC",
}
_BINS: Final = 120
_MS_PER_US: Final = 1e-3


def histogram(timing: LoopTiming) -> Figure:
    """Draw how often SYNC, measurement and drive came how late, the counts logarithmic.

    Parameters
    ----------
    timing
        Of a loop that ran.
    """
    from smarttac_can.bench.drawing import GREEN, INK, PALE, RED, canvas  # noqa: PLC0415 - an extra

    styles = {"sync": (PALE, ":"), "measurement": (GREEN, "--"), "drive": (RED, "-")}
    curves: dict[str, Delays] = {name: getattr(timing, name) for name in _CURVES}
    longest = max(delays.quantile_us(1.0) for delays in curves.values())
    edges = np.linspace(0, longest + 1, _BINS + 1)
    with canvas(7.2, 4.6) as figure:
        axes = figure.subplots()
        for name, delays in curves.items():
            counts, _ = np.histogram(
                list(delays.counts), edges, weights=list(delays.counts.values())
            )
            colour, line = styles[name]
            label = f"{_CURVES[name]}, at most {delays.quantile_us(1.0) * _MS_PER_US:.2f} ms"
            axes.stairs(
                counts,
                edges * _MS_PER_US,
                linewidth=1.8,
                color=colour,
                linestyle=line,
                label=label,
            )
        axes.set_yscale("log")
        axes.set(xlim=(0, (longest + 1) * _MS_PER_US), ylim=(0.7, None))
        axes.set_title(f"Delays in {timing.ticks} ticks of the loop, {timing.missed} missed")
        axes.set_xlabel("delay (ms)")
        axes.set_ylabel("ticks")
        axes.legend(loc="upper right", labelcolor=INK)
    return figure
