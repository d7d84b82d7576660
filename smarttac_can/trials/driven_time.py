"""How long a rig has driven, by mode and by law."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from enum import IntEnum
from typing import Final

from smarttac_can.trials.fault_case import DRIVING
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.modes import Law, Mode, VibrationLaw

_BY_AMPLITUDE: Final = frozenset(
    {Mode.FRICTION, Mode.TEXTURE, Mode.AMPLITUDE, Mode.AMPLITUDE_RESONANCE}
)
"""Modes in which a vibration law acts."""
_S_PER_CYCLE: Final = 1e-3


class DrivenTime:
    """Cycles with a voltage.

    Parameters
    ----------
    rig
        Whose object dictionary says which laws are chosen.
    """

    def __init__(self, rig: Rig) -> None:
        self._law = rig.od["Friction law"]
        self._vibration_law = rig.od["Controller.Vibration law"]
        self._cycles: Counter[tuple[Mode, int, int]] = Counter()

    def count(self, mode: Mode) -> None:
        """Count a cycle with a voltage in a mode, under the laws that are chosen now."""
        self._cycles[mode, self._law.value, self._vibration_law.value] += 1

    def by_mode(self) -> dict[str, float]:
        """Return seconds by the name of the mode, for every mode that drives."""
        return self._seconds(DRIVING, lambda mode, _law, _vibration: mode)

    def by_friction_law(self) -> dict[str, float]:
        """Return seconds by the name of the friction law, of mode friction: no other asks one."""
        return self._seconds(Law, lambda mode, law, _: law if mode is Mode.FRICTION else None)

    def by_vibration_law(self) -> dict[str, float]:
        """Return seconds by the name of the vibration law, of the modes in which one acts."""
        return self._seconds(
            VibrationLaw, lambda mode, _, law: law if mode in _BY_AMPLITUDE else None
        )

    def _seconds(
        self, kinds: Iterable[IntEnum], of: Callable[[Mode, int, int], int | None]
    ) -> dict[str, float]:
        total: Counter[int | None] = Counter()
        for key, cycles in self._cycles.items():
            total[of(*key)] += cycles
        return {kind.name.lower(): round(total[kind] * _S_PER_CYCLE, 3) for kind in kinds}
