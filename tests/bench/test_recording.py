"""A recording holds every cycle and setting, over every link, and survives any end."""

import errno
import json
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any
from zlib import crc32

import can
import h5py
import numpy as np
import pytest
from nodes_on_a_bus import in_threads, stimulator_with_plate, until

from smarttac_can.bench import (
    BenchError,
    FaultError,
    NotRunningError,
    Recording,
    State,
    Stimulator,
    make_recording,
    network,
    recorded_frames,
)
from smarttac_can.bench.recorded_frames import RecordedFrames
from smarttac_can.host.frame_log import MARK, MARK_END, RECORD, FrameLog, FrameLogReader
from smarttac_can.vocabulary.faults import FaultKind

CHANNELS = {
    "cof": "1",
    "cof_reference": "1",
    "amplitude_um": "um",
    "voltage_v": "V",
    "frequency_hz": "Hz",
    "tangential_force_n": "N",
    "normal_force_n": "N",
    "position_mm": "mm",
}
ALIEN = """
import sys
import h5py, pandas

with h5py.File(sys.argv[1]) as file:
    frame = pandas.DataFrame({name: data[:] for name, data in file["channels"].items()})
    frame["tick"] = file["tick"][:]
    units = {name: data.attrs["units"] for name, data in file["channels"].items()}
    markers = pandas.DataFrame(file["markers"][:])
    changes = pandas.DataFrame(file["set_points"][:])
    gaps = pandas.DataFrame(file["gaps"][:])
    eds = file["object_dictionaries/node_32"].asstr()[()]
assert "smarttac_can" not in sys.modules
print(len(frame), units["voltage_v"], markers["text"][0].decode(), len(gaps))
print(round(frame["cof"].mean(), 2), frame["cof"].isna().sum() > 0)
named = changes["name"].str.decode("ascii") == "Setpoint.Voltage"
print(changes["value"][named].tolist(), "ParameterName=Statusword" in eds)
"""


def play(bench: Stimulator, path: Path) -> Recording:
    bench.finger.stroke(2)
    bench.start_run()
    bench.tare()
    bench.voltage = 20
    with bench.record(path) as recording:
        bench.mode = "open_loop"
        bench.run(0.5)
        bench.mark("trial 3: Fläche")
        bench.voltage = 40
        bench.run(0.3)
        bench.amplitude = 1.0
        bench.mode = "amplitude"
        bench.run(0.2)
    return recording


def content(path: Path) -> dict[str, Any]:
    """Everything but the host's time."""
    with h5py.File(path) as file:
        found = {name: data[:] for name, data in file["channels"].items()}
        found |= {name: file[name][:] for name in ("tick", "run", "gaps")}
        found["markers"] = [tuple(row)[1:] for row in file["markers"][:]]
        plain = [tuple(row)[1:] for row in file["set_points"][:]]
        # Simulation and finger are the plate node's, if there is one.
        found["set_points"] = [row[:2] + row[3:] for row in plain]
        return found


def test_the_same_over_every_link(bench: Stimulator, tmp_path: Path) -> None:
    recording = play(bench, tmp_path / "run.h5")
    assert recording.summary is not None
    assert (recording.summary.rows, recording.summary.lost) == (1000, 0)
    with Stimulator.simulate("local") as other:
        play(other, tmp_path / "local.h5")
    found, expected = content(tmp_path / "run.h5"), content(tmp_path / "local.h5")
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)
    assert not (tmp_path / "run.h5.log").exists()


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_recording_has_the_channels_of_a_run(bench: Stimulator, tmp_path: Path) -> None:
    bench.finger.stroke(2)
    bench.start_run()
    bench.tare()
    bench.amplitude = 1.0
    bench.mode = "friction"
    with bench.record(tmp_path / "run.h5"):
        trace = bench.run(0.8)
    with h5py.File(tmp_path / "run.h5") as file:
        assert file["tick"][:].tolist() == trace.tick.tolist()
        for name, units in CHANNELS.items():
            data = file["channels"][name]
            # To the bit: names, units and the NaN of no contact are those of a trace.
            np.testing.assert_array_equal(data[:], getattr(trace, name), err_msg=name)
            assert (data.attrs["units"], data.attrs["sampling"]) == (units, "every cycle")
        status = file["channels/status"]
        assert status[:].tolist() == trace.status.tolist()
        assert status.attrs["sampling"] == "on change, held"
        assert "bits 8 to 10 the state" in status.attrs["meaning"]
        assert len(set(trace.position_mm.tolist())) > 100
        assert set(file["channels"]) == {*CHANNELS, "status", "mode", "temperature_degc"}
        assert file["channels/amplitude_um"].attrs["object"] == "Vibration.Amplitude"
        assert file["channels/amplitude_um"].attrs["resolution"] == pytest.approx(1e-4)


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_the_end_of_a_recording_reads_no_eds_again(
    bench: Stimulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, kept, made = (tmp_path / name for name in ("run.h5", "kept.log", "made.h5"))
    with monkeypatch.context() as patch:
        patch.delattr(recorded_frames, "load_eds")
        with bench.record(path) as recording:
            kept.hardlink_to(recording.log_path)
            bench.run(0.1)
    make_recording(kept, made)
    assert len(content(path)["tick"]) == 100
    np.testing.assert_equal(content(path), content(made))


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_recording_has_identity_settings_and_eds(bench: Stimulator, tmp_path: Path) -> None:
    play(bench, tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as file:
        assert file.attrs["format"] == "SMARTTAC recording 2"
        assert file.attrs["version"]
        assert file.attrs["Identity object.Product code"] == 0x534D5401
        assert file.attrs["Manufacturer device name"] == "SMARTTAC stimulator"
        settings = {row["name"].decode(): row["value"] for row in file["settings"][:]}
        assert settings["Calibration.Fx from S1"] == pytest.approx(0.9988)
        assert settings["Setpoint.Voltage"] == 20
        assert "[1A00]" in file["object_dictionaries/node_32"].asstr()[()]


def test_a_script_that_knows_nothing_of_this_package(tmp_path: Path) -> None:
    with Stimulator.simulate() as bench:
        play(bench, tmp_path / "run.h5")
    command = [sys.executable, "-W", "error", "-c", ALIEN, str(tmp_path / "run.h5")]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert said[0] == "1000 V trial 3: Fläche 0"
    assert said[1].endswith(" True")
    assert 0.2 < float(said[1].split()[0]) < 1.5
    assert said[2] == "[40.0] True"


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_a_simulation_that_starts_again_begins_a_run(bench: Stimulator, tmp_path: Path) -> None:
    with bench.record(tmp_path / "run.h5") as recording:
        bench.run(0.3)
        bench.start_run()
        bench.run(0.2)
    assert recording.summary is not None
    assert recording.summary.runs == 2
    with h5py.File(tmp_path / "run.h5") as file:
        assert np.diff(file["tick"][:][file["run"][:] == 1]).tolist() == [1] * 199
        assert file["gaps"].shape == (0,)


def test_a_fault_and_its_reset_are_emergencies_over_every_link(
    bench: Stimulator, tmp_path: Path
) -> None:
    bench.voltage = 10
    with bench.record(tmp_path / "run.h5"):
        bench.mode = "open_loop"
        bench.set("Fault.Sensor", 1)
        bench.set("Fault.Kind", FaultKind.STUCK)
        with pytest.raises(FaultError):
            bench.run(0.2)
        bench.set("Fault.Kind", FaultKind.NONE)
        bench.run(0.1)
        bench.reset_fault()
        bench.run(0.01)
    with h5py.File(tmp_path / "run.h5") as file:
        told = [(row["node_id"], row["code"], row["text"]) for row in file["emergencies"][:]]
        states = {State(status >> 8 & 7) for status in file["channels/status"][:]}
    assert told == [(32, 0x5211, b"a sensor is stuck"), (32, 0, b"reset")]
    assert {State.RUNNING, State.FAULT, State.READY} <= states


def test_any_error_puts_the_plate_at_0_v_before_the_file_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Stimulator.simulate("local") as bench:
        made = []

        def make(log: Path, path: Path, **more: Any) -> None:
            made.append(bench.get("Mode"))
            make_recording(log, path, **more)

        monkeypatch.setattr("smarttac_can.bench.recording.make_recording", make)
        bench.voltage = 10
        with pytest.raises(KeyboardInterrupt), bench.record(tmp_path / "run.h5"):
            bench.mode = "open_loop"
            bench.run(0.1)
            raise KeyboardInterrupt
        assert made == [0]


def test_refusals(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with Stimulator.simulate("local") as bench:
        with pytest.raises(BenchError, match="nothing is being recorded"):
            bench.mark("x")
        with bench.record(path):
            with pytest.raises(BenchError, match=r"run\.h5 is being recorded: one file at a time"):
                bench.record(tmp_path / "other.h5")
            for text in ("", "x" * 1001, None):
                with pytest.raises(ValueError, match="is no text of 1 to 1000 characters"):
                    bench.mark(text)  # type: ignore[arg-type]
            bench.run(0.01)
        with pytest.raises(BenchError, match=r"run\.h5 is not being recorded"):
            bench.mark("x")
        with pytest.raises(BenchError, match=r"run\.h5 exists"), bench.record(path):
            pass
        (tmp_path / "b.h5.log").touch()
        with (
            pytest.raises(BenchError, match=r"--recover .*b\.h5\.log"),
            bench.record(tmp_path / "b.h5"),
        ):
            pass
        missing = tmp_path / "no" / "run.h5"
        with (
            pytest.raises(BenchError, match=r"cannot write .*: the folder .* does not exist$"),
            bench.record(missing),
        ):
            pass
    with pytest.raises(BenchError, match=r"run\.h5 exists"):
        make_recording(tmp_path / "b.h5.log", path)
    with pytest.raises(BenchError, match=r"b\.h5\.log is no log of a recording"):
        make_recording(tmp_path / "b.h5.log", tmp_path / "c.h5")
    assert not list(tmp_path.glob("*.part"))


def test_without_the_tick_there_is_no_recording(virtual: dict[str, Any], tmp_path: Path) -> None:
    node = stimulator_with_plate()
    cob_id = node.od.entry(0x1802, 1)
    with in_threads(virtual, node):
        with Stimulator.connect(**virtual, lockstep=True) as bench:
            device = bench._link._stimulator  # type: ignore[attr-defined]
            device.write(cob_id, cob_id.default | 1 << 31)
        with (
            Stimulator.connect(**virtual, lockstep=True) as bench,
            pytest.raises(BenchError, match=r"2 to 4 of node 32 do not map Contact\.Tick, so lost"),
            bench.record(tmp_path / "run.h5"),
        ):
            pass
    assert not list(tmp_path.iterdir())


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_told_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Stimulator.simulate("local") as bench:
        with (
            pytest.raises(BenchError, match=r"run\.h5\.log cannot be written: No space left on"),
            bench.record(tmp_path / "run.h5") as recording,
        ):
            monkeypatch.setattr(FrameLog, "_write", full)
            bench.run(0.1)
            with pytest.raises(BenchError, match=r"cannot be written: No space left"):
                while True:
                    recording.check()
        assert (tmp_path / "run.h5.log").exists()
        # The error that ends the block is the one to hear of.
        with pytest.raises(ZeroDivisionError) as caught, bench.record(tmp_path / "b.h5"):
            bench.run(0.1)
            raise ZeroDivisionError
        (note,) = caught.value.__notes__
        assert "b.h5.log cannot be written: No space left on device" in note


def test_in_real_time_beside_scripts_that_run(virtual: dict[str, Any], tmp_path: Path) -> None:
    """Other scripts run beside it and drive; each loss is named."""
    node = stimulator_with_plate(lockstep=False)
    with in_threads(virtual, node, lockstep=False):
        with (
            Stimulator.connect(**virtual) as reader,
            reader.record(tmp_path / "run.h5") as recording,
            Stimulator.connect(**virtual) as driver,
        ):
            driver.voltage = 20
            for _ in range(3):
                with suppress(NotRunningError):  # on a machine that is busy
                    driver.run(0.2)
            before = recording.cycles
            # By the event timers, 100 ms, this would take longer than the guard.
            until(lambda: recording.cycles > before + 1000)
            driver.voltage = 10
        types = [node.od.entry(0x1800 + n, 2).value for n in range(4)]
    assert types == [255] * 4
    assert recording.summary is not None
    with h5py.File(tmp_path / "run.h5") as file:
        ticks, gaps = file["tick"][:], file["gaps"][:]
        voltages = [row["value"] for row in file["set_points"][:] if row["name"].endswith(b"age")]
        every = set(range(int(ticks[0]), int(ticks[-1]) + 1))
    named = {t for gap in gaps for t in range(gap["first_tick"], gap["last_tick"] + 1)}
    assert named == every - set(ticks.tolist())
    assert voltages == [20, 10]


def test_recording_keeps_frames_queued_at_its_end(
    virtual: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = FrameLog.frame

    def slowly(log: FrameLog, can_id: int, data: bytes) -> None:
        time.sleep(0.02)
        heard(log, can_id, data)

    monkeypatch.setattr(FrameLog, "frame", slowly)
    with (
        in_threads(virtual, stimulator_with_plate()),
        Stimulator.connect(**virtual, lockstep=True) as driver,
        Stimulator.connect(**virtual, lockstep=True) as reader,
        reader.record(tmp_path / "run.h5"),
    ):
        for volts in range(1, 11):
            driver.voltage = volts
    with h5py.File(tmp_path / "run.h5") as file:
        assert [row["value"] for row in file["set_points"][:]] == [*range(1, 11)]


def test_a_node_that_is_reset_is_recorded_on(virtual: dict[str, Any], tmp_path: Path) -> None:
    node = stimulator_with_plate(lockstep=False)
    with (
        in_threads(virtual, node, lockstep=False),
        can.Bus(**virtual) as master,
        Stimulator.connect(**virtual) as bench,
        bench.record(tmp_path / "run.h5") as recording,
    ):
        # The ticks begin anew by far: a few that are missing would look the same.
        until(lambda: recording.cycles > 2000)
        master.send(can.Message(data=[0x81, 32], is_extended_id=False))
        until(lambda: bench._link._stimulator.state == 0x7F)  # type: ignore[attr-defined]
        master.send(can.Message(data=[0x01, 32], is_extended_id=False))
        before = recording.cycles
        until(lambda: recording.cycles > before + 300)
    assert recording.summary is not None
    assert recording.summary.runs == 2


def test_recording_has_setpoints_a_master_sets_by_pdo(
    virtual: dict[str, Any], tmp_path: Path
) -> None:
    with (
        in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False),
        can.Bus(**virtual) as master,
        Stimulator.connect(**virtual) as bench,
        bench.record(tmp_path / "run.h5") as recording,
    ):
        for amplitude in (1000, 1000, 1500):
            data = b"".join(n.to_bytes(2, "little") for n in (amplitude, 3000, 3000))
            master.send(can.Message(arbitration_id=0x420, data=data, is_extended_id=False))
            before = recording.cycles
            until(lambda: recording.cycles > before + 20)  # noqa: B023
    with h5py.File(tmp_path / "run.h5") as file:
        changes = [(row["name"], row["value"]) for row in file["set_points"][:]]
    assert changes == [(b"Setpoint.Amplitude", 1.0), (b"Setpoint.Amplitude", 1.5)]


def test_refused_values_are_no_changes(tmp_path: Path) -> None:
    with Stimulator.simulate() as bench, bench.record(tmp_path / "run.h5"):
        with pytest.raises(BenchError):
            bench.set("Setpoint.Voltage", 1e6)
        with pytest.raises(BenchError):
            bench.set("Setpoint.Amplitude", 9000)
        bench.run(0.01)
        bench.amplitude = 1.0
    with h5py.File(tmp_path / "run.h5") as file:
        assert [row["name"] for row in file["set_points"][:]] == [b"Setpoint.Amplitude"]


def test_a_copy_of_the_log_at_any_moment_is_a_recording(tmp_path: Path) -> None:
    """A killed process leaves all but the last quarter second in the file."""
    with Stimulator.simulate("local") as bench, bench.record(tmp_path / "run.h5") as recording:
        bench.run(0.5)
        size = recording.log_path.stat().st_size
        until(lambda: recording.log_path.stat().st_size > size)
        bench.run(0.5)
        left = recording.log_path.read_bytes()
    for cut in range(0, 100, 7):
        log = tmp_path / f"{cut}.log"
        log.write_bytes(left[: len(left) - cut])
        summary = make_recording(log, tmp_path / f"{cut}.h5")
        assert 490 <= summary.rows <= 1000
        assert summary.lost == 0
        assert log.exists()


def test_a_plate_node_that_leaves_ends_the_run_not_the_file(tmp_path: Path) -> None:
    bus_bench = Stimulator.simulate()
    with pytest.raises(NotRunningError), bus_bench as bench, bench.record(tmp_path / "run.h5"):
        bench.run(0.1)
        link: Any = bench._link
        plate = next(p for p in link._network._local_bus._ports if "Plate" in repr(p._node))
        plate.close()
        bench.run(1.0)
    with h5py.File(tmp_path / "run.h5") as file:
        assert len(file["tick"]) >= 99


def test_threads_may_mark(tmp_path: Path) -> None:
    with Stimulator.simulate("local") as bench, bench.record(tmp_path / "run.h5"):
        threads = [
            threading.Thread(target=bench.mark, args=(f"{'marker ' * 9}{n}",)) for n in range(8)
        ]
        for thread in threads:
            thread.start()
        bench.run(0.1)
        for thread in threads:
            thread.join()
    with h5py.File(tmp_path / "run.h5") as file:
        texts = sorted(row["text"].decode() for row in file["markers"][:])
    assert texts == [f"{'marker ' * 9}{n}" for n in range(8)]


def test_both_nodes_are_described(tmp_path: Path) -> None:
    with Stimulator.simulate() as bench, bench.record(tmp_path / "run.h5") as recording:
        bench.run(0.01)
        assert [n["node_id"] for n in FrameLogReader(recording.log_path).head["nodes"]] == [32, 33]


@pytest.mark.parametrize("suffix", ["asc", "blf", "log", "trc", "csv"])
def test_the_raw_bus_beside_it(tmp_path: Path, suffix: str) -> None:
    raw = tmp_path / f"raw.{suffix}"
    with Stimulator.simulate() as bench, bench.record(tmp_path / "run.h5", raw=raw):
        bench.run(0.05)
        bench.voltage = 12
    frames = [message.arbitration_id for message in can.LogReader(raw)]
    # SYNC, drive and public TPDOs of each cycle, and the write with its answer.
    for can_id in (0x080, 0x221, 0x2A0, 0x3A0, 0x4A0):
        assert frames.count(can_id) == 50, hex(can_id)
    assert frames.index(0x620) < frames.index(0x5A0)


def written(raw: Path) -> list[tuple[int, bool]]:
    """Identifiers of the bench's own SDO requests and of their answers, and whether received."""
    sdo = (0x620, 0x5A0)
    return [(m.arbitration_id, m.is_rx) for m in can.LogReader(raw) if m.arbitration_id in sdo]


@pytest.mark.parametrize("echoes", [False, True])
def test_the_raw_log_of_a_bus_that_no_second_handle_hears(
    virtual: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, echoes: bool
) -> None:
    monkeypatch.setattr(network, "hears_others_of_process", lambda _: False)
    raw = tmp_path / "run.asc"
    options = {**virtual, "receive_own_messages": echoes}
    node = stimulator_with_plate(lockstep=False)
    with (
        in_threads(virtual, node, lockstep=False),
        Stimulator.connect(**options, timeout=5.0) as bench,
    ):
        recording = bench.record(tmp_path / "run.h5", raw=raw)
        with recording:
            for voltage in (1.0, 2.0, 3.0):
                bench.voltage = voltage
    # Each once, whether the bus echoes it or not.
    frames = written(raw)
    assert frames.count((0x620, False)) == frames.count((0x5A0, True)) == len(frames) / 2 >= 3
    assert recording.raw_note.startswith("" if echoes else "this interface does not echo")
    assert bool(recording.raw_note) is not echoes


def test_a_bus_that_cannot_be_opened_twice_is_told(
    virtual: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def taken(**_: object) -> None:
        raise can.CanInitializationError("it is taken")

    node = stimulator_with_plate(lockstep=False)
    with (
        in_threads(virtual, node, lockstep=False),
        Stimulator.connect(**virtual, timeout=5.0) as bench,
    ):
        monkeypatch.setattr(can, "Bus", taken)
        recording = bench.record(tmp_path / "run.h5", raw=tmp_path / "run.asc")
        with pytest.raises(BenchError, match=r"cannot open the virtual bus, .*: it is taken"):
            recording.__enter__()
        assert bench.run(0.05).cof.size
    assert not list(tmp_path.iterdir())


def test_the_raw_log_of_a_bus_that_fails_says_so(
    virtual: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unplugged(*_: object) -> None:
        raise can.CanOperationError("it is unplugged")

    node = stimulator_with_plate(lockstep=False)
    with (
        in_threads(virtual, node, lockstep=False),
        Stimulator.connect(**virtual, timeout=5.0) as bench,
        can.Bus(**virtual) as second,
    ):
        link: Any = bench._link
        monkeypatch.setattr(second, "recv", unplugged)
        monkeypatch.setattr(link._network, "second_bus", lambda: second)
        recording = bench.record(tmp_path / "run.h5", raw=tmp_path / "run.asc")
        with (
            pytest.raises(BenchError, match=r"ends where its bus failed: it is unplugged"),
            recording,
        ):
            assert bench.run(0.05).cof.size
    assert recording.summary is not None


def test_refused_raw_logs_leave_nothing(tmp_path: Path) -> None:
    (tmp_path / "there.asc").touch()
    (tmp_path / "link.asc").symlink_to(tmp_path / "nothing")
    with Stimulator.simulate() as bench:
        for raw, words in (
            ("raw.xyz", r"cannot log to .*raw\.xyz"),
            ("no/raw.asc", r"cannot log to .*no/raw\.asc: the folder .*/no does not exist$"),
            ("there.asc", r"there\.asc exists: give the raw log another name"),
            ("link.asc", r"link\.asc exists: give the raw log another name"),
        ):
            with (
                pytest.raises(BenchError, match=words),
                bench.record(tmp_path / "run.h5", raw=tmp_path / raw),
            ):
                pass
    with (
        Stimulator.simulate("local") as bench,
        pytest.raises(BenchError, match=r"there is no bus whose frames could go to .*raw\.asc"),
        bench.record(tmp_path / "run.h5", raw="raw.asc"),
    ):
        pass
    assert {path.name for path in tmp_path.iterdir()} == {"there.asc", "link.asc"}


def test_a_raw_log_that_takes_no_more_is_told_and_ends_nothing(
    virtual: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.h5"
    node = stimulator_with_plate(lockstep=False)
    with in_threads(virtual, node, lockstep=False), Stimulator.connect(**virtual) as bench:
        recording = bench.record(path, raw=tmp_path / "run.asc")
        full_disk = pytest.raises(BenchError, match=r"run\.asc cannot be written: .*No space left")
        with full_disk as told, recording:
            monkeypatch.setattr(can.ASCWriter, "on_message_received", full)
            bench.run(0.1)
            monkeypatch.setattr(can.ASCWriter, "stop", lambda log: (log.file.close(), full()))
        assert bench.run(0.1).cof.size, "it still hears the bus"
    assert told.value.__notes__ == [f"{path} holds what was recorded until then"]
    assert recording.summary is not None
    assert recording.summary.rows >= 50


def test_a_nul_in_a_text_spoils_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with Stimulator.simulate() as bench, bench.record(path) as recording:
        recording.mark("a\0b")
        bench.run(0.01)
    with h5py.File(path) as file:
        assert file["markers"]["text"][0].decode() == "a\N{REPLACEMENT CHARACTER}b"


@pytest.fixture(scope="module")
def head_of_a_log(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("head") / "run.h5"
    with Stimulator.simulate() as bench, bench.record(path) as recording:
        bench.run(0.01)
        return json.dumps(FrameLogReader(recording.log_path).head)


@pytest.fixture
def head(head_of_a_log: str) -> dict[str, Any]:
    """Head of a log."""
    made: dict[str, Any] = json.loads(head_of_a_log)
    return made


def log_with(head: Any, tmp_path: Path, records: bytes = b"") -> Path:
    text = json.dumps(head).encode()
    path = tmp_path / "made.log"
    sizes = struct.pack("<II", len(text), crc32(text))
    path.write_bytes(b"SMARTTAC recording log 1\n" + sizes + text + records)
    return path


@pytest.mark.parametrize("value", [None, [], "x", 1e400, -1, {"a": [1]}])
@pytest.mark.parametrize("key", ["node_id", "nodes", "identity", "settings", "held", "published"])
def test_a_head_of_another_form_is_refused(
    head: dict[str, Any], tmp_path: Path, key: str, value: Any
) -> None:
    log = log_with(head | {key: value}, tmp_path)
    with suppress(BenchError):
        make_recording(log, tmp_path / "made.h5")
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("value", [None, 1e400, [], 7])
@pytest.mark.parametrize("key", ["node_id", "eds"])
def test_a_node_of_another_form_is_refused(
    head: dict[str, Any], tmp_path: Path, key: str, value: Any
) -> None:
    head["nodes"][0][key] = value
    with pytest.raises(BenchError, match="cannot be understood"):
        make_recording(log_with(head, tmp_path), tmp_path / "made.h5")


def test_recorded_frames_wait_for_no_unending_mark(head: dict[str, Any]) -> None:
    frames = RecordedFrames(head)
    many = np.zeros(40_000, RECORD)
    many["kind"], many["length"], many["data"] = MARK, 8, 65
    frames.take(many)
    end = many[:1].copy()
    end["kind"] = MARK_END
    frames.take(end, last=True)
    assert [len(event.text) for event in frames.events] == [4008]


def test_frames_without_the_end_of_a_cycle_are_not_gathered(
    head: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert recorded_frames._MOST_WAITING <= 1 << 18
    monkeypatch.setattr(recorded_frames, "_MOST_WAITING", 1000)
    frames = RecordedFrames(head)
    strange = np.zeros(600, RECORD)
    strange["can_id"] = 0x7FF
    for _ in range(3):
        frames.take(strange)
        assert len(frames._rest) <= 1000
