"""All cases that apply pass for a device of a rich EDS and for the two nodes."""

from pathlib import Path

import pytest

from smarttac_can.conformance.case import Case, DeviceDescription
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.device.device import Device
from smarttac_can.host.files import read_eds
from smarttac_can.host.node import Node
from smarttac_can.nodes.device_node import DeviceNode
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.eds import load_eds

RICH = (Path(__file__).parents[1] / "eds" / "rich.eds").read_text(encoding="latin-1")
NODE_ID = 32


def judge(node: Node, text: str, cases: tuple[Case, ...] = CASES) -> dict[str, tuple[str, str]]:
    bus = DeviceTimeBus(node)
    results = run_cases(Examiner(bus, DeviceDescription(text, NODE_ID), clock=bus.time), cases)
    return {r.case.number: (r.verdict, r.reason) for r in results if r.verdict != "pass"}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.number)
def test_device_of_a_rich_eds(case: Case) -> None:
    assert judge(DeviceNode(Device(load_eds(RICH, NODE_ID))), RICH, (case,)) == {}


def test_device_of_a_rich_eds_passes_all_one_after_the_other() -> None:
    assert judge(DeviceNode(Device(load_eds(RICH, NODE_ID))), RICH) == {}


def test_plate_node() -> None:
    text = read_eds("plate.eds")
    assert judge(PlateNode(load_eds(text, NODE_ID)), text) == {}


def test_stimulator_node_has_events_all_the_time() -> None:
    text = read_eds("stimulator.eds")
    inside = PlateBlock(load_eds(read_eds("plate.eds"), 33))
    reason = ("not applicable", "the application has events all the time")
    assert judge(StimulatorNode(load_eds(text, NODE_ID), inside), text) == {
        "PDO-04": reason,
        "PDO-09": reason,
    }
