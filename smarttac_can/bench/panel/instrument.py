"""The instrument that a panel shows and drives, in its own thread: a simulated bench, or a bus.

The instrument never waits for the server. If the server stalls or the driving page falls silent,
the thread of the instrument notices that it has not received the page for `LEASE_S`, and goes to 0
V itself. If the thread stalls, a simulation stands still, and on a bus the stimulator loses the
heartbeat of the process.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, Final, NamedTuple

from smarttac_can.bench import BenchError, Stimulator, Texture
from smarttac_can.bench.link import RECORDED, Row
from smarttac_can.bench.panel.recorder import Recorder
from smarttac_can.bench.panel.textures import drawn, with_warnings
from smarttac_can.bench.simulation import open_guided_link
from smarttac_can.bench.watch.commands import Operator, answered, in_words, obey
from smarttac_can.bench.watch.extremes import Extremes
from smarttac_can.bench.watch.listener import Listener
from smarttac_can.bench.watch.watcher import (
    PUBLISHED,
    READ,
    READ_RARELY,
    Emergency,
    View,
    Watcher,
    view_of,
)
from smarttac_can.bench.watch.wording import identification
from smarttac_can.canopen.od.cia import EmergencyCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.host.background import Background
from smarttac_can.vocabulary.faults import PICKUP, PICKUP_Q, THERMOMETER, FaultKind
from smarttac_can.vocabulary.meanings import FAULT_KIND, emergency_text
from smarttac_can.vocabulary.states import IdentificationState, Mode
from smarttac_can.vocabulary.textures import TABLE_NAMES
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, watchdogs_in

LEASE_S: Final = 0.8
"""Time in s after which a silent page loses the right to drive; the heartbeat of a bench has 1
s."""
_END_S: Final = 5.0
_SIMULATED_S: Final = 0.01
_HEARD_S: Final = 0.02
_CYCLE_S: Final = 1e-3
_MOST_CYCLES: Final = 100
"""Most cycles simulated in one step; on a slower machine the simulated time passes slower."""
_MOST_WAITING: Final = 4
"""Most lines in the queue: a user may enter a value and click before it is written."""
_FAULTS: Final[Mapping[str, tuple[FaultKind, int, int]]] = {
    "a gauge is stuck": (FaultKind.STUCK, 3, 0),
    "a gauge is dead": (FaultKind.DEAD, 4, 0),
    "the pick-up is dead": (FaultKind.DEAD, PICKUP_Q, 0),
    "the pick-up reads a fifth": (FaultKind.GAIN, PICKUP, 200),
    "the thermometer is at its end": (FaultKind.SATURATED, THERMOMETER, 1),
    "the plate is at 80 degC": (FaultKind.TEMPERATURE, 1, 8000),
    "the plate cracks": (FaultKind.RESONANCE_SHIFT, 1, -3000),
    "the finger slams": (FaultKind.SLAM, 1, 8000),
    "the power stage is stuck": (FaultKind.STAGE_STUCK, 1, 14_000),
}
"""Faults that a user can inject: kind, sensor and value."""
FAULTS: Final = tuple(_FAULTS)
_TEXTURES: Final = ((10.0, 0.2, 0.35, "square"), (20.0, 0.2, 0.35, "sine"))
"""Period in mm, lowest and highest COF, and shape of the textures of a simulated bench."""
_STROKE_WORDS: Final = 3
_EMERGENCIES: Final = 6
SLOTS: Final = tuple(range(1, len(TABLE_NAMES) + 1))
_DONE: Final = {
    "hand": "the mouse is the finger",
    "stroke": "the finger strokes by itself",
    "mend": "the fault is removed",
    "identify": "identification has begun",
}
_PANEL_WORDS: Final = {
    "; .trace holds the recording": "",
    "reset_fault()": "click Reset fault",
    "disarm() first": "click STOP first",
    "then tare()": "then click Tare",
    "a script sets bench.texture first": "make a texture on this page first",
}
"""Calls that messages of the bench suggest, and what a person does on the page instead."""


def in_panel_words(error: object) -> str:
    """Return a message of the bench with what a person does on the page instead of calls."""
    text = str(error)
    for call, words in _PANEL_WORDS.items():
        text = text.replace(call, words)
    return text


class Lease:
    """The right of one page to drive, while the page is received; safe in any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._page: object = None
        self._heard = 0.0

    def take(self, page: object, now: float) -> bool:
        """Grant the right at a time in s if it is free; return whether the page has it."""
        with self._lock:
            if self._page is None:
                self._page, self._heard = page, now
            return self._page is page

    def renew(self, page: object, now: float) -> None:
        """Record that a page was received at a time in s; a right that has run out stays so."""
        with self._lock:
            if self._page is page and now - self._heard <= LEASE_S:
                self._heard = now

    def drop(self, page: object) -> bool:
        """Take the right from a page; return whether the page had it."""
        with self._lock:
            dropped = self._page is page
            if dropped:
                self._page = None
            return dropped

    def held_by(self, page: object) -> bool:
        """Return whether a page has the right."""
        with self._lock:
            return self._page is page

    def expire(self, now: float) -> bool:
        """End the right if its page was silent for `LEASE_S`; return whether it ended now."""
        with self._lock:
            expired = self._page is not None and now - self._heard > LEASE_S
            if expired:
                self._page = None
            return expired


class Seen(NamedTuple):
    """State of an instrument at one instant."""

    at: float
    """Time in s of `time.monotonic` at which its step began."""
    view: View
    stopping: bool
    """Whether a stop was requested, and the stimulator is not known to be disarmed yet."""


class Instrument(Background, ABC):
    """An instrument that runs in its own thread during its block.

    Parameters
    ----------
    where
        Name of the bus or bench.
    od
        Object dictionary of the stimulator.
    stimulator
        Stimulator to drive; None to observe only.
    pause
        Longest time between two steps in s.
    records
        Folder for the recordings of pages; None if they record nothing.
    extremes
        Least and greatest values, in steps that `step` ends.

    Attributes
    ----------
    textures
        Its textures by slot, as `drawn` returns them; None while a slot is empty or not known.
    texture_changes
        Number of changes of `textures`.
    lease
        Right of a page to command it.
    seen
        Last state; None at the beginning.
    answer
        Result of the last command.
    """

    simulated = False

    def __init__(
        self,
        where: str,
        od: ObjectDictionary,
        stimulator: Stimulator | None,
        *,
        pause: float,
        records: Path | None,
        extremes: Extremes,
    ) -> None:
        super().__init__("instrument", self._go, self._call_off, _END_S)
        self.where, self.od, self.drives = where, od, stimulator is not None
        self._stimulator = stimulator
        self.recorder: Recorder | None = None
        if stimulator is not None and records is not None:
            self.recorder = Recorder(stimulator, records)
        self.textures: dict[int, dict[str, Any] | None] = dict.fromkeys(SLOTS)
        self.texture_changes = 0
        self._offered: dict[int, tuple[Texture, str]] = {}
        self.lease = Lease()
        self.seen: Seen | None = None
        self.answer = ""
        self.extremes = extremes
        self._pause = pause
        self._over = False
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._waiting: deque[tuple[object, str]] = deque()

    def stop(self, why: str = "stop") -> None:
        """Go to 0 V from any thread, whatever is in progress or queued."""
        if self.drives:
            self.answer = why
            self._stopping.set()
            self._wake.set()

    def leave(self, page: object) -> None:
        """Go to 0 V if the page that has left was driving."""
        if self.lease.drop(page):
            self.stop("the page that drove has left: stopped")

    def command(self, page: object, text: str) -> None:
        """Queue a line of the driving page; `answer` gives the result."""
        if not self.lease.held_by(page):
            self.answer = f"{text}: not done, this page does not drive"
        elif self._stops() or len(self._waiting) >= _MOST_WAITING:
            self.answer = f"{text}: not done, wait for what is being done"
        else:
            self._waiting.append((page, text))
            self._wake.set()

    def offer(self, page: object, slot: int, texture: Texture, label: str) -> None:
        """Queue a texture for a slot, as a command of the driving page."""
        self._offered[slot] = texture, label
        self.command(page, f"load {slot}")

    def _load(self, stimulator: Stimulator, number: str) -> str:
        """Write an offered texture to its slot; return what is to be known of it."""
        slot = int(number)
        if slot not in self._offered:
            raise ValueError(f"no texture was made for slot {slot}")
        texture, label = self._offered.pop(slot)

        def write() -> None:
            stimulator.texture_slot = slot
            stimulator.texture = texture

        _, warned = with_warnings(write)
        self._know(slot, texture, label)
        return f"done: {label} is texture {slot}{warned and f'. {warned}'}"

    def _know(self, slot: int, texture: Texture, label: str) -> None:
        self.textures = {**self.textures, slot: drawn(texture, label)}
        self.texture_changes += 1

    def guide(self, page: object, x_mm: float, force: float) -> None:
        """Move the finger of a simulation to a position in mm with a force in N.

        Raises
        ------
        ValueError
            A value is out of range.
        """

    def _stops(self) -> bool:
        return self._stopping.is_set()

    def _begin_stop(self) -> bool:
        """Return whether a stop was requested; the queue is then cleared."""
        stopping = self._stopping.is_set()
        if stopping:
            self._waiting.clear()
            self._stopping.clear()
        return stopping

    def _go(self) -> None:
        while not self._over:
            self._wake.clear()
            now = monotonic()
            if self.lease.expire(now):
                self.stop(f"the page that drove was not heard for {LEASE_S:g} s: stopped")
            self.step(now)
            if self.recorder is not None:
                self.answer = self.recorder.made() or self.answer
            self._wake.wait(self._pause)
        self.stop("the panel has ended: stopped")
        # Two more cycles, so that a simulation shows the stop.
        self.step(monotonic() + 2.0 * _CYCLE_S)
        if self.recorder is not None:
            self.recorder.end()

    def _record(self, text: str) -> str:
        if self.recorder is None:
            raise ValueError("this panel was started without --record FOLDER")
        return self.recorder.obey(text)

    def _call_off(self) -> None:
        self._over = True
        self._wake.set()

    @abstractmethod
    def step(self, now: float) -> None:
        """Advance to a time in s."""


class SimulatedBench(Instrument):
    """A stimulator with its plate inside this process, at the pace of the clock.

    It has no bus, and opens none. A `GuidedFinger` is on the plate.

    Parameters
    ----------
    records
        Folder for the recordings of pages; None if they record nothing.
    """

    simulated = True

    def __init__(self, records: Path | None = None) -> None:
        link, od, self._finger = open_guided_link()
        self._bench = stimulator = Stimulator(link, od)
        super().__init__(
            "a simulated bench", od, stimulator, pause=_SIMULATED_S, records=records,
            extremes=Extremes(od, PUBLISHED),
        )  # fmt: skip
        self._link = link
        for slot, (period, low, high, shape) in enumerate(_TEXTURES, 1):
            texture = Texture.grating(period, low, high, shape=shape)
            stimulator.texture_slot = slot
            stimulator.texture = texture
            self._know(slot, texture, f"{shape}, {period:g} mm")
        stimulator.texture_slot = 1
        self._simulated_to: float | None = None
        self._identifying = False
        self._latched = 0
        self._emergencies: deque[tuple[float, int]] = deque(maxlen=_EMERGENCIES)

    def guide(self, page: object, x_mm: float, force: float) -> None:
        """Guide the finger, if the page has the right to drive."""
        if self.lease.held_by(page):
            self._finger.guide(x_mm * 1e-3, force)

    def leave(self, page: object) -> None:
        """Lift the finger and go to 0 V if the page was driving."""
        if self.lease.held_by(page):
            self._finger.guide(0.0, 0.0)
        super().leave(page)

    def step(self, now: float) -> None:
        """Disarm if requested, else obey the next line; then simulate the elapsed time."""
        if self._begin_stop():
            self._identifying = False
            self._bench.disarm()
        elif self._waiting:
            page, text = self._waiting.popleft()
            if self.lease.held_by(page):
                self.answer = answered(partial(self._obey, text), in_panel_words)
        if self._simulated_to is None:
            self._simulated_to = now
        cycles = min(round((now - self._simulated_to) / _CYCLE_S), _MOST_CYCLES)
        slow = cycles == _MOST_CYCLES
        self._simulated_to = now if slow else self._simulated_to + cycles * _CYCLE_S
        rows: list[Row] = []
        self._link.run(cycles, rows, self._stopping.is_set)
        for name, values in zip(RECORDED, zip(*rows, strict=True), strict=False):
            self.extremes.take(name, values)
        self.extremes.end_step(now)
        self.seen = self._look(now)
        if self._identifying:
            self._follow_identification(self.seen.view)

    def _look(self, now: float) -> Seen:
        read = self._link.read
        seen = {name: read(name) for name in (*PUBLISHED, "Statusword", "Mode display")}
        view = view_of(
            self.od, seen, {name: read(name) for name in (*READ, *READ_RARELY, "Message")}
        )
        latched = read("Diagnosis.Latched")
        self._note_emergencies(now, self._latched, latched)
        self._latched = latched
        emergencies = tuple(
            Emergency(now - at, self.od.node_id, code, emergency_text(code))
            for at, code in self._emergencies
        )
        return Seen(now, view._replace(emergencies=emergencies), self._stops())

    def _note_emergencies(self, now: float, before: int, latched: int) -> None:
        """Note the emergency messages that a node sends for faults that were latched or reset."""
        for _ in watchdogs_in(before & ~latched):
            self._emergencies.appendleft((now, EmergencyCode.RESET))
        for watchdog in watchdogs_in(latched & ~before):
            self._emergencies.appendleft((now, WATCHDOGS[watchdog].code))

    def _follow_identification(self, view: View) -> None:
        self.answer = identification(view.values, view.message)
        if view.values["Model.State"] != IdentificationState.RUNNING:
            self._identifying = False
            self._bench.disarm()

    def _obey(self, text: str) -> str:
        name, *arguments = text.split() or [""]
        stimulator = self._bench
        if name == "hand" and not arguments:
            self._finger.guide(0.0, 0.0)
            stimulator.finger.play_recording()
            self._start_run()
        elif name == "stroke" and len(arguments) == _STROKE_WORDS:
            subject, force, speed = arguments
            stimulator.finger.stroke(int(subject), force=float(force), speed=float(speed))
            self._start_run()
        elif name == "break":
            self._break(text.partition(" ")[2])
        elif name == "mend" and not arguments:
            stimulator.set(FAULT_KIND, int(FaultKind.NONE))
        elif name == "identify" and not arguments:
            # Its cycles are those of the next steps, so that a stop is heard meanwhile.
            stimulator.mode = Mode.IDENTIFY
            self._identifying = True
        elif name == "load" and arguments:
            return self._load(stimulator, arguments[0])
        elif name == "record":
            return self._record(text.partition(" ")[2])
        else:
            return obey(stimulator, text)
        return f"done: {_DONE.get(name) or in_words(text)}"

    def _start_run(self) -> None:
        self._bench.disarm()
        self._bench.start_run()

    def _break(self, what: str) -> None:
        if what not in _FAULTS:
            raise ValueError(f"{what!r} is none of: {', '.join(FAULTS)}")
        kind, sensor, value = _FAULTS[what]
        self._bench.set_all(
            {
                "Fault.Sensor": sensor,
                "Fault.Value": value,
                "Fault.Delay in cycles": 0,
                FAULT_KIND: int(kind),
            }
        )


class BusInstrument(Instrument):
    """A stimulator on a bus, observed by a `Watcher`.

    Parameters
    ----------
    where
        Name of the bus.
    od
        Object dictionary of the stimulator.
    watcher
        Watcher whose view is shown.
    listener
        Running source of frames.
    stimulator
        Stimulator to drive; None to observe only. A thread of its own waits for its answers.
    records
        Folder for the recordings of pages; None if they record nothing.
    """

    def __init__(
        self,
        where: str,
        od: ObjectDictionary,
        watcher: Watcher,
        listener: Listener,
        stimulator: Stimulator | None,
        records: Path | None = None,
    ) -> None:
        super().__init__(
            where, od, stimulator, pause=_HEARD_S, records=records, extremes=watcher.extremes
        )
        self._watcher = watcher
        self._operator = Operator(watcher, listener)
        self._read: set[int] = set()

    def step(self, now: float) -> None:
        """Take received frames, send those that are due, and follow the command in progress."""
        if self._begin_stop():
            self._watcher.stop()
        elif self._waiting and not self._operator.busy:
            self._operator.begin(partial(self._obey, *self._waiting.popleft()))
        elif (slot := self._slot_to_read()) and self._stimulator is not None:
            self._operator.begin(partial(self._read_texture, self._stimulator, slot))
        answer = self._operator.step(now)
        if answer:
            self.answer = answer
        self.extremes.end_step(now)
        self.seen = Seen(now, self._watcher.view(now), self._stops())

    def _stops(self) -> bool:
        return super()._stops() or self._watcher.stopping

    def _obey(self, page: object, text: str) -> str:
        stimulator = self._stimulator
        if stimulator is None or not self.lease.held_by(page):
            return f"{text}: not done, its page does not drive"
        name, _, rest = text.partition(" ")
        if name == "load":
            return answered(partial(self._load, stimulator, rest), in_panel_words)
        if name == "record":
            return answered(partial(self._record, rest), in_panel_words)
        return answered(partial(obey, stimulator, text), in_panel_words)

    def _slot_to_read(self) -> int:
        """Return the slot in use if its texture is to be read now, or 0."""
        if self._operator.busy or self._stops() or self.seen is None:
            return 0
        slot = int(self.seen.view.values.get("Texture.Slot", 0))
        return 0 if slot in self._read or self.textures.get(slot) else slot

    def _read_texture(self, stimulator: Stimulator, slot: int) -> str:
        """Read the texture of the slot in use; it stays unknown if another one is in use now."""
        self._read.add(slot)
        with suppress(BenchError, ValueError):
            texture = stimulator.texture
            if texture is not None and stimulator.texture_slot == slot:
                self._know(slot, texture, f"texture {slot}")
        return ""

    def _go(self) -> None:
        try:
            super()._go()
        finally:
            self._operator.end()
