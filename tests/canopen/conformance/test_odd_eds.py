"""Devices of EDS files with oddities of real ones fail no case, and most cases apply to them."""

import pytest
from read_once import read_once
from small_eds import NODE_ID, entry, record, small_eds

from smarttac_can.canopen.conformance.case import DeviceDescription
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.canopen.device.device import Device
from smarttac_can.instrument.nodes.device_node import DeviceNode

TIMEOUT_S = 0.15
"""Above any period that a case sets, 120 ms; a device in its own time answers at once."""


def pdo(index: str, cob_id: str, *more: str, access: str = "rw", kind: str = "255") -> str:
    return record(
        index,
        entry(f"{index}sub0", 5, "const", "5"),
        entry(f"{index}sub1", 7, access, cob_id, *more),
        entry(f"{index}sub2", 5, access, kind),
        entry(f"{index}sub5", 6, access, "0"),
    )


def mapping(index: str, *objects: str, count: str = "", access: str = "rw") -> str:
    entries = [entry(f"{index}sub{n}", 7, access, value) for n, value in enumerate(objects, 1)]
    return record(index, entry(f"{index}sub0", 5, access, count), *entries)


def consumers(*more: str) -> str:
    entries = [entry(f"1016sub{n}", 7, "rw", "0", *more) for n in (1, 2)]
    return record("1016", entry("1016sub0", 5, "const", "2"), *entries, kind=8)


DRIVE = {
    "1005": entry("1005", 7, "rw", "0x80"),
    "1008": entry("1008", 9, "const", "Drive of somebody"),
    "1014": entry("1014", 7, "rw", "$NODEID+0x80"),
    "1016": consumers(),
    "1400": pdo("1400", "$NODEID+0x200"),
    "1600": mapping("1600", "0x60400010", "0x607A0020", count="2"),
    "1800": pdo("1800", "$NODEID+0x40000180"),
    "1A00": mapping("1A00", "0x60410010", "0", "0", count="1"),
    "6040": entry("6040", 6, "rww", "0", "PDOMapping=1"),
    "6041": entry("6041", 6, "ro", "0x237", "PDOMapping=1"),
    "607A": entry("607A", 4, "rww", "0", "PDOMapping=1"),
    "6081": entry("6081", 7, "rw", "100"),
}
"""Objects of a plain drive; an oddity replaces some, or adds to them."""
ODDITIES = {
    "none": ({}, 89),
    "SYNC limited to 80h": (
        {"1005": entry("1005", 7, "rw", "0x80", "LowLimit=0x80", "HighLimit=0x80")},
        89,
    ),
    "heartbeat consumers limited to 65535": (
        {"1016": consumers("LowLimit=0", "HighLimit=65535")},
        85,
    ),
    "EMCY off": ({"1014": entry("1014", 7, "rw", "$NODEID+0x80000080")}, 84),
    "communication parameters ro": (
        {
            "1400": pdo("1400", "$NODEID+0x200", access="ro"),
            "1800": pdo("1800", "$NODEID+0x40000180", access="ro"),
        },
        64,
    ),
    "mappings const": (
        {
            "1600": mapping("1600", "0x60400010", "0x607A0020", count="2", access="const"),
            "1A00": mapping("1A00", "0x60410010", count="1", access="const"),
        },
        84,
    ),
    "numbers of mapped objects without a default": (
        {
            "1600": mapping("1600", "0x60400010", "0x607A0020"),
            "1A00": mapping("1A00", "0x60410010", "0"),
        },
        89,
    ),
    "array without sub-index 0": (
        {
            "4602": "[4602]\nParameterName=Torques\nObjectType=8\nSubNumber=1\n"
            + entry("4602subC", 6, "ro", "80")
        },
        89,
    ),
    "compact consumers and history": (
        {
            "1016": "[1016]\nParameterName=Consumers\nObjectType=8\nDataType=7\nAccessType=rw\n"
            "CompactSubObj=3\n",
            "1003": "[1003]\nParameterName=Errors\nObjectType=8\nDataType=7\nAccessType=ro\n"
            "CompactSubObj=4\n",
        },
        91,
    ),
    "ObjFlags that refuse a scan": ({"6081": entry("6081", 7, "rw", "100", "ObjFlags=3")}, 89),
    "default SDO without CAN-IDs": (
        {
            "1200": record(
                "1200",
                entry("1200sub0", 5, "const", "2"),
                entry("1200sub1", 7, "ro"),
                entry("1200sub2", 7, "ro"),
            )
        },
        89,
    ),
    "TPDO with remote frames, heartbeat of 20 ms": (
        {"1800": pdo("1800", "$NODEID+0x180"), "1017": entry("1017", 6, "rw", "20")},
        92,
    ),
}
"""Objects, and the number of cases that apply."""


@pytest.mark.parametrize("oddity", ODDITIES)
def test_device_of_an_odd_eds_fails_no_conformance_case(oddity: str) -> None:
    objects, applicable = ODDITIES[oddity]
    text = small_eds("".join((DRIVE | objects).values()), rx=1, tx=1)
    bus = DeviceTimeBus(DeviceNode(Device(read_once(text, NODE_ID))))
    sheet = DeviceDescription(text, NODE_ID)
    results = run_cases(Examiner(bus, sheet, timeout=TIMEOUT_S, clock=bus.time), CASES)
    assert [(r.case.number, r.reason) for r in results if r.verdict == "fail"] == []
    others = [r for r in results if r.verdict == "not applicable"]
    assert all(r.reason for r in others)
    assert len(results) - len(others) == applicable, [(r.case.number, r.reason) for r in others]
