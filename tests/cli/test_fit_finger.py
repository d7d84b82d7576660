"""``smarttac fit-finger``: columns of a file, limits and reasons, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import refusal, succeed

from smarttac_can.cli import fit_finger as command
from smarttac_can.science.plant.subjects import SUBJECTS, Subject
from smarttac_can.science.population.finger_fit import Estimate, FingerFit, FingerRecording

FIT = FingerFit(
    SUBJECTS[1],
    {
        "mu0": Estimate(0.445, 0.44, 0.45, True, ""),
        "W0": Estimate(2.3e-6, 2.2e-6, 2.4e-6, True, ""),
        "skin_mass": Estimate(1e-4, 2e-5, 5e-4, False, "told by the acceleration of the skin"),
    },
    4.3e-3,
    11_000,
    5000.0,
)


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> list[FingerRecording]:
    """Return what is fitted, without the fit."""
    seen: list[FingerRecording] = []

    def fitted(recording: FingerRecording, **_: object) -> FingerFit:
        seen.append(recording)
        return FIT

    monkeypatch.setattr(command, "fitted_to", fitted)
    return seen


def table(folder: Path, header: str, rows: str) -> Path:
    file = folder / "lab.csv"
    file.write_text(f"{header}\n{rows}\n")
    return file


def test_columns_of_a_trace_are_the_defaults(tmp_path: Path, given: list[FingerRecording]) -> None:
    header = "time_s,cof,amplitude_um,tangential_force_n,normal_force_n,position_mm"
    file = table(tmp_path, header, "0.1,0.4,1.5,0.2,0.5,-3\n0.101,,1,0.2,0.5,")
    shown = succeed("fit-finger", file)
    (recording,) = given
    assert recording.time.tolist() == [0.1]
    assert recording.position.tolist() == [-3e-3]
    assert recording.amplitude is not None
    assert recording.amplitude.tolist() == pytest.approx([1.5e-6])
    assert recording.position_by_gauges
    assert shown.splitlines()[1:] == [
        "mu0                    0.445  0.440 .. 0.450",
        "W0                      2.30  2.20 .. 2.40 um",
        "skin_mass           not told  told by the acceleration of the skin",
        "11000 ms compared, as good as 5000 independent ones; 4.3 mN are left",
    ]


def test_force_acceleration_and_speed_of_a_lab_are_taken(
    tmp_path: Path, given: list[FingerRecording]
) -> None:
    file = table(tmp_path, "t [ms],Fx,Fz [mN],v [m/s],a", "0,0.2,500,0.05,2\n2,0.2,500,0.05,3")
    columns = ("--time", "t", "--lateral", "Fx", "--normal", "Fz", "--speed", "v")
    succeed("fit-finger", file, "--bare", *columns, "--acceleration", "a", "--path", "1000")
    (recording,) = given
    assert recording.normal.tolist() == [0.5, 0.5]
    assert recording.position.tolist() == pytest.approx([0.0, 0.1e-3])
    assert recording.acceleration is not None
    assert recording.acceleration.tolist() == [2.0, 3.0]
    assert recording.amplitude is None
    assert recording.path_frequency == 1000.0
    assert not recording.position_by_gauges


def test_subject_of_the_json_is_taken_by_subject(
    tmp_path: Path, given: list[FingerRecording]
) -> None:
    header = "time_s,amplitude_um,tangential_force_n,normal_force_n,position_mm"
    file = table(tmp_path, header, "0,1,0.2,0.5,0")
    made = json.loads(succeed("fit-finger", file, "--json", "-"))
    assert given
    assert Subject(**made["subject"]) == SUBJECTS[1]
    assert made["numbers"]["skin_mass"]["told"] is False
    assert np.isclose(made["residual_n"], 4.3e-3)


def test_wrong_columns_are_refused_in_one_line(tmp_path: Path) -> None:
    header = "time_s,amplitude_um,tangential_force_n,normal_force_n,position_mm,a [g]"
    file = table(tmp_path, header, "0,1,0.2,0.5,0,1\n0.001,1,0.2,0.5,0,1")
    assert "there is no column 'Fx'" in refusal("fit-finger", file, "--lateral", "Fx")
    assert "is in 'g', and not in m/s^2" in refusal("fit-finger", file, "--acceleration", "a")
    assert "named twice" in refusal("fit-finger", file, "--speed", "time_s")
    assert "2 rows are fewer than the 500 of a fit" in refusal("fit-finger", file)
