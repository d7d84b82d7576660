"""What the cycle has to go on doing, made anew from its cases whenever it is asked for.

`ticks_of_row` runs a row of the fault matrix with the trials of a package, and keeps what passed on
the bus and what the nodes knew in every cycle. `interleavings` are scripts for `world.World`: every
order in which a remapping, an NMT command and writes can come between cycles of a run. Nothing is
stored: the old package stands for what the corpus was.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any, Final, NamedTuple
from unittest.mock import patch

from frozen import Package
from pair import Difference, Side, show, side
from sabotages import BEGIN
from world import Act

from smarttac_can.trials.chosen_rows import cases
from smarttac_can.vocabulary.modes import Mode


class Tick(NamedTuple):
    """What passed in a cycle, and what the nodes knew at its end."""

    frames: list[tuple[int, bytes, bool]]
    """All that was on the bus."""
    names: tuple[str, ...]
    values: list[Any]
    """By these names, of all nodes in turn."""


class RowName(NamedTuple):
    """One row of the fault matrix."""

    fault: str
    mode: int
    predictive: bool

    def __str__(self) -> str:
        laws = ", predictive laws" if self.predictive else ""
        return f"{self.fault}, {Mode(self.mode).name.lower()}{laws}"


def rows() -> list[RowName]:
    """List every row that the fault matrix has in this tree."""
    return [RowName(case.name, int(mode), case.predictive) for case, mode in cases()]


def ticks_of_row(package: Package, row: RowName, hold: int) -> list[Tick]:
    """Run a row of the fault matrix with the trials and the nodes of a package.

    Parameters
    ----------
    package
        One of the two.
    row
        The row.
    hold
        Cycles for which the plate has to stay at 0 V.
    """
    matrix = package.module("trials.fault_matrix")
    mode = package.module("vocabulary.modes").Mode(row.mode)
    ticks: list[Tick] = []
    frames: list[tuple[int, bytes, bool]] = []

    class Log(matrix._Log):  # type: ignore[misc, name-defined]
        """Hears every frame."""

        def __call__(self, microseconds: int, frame: Any) -> None:
            frames.append(tuple(frame))
            super().__call__(microseconds, frame)

    class Rig(matrix.Rig):  # type: ignore[misc, name-defined]
        """Keeps what the nodes know after every cycle."""

        def __init__(self, **options: Any) -> None:
            super().__init__(**options)
            self.sides = [side(package, self.stimulator, "StimulatorNode")]
            if self.plate_port is not None:
                self.sides.append(side(package, self.plate, "PlateNode"))

        def cycle(self, count: int = 1) -> None:
            for _ in range(count):
                super().cycle(1)
                ticks.append(_tick(frames.copy(), self.sides))
                frames.clear()

    with patch.object(matrix, "_Log", Log), patch.object(matrix, "Rig", Rig):
        matrix._row_of(matrix._BY_NAME[row.fault, row.predictive], mode, hold, None)
    return ticks


def _tick(frames: list[tuple[int, bytes, bool]], sides: list[Side]) -> Tick:
    names: list[str] = []
    values: list[Any] = []
    for one in sides:
        for known in (one.state(one.node), one.services(one.device)):
            names += known
            # What is held is changed later.
            values += [_kept(value) for value in known.values()]
        names.append("levels")
        values.append(one.levels())
        names.append("od")
        values.append(one.values())
    return Tick(frames, _NAMES.setdefault(tuple(names), tuple(names)), values)


_NAMES: Final[dict[tuple[str, ...], tuple[str, ...]]] = {}
"""The same names for all ticks that have them."""


def _kept(value: Any) -> Any:
    if isinstance(value, list):
        return value.copy()
    return dict(value) if isinstance(value, dict) else value


def require_same(row: RowName, expected: list[Tick], found: list[Tick]) -> None:
    """Compare the ticks of a row, the first one that differs first.

    Raises
    ------
    Difference
        If they are not the same.
    """
    for number, (before, now) in enumerate(zip(expected, found, strict=False)):
        if before == now:
            continue
        where = f"{row}, cycle {number}"
        if before.frames != now.frames:
            raise Difference(where, "frames", _shown(before), _shown(now))
        if before.names != now.names:
            raise Difference(where, "names", before.names, now.names)
        for name, value, other in zip(now.names, before.values, now.values, strict=True):
            if value != other and repr(value) != repr(other):
                raise Difference(where, name, value, other)
    if len(expected) != len(found):
        raise Difference(f"{row}", "cycles", len(expected), len(found))


def _shown(tick: Tick) -> list[str]:
    return [show(frame) for frame in tick.frames]  # type: ignore[arg-type]


REMAPPING: Final[tuple[Act, ...]] = (
    ("write", 32, 0x1801, 1, 0xC00002A0),
    ("write", 32, 0x1A01, 0, 0),
    ("write", 32, 0x1A01, 1, 0x2021_0310),
    ("write", 32, 0x1A01, 0, 1),
    ("write", 32, 0x1801, 1, 0x400002A0),
)
"""Another mapping for TPDO 2, step by step."""
COMMANDS: Final[dict[str, tuple[Act, ...]]] = {
    "stop": (("nmt", 0x02, 32), ("nmt", 0x01, 32)),
    "pre-operational": (("nmt", 0x80, 32), ("nmt", 0x01, 32)),
    "reset communication": (("nmt", 0x82, 32), ("nmt", 0x01, 32)),
    "reset node": (("nmt", 0x81, 32), ("nmt", 0x01, 32)),
    "stop of the plate": (("nmt", 0x02, 33), ("nmt", 0x01, 33)),
    "disarm and arm": (("put", "Controlword", 0), ("drive", 3)),
    "limit and mode": (("put", "Limit.Voltage", 9000), ("put", "Mode", 2)),
    "store and restore": (("store", 32, 1, 0x65766173), ("store", 32, 1, 0x64616F6C, 0x1011)),
}
"""What comes between the steps of it."""


def interleavings() -> Iterator[tuple[str, list[Act]]]:
    """Yield every order of the steps of a remapping and of each pair of commands, in a run.

    Each order comes twice: with a cycle after each step, and with none.
    """
    size = len(REMAPPING)
    for name, commands in COMMANDS.items():
        for places in combinations(range(size + len(commands)), len(commands)):
            steps, others = iter(REMAPPING), iter(commands)
            merged = [
                next(others) if place in places else next(steps)
                for place in range(size + len(commands))
            ]
            for cycles in (0, 1):
                between: list[Act] = [("cycles", 1)] if cycles else []
                acts = [act for step in merged for act in (step, *between)]
                yield f"{name} at {places}, {cycles}", [*BEGIN, *acts, ("cycles", 4)]
