"""Punctuality of the 1 kHz loop, from the time stamps of its frames on the bus."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, exp, log
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.mapping import Direction, compile_mapping
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.signals import TICK

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHORTEST_MS: Final = 3
"""Deadline in ms with which the dose is compared."""
_QUIET: Final = 0.05


class FrozenStage(NamedTuple):
    """A stage that freezes at a voltage, and a first-order plate at its resonance.

    With the final amplitude as 1, ``tau W' = 1 - W`` until the deadline ends it, then
    ``tau W' = -W``. All times are counted from the freezing.
    """

    deadline_ms: float
    """Deadline of the plate, long enough for 5 % of the final amplitude to be reached."""
    tau_ms: float
    """Time constant of the plate, above 0."""
    voltage_v: float
    final_um: float
    """Final amplitude peak-to-peak in um at this voltage."""

    @property
    def reached(self) -> float:
        """Fraction of the final amplitude that a plate at rest reaches, 0..1."""
        return 1.0 - exp(-self.deadline_ms / self.tau_ms)

    @property
    def quiet_ms(self) -> float:
        """Time in ms after which the amplitude of a plate at rest is below 5 % again."""
        return self.deadline_ms + self.tau_ms * log(self.reached / _QUIET)

    @property
    def dose_from_rest(self) -> float:
        """Integral of W^2 over time for a plate at rest, in ms; the final amplitude is 1."""
        return self.deadline_ms - self.tau_ms * self.reached

    @property
    def dose_from_final(self) -> float:
        """Integral of W^2 over time for a plate with the final amplitude, in ms."""
        return self.deadline_ms + 0.5 * self.tau_ms

    def as_json(self) -> dict[str, Any]:
        """Return the figures for JSON; doses are relative to that of the shortest deadline."""
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
    """Return the worst case within the default limits: highest voltage, at resonance."""
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
    "twice the longest time between two drives, rounded up to whole ms, and at least "
    f"{DEADLINE_MIN_MS} ms; if it is above {DEADLINE_MAX_MS} ms, there is no deadline"
)
_LAST_MEASUREMENT: Final = 3
"""Number of the TPDO of the plate that ends a measurement."""
_DRIVE: Final = 1
"""Number of the RPDO of the plate for drives."""
_IN_TURN: Final = 50
"""Alternations of SYNC and measurement after which neither can be a whole tick late."""
_TICKS: Final = 256
"""Modulus of the tick counts."""
_WAITING_MAX: Final = DEADLINE_MAX_MS


class Delays:
    """Histogram of delays in whole us, with exact quantiles."""

    def __init__(self) -> None:
        self.counts: Counter[int] = Counter()

    def add(self, seconds: float) -> None:
        """Count a delay in s, rounded to whole us."""
        self.counts[round(seconds * 1e6)] += 1

    def quantile_us(self, share: float) -> int:
        """Return the smallest delay in us that is not exceeded by a fraction, 0..1, of all delays.

        Raises
        ------
        ValueError
            If there are no delays.
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
    sync: float
    driven: bool = False
    measurements: int = 0
    """Number of measurements that ended before the next SYNC, for this or an earlier SYNC."""
    unheard: bool = False
    """Whether the listener has missed the SYNC of one of these measurements."""


class LoopTiming:
    """Statistics of the frames of the loop, from a listener that may be late or miss frames.

    A measurement belongs to the first SYNC that has none yet, a drive to the measurement with the
    same tick count. If the tick counts show that the listener has missed cycles, these count as
    lost, not as ticks or missed.

    Parameters
    ----------
    plate
        Object dictionary of the plate, loaded for its node-ID.

    Attributes
    ----------
    sync
        Delay of each SYNC against 1 ms after the one before; 0 if it was early.
    measurement
        Delay from SYNC to the TPDO that ends the measurement.
    drive
        Delay from SYNC to the drive that answers that measurement.
    lost
        Number of cycles that the listener has missed.
    """

    def __init__(self, plate: ObjectDictionary) -> None:
        self.sync = Delays()
        self.measurement = Delays()
        self.drive = Delays()
        self.lost = 0
        measurement = cia.TPDO_COMMUNICATION + _LAST_MEASUREMENT - 1
        drive = cia.RPDO_COMMUNICATION + _DRIVE - 1
        first_at = _place(plate, cia.TPDO_MAPPING, Direction.TRANSMIT, "Vibration.Tick")
        measured_at = _place(
            plate, cia.TPDO_MAPPING + _LAST_MEASUREMENT - 1, Direction.TRANSMIT, "Gauge tick"
        )
        driven_at = _place(plate, cia.RPDO_MAPPING + _DRIVE - 1, Direction.RECEIVE, "Drive.Tick")
        self._ticks_of: dict[int, tuple[Callable[[float, int], None], int]] = {
            plate.number(cia.TPDO_COMMUNICATION, cia.PDO_COB_ID) & cia.CAN_ID_MASK: (
                self._on_first,
                first_at,
            ),
            plate.number(measurement, cia.PDO_COB_ID) & cia.CAN_ID_MASK: (
                self._on_measurement,
                measured_at,
            ),
            plate.number(drive, cia.PDO_COB_ID) & cia.CAN_ID_MASK: (self._on_drive, driven_at),
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
        """Number of ticks of 1 ms between the first SYNC and the last, without lost ones."""
        return self._span - self.lost

    @property
    def missed(self) -> int:
        """Number of ticks without a SYNC, or whose drive came after the next SYNC."""
        return max(0, self._span - self._driven - self.lost)

    @property
    def gap_s(self) -> float:
        """Longest time between two drives in s, or from the last one to the last SYNC."""
        if self._cycle is None or self._drive_time is None:
            return self._gap_s
        return max(self._gap_s, self._cycle.sync - self._drive_time)

    @property
    def ran(self) -> bool:
        """Whether there were SYNCs, measurements and drives."""
        return all(delays.counts for delays in (self.sync, self.measurement, self.drive))

    def as_json(self) -> dict[str, Any]:
        """Return the figures for JSON, with the effect of a stage frozen within the deadline."""
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
        """Identifiers of the frames that are evaluated."""
        return frozenset({cia.SYNC_ID, *self._ticks_of})

    def feed(self, time: float, frame: Frame) -> None:
        """Evaluate a frame with its time stamp in s, in bus order; ignore other frames."""
        if frame.rtr:
            return
        if frame.can_id == cia.SYNC_ID:
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
        # Nodes that lag behind catch up soon. So after many SYNCs with one measurement each, a SYNC
        # that is still without one will not get it.
        self._in_turn = self._in_turn + 1 if in_turn else 0
        if self._in_turn == _IN_TURN:
            self._unmeasured.clear()
        self._cycle = _Cycle(time)
        self._unmeasured.append(self._cycle)

    def _note_delay(self, last: _Cycle, late: float) -> None:
        """Count the delay of a SYNC; keep a long one until a lost SYNC is ruled out."""
        if late < 0.5 * TICK:
            self.sync.add(late)
        elif not last.unheard:
            self._doubtful.append(late)

    def _on_first(self, _time: float, tick: int) -> None:
        self._first_tick = tick

    def _on_measurement(self, time: float, ahead: int) -> None:
        if self._cycle is None:
            return
        # The tick in the last TPDO of a measurement exceeds that in the first by the session
        # number.
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
        """Decide by the tick count whether cycles were missed by the nodes or only by the listener.

        A SYNC without measurement and drive is missed by the nodes: a late plate skips it.
        """
        assert self._cycle is not None
        unheard = 0 if self._tick is None else (tick - self._tick - 1) % _TICKS
        most = round((self._cycle.sync - self._tick_time) / TICK) - 1
        lost = 0
        # A restarted run jumps as well, but rarely by as few ticks as the time allows.
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
        # An unanswered measurement had the same count 256 ticks ago.
        if cycle is None or time - cycle.sync > 0.5 * _TICKS * TICK:
            self._unmatched += 1
            return
        cycle.driven = True
        self.drive.add(time - cycle.sync)
        if self._drive_time is not None:
            self._gap_s = max(self._gap_s, time - self._drive_time)
        self._drive_time = time


def deadline_ms(gap_s: float) -> int | None:
    """Return the deadline in ms for a machine, by `DEADLINE_RULE`; None if it is too long.

    Parameters
    ----------
    gap_s
        Longest time between two drives in s.
    """
    deadline = max(DEADLINE_MIN_MS, ceil(_MARGIN * gap_s * 1e3))
    return deadline if deadline <= DEADLINE_MAX_MS else None


def _place(plate: ObjectDictionary, mapping: int, direction: Direction, name: str) -> int:
    """Return the offset in a PDO of an object of one byte."""
    entries = compile_mapping(plate, mapping, direction).entries
    names = [entry.name for entry in entries]
    return sum(entry.size for entry in entries[: names.index(name)])


CURVES: Final = {
    "sync": "SYNC later than 1 ms after the last",
    "measurement": "measurement after SYNC",
    "drive": "drive after SYNC",
}
"""Names for people of the delays of a `LoopTiming`, by attribute."""
_BINS: Final = 120
_MS_PER_US: Final = 1e-3


def histogram(timing: LoopTiming) -> Figure:
    """Draw the histograms of the delays of SYNC, measurement and drive, with logarithmic counts.

    Parameters
    ----------
    timing
        Statistics of a loop that ran.
    """
    from smarttac_can.bench.drawing import GREEN, INK, PALE, RED, canvas  # noqa: PLC0415 - an extra

    styles = {"sync": (PALE, ":"), "measurement": (GREEN, "--"), "drive": (RED, "-")}
    curves: dict[str, Delays] = {name: getattr(timing, name) for name in CURVES}
    longest = max(delays.quantile_us(1.0) for delays in curves.values())
    edges = np.linspace(0, longest + 1, _BINS + 1)
    with canvas(7.2, 4.6) as figure:
        axes = figure.subplots()
        for name, delays in curves.items():
            counts, _ = np.histogram(
                list(delays.counts), edges, weights=list(delays.counts.values())
            )
            colour, line = styles[name]
            label = f"{CURVES[name]}, at most {delays.quantile_us(1.0) * _MS_PER_US:.2f} ms"
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
