import pytest
from one_device import NODE_ID, download, play, upload
from read_once import read_once
from rich_eds import RICH

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.service import Application
from smarttac_can.canopen.device.storage import Image, Memory, pack_image, unpack_image

SAVE, LOAD = 0x65766173, 0x64616F6C
RESET_NODE = Frame(0, bytes((0x81, NODE_ID)))
RESET_COMMUNICATION = Frame(0, bytes((0x82, NODE_ID)))
IDENTITY = (0x123, 7, 0x10000)
HEARTBEAT = (0x1017, 0, 500, 2)
LIMIT = (0x2F00, 0, 30, 2)


def powered(
    memory: Memory, application: Application | None = None, node_id: int = NODE_ID
) -> Device:
    device = Device(read_once(RICH, node_id), application, storage=memory)
    device.start()
    return device


def value(device: Device, parameter: tuple[int, int, int, int]) -> int:
    return device.od.number(*parameter[:2])


@pytest.mark.parametrize("index", [0x1010, 0x1011])
def test_signatures(index: int) -> None:
    memory = Memory()
    device = powered(memory)
    right = SAVE if index == 0x1010 else LOAD
    turned = int.from_bytes(right.to_bytes(4, "little"), "big")
    read = int.from_bytes(upload(device, index, 1), "little")
    # A client that writes back the value read would else believe that something was stored.
    for wrong in (turned, 0, read, SAVE + LOAD - right, 0xFFFFFFFF):
        assert download(device, index, 1, wrong, 4) == 0x08000020
    assert memory.read() is None
    assert download(device, index, 1, right, 4) == 0
    assert memory.read() is not None
    assert upload(device, index, 1) == b"\1\0\0\0"
    assert download(device, index, 0, 4, 1) == 0x06010002


def test_set_points_and_error_history_are_no_parameters() -> None:
    memory = Memory()
    device = powered(memory)
    assert download(device, 0x2110, 0, 3, 1) == 0
    device.emergency(0x1000, 0)
    device.take()
    download(device, 0x1010, 1, SAVE, 4)
    stored = memory.read()
    assert stored is not None
    assert unpack_image(IDENTITY, stored).values == {}


def test_domains_and_strings_are_stored() -> None:
    memory = Memory()
    device = powered(memory)
    device.od["Texture"].value = bytes(range(256)) * 20
    device.od["Label"].value = "bench 3"
    download(device, 0x1010, 4, SAVE, 4)
    again = powered(memory)
    assert again.od["Texture"].value == bytes(range(256)) * 20
    assert again.od["Label"].value == "bench 3"


def test_defaults_follow_the_node_id_of_the_day() -> None:
    memory = Memory()
    device = powered(memory)
    download(device, 0x1800, 2, 1, 1)
    download(device, 0x1010, 1, SAVE, 4)
    other = powered(memory, node_id=0x31)
    assert other.od.number(0x1800, 1) & 0x7FF == 0x1B1
    assert other.od.number(0x1800, 2) == 1


def test_storage_omits_values_set_by_the_application() -> None:
    class Preset(Application):
        def on_state(self, state: NMTState) -> None:
            if state is NMTState.RESET_APPLICATION:
                device.od.entry(0x1017).value = 250
                device.od.entry(0x2F00).value = 60

    memory = Memory()
    device = Device(read_once(RICH, NODE_ID), Preset(), storage=memory)
    device.start()
    assert download(device, 0x2F00, 0, 70, 2) == 0
    assert download(device, 0x1010, 1, SAVE, 4) == 0
    plain = powered(memory)
    assert (value(plain, HEARTBEAT), value(plain, LIMIT)) == (0, 70)
    device.start()
    assert (value(device, HEARTBEAT), value(device, LIMIT)) == (250, 60)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"anything",
        pack_image((0x124, 7, 0x10000), Image()),
        pack_image((0x123, 8, 0x10000), Image()),
        pack_image((0x123, 7, 0x10001), Image()),
        pack_image(IDENTITY, Image(values={(0x5FFF, 0): b"\0"})),
        pack_image(IDENTITY, Image(values={(0x1017, 0): b"\1\0", (0x2F00, 0): b"\0"})),
        pack_image(IDENTITY, Image(values={(0x1017, 0): b"\1\0", (0x2F00, 0): b"\1\0"})),
        pack_image(IDENTITY, Image(values={(0x1017, 0): b"\1\0", (0x1000, 0): bytes(4)})),
    ],
)
def test_foreign_parameters_give_defaults_and_an_emergency(data: bytes) -> None:
    memory = Memory()
    memory.write(data)
    device = Device(read_once(RICH, NODE_ID), storage=memory)
    play(
        device,
        """
        power
        < 720 00
        < 0A0 30 55 01 00 00 00 00 00
        > 620 23 10 10 01 73 61 76 65
        < 0A0 00 00 00 00 00 00 00 00
        < 5A0 60 10 10 01 00 00 00 00
        """,
    )
    assert value(device, HEARTBEAT) == 0
    assert powered(memory).od.number(0x1001) == 0


def test_verify_configuration_compares_the_stored_signature() -> None:
    memory = Memory()
    device = powered(memory)

    def signature(device: Device) -> list[int]:
        return [device.od.number(0x1020, subindex) for subindex in (1, 2)]

    download(device, 0x1020, 1, 123, 4)
    download(device, 0x1020, 2, 456, 4)
    download(device, *HEARTBEAT)
    download(device, 0x1010, 1, SAVE, 4)
    device = powered(memory)
    assert signature(device) == [123, 456]
    download(device, 0x1010, 1, SAVE, 4)
    assert signature(device) == [123, 456], "nothing has changed"
    download(device, 0x1017, 0, 600, 2)
    assert signature(powered(memory)) == [123, 456], "not stored"
    download(device, 0x1010, 1, SAVE, 4)
    assert signature(device) == signature(powered(memory)) == [0, 0]


def test_restoring_takes_the_signature_away() -> None:
    memory = Memory()
    device = powered(memory)
    download(device, *LIMIT)
    download(device, 0x1020, 1, 123, 4)
    download(device, 0x1010, 1, SAVE, 4)
    download(device, 0x1011, 4, LOAD, 4)
    assert powered(memory).od.number(0x1020, 1) == 0


def test_the_eds_can_be_read_from_the_device() -> None:
    device = powered(Memory())
    assert upload(device, 0x1021, 0) == RICH.encode()
    assert upload(device, 0x1022, 0) == b"\0"
    assert download(device, 0x1021, 0, 0, 1) == 0x06010002
