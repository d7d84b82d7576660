"""The file of a recording is read in a line, has textures and metadata, and full disks say so."""

import errno
import importlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from shutil import copy
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from commands import refusal, run, succeed
from nodes_on_a_bus import until

from smarttac_can.bench import (
    BenchError,
    RecordedData,
    Stimulator,
    Texture,
    make_recording,
    read_recording,
    recording_file,
)
from smarttac_can.host.frame_log import FrameLog
from smarttac_can.vocabulary.states import Status

GRATING = Texture.grating(2.0, 0.25, 0.45, shape="sine")
RAMP = Texture.profile("ramp", 0.2, 0.4, 0.05)
LONG = Texture.profile([(0.001 * k, 0.2 + 0.01 * (k % 30)) for k in range(4000)])


def played(bench: Stimulator, path: Path) -> RecordedData:
    bench.texture_slot = 4
    bench.texture = RAMP
    with bench.record(path, subject="P07", operator="jd", notes="dry\nfinger") as recording:
        bench.run(0.05)
        bench.texture_slot = 2
        bench.texture = GRATING
        bench.mark("begin")
        bench.run(0.05)
        bench.texture = LONG
        bench.texture_slot = 4
        bench.texture = None
    assert recording.summary is not None
    assert recording.summary.textures == 3
    return read_recording(path)


def test_textures_of_every_link_are_in_it(bench: Stimulator, tmp_path: Path) -> None:
    bench.start_run()
    recording = played(bench, tmp_path / "run.h5")
    found = [(t.slot, t.run, t.tick, t.before, t.texture) for t in recording.textures]
    assert found == [
        (4, 0, -1, True, RAMP),
        (2, 0, 49, False, GRATING),
        (2, 0, 99, False, LONG),
        (4, 0, 99, False, None),
    ]
    assert all(texture.complete for texture in recording.textures)
    times = [texture.host_time_ns for texture in recording.textures]
    assert times == sorted(times)
    assert recording.host_time_ns[0] < times[1] <= recording.markers[0].host_time_ns


def test_textures_are_read_without_this_package(tmp_path: Path) -> None:
    with Stimulator.simulate("local") as bench:
        played(bench, tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as file:
        tables = list(file["textures"].values())
        table = tables[1]
        assert {name: table.attrs[name] for name in ("slot", "axis", "axis_units")} == {
            "slot": 2,
            "axis": "position",
            "axis_units": "mm",
        }
        assert (table.attrs["start"], table.attrs["repeats"]) == (0.0, 1)
        assert table.attrs["step"] * len(table) == pytest.approx(2.0)
        places = table.attrs["start"] + table.attrs["step"] * np.arange(len(table))
        np.testing.assert_allclose(table[:], GRATING.cof(places))
        assert (tables[0].attrs["axis"], tables[0].attrs["axis_units"]) == ("time", "s")
        assert len(tables[3]) == 0


def test_a_texture_that_was_refused_is_not_in_it(tmp_path: Path) -> None:
    with Stimulator.simulate() as bench, bench.record(tmp_path / "run.h5") as recording:
        with pytest.raises(BenchError):
            bench._link.write("Texture table.Table 1", GRATING.table.pack()[:-1])
        bench.run(0.01)
    assert recording.summary is not None
    assert recording.summary.textures == 0


def test_a_texture_of_which_frames_were_not_heard_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hear = FrameLog.frame

    def deaf(log: FrameLog, can_id: int, data: bytes) -> None:
        if (can_id, data[0]) != (0x620, 7):
            hear(log, can_id, data)

    monkeypatch.setattr(FrameLog, "frame", deaf)
    with Stimulator.simulate() as bench, bench.record(tmp_path / "run.h5"):
        bench.run(0.01)
        bench.texture = GRATING
        bench.texture = RAMP
        bench.texture = None
    lost, short, emptied = read_recording(tmp_path / "run.h5").textures
    assert (lost.slot, lost.complete, lost.texture) == (1, False, None)
    assert (short.slot, short.complete, short.texture) == (1, False, None)
    assert (emptied.complete, emptied.texture) == (True, None)


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_arrays_with_the_names_and_units_of_a_trace(bench: Stimulator, tmp_path: Path) -> None:
    bench.finger.stroke(2)
    bench.start_run()
    bench.tare()
    bench.amplitude = 1.0
    bench.mode = "friction"
    with bench.record(tmp_path / "run.h5"):
        trace = bench.run(0.6)
        bench.mark("end")
    recording = read_recording(tmp_path / "run.h5")
    frame = trace.to_dataframe()
    for name in frame.columns:
        values = recording.time_s if name == "time_s" else recording[name]
        np.testing.assert_array_equal(values, frame[name], err_msg=name)
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1
    # No contact is not a number everywhere.
    assert 0 < np.isnan(recording["cof"]).sum() < len(recording)
    assert recording.units["normal_force_n"] == "N"
    assert [(marker.tick, marker.text) for marker in recording.markers] == [(trace.tick[-1], "end")]
    table = recording.to_dataframe()
    pd.testing.assert_frame_equal(table[list(frame.columns)], frame)
    assert table.attrs["units"]["amplitude_um"] == "um"
    assert list(table.columns[:4]) == ["time_s", "run", "tick", "host_time_ns"]
    limited = np.count_nonzero(trace.status & Status.LIMITED)
    assert repr(recording).startswith(
        f"<RecordedData '{tmp_path / 'run.h5'}': 600 rows of 1 ms, 0 lost, {limited} limited; "
    )


def test_set_points_and_settings_have_the_units_of_the_trace(tmp_path: Path) -> None:
    with Stimulator.simulate("local") as bench, bench.record(tmp_path / "run.h5"):
        bench.run(0.01)
        bench.amplitude = 1.25
        bench.boundary = -3.5
        bench.voltage = 30
    recording = read_recording(tmp_path / "run.h5")
    changes = {c.name: (pytest.approx(c.value), c.units) for c in recording.set_points}
    assert changes == {
        "Setpoint.Amplitude": (1.25, "um"),
        "Setpoint.Boundary": (-3.5, "mm"),
        "Setpoint.Voltage": (30.0, "V"),
    }
    assert recording.settings["Limit.Voltage"] == (pytest.approx(150.0), "V")


def test_metadata(tmp_path: Path) -> None:
    with Stimulator.simulate("local") as bench:
        recording = played(bench, tmp_path / "run.h5")
        assert recording.metadata == {"subject": "P07", "operator": "jd", "notes": "dry\nfinger"}
        assert recording.attributes["subject"] == "P07"
        for text in (7, "x" * 1001):
            with pytest.raises(ValueError, match=r"notes .* is no text of 0 to 1000 characters"):
                bench.record(tmp_path / "b.h5", notes=text)  # type: ignore[arg-type]
        with bench.record(tmp_path / "none.h5"):
            bench.run(0.01)
    said = read_recording(tmp_path / "none.h5").metadata
    assert said == {"subject": "", "operator": "", "notes": ""}


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """``smarttac record`` on a stimulator that runs by itself."""

    def connect(**_: Any) -> Stimulator:
        bench = Stimulator.simulate()
        command = importlib.import_module("smarttac_can.cli.recording")
        monkeypatch.setattr(command, "sleep", lambda _: bench.run(0.05))
        return bench

    monkeypatch.setattr(Stimulator, "connect", connect)


def test_own_metadata_of_a_recording_is_read_back(tmp_path: Path) -> None:
    own = {"humidity_percent": 45, "temperature": 21.5, "sample": "PMMA \N{GREEK SMALL LETTER MU}"}
    path = tmp_path / "run.h5"
    with Stimulator.simulate("local") as bench:
        given = {**own, "humidity_percent": np.int64(45)}
        with bench.record(path, subject="P07", metadata=given):
            bench.run(0.01)
        read = read_recording(path)
        assert read.metadata == {"subject": "P07", "operator": "", "notes": "", **own}
        assert read.to_dataframe().attrs["sample"] == own["sample"]
        for wrong, text in (
            (
                {"subject": "x"},
                "^subject is an argument of record: give it there, not in metadata$",
            ),
            ({"sample": None}, "^sample None is not a finite number$"),
            ({3: "x"}, "^key of the metadata 3 is no text of 1 to 100 characters$"),
            (["x"], r"^metadata \['x'\] is no mapping of up to 100 keys$"),
        ):
            with pytest.raises(ValueError, match=text):
                bench.record(tmp_path / "b.h5", metadata=wrong)  # type: ignore[arg-type]


def test_limited_rows_of_a_recording_are_counted(tmp_path: Path) -> None:
    with Stimulator.simulate("local", subject=2) as bench:
        touched(bench, cof=2.0)
        with bench.record(tmp_path / "run.h5") as recording:
            trace = bench.run(0.5)
    read = read_recording(tmp_path / "run.h5")
    assert recording.summary is not None
    assert trace.limited == recording.summary.limited == read.limited > 250
    assert repr(recording).endswith(f" rows of 1 ms, 0 lost, {trace.limited} limited>")


def test_a_recording_that_goes_on_is_looked_into_by_a_copy(tmp_path: Path) -> None:
    with Stimulator.simulate("local") as bench, bench.record(tmp_path / "run.h5") as recording:
        bench.run(0.2)
        recording.check()
        until(lambda: make_recording(recording.log_path, new_copy(tmp_path)).rows == 200)
        bench.run(0.1)
    assert recording.summary is not None
    assert recording.summary.rows == 300


def new_copy(folder: Path) -> Path:
    copy = folder / "copy.h5"
    copy.unlink(missing_ok=True)
    return copy


def touched(bench: Stimulator, cof: float) -> None:
    """Regulate the friction of a finger that strokes."""
    bench.finger.stroke(2)
    bench.start_run()
    bench.tare()
    bench.amplitude = 1.0
    bench.cof = cof
    bench.mode = "friction"


@pytest.mark.usefixtures("simulated")
def test_metadata_of_the_command(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    said = ["--subject", "P07", "--operator", "jd", "--notes", "dry"]
    succeed("record", path, "--seconds", "0.1", *said)
    recording = read_recording(path)
    assert recording.metadata == {"subject": "P07", "operator": "jd", "notes": "dry"}
    line = refusal("record", tmp_path / "b.h5", "--notes", "x" * 1001)
    assert "is no text of 0 to 1000 characters" in line


@pytest.mark.parametrize("name", ["x.csv", "x", "x.h5.gz"])
def test_another_suffix_is_refused_with_the_one_it_needs(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    better = r"whose suffix is \.h5 or \.hdf5: name it x(\.h5)?\.h5"
    with (
        Stimulator.simulate("local") as bench,
        pytest.raises(BenchError, match=better),
        bench.record(path),
    ):
        pass
    with pytest.raises(BenchError, match=better):
        make_recording(tmp_path / "x.log", path)
    assert "whose suffix is .h5 or .hdf5" in refusal("record", path, "--interface", "virtual")
    assert list(tmp_path.iterdir()) == []


def test_read_recording_refuses_files_of_another_format(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    with pytest.raises(FileNotFoundError, match="there is no such file"):
        read_recording(path)
    path.write_bytes(b"rubbish")
    with pytest.raises(BenchError, match=r"x\.h5 is no recording that can be read"):
        read_recording(path)
    with h5py.File(path, "w") as file:
        file["x"] = 1
    with pytest.raises(BenchError, match=r"x\.h5 is no recording that can be read: its format"):
        read_recording(path)


@pytest.mark.parametrize("text", ["\ud800", "caf\udce9"])
def test_a_text_that_no_file_holds_is_refused_before(tmp_path: Path, text: str) -> None:
    """As bytes of a shell that are no UTF-8: of the log no file could be made."""
    path = tmp_path / "run.h5"
    said = r"has characters that UTF-8 does not have$"
    with Stimulator.simulate("local") as bench:
        for name in ("subject", "operator", "notes"):
            with pytest.raises(ValueError, match=rf"^{name} .* {said}"):
                bench.record(path, **{name: text})
        with bench.record(path):
            bench.run(0.01)
            with pytest.raises(ValueError, match=rf"^marker .* {said}"):
                bench.mark(text)
    assert read_recording(path).markers == []


def test_a_log_with_such_a_text_is_made_into_a_file(tmp_path: Path) -> None:
    """Former versions took it."""
    with Stimulator.simulate("local") as bench:
        recording = bench.record(tmp_path / "run.h5")
        recording._metadata["notes"] = "caf\udce9"
        with recording:
            bench.run(0.01)
    assert read_recording(tmp_path / "run.h5").metadata["notes"] == "caf?"


def test_a_dataset_that_says_it_is_huge_takes_no_memory(tmp_path: Path) -> None:
    """As one bit of its shape that is wrong."""
    path = tmp_path / "run.h5"
    with Stimulator.simulate("local") as bench, bench.record(path):
        bench.run(0.01)
    with h5py.File(path, "r+") as file:
        file["tick"].resize((10**13,))
    with pytest.raises(BenchError, match=r"tick is too short for 10000000000000 elements$"):
        read_recording(path)


def test_a_long_recording_of_nothing_is_read(tmp_path: Path) -> None:
    """It compresses as well as anything does."""
    path = tmp_path / "run.h5"
    with Stimulator.simulate("local") as bench, bench.record(path):
        bench.run(0.01)
    with h5py.File(path, "r+") as file:
        times = (file[name] for name in ("tick", "run", "host_time_ns"))
        for data in (*times, *file["channels"].values()):
            data.resize((20_000,))
            data[:] = 0
        file["tick"][:] = range(20_000)
    assert len(read_recording(path)) == 20_000


def test_reprs(tmp_path: Path) -> None:
    with Stimulator.simulate("local") as bench:
        recording = bench.record(tmp_path / "run.h5")
        assert repr(recording) == f"<Recording '{tmp_path / 'run.h5'}': not being recorded>"
        with recording:
            bench.run(0.02)
            assert repr(recording).endswith("run.h5': 20 cycles of 1 ms so far>")
        assert repr(recording).endswith("run.h5': 20 rows of 1 ms, 0 lost, 0 limited>")
        reading = bench.read()
    assert repr(reading) == (
        f"<Reading of 0.000 s ago: NOT_READY, mode OFF, status LIVE; no contact, "
        f"Ft {reading.tangential_force:.3f} N, Fn {reading.normal_force:.3f} N, "
        f"{reading.amplitude:.4f} um, 0.00 V, 43390.00 Hz, 20.00 degC>"
    )


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture(scope="module")
def left_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("left") / "run.h5"
    with pytest.MonkeyPatch.context() as patch, Stimulator.simulate("local") as bench:
        patch.setattr("smarttac_can.bench.recording.make_recording", full)
        bench.finger.stroke(2)
        bench.voltage = 20
        bench.mode = "open_loop"
        with pytest.raises(BenchError), bench.record(path):
            bench.run(3.0)
    return path.with_name("run.h5.log")


@pytest.fixture
def log(left_log: Path, tmp_path: Path) -> Path:
    """Log of 3 s of a recording of which no file could be made."""
    return Path(copy(left_log, tmp_path))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows limits no length of files")
def test_a_recovery_onto_a_full_disk_is_one_line(log: Path) -> None:
    """In a process of its own, whose files may not be longer: a write fails as on a full disk."""
    resource = importlib.import_module("resource")
    path = log.with_name("x.h5")

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    command = [sys.executable, "-m", "smarttac_can", "record", "--recover", str(log), str(path)]
    ended = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limit,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr == (
        f"Error: {path}: File too large: make room, or name a file on another disk; "
        f"{log} stays as it is\n"
    )
    assert not path.exists()
    assert not list(path.parent.glob("*.part"))
    make_recording(log, path)
    assert len(read_recording(path)) == 3000


@pytest.mark.parametrize("writes", [0, 1, 5, 20])
def test_a_full_disk_at_any_write_makes_no_file(
    log: Path, monkeypatch: pytest.MonkeyPatch, writes: int
) -> None:
    left = writes

    class Full(recording_file._Disk):
        def _put(self, data: Any) -> int:
            nonlocal left
            left -= 1
            if left < 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            return super()._put(data)

    monkeypatch.setattr(recording_file, "_Disk", Full)
    path = log.with_name("x.h5")
    with pytest.raises(OSError, match=r"x\.h5: No space left on device: make room, or name a"):
        make_recording(log, path)
    assert [other.name for other in log.parent.iterdir()] == [log.name]


@pytest.mark.parametrize("kind", ["file", "link"])
def test_a_file_that_appears_during_the_work_stays(
    kind: str, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, write = log.with_name("x.h5"), recording_file._write

    def write_late(*arguments: Any) -> Any:
        path.write_text("theirs") if kind == "file" else path.symlink_to("nothing")
        return write(*arguments)

    monkeypatch.setattr(recording_file, "_write", write_late)
    with pytest.raises(BenchError, match=r"x\.h5 exists: give the recording another name"):
        make_recording(log, path)
    assert path.read_text() == "theirs" if kind == "file" else path.is_symlink()
    assert {other.name for other in log.parent.iterdir()} == {log.name, "x.h5"}


def test_recording_on_a_full_disk_is_read_back_to_the_error(tmp_path: Path) -> None:
    """HDF5 takes any bytes for its own tables, and crashes on others."""
    with recording_file._Disk(tmp_path / "x", tmp_path / "y", tmp_path / "z") as disk:
        disk.write(b"abcdefgh")
        disk._error = OSError(errno.ENOSPC, "No space left on device")
        for at, data in ((2, b"CD"), (6, b"GHIJ"), (3, b"x")):
            disk.seek(at)
            assert disk.write(data) == len(data)
        found = bytearray(14)
        for at, want in ((0, b"abCxefGHIJ\0\0\0\0"), (3, b"xefGHIJ\0\0\0\0\0\0\0")):
            disk.seek(at)
            assert disk.readinto(found) == 14
            assert bytes(found) == want
    assert (tmp_path / "x").read_bytes() == b"abcdefgh"


@pytest.mark.usefixtures("simulated")
def test_the_command_names_the_recovery_where_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FrameLog, "_write", full)
    path = tmp_path / "run.h5"
    result = run("record", path)
    assert result.exit_code == 1
    assert result.stderr.splitlines()[-1] == (
        f"Error: {path}.log cannot be written: No space left on device; what was recorded is in "
        f"it: make room, then smarttac record --recover {path}.log {path} makes the file"
    )


def test_a_file_that_finds_the_disk_full_names_the_recovery(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.h5"
    monkeypatch.setattr(recording_file._Disk, "_put", full)
    with (
        Stimulator.simulate("local") as bench,
        pytest.raises(BenchError) as told,
        bench.record(path),
    ):
        bench.run(0.01)
    assert str(told.value) == (
        f"{path}: No space left on device: make room, or name a file on another disk; {path}.log "
        f"stays as it is; smarttac record --recover {path}.log {path} makes the file"
    )


def test_a_disk_that_is_full_at_the_beginning_leaves_no_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FrameLog, "_sync", full)
    path = tmp_path / "run.h5"
    with (
        Stimulator.simulate("local") as bench,
        pytest.raises(BenchError, match=r"cannot write .*run\.h5\.log: No space left on device"),
        bench.record(path),
    ):
        pass
    assert list(tmp_path.iterdir()) == []
