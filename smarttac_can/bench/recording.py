"""A recording in the background, while this script or another commander drives."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from smarttac_can import __version__
from smarttac_can.bench.given import metadata as own_metadata
from smarttac_can.bench.given import require_text, stays_in_process
from smarttac_can.bench.link import Link, PublishedPdo
from smarttac_can.bench.recorded_frames import TICK
from smarttac_can.bench.recording_file import METADATA, Summary, make_recording, require_new
from smarttac_can.canopen.master.errors import BenchError, RefusedError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.host.files import reason
from smarttac_can.host.frame_log import FrameLog
from smarttac_can.vocabulary.textures import TABLE_NAMES

_LONGEST_TEXT: Final = 1000
_INPUT: Final = "Plate input."
"""Record that a plate node writes in every cycle; not a setting."""
_NAMES: Final = (
    "Manufacturer device name",
    "Manufacturer hardware version",
    "Manufacturer software version",
)


class Recording:
    """Recording of a stimulator during a ``with`` block, created by `Stimulator.record`.

    Parameters
    ----------
    link
        Link to the stimulator.
    od
        Object dictionary from the EDS of the stimulator.
    path
        HDF5 file to create; it must not exist. During the recording its log is beside it, with
        ``.log`` appended to the name.
    raw
        File for all frames of the bus in a format of python-can, or None.
    metadata
        Texts of up to 1000 characters, by the names in `METADATA`, and own keys with texts or
        numbers.
    stop
        Function called when an error ends the block, before the file is made.

    Attributes
    ----------
    summary
        Summary of the finished recording; None before.
    raw_note
        One line on how the raw log differs from the bus; empty if it does not, or there is none.
    """

    __reduce_ex__ = stays_in_process("a recording that goes on")

    def __init__(
        self,
        link: Link,
        od: ObjectDictionary,
        path: Path,
        raw: Path | None,
        metadata: Mapping[str, str | float],
        stop: Callable[[], object],
    ) -> None:
        for name in METADATA:
            require_text(name, metadata.get(name, ""), 0, _LONGEST_TEXT)
        self._metadata = {**dict.fromkeys(METADATA, ""), **own_metadata(metadata)}
        self._link = link
        self._od = od
        # The working folder may be another one at the end.
        self.path = path.absolute()
        self._raw = None if raw is None else raw.absolute()
        self._stop = stop
        self.summary: Summary | None = None
        self.raw_note = ""
        self._log: FrameLog | None = None
        self._stack = ExitStack()
        self._cycles = 0
        self._ods: list[ObjectDictionary] = []
        self._process = os.getpid()

    def __repr__(self) -> str:
        if self.summary is not None:
            summary = self.summary
            state = f"{summary.rows} rows of 1 ms, {summary.lost} lost, {summary.limited} limited"
        else:
            state = (
                f"{self._cycles} cycles of 1 ms so far" if self.goes_on else "not being recorded"
            )
        return f"<Recording {str(self.path)!r}: {state}>"

    @property
    def log_path(self) -> Path:
        """Path of the log beside the file."""
        return self.path.with_name(f"{self.path.name}.log")

    @property
    def goes_on(self) -> bool:
        """Whether the recording has begun and not ended."""
        return self._log is not None

    @property
    def cycles(self) -> int:
        """Number of cycles received so far."""
        return self._cycles

    def mark(self, text: str) -> None:
        """Add a marker with a text of 1 to 1000 characters at the present time.

        Raises
        ------
        ValueError
            If `text` is not a text, empty or too long.
        BenchError
            If the recording has not begun, or has ended.
        """
        require_text("marker", text, 1, _LONGEST_TEXT)
        if self._log is None:
            raise BenchError(f"{self.path} is not being recorded: markers go into a recording")
        self._log.mark(text)

    def check(self) -> None:
        """Raise BenchError if the log cannot be written, for example on a full disk."""
        if self._log is not None:
            self._require_room(self._log)

    def _require_room(self, log: FrameLog) -> None:
        if log.error is not None:
            raise BenchError(
                f"{self.log_path} cannot be written: {reason(log.error)}; what was recorded is in "
                f"it: make room, then {self._recover}"
            )

    @property
    def _recover(self) -> str:
        return f"smarttac record --recover {self.log_path} {self.path} makes the file"

    def __enter__(self) -> Self:
        require_new(self.path)
        head = self._head()
        last = [pdo["can_id"] for pdo in head["published"] if pdo["every_cycle"]][-1]
        with ExitStack() as stack:
            if self._raw is not None:
                self.raw_note = stack.enter_context(self._link.raw(self._raw))
            log = stack.enter_context(self._new_log(head))
            try:
                stack.enter_context(self._link.frames(self._hearing(log, last)))
            except BenchError:
                self.log_path.unlink()
                raise
            self._stack = stack.pop_all()
        self._log = log
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        log, self._log = self._log, None
        if os.getpid() != self._process:  # a fork leaves the recording to its parent
            return
        assert log is not None
        if error is not None:
            self._stop()
        failures = []
        for step in (self._stack.close, partial(self._make_file, log)):
            try:
                step()
            except BenchError as failure:
                failures.append(failure)
        # Report the first failure, with a note of the others.
        first = error or (failures[0] if failures else None)
        if first is not None:
            others = [str(failure) for failure in failures if str(failure) != str(first)]
            if self.summary is not None:
                others.append(f"{self.path} holds what was recorded until then")
            for text in others:
                first.add_note(text)
            if first is not error:
                raise first

    def _new_log(self, head: dict[str, Any]) -> FrameLog:
        try:
            return FrameLog(self.log_path, head)
        except FileExistsError as error:
            raise BenchError(
                f"{self.log_path} is the log of a recording that goes on, or was killed: in that "
                f"case smarttac record --recover {self.log_path} {self.path} makes its file"
            ) from error
        except OSError as error:
            raise BenchError(f"cannot write {self.log_path}: {reason(error)}") from error

    def _make_file(self, log: FrameLog) -> None:
        self._require_room(log)
        try:
            self.summary = make_recording(self.log_path, self.path, at_hand=self._ods)
            self.log_path.unlink()
        except OSError as error:
            raise BenchError(f"{error}; {self._recover}") from error

    def _hearing(self, log: FrameLog, last: int) -> Callable[[int, bytes], None]:
        """Return a function that logs a frame; frames with the identifier `last` end a cycle."""
        write = log.frame

        def hear(can_id: int, data: bytes) -> None:
            write(can_id, data)
            if can_id == last:
                self._cycles += 1

        return hear

    def _head(self) -> dict[str, Any]:
        source, own = self._link.source(), self._od
        every_cycle = source.every_cycle
        carried = {n for pdo in source.published if pdo.number in every_cycle for n in pdo.names}
        if TICK not in carried:
            raise BenchError(
                f"the TPDOs 2 to 4 of node {own.node_id} do not map {TICK}, so lost "
                "cycles cannot be counted: restore their default mapping"
            )
        self._ods = [own] if source.plate is None else [own, source.plate]
        held = [n for p in source.published if p.number not in every_cycle for n in p.names]
        return {
            "version": __version__,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "where": self._link.where,
            "node_id": own.node_id,
            "nodes": [{"node_id": od.node_id, "eds": od.text} for od in self._ods],
            "identity": self._identity(),
            "clocked": source.clocked,
            "published": [_pdo(pdo, pdo.number in every_cycle) for pdo in source.published],
            "commanded": [_pdo(pdo, False) for pdo in source.commanded],
            "held": {name: self._link.read(name) for name in held},
            "settings": self._settings(),
            "metadata": self._metadata,
            "textures": self._textures(),
        }

    def _identity(self) -> dict[str, Any]:
        numbers = [e for e in self._od.objects[cia.IDENTITY].entries.values() if e.subindex]
        identity: dict[str, Any] = {e.name: self._link.read(e.name) for e in numbers}
        return identity | {name: self._link.read(name) for name in _NAMES}

    def _settings(self) -> dict[str, int]:
        """Read all settable values that the device has: calibration, limits, set-points."""
        settings = {}
        for entry in self._od:
            settable = entry.readable and entry.writable and isinstance(entry.default, int)
            manufacturers = cia.MANUFACTURER_FIRST <= entry.index < cia.PROFILE_FIRST
            if settable and manufacturers and not entry.name.startswith(_INPUT):
                with suppress(RefusedError):
                    settings[entry.name] = self._link.read(entry.name)
        return settings

    def _textures(self) -> dict[int, str]:
        """Read the textures of the slots that the device has, by slot, in hexadecimal."""
        tables = {}
        for slot, name in enumerate(TABLE_NAMES, 1):
            if self._od.find(name) is not None:
                with suppress(RefusedError):
                    if table := self._link.read(name):
                        tables[slot] = table.hex()
        return tables


def _pdo(pdo: PublishedPdo, every_cycle: bool) -> dict[str, Any]:
    return {
        "number": pdo.number,
        "can_id": pdo.can_id,
        "names": pdo.names,
        "every_cycle": every_cycle,
    }
