"""Which rows the fault matrix has: each fault with each way to drive that it is injected in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from smarttac_can.trials.fault_case import DRIVING, FaultCase
from smarttac_can.trials.fault_cases import CASES, TOLERATED
from smarttac_can.trials.fault_row import mode_name
from smarttac_can.trials.weak_pickup import NOT_SEEN
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.watchdogs import Watchdog

Row = tuple[FaultCase, Mode]
_HUNTS = "the loop hunts in frequency, so that the wrong phase does not last; the lack comes again"
_FIRST: Final[Mapping[str, tuple[Watchdog, str]]] = {
    "pick-up d at 0.1, tracked": (Watchdog.PICKUP, _HUNTS),
    "pick-up d at 0.2, tracked": (Watchdog.PICKUP, _HUNTS),
}
"""What trips first under the predictive laws, and why, where it is another one than under the
paper's."""


def _predicted(given: Sequence[FaultCase]) -> tuple[FaultCase, ...]:
    """Return the cases whose course a controller shapes, in mode FRICTION under predictive laws."""
    found = []
    for case in given:
        if not case.through_loop or Mode.FRICTION not in case.modes or case.plate_inside:
            continue
        watchdog, why = _FIRST.get(case.name, (case.trips(Mode.FRICTION), ""))
        instead = {} if watchdog is None else {Mode.FRICTION: watchdog}
        found.append(
            case._replace(modes=(Mode.FRICTION,), predictive=True, instead=instead, why=why)
        )
    return tuple(found)


PREDICTED: Final = _predicted(CASES)
"""Faults that act through the loop, under the predictive laws."""
WAYS: Final = (*map(mode_name, DRIVING), PREDICTED[0].way(Mode.FRICTION))
"""Names of the ways to drive: the modes, and the predictive laws."""


def _rows(given: Sequence[FaultCase]) -> tuple[Row, ...]:
    return tuple((case, mode) for case in given for mode in case.modes)


_ADDS_UP: Final = frozenset({"pick-up at 0.5", "pick-up d at 0.5"})
"""What predictive laws let be seen: half the gain is at the bound, and a turn, which brings the
vibration to 0 under others, does not interrupt the cycles beyond it."""
ALL_NOT_SEEN: Final = _rows(
    (*NOT_SEEN, *_predicted([case for case in NOT_SEEN if case.name not in _ADDS_UP]))
)
"""Every fault that is not seen, with every mode."""
ALL_TOLERATED: Final = _rows((*TOLERATED, *_predicted(TOLERATED)))
"""Every fault that must not end a run, with every mode."""


def cases(faults: Sequence[str] = (), ways: Sequence[str] = ()) -> list[Row]:
    """Return every fault with every mode it is injected in.

    Parameters
    ----------
    faults, ways
        Names of faults and of ways to drive, to keep; all if empty.

    Raises
    ------
    ValueError
        If there is no such fault, or it is injected in none of these ways.
    """
    known = {case.name for case in CASES}
    for name in faults:
        if name not in known:
            raise ValueError(f"fault {name!r} is none of {', '.join(sorted(known))}")
    chosen = [
        (case, mode)
        for case, mode in _rows((*CASES, *PREDICTED))
        if (not faults or case.name in faults) and (not ways or case.way(mode) in ways)
    ]
    found = {case.name for case, _ in chosen}
    absent = " or ".join(repr(name) for name in faults if name not in found)
    if absent or not chosen:
        what = f"fault {absent} is not" if absent else "no fault is"
        raise ValueError(f"{what} injected in mode {' or '.join(ways)}")
    return chosen
