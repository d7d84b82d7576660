"""``smarttac calibrate`` as a command, on a simulated plate that is pressed and pulled as told."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result
from nodes_on_a_bus import multicast_options, processes

from smarttac_can.bench import Stimulator
from smarttac_can.bench.open_link import LocalLink
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.cli import main
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.plant.finger import Trajectory
from smarttac_can.vocabulary.faults import FaultKind

PHASE_S = 1.0
G = 9.80665
PULL = 0.5
PLAN = """mass_g,angle_deg,azimuth_deg,x_mm
200,0,0,-20
200,0,0,20
101.890,30,1.6866,0
99.930,30,92.2907,0
"""
"""The tilted ones load one lateral gauge each, by 0.5 N: what a simulated fault can do."""
PRESSES = (
    (-20e-3, 0.2 * G),
    (20e-3, 0.2 * G),
    (0.0, 0.1019 * G * 0.8660),
    (0.0, 0.0999 * G * 0.8660),
)


class Laboratory:
    """A bench whose person does what is asked, one phase of the simulated finger after another."""

    def __init__(self, scale: float) -> None:
        samples = [(0.0, 0.0, 0.0)]
        for row, (x, Fn) in enumerate(PRESSES):
            start = (2 * row + 2) * PHASE_S
            samples += [(start - 0.6, x, 0.0), (start - 0.5, x, scale * Fn)]
            samples += [(start + 0.5, x, scale * Fn), (start + 0.6, x, 0.0)]
        block = StimulatorBlock(stimulator_od(), PlateBlock(plate_od(), Trajectory(samples)))
        self.od = block.od
        self.bench = Stimulator(LocalLink(block), block.od)
        self.bench.finger.play_recording()
        self.bench.start_run()
        self.bench.tare()
        self._phase = 0
        self.asked: list[str] = []

    def do(self, what: str) -> None:
        self.asked.append(what)
        self._phase += 1
        row, loaded = divmod(self._phase - 1, 2)
        self.bench.set("Fault.Kind", FaultKind.NONE)
        if loaded and row >= 2:
            self.bench.set("Fault.Sensor", row - 1)
            self.bench.set("Fault.Value", 1e3 * PULL)
            self.bench.set("Fault.Kind", FaultKind.OFFSET)
        now = self.bench.get("Cycle.Cycles") * 1e-3
        self.bench.run(self._phase * PHASE_S - 0.2 - now)


@pytest.fixture
def scale(request: pytest.FixtureRequest) -> float:
    return float(getattr(request, "param", 1.0))


@pytest.fixture
def laboratory(monkeypatch: pytest.MonkeyPatch, scale: float) -> Iterator[Laboratory]:
    made = Laboratory(scale)
    monkeypatch.setattr(Stimulator, "connect", lambda **_: made.bench)
    monkeypatch.setattr(made.bench._link, "close", lambda: None)
    monkeypatch.setattr(sys.modules["smarttac_can.cli.calibrate"], "_ask", made.do)
    yield made


def calibrate(folder: Path, *arguments: str) -> Result:
    plan = folder / "plan.csv"
    if not plan.exists():
        plan.write_text(PLAN)
    certificate = str(folder / "plate.json")
    return CliRunner().invoke(
        main, ["calibrate", str(plan), "--certificate", certificate, *arguments]
    )


def test_a_plate_is_calibrated_and_has_its_nulls(laboratory: Laboratory, tmp_path: Path) -> None:
    written: dict[str, Any] = {}
    link = laboratory.bench._link
    write = link.write
    link.write = lambda name, raw: (written.update({name: raw}), write(name, raw))
    result = calibrate(tmp_path, "--write")
    assert result.exit_code == 0, result.output
    assert laboratory.asked[:2] == [
        "1: level the plate, nothing on it",
        "1: put 200 g at -20 mm",
    ]
    assert laboratory.asked[4] == "3: tilt the plate by 30 degrees towards 1.6866, nothing on it"
    assert laboratory.asked[-1] == "level the plate, nothing on it"
    certificate = json.loads((tmp_path / "plate.json").read_text())
    found = certificate["calibration"]["objects"]
    # The simulated cross-talk is ((1, 0.04), (-0.03, 1.02)); its gauges stand at +-28 mm.
    assert found["Calibration.Fx from S1"] == pytest.approx(0.9988, abs=0.01)
    assert found["Calibration.Fx from S2"] == pytest.approx(-0.0392, abs=0.01)
    assert found["Calibration.Fy from S1"] == pytest.approx(0.0294, abs=0.01)
    assert found["Calibration.Fy from S2"] == pytest.approx(0.9792, abs=0.01)
    assert found["Calibration.Position of S3"] == pytest.approx(-28_000, abs=300)
    assert certificate["calibration"]["normal_scale"] == pytest.approx(1.0, abs=0.01)
    assert len(certificate["weighings"]) == 4
    assert len(certificate["weighings"][0]["loaded_mN"]) == 6
    assert certificate["written"]["Gauge null.Window"] == 60
    assert written["Gauge null.Window"] == 60
    assert written["Calibration.Fx from S1"] == round(found["Calibration.Fx from S1"] * 1e4)
    assert "S3 to S6 show" in result.stdout
    assert "Calibration.Position of S3: -2" in result.stdout
    assert result.stdout.splitlines()[4].endswith(" um")


REHEARSAL = """mass_g,angle_deg,azimuth_deg,x_mm
200,30,0,0
200,30,90,0
300,0,0,-20
300,0,0,20
"""


@pytest.mark.parametrize(
    "commands", [("node --lockstep",), ("node --lockstep --plate-node 33", "plate --lockstep")]
)
def test_a_calibration_is_rehearsed_without_a_person(
    commands: tuple[str, ...], multicast: dict[str, Any], tmp_path: Path
) -> None:
    """Also of a plate that a finger strokes by default: it is lifted."""
    (tmp_path / "plan.csv").write_text(REHEARSAL)
    more = ["--plate-node", "33"] if len(commands) > 1 else []
    with processes(multicast, *commands):
        result = calibrate(
            tmp_path, *multicast_options(multicast), *more, "--rehearse", "--lockstep", "--write"
        )
    assert result.exit_code == 0, result.output
    assert result.stderr.splitlines()[:2] == [
        "1: tilt the plate by 30 degrees towards 0, nothing on it",
        "1: put 200 g at 0 mm",
    ]
    certificate = json.loads((tmp_path / "plate.json").read_text())
    assert certificate["written"]["Calibration.Fx from S2"] == pytest.approx(-0.0392, abs=0.005)
    assert certificate["written"]["Gauge null.Null of S3"] == pytest.approx(-1045.7, abs=3.0)


def test_without_write_nothing_changes(laboratory: Laboratory, tmp_path: Path) -> None:
    result = calibrate(tmp_path)
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / "plate.json").read_text())["written"] == {}
    assert laboratory.od["Gauge null.Window"].value == 1500


@pytest.mark.parametrize("scale", [0.9], indirect=True)
def test_what_does_not_fit_is_not_written(laboratory: Laboratory, tmp_path: Path) -> None:
    result = calibrate(tmp_path, "--write")
    assert result.exit_code == 1
    line = result.stderr.splitlines()[-1]
    assert line.startswith("Error: not to be used: Fn is left with")
    assert "S3 to S6 show 0.8996 of the weights" in line
    certificate = json.loads((tmp_path / "plate.json").read_text())
    assert certificate["written"] == {}
    assert len(certificate["calibration"]["shortcomings"]) == 2
    assert laboratory.od["Gauge null.Window"].value == 1500


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mass\n", "plan.csv: line 1 is not mass_g,angle_deg,azimuth_deg,x_mm"),
        (PLAN.replace("200,0,0,20", "200,0,0,99"), "line 3: x_mm 99 is outside -38..38"),
    ],
)
def test_a_plan_is_looked_at_before_a_bus_is_opened(
    text: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "plan.csv").write_text(text)
    result = calibrate(tmp_path, "--interface", "virtual")
    assert result.exit_code == 1
    assert message in result.stderr.splitlines()[-1]
    assert not (tmp_path / "plate.json").exists()


def test_tilts_in_one_direction_are_refused_before_any_weight_is_asked_for(
    laboratory: Laboratory, tmp_path: Path
) -> None:
    (tmp_path / "plan.csv").write_text("\n".join(PLAN.splitlines()[:4]) + "\n")
    result = calibrate(tmp_path)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line == (
        f"Error: {tmp_path}/plan.csv: the tilted weighings load one direction only: "
        "tilt along x and along y"
    )
    assert laboratory.asked == []
    assert not (tmp_path / "plate.json").exists()


def test_who_drives_is_not_disturbed(laboratory: Laboratory, tmp_path: Path) -> None:
    laboratory.bench.voltage = 5.0
    laboratory.bench.mode = "open_loop"
    result = calibrate(tmp_path, "--write")
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: somebody drives the stimulator: it is armed or running")
    assert laboratory.asked == []
    assert not (tmp_path / "plate.json").exists()


def test_a_certificate_that_exists_is_kept(laboratory: Laboratory, tmp_path: Path) -> None:
    (tmp_path / "plate.json").write_text("of last year")
    result = calibrate(tmp_path)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    cure = "choose another file, or replace it with --force"
    assert line == f"Error: {tmp_path}/plate.json exists: {cure}"
    assert (tmp_path / "plate.json").read_text() == "of last year"
    assert laboratory.asked == []


@pytest.mark.parametrize("end", [click.Abort, KeyboardInterrupt])
def test_who_interrupts_is_told_that_nothing_is_kept(
    laboratory: Laboratory,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    end: type[BaseException],
) -> None:
    def leave(what: str) -> None:
        if what.startswith("2: put"):
            raise end
        laboratory.do(what)

    monkeypatch.setattr(sys.modules["smarttac_can.cli.calibrate"], "_ask", leave)
    result = calibrate(tmp_path, "--write")
    assert (result.exit_code, result.stderr) == (
        1,
        "Error: interrupted after 1 of 4 weighings: none is kept, and nothing was set in the "
        "stimulator\n",
    )
    assert [path.name for path in tmp_path.iterdir()] == ["plan.csv"]


@pytest.mark.parametrize("name", ["plan.csv", "linked.json", "./plan.csv"])
def test_the_certificate_never_takes_the_place_of_the_plan(tmp_path: Path, name: str) -> None:
    plan = tmp_path / "plan.csv"
    plan.write_text(PLAN)
    (tmp_path / "linked.json").symlink_to(plan)
    arguments = ["calibrate", str(plan), "--certificate", f"{tmp_path}/{name}", "--force"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 2
    assert "would take the place of the plan" in result.stderr
    assert plan.read_text() == PLAN


def test_the_plan_is_not_where_the_certificate_is_made(tmp_path: Path) -> None:
    plan = tmp_path / "plate.json.part"
    plan.write_text(PLAN)
    arguments = ["calibrate", str(plan), "--certificate", str(tmp_path / "plate.json")]
    assert CliRunner().invoke(main, arguments).exit_code == 2
    assert plan.read_text() == PLAN
