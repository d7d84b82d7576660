"""``tools/count_calls`` counts: a call more in each cycle is one more in its figures."""

import gc
import json
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from platform import python_version
from shutil import which
from typing import Any

import pytest

from smarttac_can.nodes.stimulator_block import StimulatorBlock

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "tools" / "count_calls"
STRACE = pytest.mark.skipif(which("strace") is None, reason="strace is not installed")


@pytest.fixture(scope="module")
def tool() -> Iterator[dict[str, Any]]:
    """Names of the tool, which its functions see."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(TOOL.parent))
        names: dict[str, Any] = runpy.run_path(str(TOOL))["main"].__globals__
        yield names


def module(name: str, source: str) -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": name}
    exec(compile(source, f"/somewhere/{name.replace('.', '/')}.py", "exec"), names)
    return names


def test_calls_are_counted_by_kind_and_module(tool: dict[str, Any]) -> None:
    plant = module(
        "smarttac_can.plant.fake",
        "def step(): return [len(()), len(()), inner()]\ndef inner(): pass",
    )
    nodes = module("smarttac_can.nodes.fake", "def cycle(): hash(0)")
    others = module("numpy.fake", "def g(): pass")

    def run(cycles: int) -> None:
        abs(cycles)  # once a run, so in no figure
        for _ in range(cycles):
            plant["step"]()
            nodes["cycle"]()
            others["g"]()
            others["g"]()

    found = tool["count"](run, 7)
    assert found["science_by_module"] == {"plant.fake": {"python": 2.0, "c": 2.0}}
    assert found["rest_by_package"] == {
        "nodes": {"python": 1.0, "c": 1.0},
        "outside": {"python": 2.0, "c": 0.0},
    }
    assert found["calls"] == {"python": 5.0, "c": 3.0}
    assert found["calls_of_the_science"] == {"python": 2.0, "c": 2.0}
    assert found["calls_of_the_rest"] == {"python": 3.0, "c": 1.0}
    assert found["files_entered"] == 2
    assert found["files_entered_outside"] == 2, "the made-up one, and this"


def test_a_call_more_in_a_cycle_of_the_loop_is_seen(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = tool["count_way"](tool["WAYS"]["local link"], ROOT, 32)
    sound = StimulatorBlock.tick

    def tick(self: StimulatorBlock) -> None:
        len(())
        sound(self)

    monkeypatch.setattr(StimulatorBlock, "tick", tick)
    after = tool["count_way"](tool["WAYS"]["local link"], ROOT, 32)
    assert after["calls"]["python"] - before["calls"]["python"] == pytest.approx(1.0, abs=1e-6)
    assert after["calls"]["c"] - before["calls"]["c"] == pytest.approx(1.0, abs=1e-6)
    assert after["calls_of_the_science"] == before["calls_of_the_science"]
    assert before["calls_of_the_science"]["python"] > 50
    assert after["files_entered_outside"] == before["files_entered_outside"] + 1


def test_who_listens_to_the_collector_is_not_counted(tool: dict[str, Any]) -> None:
    heard = []
    gc.callbacks.append(lambda phase, _info: heard.append(phase))
    threshold = gc.get_threshold()
    gc.set_threshold(1)
    try:
        with tool["Calls"]() as calls:
            kept = [[n] for n in range(1000)]
    finally:
        gc.set_threshold(*threshold)
        gc.callbacks.pop()
    assert len(kept) == 1000
    assert calls.python.total() < 5
    assert gc.isenabled()


def test_all_loops_are_counted(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(tool, "traced", lambda *_: {"per_cycle": None, "reason": "not asked for"})
    monkeypatch.setattr(sys, "argv", ["count_calls", "--cycles", "20", "--json"])
    tool["main"]()
    results = json.loads(capsys.readouterr().out)
    assert results.pop("python") == f"CPython {python_version()}"
    assert results.pop("cycles") == 20
    local, bus, recording = (results[name]["calls"]["python"] for name in tool["WAYS"])
    assert local < bus < recording
    science = [results[name]["calls_of_the_science"]["python"] for name in tool["WAYS"]]
    assert science == pytest.approx(science[:1] * 3, abs=1.0), "the same formulas on all"
    tool["show"](results | {"python": "CPython", "cycles": 20})
    assert "system calls are not counted: not asked for" in capsys.readouterr().out


MARKED = """
import os, runpy, sys
sys.path.insert(0, {tools!r})
tool = runpy.run_path({tool!r})
os.getppid()
tool["marked"](lambda: [{act} for _ in range(10)])
os.getppid()
"""


@STRACE
@pytest.mark.parametrize(
    ("act", "number"), [("os.getppid()", 1), ("(os.getppid(), os.getppid())", 2)]
)
def test_system_calls_between_the_marks_are_counted(
    tool: dict[str, Any], act: str, number: int
) -> None:
    script = MARKED.format(tool=str(TOOL), tools=str(TOOL.parent), act=act)
    found = tool["traced"]([sys.executable, "-c", script], ROOT, 10)
    assert found["by_name"]["getppid"] == number
    assert number <= found["per_cycle"] <= number + 0.5, "next to nothing else"


def test_a_machine_without_strace_counts_none(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(tool, "which", lambda _: None)
    found = tool["traced"]([sys.executable], ROOT, 10)
    assert found == {"per_cycle": None, "reason": "strace is not installed"}


def test_a_tree_without_the_package_is_refused(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "argv", ["count_calls", str(tmp_path)])
    with pytest.raises(SystemExit, match=r"^2$"):
        tool["main"]()
