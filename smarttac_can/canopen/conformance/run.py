"""All cases in their order: run them, and report the results as text, JSON and Markdown."""

from __future__ import annotations

import tomllib
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import ceil
from typing import Any, Final
from xml.etree import ElementTree

from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.bus.node import Node
from smarttac_can.canopen.conformance import (
    dictionary,
    emcy,
    error_control,
    general,
    nmt,
    pdo,
    sdo,
    sync,
)
from smarttac_can.canopen.conformance.case import Case, Failure, NotApplicable, Result
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.object_reference import table

_SHOWN: Final = 3
_STEP_US: Final = 1000
"""Time in us that passes between two checks for frames."""


class DeviceTimeBus:
    """The examiner's connection to a local bus; waiting here advances the time of the device.

    Parameters
    ----------
    node
        Node to examine. It is powered on at once; its boot-up message is the first frame.
    """

    def __init__(self, node: Node) -> None:
        self._frames: deque[Frame] = deque()
        self._bus = LocalBus()
        self._port = self._bus.connect(self._frames.append)
        self._bus.attach(node, lockstep=False)

    def time(self) -> float:
        """Return the device time in s, as the clock of `Examiner`."""
        return self._bus.time * 1e-6

    def send(self, frame: Frame) -> None:
        """Send a frame to the device; its answers wait for `receive`."""
        self._port.send(frame)

    def receive(self, timeout: float) -> Frame | None:
        """Return the next frame; advance time in steps of 1 ms until there is one."""
        end = self._bus.time + ceil(timeout * 1e6)  # round up, so that every wait advances the time
        while not self._frames:
            left = end - self._bus.time
            if left <= 0:
                return None
            self._bus.advance(min(_STEP_US, left))
        return self._frames.popleft()

    def close(self) -> None:
        """Switch the device off."""
        self._bus.shutdown()


GROUPS: Final = {
    "EDS": "EDS file",
    "SDO": "SDO server",
    "PDO": "Process data",
    "OD": "Object dictionary",
    "EMCY": "Emergency",
    "SYNC": "Synchronisation",
    "GUARD": "Node and life guarding",
    "HB": "Heartbeat",
    "BOTH": "Guarding and heartbeat together",
    "OTHER": "Identity, storage, error behaviour, CAN-IDs",
    "STATE": "NMT states",
    "TRANS": "NMT transitions",
}
"""Titles of the groups, by the first part of a case's number."""

_MODULES = (sdo, pdo, dictionary, emcy, sync, error_control, general, nmt)
_ORDER = list(GROUPS)

CASES: Final = tuple(
    sorted(
        (c for module in _MODULES for c in vars(module).values() if isinstance(c, Case)),
        key=lambda c: (_ORDER.index(c.group), c.number),
    )
)


def run_cases(
    examiner: Examiner, cases: Iterable[Case], on_result: Callable[[Result], None] | None = None
) -> list[Result]:
    """Examine a device, which is reset before each case and at the end.

    Parameters
    ----------
    on_result
        Function that is called with each result immediately.

    Raises
    ------
    BusError
        The bus carries no more frames.
    """
    results = []
    try:
        for case in cases:
            result = _run(examiner, case)
            results.append(result)
            if on_result is not None:
                on_result(result)
    finally:
        _reset(examiner)
    return results


def _run(examiner: Examiner, case: Case) -> Result:
    for need in case.needs:
        reason = need(examiner.sheet)
        if reason is not None:
            return Result(case, "not applicable", reason)
    _reset(examiner)
    examiner.trace.clear()
    examiner.remarks.clear()
    try:
        case.check(examiner)
    except NotApplicable as refusal:
        return Result(case, "not applicable", str(refusal))
    except (Failure, Abort) as failure:
        return Result(
            case, "fail", str(failure), tuple(examiner.trace), remarks=tuple(examiner.remarks)
        )
    return Result(case, "pass", remarks=tuple(examiner.remarks))


def _reset(examiner: Examiner) -> None:
    """Reset the device. The cases that require a boot-up judge a device that sends none.

    A transfer that a failed case left open is aborted, as not every device drops it in a reset.
    """
    examiner.abort_transfer()
    try:
        examiner.reset()
    except Failure:
        examiner.settle()


def failed(results: Sequence[Result]) -> list[Result]:
    """Return the results of the cases that failed."""
    return [result for result in results if result.verdict == "fail"]


def known_deviations(text: str) -> dict[str, str]:
    """Read a file of known deviations, TOML: a reason for each case that may fail.

    ::

        PDO-28 = "firmware 1.2 maps more than 64 bits; the maker knows"

    Raises
    ------
    ValueError
        It is no TOML, or a line has no case of this suite or no reason.
    """
    known = tomllib.loads(text)
    numbers = {case.number for case in CASES}
    for number, reason in known.items():
        if number not in numbers:
            raise ValueError(f"{number!r} is no case: cases are such as {CASES[0].number}")
        if not isinstance(reason, str) or not reason.strip():
            raise ValueError(f"{number} has no reason: write why the device deviates, as a text")
    return known


def unexpected(results: Sequence[Result], known: Mapping[str, str]) -> list[str]:
    """Return a line for each case that is not as expected: an unknown failure, or a known one gone.

    A known deviation that passes is told, so that the file does not outlive the fault.
    """
    lines = [
        f"{result.case.number} fails, and is no known deviation"
        for result in failed(results)
        if result.case.number not in known
    ]
    return lines + [
        f"{result.case.number} passes: remove it from the known deviations"
        for result in results
        if result.verdict == "pass" and result.case.number in known
    ]


def junit(results: Sequence[Result], device: str, known: Mapping[str, str]) -> str:
    """Return the results as JUnit XML, which CI services show.

    A known deviation is skipped with its reason, as a case that is not applicable; one that passes
    is a failure.
    """
    suite = ElementTree.Element("testsuite", name=f"conform {device}", tests=str(len(results)))
    counts = Counter[str]()
    for result in results:
        number = result.case.number
        case = ElementTree.SubElement(
            suite, "testcase", classname=result.case.group, name=f"{number} {result.case.title}"
        )
        found = "; ".join(_found(result))
        if result.verdict == "fail" and number not in known:
            counts["failures"] += 1
            failure = ElementTree.SubElement(case, "failure", message=_xml(found))
            failure.text = _xml("\n".join([result.case.rule, *result.trace]))
        elif result.verdict == "pass" and number in known:
            counts["failures"] += 1
            ElementTree.SubElement(case, "failure", message="passes, and is a known deviation")
        elif result.verdict != "pass":
            counts["skipped"] += 1
            reason = f"known deviation: {known[number]}" if result.verdict == "fail" else found
            ElementTree.SubElement(case, "skipped", message=_xml(reason))
    for name in ("failures", "skipped"):
        suite.set(name, str(counts[name]))
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _xml(text: str) -> str:
    """Return a text without the control characters that XML cannot have."""
    return "".join(char if char.isprintable() or char in "\n\t" else "?" for char in text)


_SHORT = {"pass": "pass", "fail": "FAIL", "not applicable": "n/a"}


def line(result: Result) -> str:
    """Return the line of text with the result of one case."""
    found = "; ".join(_found(result))
    return f"{_SHORT[result.verdict]:4}  {result.case.number:8}  {result.case.title}" + (
        f": {found}" if found else ""
    )


def _found(result: Result) -> Iterator[str]:
    """Yield the reason for a verdict, and the first few remarks."""
    if result.reason:
        yield result.reason
    yield from (f"remark: {remark}" for remark in result.remarks[:_SHOWN])
    if len(result.remarks) > _SHOWN:
        yield f"{len(result.remarks) - _SHOWN} more remarks"


def summary(results: Sequence[Result]) -> str:
    """Return a text with the number of cases for each verdict, and of those with a remark."""
    counts = Counter(result.verdict for result in results)
    text = ", ".join(f"{counts[verdict]} {verdict}" for verdict in _SHORT)
    remarked = sum(bool(result.remarks) for result in results)
    return text + (f"; {remarked} with a remark" if remarked else "")


def as_json(results: Sequence[Result], device: str) -> dict[str, Any]:
    """Return the results as JSON values."""
    return {
        "device": device,
        "counts": Counter(result.verdict for result in results),
        "cases": [
            {
                "id": result.case.number,
                "title": result.case.title,
                "rule": result.case.rule,
                "verdict": result.verdict,
                "reason": result.reason,
                "remarks": list(result.remarks),
                "trace": list(result.trace),
            }
            for result in results
        ],
    }


def markdown(results: Sequence[Result], device: str) -> str:
    """Return a report with a line for each case, and the last frames of failed cases."""
    return "\n".join(_markdown(results, device))


def _markdown(results: Sequence[Result], device: str) -> Iterator[str]:
    yield f"# Conformance of {device}\n"
    yield f"{summary(results)}.\n"
    for group, title in GROUPS.items():
        chosen = [result for result in results if result.case.group == group]
        if not chosen:
            continue
        yield f"## {title}\n"
        rows = [
            (r.case.number, r.case.title, r.case.rule, r.verdict, "; ".join(_found(r)))
            for r in chosen
        ]
        yield from table(("Case", "Title", "Rule", "Verdict", "Reason"), *rows)
        for result in chosen:
            if result.trace:
                yield f"Last frames of {result.case.number}:\n"
                yield "```text"
                yield from result.trace
                yield "```\n"
