"""Old and new do the same: in what is drawn, in what the cases know, and in what tests do."""

from __future__ import annotations

import json
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import frozen
import pytest
import shadowed
from corpus import RowName, interleavings, require_same, rows, ticks_of_row
from frozen import BASELINE, NAME, NEW, OLD_NAME, old
from hypothesis import given, settings
from pair import BothFailed, Difference
from sabotages import BEGIN, SABOTAGES, Sabotage, broken
from scripts import Script, scripts
from world import Setting, World

from smarttac_can.device.application import Application
from smarttac_can.device.device import Device
from smarttac_can.device.emcy import Emergency
from smarttac_can.device.frame import Frame
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.eds import load_eds
from smarttac_can.trials.fault_cases import CASES
from smarttac_can.trials.rig import Rig

RICH = (Path(__file__).parents[1] / "eds" / "rich.eds").read_text(encoding="ascii")
TOOL = Path(__file__).parents[2] / "tools" / "shadow"


def sabotage(what: str) -> Sabotage:
    return next(row for row in SABOTAGES if row.what == what)


@settings(max_examples=12)
@given(scripts(scenes=6))
def test_drawn_scripts(script: Script) -> None:
    try:
        World(old(), NEW, script[0]).play(script[1])
    except BothFailed as failure:
        pytest.fail(f"both raise {failure}")


def test_the_two_packages_share_nothing() -> None:
    assert old().module("nodes.supervisor").State is not NEW.module("nodes.supervisor").State
    file = old().module("nodes.supervisor").__file__
    assert file is not None
    assert Path(file).is_relative_to(frozen.ROOT / "build" / "shadow")
    names = {name for name in sys.modules if name.partition(".")[0] == OLD_NAME}
    for name in names:
        source = getattr(sys.modules[name], "__file__", None)
        assert source is not None
        assert f"import {NAME}." not in Path(source).read_text()
        assert f"from {NAME}." not in Path(source).read_text()


def test_a_commit_has_its_files() -> None:
    files = frozen._of_commit("HEAD")
    assert "eds/plate.eds" in files
    assert b"class Supervisor" in files["smarttac_can/nodes/supervisor.py"]
    with pytest.raises(ValueError, match=r"^no-such-commit: "):
        frozen._of_commit("no-such-commit")


def test_one_old_implementation_in_a_process() -> None:
    old()
    with pytest.raises(RuntimeError, match=f"^smarttac_can_old is of {BASELINE}, not of HEAD$"):
        frozen.old("HEAD")


CHOSEN = (
    RowName("S3 off in 4 of 5 cycles", 4, False),
    RowName("controller gives NaN", 1, False),
    RowName("drives lost", 3, False),
)


@pytest.mark.parametrize("row", CHOSEN, ids=str)
def test_a_row_of_the_fault_matrix(row: RowName) -> None:
    expected, found = (ticks_of_row(package, row, hold=10) for package in (old(), NEW))
    assert len(found) > 500
    assert any(frame[0] in (0xA0, 0xA1) for tick in found for frame in tick.frames)
    require_same(row, expected, found)


def test_every_row_of_the_fault_matrix_can_be_compared() -> None:
    assert {row.fault for row in rows()} == {case.name for case in CASES}


def test_a_row_that_differs_is_found() -> None:
    row = CHOSEN[2]
    expected = ticks_of_row(old(), row, hold=1)
    with broken(NEW, sabotage("a wrong check counts for less")):
        require_same(row, expected, ticks_of_row(NEW, row, hold=1))
    with broken(NEW, sabotage("a plate that tripped waits as at first")):
        found = ticks_of_row(NEW, row, hold=1)
    with pytest.raises(Difference, match=r"^drives lost, amplitude_resonance, cycle \d+: frames\n"):
        require_same(row, expected, found)
    with pytest.raises(Difference, match="cycles\n"):
        require_same(row, expected, expected[:-1])


def test_orders_of_a_remapping_and_commands() -> None:
    orders = list(interleavings())
    assert len(orders) == len({str(acts) for _, acts in orders}) == 336
    for _, acts in orders[::48]:
        World(old(), NEW, Setting()).play(acts)


def test_a_transcript_is_what_passed() -> None:
    world = World(old(), NEW, Setting())
    world.play([("nmt", 1), ("cycles", 10), ("frame", 0x7E5, "00"), ("cycles", 1)])
    lines = world.transcript().splitlines()
    assert lines[0] == f"# {Setting()}"
    assert lines[1:3] == ["< 721 00", "< 720 00"]
    assert lines[lines.index("# nmt 1") + 1] == "> 000 01 00"
    assert "> 7E5 00" in lines
    [left_out] = [line for line in lines if line.endswith("cycles with nothing but the loop")]
    assert 5 <= int(left_out.split()[1]) <= 8
    assert sum(line == "> 080" for line in lines) == 11 - int(left_out.split()[1])


@pytest.fixture
def tool() -> dict[str, Any]:
    """Names of the tool, which its functions see."""
    names: dict[str, Any] = runpy.run_path(str(TOOL))["main"].__globals__
    return names


def test_what_is_drawn_is_shrunk_and_can_be_played_again(
    tool: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with broken(NEW, sabotage("the drive answers another tick")):
        result = tool["batch"](1, BASELINE, 3)
        difference = result["difference"]
        assert difference["what"] == "frames"
        assert result["scripts"] > 1
        assert len(difference["script"]["acts"]) <= 4
        assert difference["transcript"].startswith("# Setting(plate='node'")
        kept = tmp_path / "script.json"
        kept.write_text(json.dumps(difference["script"]))
        with patch.object(sys, "argv", ["shadow", "play", str(kept)]):
            assert tool["main"]() == 1
    assert difference["transcript"] in capsys.readouterr().out
    with patch.object(sys, "argv", ["shadow", "play", str(kept), "--json"]):
        assert tool["main"]() == 0
    assert json.loads(capsys.readouterr().out)["difference"] is None


def test_hours_are_counted_in_simulated_time(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    played: list[int] = []

    def batch(number: int, commit: str | None) -> dict[str, Any]:
        played.append(number)
        seen = {"ticks": 1_800_000, "states": {"RUNNING": 900_000}, "driven": {}, "latched": {}}
        return {
            "seed": number, "scripts": 20, "both_failed": ["x"], "difference": None,
            "seen": seen | {"messages": 0},
        }  # fmt: skip

    monkeypatch.setitem(tool, "batch", batch)
    monkeypatch.setattr(sys, "argv", ["shadow", "drawn", "--hours", "1.2", "--seed", "7", "--json"])
    assert tool["main"]() == 0
    result = json.loads(capsys.readouterr().out)
    assert played == [7, 8, 9]
    assert (result["simulated_h"], result["scripts"], result["both_failed"]) == (1.5, 60, ["x"])


@pytest.fixture
def with_shadows() -> Iterator[None]:
    made = shadowed._with_shadow("StimulatorNode", StimulatorNode.__init__)
    shadowed.differences.clear()
    with patch.object(StimulatorNode, "__init__", made):
        yield
    shadowed.differences.clear()


@pytest.mark.usefixtures("with_shadows")
def test_a_node_of_a_test_has_a_shadow() -> None:
    before = shadowed.counts.copy()
    rig = Rig()
    rig.start()
    counted = shadowed.counts - before
    assert counted["with a shadow"] == 1
    assert counted["calls"] > 500
    assert shadowed.differences == []
    # What a test does inside its node is none of the shadow's business.
    rig.od["Limit.Voltage"].value = 1
    rig.cycle(3)
    assert shadowed.differences == []
    with broken(NEW, sabotage("a window of SYNC begins a tick later")):
        rig.cycle(30)
    assert [difference.what for difference in shadowed.differences] == ["bus sync window"]


@pytest.fixture
def devices_with_shadows() -> Iterator[None]:
    made = shadowed._with_shadow("Device", Device.__init__)
    shadowed.differences.clear()
    with patch.object(Device, "__init__", made):
        yield
    shadowed.differences.clear()


@pytest.mark.usefixtures("devices_with_shadows")
def test_a_device_of_a_test_has_a_shadow() -> None:
    before = shadowed.counts.copy()
    with_application = Device(load_eds(RICH, 32), Application())
    device = Device(load_eds(RICH, 32))
    assert shadowed.counts - before == {"with a shadow": 1, "without a shadow": 1}
    with_application.start()
    device.start()
    device.receive(Frame(0, bytes((1, 32))))
    device.emergency(0x1000, 0, vendor=b"x")
    device.take()
    device.advance(1000)
    assert shadowed.differences == []
    with patch.object(Emergency, "clear", lambda *_: None):
        device.clear_emergency(0x1000)
    assert [difference.what for difference in shadowed.differences] == ["emergencies"]


def test_both_may_fail_alike() -> None:
    world = World(old(), NEW, Setting())
    for side in (world.pairs[33].old, world.pairs[33].new):
        side.node.receive = lambda frame: 1 / 0
    with pytest.raises(BothFailed, match=r"^plate, after receive 080: ZeroDivisionError"):
        world.play([("cycles", 1)])
    world.pairs[33].old.node.receive = lambda frame: []
    with pytest.raises(Difference, match="plate, after receive 080: error"):
        world.play([("cycles", 1)])


def test_the_way_into_a_run_drives() -> None:
    world = World(old(), NEW, Setting())
    world.play(BEGIN)
    assert world.seen.driven["AMPLITUDE_RESONANCE"] > 60
