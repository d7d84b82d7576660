"""``smarttac status`` says how a stimulator is, and ``smarttac reset`` resets its fault."""

import json
from collections.abc import Iterator
from typing import Any

import can
import pytest
from click.testing import CliRunner, Result
from nodes_on_a_bus import both, in_threads, stimulator_with_plate

from smarttac_can.bench import BenchError, State, Stimulator
from smarttac_can.cli import main
from smarttac_can.commissioning.node_ids import wait_until
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

STUCK = {"code": int(WATCHDOGS[Watchdog.STUCK].code), "text": "a sensor is stuck"}


@pytest.fixture
def node(virtual: dict[str, Any]) -> Iterator[StimulatorNode]:
    made = stimulator_with_plate(lockstep=False)
    with in_threads(virtual, made, lockstep=False):
        yield made


@pytest.fixture
def driven(virtual: dict[str, Any]) -> Iterator[Stimulator]:
    """A bench whose node has no time but that of its runs, so that nothing else trips."""
    with (
        in_threads(virtual, stimulator_with_plate()),
        Stimulator.connect(**virtual, lockstep=True) as bench,
    ):
        bench.run(0.2)
        yield bench


def smarttac(virtual: dict[str, Any], command: str, *arguments: str) -> Result:
    bus = ["--interface", virtual["interface"], "--channel", virtual["channel"], "--timeout", "5"]
    return CliRunner().invoke(main, [command, *bus, *arguments])


def lines(result: Result) -> dict[str, str]:
    assert (result.exit_code, result.stderr) == (0, "")
    return {line[:15].strip(): line[15:] for line in result.stdout.splitlines()}


def break_a_gauge(bench: Stimulator) -> None:
    bench.set("Fault.Sensor", 3)
    bench.set("Fault.Kind", FaultKind.STUCK)
    with pytest.raises(BenchError):
        while True:
            bench.run(0.1)


def test_a_node_that_nobody_has_started(virtual: dict[str, Any], node: StimulatorNode) -> None:
    """It is not started by the question."""
    said = lines(smarttac(virtual, "status"))
    bus = f"virtual:{virtual['channel']}"
    assert said["nodes"] == f"stimulator 32 pre-operational, on {bus}"
    assert said["state"] == "not ready, mode off (live)"
    assert said["driven by"] == "nobody"
    assert said["voltage"] == "0 of 150 V, 0%"
    assert "fault" not in said
    assert node.device.nmt_state.name == "PRE_OPERATIONAL"


def test_who_drives_is_named(virtual: dict[str, Any], node: StimulatorNode) -> None:
    with Stimulator.connect(**virtual) as bench:
        bench.run(0.2)
        bench.arm()
        said = json.loads(smarttac(virtual, "status", "--json").stdout)
        text = lines(smarttac(virtual, "status"))
    assert (said["node_id"], said["nmt"], said["plate"]) == (32, "operational", None)
    assert said["driven_by"] == [{"node_id": 127, "bench": True, "heard": True}]
    assert text["driven by"] == "a bench script, heartbeat of node 127"


def test_state_and_levels_of_a_run_that_goes_on(
    driven: Stimulator, virtual: dict[str, Any]
) -> None:
    driven.voltage = 12.0
    driven.mode = "open_loop"
    driven.run(0.1)
    said = json.loads(smarttac(virtual, "status", "--json").stdout)
    text = lines(smarttac(virtual, "status"))
    assert driven.state is State.RUNNING
    assert (said["state"], said["mode"]) == ("running", "open_loop")
    assert said["flags"] == ["live", "driving"]
    assert said["driven_by"] == []
    assert said["levels"]["voltage"] == {"value": 12.0, "limit": 150.0, "unit": "V", "level": 0.08}
    assert 0.1 < said["levels"]["amplitude"]["value"] < 1.0
    assert said["levels"]["temperature"]["limit"] == 60.0
    # Nothing but the bench moves the time of its node, and so its heartbeat.
    assert said["nmt"] == "unknown"
    assert text["state"] == "running, mode open_loop (live, driving)"
    assert text["driven by"] == "somebody whose heartbeat is not watched"
    assert text["voltage"] == "12 of 150 V, 8%"
    assert text["nodes"].startswith("stimulator 32 in a state that no heartbeat tells, on virtual:")


def test_values_that_no_cycle_has_renewed_are_named(virtual: dict[str, Any]) -> None:
    with in_threads(virtual, stimulator_with_plate()):
        said = smarttac(virtual, "status").stdout.splitlines()
    assert said[3] == "no cycle comes what follows is of the last one, or of none"


def test_a_fault_is_named_and_reset_when_its_cause_is_gone(
    driven: Stimulator, virtual: dict[str, Any]
) -> None:
    driven.arm()
    break_a_gauge(driven)
    there = lines(smarttac(virtual, "status"))
    assert there["state"] == "fault, mode off (live, fault)"
    assert there["fault"] == f"{STUCK['code']:04X}h a sensor is stuck"
    assert there["message"] == "a sensor is stuck"
    refused = smarttac(virtual, "reset", "--lockstep")
    assert (refused.exit_code, refused.stderr) == (
        1,
        "Error: the fault cannot be reset: a sensor is stuck\n",
    )
    driven.set("Fault.Kind", FaultKind.NONE)
    driven.run(0.1)
    gone = json.loads(smarttac(virtual, "status", "--json").stdout)
    assert (gone["latched"], gone["present"]) == ([STUCK], [])
    assert lines(smarttac(virtual, "status"))["fault"].endswith(
        "; no longer present: smarttac reset"
    )
    done = smarttac(virtual, "reset")
    assert (done.exit_code, done.output) == (
        0,
        "stimulator 32 is reset (a sensor is stuck): ready\n",
    )
    assert driven.state is State.READY


def test_no_reset_beside_a_bench_that_drives(virtual: dict[str, Any], node: StimulatorNode) -> None:
    with Stimulator.connect(**virtual) as bench:
        bench.run(0.2)
        bench.arm()
        break_a_gauge(bench)
        refused = smarttac(virtual, "reset")
    assert refused.exit_code == 1
    assert "another bench script drives node 32" in refused.stderr


def test_a_reset_that_is_not_needed_disturbs_nobody(
    driven: Stimulator, virtual: dict[str, Any]
) -> None:
    driven.voltage = 5.0
    driven.mode = "open_loop"
    assert smarttac(virtual, "reset").output == (
        "stimulator 32 has no fault: its state is running\n"
    )
    assert driven.state is State.RUNNING


def test_the_plate_node_is_found(virtual: dict[str, Any]) -> None:
    with in_threads(virtual, *both(lockstep=False), lockstep=False):
        said = lines(smarttac(virtual, "status"))
        assert said["nodes"].startswith("stimulator 32 pre-operational, plate 33 pre-operational")
        assert said["driven by"] == "nobody"


def test_a_master_that_is_not_heard(virtual: dict[str, Any], node: StimulatorNode) -> None:
    node.od.entry(0x1016, 2).value = 5 << 16 | 100
    said = lines(smarttac(virtual, "status"))
    assert said["driven by"] == "nobody; node 5 watched but not heard"


def test_a_lost_master_is_named_with_the_cure(
    virtual: dict[str, Any], node: StimulatorNode
) -> None:
    watch = "Consumer heartbeat time.Consumer heartbeat time 2"
    with Stimulator.connect(**virtual) as bench, can.Bus(**virtual) as bus:
        bench.run(0.2)
        bench.set(watch, 5 << 16 | 2000)
        bus.send(can.Message(arbitration_id=0x705, data=[5], is_extended_id=False))
        bench.arm()
        wait_until(lambda: bench.state is State.FAULT, 60.0)
    for _ in range(2):
        refused = smarttac(virtual, "reset")
        assert (refused.exit_code, refused.stderr) == (
            1,
            "Error: the fault cannot be reset: the heartbeat of a watched node is lost; node 5 is "
            "watched but not heard: start it again, or write 0 to 1016h sub-index 2 of node 32, or "
            "reset node 32 (NMT)\n",
        )
    with Stimulator.connect(**virtual) as bench:
        bench.set(watch, 0)
    assert smarttac(virtual, "reset").exit_code == 0


def test_no_node_there(virtual: dict[str, Any], node: StimulatorNode) -> None:
    result = smarttac(virtual, "status", "--node-id", "40", "--timeout", "0.2")
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: no node 40 answers on virtual:")
