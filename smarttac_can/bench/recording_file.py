"""The HDF5 file of a recording: make it from the log, and read it.

Channels have the names, the units and the NaN of the arrays of a `Trace`. Other mapped objects keep
their names. The whole file, settings included, uses the units of `SHOWN_UNITS`.

A file of format 1 has the names and units of the objects, and neither textures nor metadata. It is
read as if it were of format 2.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from decimal import Decimal
from difflib import get_close_matches
from functools import cached_property
from importlib.util import find_spec
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar, get_type_hints

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.given import said
from smarttac_can.bench.named_objects import SHOWN_UNITS, shown, shown_unit
from smarttac_can.bench.recorded_frames import (
    Emergency,
    Marker,
    Missing,
    RecordedFrames,
    RecordedTexture,
    Rows,
    SetPoint,
    texture_in,
)
from smarttac_can.bench.textures import Texture
from smarttac_can.bench.traces import COLUMNS, Floats, Integers, data_frame
from smarttac_can.bench.untrusted_hdf5 import UntrustedFile
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import EDSError
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.units import Quantity
from smarttac_can.host.files import in_words, open_regular, replacing
from smarttac_can.host.frame_log import RECORD, FrameLogReader, Records
from smarttac_can.vocabulary.states import STATE_SHIFT, Mode, State, Status
from smarttac_can.vocabulary.textures import COF_COUNT, Axis, TextureTable

if TYPE_CHECKING:
    import h5py
    import pandas

FORMAT: Final = "SMARTTAC recording 2"
_FORMAT_1: Final = "SMARTTAC recording 1"
SUFFIXES: Final = (".h5", ".hdf5")
METADATA: Final = ("subject", "operator", "notes")
"""Names of the texts with which a person describes a recording."""
_OWN: Final = "metadata."
"""Beginning of the names of attributes that hold own metadata."""
_STATUS, _MODE = "Statusword", "Mode display"
_NAMES: Final = {column.object: column.name for column in COLUMNS} | {
    "Plate temperature": "temperature_degc",
    _MODE: "mode",
}
"""Names of channels by object; other channels have the name of their object."""
_NEEDS: Final = {
    column.object: other.object
    for column in COLUMNS
    for other in COLUMNS
    if column.needs == other.name
}
"""For each object that may have no value: the object whose 0 marks this."""
_CHUNK_ROWS: Final = 8192
_NOT_OF_A_RECORDING: Final = (KeyError, TypeError, ValueError, AttributeError, OverflowError)
"""Errors raised by a head that is not that of a recording."""
_EVERY_CYCLE, _ON_CHANGE = "every cycle", "on change, held"
_NS: Final = 1_000_000_000
_PLACE_UNITS: Final = {Axis.POSITION: ("mm", 1e-6), Axis.TIME: ("s", 1e-6)}


class UnknownChannelError(BenchError, KeyError):
    """A recording has no channel of this name."""

    __str__ = BenchError.__str__  # that of a KeyError is in quotes


class Summary(NamedTuple):
    """Contents of a recording."""

    rows: int
    lost: int
    """Number of ticks missing in all gaps."""
    gaps: int
    runs: int
    """Number of runs: 1, plus 1 for each time that the ticks restarted."""
    markers: int
    set_points: int
    textures: int
    """Number of textures written to a slot, empty ones included."""
    emergencies: int
    damaged: int
    """Number of cut or damaged records of the log."""
    limited: int
    """Number of rows in which a limit of voltage, amplitude or frequency cut the drive."""


def channel_name(name: str) -> str:
    """Return the name of an object as a channel of a recording, and of a file of the panel."""
    return _NAMES.get(name, name)


def require_h5py() -> None:
    """Raise BenchError if h5py is missing; called before a recording begins."""
    if find_spec("h5py") is None:
        raise BenchError("recordings need h5py: pip install 'smarttac-can[record]'")


def require_new(path: Path) -> None:
    """Refuse a file that could not be made; called before a recording begins.

    Raises
    ------
    BenchError
        If h5py is missing, the suffix is not one of HDF5, or the file exists.
    """
    require_h5py()
    if path.suffix.lower() not in SUFFIXES:
        raise BenchError(
            f"{path}: a recording is an HDF5 file, whose suffix is {' or '.join(SUFFIXES)}: "
            f"name it {path.stem or 'run'}{SUFFIXES[0]}"
        )
    if os.path.lexists(path):
        raise BenchError(f"{path} exists: give the recording another name")


@in_words()
def make_recording(
    log: Path | str, path: Path | str, *, at_hand: Iterable[ObjectDictionary] = ()
) -> Summary:
    """Make the HDF5 file of a recording from its log, even if the recording was killed.

    Parameters
    ----------
    log
        Log of the recording; it is not changed.
    path
        File to create; it must not exist. It appears only when it is complete.
    at_hand
        Object dictionaries that need not be made from the EDS texts of the log again.

    Raises
    ------
    BenchError
        If the file exists, its suffix is not ``.h5`` or ``.hdf5``, h5py is missing, or the log is
        not that of a recording.
    OSError
        If a file cannot be read or written, for example on a full disk.
    """
    log, path = Path(log), Path(path)
    require_new(path)
    import h5py  # noqa: PLC0415 - an extra, and slow

    try:
        reader = FrameLogReader(log)
    except ValueError as error:
        raise BenchError(str(error)) from error
    try:
        with replacing(path) as part, _Disk(part, path, log) as disk:
            frames = RecordedFrames(reader.head, at_hand)
            try:
                with h5py.File(disk, "w", track_order=False) as file:
                    summary = _write(file, reader, frames, disk.check)
            finally:
                # The error of the disk is the cause, not what HDF5 raises after reading back.
                disk.check()
            os.fsync(disk.fileno())
            require_new(path)  # somebody may have made it meanwhile
    except (*_NOT_OF_A_RECORDING, EDSError) as error:
        raise BenchError(f"{log} cannot be understood: {error}") from error
    return summary


class _Disk(FileIO):
    """A file for h5py whose writes never fail, as HDF5 crashes on a full disk.

    Parameters
    ----------
    part
        Temporary file to write.
    path
        Final name of the file, for the error message.
    log
        Log from which the file is made, for the error message.
    """

    def __init__(self, part: Path, path: Path, log: Path) -> None:
        super().__init__(part, "x+")
        self._path = path
        self._log = log
        self._error: OSError | None = None
        self._kept: list[tuple[int, bytes]] = []
        """Offset and data of each refused write; only those between two calls of `check`."""

    def write(self, data: Any) -> int:
        """Write all data, or keep it in memory once a write has failed."""
        at, left = self.tell(), memoryview(data).cast("B")
        try:
            while len(left) and self._error is None:
                left = left[self._put(left) :]
        except OSError as error:
            self._error = error
        if self._error is not None:
            self._kept.append((at, bytes(memoryview(data).cast("B"))))
        return memoryview(data).nbytes

    def _put(self, data: memoryview) -> int:
        return super().write(data)

    def readinto(self, buffer: Any) -> int:
        """Read what was written, on disk or kept in memory; HDF5 crashes on a short read."""
        begin, view = self.tell(), memoryview(buffer).cast("B")
        found = super().readinto(view) or 0
        view[found:] = bytes(len(view) - found)
        for at, data in self._kept:
            first, end = max(at, begin), min(at + len(data), begin + len(view))
            if first < end:
                view[first - begin : end - begin] = data[first - at : end - at]
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the size."""
        try:
            if self._error is None:
                super().truncate(size)
        except OSError as error:
            self._error = error
        return size or 0

    def check(self) -> None:
        """Raise the error of the first failed write."""
        if self._error is not None:
            cure = f"make room, or name a file on another disk; {self._log} stays as it is"
            raise OSError(self._error.errno, f"{self._error.strerror}: {cure}", str(self._path))


def _write(
    file: h5py.File, reader: FrameLogReader, frames: RecordedFrames, check: Callable[[], None]
) -> Summary:
    """Write all contents; `check` raises the error of a failed write."""
    own = frames.ods[int(reader.head["node_id"])]
    columns = _Columns(file, own, frames.channels)
    for records in reader.chunks():
        columns.append(frames.take(records))
        check()
    columns.append(frames.take(_NONE, last=True))
    columns.describe()
    _describe(file, reader.head, frames.ods)
    _table(file, "gaps", Missing, frames.gaps)
    found: dict[type[Any], list[Any]] = {
        kind: [event for event in frames.events if isinstance(event, kind)]
        for kind in (Marker, SetPoint, Emergency, RecordedTexture)
    }
    _table(file, "markers", Marker, found[Marker])
    _table(file, "set_points", SetPoint, found[SetPoint])
    _table(file, "emergencies", Emergency, found[Emergency])
    _write_textures(file, [*_textures_before(reader.head), *found[RecordedTexture]])
    return Summary(
        rows=columns.rows,
        lost=sum(gap.ticks for gap in frames.gaps),
        gaps=len(frames.gaps),
        runs=columns.runs,
        markers=len(found[Marker]),
        set_points=len(found[SetPoint]),
        textures=len(found[RecordedTexture]),
        emergencies=len(found[Emergency]),
        damaged=reader.damaged,
        limited=columns.limited,
    )


class _Columns:
    def __init__(self, file: h5py.File, od: ObjectDictionary, channels: Mapping[str, bool]) -> None:
        self.rows = self.runs = self.limited = 0
        self._od, self._channels, self._file = od, channels, file
        self._times = {name: _growing(file, name, "i8") for name in ("tick", "run", "host_time_ns")}
        group = file.create_group("channels", track_order=True)
        self._values = {
            name: _growing(group, channel_name(name), _dtype(od[name])) for name in channels
        }

    def append(self, rows: Rows) -> None:
        """Append rows to all datasets."""
        times = {"tick": rows.tick, "run": rows.run, "host_time_ns": rows.time_ns}
        for name, values in times.items():
            _append(self._times[name], values)
        for name, dataset in self._values.items():
            _append(dataset, _in_unit(self._od[name], rows.values))
        self.rows += len(rows.tick)
        if _STATUS in rows.values:
            self.limited += int(np.count_nonzero(rows.values[_STATUS] & Status.LIMITED))
        if len(rows.run):
            self.runs = int(rows.run[-1]) + 1

    def describe(self) -> None:
        """Write the attributes of the datasets."""
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
            dataset.attrs["units"] = shown_unit(entry) or "1"
            dataset.attrs["resolution"] = shown(entry, 1)
            dataset.attrs["object"] = name
            dataset.attrs["sampling"] = _EVERY_CYCLE if self._channels[name] else _ON_CHANGE
            if name in _MEANINGS:
                dataset.attrs["meaning"] = _MEANINGS[name]


def _textures_before(head: Mapping[str, Any]) -> Iterator[RecordedTexture]:
    """Yield the textures that were in a slot at first."""
    began = int(datetime.fromisoformat(head["created"]).timestamp()) * _NS
    # Logs of version 0.1.0 and before do not have them.
    for slot, table in head.get("textures", {}).items():
        yield RecordedTexture(began, 0, -1, int(slot), True, *texture_in(bytes.fromhex(table)))


def _write_textures(file: h5py.File, textures: Iterable[RecordedTexture]) -> None:
    group = file.create_group("textures", track_order=True)
    group.attrs["description"] = "COF of tables of textures; before is 1 of those there before"
    for number, recorded in enumerate(textures):
        table = None if recorded.texture is None else recorded.texture.table
        values = np.array(() if table is None else table.values) * COF_COUNT
        attrs = group.create_dataset(str(number), data=values).attrs
        attrs["units"], attrs["slot"], attrs["before"] = "1", recorded.slot, int(recorded.before)
        attrs["host_time_ns"], attrs["run"], attrs["tick"] = recorded[:3]
        attrs["complete"] = int(recorded.complete)
        if table is not None:
            unit, count = _PLACE_UNITS[table.axis]
            attrs["axis"], attrs["axis_units"] = table.axis.name.lower(), unit
            attrs["start"], attrs["step"] = table.start * count, table.step * count
            attrs["repeats"] = int(table.repeats)


def _describe(
    file: h5py.File, head: Mapping[str, Any], ods: Mapping[int, ObjectDictionary]
) -> None:
    own = ods[int(head["node_id"])]
    file.attrs["format"] = FORMAT
    for name in ("version", "created", "where", "node_id"):
        file.attrs[name] = _storable(head[name])
    # How HDF5 names True is a setting of h5py, as is the order of members where it is not given.
    file.attrs["clocked"] = int(head["clocked"])
    # Logs of version 0.1.0 and before have no metadata.
    given = head.get("metadata", {})
    for name in METADATA:
        file.attrs[name] = _storable(str(given.get(name, "")))
    for name, value in given.items():
        if name not in METADATA:
            file.attrs[_OWN + _storable(name)] = _storable(value)
    for name, value in head["identity"].items():
        file.attrs[name] = _storable(value)
    settings = [
        _Setting(name, shown(own[name], raw), shown_unit(own[name]) or "1")
        for name, raw in head["settings"].items()
    ]
    _table(file, "settings", _Setting, settings)
    file["settings"].attrs["description"] = "as the recording began; calibration among them"
    group = file.create_group("object_dictionaries", track_order=False)
    for node_id, od in ods.items():
        group[f"node_{node_id}"] = od.text


def _dtype(entry: Entry) -> str:
    return "i8" if entry.name in _MEANINGS else "f8"


def _in_unit(entry: Entry, raw: Mapping[str, Integers]) -> Any:
    """Return the values of an object in the unit of the file, NaN where there is no value."""
    if entry.name in _MEANINGS:
        return raw[entry.name]
    values = shown(entry, raw[entry.name])
    # A different PDO mapping may lack the object on which the value depends.
    needed = raw.get(_NEEDS.get(entry.name, ""))
    return values if needed is None else np.where(needed == 0, np.nan, values)


def _growing(group: h5py.Group, name: str, dtype: str) -> h5py.Dataset:
    return group.create_dataset(
        name, (0,), dtype, maxshape=(None,), chunks=(_CHUNK_ROWS,), compression="gzip", shuffle=True
    )


def _append(dataset: h5py.Dataset, values: Any) -> None:
    before = len(dataset)
    dataset.resize(before + len(values), axis=0)
    dataset[before:] = values


class _Setting(NamedTuple):
    name: str
    value: float
    units: str


_Row = TypeVar("_Row", bound=NamedTuple)


def _table(file: h5py.File, name: str, kind: type[_Row], rows: Sequence[_Row]) -> None:
    """Write a table with a column for each field of its rows."""
    import h5py  # noqa: PLC0415 - an extra, and slow

    types = {int: "i8", float: "f8", str: h5py.string_dtype()}
    dtype = np.dtype([(field, types[hint]) for field, hint in get_type_hints(kind).items()])
    values = [tuple(map(_storable, row)) for row in rows]
    file.create_dataset(name, data=np.array(values, dtype))


def _storable(value: Any) -> Any:
    """Return a text as HDF5 accepts it, in UTF-8 without NUL; other values unchanged."""
    if not isinstance(value, str):
        return value
    return value.encode(errors="replace").decode().replace("\0", "\N{REPLACEMENT CHARACTER}")


_NONE: Final[Records] = np.empty(0, RECORD)
_MEANINGS: Final = {
    _STATUS: ", ".join(f"bit {s.value.bit_length() - 1} {s.name}" for s in Status)
    + f"; bits {STATE_SHIFT} to {STATE_SHIFT + 2} the state: "
    + ", ".join(f"{s.value} {s.name}" for s in State),
    _MODE: ", ".join(f"{m.value} {m.name}" for m in Mode),
}
"""Channels with codes instead of quantities, and what the codes mean."""


@dataclass(frozen=True, eq=False, repr=False)
class RecordedData:
    """Contents of the file of a recording, from `read_recording`. All arrays are read-only."""

    path: Path
    """Path of the file."""
    channels: Mapping[str, npt.NDArray[Any]]
    """An array per channel with an element per row. Names are those of the arrays of a `Trace`,
    such as ``cof`` and ``amplitude_um``, then ``mode``, ``temperature_degc``, names of objects."""
    units: Mapping[str, str]
    """Unit of each channel; 1 for pure numbers."""
    tick: Integers
    """Control cycle of each row in ms; increases within a run."""
    run: Integers
    """Number of restarts of the ticks before each row."""
    host_time_ns: Integers
    """Time when the recording computer received each row, in ns since 1970."""
    markers: list[Marker]
    set_points: list[SetPoint]
    emergencies: list[Emergency]
    gaps: list[Missing]
    textures: list[RecordedTexture]
    settings: Mapping[str, tuple[float, str]]
    """Value and unit by object of all settings at the beginning of the recording."""
    metadata: Mapping[str, str | float]
    """Texts by the names in `METADATA`, empty if not given, and own keys."""
    attributes: Mapping[str, Any]
    """Attributes of the file: format, version, identity of the node, and so on."""

    def __len__(self) -> int:
        return len(self.tick)

    @property
    def limited(self) -> int:
        """Number of rows in which a limit of voltage, amplitude or frequency cut the drive."""
        if "status" not in self.channels:
            return 0
        return int(np.count_nonzero(self.channels["status"] & Status.LIMITED))

    def __repr__(self) -> str:
        lost = sum(gap.ticks for gap in self.gaps)
        return (
            f"<RecordedData {str(self.path)!r}: {len(self)} rows of 1 ms, {lost} lost, "
            f"{self.limited} limited; "
            f"markers {len(self.markers)}, set-points {len(self.set_points)}>"
        )

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """Return the array of a channel.

        Raises
        ------
        UnknownChannelError
            If the recording has no such channel; it is a `KeyError`, too.
        """
        if name not in self.channels:
            near = get_close_matches(str(name), self.channels, 1)
            hint = f", perhaps {near[0]}" if near else ""
            raise UnknownChannelError(
                f"there is no channel {said(name)}{hint}: it has {', '.join(self.channels)}"
            )
        return self.channels[name]

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    @cached_property
    def time_s(self) -> Floats:
        """Time of each row in s since its run began."""
        values = np.asarray(self.tick / 1000)
        values.setflags(write=False)
        return values

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row per tick: time, run, tick, host time, channels; needs pandas."""
        when = {"time_s": self.time_s, "run": self.run, "tick": self.tick}
        arrays = when | {"host_time_ns": self.host_time_ns} | dict(self.channels)
        units = {"time_s": "s", "run": "1", "tick": "ms", "host_time_ns": "ns"} | dict(self.units)
        return data_frame(arrays, {**self.metadata, "units": units})


@in_words()
def read_recording(path: Path | str) -> RecordedData:
    """Read the HDF5 file of a recording, of this or an older format.

    Raises
    ------
    BenchError
        If h5py is missing, or the file is not that of a recording.
    OSError
        If the file is not a regular file, or cannot be read.
    """
    require_h5py()
    import h5py  # noqa: PLC0415 - an extra, and slow

    path = Path(path)
    with open_regular(path) as disk:
        try:
            with h5py.File(disk, "r") as file:
                return _read(path, UntrustedFile(file, os.fstat(disk.fileno()).st_size))
        except (*_NOT_OF_A_RECORDING, OSError, RuntimeError) as error:  # as h5py names damage
            raise BenchError(f"{path} is no recording that can be read: {error}") from error
        except MemoryError as error:
            raise BenchError(f"{path} needs more memory than there is") from error


def _read(path: Path, file: UntrustedFile) -> RecordedData:
    attributes = file.attributes()
    if attributes.get("format") not in (FORMAT, _FORMAT_1):
        raise ValueError(f"its format is not {FORMAT!r} or older")
    current = _current_1 if attributes["format"] == _FORMAT_1 else _as_it_is
    times = _read_times(file)
    rows = len(times["tick"])
    channels, units = {}, {}
    for stored_name, data in file.members("channels"):
        if data.shape != (rows,):
            raise ValueError(f"{data.name} has the shape {data.shape} beside {rows} ticks")
        name = channel_name(stored_name)
        scale, units[name] = current(str(file.attributes(data)["units"]))
        channels[name] = file.numbers(data) if scale == 1.0 else file.numbers(data) * scale
    if current is _current_1 and {"cof", "position_mm"} <= channels.keys():
        channels["position_mm"][np.isnan(channels["cof"])] = np.nan
    for values in (*channels.values(), *times.values()):
        values.setflags(write=False)
    set_points = []
    for row in file.table(file.dataset("set_points"), SetPoint):
        scale, unit = current(row.units)
        set_points.append(row._replace(value=row.value * scale, units=unit))
    settings = {}
    for setting in file.table(file.dataset("settings"), _Setting):
        scale, unit = current(setting.units)
        settings[setting.name] = setting.value * scale, unit
    return RecordedData(
        path=path,
        channels=channels,
        units=units,
        **times,
        markers=file.table(file.dataset("markers"), Marker),
        set_points=set_points,
        emergencies=file.table(file.dataset("emergencies"), Emergency),
        gaps=file.table(file.dataset("gaps"), Missing),
        textures=[_read_texture(file, data) for _, data in file.members("textures")],
        settings=settings,
        metadata={
            **{name: str(attributes.get(name, "")) for name in METADATA},
            **{n.removeprefix(_OWN): v for n, v in attributes.items() if n.startswith(_OWN)},
        },
        attributes=attributes,
    )


def _read_times(file: UntrustedFile) -> dict[str, Integers]:
    """Return when each row was; ValueError if the rows are not in the order of time."""
    times = {
        name: file.numbers(file.dataset(name), "i") for name in ("tick", "run", "host_time_ns")
    }
    tick, run = times["tick"], times["run"]
    sizes = {len(values) for values in times.values()}
    if len(sizes) > 1:
        raise ValueError("tick, run and host_time_ns differ in their number of rows")
    if np.any(run[1:] < run[:-1]) or np.any((tick[1:] <= tick[:-1]) & (run[1:] == run[:-1])):
        raise ValueError("its ticks run backwards")
    return times


def _read_texture(file: UntrustedFile, data: h5py.Dataset) -> RecordedTexture:
    attrs = file.attributes(data)
    texture = None
    if "axis" in attrs:
        axis = Axis[attrs["axis"].upper()]
        _, count = _PLACE_UNITS[axis]
        start, step = round(attrs["start"] / count), round(attrs["step"] / count)
        values = tuple(int(count) for count in np.round(file.numbers(data) / COF_COUNT).tolist())
        texture = Texture(TextureTable(axis, bool(attrs["repeats"]), start, step, values))
    when = (attrs["host_time_ns"], attrs["run"], attrs["tick"], attrs["slot"])
    return RecordedTexture(*when, bool(attrs["before"]), bool(attrs["complete"]), texture)


def _as_it_is(units: str) -> tuple[float, str]:
    return 1.0, units


def _current_1(units: str) -> tuple[float, str]:
    """Return the factor that converts a value of format 1, and its unit after that."""
    if units not in SHOWN_UNITS:
        return 1.0, units
    return Quantity(Decimal(1), units).in_unit(SHOWN_UNITS[units]), SHOWN_UNITS[units]
