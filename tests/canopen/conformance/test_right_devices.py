"""Devices that are right, and that a suite may condemn: by time, by the EDS, by their defaults."""

from collections import deque
from collections.abc import Iterator

import pytest
from altered_device import EMCY, HEARTBEAT, NODE_ID, SDO, Change, alter, drop, is_frame, judge
from read_once import read_once
from rich_eds import RICH

from smarttac_can.canopen.conformance.case import DeviceDescription, Result
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.instrument.nodes.device_node import DeviceNode


def edited(**sections: str) -> str:
    """Rich EDS with keys of sections set, given as ``s1005="DefaultValue=0x80 LowLimit=0x80"``."""
    text = f"\n{RICH}"
    for name, keys in sections.items():
        head, found, rest = text.partition(f"\n[{name[1:]}]\n")
        assert found, name
        body, gap, tail = rest.partition("\n\n")
        names = tuple(key.partition("=")[0] + "=" for key in keys.split())
        kept = [line for line in body.splitlines() if not line.startswith(names)]
        text = head + found + "\n".join([*kept, *keys.split()]) + gap + tail
    return text[1:]


def of_eds(text: str, only: str) -> list[Result]:
    return judge(text=text, sheet=text, only=only)


def faults(results: list[Result]) -> list[tuple[str, str]]:
    return [(r.case.number, r.reason) for r in results if r.verdict == "fail"]


# A heartbeat that was under way when a reset was sent.


def before_boot_up(*states: int) -> Change:
    def change(frame: Frame) -> Iterator[Frame]:
        if frame == Frame(HEARTBEAT, b"\0"):
            yield from (Frame(HEARTBEAT, bytes((state,))) for state in states)
        yield frame

    return change


@pytest.mark.parametrize("states", [(0x05,), (0x7F, 0x7F), (0x04, 0x85, 0x04)])
def test_heartbeat_under_way_at_a_reset_is_passed_over(states: tuple[int, ...]) -> None:
    only = "HB-01 BOTH-05 BOTH-06 TRANS-03 TRANS-04 OTHER-05"
    results = judge(outwards=before_boot_up(*states), only=only)
    assert [r.verdict for r in results] == ["pass"] * 6


def test_heartbeat_instead_of_a_boot_up_is_a_fault() -> None:
    instead = alter(is_frame(HEARTBEAT, first=0), lambda _: b"\x05")
    (result,) = judge(outwards=instead, only="HB-01")
    assert result.reason == "no boot-up (720h) within 5 s (--timeout 2), but 720 05"


# A device that takes its time where no clause of CiA 301 gives one.


class Slow(DeviceNode):
    """A device that answers SDO requests after a delay in s."""

    def __init__(self, delay: float) -> None:
        device = Device(read_once(RICH, NODE_ID))
        super().__init__(device)
        self._delay = round(delay * 1e6)
        self._now = 0
        self._held: deque[tuple[int, Frame]] = deque()
        self.advance = self._advance
        self.receive = self._receive

    def _receive(self, frame: Frame) -> list[Frame]:
        answers = self.device.receive(frame)
        self._held.extend((self._now + self._delay, f) for f in answers if f.can_id == SDO)
        return [f for f in answers if f.can_id != SDO]

    def _advance(self, microseconds: int) -> list[Frame]:
        self._now += microseconds
        frames = self.device.advance(microseconds)
        while self._held and self._held[0][0] <= self._now:
            frames.append(self._held.popleft()[1])
        return frames


def slow(delay: float, only: str, timeout: float = 2.0) -> list[Result]:
    bus = DeviceTimeBus(Slow(delay))
    cases = [case for case in CASES if case.number in only.split()]
    sheet = DeviceDescription(RICH, NODE_ID)
    return run_cases(Examiner(bus, sheet, timeout=timeout, clock=bus.time), cases)


@pytest.mark.parametrize("delay", [0.3, 0.5, 0.7])
def test_slow_answer_passes_at_the_default_time_out(delay: float) -> None:
    assert faults(slow(delay, "SDO-01 SDO-05 SDO-27 SDO-30 STATE-04 OD-09 EMCY-04")) == []


def test_answer_after_the_time_out_is_a_fault_that_names_it() -> None:
    (result,) = slow(0.7, "SDO-27", timeout=0.5)
    assert result.reason == "no SDO response (5A0h) within 0.5 s (--timeout 0.5)"


def test_server_that_gives_up_by_itself_aborts_by_05040000h() -> None:
    assert judge(only="SDO-13")[0].verdict == "pass"
    late = alter(
        lambda f: f.can_id == SDO and f.data[:1] == b"\x41", lambda data: b"\x41" + data[1:]
    )

    def then(frame: Frame) -> Iterator[Frame]:
        yield from late(frame)
        if frame.can_id == SDO and frame.data[:1] == b"\x41":
            yield frame._replace(data=bytes(8))

    (result,) = judge(outwards=then, only="SDO-13")
    assert result.reason == "without a request the server sends 00 00 00 00 00 00 00 00"


def test_end_of_the_8250h_error_needs_no_emcy() -> None:
    no_reset = drop(lambda f: f.can_id == EMCY and f.data[:2] == b"\0\0")
    assert judge(outwards=no_reset, only="PDO-25")[0].verdict == "pass"


def test_end_of_a_block_upload_is_not_read_as_a_segment() -> None:
    def ended(frame: Frame) -> Iterator[Frame]:
        again = frame.can_id == SDO and frame.data[:1] == b"\x81"
        ended.count += again  # type: ignore[attr-defined]
        done = b"\xcd" + bytes(7)
        yield frame._replace(data=done) if again and ended.count == 2 else frame  # type: ignore[attr-defined]

    ended.count = 0  # type: ignore[attr-defined]
    (result,) = judge(outwards=ended, only="SDO-30")
    assert result.reason == (
        "end of the block upload (cd 00 00 00 00 00 00 00) instead of segment 1"
    )


# Of the EDS itself: limits, bit 30 of a COB-ID, ObjFlags.


@pytest.mark.parametrize(
    ("text", "only", "limited"),
    [
        (edited(s1005="LowLimit=0x80 HighLimit=0x80"), "SYNC-02 SYNC-04 SYNC-05 SYNC-07", "1005h"),
        (
            edited(s1016sub1="LowLimit=0 HighLimit=65535", s1016sub2="LowLimit=0 HighLimit=65535"),
            "EMCY-01 EMCY-03 EMCY-06 HB-06 HB-07 OTHER-10",
            "1016h",
        ),
        (edited(s1017="LowLimit=0 HighLimit=20"), "HB-03 BOTH-01 OTHER-05 STATE-02", "1017h"),
        (edited(s1019="LowLimit=0 HighLimit=1"), "PDO-13 SYNC-07", "1019h"),
        (edited(s1800sub2="LowLimit=254 HighLimit=255"), "PDO-02 PDO-19 SYNC-01", "1800h"),
    ],
)
def test_value_beyond_the_limits_of_the_eds_is_not_written(
    text: str, only: str, limited: str
) -> None:
    results = of_eds(text, only)
    assert [r.verdict for r in results] == ["not applicable"] * len(only.split())
    assert {r.reason[:20] for r in results} == {f"the EDS limits {limited}"}


def test_refusal_by_a_limit_counts_as_a_refusal() -> None:
    text = edited(s1005="LowLimit=0x80 HighLimit=0x80")
    assert [r.verdict for r in of_eds(text, "SYNC-03 OD-06")] == ["pass", "pass"]


NO_RTR = {f"s180{n}sub1": f"DefaultValue=$NODEID+0x{0x40000180 + 0x100 * n:X}" for n in range(6)}


def test_remote_frame_that_no_tpdo_allows_is_not_applicable() -> None:
    results = of_eds(edited(**NO_RTR), "PDO-05 PDO-06 PDO-07")
    reason = "the EDS has bit 30 (no RTR) of the COB-ID of every TPDO set"
    assert [(r.verdict, r.reason) for r in results] == [("not applicable", reason)] * 3


@pytest.mark.parametrize("first", [0, 1, 3])
def test_remote_frame_goes_to_a_tpdo_that_allows_it(first: int) -> None:
    sections = {**NO_RTR, f"s180{first}sub1": f"DefaultValue=$NODEID+0x{0x180 + 0x100 * first:X}"}
    assert [r.verdict for r in of_eds(edited(**sections), "PDO-05 PDO-06 PDO-07")] == ["pass"] * 3


def writes(text: str, only: str) -> set[int]:
    """Indices that some cases write by SDO."""
    seen = set()

    def spy(frame: Frame) -> Iterator[Frame]:
        if frame.can_id == SDO + 0x80 and frame.data[0] >> 5 == 1:
            seen.add(int.from_bytes(frame.data[1:3], "little"))
        yield frame

    assert faults(judge(inwards=spy, text=text, sheet=text, only=only)) == []
    return seen


def test_write_back_leaves_out_the_objects_of_communication() -> None:
    written = writes(RICH, "OD-07")
    assert 0x2110 in written
    assert min(written) > 0x1FFF


@pytest.mark.parametrize("index", [0x2110, 0x2111, 0x2120])
def test_conform_scan_writes_no_object_refused_by_objflags(index: int) -> None:
    only = "OD-04 OD-06 OD-07"
    assert index in writes(RICH, only)
    assert index not in writes(edited(**{f"s{index:X}": "ObjFlags=1"}), only)


def test_conform_scan_reads_no_object_refused_by_objflags() -> None:
    seen = set()

    def spy(frame: Frame) -> Iterator[Frame]:
        if frame.can_id == SDO + 0x80 and frame.data[0] == 0x40:
            seen.add(int.from_bytes(frame.data[1:3], "little"))
        yield frame

    text = edited(s2110="ObjFlags=2")
    judge(inwards=spy, text=text, sheet=text, only="OD-01 OD-02 OD-03 OD-05 OD-07 OD-09")
    assert 0x2111 in seen
    assert 0x2110 not in seen


def test_write_back_refused_by_the_present_state_is_a_remark() -> None:
    def refused(frame: Frame) -> Iterator[Frame]:
        if frame.can_id == SDO and frame.data[:4] == b"\x60\x10\x21\0":
            frame = frame._replace(data=b"\x80\x10\x21\0" + (0x08000022).to_bytes(4, "little"))
        yield frame

    (result,) = judge(outwards=refused, only="OD-07")
    assert result.verdict == "pass"
    assert result.remarks[0].startswith("2110h:00 abort 08000022")


def test_default_that_is_not_ascii_is_a_remark_of_the_eds() -> None:
    text = edited(s1008="DefaultValue=Pr\xfcfling")
    eds, _ = results = of_eds(text, "EDS-01 OD-03")
    assert faults(results) == []
    assert "not all characters are ASCII" in eds.remarks[0]


# Services that the default values start.

STARTED = {
    "SYNC": {"s1005": "DefaultValue=0x40000080", "s1006": "DefaultValue=20000"},
    "SYNC whose period is fixed": {
        "s1005": "DefaultValue=0x40000080",
        "s1006": "DefaultValue=20000 LowLimit=20000 HighLimit=20000",
    },
    "event timer": {"s1800sub5": "DefaultValue=20"},
    "inhibit time": {"s1800sub3": "DefaultValue=1500"},
    "SYNC start value": {"s1800sub6": "DefaultValue=5"},
    "RPDO deadline": {"s1400sub5": "DefaultValue=20"},
    "heartbeat": {"s1017": "DefaultValue=20"},
    "life guarding": {"s100C": "DefaultValue=20", "s100D": "DefaultValue=2"},
    "heartbeat consumer": {"s1016sub2": "DefaultValue=0x007F03E8"},
}
DISTURBED = (
    "PDO-01 PDO-02 PDO-03 PDO-04 PDO-08 PDO-09 PDO-10 PDO-13 PDO-16 PDO-18 PDO-19 PDO-20 PDO-21 "
    "PDO-27 SYNC-01 SYNC-02 SYNC-09 SYNC-10 STATE-02 STATE-03 GUARD-01 GUARD-03 GUARD-05 EMCY-01 "
    "EMCY-02 HB-06 HB-07 BOTH-02 BOTH-04"
)


@pytest.mark.parametrize("service", STARTED)
def test_service_that_the_defaults_start_disturbs_no_case(service: str) -> None:
    assert faults(of_eds(edited(**STARTED[service]), DISTURBED)) == []


def test_emcy_that_the_eds_disables_is_not_applicable() -> None:
    results = of_eds(edited(s1014="DefaultValue=$NODEID+0x80000080"), "EMCY-01 HB-06 PDO-25")
    reason = "the EDS has bit 31 of 1014h set: there is no EMCY"
    assert [(r.verdict, r.reason) for r in results] == [("not applicable", reason)] * 3
