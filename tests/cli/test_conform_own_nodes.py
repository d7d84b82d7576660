"""Nodes as ``smarttac node`` and ``plate`` make them pass each conformance case that applies."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from commands import succeed

from smarttac_can.canopen.conformance.case import Case, DeviceDescription, Result
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.cli import nodes
from smarttac_can.host.files import read_eds
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode

TIMEOUT_S = 0.15
"""Above any period that a case sets, 120 ms; a node in its own time answers at once."""
EVENTS = "the application has events all the time"


SHEETS = {"node": ("stimulator.eds", 32), "plate": ("plate.eds", 33)}
Judge = Callable[..., list[Result]]


@pytest.fixture
def judge(monkeypatch: pytest.MonkeyPatch) -> Judge:
    """Results for the node that a command with options would have run."""
    made: list[PlateNode | StimulatorNode] = []
    monkeypatch.setattr(nodes, "run_in_process", lambda name, node, *rest: made.append(node))

    def results(command: str, *options: str, cases: Sequence[Case] = CASES) -> list[Result]:
        succeed(command, "--interface", "virtual", *options)
        bus = DeviceTimeBus(made.pop())
        eds, node_id = SHEETS[command]
        sheet = DeviceDescription(read_eds(eds), node_id)
        return run_cases(Examiner(bus, sheet, timeout=TIMEOUT_S, clock=bus.time), cases)

    return results


def fails(results: list[Result]) -> list[tuple[str, str]]:
    return [(r.case.number, r.reason) for r in results if r.verdict == "fail"]


@pytest.mark.parametrize(
    ("command", "not_applicable"),
    [("node", {"PDO-04": EVENTS, "PDO-09": EVENTS}), ("plate", {})],
)
def test_the_node_of_a_command_fails_no_conformance_case(
    command: str, not_applicable: dict[str, str], judge: Judge
) -> None:
    results = judge(command, "--seed", "7")
    assert fails(results) == []
    others = {r.case.number: r.reason for r in results if r.verdict == "not applicable"}
    assert others == not_applicable
    assert sum(r.verdict == "pass" for r in results) == 127 - len(not_applicable)


@pytest.mark.parametrize("command", SHEETS)
@pytest.mark.parametrize(
    "options",
    [(), ("--finger", "none"), ("--subject", "6"), ("--finger", "{recording}", "--seed", "0")],
    ids=["none", "finger", "subject", "recorded finger"],
)
def test_options_of_a_node_contradict_no_default_of_its_eds(
    command: str, options: tuple[str, ...], judge: Judge, tmp_path: Path
) -> None:
    recording = tmp_path / "finger.csv"
    recording.write_text("t_s,x_mm,Fn_N\n0,0,0\n5,0,0.9\n")
    given = [option.format(recording=recording) for option in options]
    (result,) = judge(command, *given, cases=[c for c in CASES if c.number == "OD-03"])
    assert (result.verdict, result.reason) == ("pass", "")
