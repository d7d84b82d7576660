"""Invariants of every cycle, and the check whether the plate gave cause for a trip."""

from __future__ import annotations

from collections import deque
from itertools import cycle
from math import isfinite
from typing import Final, Protocol

from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.science.plant.parameters import SensorParameters
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import AMPLITUDE_CYCLES, FORGOTTEN, Watchdog

AFTERGLOW_CYCLES: Final = 5
"""Cycles until the vibration has decayed."""
UNDRIVEN_CYCLES: Final = 5
"""Cycles outside of RUNNING until the power stage is at 0 V, also over the bus."""
_ENTRIES_PER_CYCLE: Final = 4
_RUNNING: Final = State.RUNNING
MOST_VIOLATIONS: Final = 20
"""Largest number of violations that are stored."""


class Invariants:
    """Check a rig with a plate node after every cycle.

    Parameters
    ----------
    rig
        Rig to check. It is read by function calls, not over the bus, so the checks change nothing.

    Attributes
    ----------
    violations
        Violated invariants, a line each; no more than 20 are stored.
    violated
        Number of all violations.
    stage_is_broken
        Whether the power stage ignores the commanded voltage; its voltage is then not checked.
    deaf
        Whether a node cannot receive or act, so that it may drive until the plate detects it.
    hidden_cycles
        Cycles for which a faulty pick-up may hide that the plate vibrates too much.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._plate_block = rig.plate_block
        self._machine = rig.stimulator.block.supervisor
        od = rig.od
        self._drive = od["Drive.Voltage"]
        self._limit = od["Limit.Voltage"]
        self._trip = od["Limit.Amplitude trip"]
        entries = [
            entry
            for dictionary in (od, rig.plate_block.od)
            for entry in dictionary
            if isinstance(entry.default, int) and entry.low < entry.high
        ]
        self._rolling = cycle([(entry.reader, entry) for entry in entries])
        self._tick = rig.plate_block.tick
        self._last_tick = -1
        self._high_for = 0
        self._undriven_for = 0
        self.violations: list[str] = []
        self.violated = 0
        self.stage_is_broken = False
        self.deaf = False
        self.hidden_cycles = 0

    def check(self) -> None:
        """Check a cycle; the ranges of objects are checked a few at a time."""
        rig = self._rig
        volts = rig.stage.si_value
        most = self._limit.si_value
        if not 0.0 <= volts <= most and not self.stage_is_broken:
            self.violate(f"{volts:g} V at the power stage, limit {most:g} V")
        asked = self._drive.si_value
        if not 0.0 <= asked <= most:
            self.violate(f"a drive of {asked:g} V, limit {most:g} V")
        plate = self._plate_block.plate
        W = abs(plate.W)
        if not isfinite(W + plate.temperature + plate.Ft + plate.Fn):
            self.violate("a state of the plate is not finite")
        # Without ticks the simulated plate does not move, so its vibration does not decay at 0 V.
        tick, self._last_tick = self._last_tick, self._tick.value
        if self._last_tick != tick:
            self._high_for = self._high_for + 1 if self._trip.si_value < W else 0
        if self._high_for > AMPLITUDE_CYCLES + AFTERGLOW_CYCLES + self.hidden_cycles:
            self.violate(f"an amplitude of {W * 1e6:.2f} um for {self._high_for} cycles")
        if self._machine.state is _RUNNING or self.deaf or not rig.stage.read():
            self._undriven_for = 0
        else:
            self._undriven_for += 1
            if self._undriven_for > UNDRIVEN_CYCLES:
                self.violate(f"{volts:g} V in state {self._machine.state.name.lower()}")
        for _ in range(_ENTRIES_PER_CYCLE):
            read, entry = next(self._rolling)
            value = read()
            if not entry.low <= value <= entry.high:
                self.violate(f"{entry.name} is {value}, outside {entry.low}..{entry.high}")

    def clear_history(self) -> None:
        """Clear the error histories, and restart their comparison with the emergency messages."""
        rig = self._rig
        for node_id, od in ((STIMULATOR_ID, rig.od), (PLATE_ID, rig.plate_block.od)):
            rig.master.write(node_id, od.entry(cia.ERROR_FIELD), 0)
        del rig.emergencies[:]

    def check_history(self) -> None:
        """Compare the error histories with the messages since `clear_history`, entry by entry."""
        rig = self._rig
        for node_id, od in ((STIMULATOR_ID, rig.od), (PLATE_ID, rig.plate_block.od)):
            sent = [emcy.code for emcy in rig.emergencies if emcy.node_id == node_id and emcy.code]
            kept = [entry.value & 0xFFFF for entry in history(od)]
            newest = sent[::-1][: len(od.objects[cia.ERROR_FIELD].entries) - 1]
            if kept != newest:
                self.violate(f"node {node_id} sent {_hex(newest)}, its history is {_hex(kept)}")

    def violate(self, what: str) -> None:
        """Record a violation."""
        self.violated += 1
        if len(self.violations) < MOST_VIOLATIONS:
            self.violations.append(f"cycle {self._rig.cycles}: {what}")


def history(od: ObjectDictionary) -> list[Entry]:
    """Return the used entries of a node's error history, the newest first."""
    places = od.objects[cia.ERROR_FIELD].entries
    return [places[subindex] for subindex in range(1, places[0].value + 1)]


def _hex(codes: list[int]) -> str:
    return "[" + " ".join(f"{code:04X}" for code in codes) + "]"


_NOISE_M: Final = 10e-9
"""Largest error of a pick-up in m: ten times its noise."""


class Driven(Protocol):
    """A stimulator with its plate, such as a `Rig`."""

    plate_block: PlateBlock
    od: ObjectDictionary
    """Object dictionary of the stimulator."""
    cycles: int
    """Number of cycles so far."""


class TripCause:
    """Record the last cycles in which the true vibration exceeded its limit or the pick-up's range.

    A watchdog trips after n faulty cycles in a row, or after more of them with gaps: at least n of
    the last 20 n cycles are then faulty.

    Parameters
    ----------
    rig
        Rig whose true vibration over the pick-up's window is checked, not its reading.
    """

    def __init__(self, rig: Driven) -> None:
        self._rig = rig
        self._block = rig.plate_block
        self._trip = rig.od["Limit.Amplitude trip"]
        sensors = SensorParameters()
        self._end = sensors.full_scale * sensors.pickup_resolution - _NOISE_M
        self._above: deque[int] = deque(maxlen=5)
        self._beyond: deque[int] = deque(maxlen=6)

    def look(self) -> None:
        """Check the vibration of a cycle."""
        W = self._block.plate.seen_W
        trip = self._trip
        if abs(W) > trip.value * trip.si - _NOISE_M:
            self._above.append(self._rig.cycles)
            if max(abs(W.real), abs(W.imag)) > self._end:
                self._beyond.append(self._rig.cycles)

    def of(self, latched: int) -> str | None:
        """Return the cause of a trip in this cycle; None if a latched watchdog has no cause.

        Parameters
        ----------
        latched
            Watchdogs that have tripped, as bits, 1 << `Watchdog`.
        """
        causes = {
            1 << Watchdog.AMPLITUDE: ("vibration above its limit", self._above),
            1 << Watchdog.SATURATED: ("vibration beyond the range of its pick-up", self._beyond),
        }
        shown = [
            (bit, text) for bit, (text, cycles) in causes.items()
            if latched & bit and self._lasted(cycles)
        ]  # fmt: skip
        if not latched or latched != sum(bit for bit, _ in shown):
            return None
        return ", ".join(text for _, text in shown)

    def _lasted(self, cycles: deque[int]) -> bool:
        most = cycles.maxlen or 0
        return len(cycles) == most and self._rig.cycles - cycles[0] < FORGOTTEN * most
