"""Nodes as ``smarttac node`` and ``plate`` make them pass each conformance case that applies."""

import pytest
from commands import succeed

from smarttac_can.canopen.conformance.case import DeviceDescription
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.cli import nodes
from smarttac_can.host.files import read_eds
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode

TIMEOUT_S = 0.15
"""Above any period that a case sets, 120 ms; a node in its own time answers at once."""
EVENTS = "the application has events all the time"


@pytest.mark.parametrize(
    ("command", "node_id", "eds", "not_applicable"),
    [
        ("node", 32, "stimulator.eds", {"PDO-04": EVENTS, "PDO-09": EVENTS}),
        ("plate", 33, "plate.eds", {}),
    ],
)
def test_the_node_of_a_command_fails_no_conformance_case(
    command: str,
    node_id: int,
    eds: str,
    not_applicable: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[PlateNode | StimulatorNode] = []
    monkeypatch.setattr(nodes, "run_in_process", lambda name, node, *rest: made.append(node))
    succeed(command, "--interface", "virtual")
    bus = DeviceTimeBus(made[0])
    sheet = DeviceDescription(read_eds(eds), node_id)
    results = run_cases(Examiner(bus, sheet, timeout=TIMEOUT_S, clock=bus.time), CASES)
    assert [(r.case.number, r.reason) for r in results if r.verdict == "fail"] == []
    others = {r.case.number: r.reason for r in results if r.verdict == "not applicable"}
    assert others == not_applicable
    assert sum(r.verdict == "pass" for r in results) == 127 - len(not_applicable)
