"""Files of former versions are read: a folder a version, by the hash of its commit.

A file here is never made again. A change of a format has to read the former one as well.
"""

import json
import lzma
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from commands import refusal, run, succeed

from smarttac_can.bench import (
    BenchError,
    Texture,
    make_recording,
    read_csv,
    read_recording,
    stimulator_od,
    write_csv,
)
from smarttac_can.bench.recording_file import RecordedData
from smarttac_can.canopen.device.storage import Memory
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.host.files import StorageFile, read_lines
from smarttac_can.host.log_file import read_log
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.textures import TextureTable

FOLDER = Path(__file__).parent / "c475fbb"
GRATING = Texture.grating(2.0, 0.25, 0.45)
RAMP = Texture.profile("ramp", 0.2, 0.4, 0.05)
ROWS = 170


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder, unpacked."""
    folder = tmp_path_factory.mktemp("golden")
    for path in FOLDER.iterdir():
        (folder / path.stem).write_bytes(lzma.decompress(path.read_bytes()))
    return folder


def check(recording: RecordedData) -> None:
    """Check the recording, in either format."""
    assert recording.tick.tolist() == list(range(164, 164 + ROWS))
    assert set(recording.run.tolist()) == {0}
    assert recording.units["amplitude_um"] == "um"
    assert recording.units["position_mm"] == "mm"
    assert {"tangential_force_n", "normal_force_n", "voltage_v"} < set(recording.channels)
    assert [marker.text for marker in recording.markers] == ["trial 1: Fläche"]
    assert recording.settings["Setpoint.Amplitude"] == (pytest.approx(1.0), "um")
    changes = [(change.name, change.units) for change in recording.set_points]
    assert ("Setpoint.COF left", "1") in changes
    assert recording.gaps == recording.emergencies == []
    assert recording.attributes["Manufacturer device name"] == "SMARTTAC stimulator"
    assert recording.metadata == {"subject": "", "operator": "", "notes": ""}


def test_a_recording(files: Path) -> None:
    recording = read_recording(files / "recording.h5")
    check(recording)
    assert recording.textures == []
    friction, texture = read_csv(files / "traces.csv")
    for name in ("cof", "cof_reference", "amplitude_um", "voltage_v", "frequency_hz"):
        wanted = np.concatenate((getattr(friction, name), getattr(texture, name)))
        found = recording[name][: len(wanted)]
        np.testing.assert_allclose(found, wanted, rtol=1e-12, err_msg=name)
    for name in ("tangential_force_n", "normal_force_n"):
        wanted = np.concatenate((getattr(friction, name), getattr(texture, name)))
        np.testing.assert_allclose(recording[name][: len(wanted)], wanted, atol=1e-12)
    assert 0 < np.isnan(recording["cof"]).sum() < ROWS


def test_the_log_of_a_recording_that_was_killed(files: Path, tmp_path: Path) -> None:
    summary = make_recording(files / "killed.h5.log", tmp_path / "run.h5")
    assert (summary.rows, summary.textures) == (ROWS, 2)
    recording = read_recording(tmp_path / "run.h5")
    check(recording)
    # The texture is in the frames of the log, though no version could show it then.
    assert [(one.slot, one.tick, one.texture) for one in recording.textures] == [
        (1, 243, GRATING),
        (2, 243, RAMP),
    ]
    old = read_recording(files / "recording.h5")
    for name, values in recording.channels.items():
        np.testing.assert_allclose(values, old[name], rtol=1e-12, err_msg=name)
        assert recording.units[name] == old.units[name]
    assert [row[1:] for row in recording.set_points] == [row[1:] for row in old.set_points]
    assert recording.settings.keys() == old.settings.keys()
    for name, (value, unit) in recording.settings.items():
        assert (pytest.approx(value), unit) == old.settings[name], name


@pytest.mark.parametrize("at", [1688, 2110, 3798, 5064, 23_632])
def test_a_recording_with_a_wrong_bit(files: Path, tmp_path: Path, at: int) -> None:
    """h5py has a class of error for each: of an attribute, a key, at run time, of a chunk."""
    data = bytearray((files / "recording.h5").read_bytes())
    data[at] ^= 0x5A
    (tmp_path / "damaged.h5").write_bytes(data)
    with pytest.raises(BenchError, match=r"damaged\.h5 is no recording that can be read: "):
        read_recording(tmp_path / "damaged.h5")


def test_a_recording_is_found_as_it_was_described(files: Path) -> None:
    """Scripts for format 1 of others go on: the file itself is unchanged."""
    with h5py.File(files / "recording.h5") as file:
        assert file.attrs["format"] == "SMARTTAC recording 1"
        assert file["channels/Vibration.Amplitude"].attrs["units"] == "nm"


def test_traces(files: Path, tmp_path: Path) -> None:
    friction, texture = read_csv(files / "traces.csv")
    assert (friction.experiment, friction.subject) == ("golden.friction", 2)
    assert (len(friction), len(texture)) == (80, 80)
    assert friction.voltage_v[0] > 0
    assert np.isnan(friction.position_mm).all()
    lines = (files / "traces.csv").read_text().splitlines()
    cof = [float(line.split(",")[3]) for line in lines[1:]]
    found = np.nan_to_num(np.concatenate((friction.cof, texture.cof)))
    assert found.tolist() == pytest.approx(cof)
    assert 0 < np.count_nonzero(found) < len(found)
    write_csv(tmp_path / "again.csv", [friction, texture])
    again = read_csv(tmp_path / "again.csv")
    assert [trace.counts.tolist() for trace in again] == [
        trace.counts.tolist() for trace in (friction, texture)
    ]


def test_a_trace_for_other_programs(files: Path, tmp_path: Path) -> None:
    frame = pd.read_csv(files / "trace.csv", comment="#")
    assert len(frame) == 80
    frame[frame["cof"] > 0.05].to_csv(tmp_path / "touched.csv")
    assert Texture.from_csv(tmp_path / "touched.csv", time="time_s", cof="cof").is_over_time


@pytest.mark.parametrize(("name", "frames"), [("raw.log", 3298), ("raw.blf", 500)])
def test_a_raw_log(files: Path, name: str, frames: int) -> None:
    assert len(list(read_log(files / name))) == frames


def test_a_raw_log_is_replayed(files: Path, tmp_path: Path) -> None:
    """Textures are written in it by block transfer."""
    found = tmp_path / "found.json"
    run("replay", files / "raw.log", "--lockstep", "--json", found)
    result = json.loads(found.read_text())
    # A later version may answer in another way, and says where; it understands the log.
    assert result["compared"] > 100
    assert result["same"] or result["difference"]["time_s"] > 0


def test_an_eds_of_then_is_no_device_of_today(files: Path) -> None:
    """It lacks objects that came later; which, and the cure, is said in one line."""
    eds = files / "stimulator.eds"
    succeed("eds", "check", eds)
    said = refusal("replay", files / "raw.log", "--eds", eds)
    assert said.startswith(f"{eds} does not suit the device: 'Model.Data sheet gain")
    assert said.endswith(
        "is not in the EDS, so it is of another version: leave --eds out, or begin with what "
        "'smarttac eds show' writes"
    )


def test_stored_parameters_of_an_older_revision_are_refused(files: Path) -> None:
    data = StorageFile(files / "node.bin").read()
    assert data is not None
    memory = Memory()
    memory.write(data)
    node = StimulatorNode(stimulator_od(), plate_node_id=33, lockstep=True, storage=memory)
    sent = node.start()
    assert [f.data[:2] for f in sent if f.can_id == cia.EMCY_ID + node.od.node_id] == [b"\x30\x55"]
    assert node.od["Limit.Voltage"].value == node.od["Limit.Voltage"].default == 15_000


def test_faults(files: Path) -> None:
    lines = read_lines(StorageFile(files / "node.bin.faults"))
    node = StimulatorNode(stimulator_od(), plate_node_id=33, lockstep=True)
    node.block.supervisor.memory.recall(lines)
    assert node.od["Fault memory.Fault 1"].value == lines[0]
    assert lines[0].startswith("5211h a sensor is stuck; mode open loop, Voltage 10000 mV, ")
    assert len(lines) == 2


def test_a_dcf(files: Path) -> None:
    od = load_eds((files / "stimulator.dcf").read_text(), 40)
    assert od["Limit.Voltage"].default == 6_000
    for name in ("stimulator.dcf", "stimulator.eds"):
        succeed("eds", "check", files / name)


def test_a_texture(files: Path) -> None:
    assert TextureTable.unpack((files / "texture.stx").read_bytes()) == GRATING.table
