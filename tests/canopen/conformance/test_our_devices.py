"""All cases that apply pass for a device of a rich EDS and for a minimal one.

Those for the two nodes of the commands are in ``tests/cli/test_conform_own_nodes.py``.
"""

from read_once import read_once
from rich_eds import RICH

from smarttac_can.canopen.bus.node import Node
from smarttac_can.canopen.conformance.case import Case, DeviceDescription
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.canopen.device.device import Device
from smarttac_can.instrument.nodes.device_node import DeviceNode

NODE_ID = 32
TIMEOUT_S = 0.15
"""Above any period that a case sets, 120 ms; a device in its own time answers at once."""


def judge(node: Node, text: str, cases: tuple[Case, ...] = CASES) -> dict[str, tuple[str, str]]:
    """Verdict and reason of each case that does not pass."""
    bus = DeviceTimeBus(node)
    sheet = DeviceDescription(text, NODE_ID)
    results = run_cases(Examiner(bus, sheet, timeout=TIMEOUT_S, clock=bus.time), cases)
    return {r.case.number: (r.verdict, r.reason) for r in results if r.verdict != "pass"}


def test_device_of_a_rich_eds() -> None:
    assert judge(DeviceNode(Device(read_once(RICH, NODE_ID))), RICH) == {}


def test_each_case_passes_by_itself() -> None:
    for case in CASES:
        assert judge(DeviceNode(Device(read_once(RICH, NODE_ID))), RICH, (case,)) == {}


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


def test_a_minimal_device_has_little_to_be_asked_and_no_fault() -> None:
    others = judge(DeviceNode(Device(read_once(MINIMAL, NODE_ID))), MINIMAL)
    assert {verdict for verdict, _ in others.values()} == {"not applicable"}
    for number, reason in (
        ("SYNC-02", "the EDS has no 1005h:00"),
        ("PDO-01", "the EDS has no TPDO that can be configured"),
        ("OD-05", "the EDS has no write-only entry"),
    ):
        assert others[number][1] == reason
    asked = {"EDS-01", "SDO-01", "SDO-10", "SDO-23", "OD-01", "HB-01", "OTHER-01"}
    assert not asked & set(others)
