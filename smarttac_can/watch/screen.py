"""The screen of a watch, in the terminal. Needs Textual."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from time import monotonic
from typing import ClassVar, Final

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.widgets import Input, Static

from smarttac_can.bench import BenchError, Stimulator
from smarttac_can.bench.errors import in_shell_words
from smarttac_can.watch.commands import HINT, obey
from smarttac_can.watch.layout import lines
from smarttac_can.watch.listener import Listener
from smarttac_can.watch.watcher import Watcher

_TICK_S: Final = 0.05
_STYLES: Final = {"head": "bold", "alarm": "bold red", "note": "yellow", "faint": "dim", "": ""}
_BELOW: Final = 2
"""Lines under the view."""


class WatchScreen(App[None]):
    """A view that is drawn anew as frames come; with a stimulator to drive, a line to type at.

    Parameters
    ----------
    watcher
        What is shown.
    listener
        Where its frames come from, running.
    where
        Name of the bus.
    stimulator
        What is driven; None to look on only.
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
        self._listener = listener
        self._where = where
        self._stimulator = stimulator
        self._worker: ThreadPoolExecutor | None = None
        self._doing: Future[str] | None = None
        self._said = ""

    def compose(self) -> ComposeResult:
        """Lay out the view, the line to type at, and what the keys do."""
        yield Static(id="view")
        if self._stimulator is not None:
            yield Input(placeholder=HINT, id="line", select_on_focus=False)
        yield Static(id="keys")

    def on_mount(self) -> None:
        """Begin to follow the bus."""
        if self._stimulator is not None:
            self._worker = ThreadPoolExecutor(1, "drive")
            self.query_one(Input).focus()
        self.set_interval(_TICK_S, self._tick)
        self._tick()

    def on_unmount(self) -> None:
        """Wait for what is being done."""
        if self._worker is not None:
            self._worker.shutdown()

    def action_stop(self) -> None:
        """Disarm, whatever else is being done; a watch that only looks on has no such key."""
        if self._stimulator is None:
            return
        self._watcher.stop()
        self._said = "stop"
        self._tick()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Have a line obeyed, one at a time."""
        if self._doing is not None or self._watcher.stopping:
            self._said = "wait: the last one is not done yet"
        elif self._worker is not None and self._stimulator is not None and event.value.strip():
            self._said = f"doing: {event.value.strip()}"
            self._doing = self._worker.submit(obey, self._stimulator, event.value)
            event.input.value = ""

    def _tick(self) -> None:
        if not self.is_running:
            return
        now = monotonic()
        self._watcher.lost = self._listener.lost
        for at, frame in self._listener.heard():
            self._watcher.receive(at, frame)
        self._follow_command()
        for frame in self._watcher.advance(now):
            self._listener.send(frame)
        self._show(now)

    def _follow_command(self) -> None:
        if self._doing is None:
            return
        if self._watcher.stopping:
            # What is being done must not arm behind the stop's back.
            self._watcher.stop()
        if not self._doing.done():
            return
        try:
            self._said = self._doing.result()
        except (BenchError, ValueError) as error:
            # A device may have put into its Message what a terminal would obey.
            self._said = "".join(c if c.isprintable() else "?" for c in in_shell_words(error))
        self._doing = None

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
        return f"Esc: STOP   Ctrl-C: stop and end\n{self._said}"
