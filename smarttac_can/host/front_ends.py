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
"""Entry points by which packages name their front ends: classes called without arguments."""
_METHODS: Final = ("put_out", "sample", "close")
_LOOK_S: Final = 0.02
HUNG_LOOKS: Final = 5
"""Looks at the same call, 20 ms apart, after which it hangs. Looks, and not time: of a process that
the system held up they are one."""
_LAST_WORD_S: Final = 0.1


def no_clock() -> int:
    """Return 0, always: no time passes but by SYNC."""
    return 0


class FrontEndError(Exception):
    """There is no such front end, or it does not open."""


def find_front_end(name: str) -> Callable[[], Plate]:
    """Return the class of a front end.

    Parameters
    ----------
    name
        That of an entry point of the group ``smarttac_can.front_ends``, or ``module:Class``.

    Raises
    ------
    FrontEndError
        If there is none of that name, or it cannot be imported.
    """
    found = {point.name: point.value for point in entry_points(group=GROUP)}
    target = found.get(name, name)
    module, colon, attribute = target.partition(":")
    if not (module and colon and attribute):
        known = ", ".join(sorted(found)) or "none is installed"
        raise FrontEndError(f"no front end {name!r} ({known}); it may also be module:Class")
    try:
        made: Callable[[], Plate] = getattr(import_module(module), attribute)
    except Exception as error:  # a module raises what it likes
        raise FrontEndError(f"cannot import front end {target}: {error}") from error
    return made


@contextmanager
def opened_front_end(name: str, *, by_clock: bool) -> Iterator[TimedFrontEnd]:
    """Open a front end, and close it on every way out; if a call hangs, the process ends.

    Parameters
    ----------
    name
        As for `find_front_end`.
    by_clock
        Whether calls are timed; in lockstep only SYNC is time.

    Raises
    ------
    FrontEndError
        If it cannot be found, does not open or close, or has not the methods of a `Plate`.
    """
    make = find_front_end(name)
    try:
        plate = make()
    except Exception as error:  # a driver raises what it likes
        raise FrontEndError(f"front end {name} does not open: {error}") from error
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
    """A front end whose calls are timed, and counted so that one that hangs is seen.

    Parameters
    ----------
    plate
        The front end.
    clock
        Time in ns that only goes on; without one no call takes any.

    Attributes
    ----------
    took_us
        How long the last call took.
    calls
        Calls begun and ended: odd while one goes on.
    last
        The drive that was put out last.
    """

    def __init__(self, plate: Plate, clock: Callable[[], int] = no_clock) -> None:
        self._plate = plate
        self._clock = clock
        self.took_us = 0
        self.calls = 0
        self.last = Drive(0.0, 0.0)

    def put_out(self, drive: Drive) -> float:
        """Put a drive out, as of a `Plate`."""
        self.last = drive
        with self._timed():
            return self._plate.put_out(drive)

    def sample(self) -> Measurement | None:
        """Return what is measured now, as of a `Plate`."""
        with self._timed():
            return self._plate.sample()

    def close(self) -> None:
        """Let go of the hardware, as of a `Plate`."""
        with self._timed():
            self._plate.close()

    def last_word(self) -> None:
        """Ask for 0 V beside a call that hangs."""
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
    except Exception as error:  # a driver raises what it likes
        raise FrontEndError(f"front end {name} does not close: {error}") from error


def _watch(name: str, plate: TimedFrontEnd, over: Event) -> None:
    """Look at the calls again and again; end the process when one hangs."""
    seen, looks = 0, 0
    while not over.wait(_LOOK_S):
        calls = plate.calls
        looks = looks + 1 if calls == seen and calls % 2 else 0
        seen = calls
        if looks >= HUNG_LOOKS:
            _end(name, plate)


def _end(name: str, plate: TimedFrontEnd) -> None:
    """Ask for 0 V in a thread of its own, which may hang as well, and end the process."""
    last = Thread(target=plate.last_word, daemon=True)
    last.start()
    last.join(_LAST_WORD_S)
    answer = "0 V was asked for" if not last.is_alive() else "nor does it take 0 V"
    sys.stderr.write(f"Error: front end {name} hangs in a call: ended, {answer}\n")
    sys.stderr.flush()
    os._exit(1)
