import re
from unittest.mock import Mock, patch

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_device import make_device, play, started
from read_once import read_once
from rich_eds import RICH

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.storage import Memory

SELECT = """
    > 7E5 40 23 01 00 00 00 00 00
    > 7E5 41 07 00 00 00 00 00 00
    > 7E5 42 00 00 01 00 00 00 00
    > 7E5 43 2A 00 00 00 00 00 00
    < 7E4 44 00 00 00 00 00 00 00
"""
CONFIGURE_NODE_30 = "> 7E5 11 30 00 00 00 00 00 00\n< 7E4 11 00 00 00 00 00 00 00\n"
STORE = "> 7E5 17 00 00 00 00 00 00 00\n< 7E4 17 00 00 00 00 00 00 00\n"
WAIT = "> 7E5 04 00 00 00 00 00 00 00\n"
CONFIGURE = "> 7E5 04 01 00 00 00 00 00 00\n"
INQUIRE_NODE_ID = "> 7E5 5E 00 00 00 00 00 00 00\n< 7E4 5E {} 00 00 00 00 00 00\n"


def unconfigured(memory: Memory | None = None, **options: bool) -> Device:
    return Device(read_once(RICH, 0x20), storage=memory, node_id=255, **options)


def test_unconfigured_device_waits_without_boot_up() -> None:
    device = unconfigured()
    play(
        device,
        """
        power
        + 5000ms
        > 620 40 00 10 00 00 00 00 00
        > 67F 40 00 10 00 00 00 00 00
        > 000 01 00
        > 000 82 00
        > 080
        > 7FF rtr
        > 720 rtr
        > 7E5 4C 00 00 00 00 00 00 00
        < 7E4 50 00 00 00 00 00 00 00
        """,
    )
    assert device.node_id == 255
    assert device.nmt_state is NMTState.INITIALISING


def test_it_starts_when_the_master_has_given_it_a_node_id() -> None:
    device = unconfigured()
    play(
        device,
        "power\n" + CONFIGURE + INQUIRE_NODE_ID.format("FF") + CONFIGURE_NODE_30 + WAIT
        + """
        < 730 00
        > 7E5 4C 00 00 00 00 00 00 00
        > 630 40 14 10 00 00 00 00 00
        < 5B0 43 14 10 00 B0 00 00 00
        > 620 40 14 10 00 00 00 00 00
        > 000 01 30
        > 730 rtr
        < 730 05
        """,
    )  # fmt: skip
    assert device.node_id == device.od.node_id == 0x30
    assert device.od.number(0x1800, 1) & 0x7FF == 0x1B0


def test_autostart_after_lss() -> None:
    device = unconfigured(autostart=True)
    play(device, "power\n" + CONFIGURE + CONFIGURE_NODE_30 + WAIT + "< 730 00")
    assert device.nmt_state is NMTState.OPERATIONAL


def test_new_node_id_takes_effect_at_the_reset() -> None:
    device = make_device()
    play(
        device,
        "power\n< 720 00\n" + SELECT + CONFIGURE_NODE_30 + INQUIRE_NODE_ID.format("20") + WAIT
        + """
        > 720 rtr
        < 720 7F
        > 000 82 20
        < 730 00
        > 720 rtr
        > 730 rtr
        < 730 7F
        """,
    )  # fmt: skip


@pytest.mark.parametrize(("given", "node_id"), [(None, 0x30), (255, 0x30), (0x21, 0x21)])
def test_stored_node_id(given: int | None, node_id: int) -> None:
    memory = Memory()
    play(
        unconfigured(memory),
        "power\n" + CONFIGURE + CONFIGURE_NODE_30 + STORE + WAIT + "< 730 00",
    )
    device = Device(read_once(RICH, 0x20), storage=memory, node_id=given)
    assert device.start() == [Frame(0x700 + node_id, b"\0")]


def test_node_id_can_be_taken_away() -> None:
    device = make_device()
    play(
        device,
        "power\n< 720 00\n" + CONFIGURE
        + "> 7E5 11 FF 00 00 00 00 00 00\n< 7E4 11 00 00 00 00 00 00 00\n> 000 81 20\n+ 5000ms",
    )  # fmt: skip
    assert device.node_id == 255


def test_refusals() -> None:
    play(
        make_device(),
        "power\n< 720 00\n" + CONFIGURE
        + """
        > 7E5 11 00 00 00 00 00 00 00
        < 7E4 11 01 00 00 00 00 00 00
        > 7E5 11 80 00 00 00 00 00 00
        < 7E4 11 01 00 00 00 00 00 00
        > 7E5 13 00 05 00 00 00 00 00       # reserved
        < 7E4 13 01 00 00 00 00 00 00
        > 7E5 13 00 09 00 00 00 00 00       # automatic detection
        < 7E4 13 01 00 00 00 00 00 00
        > 7E5 13 01 00 00 00 00 00 00       # another table
        < 7E4 13 01 00 00 00 00 00 00
        > 7E5 13 00 02 00 00 00 00 00
        < 7E4 13 00 00 00 00 00 00 00
        """,
    )  # fmt: skip


def test_a_failing_storage_is_told() -> None:
    class Full(Memory):
        def write(self, data: bytes) -> None:
            raise OSError

    device = unconfigured(Full())
    play(device, "power\n" + CONFIGURE + "> 7E5 17 00 00 00 00 00 00 00\n< 7E4 17 02" + " 00" * 6)


def test_bit_timing_is_stored_and_left_to_the_host() -> None:
    memory = Memory()
    device = Device(read_once(RICH, 0x20), storage=memory)
    activate = "> 7E5 15 64 00 00 00 00 00 00\n"
    play(device, "power\n< 720 00\n" + CONFIGURE + activate)
    assert device.bit_rate is None
    play(device, "> 7E5 13 00 02 00 00 00 00 00\n< 7E4 13 00 00 00 00 00 00 00\n" + STORE)
    assert device.bit_rate is None
    play(device, activate)
    assert device.bit_rate == 500
    again = Device(read_once(RICH, 0x20), storage=memory)
    play(again, "power\n< 720 00\n" + CONFIGURE + activate)
    assert again.bit_rate == 500


def test_inquiries() -> None:
    play(
        started(operational=False),
        CONFIGURE
        + """
        > 7E5 5A 00 00 00 00 00 00 00
        < 7E4 5A 23 01 00 00 00 00 00
        > 7E5 5B 00 00 00 00 00 00 00
        < 7E4 5B 07 00 00 00 00 00 00
        > 7E5 5C 00 00 00 00 00 00 00
        < 7E4 5C 00 00 01 00 00 00 00
        > 7E5 5D 00 00 00 00 00 00 00
        < 7E4 5D 2A 00 00 00 00 00 00
        """
        + INQUIRE_NODE_ID.format("20")
        + WAIT
        + "> 7E5 5E 00 00 00 00 00 00 00\n> 7E5 11 30 00 00 00 00 00 00",
    )


@pytest.mark.parametrize("line", range(1, 5))
def test_another_identity_is_not_selected(line: int) -> None:
    lines = SELECT.splitlines()
    lines[line] = re.sub("(7E5 ..) ..", r"\1 99", lines[line])
    play(started(operational=False), "\n".join(lines[:-1]) + "\n" + "> 7E5 5E" + " 00" * 7)


IDENTIFY = ["46 23 01", "47 07 00", "48 00 00 01", "49 00 00 01", "4A 2A 00", "4B 2A 00"]


def identify(parts: list[str]) -> str:
    return "".join(f"> 7E5 {(part + ' 00' * 8)[:23]}\n" for part in parts)


def test_identify() -> None:
    play(started(operational=False), identify(IDENTIFY) + "< 7E4 4F" + " 00" * 7)
    wide = [*IDENTIFY[:2], "48 00 00 00", "49 FF FF FF", "4A 29 00", "4B 2B 00"]
    play(started(operational=False), identify(wide) + "< 7E4 4F" + " 00" * 7)
    for part, other in [(0, "46 24 01"), (1, "47 08"), (2, "48 01 00 01"), (3, "49 FF FF 00"),
                        (4, "4A 2B 00"), (5, "4B 29 00")]:  # fmt: skip
        parts = [*IDENTIFY]
        parts[part] = other
        play(started(operational=False), identify(parts))


def test_only_devices_without_node_id_take_part_in_a_fastscan() -> None:
    start = "> 7E5 51 00 00 00 00 80 00 00\n"
    play(started(operational=False), start + "> 7E5 4C" + " 00" * 7)
    device = unconfigured()
    play(device, "power\n" + start + "< 7E4 4F" + " 00" * 7)


def test_operational_devices_do_not_listen() -> None:
    play(started(), CONFIGURE + "> 7E5 5E" + " 00" * 7)


at_once = patch("canopen.lss.time", Mock())
"""python-canopen waits 10 ms after each frame for slow devices."""


class Bus:
    """Devices on a python-canopen network."""

    def __init__(self, *devices: Device) -> None:
        self.devices = devices
        self.heard: list[Frame] = []
        self.network = canopen.Network()
        self.network.send_message = self.send
        self.network.lss.RESPONSE_TIMEOUT = 0.001
        self.network.subscribe(0x7E4, self.network.lss.on_message_received)

    def send(self, can_id: int, data: bytes, remote: bool = False) -> None:
        for device in self.devices:
            for frame in device.receive(Frame(can_id, bytes(data), remote)):
                self.heard.append(frame)
                self.network.notify(frame.can_id, bytearray(frame.data), 0.0)


@at_once
@given(st.integers(0, 0xFFFFFFFF), st.integers(0, 0xFFFFFFFF))
@settings(max_examples=3)
def test_fastscan_by_python_canopen(serial: int, product: int) -> None:
    od = read_once(RICH, 1)
    od.entry(0x1018, 2).value = product
    od.entry(0x1018, 4).value = serial
    device = Device(od, node_id=255)
    device.start()
    bus = Bus(device)
    lss = bus.network.lss
    assert lss.fast_scan() == (True, [0x123, product, 0x10000, serial])
    lss.configure_node_id(0x42)
    lss.store_configuration()
    lss.send_switch_state_global(lss.WAITING_STATE)
    assert bus.heard[-1] == Frame(0x742, b"\0")
    assert device.start() == [Frame(0x742, b"\0")]


@at_once
def test_two_devices_get_their_node_ids_one_by_one() -> None:
    devices = [
        Device(read_once(RICH.replace("DefaultValue=42\n", f"DefaultValue={s}\n"), 1), node_id=255)
        for s in (42, 1 << 31)
    ]
    for device in devices:
        device.start()
    lss = Bus(*devices).network.lss
    for node_id in (5, 6):
        found, _ = lss.fast_scan()
        assert found
        lss.configure_node_id(node_id)
        lss.send_switch_state_global(lss.WAITING_STATE)
    assert sorted(device.node_id for device in devices) == [5, 6]
    assert not lss.fast_scan()[0]


@pytest.mark.parametrize("node_id", [0, 128, 254, 256])
def test_node_id_outside_its_range(node_id: int) -> None:
    with pytest.raises(ValueError, match=f"node_id {node_id} is outside"):
        Device(read_once(RICH, 1), node_id=node_id)
