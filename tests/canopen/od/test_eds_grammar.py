"""EDS files by their grammar: each is refused in one line, or is a device that serves every object.

A file is sections of objects of CiA 301 and of a manufacturer, in any order and case, compact or
not, with types, access, limits and counts that need not agree, in the code pages that are met.
"""

from contextlib import suppress
from datetime import datetime
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from smarttac_can.canopen.commissioning.dbc import NO_NAMES, make_dbc
from smarttac_can.canopen.commissioning.dcf import make_dcf
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.eds import EDSError, load_eds, node_id_of, read_sections
from smarttac_can.canopen.od.eds_check import check_eds
from smarttac_can.host.files import read_eds_file

NODE_ID = 9
MOST_FRAMES = 1000
INDICES = (
    0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1007, 0x1008, 0x100C, 0x100D, 0x1010, 0x1011, 0x1012,
    0x1014, 0x1015, 0x1016, 0x1017, 0x1018, 0x1019, 0x1020, 0x1021, 0x1028, 0x1029, 0x1200, 0x1201,
    0x1280, 0x1400, 0x1600, 0x1800, 0x1A00, 0x1F80, 0x2000, 0x2001, 0x6040, 0x6041,
)  # fmt: skip
TYPES = (1, 2, 3, 4, 5, 6, 7, 8, 9, 0xA, 0xB, 0xC, 0xF, 0x10, 0x11, 0x15, 0x16, 0x1B)
ODD_VALUES = ("text", "-1", "0xFFFFFFFFF", "1.5", "00 FF", "$NODEID", "0x600+$NODEID", "08")
BYTE = ("", "0", "1", "2", "8", "127")
WORD = (*BYTE, "1000", "0x201", "$NODEID+0x180")
LONG = (
    *WORD, "0x600+$NODEID", "0x80000000", "0x40000080", "0x20000010", "0x60410010", "0x20000108",
    "0x000A0064", "0x000B0064",
)  # fmt: skip
VALUES = {
    1: ("", "0", "1"), 2: BYTE, 5: (*BYTE, "254", "255"), 3: WORD, 6: WORD, 8: ("", "0", "1.5"),
    9: ("", "text", "200"), 0xA: ("", "00 FF"), 0xB: ("", "text"), 0xC: ("", "0"),
    0xF: ("", "00 FF"), 0x11: ("", "1.5"), 0x10: WORD, 0x16: WORD,
}  # fmt: skip
"""Values that suit a data type; those of 4 and 8 bytes have `LONG`."""
ACCESS = ("ro", "rw", "wo", "const", "rww", "rwr", "RW")


def _suiting(kind: int) -> tuple[str, ...]:
    return VALUES.get(kind, ("", "0", "7", "0x7FFFFFFF") if kind in (4, 0x15) else LONG)


@st.composite
def keys(draw: st.DrawFn, *, data_type: int | None = None) -> list[str]:
    """Keys of one entry, most of them of the type that its object has."""
    kind = draw(st.sampled_from(TYPES)) if data_type is None else data_type
    lines = [f"DataType=0x{kind:04X}", f"AccessType={draw(st.sampled_from(ACCESS))}"]
    for key in ("DefaultValue", "LowLimit", "HighLimit", "ParameterValue"):
        rare = key != "DefaultValue"
        if not rare or draw(st.integers(0, 19)) == 0:
            odd = draw(st.integers(0, 149)) == 0
            lines.append(f"{key}={draw(st.sampled_from(ODD_VALUES if odd else _suiting(kind)))}")
    if draw(st.booleans()):
        lines.append("PDOMapping=1")
    return lines


@st.composite
def objects(draw: st.DrawFn, index: int) -> list[list[str]]:
    """Sections of one object: a VAR, sub-indices, or a compact form."""
    name = f"{index:04X}"
    title = f"ParameterName={draw(st.sampled_from(('Object', 'Größe [mm]', 'Gain [1]', '')))}{name}"
    kind = draw(st.sampled_from((7, 7, 8, 9, 9, 2)))
    head = [f"[{name}]", title, f"ObjectType={kind}"]
    # Mostly the type that services expect, so that they get to work with the values.
    own = draw(st.sampled_from((7, 7, 5, 6, None)))
    if kind in (2, 7):
        return [[*head, *draw(keys(data_type=own))]]
    if draw(st.integers(0, 3)) == 0:
        compact = [*head, f"CompactSubObj={draw(st.sampled_from((1, 3, 8, 254)))}"]
        values = [f"[{name}Value]", "NrOfEntries=1", f"1={draw(st.sampled_from(BYTE))}"]
        return [[*compact, *draw(keys(data_type=own))], values]
    chosen = draw(st.lists(st.sampled_from((0, 1, 2, 3, 5, 8, 0xC, 0xFF)), unique=True))
    made = [[*head, f"SubNumber={len(chosen)}"]]
    for sub in chosen:
        entry = draw(keys(data_type=5 if sub == 0 else own))
        made.append([f"[{name}sub{sub:X}]", f"ParameterName=Sub{sub}", *entry])
    return made


@st.composite
def files(draw: st.DrawFn) -> bytes:
    """Bytes of a whole file."""
    info = ["[DeviceInfo]", f"NrOfRXPDO={draw(st.integers(0, 3))}", "NrOfTXPDO=2"]
    info += draw(st.sampled_from(([], ["CompactPDO=0x3F"], ["CompactPDO=2"], ["LSS_Supported=1"])))
    sections = [info, ["[DummyUsage]", "Dummy0005=1"]]
    for index in draw(st.lists(st.sampled_from(INDICES), unique=True, min_size=1, max_size=8)):
        sections += draw(objects(index))
    lines = []
    for name, *keys_of in draw(st.permutations(sections)):
        lines += [*draw(st.sampled_from(([], [""], ["; a remark"]))), name]
        lines += reversed(keys_of) if draw(st.booleans()) else keys_of
    equals = draw(st.sampled_from(("=", " = ", "=\t")))
    lines = [line.replace("=", equals, 1) for line in lines]
    text = draw(st.sampled_from(("\n", "\r\n"))).join(lines)
    text = draw(st.sampled_from((str, str.upper, str.lower)))(text)
    return text.encode(draw(st.sampled_from(("utf-8", "utf-8-sig", "cp1252"))))


def serve(device: Device, data: bytes) -> list[Frame]:
    """Answers of the SDO server, with all segments that it streams."""
    frames = device.receive(Frame(0x600 + NODE_ID, data))
    while more := device.segments(100):
        frames += more
        assert len(frames) < MOST_FRAMES
    return frames


def server_of_bytes(index: str, *subs: int) -> bytes:
    """A file whose SDO server has CAN-IDs of one byte."""
    lines = [f"[{index}]", "ParameterName=Server", "ObjectType=8", f"SubNumber={len(subs) + 1}"]
    for sub in (0, *subs):
        lines += [f"[{index}sub{sub}]", f"ParameterName=Sub{sub}", "DataType=5", "AccessType=ro"]
    return "\n".join(lines).encode()


def history_counted_by(data_type: int, default: str) -> bytes:
    """A file whose number of errors has another type than UNSIGNED8."""
    lines = ["[1003]", "ParameterName=Errors", "ObjectType=7", "AccessType=ro"]
    return "\n".join([*lines, f"DataType={data_type}", f"DefaultValue={default}"]).encode()


@given(content=files())
@example(content=history_counted_by(8, "-1"))
@example(content=history_counted_by(9, "text"))
@example(content=server_of_bytes("1200", 2))
@example(content=server_of_bytes("1200", 1))
@example(content=server_of_bytes("1201", 1, 2))
@settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow])
def test_an_eds_is_refused_in_one_line_or_served(
    content: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = Path(tmp_path_factory.getbasetemp(), "grammar.eds")
    path.write_bytes(content)
    text = read_eds_file(path)
    assert all("\n" not in str(finding) for finding in check_eds(text, path.name))
    try:
        od = load_eds(text, NODE_ID)
    except EDSError as error:
        assert "\n" not in str(error)
        return
    device = Device(od)
    sent = device.start()
    sent += device.receive(Frame(0, b"\x01\x00"))
    for entry in [*od]:
        for sub in (entry.subindex, 0xFF):
            where = bytes((entry.index & 0xFF, entry.index >> 8, sub))
            answers = serve(device, b"\x40" + where + bytes(4))
            assert answers[-1].can_id == 0x580 + NODE_ID
            assert answers[-1].data[1:4] == where
            serve(device, b"\x80" + where + bytes(4))
            if answers[-1].data[0] & 0xE3 == 0x43:  # expedited, so it can be written back
                size = answers[-1].data[0] >> 2 & 3
                back = bytes((0x23 | size << 2,)) + where + answers[-1].data[4:]
                serve(device, back)
    for request in (b"\x01", b"\x80", b"\x01", b"\x82", b"\x81"):
        sent += device.receive(Frame(0, request + b"\x00"))
        device.emergency(0x5000, 0x21, b"\1\2\3\4\5")
        sent += device.take()
        for number in device._pdos.tpdos:
            device.trigger(number)
        sent += device.receive(Frame(od.sync_id, b""))
        sent += device.advance(50_000)
    assert not [frame for frame in sent if frame.can_id == 0], "it gives no NMT commands"


@given(content=files())
@settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow])
def test_a_dcf_has_the_values_of_the_eds(
    content: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = Path(tmp_path_factory.getbasetemp(), "grammar.eds")
    path.write_bytes(content)
    text = read_eds_file(path)
    try:
        od = load_eds(text, NODE_ID)
    except EDSError:
        return
    made = make_dcf(
        text, node_id=NODE_ID, bit_rate=500_000, values={}, eds_name="a.eds", dcf_name="a.dcf",
        now=datetime(2026, 1, 1),
    )  # fmt: skip
    assert node_id_of(read_sections(made, [])) == NODE_ID
    again = load_eds(made, NODE_ID)
    assert [(str(entry), entry.access, entry.low, entry.high) for entry in again] == [
        (str(entry), entry.access, entry.low, entry.high) for entry in od
    ]
    with suppress(ValueError):  # of a PDO that does not suit a DBC, in one line
        make_dbc(od, NO_NAMES)
