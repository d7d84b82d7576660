"""What the EDS does not have is not asked, and what is optional may be refused."""

from smarttac_can.conformance.case import DeviceDescription, Result
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.nodes.device_node import DeviceNode
from smarttac_can.od.eds import load_eds

NODE_ID = 3
VAR = "[{index}]\nParameterName={name}\nObjectType=0x7\nDataType={kind}\nAccessType=ro\n"
MINIMAL = (
    "[MandatoryObjects]\nSupportedObjects=3\n1=0x1000\n2=0x1001\n3=0x1018\n"
    + VAR.format(index="1000", name="Device type", kind="0x0007")
    + VAR.format(index="1001", name="Error register", kind="0x0005")
    + "[1018]\nParameterName=Identity\nObjectType=0x9\nSubNumber=2\n"
    + VAR.format(index="1018sub0", name="Highest sub-index", kind="0x0005")
    + "DefaultValue=1\n"
    + VAR.format(index="1018sub1", name="Vendor-ID", kind="0x0007")
)


class WithoutBlockTransfer(DeviceNode):
    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self.receive = self._receive

    def _receive(self, frame: Frame) -> list[Frame]:
        if frame.can_id == 0x600 + NODE_ID and frame.data[0] >> 5 in (5, 6):
            data = b"\x80" + frame.data[1:4] + (0x05040001).to_bytes(4, "little")
            return [Frame(0x580 + NODE_ID, data)]
        return self.device.receive(frame)


def judge(node: DeviceNode) -> list[Result]:
    bus = DeviceTimeBus(node)
    return run_cases(Examiner(bus, DeviceDescription(MINIMAL, NODE_ID), clock=bus.time), CASES)


def test_a_minimal_device_has_little_to_be_asked_and_no_fault() -> None:
    results = judge(DeviceNode(Device(load_eds(MINIMAL, NODE_ID))))
    reasons = {r.case.number: r.reason for r in results if r.verdict == "not applicable"}
    assert [r for r in results if r.verdict == "fail"] == []
    assert reasons["SYNC-02"] == "the EDS has no 1005h:00"
    assert reasons["PDO-01"] == "the EDS has no TPDO that can be configured"
    assert reasons["OD-05"] == "the EDS has no write-only entry"
    passed = {result.case.number for result in results} - set(reasons)
    assert passed >= {"EDS-01", "SDO-01", "SDO-10", "SDO-23", "OD-01", "HB-01", "OTHER-01"}


def test_block_transfer_is_optional() -> None:
    results = judge(WithoutBlockTransfer(Device(load_eds(MINIMAL, NODE_ID))))
    (block,) = [result for result in results if result.case.number == "SDO-23"]
    assert (block.verdict, block.reason) == (
        "not applicable",
        "the device has no SDO block transfer",
    )
