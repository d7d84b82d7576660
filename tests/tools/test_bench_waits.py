"""``tools/bench/measure waits`` runs what users wait for, and finds what takes too long."""

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("resource", reason="of POSIX")

from smarttac_can.cli import FAMILIES


@pytest.fixture
def tool(load: Callable[[str], ModuleType]) -> Any:
    return load("bench/waits.py")


def test_each_command_is_among_them(tool: Any) -> None:
    names = {wait.name for wait in tool.waits()}
    assert len(names) > 30
    for family in FAMILIES.values():
        assert {f"smarttac {name} --help" for name in family} <= names


def test_process_above_its_bound_is_named(
    tool: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    busy = "sum(range(3_000_000))"
    waits = [tool.Wait("idle", ("-c", ""), 60.0), tool.Wait("busy", ("-c", busy), 0.001)]
    monkeypatch.setattr(tool, "waits", lambda: iter(waits))
    monkeypatch.setattr("sys.argv", ["measure waits", "--repeats", "1", "--json"])
    assert tool.main() == 1
    said = capsys.readouterr()
    assert said.err.splitlines()[-1] == "Error: busy is above its bound"
    rows = json.loads(said.out)
    assert set(rows) == {"idle", "busy"}
    assert rows["busy"]["processor_s"] > 0.001


def test_process_that_fails_ends_it_by_its_last_line(tool: Any, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=r"^Error: broken: ZeroDivisionError"):
        tool.waited(tool.Wait("broken", ("-c", "1/0"), 1.0), tmp_path)
