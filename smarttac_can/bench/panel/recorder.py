"""Recordings that a page begins, marks and ends, in a folder of the computer of the panel."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any

from smarttac_can.bench import BenchError, Stimulator
from smarttac_can.bench.recording import Recording
from smarttac_can.bench.watch.commands import answered


class Recorder:
    """One recording at a time of a stimulator, into files that are named by their time.

    Parameters
    ----------
    stimulator
        Stimulator to record.
    folder
        Folder of the files; it must exist.
    """

    def __init__(self, stimulator: Stimulator, folder: Path) -> None:
        self._stimulator, self._folder = stimulator, folder
        self._recording: Recording | None = None
        self._maker = ThreadPoolExecutor(1, "recorder")
        self._making: Future[str] | None = None

    def obey(self, text: str) -> str:
        """Execute ``start NOTES``, ``mark TEXT`` or ``stop``; return what was done.

        The file of a recording is made after this call: see `made`.

        Raises
        ------
        ValueError
            If it is none of these, or a text is empty or too long.
        BenchError
            If nothing is being recorded, or something is already, or a file cannot be written.
        """
        word, _, words = text.partition(" ")
        if word == "start":
            return self._start(words)
        if self._recording is None or self._making is not None:
            raise BenchError("nothing is being recorded: click Start recording first")
        if word == "mark":
            self._recording.mark(words)
            return f"done: marker {words!r}"
        if word == "stop":
            recording = self._recording
            self._making = self._maker.submit(lambda: answered(lambda: _ended(recording)))
            return f"{recording.path.name} is being made"
        raise ValueError(f"record {word} is none of start, mark, stop")

    def made(self) -> str:
        """Return the result once a file was made, and an empty text at all other times."""
        if self._making is None or not self._making.done():
            return ""
        result, self._making, self._recording = self._making.result(), None, None
        return result

    def shown(self) -> dict[str, Any]:
        """Return the folder, and the file that is being recorded with its cycles, for a page."""
        recording = self._recording
        return {
            "folder": str(self._folder),
            "file": "" if recording is None else recording.path.name,
            "cycles": 0 if recording is None else recording.cycles,
            "making": self._making is not None,
        }

    def end(self) -> None:
        """End a recording that goes on, and wait for its file."""
        if self._recording is not None and self._making is None:
            self.obey("stop")
        self._maker.shutdown()

    def _start(self, notes: str) -> str:
        if self._recording is not None:
            raise BenchError(f"{self._recording.path.name} is being recorded: one file at a time")
        path = self._folder / f"panel-{datetime.now().astimezone():%Y%m%d-%H%M%S}.h5"
        recording = self._stimulator.record(path, notes=notes)
        recording.__enter__()
        self._recording = recording
        return f"done: recording into {path.name}"


def _ended(recording: Recording) -> str:
    recording.__exit__(None, None, None)
    assert recording.summary is not None
    rows, lost = recording.summary.rows, recording.summary.lost
    return f"done: {recording.path.name} has {rows} cycles of 1 ms, and {lost} are lost"
