"""The terminal screen of a watch: layout of a view, and input of commands. Needs Textual."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from textwrap import wrap
from time import monotonic
from typing import ClassVar, Final, NamedTuple

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.widgets import Input, Static

from smarttac_can.bench import Stimulator
from smarttac_can.bench.errors import in_shell_words
from smarttac_can.bench.watch.commands import HINT, Operator, answered, obey
from smarttac_can.bench.watch.listener import Listener
from smarttac_can.bench.watch.watcher import Peer, View, Watcher

_TICK_S: Final = 0.05
_STYLES: Final = {"head": "bold", "alarm": "bold red", "note": "yellow", "faint": "dim", "": ""}
_BELOW: Final = 2
"""Lines below the view."""
LEAST_COLUMNS: Final = 72
LEAST_LINES: Final = 20
"""Least height of the view in lines, as `LEAST_COLUMNS` is its least width."""
_HALF_PLATE_MM: Final = 38.0
_COF_MAX: Final = 1.0
_STEPS: Final = " ▁▂▃▄▅▆▇█"
_NOTHING: Final = "-"
_EDGE: Final = 14
"""Columns for label and value in front of a bar."""


class WatchScreen(App[None]):
    """A view that follows the frames of a bus, with a command line if a stimulator is driven.

    Parameters
    ----------
    watcher
        Watcher whose view is shown.
    listener
        Running listener that supplies the frames.
    where
        Name of the bus.
    stimulator
        Stimulator to drive; None for a screen that only reads.
    """

    CSS = "Input { border: none; height: 1; padding: 0; }"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "stop", priority=True),
        Binding("ctrl+c", "quit", priority=True),
        Binding("q", "quit"),
    ]

    def __init__(
        self,
        watcher: Watcher,
        listener: Listener,
        where: str,
        stimulator: Stimulator | None = None,
    ) -> None:
        super().__init__()
        self._watcher = watcher
        self._where = where
        self._stimulator = stimulator
        self._operator = Operator(watcher, listener)
        self._report = ""

    def compose(self) -> ComposeResult:
        """Create the view, the command line, and the line for keys and reports."""
        yield Static(id="view")
        if self._stimulator is not None:
            yield Input(placeholder=HINT, id="line", select_on_focus=False)
        yield Static(id="keys")

    def on_mount(self) -> None:
        """Begin to follow the bus."""
        if self._stimulator is not None:
            self.query_one(Input).focus()
        self.set_interval(_TICK_S, self._tick)
        self._tick()

    def on_unmount(self) -> None:
        """Wait for the end of the present command."""
        self._operator.end()

    def action_stop(self) -> None:
        """Disarm, also during a command; a screen that only reads has no such key."""
        if self._stimulator is None:
            return
        self._watcher.stop()
        self._report = "stop"
        self._tick()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Execute a command, one at a time."""
        if self._operator.busy or self._watcher.stopping:
            self._report = "wait: the last one is not done yet"
        elif self._stimulator is not None and event.value.strip():
            self._report = f"doing: {event.value.strip()}"
            command = partial(obey, self._stimulator, event.value)
            self._operator.begin(partial(answered, command, in_shell_words))
            event.input.value = ""

    def _tick(self) -> None:
        if not self.is_running:
            return
        now = monotonic()
        report = self._operator.step(now)
        if report is not None:
            self._report = report
        self._show(now)

    def _show(self, now: float) -> None:
        width, height = self.size
        below = _BELOW + (self._stimulator is not None)
        text = Text(no_wrap=True)
        for line, style in lines(self._watcher.view(now), self._where, width, height, below):
            text.append(f"{line}\n", _STYLES[style])
        self.query_one("#view", Static).update(text)
        self.query_one("#keys", Static).update(Text(self._keys()[: 2 * width]))

    def _keys(self) -> str:
        if self._stimulator is None:
            return "reads only   q: end"
        return f"Esc: STOP   Ctrl-C: stop and end\n{self._report}"


class Line(NamedTuple):
    """One line of the screen."""

    text: str
    style: str = ""
    """``head``, ``alarm``, ``note``, ``faint``, or empty for an ordinary line."""


def lines(view: View, where: str, width: int, height: int, below: int = 0) -> list[Line]:
    """Return the lines of a view: at most `height - below` of at most `width` columns.

    Parameters
    ----------
    where
        Name of the bus.
    width, height
        Size of the whole terminal.
    below
        Lines of the terminal that are not for the view.
    """
    too_small = (
        f"the terminal has {width} x {height} characters, "
        f"watch needs {LEAST_COLUMNS} x {LEAST_LINES + below}: make it larger"
    )
    height -= below
    if width < LEAST_COLUMNS or height < LEAST_LINES:
        return [Line(text, "alarm") for text in wrap(too_small, max(width, 1))[: max(height, 0)]]
    laid = [*_top(view, where), *_contact(view, width), *_drive(view), *_counts(view)]
    urgent = [*_urgent(view, width)]
    # If there is no room for both, present faults come before past emergencies.
    room = height - len(laid)
    laid += urgent[:room]
    laid += list(_emergencies(view))[: max(0, room - len(urgent))]
    return [Line(text[:width], style) for text, style in laid]


def _top(view: View, where: str) -> Iterator[Line]:
    load = f"bus load {view.bus_load:.1%}, {view.frame_rate:.0f} frames/s"
    yield Line(f"SMARTTAC on {where}   {load}", "head")
    yield Line("   ".join(_peer(peer) for peer in view.peers))
    style = "alarm" if view.state == "fault" else "head"
    flags = ", ".join(view.flags) or _NOTHING
    state = view.state or _NOTHING
    yield Line(f"state {state:<12} mode {view.mode or _NOTHING:<20} {flags}", style)
    yield Line("")


def _peer(peer: Peer) -> str:
    if peer.silent is None:
        return f"{peer.name} {peer.node_id}: not heard"
    return f"{peer.name} {peer.node_id}: {peer.nmt or 'heard'}"


def _contact(view: View, width: int) -> Iterator[Line]:
    room = width - _EDGE - 2
    cof, asked = (view.values.get(f"Contact.{name}") for name in ("COF", "COF reference"))
    yield Line(f"{'COF':<6}{_number(cof, 3):>7} {_bar(cof, asked, room)}")
    yield Line(
        f"{'asked':<6}{_number(asked, 3):>7}  0 to {_COF_MAX:g}; | is the reference", "faint"
    )
    yield Line(f"{'course':<14}{_course(view.history, room)}")
    yield Line(f"{'finger':<6}{_value(view, 'Contact.Position', 1):>7} {_finger(view, room)}")
    normal, tangential = (
        _value(view, f"Contact.{name} force", 3) for name in ("Normal", "Tangential")
    )
    yield Line(f"normal {normal} N   tangential {tangential} N")


def _drive(view: View) -> Iterator[Line]:
    yield Line(
        f"amplitude {_value(view, 'Vibration.Amplitude', 3)} um   "
        f"voltage {_value(view, 'Vibration.Voltage', 2)} V   "
        f"frequency {_value(view, 'Vibration.Frequency', 2)} Hz   "
        f"{_value(view, 'Plate temperature', 1)} degC"
    )
    yield Line(
        f"set to    {_value(view, 'Setpoint.Amplitude', 3)} um           "
        f"{_value(view, 'Setpoint.Voltage', 2)} V   "
        f"COF {_value(view, 'Setpoint.COF left', 3)} left, "
        f"{_value(view, 'Setpoint.COF right', 3)} right of "
        f"{_value(view, 'Setpoint.Boundary', 1)} mm",
        "faint",
    )


def _counts(view: View) -> Iterator[Line]:
    named = (
        ("lost", "Lost cycles"),
        ("missed", "Missed deadlines"),
        ("foreign", "Foreign ticks"),
        ("corrupt", "Corrupt measurements"),
        ("surplus", "Surplus measurements"),
    )
    counts = "   ".join(f"{_value(view, f'Cycle.{name}', 0)} {what}" for what, name in named)
    rate = _number(view.cycle_rate, 0)
    cycles = _value(view, "Cycle.Cycles", 0)
    yield Line(f"cycles {cycles} ({rate}/s)   {counts}")


def _urgent(view: View, width: int) -> Iterator[Line]:
    for text, remedy in zip(view.latched, view.remedies, strict=True):
        yield from _wrapped(f"FAULT: {text}; {remedy}", width, "alarm")
    for text in view.notes:
        yield from _wrapped(text, width, "note")


def _emergencies(view: View) -> Iterator[Line]:
    for emergency in view.emergencies:
        yield Line(
            f"{emergency.ago:6.1f} s ago, node {emergency.node_id}: "
            f"EMCY {emergency.code:04X}h {emergency.text}",
            "faint",
        )


def _wrapped(text: str, width: int, style: str) -> Iterable[Line]:
    return (Line(part, style) for part in wrap(text, width))


def _number(value: float | None, decimals: int) -> str:
    return _NOTHING if value is None else f"{value:.{decimals}f}"


def _value(view: View, name: str, decimals: int) -> str:
    return _number(view.values.get(name), decimals)


def _bar(value: float | None, reference: float | None, width: int) -> str:
    cells = ["#" if at < _column(value or 0.0, width) else "." for at in range(width)]
    if reference is not None:
        cells[min(_column(reference, width), width - 1)] = "|"
    return "".join(cells)


def _column(value: float, width: int) -> int:
    return round(min(max(value / _COF_MAX, 0.0), 1.0) * width)


def _course(history: Sequence[tuple[float | None, float | None]], width: int) -> str:
    """Draw the COF over time, scaled to its maximum."""
    values = [cof for cof, _ in history[-width:]]
    highest = max([value for value in values if value is not None], default=0.0)
    if not highest:
        return ""
    last = len(_STEPS) - 1
    return "".join(
        " " if value is None else _STEPS[max(1, round(value / highest * last))] for value in values
    )


def _finger(view: View, width: int) -> str:
    """Draw the plate from above, with the boundary and the finger on it."""
    cells = ["_"] * width
    for name, mark in (("Setpoint.Boundary", ":"), ("Contact.Position", "O")):
        if name in view.values:
            cells[_place(view.values[name], width)] = mark
    return "".join(cells)


def _place(position_mm: float, width: int) -> int:
    share = (position_mm + _HALF_PLATE_MM) / (2.0 * _HALF_PLATE_MM)
    return min(max(round(share * (width - 1)), 0), width - 1)
