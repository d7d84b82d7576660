"""Refusals: every code of the table is accepted, another one is a remark, an acceptance a fault."""

from collections.abc import Iterator

import pytest
from altered_device import SDO, Change, abort_codes, judge

from smarttac_can.canopen.conformance.refusals import REFUSALS, Refusal
from smarttac_can.canopen.conformance.run import CASES, failed, line, summary
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.cia import AbortCode

ODD = AbortCode.HARDWARE


def cases(refusal: Refusal) -> str:
    return refusal.cases.replace(",", "")


def without_structure(change: Change) -> Change:
    """Refuse sub-index FFh, which our device has, and then make a change."""

    def both(frame: Frame) -> Iterator[Frame]:
        if frame.can_id == SDO and frame.data[0] == 0x43 and frame.data[3] == 0xFF:
            code = AbortCode.NO_SUBINDEX.to_bytes(4, "little")
            frame = frame._replace(data=b"\x80" + frame.data[1:4] + code)
        yield from change(frame)

    return both


def test_refusals_name_existing_cases() -> None:
    numbers = {case.number for case in CASES}
    assert len(REFUSALS) == 21
    for refusal in REFUSALS:
        assert set(cases(refusal).split()) <= numbers
        assert ODD not in refusal.codes


@pytest.mark.parametrize("refusal", REFUSALS, ids=lambda refusal: refusal.cases)
def test_refusal_by_an_accepted_code_passes(refusal: Refusal) -> None:
    for code in refusal.codes:
        results = judge(
            outwards=without_structure(abort_codes(refusal.codes, code)), only=cases(refusal)
        )
        assert {(r.verdict, r.reason, r.remarks) for r in results} == {("pass", "", ())}, code


@pytest.mark.parametrize("refusal", REFUSALS, ids=lambda refusal: refusal.cases)
def test_refusal_by_another_code_is_a_remark(refusal: Refusal) -> None:
    results = judge(
        outwards=without_structure(abort_codes(refusal.codes, ODD)), only=cases(refusal)
    )
    for result in results:
        assert result.verdict == "pass"
        assert "abort 06060000" in result.remarks[0]
        assert f"remark: {result.remarks[0]}" in line(result)
    assert summary(results).endswith(f"; {len(results)} with a remark")


def confirmed(frame: Frame) -> Iterator[Frame]:
    """Confirm a request instead of refusing it."""
    if frame.can_id == SDO and frame.data[0] == 0x80:
        yield frame._replace(data=b"\x60" + frame.data[1:4] + bytes(4))
    else:
        yield frame


@pytest.mark.parametrize("refusal", REFUSALS, ids=lambda refusal: refusal.cases)
def test_request_that_is_not_refused_is_a_fault(refusal: Refusal) -> None:
    results = judge(outwards=without_structure(confirmed), only=cases(refusal))
    assert {r.case.number for r in failed(results)} == set(cases(refusal).split())
