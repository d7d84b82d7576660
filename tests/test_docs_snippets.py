"""The Python of the documentation runs: each page from top to bottom, beside a simulated plate."""

import inspect
import re
import time
from pathlib import Path
from typing import Any

import canopen
import pytest
from nodes_on_a_bus import GUARD_S, in_threads, stimulator_with_plate

from smarttac_can.bench import Stimulator
from smarttac_can.bench.local_link import LocalLink
from smarttac_can.bench.open_link import plate_od, stimulator_od
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.plant.finger import Trajectory

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
PAGES = sorted(
    page for page in (ROOT / "docs").rglob("*.md") if "```python" in page.read_text("utf-8")
)
MASTER = ROOT / "docs" / "how-to" / "integrate-with-a-master.md"
ALONE = [page for page in PAGES if page != MASTER]
WITHOUT_END = "run_node(node, PythonCanBus("
"""Runs until a signal comes, on a bus that is not there; the runner has tests of its own."""


def simulated() -> Stimulator:
    """Simulate a stimulator without a bus, with a recorded finger to play."""
    recording = Trajectory([(0.0, 0.0, 0.5), (1.0, 0.01, 0.5)])
    block = StimulatorBlock(stimulator_od(), PlateBlock(plate_od(), recording))
    return Stimulator(LocalLink(block), block.od)


def run(page: Path, names: dict[str, Any], request: pytest.FixtureRequest) -> None:
    """Execute the blocks of a page one after the other, and the tests that they define."""
    text = page.read_text(encoding="utf-8")
    for block in BLOCK.finditer(text):
        line = text.count("\n", 0, block.start()) + 1
        source = "\n" * line + block[1].replace('== "..."', '!= "..."')
        code = compile(source, str(page), "exec")
        if WITHOUT_END in source:
            continue
        known = set(names)
        exec(code, names)
        for name in names.keys() - known:
            if name.startswith("test_"):
                test = names[name]
                fixtures = inspect.signature(test).parameters
                test(**{fixture: request.getfixturevalue(fixture) for fixture in fixtures})


@pytest.mark.parametrize("page", ALONE, ids=[page.stem for page in ALONE])
def test_page(
    page: Path,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    signature = inspect.signature(Stimulator.connect)

    def connect(**options: Any) -> Stimulator:
        signature.bind(**options)
        return Stimulator.simulate("local")

    monkeypatch.setattr(Stimulator, "connect", connect)
    monkeypatch.chdir(tmp_path)
    with simulated() as bench:
        names = {
            "bench": bench,
            "stimulator": bench,
            "trace": bench.run(0.1),
            "node": stimulator_with_plate(),
            "text": stimulator_od().text,
            "path": tmp_path / "trace.csv",
        }
        run(page, names, request)
    printed = capsys.readouterr().out
    for shown in re.findall(r"\$ python friction.py\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
        assert printed.endswith(shown)


def test_a_master_of_python_canopen(
    virtual: dict[str, Any],
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    connect = canopen.Network.connect
    monkeypatch.setattr(canopen.Network, "connect", lambda self, **_: connect(self, **virtual))
    monkeypatch.chdir(ROOT)
    node = stimulator_with_plate()
    with in_threads(virtual, node, lockstep=False):
        guard = time.monotonic() + GUARD_S
        while not node.block.interlock.tared:
            assert time.monotonic() < guard, "it was not tared"
            time.sleep(0.005)
        run(MASTER, {}, request)
    assert re.match(r"Contact.Tangential force \[mN\] -?\d+\nContact.Nor", capsys.readouterr().out)
