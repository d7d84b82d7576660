"""A pick-up that has lost gain: what of it is seen, and what is not."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Final

from smarttac_can.trials.fault_case import (
    REGULATED,
    RING_DOWN_CYCLES,
    TRACKED,
    FaultCase,
    broken,
    visible,
)
from smarttac_can.vocabulary.faults import PICKUP, PICKUP_D, PICKUP_Q, FaultKind
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.watchdogs import LACK_CYCLES, RESONANCE_CYCLES, Watchdog

_PER_MILLE: Final = 1000
_NAMES: Final = {PICKUP: "pick-up", PICKUP_D: "pick-up d", PICKUP_Q: "pick-up q"}
LACK_BOUND: Final = 2 * LACK_CYCLES + RING_DOWN_CYCLES
"""A friction loop that pauses interrupts a lack, but not for longer."""
_EXPLAINED_N: Final = 0.6
"""Force in N above which a finger that damps much explains what one that damps little, under a
pick-up at 0.4, shows."""
_FIXED: Final = (Mode.OPEN_LOOP, Mode.AMPLITUDE)
_BY_FRICTION: Final = (Mode.FRICTION,)
"""Elsewhere half the gain is at the bound of what is seen: cycles beyond it add up in the end."""


def _weak(
    sensor: int,
    per_mille: int,
    modes: tuple[Mode, ...] = REGULATED,
    up_to_N: float = inf,
) -> FaultCase:
    name = f"{_NAMES[sensor]} at {per_mille / _PER_MILLE:g}"
    return broken(
        name, LACK_BOUND, Watchdog.PICKUP, FaultKind.GAIN, sensor, per_mille,
        modes=modes, shows=visible(up_to_N=up_to_N), detunes=sensor == PICKUP_D,
    )  # fmt: skip


def _detuned(per_mille: int, instead: Mapping[Mode, Watchdog]) -> FaultCase:
    """Return the loss of one axis whose wrong phase leads the resonance loop astray."""
    return broken(
        f"pick-up d at {per_mille / _PER_MILLE:g}, tracked", RESONANCE_CYCLES + LACK_BOUND,
        Watchdog.RESONANCE, FaultKind.GAIN, PICKUP_D, per_mille,
        modes=TRACKED, instead=instead, shows=visible(),
        why="the lack has lasted before the wrong phase" if instead else "",
    )  # fmt: skip


WEAK_PICKUP: Final = (
    _weak(PICKUP, 50),
    _weak(PICKUP, 100),
    _weak(PICKUP, 200),
    _weak(PICKUP, 300),
    _weak(PICKUP, 400, up_to_N=_EXPLAINED_N),
    _weak(PICKUP_D, 50, _FIXED),
    _weak(PICKUP_D, 100, _FIXED),
    _weak(PICKUP_D, 200, _FIXED),
    _detuned(50, {Mode.FRICTION: Watchdog.PICKUP}),
    _detuned(100, {}),
    _detuned(200, {}),
    _weak(PICKUP_D, 300),
    _weak(PICKUP_D, 400, up_to_N=_EXPLAINED_N),
)
"""Losses of gain that end a run."""
NOT_SEEN: Final = (
    _weak(PICKUP, 500, _BY_FRICTION),
    *(_weak(PICKUP, per_mille) for per_mille in (600, 700, 800, 900)),
    _weak(PICKUP_D, 500, _BY_FRICTION),
    *(_weak(PICKUP_D, per_mille) for per_mille in (600, 700, 800, 900)),
    *(_weak(PICKUP_Q, per_mille) for per_mille in (50, 300, 600, 900)),
)
"""Losses that a finger of unknown damping explains as well, or that the vibration does not show:
what is left when all is watched."""
