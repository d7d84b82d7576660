"""How near every watch came to a fault while nothing was broken."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from smarttac_can.trials.fault_row import mode_name
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.watchdogs import COUNTED, PLATE_COUNTED

Table = dict[str, dict[str, float]]
"""Largest levels by watch and mode; 1.0 is a fault, or 0 V at the plate."""

WHAT: Final = {
    "nmt": "event",
    "heartbeat": "silence, of the consumer time",
    "measurement": "time without one, of the deadline",
    "setpoint": "time without one, of the deadline; none is set in a soak",
    "sync_lost": "time without one, of the deadline",
    "sync_irregular": "too many or too few in a window, of what is a fault",
    "sync_counter": "event",
    "bus_off": "event",
    "transmit_queue": "event",
    "voltage": "drive, of the limit, to which the controllers keep",
    "amplitude": "cycles above the limit, of what is a fault",
    "temperature": "degC, of the limit",
    "normal_force": "force, of the limit",
    "lateral_force": "force, of the limit",
    "saturated": "cycles at the end of a range, of what is a fault",
    "stuck": "samples in a row that rest, of what is a fault",
    "gauges": "cycles with a contradiction, of what is a fault",
    "pickup": "cycles with too much, none or too little, of what is a fault",
    "resonance": "cycles off the resonance, of what is a fault",
    "controller": "event",
    "calibration": "event",
    "plate": "event",
    "double": "measurements beyond one a SYNC, of what is a fault; identifiers are events",
    "unseen": "cycles above the limit, of what is a fault",
    "missed_time": "missed ticks of a second, of the limit",
    "stage": "event",
    "not_enabled": "event",
    "plate_deadline": "time without a drive, of the deadline",
    "plate_wrong_checks": "drives with a wrong check, of what bars",
    "plate_temperature": "degC, of the limit",
    "plate_voltage": "drive, of the limit",
    "true_amplitude": "vibration of the plate, of the limit of amplitude",
    "bound_by_the_drive": "vibration that the drive may have made, of the limit of unseen",
}
"""Every watch, and what its level is; last the quantities behind two that count cycles."""
_LOOKED_AT: Final = (
    *(watchdog.name.lower() for watchdog in COUNTED),
    *(f"plate_{what.replace(' ', '_')}" for what in PLATE_COUNTED),
    "true_amplitude",
    "bound_by_the_drive",
)
_DIGITS: Final = 3


class Margins:
    """The largest levels of a rig with a plate node, mode by mode.

    Parameters
    ----------
    rig
        Whose nodes are asked, over calls.
    """

    def __init__(self, rig: Rig) -> None:
        self._stimulator = rig.stimulator
        self._plate = rig.plate
        self._supervisor = rig.stimulator.block.supervisor
        self._amplitude_trip = rig.od["Limit.Amplitude trip"]
        self._bound_trip = rig.od["Limit.Amplitude by drive"]
        self._mode = rig.od["Mode"]
        self._run: dict[int, tuple[float, ...]] = {}
        self._kept: dict[int, tuple[float, ...]] = {}

    def look(self) -> None:
        """Look at a cycle in which nothing is broken."""
        trip, most = self._amplitude_trip, self._bound_trip
        levels = (
            *self._stimulator.levels(),
            *self._plate.levels(),
            abs(self._plate.block.plate.W) / (trip.value * trip.si),
            abs(self._supervisor.watch.vibration.most) / (most.value * most.si),
        )
        _raise(self._run, self._mode.value, levels)

    def keep(self) -> None:
        """Keep what was seen since the last time."""
        for mode, levels in self._run.items():
            _raise(self._kept, mode, levels)
        self._run = {}

    def drop(self) -> None:
        """Forget what was seen since the last time: a watch did trip, and had cause to."""
        self._run = {}

    def table(self) -> Table:
        """Return what was kept."""
        return {
            name: {
                mode_name(Mode(mode)): round(levels[at], _DIGITS)
                for mode, levels in sorted(self._kept.items())
            }
            for at, name in enumerate(_LOOKED_AT)
        }


def _raise(peaks: dict[int, tuple[float, ...]], mode: int, levels: tuple[float, ...]) -> None:
    before = peaks.get(mode)
    peaks[mode] = levels if before is None else tuple(map(max, before, levels))


def largest(tables: Sequence[Table]) -> Table:
    """Return the largest levels of several tables, one or more."""
    modes = [
        name for mode in Mode if any((name := mode_name(mode)) in t["voltage"] for t in tables)
    ]
    return {
        name: {mode: max(t[name].get(mode, 0.0) for t in tables) for mode in modes}
        for name in _LOOKED_AT
    }


def margin_rows(table: Table) -> Iterator[tuple[str, ...]]:
    """Return the margins for readers, the head first: a watch, what its level is, and levels."""
    modes = list(table["voltage"])
    yield ("Watch", "Level", *(mode.replace("_", " ") for mode in modes))
    for name, what in WHAT.items():
        levels = [f"{table[name][mode]:.2f}" if name in table else "" for mode in modes]
        yield (name.replace("_", " "), what, *levels)
