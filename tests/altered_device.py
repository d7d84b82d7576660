"""A device that differs from a right one by its frames, and the verdicts of the suite."""

from collections.abc import Callable, Collection, Iterator
from functools import cache

from read_once import read_once
from rich_eds import RICH

from smarttac_can.canopen.bus.node import without_queue
from smarttac_can.canopen.conformance.case import DeviceDescription, Result
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.instrument.nodes.device_node import DeviceNode

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


def drop(wanted: Callable[[Frame], bool]) -> Change:
    def change(frame: Frame) -> Iterator[Frame]:
        if not wanted(frame):
            yield frame

    return change


def alter(wanted: Callable[[Frame], bool], data: Callable[[bytes], bytes]) -> Change:
    def change(frame: Frame) -> Iterator[Frame]:
        yield frame._replace(data=data(frame.data)) if wanted(frame) else frame

    return change


def twice(can_id: int) -> Change:
    def change(frame: Frame) -> Iterator[Frame]:
        yield frame
        if frame.can_id == can_id:
            yield frame

    return change


def abort_codes(codes: Collection[int], instead: int) -> Change:
    """Answer by another abort code instead of any of these."""
    old = [code.to_bytes(4, "little") for code in codes]
    return alter(
        lambda f: f.can_id == SDO and f.data[0] == 0x80 and f.data[4:] in old,
        lambda data: data[:4] + instead.to_bytes(4, "little"),
    )


def is_frame(can_id: int, *, first: int | None = None) -> Callable[[Frame], bool]:
    return lambda f: f.can_id == can_id and (first is None or f.data[:1] == bytes((first,)))


@cache
def described(sheet: str) -> DeviceDescription:
    """Description by an EDS, which is read once in a run: no case changes it."""
    return DeviceDescription(sheet, NODE_ID)


def judge(
    *,
    inwards: Change | None = None,
    outwards: Change | None = None,
    text: str = RICH,
    sheet: str = RICH,
    only: str,
    timeout: float = 2.0,
) -> list[Result]:
    """Results of some cases for a device of an EDS, by an EDS, the rich one unless given."""
    node = Altered(Device(read_once(text, NODE_ID)), inwards=inwards, outwards=outwards)
    bus = DeviceTimeBus(node)
    cases = [case for case in CASES if case.number in only.split()]
    return run_cases(Examiner(bus, described(sheet), timeout=timeout, clock=bus.time), cases)
