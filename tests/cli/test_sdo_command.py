"""``smarttac sdo`` reads and writes objects of devices by name or index."""

import json
from pathlib import Path

import pytest
from commands import refusal, succeed
from nodes_on_a_bus import in_threads
from small_eds import NODE_ID, entry, small_eds, written

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.instrument.nodes.device_node import DeviceNode

TEXT = small_eds(
    entry("2000", 6, "rw", "250", "HighLimit=1000").replace("Entry 2000", "Voltage [10 mV]")
    + entry("6041", 6, "ro", "0x237").replace("Entry 6041", "Statusword")
    + entry("2001", 9, "ro", "text")
)


def on_bus(name: str) -> tuple[str, ...]:
    return ("--interface", "virtual", "--channel", name, "--timeout", "5")


def test_an_object_is_read_and_written_with_its_unit(tmp_path: Path) -> None:
    eds = str(written(tmp_path, TEXT))
    node = DeviceNode(Device(load_eds(TEXT, NODE_ID)))
    bus = on_bus("sdo")
    with in_threads({"interface": "virtual", "channel": "sdo"}, node, lockstep=False):
        assert succeed("sdo", "read", "9", "Voltage", "--eds", eds, *bus) == (
            "2000h:0 Voltage = 2500 mV\n"
        )
        told = succeed("sdo", "write", "9", "Voltage", "5 V", "--eds", eds, *bus)
        assert told == "2000h:0 Voltage = 5000 mV\n"
        assert node.device.od.number(0x2000) == 500
        succeed("sdo", "write", "9", "0x2000", "7", "--eds", eds, *bus)
        assert succeed("sdo", "read", "9", "2000h:0", *bus) == "2000h:0 = 07 00\n"
        assert succeed("sdo", "read", "9", "6041", "--eds", eds, *bus) == (
            "6041h:0 Statusword = 567\n"
        )
        assert succeed("sdo", "read", "9", "2001", "--eds", eds, *bus).endswith("= 'text'\n")
        found = json.loads(succeed("sdo", "read", "9", "Voltage", "--eds", eds, *bus, "--json"))
        assert found == {
            "node_id": 9, "index": 0x2000, "subindex": 0, "bytes": "07 00", "name": "Voltage",
            "value": 7, "text": "70 mV", "unit": "mV", "in_unit": 70.0,
        }  # fmt: skip
        assert refusal("sdo", "read", "9", "2345sub1", *bus) == (
            "node 9 refuses to read 2345h:1: abort 06020000: object does not exist in the object "
            "dictionary"
        )


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("Voltage", "80 V", "Voltage 80 V is outside 0..10000 mV"),
        ("Voltage", "1 kg", "is neither a raw integer nor a number with a unit like mV"),
        ("Statusword", "1", "Statusword is ro: it takes no value"),
        ("Voltag", "1", "'Voltag' is not in the EDS, or stands for several objects; perhaps"),
        ("2345", "1", "2345 is not in the EDS"),
    ],
)
def test_a_value_is_refused_before_it_is_sent(
    name: str, value: str, message: str, tmp_path: Path
) -> None:
    eds = str(written(tmp_path, TEXT))
    line = refusal("sdo", "write", "9", name, value, "--eds", eds, *on_bus("nobody"))
    assert message in line


def test_sdo_command_names_a_silent_node() -> None:
    bus = (*on_bus("nobody here")[:4], "--timeout", "0.05")
    assert refusal("sdo", "read", "9", "1000", *bus) == "node 9 does not answer"
    assert "for a name give --eds" in refusal("sdo", "read", "9", "Voltage", *bus, code=2)
