"""``tools/bench`` times a loop that drives, and says so when it does not."""

import json
import runpy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from smarttac_can.bench import BenchError, Mode, State, Stimulator

TOOL = Path(__file__).parents[2] / "tools" / "bench"
STAGES = 9


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Names of the tool, to be run with few ticks."""
    monkeypatch.setattr("sys.argv", ["bench", "--ticks", "20", "--repeats", "2", "--json"])
    return runpy.run_path(str(TOOL))


def test_every_stage_takes_time(tool: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    tool["main"]()
    costs = json.loads(capsys.readouterr().out)
    assert len(costs) == STAGES
    assert all(cost > 0 for cost in costs.values())


def test_a_loop_that_is_off_is_an_error(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    off = property(None, lambda bench, _: bench.disarm())
    monkeypatch.setattr(Stimulator, "mode", off)
    with pytest.raises(SystemExit, match=r"^plant: step of 1 ms: state READY, mode OFF, a finger"):
        tool["main"]()


@dataclass
class Said:
    """What a bench says of its loop."""

    state: State = State.RUNNING
    mode: Mode = Mode.FRICTION
    touching: int = 1

    def get(self, name: str) -> float:
        return {"Mode display": self.mode, "Contact.Touching": self.touching}[name]


@pytest.mark.parametrize("cof", [0.335, 0.365])
def test_regulated_friction(tool: dict[str, Any], cof: float) -> None:
    tool["require_friction"](Said(), cof)


@pytest.mark.parametrize(
    ("said", "cof", "error"),
    [
        (Said(state=State.READY), 0.35, "state READY, mode FRICTION, a finger, COF 0.350:"),
        (Said(mode=Mode.AMPLITUDE), 0.35, "state RUNNING, mode AMPLITUDE, a finger, COF 0.350:"),
        (Said(touching=0), 0.35, "state RUNNING, mode FRICTION, no finger, COF 0.350:"),
        (Said(), 0.33, "state RUNNING, mode FRICTION, a finger, COF 0.330:"),
        (Said(), 0.37, "state RUNNING, mode FRICTION, a finger, COF 0.370:"),
    ],
)
def test_friction_that_is_not_regulated(
    tool: dict[str, Any], said: Said, cof: float, error: str
) -> None:
    with pytest.raises(
        BenchError, match=rf"^{error} friction is not regulated to 0\.35 within 5%$"
    ):
        tool["require_friction"](said, cof)
