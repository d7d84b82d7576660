"""A DBC is read by cantools: it decodes a recorded run to the recorded numbers."""

from itertools import groupby
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from cantools.database.can import Database
from rich_eds import RICH

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.bench.traces import read_csv
from smarttac_can.canopen.commissioning.dbc import Names, identifier, make_dbc
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.host.log_file import read_candump
from smarttac_can.studies.paper.experiments import Conditions
from smarttac_can.studies.paper.reproduce import CANDUMP, TRACES, reproduce
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.meanings import EMERGENCIES, FIELDS
from smarttac_can.vocabulary.states import STATE_SHIFT, State, Status


def load(text: str) -> Database:
    database = cantools.database.load_string(text, "dbc", strict=True)
    assert isinstance(database, Database)
    return database


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    reproduce(frozenset({"fig5"}), Conditions(), link="bus", folder=folder)
    return folder


def cycles(log: Path, database: Database) -> list[dict[str, Any]]:
    """Values of the node's TPDOs from SYNC to SYNC."""
    known = {message.frame_id for message in database.messages}
    numbered = []
    number = 0
    for _, frame in read_candump(log):
        number += frame.can_id == cia.SYNC_ID
        if frame.can_id in known:
            numbered.append((number, frame))
    rows = []
    for _, frames in groupby(numbered, key=lambda item: item[0]):
        row: dict[str, Any] = {}
        for _, frame in frames:
            # The first is the cycle's; a node that ends says once more how it left the plate.
            row = {**database.decode_message(frame.can_id, frame.data), **row}
        rows.append(row)
    return rows


def test_a_recorded_run_decodes_to_its_traces(run: Path) -> None:
    """All rows of the traces are in the log, in their order, with other cycles between runs."""
    decoded = iter(cycles(run / CANDUMP, load(make_dbc(stimulator_od()))))
    compared = 0
    for trace in read_csv(run / TRACES):
        columns = {
            "Contact_Tick": trace.tick,
            "Vibration_Amplitude": trace.amplitude_um * 1e3,
            "Vibration_Voltage": trace.voltage_v * 1e3,
            "Vibration_Frequency": trace.frequency_hz,
            "Contact_Tangential_force": trace.tangential_force_n * 1e3,
            "Contact_Normal_force": trace.normal_force_n * 1e3,
            "Contact_COF": np.nan_to_num(trace.cof),
            "Contact_COF_reference": np.nan_to_num(trace.cof_reference),
        }
        for k in range(len(trace)):
            wanted = {name: pytest.approx(values[k]) for name, values in columns.items()}
            assert any(
                all(row.get(name) == value for name, value in wanted.items()) for row in decoded
            ), (trace.experiment, k)
            compared += 1
    assert compared > 50


def test_scale_unit_sign_and_limits() -> None:
    database = load(make_dbc(load_eds(RICH, 5)))
    message = database.get_message_by_name("Conformance_probe_5_RPDO1")
    assert (message.frame_id, message.length) == (0x205, 8)
    offset = message.get_signal_by_name("Setpoint_Offset")
    assert (offset.start, offset.length, offset.is_signed) == (48, 16, True)
    assert (offset.scale, offset.unit) == (0.1, "us")
    assert (offset.minimum, offset.maximum) == (-100, 100)
    assert offset.receivers == ["Conformance_probe_5"]
    assert message.decode(bytes.fromhex("E80338354200F6FF")) == {
        "Setpoint_Voltage": 10_000,
        "Setpoint_Frequency": 43_390.0,
        "Setpoint_Offset": -1.0,
    }
    heartbeat = database.decode_message(0x705, b"\x85")
    assert heartbeat == {"NMT_state": "operational"}
    emergency = database.decode_message(0x85, bytes.fromhex("3081110102030405"))
    assert emergency["Error_code"] == 0x8130


def test_dbc_omits_disabled_pdos() -> None:
    names = {message.name for message in load(make_dbc(load_eds(RICH, 5))).messages}
    assert "Conformance_probe_5_TPDO3" in names
    assert not {f"Conformance_probe_5_{pdo}" for pdo in ("RPDO3", "TPDO4", "TPDO5")} & names


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("0x2F990010", "TPDO 1 maps 2F99h sub-index 0, which is not there"),
        ("0x22000100", "TPDO 1 maps no bit or more than 64"),
        ("0x22000140", "TPDO 1 maps no bit or more than 64"),
    ],
)
def test_a_mapping_that_makes_no_sense(value: str, message: str) -> None:
    assert RICH.count("DefaultValue=0x22000110") == 1
    od = load_eds(RICH.replace("DefaultValue=0x22000110", f"DefaultValue={value}"), 5)
    with pytest.raises(ValueError, match=message):
        make_dbc(od)


def test_identifiers() -> None:
    assert identifier("Contact.Normal force") == "Contact_Normal_force"
    assert identifier("3 phases (µ)") == "_3_phases"


def named() -> Database:
    return load(make_dbc(stimulator_od(), Names(FIELDS, EMERGENCIES)))


def test_mode_state_and_statusword_have_names() -> None:
    """Live, driving, touching and running in mode friction, by the layout of the EDS."""
    word = Status.LIVE | Status.DRIVING | Status.TOUCHING | State.RUNNING << STATE_SHIFT
    decoded = named().decode_message(0x1A0, word.to_bytes(2, "little") + b"\x04")
    assert decoded == {
        "Statusword_live": 1, "Statusword_driving": 1, "Statusword_touching": 1,
        "Statusword_limited": 0, "Statusword_saturated": 0, "Statusword_fault": 0,
        "Statusword_state": "running", "Mode_display": "friction",
    }  # fmt: skip


def test_dbc_encodes_drives_by_signal_name() -> None:
    database = named()
    arm = dict.fromkeys(("run", "quick_stop", "fault_reset"), 0) | {"arm": 1}
    words = {f"Controlword_{name}": bit for name, bit in arm.items()}
    data = database.encode_message("SMARTTAC_stimulator_32_RPDO1", words | {"Mode": "amplitude"})
    assert data == bytes((1, 0, 2))


def test_emergencies_have_the_names_of_their_codes() -> None:
    decoded = named().decode_message(0xA0, bytes.fromhex("2052110000000000"))
    assert decoded["Error_code"] == 0x5220  # no such code
    stuck = FaultCode.SENSOR_STUCK.to_bytes(2, "little") + bytes(6)
    assert named().decode_message(0xA0, stuck)["Error_code"] == "sensor stuck"
    assert named().decode_message(0xA0, bytes(8))["Error_code"] == "reset"
