"""Transcripts of frames, one event a line; everything that is not written must not happen.

``power``               power on
``> 000 01 20``         a frame arrives; ``> 1A0 rtr`` is a remote frame
``+ 1000us``            time passes in one step; ``+ 3x 1ms`` in three
``! 2``                 the application triggers a TPDO
``? 3``                 the bus takes up to three segments; only if it does not take all at once
``< 720 05``            the device has sent this, in this order, because of what stands above
``< 720 00 ..``         the same with any data from there on
``# ...``               a remark, also at the end of a line
"""

from __future__ import annotations

import re
from pathlib import Path

from smarttac_can.device.application import Application
from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.od.eds import load_eds

NODE_ID = 0x20
RICH = (Path(__file__).parent.parent / "eds" / "rich.eds").read_text()
_TIME = re.compile(r"(?:(\d+)x )?(\d+)(us|ms)")


def make_device(application: Application | None = None, *, autostart: bool = False) -> Device:
    return Device(load_eds(RICH, NODE_ID), application, autostart=autostart)


def started(application: Application | None = None, *, operational: bool = True) -> Device:
    device = make_device(application)
    device.start()
    if operational:
        device.receive(Frame(0, bytes((1, NODE_ID))))
    return device


def receive(device: Device, request: Frame) -> list[Frame]:
    """What a frame causes on a bus that takes all segments at once."""
    sent = device.receive(request)
    while more := device.segments(127):
        sent += more
    return sent


def play(device: Device, text: str, *, at_once: bool = True) -> None:
    sent: list[Frame] = []
    since = "the beginning"
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.partition("#")[0].strip()
        if not line:
            continue
        what, _, rest = line.partition(" ")
        where = f"line {number}: {line}"
        if what == "<":
            assert sent, f"{where}: nothing was sent"
            _compare(sent.pop(0), rest, where)
            continue
        assert not sent, f"after {since}: also sent {sent}"
        since = where
        if what == ">" and at_once:
            sent += receive(device, frame(rest))
        else:
            sent += _act(device, what, rest)
    assert not sent, f"after {since}: also sent {sent}"


def _act(device: Device, what: str, rest: str) -> list[Frame]:
    if what == "power":
        return device.start()
    if what == ">":
        return device.receive(frame(rest))
    if what == "!":
        device.trigger(int(rest))
        return device.take()
    if what == "?":
        return device.segments(int(rest))
    found = _TIME.fullmatch(rest)
    assert what == "+" and found is not None, f"{what} {rest} is no event"
    step = int(found[2]) * (1000 if found[3] == "ms" else 1)
    return [sent for _ in range(int(found[1] or 1)) for sent in device.advance(step)]


def _compare(sent: Frame, rest: str, where: str) -> None:
    expected = frame(rest.removesuffix(".."))
    if rest.endswith(".."):
        sent = sent._replace(data=sent.data[: len(expected.data)])
    assert sent == expected, f"{where}: sent {show(sent)}"


def frame(text: str) -> Frame:
    can_id, *data = text.split()
    if data == ["rtr"]:
        return Frame(int(can_id, 16), rtr=True)
    return Frame(int(can_id, 16), bytes.fromhex("".join(data)))


def show(sent: Frame) -> str:
    return f"{sent.can_id:03X} {sent.data.hex(' ')}"


def download(device: Device, index: int, subindex: int, value: int, size: int) -> int:
    """Write by expedited SDO; return the abort code, 0 for success."""
    command = 0x23 | (4 - size) << 2
    data = (value & (1 << 8 * size) - 1).to_bytes(size, "little").ljust(4, b"\0")
    address = index.to_bytes(2, "little") + bytes((subindex,))
    answer, *_ = device.receive(Frame(0x600 + NODE_ID, bytes((command,)) + address + data))
    assert answer.can_id == 0x580 + NODE_ID
    assert answer.data[1:4] == address
    if answer.data[0] == 0x80:
        return int.from_bytes(answer.data[4:], "little")
    assert answer.data == b"\x60" + address + bytes(4)
    return 0


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
