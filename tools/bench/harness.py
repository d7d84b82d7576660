"""Common parts of measuring tools: options, a bus, runs of two trees by turns, ratios, printing.

It names nothing of the package, so a tool may measure an older tree.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NoReturn

import click
import numpy as np

ROOT: Final = Path(__file__).resolve().parents[2]
DRAWS: Final = 10_000
"""Of the pairs, for the range of a ratio."""
_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def parser_of(text: str | None, *, realtime: bool = False) -> argparse.ArgumentParser:
    """Return a parser with the options of all measuring tools; the text is that of the tool."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    if realtime:
        parser.add_argument("--realtime", type=int, help="SCHED_FIFO priority of the nodes, 1..99")
    return parser


def add_against(parser: argparse.ArgumentParser, pairs: int) -> None:
    """Add the options of a comparison with another tree."""
    parser.add_argument("--against", type=Path, metavar="TREE", help="another working tree")
    parser.add_argument(
        "--pairs", type=int, default=pairs, help=f"runs of each tree (default {pairs})"
    )


def tree_of(parser: argparse.ArgumentParser, arguments: argparse.Namespace, file: str) -> Path:
    """Return the path of the other tree; a usage error if it has no such file, or no pairs."""
    tree: Path = arguments.against.resolve()
    if arguments.pairs < 1:
        parser.error(f"--pairs {arguments.pairs} is below 1")
    if not (tree / file).exists():
        parser.error(f"--against {arguments.against} has no {file}")
    return tree


def own_bus(channel: str) -> dict[str, Any]:
    """Return the options of a bus on this computer; those of two runs at once are two."""
    return {
        "interface": "udp_multicast",
        "channel": channel,
        "port": 40000 + os.getpid() % 20000,
        "hop_limit": 0,  # frames of plain python-can stay on this computer as well
    }


def finished(measure: Callable[[], int], *errors: type[Exception]) -> int:
    """Measure, and return the exit code: 1 for a failed measurement, with the reason.

    A signal ends all processes that the tool has begun, and itself by 128 and the signal.
    """

    def leave(number: int, _frame: object) -> NoReturn:
        for ending in _ENDING:
            signal.signal(ending, signal.SIG_IGN)
        sys.exit(128 + number)

    for ending in _ENDING:
        signal.signal(ending, leave)
    try:
        return measure()
    except errors as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1


def results_in(tree: Path, tool: str | Path, *arguments: str) -> Any:
    """Run a tool with the package of a tree, and return its JSON; SystemExit if it fails."""
    done = subprocess.run(
        [sys.executable, str(tool), *arguments],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        reason = (done.stderr.strip() or "it said nothing").splitlines()[-1]
        raise SystemExit(f"Error: {tree}: {tool} {' '.join(arguments)}: {reason}")
    return json.loads(done.stdout)


def by_turns(runs: Sequence[Callable[[], Any]], turns: int) -> list[list[Any]]:
    """Run each once a turn, in reverse every second turn, and return the results of each."""
    results: list[list[Any]] = [[] for _ in runs]
    with click.progressbar(range(turns), label="turns", file=sys.stderr) as bar:
        for turn in bar:
            order = list(zip(runs, results, strict=True))
            for run, found in reversed(order) if turn % 2 else order:
                found.append(run())
    return results


def compared(
    other: list[float], here: list[float], average: Callable[..., Any] = np.mean
) -> dict[str, Any]:
    """Return the average of a figure in pairs of runs, and its ratio where that can be told.

    The ratio is that of this tree by the other. Its range holds 95 % of the ratios of pairs that
    are drawn anew, and is left out where a draw of the other tree has an average of 0.
    """
    before, now = np.array(other), np.array(here)
    found: dict[str, Any] = {
        "other": round(float(average(before)), 2),
        "here": round(float(average(now)), 2),
    }
    draws = np.random.default_rng(1).integers(len(now), size=(DRAWS, len(now)))
    drawn = average(before[draws], axis=1)
    if drawn.all():
        interval = np.percentile(average(now[draws], axis=1) / drawn, (2.5, 97.5))
        found["ratio"] = round(float(average(now) / average(before)), 3)
        found["range"] = interval.round(3).tolist()
    return found


def show(results: dict[str, Any], *, as_json: bool) -> None:
    """Print results as JSON, or for people."""
    if as_json:
        print(json.dumps(results, indent=2))
        return
    for key, value in results.items():
        first, *others = map(_line, value) if isinstance(value, list) and value else [_line(value)]
        print(f"{key:<40}{first}", *(f"{'':<40}{line}" for line in others), sep="\n")


def _line(value: Any) -> str:
    if isinstance(value, dict):
        return "  ".join(f"{name} {item}" for name, item in value.items())
    return str(value)
