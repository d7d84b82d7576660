import pytest
from one_device import download, fewer_bytes, play, started, upload

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.service import Application
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.entry import Entry


def write_segmented(device: Device, index: int, data: bytes, *, announce: bool = True) -> int:
    def request(payload: bytes) -> bytes:
        (answer,) = device.receive(Frame(0x620, payload.ljust(8, b"\0")))
        return answer.data

    address = index.to_bytes(2, "little") + b"\0"
    size = len(data).to_bytes(4, "little") if announce else bytes(4)
    answer = request(bytes((0x20 | announce,)) + address + size)
    parts = [data[i : i + 7] for i in range(0, len(data), 7)] or [b""]
    for k, part in enumerate(parts):
        if answer[0] == 0x80:
            break
        toggle = (k & 1) << 4
        last = k == len(parts) - 1
        answer = request(bytes((toggle | (7 - len(part)) << 1 | last,)) + part)
        assert answer[0] in (0x20 | toggle, 0x80)
    return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0


@pytest.mark.parametrize(
    ("index", "subindex", "value", "size", "code"),
    [
        (0x2100, 3, -1001, 2, 0x06090032),
        (0x2100, 3, 1001, 2, 0x06090031),
        (0x2100, 3, -1000, 2, 0),
        (0x2112, 0, 65535, 2, 0),  # wo
        (0x2000, 0, 2, 1, 0x06090031),  # BOOLEAN
        (0x2007, 0, 0x7FC00000, 4, 0x06090030),  # REAL32 not a number
        (0x2007, 0, 0x7F800000, 4, 0x06090031),  # infinity
        (0x2008, 0, 0x80, 1, 0x06090030),  # no visible character
        (0x200A, 0, 0x61, 1, 0x06070010),  # half a UNICODE character
        (0x200B, 0, 0, 4, 0x06070013),
    ],
)
def test_expedited_write(index: int, subindex: int, value: int, size: int, code: int) -> None:
    device = started()
    before = {id(entry): entry.value for entry in device.od}
    assert download(device, index, subindex, value, size) == code
    changed = [e for e in device.od if e.value != before[id(e)]]
    assert len(changed) == (0 if code else 1)


def test_segmented_upload_is_a_snapshot() -> None:
    device = started()
    label = device.od["Label"]
    label.value = "first value"
    play(device, "> 620 40 01 23 00 00 00 00 00\n< 5A0 41 01 23 00 0B 00 00 00")
    label.value = "x"
    play(device, "> 620 60 00 00 00 00 00 00 00\n< 5A0 00 66 69 72 73 74 20 76")


@pytest.mark.parametrize(
    "data", [b"", b"a", b"abcd", b"abcdefg", b"abcdefgh", bytes(range(32, 127)) * 9]
)
@pytest.mark.parametrize("announce", [True, False])
def test_strings_and_domains_of_any_length(data: bytes, announce: bool) -> None:
    device = started()
    assert write_segmented(device, 0x2301, data, announce=announce) == 0
    assert upload(device, 0x2301, 0) == data
    assert write_segmented(device, 0x2300, data, announce=announce) == 0
    assert upload(device, 0x2300, 0) == data


@pytest.mark.sources
def test_segmented_write_of_too_many_bytes_or_too_few(monkeypatch: pytest.MonkeyPatch) -> None:
    device, most = started(), fewer_bytes(monkeypatch)
    assert write_segmented(device, 0x2012, bytes(9)) == 0x06070012
    assert write_segmented(device, 0x2012, bytes(7)) == 0x06070013
    assert write_segmented(device, 0x2012, bytes(9), announce=False) == 0x06070012
    assert write_segmented(device, 0x2012, bytes(7), announce=False) == 0x06070013
    assert write_segmented(device, 0x2300, bytes(most)) == 0
    assert write_segmented(device, 0x2300, bytes(most + 1)) == 0x06070012
    assert write_segmented(device, 0x2300, bytes(most + 1), announce=False) == 0x06070012
    assert device.od["INTEGER64"].value == -(1 << 63)
    assert len(device.od["Texture"].value) == most


def test_more_than_was_announced_is_refused() -> None:
    device = started()
    play(
        device,
        """
        > 620 21 00 23 00 03 00 00 00
        < 5A0 60 00 23 00 00 00 00 00
        > 620 07 01 02 03 04 00 00 00      # 4 bytes
        < 5A0 80 00 23 00 12 00 07 06
        """,
    )
    assert device.od["Texture"].value == b""


@pytest.mark.parametrize("command", ["00", "60", "A1", "A2", "A3", "C1", "E0"])
def test_command_that_fits_nothing(command: str) -> None:
    play(started(), f"> 620 {command} 10 21 00 00 00 00 00\n< 5A0 80 00 00 00 01 00 04 05")


def test_segment_of_the_other_direction() -> None:
    play(
        started(),
        """
        > 620 40 08 10 00 00 00 00 00
        < 5A0 41 08 10 00 11 00 00 00
        > 620 00 00 00 00 00 00 00 00
        < 5A0 80 08 10 00 01 00 04 05
        """,
    )


def test_time_out_after_one_second_of_device_time() -> None:
    play(
        started(),
        """
        > 620 40 08 10 00 00 00 00 00
        < 5A0 41 08 10 00 11 00 00 00
        + 999ms
        > 620 60 00 00 00 00 00 00 00
        < 5A0 ..
        + 999ms
        + 1ms
        < 5A0 80 08 10 00 00 00 04 05
        + 2000ms
        > 620 70 00 00 00 00 00 00 00
        < 5A0 80 00 00 00 01 00 04 05
        """,
    )


def test_application_may_refuse_and_sees_the_old_value() -> None:
    seen = []

    class Guard(Application):
        def on_write(self, entry: Entry, value: int) -> None:
            seen.append((entry.name, entry.value, value))
            if value == 5:
                raise Abort(0x08000021)

    device = started(Guard())
    assert download(device, 0x2110, 0, 5, 1) == 0x08000021
    assert download(device, 0x2110, 0, 4, 1) == 0
    assert download(device, 0x2110, 0, 7, 1) == 0x06090031
    assert seen == [("Mode", 0, 5), ("Mode", 0, 4)], "asked only about what is possible"
    assert device.od["Mode"].value == 4


def test_application_may_refuse_with_a_code_of_its_own() -> None:
    class Guard(Application):
        def on_write(self, entry: Entry, value: int) -> None:
            raise Abort(0x12345678)

    assert download(started(Guard()), 0x2110, 0, 5, 1) == 0x12345678


def test_second_server() -> None:
    device = started()
    assert download(device, 0x1201, 1, 0x640, 4) == 0x06090030, "restricted"
    assert download(device, 0x1201, 1, 0x6C0, 4) == 0
    play(device, "> 6C0 40 10 21 00 00 00 00 00")
    assert download(device, 0x1201, 2, 0x6C1, 4) == 0
    play(
        device,
        """
        > 6C0 40 08 10 00 00 00 00 00
        < 6C1 41 08 10 00 11 00 00 00
        > 620 2F 10 21 00 02 00 00 00        # the first goes its own way
        < 5A0 60 10 21 00 00 00 00 00
        > 6C0 60 00 00 00 00 00 00 00
        < 6C1 00 43 6F 6E 66 6F 72 6D
        """,
    )
    assert download(device, 0x1201, 2, 0x6C2, 4) == 0x08000022
    assert download(device, 0x1201, 2, 0x800006C1, 4) == 0
    play(device, "> 6C0 40 10 21 00 00 00 00 00\n+ 2000ms")


@pytest.mark.parametrize(
    ("index", "structure"),
    [
        (0x1000, 0x0707),
        (0x1003, 0x0708),
        (0x1008, 0x0907),
        (0x1018, 0x2309),
        (0x1200, 0x2209),
        (0x1400, 0x2009),
        (0x1600, 0x2109),
        (0x1800, 0x2009),
        (0x1A00, 0x2109),
        (0x2110, 0x0507),
        (0x2300, 0x0F02),
    ],
)
def test_every_object_tells_its_structure(index: int, structure: int) -> None:
    device = started()
    assert upload(device, index, 0xFF) == structure.to_bytes(4, "little")
    assert download(device, index, 0xFF, structure, 4) == 0x06010002


def test_structure_of_nothing() -> None:
    device = started()
    assert upload(device, 0x5FFF, 0xFF) == 0x06020000
    assert download(device, 0x5FFF, 0xFF, 0, 4) == 0x06020000
