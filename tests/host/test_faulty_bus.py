"""Each frame_fault acts as named, on the frames given, and the same with the same seed."""

import pytest
from toy_node import (
    AT_SYNC,
    BOOT_UP,
    EMERGENCY,
    OFF,
    REQUEST,
    SEGMENT,
    SYNC,
    TICKER,
    StreamingNode,
    ToyNode,
)

from smarttac_can.canopen.bus.local_bus import Connection, LocalBus
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.faulty_bus import Disturbance, FaultyBus, FrameFault


class Bench:
    """A toy node and a master that sends SYNC, and all frames on the bus."""

    def __init__(
        self, seed: int = 1, node: ToyNode | None = None, *, lockstep: bool = True
    ) -> None:
        self.frames: list[Frame] = []
        self.bus = FaultyBus(seed, log=lambda _time, frame: self.frames.append(frame))
        self.master = self.bus.connect(lambda frame: None)
        self.node = node or ToyNode()
        self.port: Connection = self.bus.attach(self.node, lockstep=lockstep)
        del self.frames[:]

    def cycles(self, count: int) -> list[Frame]:
        del self.frames[:]
        for _ in range(count):
            self.master.send(SYNC)
        return list(self.frames)

    def ids(self, count: int) -> list[int]:
        return [frame.can_id for frame in self.cycles(count)]

    def disturb(
        self, frame_fault: FrameFault, *can_ids: int, share: float = 1.0, cycles: int = 1
    ) -> None:
        self.bus.disturbances.append(Disturbance(frame_fault, frozenset(can_ids), share, cycles))


REPORT = AT_SYNC + 1


def test_without_faults_it_is_a_local_bus() -> None:
    bench = Bench()
    frames: list[Frame] = []
    bus = LocalBus(log=lambda _time, frame: frames.append(frame))
    master = bus.connect(lambda frame: None)
    bus.attach(ToyNode())
    del frames[:]
    for _ in range(12):
        master.send(SYNC)
    assert bench.cycles(12) == frames
    assert bench.bus.time == bus.time


def test_lost_frame_is_not_on_the_bus() -> None:
    bench = Bench()
    bench.disturb(FrameFault.LOSS, REPORT)
    assert REPORT not in bench.ids(5)
    assert len(bench.node.heard) == 5


def test_segments_are_lost_as_other_frames_are() -> None:
    bench = Bench(node=StreamingNode())
    sent = [Frame(SEGMENT + 1, bytes((k,))) for k in range(255)]
    for share, least, most in ((0.0, 255, 255), (0.3, 100, 254), (1.0, 0, 0)):
        bench.bus.disturbances.clear()
        bench.disturb(FrameFault.LOSS, SEGMENT + 1, share=share)
        del bench.frames[:]
        bench.master.send(Frame(REQUEST + 1, b"\xff"))
        came = bench.frames[2:]
        assert least <= len(came) <= most
        assert came == [frame for frame in sent if frame in came]


def test_duplicate_follows_at_once() -> None:
    bench = Bench()
    bench.disturb(FrameFault.DUPLICATION, REPORT)
    assert bench.ids(1) == [SYNC.can_id, REPORT, REPORT]


def test_reordered_frame_comes_behind_the_senders_next_one() -> None:
    bench = Bench()
    bench.cycles(4)
    bench.disturb(FrameFault.REORDERING, TICKER + 1)
    frames = bench.cycles(1)
    assert [frame.can_id for frame in frames] == [SYNC.can_id, REPORT, TICKER + 1]


def test_delayed_frame_comes_cycles_later() -> None:
    bench = Bench()
    bench.disturb(FrameFault.DELAY, REPORT, cycles=3)
    assert bench.ids(3) == [SYNC.can_id] * 3
    (late,) = [frame for frame in bench.cycles(1) if frame.can_id == REPORT]
    assert int.from_bytes(late.data, "little") == 1000, "what was measured in the first cycle"


def test_corrupt_frame_differs_in_one_bit() -> None:
    bench, sound = Bench(), Bench()
    bench.disturb(FrameFault.CORRUPTION, REPORT)
    for broken, whole in zip(bench.cycles(20), sound.cycles(20), strict=True):
        difference = int.from_bytes(broken.data) ^ int.from_bytes(whole.data)
        assert difference.bit_count() == (1 if whole.can_id == REPORT else 0)


def test_share_is_drawn_and_the_same_with_the_same_seed() -> None:
    def lost(seed: int) -> list[Frame]:
        bench = Bench(seed)
        bench.disturb(FrameFault.LOSS, REPORT, share=0.3)
        return bench.cycles(500)

    reports = [frame for frame in lost(1) if frame.can_id == REPORT]
    assert 300 < len(reports) < 400
    assert lost(1) == lost(1)
    assert lost(1) != lost(2)


def test_after_the_mishap_all_is_well() -> None:
    bench = Bench()
    bench.disturb(FrameFault.DELAY, REPORT, cycles=2)
    bench.cycles(5)
    bench.bus.disturbances.clear()
    bench.cycles(5)
    assert bench.ids(4).count(REPORT) == 4


def test_powerless_node_is_silent_and_starts_anew() -> None:
    bench = Bench()
    bench.bus.power_off(bench.port)
    assert bench.ids(3) == [SYNC.can_id] * 3
    assert OFF + 1 not in [frame.can_id for frame in bench.frames]
    assert not bench.node.heard
    bench.bus.power_on(bench.port)
    assert bench.frames[-1].can_id == BOOT_UP + 1
    assert REPORT in bench.ids(1)


def test_paused_process_takes_everything_afterwards() -> None:
    bench, sound = Bench(), Bench()
    bench.bus.pause(bench.port)
    assert bench.ids(7) == [SYNC.can_id] * 7
    assert not bench.node.heard
    bench.bus.resume(bench.port)
    sound.cycles(7)
    assert bench.node.heard == sound.node.heard
    assert bench.node.advances == sound.node.advances
    answers = [frame for frame in bench.frames if frame != SYNC]
    assert answers == [frame for frame in sound.frames if frame != SYNC]


def test_paused_process_in_real_time_has_the_time_first() -> None:
    bench = Bench(lockstep=False)
    node = bench.node
    bench.bus.pause(bench.port)
    for _ in range(300):
        bench.bus.advance(1000)
        bench.master.send(SYNC)
    bench.bus.resume(bench.port)
    assert node.late == [300_000], "before it hears a frame"
    assert len(node.heard) == 256, "a queue is full some time"
    assert node.passed == [SYNC] * 255, "all but the newest are overtaken"
    assert node.time == 300_000


def test_clogged_node_is_told_by_its_outbox_and_sends_later() -> None:
    bench = Bench(lockstep=False)
    bench.bus.clog(bench.port, 4)
    failures = []
    for _ in range(6):
        bench.bus.advance(1000)
        bench.master.send(SYNC)
        failures.append(bench.node.failures)
    assert failures[:3] == [0, 1, 2], "one that was not handed over in its cycle, of each"
    others = [(n, f.can_id) for n, f in enumerate(bench.frames) if f != SYNC]
    assert others[0][0] == 3, "nothing before"
    assert EMERGENCY + 1 in [can_id for _, can_id in others]
    assert others[-1][1] == REPORT
    with pytest.raises(ValueError, match="cycles 0 is below 1"):
        bench.bus.clog(bench.port, 0)


class TalkativeNode(ToyNode):
    """A node that answers each event of its bus."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[str] = []

    def bus_off(self) -> list[Frame]:
        self.told.append("off")
        return [Frame(0x123)]

    def bus_recovered(self) -> list[Frame]:
        self.told.append("back")
        return [Frame(0x124)]


def test_bus_off_node_neither_receives_nor_sends() -> None:
    node = TalkativeNode()
    bench = Bench(node=node)
    bench.bus.bus_off(bench.port)
    assert bench.ids(7) == [SYNC.can_id] * 7
    assert not bench.node.heard
    assert bench.node.time == 7000, "its clock goes on"
    del bench.frames[:]
    bench.bus.bus_recovered(bench.port)
    assert bench.frames == [Frame(0x124)]
    assert node.told == ["off", "back"]
    assert REPORT in bench.ids(1)


def test_clock_jumps_and_stands() -> None:
    bench = Bench()
    bench.bus.jump(bench.port, 60_000)
    assert bench.node.time == 60_000
    assert bench.frames[-1].can_id == TICKER + 1
    bench.bus.stop_clock(bench.port)
    bench.cycles(9)
    assert bench.node.time == 60_000
    assert len(bench.node.heard) == 9
    bench.bus.start_clock(bench.port)
    bench.cycles(1)
    assert bench.node.time == 61_000
    with pytest.raises(ValueError, match="microseconds -1 is below 0"):
        bench.bus.jump(bench.port, -1)


def test_babble_comes_in_every_cycle_until_it_ends() -> None:
    bench = Bench()
    bench.bus.babble(3, can_id=0x010)
    assert bench.ids(2).count(0x010) == 6
    bench.bus.babble(0)
    assert 0x010 not in bench.ids(2)


def test_babble_on_a_full_bus_delays_lower_priority() -> None:
    bench = Bench()
    bench.bus.babble(7)
    assert REPORT not in bench.ids(1), "7 frames of 135 us leave 55 us"
    bench.bus.babble(0)
    assert bench.ids(1).count(REPORT) == 2


def test_a_queue_that_waits_for_the_bus_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smarttac_can.host.faulty_bus.QUEUE_FRAMES", 100)
    bench = Bench()
    bench.bus.babble(8)
    bench.cycles(150)
    bench.bus.babble(0)
    waited = len(bench.cycles(1)) - len(bench.cycles(1))
    assert waited == pytest.approx(100, abs=2), "the ticker does not say something always"


def test_more_urgent_frames_pass_the_babble() -> None:
    bench = Bench()
    bench.bus.babble(8, can_id=0x300)
    assert bench.ids(1).count(REPORT) == 1


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"share 1.5 is outside 0\.\.1"):
        Disturbance(FrameFault.LOSS, share=1.5)
    with pytest.raises(ValueError, match="cycles 0 is below 1"):
        Disturbance(FrameFault.DELAY, cycles=0)
    with pytest.raises(ValueError, match=r"identifier 900h is outside 0h\.\.7FFh"):
        Disturbance(FrameFault.LOSS, frozenset({0x900}))
    bus = FaultyBus()
    with pytest.raises(ValueError, match="frames -1 is below 0"):
        bus.babble(-1, 5)
    with pytest.raises(ValueError, match=r"identifier 900h is outside 0h\.\.7FFh"):
        bus.babble(1, 0x900)
