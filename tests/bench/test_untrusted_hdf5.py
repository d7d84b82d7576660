"""Files under false names: `read_recording` refuses each in one line.

Each of them is a sound recording in which one thing was replaced.
"""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from smarttac_can.bench import BenchError, Stimulator, read_recording
from smarttac_can.bench.recorded_frames import Marker
from smarttac_can.bench.untrusted_hdf5 import UntrustedFile

ROWS = 50
Change = Callable[[h5py.File], Any]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "sound.h5"
    with Stimulator.simulate() as bench, bench.record(path):
        bench.run(ROWS / 1000)
        bench.mark("here")
    return path


def replaced(name: str, **what: Any) -> Change:
    """Return a change that makes a dataset anew, with the attributes that it had."""

    def change(file: h5py.File) -> None:
        attributes = dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, **what).attrs.update(attributes)

    return change


def linked(name: str, link: Any) -> Change:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = link

    return change


def elsewhere(path: Path | str, rows: int = ROWS) -> Change:
    """Return a change that makes a channel of the bytes of another file."""
    external = [(str(path), 0, h5py.h5f.UNLIMITED)]
    return replaced("channels/cof", shape=(rows,), dtype="f8", external=external)


def virtual(path: Path) -> Change:
    def change(file: h5py.File) -> None:
        layout = h5py.VirtualLayout((ROWS,), "f8")
        layout[:] = h5py.VirtualSource(path, "channels/cof", (ROWS,))
        attributes = dict(file["channels/cof"].attrs)
        del file["channels/cof"]
        file.create_virtual_dataset("channels/cof", layout).attrs.update(attributes)

    return change


def backwards(name: str) -> Change:
    return lambda file: file[name].__setitem__(slice(None), file[name][:][::-1].copy())


HOSTILE: dict[str, tuple[Change, str]] = {
    "a file": (elsewhere("/etc/hostname", 1), "shape"),
    "a file of as many rows": (elsewhere("/etc/passwd"), "is in another file"),
    "an endless file": (elsewhere("/dev/zero"), "is in another file"),
    "an external link": (
        linked("channels/cof", h5py.ExternalLink("/etc/hostname", "/")),
        "not in the file itself",
    ),
    "a group by an external link": (
        linked("textures", h5py.ExternalLink("/etc/hostname", "/")),
        "not in the file itself",
    ),
    "a soft link": (linked("channels/cof", h5py.SoftLink("/tick")), "not in the file itself"),
    "a group": (lambda file: file.create_group("channels/x"), "is no dataset"),
    "one dataset twice": (
        lambda file: file["channels"].__setitem__("x", file["channels/cof"]),
        "the same dataset as another",
    ),
    "a filter of another library": (
        replaced("channels/cof", data=np.zeros(ROWS), chunks=(ROWS,), compression="lzf"),
        "a filter other than",
    ),
    "a large chunk": (
        replaced("channels/cof", shape=(ROWS,), dtype="f8", chunks=(1 << 22,), maxshape=(None,)),
        "has chunks of 33554432 bytes",
    ),
    "no data": (replaced("channels/cof", shape=(ROWS,), dtype="f8"), "too short for 50 elements"),
    "few values": (replaced("channels/cof", data=np.zeros(3)), "shape (3,) beside 50 ticks"),
    "no ticks beside values": (replaced("tick", data=np.zeros(0, "i8")), "number of rows"),
    "one number": (replaced("channels/cof", data=1.0), "has the shape ()"),
    "a table of numbers": (replaced("channels/cof", data=np.zeros((ROWS, 2))), "has the shape"),
    "ticks in two dimensions": (replaced("tick", data=np.zeros((ROWS, 2), "i8")), "2 dimensions"),
    "ticks that are no integers": (replaced("tick", data=np.arange(float(ROWS))), "of type"),
    "ticks backwards": (backwards("tick"), "ticks run backwards"),
    "ticks that stand still": (
        replaced("tick", data=np.zeros(ROWS, "i8")),
        "ticks run backwards",
    ),
    "runs backwards": (replaced("run", data=np.arange(ROWS)[::-1]), "ticks run backwards"),
    "texts as COF": (
        replaced(
            "channels/cof", data=np.array([b"x"] * ROWS, dtype=object), dtype=h5py.string_dtype()
        ),
        "elements of type object",
    ),
    "complex numbers": (replaced("channels/cof", data=np.zeros(ROWS, "c8")), "of type complex64"),
    "a table without its columns": (replaced("markers", data=np.zeros(3)), "has no column"),
    "a table of other columns": (
        replaced(
            "gaps",
            data=np.zeros(1, [(name, "f8") for name in ("run", "first", "last", "ticks")]),
        ),
        "has no column",
    ),
    "many attributes in one": (
        lambda file: file.attrs.__setitem__("notes", np.zeros(9)),
        "attribute notes is no number and no text",
    ),
    "no units": (lambda file: file["channels/cof"].attrs.__delitem__("units"), "units"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused(sound: Path, tmp_path: Path, name: str) -> None:
    change, why = HOSTILE[name]
    path = tmp_path / "run.h5"
    shutil.copy(sound, path)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(BenchError) as caught:
        read_recording(path)
    said = str(caught.value)
    assert said.startswith(f"{path} is no recording that can be read: ")
    assert why in said
    assert "\n" not in said


def test_one_text_of_many_rows_is_refused(sound: Path, tmp_path: Path) -> None:
    """The file holds it once, and each row refers to it: 2 GB of text in 1 MB."""
    path, rows, text = tmp_path / "run.h5", 2000, "x" * 1_000_000
    shutil.copy(sound, path)
    column = {"host_time_ns": "i8", "run": "i8", "tick": "i8", "text": h5py.string_dtype()}
    assert set(column) == set(Marker._fields)
    with h5py.File(path, "r+") as file:
        del file["markers"]
        data = np.array(
            [(0, 0, 0, text), *[(0, 0, 0, "y")] * (rows - 1)], np.dtype([*column.items()])
        )
        table = file.create_dataset("markers", data=data)
        offset, size = table.id.get_offset(), table.id.get_storage_size() // rows
    content = bytearray(path.read_bytes())
    first = content[offset : offset + size]
    content[offset : offset + rows * size] = first * rows
    path.write_bytes(content)
    with pytest.raises(BenchError, match=r"run\.h5 is no recording .*: its texts are longer than"):
        read_recording(path)


def test_data_longer_than_the_file_are_refused(sound: Path) -> None:
    """Chunks that share their bytes hold more than the file."""
    with h5py.File(sound) as file:
        stored = file["tick"].id.get_storage_size() + file["run"].id.get_storage_size()
        for size, refused in ((stored, False), (stored - 1, True)):
            reader = UntrustedFile(file, size)
            reader.numbers(reader.dataset("tick"))
            if refused:
                with pytest.raises(ValueError, match="too short for 50 elements"):
                    reader.numbers(reader.dataset("run"))
            else:
                assert len(reader.numbers(reader.dataset("run"))) == ROWS


def test_read_recording_refuses_files_beyond_its_memory(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def exhausted(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(UntrustedFile, "numbers", exhausted)
    with pytest.raises(BenchError, match="needs more memory than there is"):
        read_recording(sound)


def test_a_sound_file_is_read(sound: Path) -> None:
    recording = read_recording(sound)
    assert len(recording) == ROWS
    assert [marker.text for marker in recording.markers] == ["here"]
