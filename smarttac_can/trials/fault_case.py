"""What a fault of the fault matrix is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from smarttac_can.trials.fault_acts import Act
from smarttac_can.trials.fault_row import mode_name
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.faults import PICKUP, PICKUP_D, PICKUP_Q, SENSOR_KINDS, FaultKind
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.watchdogs import Watchdog

DRIVING: Final = (
    Mode.OPEN_LOOP,
    Mode.AMPLITUDE,
    Mode.AMPLITUDE_RESONANCE,
    Mode.FRICTION,
    Mode.IDENTIFY,
    Mode.TEXTURE,
)
"""Modes with a voltage."""
TRACKED: Final = (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION, Mode.TEXTURE)
"""Modes in which the frequency follows the resonance."""
REGULATED: Final = tuple(mode for mode in DRIVING if mode is not Mode.IDENTIFY)
"""Modes that do not end by themselves."""
RING_DOWN_CYCLES: Final = 3
"""Time constants of the plate, 1 ms each, until 5 % of its vibration is left."""
_PICKUPS: Final = (PICKUP, PICKUP_D, PICKUP_Q)


Shows = Callable[[Rig], bool]
"""Whether a fault can be noticed in a cycle."""


def visible(volts: float = 20.0, up_to_N: float = inf) -> Shows:
    """Return what tells whether a fault is sure to be noticed.

    Parameters
    ----------
    volts
        Voltage of the stage from which it is. By default the lowest at which any plate vibrates
        enough to be judged; below it, as where a friction loop pauses, a fault is delayed.
    up_to_N
        Normal force in N up to which it is: a finger that presses harder may explain the fault by
        what it damps, or by friction.
    """
    return lambda rig: rig.stage.si_value >= volts and rig.plate_block.plate.Fn <= up_to_N


class FaultCase(NamedTuple):
    """One fault."""

    name: str
    bound: int
    """Cycles from the injection to the detection."""
    watchdog: Watchdog | None
    """What trips first in the stimulator; None if nothing does, as it restarts or is paused."""
    inject: Act
    remove: Act
    modes: tuple[Mode, ...] = DRIVING
    instead: Mapping[Mode, Watchdog] = MappingProxyType({})
    """What trips before `watchdog` in some modes, whose loops answer a wrong reading otherwise."""
    prepare: Act | None = None
    """What the fault needs before the run."""
    plate_inside: bool = False
    forgets: bool = False
    """Whether the stimulator starts anew, and so obeys the master again without a fault reset."""
    deaf: bool = False
    """Whether a node cannot hear or act, so that it may go on driving until its plate notices."""
    breaks_stage: bool = False
    """Whether the power stage ignores what is asked for."""
    breaks_controller: bool = False
    """Whether the controllers themselves are replaced."""
    cut_off: bool = False
    """Whether what the stimulator says is lost with the bus."""
    shows: Shows | None = None
    """Tells whether it can be noticed in a cycle; None if it can in each."""
    adds_up: bool = True
    """Whether cycles in which it shows add up, as in a leaky bucket; else they are in a row."""
    hides_vibration: bool = False
    """Whether the pick-up is broken, so that the plate may vibrate too much until that is seen."""

    detunes: bool = False
    """Whether it may lead a resonance loop astray, whose wrong phase then ends the run later."""
    through_loop: bool = False
    """Whether a controller that runs shapes its course, by what it makes of what it measures."""
    predictive: bool = False
    """Whether both laws are the predictive ones, and not those of the paper."""
    why: str = ""
    """Why another watchdog is first than the one of the name."""
    uncovered: str = ""
    """Why no software can act, where none can; the bound then counts from where it goes on."""

    def trips(self, mode: Mode) -> Watchdog | None:
        """Return what trips first in a mode."""
        return self.instead.get(mode, self.watchdog)

    def way(self, mode: Mode) -> str:
        """Name the way to drive: a mode, and the laws where they are not those of the paper."""
        return mode_name(mode) + ("_predictive" if self.predictive else "")


def broken(
    name: str,
    bound: int,
    watchdog: Watchdog,
    kind: FaultKind,
    sensor: int = 1,
    value: int = 0,
    **more: Any,
) -> FaultCase:
    """Return the case of a fault of the simulated plate; the further ones are of `FaultCase`."""

    def inject(rig: Rig) -> None:
        rig.inject(kind, sensor, value)

    hides = kind in SENSOR_KINDS and sensor in _PICKUPS
    return FaultCase(
        name, bound, watchdog, inject, Rig.mend, hides_vibration=hides, through_loop=True, **more
    )
