from collections import Counter
from pathlib import Path

from smarttac_can.canopen.conformance.run import CASES, GROUPS

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "conformance.md"
COUNTS = {
    "EDS": 1, "SDO": 30, "PDO": 33, "OD": 9, "EMCY": 6, "SYNC": 10, "GUARD": 6, "HB": 7, "BOTH": 7,
    "OTHER": 10, "STATE": 4, "TRANS": 4,
}  # fmt: skip


def test_every_group_has_its_cases_numbered_without_gap() -> None:
    assert Counter(case.group for case in CASES) == COUNTS
    assert list(GROUPS) == list(COUNTS)
    assert [case.number for case in CASES] == [
        f"{group}-{n:02}" for group, count in COUNTS.items() for n in range(1, count + 1)
    ]


def test_every_conformance_case_names_its_subject_and_clause() -> None:
    for case in CASES:
        assert 3 <= len(case.title) <= 60, case
        assert len(case.rule) > 20, case
    assert len({case.title for case in CASES}) >= len(CASES) - 6


def test_the_page_has_every_case_as_it_is() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for case in CASES:
        assert f"| {case.number} {case.title} | {case.rule} |" in page
