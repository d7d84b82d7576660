"""A device that breaks a rule fails the case of that rule; there is one for every case."""

import json
from pathlib import Path

import pytest
from altered_device import SDO, alter, drop, is_frame, judge
from faulty_devices import FAULTS

from smarttac_can.canopen.conformance.run import CASES, failed


@pytest.mark.parametrize("deviation", FAULTS)
def test_deviation_fails_the_case_of_its_rule(deviation: str) -> None:
    fault = FAULTS[deviation]
    results = fault.judge(fault.fails)
    assert {r.case.number for r in failed(results)} == set(fault.fails.split())


def test_every_case_is_failed_by_a_deviation() -> None:
    numbers = [number for fault in FAULTS.values() for number in fault.fails.split()]
    assert {case.number for case in CASES} == set(numbers)


def test_verdicts_have_every_deviation() -> None:
    path = Path(__file__).parents[3] / "docs" / "reference" / "verdicts.json"
    devices = json.loads(path.read_text(encoding="utf-8"))["scripted_devices"]
    found = {d["scripted_device"]: {row["case"] for row in d["fails"]} for d in devices}
    assert found == {name: set(fault.fails.split()) for name, fault in FAULTS.items()}
    for row in (row for d in devices for row in d["fails"] + d["fails_too"]):
        assert row["why"], row["case"]


def test_block_transfer_is_optional() -> None:
    refused = alter(
        lambda f: f.can_id == SDO and f.data[0] >> 5 in (5, 6),
        lambda data: b"\x80" + data[1:4] + (0x05040001).to_bytes(4, "little"),
    )
    (block,) = judge(outwards=refused, only="SDO-23")
    assert block.verdict == "not applicable"
    assert block.reason.startswith("the device has no SDO block transfer: abort 05040001")


def test_failed_case_names_its_last_frames() -> None:
    (result,) = judge(inwards=drop(is_frame(0x620)), only="SDO-01")
    assert result.reason == "no SDO response (5A0h) within 2 s (--timeout 2)"
    assert result.trace[-1] == "> 620 40 00 10 00 00 00 00 00"
