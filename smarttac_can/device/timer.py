"""Device time: a count of microseconds that moves only when the device is told so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

NEVER: Final = 1 << 62


class Timer:
    """One timer of a clock, stopped at first.

    Attributes
    ----------
    due
        Device time in us at which it expires; `NEVER` while stopped.
    """

    __slots__ = ("_clock", "_expire", "_period", "due")

    def __init__(self, clock: Clock, expire: Callable[[], None]) -> None:
        self._clock = clock
        self._expire = expire
        self._period = 0
        self.due = NEVER

    def start(self, delay: int, *, periodic: bool = False) -> None:
        """Expire after a delay in us, above 0, and again every delay if periodic."""
        self._period = delay if periodic else 0
        self.due = due = self._clock.now + delay
        self._clock.next_due = min(due, self._clock.next_due)

    def stop(self) -> None:
        """Do not expire."""
        self.due = NEVER

    @property
    def running(self) -> bool:
        """Whether it will expire."""
        return self.due != NEVER

    def fire(self) -> None:
        """Set the next expiry, then act: what it does may start or stop it again."""
        if self._period:
            # Expiries that were slept through are dropped, the phase is kept.
            self.due += self._period * (1 + (self._clock.now - self.due) // self._period)
        else:
            self.due = NEVER
        self._expire()


class Clock:
    """Device time and the timers that run on it.

    Attributes
    ----------
    now
        Microseconds since power-on.
    next_due
        No timer expires before this.
    """

    __slots__ = ("_timers", "next_due", "now")

    def __init__(self) -> None:
        self.now = 0
        self.next_due = NEVER
        self._timers: list[Timer] = []

    def timer(self, expire: Callable[[], None]) -> Timer:
        """Add a timer, stopped."""
        timer = Timer(self, expire)
        self._timers.append(timer)
        return timer

    def advance(self, microseconds: int) -> None:
        """Let time pass; every timer expires at most once, in order of expiry."""
        self.now = now = self.now + microseconds
        if now < self.next_due:
            return
        expired = [timer for timer in self._timers if timer.due <= now]
        expired.sort(key=lambda timer: timer.due)
        for timer in expired:
            if timer.due <= now:  # not stopped or restarted by one before
                timer.fire()
        self.next_due = min((timer.due for timer in self._timers), default=NEVER)
