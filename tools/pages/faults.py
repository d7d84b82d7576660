"""Fill docs/reference/faults.md from the fault matrix; --check fails when a row is another one.

    tools/pages/make faults [--check] [--hold CYCLES] [--log LOG --json ROWS]

A check holds each fault for 1000 cycles by default, a table is made with 10 000. Either
also fails if a watchdog trips in no row of a mode. LOG and ROWS are for
`python tests/fault_log.py`.

Example: tools/pages/make faults --check --hold 200
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path

import click
from pages import REFERENCE, differences, parser_of, renewed, write

from smarttac_can.assurance.trials.fault_cases import (
    ALL_NOT_SEEN,
    ALL_TOLERATED,
    CASES,
    DRIVING,
    NOT_SEEN,
    PREDICTED,
    TOLERATED,
    TRACKED,
    FaultCase,
    cases,
)
from smarttac_can.assurance.trials.fault_matrix import (
    HOLD_CYCLES,
    FaultRow,
    fault_matrix,
    reached_unseen,
    rows_as_json,
    tolerated,
)
from smarttac_can.canopen.bus.bus import LogHook
from smarttac_can.canopen.od.object_reference import table
from smarttac_can.host.log_file import CandumpWriter
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

CHECK_HOLD_CYCLES = 1000


def fields(
    rows: list[FaultRow], reached: dict[tuple[str, str], float]
) -> dict[str, str | Iterable[str]]:
    """Return the fields of the page."""
    ways = dict.fromkeys(way for _, way in reached)
    return {
        "hold_cycles": str(HOLD_CYCLES),
        "rows": matrix_table(rows),
        "passed": f"{sum(row.passed for row in rows)} of {len(rows)}",
        "digest": f"`{_digest(rows)}`",
        "instead": table(
            ("Fault", "Mode", "First", "Why that is right"),
            *(
                ("; ".join(names), *reason)
                for reason, names in _instead((*CASES, *PREDICTED)).items()
            ),
        ),
        "uncovered": (f"- **{case.name}**: {case.uncovered}." for case in CASES if case.uncovered),
        "tolerated": ", ".join(case.name for case in TOLERATED),
        "reached": table(
            ("Gain", *(way.replace("_", " ") for way in ways)),
            *(("; ".join(names), *um) for um, names in _alike(reached, ways).items()),
        ),
    }


def matrix_table(rows: Iterable[FaultRow]) -> Iterator[str]:
    """Return a line of Markdown for each fault, of all modes."""
    faults: dict[str, list[FaultRow]] = {}
    for row in rows:
        faults.setdefault(row.fault, []).append(row)
    return table(
        ("Fault", "Modes", "To 0 V", "Reached [um]", "EMCY"),
        *(
            (
                fault,
                str(len(runs)),
                _range(run.cycles_to_zero for run in runs)
                + ("" if all(run.covered for run in runs) else ", not covered"),
                f"{max(run.reached_um for run in runs):.2f}",
                ", ".join(dict.fromkeys(code for run in runs for code in run.emcy_codes)) or "none",
            )
            for fault, runs in faults.items()
        ),
    )


def _range(cycles: Iterable[int | None]) -> str:
    """Show the least and the most; a run that never came there is the most."""
    found = list(cycles)
    known = [cycle for cycle in found if cycle is not None]
    if len(known) < len(found):
        return "never"
    return " to ".join(map(str, sorted({min(known), max(known)})))


def _digest(rows: Iterable[FaultRow]) -> str:
    """Return the changes with any row as it is shown, in every mode."""
    shown = [
        (
            row.fault,
            row.mode,
            round(row.voltage_before_v),
            row.detection_bound_cycles,
            row.cycles_to_zero,
            f"{row.reached_um:.2f}",
            row.emcy_codes,
            row.state_after,
        )
        for row in rows
    ]
    return sha256(json.dumps(shown).encode()).hexdigest()


def _alike(
    reached: dict[tuple[str, str], float], ways: Iterable[str]
) -> dict[tuple[str, ...], list[str]]:
    """Return the faults that are not seen, with their largest effect in each mode."""
    found: dict[tuple[str, ...], list[str]] = {}
    for case in NOT_SEEN:
        um = tuple(_reached(reached, case.name, way) for way in ways)
        found.setdefault(um, []).append(case.name)
    return found


def _reached(reached: dict[tuple[str, str], float], name: str, way: str) -> str:
    um = reached.get((name, way))
    return "seen" if um is None else f"{um:.2f}"


def _ways(case: FaultCase) -> str:
    return ", ".join(case.way(mode).replace("_", " ") for mode in case.instead) or "every one"


def _instead(cases: Iterable[FaultCase]) -> dict[tuple[str, str, str], list[str]]:
    """Return the faults by modes, the watchdog that trips first, and why that is right."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for case in cases:
        if case.why:
            found.setdefault((_ways(case), _first(case), case.why), []).append(case.name)
    return found


def _first(case: FaultCase) -> str:
    """Name the watchdog that trips first, where it is not that of the name."""
    first = dict.fromkeys(case.instead.values() or [case.watchdog])
    return ", ".join(watchdog.name.lower().replace("_", " ") for watchdog in first if watchdog)


def undetected(rows: list[FaultRow]) -> list[str]:
    """Name the watchdogs whose emergency code is in no row of a mode.

    A fault of the matrix cannot have three of them: ticks are missed on a clock, a node that is
    bus-off sends nothing, and drives of the matrix that come late do so for less than their bound.
    """
    seen = {(row.mode, code) for row in rows for code in row.emcy_codes}
    return [
        f"{mode.name.lower()}: no row with {row.code:04X}h, {row.text}"
        for watchdog, row in WATCHDOGS.items()
        if watchdog not in (Watchdog.MISSED_TIME, Watchdog.BUS_OFF, Watchdog.UNSEEN)
        for mode in (TRACKED if watchdog is Watchdog.RESONANCE else DRIVING)
        if (mode.name.lower(), f"{row.code:04X}h") not in seen
    ]


def injected(hold: int, log_file: Path | None) -> list[FaultRow]:
    """Inject all faults, with their frames in a file if there is one."""
    chosen = cases()
    with ExitStack() as stack:
        log: LogHook | None = None
        if log_file is not None:
            log = CandumpWriter(stack.enter_context(log_file.open("w", encoding="ascii"))).write
        matrix = fault_matrix(chosen, hold=hold, log=log, jobs=os.cpu_count() or 1)
        bar = click.progressbar(matrix, length=len(chosen), label="faults", file=sys.stderr)
        return list(stack.enter_context(bar))


def main() -> int:
    """Write the page, or return 1 if it is stale or a fault does not end as it must."""
    parser = parser_of(__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--hold", type=int, help="cycles at 0 V under traffic")
    parser.add_argument("--log", type=Path, help="file for the frames around each fault")
    parser.add_argument("--json", type=Path, help="file for the rows")
    arguments = parser.parse_args()
    hold = arguments.hold
    if hold is None:
        hold = CHECK_HOLD_CYCLES if arguments.check else HOLD_CYCLES
    rows = injected(hold, arguments.log)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows_as_json(rows), indent=2), encoding="utf-8")
    bad = [f"{row.fault}, {row.mode}: does not end as it must" for row in rows if not row.passed]
    bad += undetected(rows)
    bad += [
        f"{case.name}, {case.way(mode)}: ends the run"
        for case, mode in ALL_TOLERATED
        if not tolerated(case, mode)
    ]
    unseen = {
        (case.name, case.way(mode)): reached_unseen(case, mode) for case, mode in ALL_NOT_SEEN
    }
    bad += [f"{name}, {way}: is seen" for (name, way), um in unseen.items() if not um]
    reached = {which: um or 0.0 for which, um in unseen.items()}
    made = renewed(REFERENCE / "faults.md", fields(rows, reached))
    if arguments.check:
        bad += differences(made)
    else:
        write(made)
    print("\n".join(bad) or f"{len(rows)} faults end as they must")
    return 1 if bad else 0
