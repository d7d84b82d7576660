"""The fingers are those of docs/explanation/plant.md, and have the friction of the paper's."""

import re
from pathlib import Path

import pytest

from smarttac_can.science.plant.fitted import FITTED
from smarttac_can.science.plant.friction import check_reach, sliding_coefficient
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.studies.paper.references import REFERENCES

F0 = 43390.0
PAGE = Path(__file__).parents[3] / "docs/explanation/plant.md"
# With their force in N and speed in m/s.
PRESETS = [(subject, 0.5, 0.06) for subject in SUBJECTS[:4]]


def row(title, fingers):
    """The numbers of the row of a title in the table of so many fingers, a list for each."""
    for line in re.findall(rf"^\| {re.escape(title)} \|(.*)\|$", PAGE.read_text(), re.MULTILINE):
        cells = line.split("|")
        if len(cells) == fingers:
            return [[float(number) for number in re.findall(r"[\d.]+", cell)] for cell in cells]
    raise LookupError(title)


def test_the_presets():
    by_title = {
        "mu0": [[s.mu0] for s in SUBJECTS],
        "rho": [[s.rho] for s in SUBJECTS],
        "W0, um": [[s.W0 * 1e6] for s in SUBJECTS],
        "p": [[s.p] for s in SUBJECTS],
        "finger damping, N s/m": [[s.load_damping] for s in SUBJECTS],
    }
    for title, numbers in by_title.items():
        assert row(title, 5) == [pytest.approx(number) for number in numbers], title


def test_the_reduction_of_the_presets():
    rows = row("mu1/mu0 at 0.5, 1, 1.5, 2 um, %", 5)
    for subject, shown in zip(SUBJECTS, rows, strict=True):
        bare, *vibrated = (
            sliding_coefficient(subject, W * 1e-6, 0.06, 0.5, 0.0, f0=F0)
            for W in (0.0, 0.5, 1.0, 1.5, 2.0)
        )
        assert [100.0 * mu / bare for mu in vibrated] == pytest.approx(shown, abs=0.51)


def test_the_fitted_fingers():
    by_title = {
        "W0, um": [[finger.subject.W0 * 1e6] for finger in FITTED],
        "finger damping at 0.5 N, N s/m": [[finger.subject.load_damping] for finger in FITTED],
        "force, N; speed, mm/s": [[finger.force, finger.speed * 1e3] for finger in FITTED],
        "mu0 at 0.5 N": [[finger.subject.mu0] for finger in FITTED],
    }
    for title, numbers in by_title.items():
        assert row(title, 4) == [pytest.approx(number) for number in numbers], title


@pytest.mark.parametrize(
    ("finger", "references"),
    [*zip(PRESETS, REFERENCES, strict=True), *zip(FITTED, REFERENCES, strict=True)],
    ids=lambda of: getattr(of[0], "name", None),
)
def test_finger_has_its_subjects_friction_and_its_references(finger, references):
    """Wherever a stroke goes."""
    subject, force, speed = finger
    low, high = references
    for share in (0.8, 1.0, 1.2):
        bare = sliding_coefficient(subject, 0.0, speed, share * force, 0.0, f0=F0)
        assert high < bare < high + 0.1
    around = (0.8, 1.2)
    check_reach(
        subject,
        low,
        high,
        forces=tuple(share * force for share in around),
        speeds=tuple(share * speed for share in around),
    )


def test_fitted_subjects_differ_from_presets_in_fits_alone():
    searched = {"name", "mu0", "W0", "load_damping"}
    for preset, finger in zip(SUBJECTS, FITTED, strict=False):
        assert finger.subject.name != preset.name
        for name in set(preset.__dataclass_fields__) - searched:
            assert getattr(finger.subject, name) == getattr(preset, name)
