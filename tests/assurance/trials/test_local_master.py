"""A master on a local bus with a node of any EDS: transcripts to the byte."""

from __future__ import annotations

import pytest
from rich_eds import RICH

from smarttac_can.assurance.trials.rig import LocalMaster
from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.master.errors import HeartbeatLostError
from smarttac_can.canopen.od.cia import Abort, NMTCommand
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.instrument.nodes.device_node import DeviceNode

NODE_ID = 0x20
OD = load_eds(RICH, NODE_ID)
DEVICE_TYPE, HEARTBEAT = OD.entry(0x1000), OD.entry(0x1017)


def texts(frames: list[Frame]) -> list[str]:
    return [f"{frame.can_id:03X} {frame.data.hex(' ').upper()}".rstrip() for frame in frames]


class Bench:
    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.heard: list[Frame] = []
        self.bus = LocalBus(log=lambda _time, frame: self.frames.append(frame))
        self.master = LocalMaster(self.bus, self.heard.append)
        self.port = self.bus.attach(DeviceNode(Device(load_eds(RICH, NODE_ID))))


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_reads_and_writes(bench: Bench) -> None:
    bench.master.write(NODE_ID, HEARTBEAT, 250)
    assert bench.master.read(NODE_ID, HEARTBEAT) == 250
    assert texts(bench.frames) == [
        "720 00",
        "620 2B 17 10 00 FA 00 00 00",
        "720 7F",
        "5A0 60 17 10 00 00 00 00 00",
        "620 40 17 10 00 00 00 00 00",
        "5A0 4B 17 10 00 FA 00 00 00",
    ]
    assert texts(bench.heard) == [text for text in texts(bench.frames) if text[:3] != "620"]


def test_refusals_and_silence_are_told(bench: Bench) -> None:
    with pytest.raises(Abort, match="06010002"):
        bench.master.write(NODE_ID, DEVICE_TYPE, 0)
    bench.master.send(requests.nmt(NMTCommand.STOP, NODE_ID))
    with pytest.raises(HeartbeatLostError, match=f"node 32 does not answer to {HEARTBEAT.name}"):
        bench.master.read(NODE_ID, HEARTBEAT)


def test_local_master_finds_its_answer_among_other_frames(bench: Bench) -> None:
    other_answer, answer = "4B 16 10 00 01 00 00 00", "4B 17 10 00 FA 00 00 00"
    chatter = [
        Frame(0x080),
        *[Frame(0x5A0, bytes.fromhex(data)) for data in (other_answer, answer)],
    ]

    def chat(frame: Frame) -> None:
        if frame.can_id == 0x620:
            for each in chatter:
                other.send(each)

    bench.port.close()
    other = bench.bus.connect(chat)
    assert bench.master.read(NODE_ID, HEARTBEAT) == 250


def test_local_master_returns_only_frames_after_its_own(bench: Bench) -> None:
    bench.master.write(NODE_ID, HEARTBEAT, 10)
    bench.bus.advance(10_000)
    assert texts(bench.heard)[-1] == "720 7F"
    asked = requests.upload(NODE_ID, HEARTBEAT)
    answer = "5A0 4B 17 10 00 0A 00 00 00"
    assert texts(bench.master.send(asked, asked)) == [answer, answer]
    assert bench.master.send() == []


def test_sync_counts_to_its_overflow_when_it_has_a_counter(bench: Bench) -> None:
    bench.master.sync()
    bench.master.sync_counter = 239
    for _ in range(3):
        bench.master.sync()
    syncs = [frame for frame in bench.frames if frame.can_id == 0x080]
    assert texts(syncs) == ["080", "080 F0", "080 01", "080 02"]
