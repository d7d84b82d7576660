"""The tool that kills recordings: it sees what holds, and what does not."""

import importlib.machinery
import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

TOOL = Path(__file__).parents[2] / "tools" / "record_kills"


@pytest.fixture(scope="module")
def tool() -> Any:
    loader = importlib.machinery.SourceFileLoader("record_kills", str(TOOL))
    spec = importlib.util.spec_from_loader("record_kills", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def test_a_kill_and_a_recording(multicast: dict[str, Any]) -> None:
    options = ["--kills", "1", "--seconds", "3", "--port", str(multicast["port"]), "--json"]
    command = [sys.executable, TOOL, *options]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr + run.stdout
    result = json.loads(run.stdout)
    assert [row["wrong"] for row in result["kills"]] == [[]]
    assert result["kills"][0]["rows"] > 50
    assert result["long"]["set_points"] > 10


def recording(path: Path, ticks: list[int], gaps: list[tuple[int, int]]) -> Path:
    with h5py.File(path, "w") as file:
        file["tick"] = np.array(ticks)
        file["run"] = np.zeros(len(ticks), np.int64)
        file["host_time_ns"] = np.array(ticks, np.int64) * 1_000_000
        fields = [("first_tick", "i8"), ("last_tick", "i8"), ("host_time_ns", "i8")]
        rows = [(first, last, (last + 1) * 1_000_000) for first, last in gaps]
        file["gaps"] = np.array(rows, fields)
        file["set_points"] = np.array([(1.0,)], [("value", "f8")])
    return path


@pytest.mark.parametrize(
    ("gaps", "wrong"),
    [
        ([(500, 509)], []),
        ([], ["rows and gaps are not all ticks", "10 ticks that were on the bus are neither"]),
        ([(500, 508)], ["rows and gaps are not all ticks", "1 ticks that were on the bus are"]),
        ([(499, 509)], ["rows and gaps are not all ticks"]),
    ],
)
def test_what_is_wrong_is_named(
    tool: Any, tmp_path: Path, gaps: list[tuple[int, int]], wrong: list[str]
) -> None:
    ticks = [tick for tick in range(1000) if not 500 <= tick < 510]
    witness = tool.Witness()
    witness.heard = [(tick * 1e-3, tick) for tick in range(1000)]
    row = tool.look(recording(tmp_path / "run.h5", ticks, gaps), witness, 1.5)
    assert len(row["wrong"]) == len(wrong)
    assert all(found.startswith(words) for found, words in zip(row["wrong"], wrong, strict=True))
    assert row["missing_s"] == pytest.approx(0.501)


def test_set_points_that_are_missing(tool: Any) -> None:
    written = [(n * 0.05, float(n)) for n in range(20)]
    changes = [float(n) for n in range(20) if n not in (7, 8)]
    assert tool.missing(written, changes) == written[7:9]
    assert tool.missing(written, [*changes, *[0.5] * 100, 7.0]) == written[7:9]
