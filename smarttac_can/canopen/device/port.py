"""Shared parts of all services of a device: frames to send, listeners by CAN-ID, device time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od import cia

NEVER: Final = 1 << 62


class Timer:
    """One timer of a clock, stopped at first.

    Attributes
    ----------
    delay
        Time in us from a start to the first expiry.
    due
        Device time in us of the next expiry; `NEVER` while stopped.
    missed
        Number of whole periods that were missed before the last expiry.
    """

    __slots__ = ("_clock", "_expire", "_period", "_slip", "_spacing", "delay", "due", "missed")

    def __init__(self, clock: Clock, expire: Callable[[], None]) -> None:
        self._clock = clock
        self._expire = expire
        self.delay = self._period = self._spacing = self._slip = 0
        self.due = NEVER
        self.missed = 0

    def start(self, delay: int, *, periodic: bool = False, spacing: int = 0) -> None:
        """Expire after a delay in us, 0 or more; if periodic, again after each delay, above 0.

        Parameters
        ----------
        spacing
            Least time in us between two expiries, up to the delay; 0 for no limit. After a late
            expiry the next ones shift if needed.
        """
        self.delay = delay
        self._period = delay if periodic else 0
        self._spacing = spacing
        self._slip = 0
        self.restart()

    def restart(self) -> None:
        """Start with `delay`, periodic if the timer was so before."""
        clock = self._clock
        self.due = due = clock.now + self.delay
        clock.next_due = due if due < clock.next_due else clock.next_due

    def follow(self, delay: int) -> None:
        """Change the delay in us of a running one-shot timer, counted from its start."""
        if self.running:
            self.due += delay - self.delay
            self.delay = delay
            self._clock.next_due = min(self.due, self._clock.next_due)

    def stop(self) -> None:
        """Stop the timer."""
        self.due = NEVER

    @property
    def running(self) -> bool:
        """Whether the timer will expire."""
        return self.due != NEVER

    def fire(self) -> None:
        """Set the next expiry, then call the function, which may start or stop the timer again."""
        period = self._period
        if not period:
            self.due = NEVER
        else:
            now = self._clock.now
            late = now - self.due
            if not self._spacing or late <= period - self._spacing:
                # Expiries that were missed are dropped; the phase is kept.
                self.missed = late // period
                self.due += period * (1 + self.missed)
            else:
                self.missed, self._slip = divmod(self._slip + late, period)
                self.due = now + period
        self._expire()


class Clock:
    """Device time and the timers that run on it.

    Attributes
    ----------
    now
        Time in us since power-on. `advance` must be called when `next_due` is reached, so that
        frames received in between are processed at that time.
    next_due
        Device time in us before which no timer expires.
    """

    __slots__ = ("_timers", "next_due", "now")

    def __init__(self) -> None:
        self.now = 0
        self.next_due = NEVER
        self._timers: list[Timer] = []

    def timer(self, expire: Callable[[], None]) -> Timer:
        """Add a timer that is stopped."""
        timer = Timer(self, expire)
        self._timers.append(timer)
        return timer

    def level(self, timers: Sequence[Timer], ahead: int) -> float:
        """Return the largest elapsed fraction of the delays of some timers.

        Parameters
        ----------
        timers
            Timers. A stopped one counts as 0.0, one without a delay as 1.0.
        ahead
            Time in us from now for which to compute it.
        """
        then = self.now + ahead
        largest = 0.0
        for timer in timers:
            if timer.due != NEVER:
                delay = timer.delay
                elapsed = 1.0 - (timer.due - then) / delay if delay else 1.0
                largest = elapsed if elapsed > largest else largest
        return largest

    def advance(self, microseconds: int) -> None:
        """Advance time by 0 or more us; every timer expires at most once, in order of expiry."""
        self.now = now = self.now + microseconds
        if now < self.next_due:
            return
        timers = self._timers
        # The first timer may have been stopped or restarted since.
        self.next_due = next_due = min([timer.due for timer in timers], default=NEVER)
        if now < next_due:
            return
        expired = [timer for timer in timers if timer.due <= now]
        expired.sort(key=lambda timer: timer.due)
        for timer in expired:
            if timer.due <= now:  # a timer before it may have stopped or restarted it
                timer.fire()
        self.next_due = min([timer.due for timer in timers])


class Identifiers(NamedTuple):
    """CAN-IDs that a host needs to connect a device to a bus."""

    heard: frozenset[int] = frozenset()
    """CAN-IDs to which the device listens in any NMT state. Frames with other CAN-IDs may be
    filtered out; the device itself ignores those that its present state does not serve."""
    urgent: frozenset[int] = frozenset()
    """CAN-IDs of its frames that have priority, and are useless if late: SYNC, EMCY, error control,
    and the TPDOs of a control loop."""
    emcy: int = 0
    """CAN-ID of its emergency messages, which stay useful however late."""
    sent: frozenset[int] = frozenset()
    """CAN-IDs with which only this device may send."""
    sync: int = cia.SYNC_ID
    """CAN-ID of SYNC."""


class Port:
    """The device's side of its CAN connection.

    Attributes
    ----------
    clock
        Device time.
    out
        Frames to send, in order of cause.
    listeners
        Handlers by CAN-ID.
    """

    __slots__ = ("_streams", "clock", "listeners", "out")

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.out: list[Frame] = []
        self.listeners: dict[int, list[Callable[[Frame], None]]] = {}
        self._streams: deque[Callable[[], Frame | None]] = deque()

    def listen(self, can_id: int, handler: Callable[[Frame], None]) -> None:
        """Call the handler with every frame of this CAN-ID."""
        self.listeners.setdefault(can_id, []).append(handler)

    def take(self) -> list[Frame]:
        """Return the frames to send, and clear them."""
        out = self.out
        if not out:
            return []
        self.out = []
        return out

    def stream(self, source: Callable[[], Frame | None]) -> None:
        """Take frames from a source as fast as the bus accepts them, until it returns None."""
        if source not in self._streams:
            self._streams.append(source)

    def segments(self, most: int) -> list[Frame]:
        """Return up to ``most`` next frames of the sources, which take turns."""
        frames: list[Frame] = []
        streams = self._streams
        while streams and len(frames) < most:
            source = streams.popleft()
            frame = source()
            if frame is not None:
                frames.append(frame)
                streams.append(source)
        return frames
