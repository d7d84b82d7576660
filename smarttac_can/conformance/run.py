"""Run the cases, each from a device fresh out of a reset."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from smarttac_can.conformance.case import Case, Failure, NotApplicable, Result
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.od.cia import Abort, AbortCode


def run_cases(
    examiner: Examiner, cases: Iterable[Case], on_result: Callable[[Result], None] | None = None
) -> list[Result]:
    """Judge a device.

    Parameters
    ----------
    on_result
        Called with each result as soon as it is known.

    Raises
    ------
    BusError
        If the bus carries no more frames.
    """
    results = []
    for case in cases:
        result = _run(examiner, case)
        results.append(result)
        if on_result is not None:
            on_result(result)
    return results


def _run(examiner: Examiner, case: Case) -> Result:
    for need in case.needs:
        reason = need(examiner.sheet)
        if reason is not None:
            return Result(case, "not applicable", reason)
    _reset(examiner)
    examiner.trace.clear()
    try:
        case.check(examiner)
    except NotApplicable as refusal:
        return Result(case, "not applicable", str(refusal))
    except (Failure, Abort) as failure:
        return Result(case, "fail", str(failure), tuple(examiner.trace))
    finally:
        _reset(examiner)
    return Result(case, "pass")


def _reset(examiner: Examiner) -> None:
    """Reset; a device that sends no boot-up is judged by the cases that ask for it.

    A transfer that a failed case left open is aborted: not every device drops it in a reset.
    """
    examiner.sdo_send(b"\x80\0\0\0" + AbortCode.GENERAL.to_bytes(4, "little"))
    try:
        examiner.reset()
    except Failure:
        examiner.settle()


def failed(results: Sequence[Result]) -> list[Result]:
    """Return the results of the cases that failed."""
    return [result for result in results if result.verdict == "fail"]
