"""The HDF5 file of a recording, made of its log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from smarttac_can.bench.recorded_events import Kind
from smarttac_can.bench.recorded_frames import Dated, RecordedFrames
from smarttac_can.bench.recorded_rows import Rows
from smarttac_can.host.file_errors import in_words
from smarttac_can.host.frame_log import RECORD, FrameLogReader, Records
from smarttac_can.master.errors import BenchError
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.od.ini import EDSError
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import STATE_SHIFT, State, Status

if TYPE_CHECKING:
    import h5py

FORMAT: Final = "SMARTTAC recording 1"
WITHOUT_CONTACT: Final = ("Contact.COF", "Contact.COF reference")
"""Objects that are 0 where there is none: not a number in the file."""
_CHUNK_ROWS: Final = 8192
_NOT_OF_A_RECORDING: Final = (KeyError, TypeError, ValueError, AttributeError, OverflowError)
"""What a head of another form raises."""
_EVERY_CYCLE, _ON_CHANGE = "every cycle", "on change, held"


class Summary(NamedTuple):
    """What a recording holds."""

    rows: int
    lost: int
    """Ticks that are named in the gaps."""
    gaps: int
    runs: int
    """How often ticks began anew, and once."""
    markers: int
    set_points: int
    emergencies: int
    damaged: int
    """Records of the log that were cut or damaged."""


def require_h5py() -> None:
    """Raise BenchError, before a recording begins, if its file could not be made."""
    if find_spec("h5py") is None:
        raise BenchError("recordings need h5py: pip install 'smarttac-can[record]'")


@in_words()
def make_recording(log: Path, path: Path) -> Summary:
    """Make the HDF5 file of a recording of its log, also of one that was killed.

    Parameters
    ----------
    log
        Log of the recording; it stays as it is.
    path
        A file that does not exist yet; it is there when all of it is.

    Raises
    ------
    BenchError
        If there is such a file, h5py is missing, or the log is none of a recording.
    OSError
        If a file cannot be read or written.
    """
    require_h5py()
    import h5py  # noqa: PLC0415 - an extra, and slow

    if path.exists():
        raise BenchError(f"{path} exists: give the recording another name")
    try:
        reader = FrameLogReader(log)
    except ValueError as error:
        raise BenchError(str(error)) from error
    part = path.with_name(f"{path.name}.part")
    _make_empty(part, path)
    try:
        frames = RecordedFrames(reader.head)
        with h5py.File(part, "w") as file:
            summary = _write(file, reader, frames)
        part.rename(path)
    except (*_NOT_OF_A_RECORDING, EDSError) as error:
        raise BenchError(f"{log} cannot be understood: {error}") from error
    finally:
        part.unlink(missing_ok=True)
    return summary


def _make_empty(part: Path, path: Path) -> None:
    """Make the file that is to become another; of what hinders that h5py says what it thinks."""
    try:
        part.open("wb").close()
    except OSError as error:
        error.filename = str(path)
        raise


def _write(file: h5py.File, reader: FrameLogReader, frames: RecordedFrames) -> Summary:
    own = frames.ods[int(reader.head["node_id"])]
    columns = _Columns(file, own, frames.channels)
    for records in reader.chunks():
        columns.append(frames.take(records))
    columns.append(frames.take(_NONE, last=True))
    columns.describe()
    _describe(file, reader.head, frames.ods)
    gaps = [(g.run, g.first, g.last, g.last - g.first + 1, g.time_ns) for g in frames.gaps]
    _table(file, "gaps", "run:i8 first_tick:i8 last_tick:i8 ticks:i8 host_time_ns:i8", gaps)
    by_kind = {kind: [e for e in frames.events if e.event.kind is kind] for kind in Kind}
    _write_events(file, frames.ods, by_kind)
    return Summary(
        rows=columns.rows,
        lost=sum(gap[3] for gap in gaps),
        gaps=len(gaps),
        runs=columns.runs,
        markers=len(by_kind[Kind.MARKER]),
        set_points=len(by_kind[Kind.SET_POINT]),
        emergencies=len(by_kind[Kind.EMERGENCY]),
        damaged=reader.damaged,
    )


class _Columns:
    """Datasets with an element a row, which grow."""

    def __init__(self, file: h5py.File, od: ObjectDictionary, channels: Mapping[str, bool]) -> None:
        self.rows, self.runs = 0, 0
        self._od, self._channels, self._file = od, channels, file
        self._times = {name: _growing(file, name, "i8") for name in ("tick", "run", "host_time_ns")}
        group = file.create_group("channels", track_order=True)
        self._values = {name: _growing(group, name, _dtype(od[name])) for name in channels}

    def append(self, rows: Rows) -> None:
        """Append rows."""
        times = {"tick": rows.tick, "run": rows.run, "host_time_ns": rows.time_ns}
        for name, values in times.items():
            _append(self._times[name], values)
        for name, dataset in self._values.items():
            _append(dataset, _physical(self._od[name], rows.values[name]))
        self.rows += len(rows.tick)
        if len(rows.run):
            self.runs = int(rows.run[-1]) + 1

    def describe(self) -> None:
        """Say what the datasets are."""
        self._times["tick"].attrs["units"] = "ms"
        self._times["tick"].attrs["description"] = "control cycle of the run, by the node"
        self._times["run"].attrs["units"] = "1"
        self._times["run"].attrs["description"] = "ticks began anew so often before"
        self._times["host_time_ns"].attrs["units"] = "ns"
        self._times["host_time_ns"].attrs["description"] = (
            "since 1970, when the recording computer took the row"
        )
        for name, dataset in self._values.items():
            entry = self._od[name]
            dataset.attrs["units"] = entry.unit.symbol or "1"
            dataset.attrs["resolution"] = float(entry.unit.number)
            dataset.attrs["sampling"] = _EVERY_CYCLE if self._channels[name] else _ON_CHANGE
            if name in _MEANINGS:
                dataset.attrs["meaning"] = _MEANINGS[name]


def _write_events(
    file: h5py.File, ods: Mapping[int, ObjectDictionary], events: Mapping[Kind, list[Dated]]
) -> None:
    when = "host_time_ns:i8 run:i8 tick:i8"
    markers = [(*_when(e), e.event.text) for e in events[Kind.MARKER]]
    _table(file, "markers", f"{when} text:s", markers)
    changes = []
    for dated in events[Kind.SET_POINT]:
        entry = ods[dated.event.node_id][dated.event.text]
        value = dated.event.raw * float(entry.unit.number)
        row = (dated.event.node_id, entry.name, value, entry.unit.symbol or "1")
        changes.append((*_when(dated), *row))
    _table(file, "set_points", f"{when} node_id:i8 name:s value:f8 units:s", changes)
    emergencies = [
        (*_when(e), e.event.node_id, e.event.raw, e.event.text) for e in events[Kind.EMERGENCY]
    ]
    _table(file, "emergencies", f"{when} node_id:i8 code:i8 text:s", emergencies)


def _when(dated: Dated) -> tuple[int, int, int]:
    return dated.event.time_ns, dated.run, dated.tick


def _describe(
    file: h5py.File, head: Mapping[str, Any], ods: Mapping[int, ObjectDictionary]
) -> None:
    """Write what holds for the whole recording."""
    own = ods[int(head["node_id"])]
    file.attrs["format"] = FORMAT
    for name in ("version", "created", "where", "node_id", "clocked"):
        file.attrs[name] = _storable(head[name])
    for name, value in head["identity"].items():
        file.attrs[name] = _storable(value)
    settings = [
        (name, raw * float(own[name].unit.number), own[name].unit.symbol or "1")
        for name, raw in head["settings"].items()
    ]
    _table(file, "settings", "name:s value:f8 units:s", settings)
    file["settings"].attrs["description"] = "as the recording began; calibration among them"
    group = file.create_group("object_dictionaries")
    for node_id, od in ods.items():
        group[f"node_{node_id}"] = od.text


def _dtype(entry: Entry) -> str:
    return "i8" if entry.name in _MEANINGS else "f8"


def _physical(entry: Entry, raw: Any) -> Any:
    """Return raw values in their displayed unit."""
    if entry.name in _MEANINGS:
        return raw
    values = raw * float(entry.unit.number)
    return np.where(raw == 0, np.nan, values) if entry.name in WITHOUT_CONTACT else values


def _growing(group: h5py.Group, name: str, dtype: str) -> h5py.Dataset:
    return group.create_dataset(
        name, (0,), dtype, maxshape=(None,), chunks=(_CHUNK_ROWS,), compression="gzip", shuffle=True
    )


def _append(dataset: h5py.Dataset, values: Any) -> None:
    before = len(dataset)
    dataset.resize(before + len(values), axis=0)
    dataset[before:] = values


def _table(file: h5py.File, name: str, columns: str, rows: Iterable[tuple[Any, ...]]) -> None:
    """Write a table with a column for each ``name:type``; s is text."""
    import h5py  # noqa: PLC0415 - an extra, and slow

    fields = [column.split(":") for column in columns.split()]
    text = h5py.string_dtype()
    dtype = np.dtype([(field, text if kind == "s" else kind) for field, kind in fields])
    values = [tuple(map(_storable, row)) for row in rows]
    file.create_dataset(name, data=np.array(values, dtype))


def _storable(value: Any) -> Any:
    """Return a text as HDF5 takes it, which has no NUL in texts; and anything else as it is."""
    return value.replace("\0", "\N{REPLACEMENT CHARACTER}") if isinstance(value, str) else value


_NONE: Final[Records] = np.empty(0, RECORD)
_MEANINGS: Final = {
    "Statusword": ", ".join(f"bit {s.value.bit_length() - 1} {s.name}" for s in Status)
    + f"; bits {STATE_SHIFT} to {STATE_SHIFT + 2} the state: "
    + ", ".join(f"{s.value} {s.name}" for s in State),
    "Mode display": ", ".join(f"{m.value} {m.name}" for m in Mode),
}
"""Channels that are words, not quantities."""
