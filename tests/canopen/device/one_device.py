"""A device of ``rich.eds`` alone: transcripts of it, and objects read and written by SDO."""

from __future__ import annotations

import pytest
import transcript
from read_once import read_once
from rich_eds import RICH
from transcript import frame, microseconds

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.service import Application
from smarttac_can.canopen.od.entry import MAX_BYTES

NODE_ID = 0x20


def make_device(application: Application | None = None, *, autostart: bool = False) -> Device:
    return Device(read_once(RICH, NODE_ID), application, autostart=autostart)


def started(application: Application | None = None, *, operational: bool = True) -> Device:
    device = make_device(application)
    device.start()
    if operational:
        device.receive(Frame(0, bytes((1, NODE_ID))))
    return device


def fewer_bytes(monkeypatch: pytest.MonkeyPatch) -> int:
    """Let an entry have fewer bytes than the 1 MiB that take long; return how many at most."""
    assert MAX_BYTES == 1 << 20
    for module in ("canopen.od.entry", "canopen.device.sdo"):
        monkeypatch.setattr(f"smarttac_can.{module}.MAX_BYTES", 3000)
    return 3000


def receive(device: Device, request: Frame) -> list[Frame]:
    """Responses to a frame on a bus that takes all segments at once."""
    sent = device.receive(request)
    while more := device.segments(127):
        sent += more
    return sent


def play(device: Device, text: str, *, at_once: bool = True) -> None:
    """Play a transcript; with `at_once` the bus takes all segments without being asked by ``?``."""

    def act(sign: str, what: str) -> list[Frame]:
        if sign == "power":
            return device.start()
        if sign == ">":
            return receive(device, frame(what)) if at_once else device.receive(frame(what))
        if sign == "+":
            return device.advance(microseconds(what))
        if sign == "!":
            device.trigger(int(what))
            return device.take()
        return device.segments(int(what))

    transcript.play(act, text)


def download(device: Device, index: int, subindex: int, value: int, size: int) -> int:
    """Write by expedited SDO; return the abort code, 0 for success."""
    command = 0x23 | (4 - size) << 2
    data = (value & (1 << 8 * size) - 1).to_bytes(size, "little").ljust(4, b"\0")
    address = index.to_bytes(2, "little") + bytes((subindex,))
    sent = device.receive(Frame(0x600 + NODE_ID, bytes((command,)) + address + data))
    (answer,) = [frame for frame in sent if frame.can_id == 0x580 + NODE_ID]
    assert answer.data[1:4] == address
    if answer.data[0] == 0x80:
        return int.from_bytes(answer.data[4:], "little")
    assert answer.data == b"\x60" + address + bytes(4)
    return 0


def reconfigure(device: Device, n: int, *, transmission: int, inhibit: int = 0, event: int = 0,
                start: int = 0, rtr: bool = False) -> None:  # fmt: skip
    """Change a TPDO by the book."""
    record = 0x1800 + n - 1
    cob_id = device.od.entry(record, 1).value & 0x7FF
    flags = 0 if rtr else 0x40000000
    for subindex, value, size in (
        (1, 0x80000000 | flags | cob_id, 4),
        (2, transmission, 1),
        (3, inhibit, 2),
        (5, event, 2),
        (6, start, 1),
        (1, flags | cob_id, 4),
    ):
        assert download(device, record, subindex, value, size) == 0


def upload(device: Device, index: int, subindex: int) -> int | bytes:
    """Read by SDO, expedited or segmented; return the abort code or the bytes."""
    address = index.to_bytes(2, "little") + bytes((subindex,))
    server = Frame(0x600 + NODE_ID, b"\x40" + address + bytes(4))
    (answer,) = device.receive(server)
    assert answer.data[1:4] == address
    if answer.data[0] == 0x80:
        return int.from_bytes(answer.data[4:], "little")
    if answer.data[0] & 2:
        return answer.data[4 : 8 - (answer.data[0] >> 2 & 3)]
    data, toggle = b"", 0
    while True:
        request = Frame(0x600 + NODE_ID, bytes((0x60 | toggle,)) + bytes(7))
        ((_, part, _),) = device.receive(request)
        assert part[0] & 0xF0 == toggle
        data += part[1 : 8 - (part[0] >> 1 & 7)]
        if part[0] & 1:
            break
        toggle ^= 0x10
    assert len(data) == int.from_bytes(answer.data[4:], "little")
    return data
