"""The outcome of a run as text, JSON and Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from smarttac_can.conformance.case import Result
from smarttac_can.conformance.table import GROUPS

_SHORT = {"pass": "pass", "fail": "FAIL", "not applicable": "n/a"}


def line(result: Result) -> str:
    """Return the line of text that shows the result of one case."""
    reason = f": {result.reason}" if result.reason else ""
    return f"{_SHORT[result.verdict]:4}  {result.case.number:8}  {result.case.title}{reason}"


def summary(results: Sequence[Result]) -> str:
    """Return the numbers of cases by verdict as text."""
    counts = Counter(result.verdict for result in results)
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in _SHORT)


def as_json(results: Sequence[Result], device: str) -> dict[str, Any]:
    """Return the results as plain data for JSON."""
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
                "trace": list(result.trace),
            }
            for result in results
        ],
    }


def markdown(results: Sequence[Result], device: str) -> str:
    """Report with a line for each case, and the last frames of those that failed."""
    return "\n".join(_markdown(results, device))


def _markdown(results: Sequence[Result], device: str) -> Iterator[str]:
    yield f"# Conformance of {device}\n"
    yield f"{summary(results)}.\n"
    for group, title in GROUPS.items():
        chosen = [result for result in results if result.case.group == group]
        if not chosen:
            continue
        yield f"## {title}\n"
        yield "| Case | Title | Rule | Verdict | Reason |"
        yield "|---|---|---|---|---|"
        for case, verdict, reason, _ in chosen:
            cells = (case.number, case.title, case.rule, verdict, reason)
            yield f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
        yield ""
        for result in chosen:
            if result.trace:
                yield f"Last frames of {result.case.number}:\n"
                yield "```text"
                yield from result.trace
                yield "```\n"
