"""A device that breaks a rule fails the case of that rule."""

from collections.abc import Callable, Iterator

import pytest
from read_once import read_once
from rich_eds import RICH, changed, without

from smarttac_can.conformance.case import DeviceDescription, Result
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.run import CASES, DeviceTimeBus, failed, run_cases
from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.host.node import without_queue
from smarttac_can.nodes.device_node import DeviceNode

NODE_ID = 0x20
SDO, HEARTBEAT, EMCY, TPDO = 0x5A0, 0x720, 0x0A0, 0x1A0

Change = Callable[[Frame], Iterator[Frame]]


class Altered(DeviceNode):
    """A device whose frames, to it or from it, are altered on their way."""

    def __init__(self, device: Device, *, inwards: Change | None, outwards: Change | None) -> None:
        super().__init__(device)
        self._inwards = inwards or _same
        self._outwards = outwards or _same
        receive = without_queue(self)
        self.start = lambda: self._out(device.start())
        self.advance = lambda microseconds: self._out(device.advance(microseconds))
        self.receive = lambda frame: [
            answer for f in self._inwards(frame) for answer in self._out(receive(f))
        ]

    def _out(self, frames: list[Frame]) -> list[Frame]:
        return [altered for frame in frames for altered in self._outwards(frame)]


def _same(frame: Frame) -> Iterator[Frame]:
    yield frame


def _drop(wanted: Callable[[Frame], bool]) -> Change:
    def change(frame: Frame) -> Iterator[Frame]:
        if not wanted(frame):
            yield frame

    return change


def _alter(wanted: Callable[[Frame], bool], data: Callable[[bytes], bytes]) -> Change:
    def change(frame: Frame) -> Iterator[Frame]:
        yield frame._replace(data=data(frame.data)) if wanted(frame) else frame

    return change


def _twice(can_id: int) -> Change:
    def change(frame: Frame) -> Iterator[Frame]:
        yield frame
        if frame.can_id == can_id:
            yield frame

    return change


def _abort_code(code: int, instead: int) -> Change:
    old = code.to_bytes(4, "little")
    return _alter(
        lambda f: f.can_id == SDO and f.data[0] == 0x80 and f.data[4:] == old,
        lambda data: data[:4] + instead.to_bytes(4, "little"),
    )


def _general(code: int) -> Change:
    return _abort_code(code, 0x08000000)


def _is(can_id: int, *, first: int | None = None) -> Callable[[Frame], bool]:
    return lambda f: f.can_id == can_id and (first is None or f.data[:1] == bytes((first,)))


def _swap_states(data: bytes) -> bytes:
    return bytes(({5: 0x7F, 0x7F: 5}.get(data[0], data[0]),))


OUTWARDS = {
    "no boot-up": (_drop(_is(HEARTBEAT, first=0)), "HB-01 BOTH-05 TRANS-03 TRANS-04"),
    "boot-up twice": (_twice(HEARTBEAT), "BOTH-05"),
    "wrong states": (_alter(_is(HEARTBEAT), _swap_states), "GUARD-03 HB-04 STATE-02 TRANS-01"),
    "toggle bit stays 0": (
        _alter(_is(HEARTBEAT), lambda data: bytes((data[0] & 0x7F,))),
        "GUARD-02",
    ),
    "no EMCY": (_drop(_is(EMCY)), "EMCY-01 EMCY-02 GUARD-04 HB-06 SYNC-10 PDO-24 PDO-25"),
    "EMCY twice": (_twice(EMCY), "EMCY-01"),
    "EMCY without register": (
        _alter(_is(EMCY), lambda data: data[:2] + b"\0" + data[3:]),
        "EMCY-01",
    ),
    "TPDO too short": (_alter(_is(TPDO), lambda data: data[:-1]), "PDO-01"),
    "no TPDO": (_drop(_is(TPDO)), "PDO-01 PDO-02 PDO-03 PDO-09 PDO-13 PDO-19 SYNC-01 STATE-03"),
    "no SYNC": (_drop(lambda f: f.can_id == 0x80), "SYNC-04 SYNC-06 SYNC-07"),
    "SDO data wrong": (
        _alter(_is(SDO, first=0x43), lambda data: data[:4] + bytes((data[4] ^ 1,)) + data[5:]),
        "SDO-02 OD-03 OTHER-01",
    ),
    "abort without multiplexer": (
        _alter(_is(SDO, first=0x80), lambda data: data[:1] + bytes(3) + data[4:]),
        "SDO-22",
    ),
    "answer of 7 bytes": (_alter(_is(SDO), lambda data: data[:7]), "SDO-01 OD-01"),
    "wrong CRC": (
        _alter(
            lambda f: f.can_id == SDO and f.data[0] & 0xE3 == 0xC1,
            lambda data: data[:1] + bytes((data[1] ^ 1,)) + data[2:],
        ),
        "SDO-23",
    ),
    "abort 05030000": (_general(0x05030000), "SDO-07 SDO-08"),
    "abort 05040001": (_general(0x05040001), "SDO-09 SDO-10 SDO-11"),
    "abort 05040002": (_general(0x05040002), "SDO-29"),
    "abort 05040003": (_general(0x05040003), "SDO-30"),
    "abort 05040004": (_general(0x05040004), "SDO-28"),
    "abort 06020000": (_general(0x06020000), "SDO-14"),
    "abort 06090011": (_general(0x06090011), "SDO-15"),
    "abort 06010000": (_general(0x06010000), "PDO-28"),
    "abort 06010002": (_general(0x06010002), "SDO-16 OD-04"),
    "abort 06010001": (_general(0x06010001), "SDO-17 OD-05"),
    "abort 06070012": (_general(0x06070012), "SDO-18"),
    "abort 06070013": (_general(0x06070013), "SDO-19 SDO-20"),
    "abort 06090031": (_general(0x06090031), "OD-06"),
    "abort 06040041": (_general(0x06040041), "PDO-31 PDO-32"),
    "abort 06040042": (_general(0x06040042), "PDO-30"),
    "abort 06040043": (_general(0x06040043), "HB-07"),
    "abort 08000020": (_general(0x08000020), "OTHER-04 OTHER-06"),
    "abort 08000022": (_general(0x08000022), "SYNC-08"),
}


def _as_command(command: int, instead: int) -> Change:
    return _alter(
        lambda f: f.can_id == 0 and f.data[:1] == bytes((command,)),
        lambda data: bytes((instead,)) + data[1:],
    )


INWARDS = {
    "deaf to SDO": (_drop(_is(0x620)), "SDO-01 SDO-12 OD-01 STATE-02"),
    "deaf to commands for all": (
        _drop(lambda f: f.can_id == 0 and f.data[1:] == b"\0"),
        "TRANS-02",
    ),
    "obeys commands for others": (
        _alter(lambda f: f.can_id == 0 and len(f.data) == 2, lambda data: data[:1] + b"\0"),
        "TRANS-02",
    ),
    "STOPPED is PRE-OPERATIONAL": (_as_command(0x02, 0x80), "STATE-04 TRANS-01 BOTH-07"),
    "PRE-OPERATIONAL is OPERATIONAL": (_as_command(0x80, 0x01), "PDO-19 PDO-22 STATE-02"),
    "reset node is reset communication": (_as_command(0x81, 0x82), "TRANS-04"),
    "reset communication is reset node": (_as_command(0x82, 0x81), "TRANS-03"),
    "deaf to RPDO": (_drop(_is(0x220)), "PDO-20 PDO-21 PDO-24 PDO-25"),
    "deaf to SYNC": (_drop(_is(0x80)), "PDO-02 PDO-21 SYNC-01"),
    "deaf to remote frames": (_drop(lambda f: f.rtr), "GUARD-01"),
    "toggle in the client's segment not looked at": (
        _alter(_is(0x620, first=0x70), lambda data: b"\x60" + data[1:]),
        "SDO-07",
    ),
    "the client's abort ignored": (_drop(_is(0x620, first=0x80)), "SDO-11"),
}  # fmt: skip


def judge(
    *, inwards: Change | None = None, outwards: Change | None = None, text: str = RICH, only: str
) -> list[Result]:
    """Results of some cases for a device of an EDS, by the rich one."""
    node = Altered(Device(read_once(text, NODE_ID)), inwards=inwards, outwards=outwards)
    bus = DeviceTimeBus(node)
    cases = [case for case in CASES if case.number in only.split()]
    return run_cases(Examiner(bus, DeviceDescription(RICH, NODE_ID), clock=bus.time), cases)


def numbers(results: list[Result]) -> str:
    return " ".join(result.case.number for result in results)


def in_order(expected: str) -> str:
    return " ".join(case.number for case in CASES if case.number in expected.split())


@pytest.mark.parametrize("fault", OUTWARDS)
def test_fault_in_what_the_device_sends(fault: str) -> None:
    change, expected = OUTWARDS[fault]
    assert numbers(failed(judge(outwards=change, only=expected))) == in_order(expected)


@pytest.mark.parametrize("fault", INWARDS)
def test_fault_in_what_the_device_makes_of_a_frame(fault: str) -> None:
    change, expected = INWARDS[fault]
    assert numbers(failed(judge(inwards=change, only=expected))) == in_order(expected)


SHEETS = {
    "object missing": (without("2115"), "OD-01"),
    "another type": (changed("2115", "DataType=0x0007"), "OD-02"),
    "another default": (changed("1029sub1", "DefaultValue=1"), "OD-03"),
    "read-only entry takes values": (changed("2111", "AccessType=rw"), "OD-04"),
    "write-only entry is readable": (changed("2112", "AccessType=rw"), "OD-05"),
    "another vendor": (changed("1018sub1", "DefaultValue=0x00000124"), "OTHER-01"),
    "another name": (changed("1008", "DefaultValue=Something else"), "OTHER-03"),
    "another CAN-ID of EMCY": (changed("1014", "DefaultValue=$NODEID+0x90"), "EMCY-05"),
    "another heartbeat": (changed("1017", "DefaultValue=500"), "HB-02"),
}


@pytest.mark.parametrize("fault", SHEETS)
def test_device_that_is_not_as_its_eds_says(fault: str) -> None:
    text, expected = SHEETS[fault]
    assert numbers(failed(judge(text=text, only=expected))) == expected


def test_block_transfer_is_optional() -> None:
    refused = _alter(
        lambda f: f.can_id == SDO and f.data[0] >> 5 in (5, 6),
        lambda data: b"\x80" + data[1:4] + (0x05040001).to_bytes(4, "little"),
    )
    (block,) = judge(outwards=refused, only="SDO-23")
    assert (block.verdict, block.reason) == (
        "not applicable",
        "the device has no SDO block transfer",
    )


def test_a_failed_case_names_its_last_frames() -> None:
    (result,) = judge(outwards=_general(0x06020000), only="SDO-14")
    assert result.reason.startswith("reading 1")
    assert result.trace[-1] == f"< {SDO:03X} 80 {result.trace[-1][9:17]} 00 00 00 08"
