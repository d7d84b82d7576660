"""Front ends for real hardware: found by name, timed, and ended when they hang."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.metadata import entry_points
from threading import Event, Thread
from time import monotonic_ns
from typing import Final

from smarttac_can.host.background import Background
from smarttac_can.vocabulary.plate import Plate
from smarttac_can.vocabulary.signals import Drive, Measurement

GROUP: Final = "smarttac_can.front_ends"
"""Group of entry points with which packages name their front ends: classes without arguments."""
_METHODS: Final = ("put_out", "sample", "close")
_LOOK_S: Final = 0.02
HUNG_LOOKS: Final = 5
"""Checks of the same call, 20 ms apart, after which it counts as hanging. Checks are counted, not
time, because a pause of the whole process is only one check."""
_LAST_WORD_S: Final = 0.1


def no_clock() -> int:
    """Return 0: no time passes between two SYNCs."""
    return 0


class FrontEndError(Exception):
    """The front end does not exist, or cannot be opened."""


def find_front_end(name: str) -> Callable[[], Plate]:
    """Return the class of a front end.

    Parameters
    ----------
    name
        Entry point of the group ``smarttac_can.front_ends``, or ``module:Class``.

    Raises
    ------
    FrontEndError
        If there is no such front end, or it cannot be imported.
    """
    found = {point.name: point.value for point in entry_points(group=GROUP)}
    target = found.get(name, name)
    module, colon, attribute = target.partition(":")
    if not (module and colon and attribute):
        known = ", ".join(sorted(found)) or "none is installed"
        raise FrontEndError(f"no front end {name!r} ({known}); it may also be module:Class")
    try:
        made: Callable[[], Plate] = getattr(import_module(module), attribute)
    except Exception as error:  # a module may raise any error
        raise FrontEndError(f"cannot import front end {target}: {error}") from error
    return made


@contextmanager
def opened_front_end(name: str, *, by_clock: bool) -> Iterator[TimedFrontEnd]:
    """Open a front end, and always close it at the end; if a call hangs, end the process.

    Parameters
    ----------
    name
        Name, as for `find_front_end`.
    by_clock
        Whether calls are timed; in lockstep time passes only by SYNC.

    Raises
    ------
    FrontEndError
        If it is not found, cannot be opened or closed, or lacks methods of a `Plate`.
    """
    make = find_front_end(name)
    try:
        plate = make()
    except Exception as error:  # a driver may raise any error
        raise FrontEndError(f"front end {name} cannot be opened: {error}") from error
    missing = [m for m in _METHODS if not callable(getattr(plate, m, None))]
    if missing:
        raise FrontEndError(f"front end {name} has no {', '.join(missing)}")
    timed = TimedFrontEnd(plate, monotonic_ns if by_clock else no_clock)
    over = Event()
    with Background("front end", partial(_watch, name, timed, over), over.set):
        try:
            yield timed
        finally:
            _close(name, timed)


class TimedFrontEnd:
    """A front end whose calls are timed, and counted to detect a call that hangs.

    Parameters
    ----------
    plate
        Front end.
    clock
        Function that returns a monotonic time in ns; by default calls take no time.

    Attributes
    ----------
    took_us
        Duration of the last call in us.
    calls
        Number of begins and ends of calls: odd during a call.
    last
        Last drive that was put out.
    """

    def __init__(self, plate: Plate, clock: Callable[[], int] = no_clock) -> None:
        self._plate = plate
        self._clock = clock
        self.took_us = 0
        self.calls = 0
        self.last = Drive(0.0, 0.0)

    def put_out(self, drive: Drive) -> float:
        """Put a drive out, as a `Plate` does."""
        self.last = drive
        with self._timed():
            return self._plate.put_out(drive)

    def sample(self) -> Measurement | None:
        """Return the present measurement, as a `Plate` does."""
        with self._timed():
            return self._plate.sample()

    def close(self) -> None:
        """Release the hardware, as a `Plate` does."""
        with self._timed():
            self._plate.close()

    def last_word(self) -> None:
        """Request 0 V while another call hangs."""
        self._plate.put_out(Drive(0.0, self.last.frequency))

    @contextmanager
    def _timed(self) -> Iterator[None]:
        began = self._clock()
        self.calls += 1
        try:
            yield
        finally:
            self.calls += 1
            self.took_us = (self._clock() - began) // 1000


def _close(name: str, plate: TimedFrontEnd) -> None:
    try:
        plate.close()
    except Exception as error:  # a driver may raise any error
        raise FrontEndError(f"front end {name} does not close: {error}") from error


def _watch(name: str, plate: TimedFrontEnd, over: Event) -> None:
    """Check the calls periodically; end the process if one hangs."""
    seen, looks = 0, 0
    while not over.wait(_LOOK_S):
        calls = plate.calls
        looks = looks + 1 if calls == seen and calls % 2 else 0
        seen = calls
        if looks >= HUNG_LOOKS:
            _end(name, plate)


def _end(name: str, plate: TimedFrontEnd) -> None:
    """Request 0 V in a separate thread, which may hang as well, and end the process."""
    last = Thread(target=plate.last_word, daemon=True)
    last.start()
    last.join(_LAST_WORD_S)
    answer = "0 V was asked for" if not last.is_alive() else "nor does it take 0 V"
    sys.stderr.write(f"Error: front end {name} hangs in a call: ended, {answer}\n")
    sys.stderr.flush()
    os._exit(1)
