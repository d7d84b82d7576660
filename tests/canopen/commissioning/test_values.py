"""Values of a DCF written to devices that are not ours, by the procedures of CiA 301."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest
from canopen.sdo.exceptions import SdoAbortedError
from commands import refusal, run, succeed
from nodes_on_a_bus import in_threads
from small_eds import NODE_ID, entry, record, small_eds, written

from smarttac_can.canopen.commissioning.values import _Writer, stated_values
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.eds import load_eds, read_sections, write_out
from smarttac_can.instrument.nodes.device_node import DeviceNode

COMMISSION = ("--node-id", f"{NODE_ID}", "--bitrate", "500000")


def bus(name: str) -> tuple[str, ...]:
    return ("--interface", "virtual", "--channel", name, "--timeout", "5")


def dcf(folder: Path, text: str, *values: str) -> Path:
    file = folder / "small-9.dcf"
    given = [word for value in values for word in ("--set", value)]
    succeed("eds", "dcf", written(folder, text), *COMMISSION, *given, "--output", file, "--force")
    return file


def device(text: str) -> DeviceNode:
    return DeviceNode(Device(load_eds(text, NODE_ID)))


# The device.


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (("DefaultValue=0x9A", "DefaultValue=0x1"), "the vendor-ID 1h, the file 9Ah"),
        (("AccessType=ro\nDefaultValue=1\n", "AccessType=ro\nDefaultValue=7\n"), "product code 7h"),
    ],
)
def test_another_device_is_written_only_if_asked(
    other: tuple[str, str], message: str, tmp_path: Path
) -> None:
    file = dcf(tmp_path, small_eds(), "1017=200")
    node = device(small_eds().replace(*other))
    options = bus(f"other {message[-4:]}")
    with in_threads({"interface": "virtual", "channel": options[3]}, node, lockstep=False):
        line = refusal("eds", "load", file, *options)
        assert "node 9 is another device, and nothing is written: " in line
        assert message in line
        assert node.device.od.number(0x1017) == 0
        succeed("eds", "load", file, "--any-device", *options)
        assert node.device.od.number(0x1017) == 200


def test_eds_load_without_a_node_is_an_error(tmp_path: Path) -> None:
    file = dcf(tmp_path, small_eds(), "1017=200")
    line = refusal("eds", "load", file, *bus("nobody there")[:4], "--timeout", "0.05")
    assert line == "node 9 does not answer"


def test_a_download_file_is_written(tmp_path: Path) -> None:
    text = small_eds("[2010]\nParameterName=Table\nObjectType=2\nAccessType=rw\n")
    file = dcf(tmp_path, text, "1017=200")
    file.write_text(
        file.read_text().replace("ObjectType=2\n", "ObjectType=2\nDownloadFile=a.bin\n")
    )
    assert "a.bin" in refusal("eds", "load", file, *bus("no file"))
    (tmp_path / "a.bin").write_bytes(bytes(range(200)))
    node = device(text)
    with in_threads({"interface": "virtual", "channel": "file"}, node, lockstep=False):
        said = succeed("eds", "load", file, *bus("file"))
    assert node.device.od.entry(0x2010).value == bytes(range(200))
    assert re.search(r"node 9: 2 values, 0 refused", said)
    file.write_text(file.read_text().replace("=a.bin", "=../a.bin"))
    assert "is not in the folder of the DCF" in refusal("eds", "load", file, *bus("no file"))


# The procedures: a device that refuses all that CiA 301 permits, written to without a bus.


class Client:
    """SDO client of a device in this process; it notes the downloads."""

    def __init__(self, device: Device) -> None:
        self._access = device._access
        self.downloads: list[tuple[int, int, int]] = []

    def download(self, index: int, subindex: int, data: bytes) -> None:
        self.downloads.append((index, subindex, int.from_bytes(data, "little")))
        try:
            self._access.write(self._access.writable(index, subindex, len(data)), data)
        except Abort as abort:
            raise SdoAbortedError(abort.code) from abort

    def upload(self, index: int, subindex: int) -> bytes:
        return self._access.read(index, subindex)


def load(text: str, values: str, *, before: str = "") -> tuple[_Writer, Client, Device]:
    """Write a DCF, the EDS `text` with `values` as ParameterValue, to a device.

    Values are those of sections in the order of the file (``1014=0xA1``); `before` are those that
    the device has already.
    """
    node = Device(load_eds(_stated(text, before), NODE_ID))
    node.start()
    made = _stated(text, values)
    od, sections = load_eds(made, NODE_ID), read_sections(made, [])
    write_out(sections)
    client = Client(node)
    writer = _Writer(client, od)
    writer.write_all(stated_values(od, sections))
    return writer, client, node


def _stated(text: str, values: str) -> str:
    for value in values.split():
        name, _, number = value.partition("=")
        assert f"[{name}]\n" in text
        text = text.replace(f"[{name}]\n", f"[{name}]\nParameterValue={number}\n")
    return text


STATUS = entry("2000", 6, "ro", "0", "PDOMapping=1") + entry("2001", 6, "ro", "0", "PDOMapping=1")
TPDO = record(
    "1800",
    entry("1800sub0", 5, "const", "5"),
    entry("1800sub1", 7, "rw", "$NODEID+0x180"),
    entry("1800sub2", 5, "rw", "255"),
    entry("1800sub3", 6, "rw", "0"),
    entry("1800sub5", 6, "rw", "0"),
)
MAPPING = record(
    "1A00",
    entry("1A00sub0", 5, "rw", "1"),
    entry("1A00sub1", 7, "rw", "0x20000010"),
    entry("1A00sub2", 7, "rw", "0"),
)
SYNC = (
    entry("1005", 7, "rw", "0x80")
    + entry("1006", 7, "rw", "0")
    + entry("1007", 7, "rw", "0")
    + entry("1019", 5, "rw", "0")
)
CONSUMER = record(
    "1016",
    entry("1016sub0", 5, "const", "2"),
    entry("1016sub1", 7, "rw", "0"),
    entry("1016sub2", 7, "rw", "0"),
    kind=8,
)
SERVER = record(
    "1201",
    entry("1201sub0", 5, "const", "3"),
    entry("1201sub1", 7, "rw", "0x80000000"),
    entry("1201sub2", 7, "rw", "0x80000000"),
    entry("1201sub3", 5, "rw", "0"),
)


@pytest.mark.parametrize(
    ("text", "before", "values"),
    [
        (entry("1014", 7, "rw", "$NODEID+0x80"), "", "1014=0xA1"),
        (SYNC, "1005=0x40000080 1006=1000", "1005=0x40000090 1006=2000 1007=500 1019=10"),
        (SYNC, "1006=1000 1019=10", "1006=1000 1019=20"),
        (SYNC, "1006=1000", "1019=20"),
        (entry("1012", 7, "rw", "0x80000100"), "", "1012=0x80000090"),
        (CONSUMER, "1016sub1=0x10064 1016sub2=0x20064", "1016sub1=0x20064 1016sub2=0x10064"),
        (SERVER, "1201sub1=0x6C1 1201sub2=0x6C2", "1201sub1=0x6C3 1201sub2=0x6C4 1201sub3=7"),
        (STATUS + TPDO + MAPPING, "", "1800sub1=0x1A1 1800sub3=50 1A00sub1=0x20010010"),
        (STATUS + TPDO + MAPPING, "", "1A00sub0=2 1A00sub2=0x20010010"),
        (STATUS + TPDO + MAPPING, "", "1800sub3=50"),
        (STATUS + TPDO + MAPPING.replace("rw\nDefaultValue=1", "ro\nDefaultValue=1"), "",
         "1A00sub1=0x20010010"),
    ],
)  # fmt: skip
def test_communication_parameters_are_written(text: str, before: str, values: str) -> None:
    writer, _, node = load(small_eds(text), values, before=before)
    assert writer.refused == {}
    for value in values.split():
        index, sub, number = re.fullmatch(r"(\w{4})(?:sub(\w))?=(\w+)", value).groups()
        assert node.od.number(int(index, 16), int(sub or "0", 16)) == int(number, 0), value


def test_a_period_that_is_not_stated_is_kept() -> None:
    _, _, node = load(small_eds(SYNC), "1019=20", before="1006=1000")
    assert node.od.number(0x1006) == 1000


def test_a_cob_id_that_is_not_stated_is_kept() -> None:
    """The device has another one than the EDS."""
    _, client, node = load(
        small_eds(STATUS + TPDO + MAPPING), "1A00sub1=0x20010010", before="1800sub1=0x1A1"
    )
    assert node.od.number(0x1800, 1) == 0x1A1
    assert client.downloads == [
        (0x1800, 1, 0x800001A1),
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x20010010),
        (0x1A00, 0, 1),
        (0x1800, 1, 0x1A1),
    ]


def test_a_pdo_whose_mapping_is_refused_is_left_invalid() -> None:
    text = small_eds(STATUS + TPDO + MAPPING)
    writer, _, node = load(text, "1A00sub1=0x77770010 1800sub2=254")
    assert node.od.number(0x1800, 1) == 0x80000189
    assert node.od.number(0x1800, 2) == 254
    assert [entry.name for entry in writer.refused] == [
        "Object 1A00.Entry 1A00sub1",
        "Object 1800.Entry 1800sub1",
    ]


def test_commands_and_the_default_sdo_are_no_values() -> None:
    """To store, restore and clear are left to the user, and 1200h is the SDO in use."""
    text = small_eds(
        record("1010", entry("1010sub0", 5, "const", "1"), entry("1010sub1", 7, "rw", "1"))
        + record("1003", entry("1003sub0", 5, "rw", "0"), entry("1003sub1", 7, "ro", "0"))
        + record("1200", entry("1200sub0", 5, "const", "2"), entry("1200sub1", 7, "rw", "0x609"))
    )
    _, client, _ = load(text, "1010sub1=1 1003sub0=0 1200sub1=0x609 1017=200")
    assert client.downloads == [(0x1017, 0, 200)]


def test_a_multiplexed_pdo_is_written() -> None:
    """Its number FEh is not a number of objects."""
    _, client, _ = load(small_eds(STATUS + TPDO + MAPPING), "1A00sub0=0xFE")
    assert (0x1A00, 0, 0xFE) in client.downloads


def test_the_date_of_the_configuration_is_last() -> None:
    dates = [entry(f"1020sub{n}", 7, "rw", "0") for n in (1, 2)]
    text = small_eds(record("1020", entry("1020sub0", 5, "const", "2"), *dates, kind=8))
    _, client, _ = load(text, "1020sub1=5 1020sub2=6 1017=200")
    indices: Sequence[int] = [index for index, _, _ in client.downloads]
    assert indices == [0x1017, 0x1020, 0x1020]


# The values of a device as a DCF, and differences.


def values_of(node: DeviceNode) -> list[tuple[str, object]]:
    return [(entry.name, entry.value) for entry in node.device.od]


TEXT = record(
    "2010",
    entry("2010sub0", 5, "const", "6"),
    entry("2010sub1", 9, "rw", "text"),
    entry("2010sub2", 8, "rw", "0.1"),
    entry("2010sub3", 0xA, "rw", "00 FF"),
    entry("2010sub4", 4, "rw", "-1"),
    entry("2010sub5", 7, "wo", "1"),
    entry("2010sub6", 0xF, "rw", "00"),
)
COMPACT = (
    "[1A00]\nParameterName=Mapping\nObjectType=9\nDataType=7\nAccessType=rw\nCompactSubObj=4\n"
    "[1A00Value]\nNrOfEntries=1\n1=0x20000010\n"
)


def changed(node: DeviceNode) -> None:
    od = node.device.od
    od.entry(0x1017).value = 250
    if 0x2010 in od.objects:
        for subindex, value in ((1, "a b"), (2, 0.10000000149011612), (3, b"\x00\x01"), (4, -7)):
            od.entry(0x2010, subindex).value = value
    if 0x1A00 in od.objects:
        od.entry(0x1A00, 0).value = 0
        od.entry(0x1A00, 1).value = 0x20010010


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("small", small_eds()),
        ("types", small_eds(TEXT)),
        ("pdo", small_eds(STATUS + TPDO + MAPPING, tx=1)),
        ("compact", small_eds(STATUS + TPDO + COMPACT, tx=1)),
        ("heartbeats", small_eds(SYNC + CONSUMER + SERVER)),
    ],
)
def test_a_saved_dcf_loads_without_any_change(name: str, text: str, tmp_path: Path) -> None:
    eds, saved = written(tmp_path, text), tmp_path / "saved.dcf"
    options = bus(f"save {name}")
    node = device(text)
    with in_threads({"interface": "virtual", "channel": options[3]}, node, lockstep=False):
        changed(node)
        before = values_of(node)
        said = succeed("eds", "save", "--node", "9", saved, "--eds", eds, *options)
        assert re.search(r"node 9: \d+ values saved, 0 not", said)
        assert succeed("eds", "diff", saved, *options) == ""
        assert "0 refused or different" in succeed("eds", "load", saved, *options)
        assert values_of(node) == before
        od = load_eds(saved.read_text(), NODE_ID)
        kept = [(e.name, e.value) for e in od if e.writable and e.readable]
        assert kept == [(e.name, e.value) for e in node.device.od if e.writable and e.readable]
        node.device.od.entry(0x1017).value = 300
        line = run("eds", "diff", saved, *options)
        assert (line.exit_code, line.stdout) == (1, "1017h:0 Producer heartbeat time: 250 | 300\n")


def test_a_device_is_saved_by_the_eds_that_it_has(tmp_path: Path) -> None:
    text = small_eds("[1021]\nParameterName=EDS\nObjectType=2\nDataType=0xF\nAccessType=ro\n")
    saved, options = tmp_path / "saved.dcf", bus("save own")
    node = device(text)
    with in_threads({"interface": "virtual", "channel": options[3]}, node, lockstep=False):
        changed(node)
        succeed("eds", "save", "--node", "9", saved, *options)
        assert load_eds(saved.read_text(), NODE_ID).number(0x1017) == 250
    assert "LastEDS=1021h\n" in saved.read_text()


def test_process_data_are_not_saved(tmp_path: Path) -> None:
    control = entry("6040", 6, "rw", "0", "PDOMapping=1") + entry("6042", 6, "rww", "0")
    mapping = record(
        "1600", entry("1600sub0", 5, "rw", "1"), entry("1600sub1", 7, "rw", "0x60400010")
    )
    text = small_eds(control + mapping + entry("6081", 7, "rw", "7", "PDOMapping=1"))
    eds, saved, options = written(tmp_path, text), tmp_path / "saved.dcf", bus("process")
    node = device(text)
    with in_threads({"interface": "virtual", "channel": options[3]}, node, lockstep=False):
        for index in (0x6040, 0x6042, 0x6081):
            node.device.od.entry(index).value = 15
        succeed("eds", "save", "--node", "9", saved, "--eds", eds, *options)
    od = load_eds(saved.read_text(), NODE_ID)
    assert [od.number(index) for index in (0x6040, 0x6042, 0x6081)] == [0, 0, 15]


def test_dcf_save_names_values_that_cannot_be_read(tmp_path: Path) -> None:
    eds, saved = written(tmp_path, small_eds(TEXT)), tmp_path / "saved.dcf"
    node, options = device(small_eds(TEXT).replace("[2010sub4]", "[2010sub7]")), bus("save not")
    with in_threads({"interface": "virtual", "channel": options[3]}, node, lockstep=False):
        node.device.od.entry(0x2010, 1).value = "two\nlines"
        result = run("eds", "save", "--node", "9", saved, "--eds", eds, *options)
        assert result.exit_code == 1
        lines = [line.partition("saved.dcf: ")[2] for line in result.stdout.splitlines()]
        assert lines[0].startswith("[2010sub4] the device refuses to read it: ")
        assert lines[1] == "2010sub1: its value has no form in a DCF"
        text = saved.read_text()
        assert "; [2010sub4] the device refuses to read it: " in text
        assert "\n; 2010h:1 " in text
        assert "another device" in refusal(
            *("eds", "save", "--node", "9", tmp_path / "b.dcf", "--eds"),
            *(written(tmp_path, small_eds().replace("0x9A", "0x9B")), *options),
        )
        assert "has no EDS in 1021h" in refusal(
            "eds", "save", "--node", "9", tmp_path / "b.dcf", *options
        )
    assert not (tmp_path / "b.dcf").exists()


def test_two_dcfs_differ_in_values_and_commissioning(tmp_path: Path) -> None:
    first = dcf(tmp_path, small_eds(), "1017=200").rename(tmp_path / "first.dcf")
    assert succeed("eds", "diff", first, first) == ""
    second = dcf(tmp_path, small_eds(TEXT), "1017=300")
    result = run("eds", "diff", first, second, "--json")
    assert result.exit_code == 1
    rows = json.loads(result.stdout)["differences"]
    assert rows[0] == {
        "address": "1017h:0",
        "name": "Producer heartbeat time",
        "first": 200,
        "second": 300,
    }
    assert [row["first"] for row in rows[1:]] == [None] * 7
    second.write_text(second.read_text().replace("Baudrate=500", "Baudrate=250"))
    assert "baudrate: 500 | 250\n" in run("eds", "diff", first, second).stdout
