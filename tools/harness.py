"""What the measuring tools share: a loop that regulates, runs of two trees by turns, and ratios.

It names nothing of the package but what lab scripts import, so a tool may measure an older tree.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
import numpy as np

if TYPE_CHECKING:
    from smarttac_can.bench import Stimulator

ROOT: Final = Path(__file__).resolve().parent.parent
PACKAGE: Final = "smarttac_can"
COF: Final = 0.35
COF_BOUND: Final = 0.05
"""Deviation of the median COF from the reference at most, as a share of it."""
SETTLING_S: Final = 0.7
"""Touch-down included; the finger turns for the first time after 1.5 s of sliding."""
DRAWS: Final = 10_000
"""Of the pairs, for the range of a ratio."""


def parser_of(text: str | None) -> argparse.ArgumentParser:
    """Return a parser with what all measuring tools have; the text is that of the tool."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def add_against(parser: argparse.ArgumentParser, pairs: int) -> None:
    """Add the options of a comparison with another tree."""
    parser.add_argument("--against", type=Path, metavar="TREE", help="another working tree")
    parser.add_argument(
        "--pairs", type=int, help=f"runs of each tree with --against (default {pairs})"
    )
    parser.set_defaults(default_pairs=pairs)


def pairs_of(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> int:
    """Return how many pairs are asked for; a usage error if that makes no sense."""
    if arguments.pairs is None:
        return int(arguments.default_pairs)
    if arguments.against is None:
        parser.error("--pairs needs --against")
    if arguments.pairs < 1:
        parser.error(f"--pairs {arguments.pairs} is below 1")
    return int(arguments.pairs)


def tree_of(parser: argparse.ArgumentParser, tree: Path) -> Path:
    """Return the path of a tree; a usage error if it has no package."""
    if not (tree / PACKAGE).is_dir():
        parser.error(f"{tree} is no working tree with a package {PACKAGE}")
    return tree.resolve()


@contextmanager
def regulating(link: Any, *, plate_inside: bool, tree: Path | None = None) -> Iterator[Stimulator]:
    """Regulate friction under a sliding finger, with all watchdogs, until the block ends.

    Raises
    ------
    SystemExit
        If the package is not that of the tree.
    """
    # Only the package of the tree that this process is for.
    import smarttac_can.bench  # noqa: PLC0415
    from smarttac_can.bench import Mode, Stimulator  # noqa: PLC0415

    file = Path(smarttac_can.bench.__file__).resolve()
    if tree is not None and not file.is_relative_to(tree):
        raise SystemExit(f"the package comes from {file}")
    with Stimulator.simulate(link, plate_inside=plate_inside) as bench:
        bench.finger.stroke(2, speed=20.0, travel=30.0)
        bench.start_run()
        bench.tare()
        bench.amplitude, bench.cof = 1.0, COF
        bench.mode = Mode.FRICTION
        bench.run(SETTLING_S)
        yield bench


def require_friction(bench: Stimulator, cof: float) -> None:
    """Raise SystemExit unless friction is regulated under a finger, to a median COF."""
    from smarttac_can.bench import Mode, State  # noqa: PLC0415

    state, mode = bench.state, Mode(int(bench.get("Mode display")))
    touching = bench.get("Contact.Touching") > 0
    near = abs(cof - COF) <= COF_BOUND * COF
    if state is not State.RUNNING or mode is not Mode.FRICTION or not touching or not near:
        raise SystemExit(
            f"state {state.name}, mode {mode.name}, {'a' if touching else 'no'} finger, "
            f"COF {cof:.3f}: friction is not regulated to {COF} within {COF_BOUND:.0%}"
        )


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


def by_turns(
    other: Callable[[], Any], here: Callable[[], Any], pairs: int
) -> tuple[list[Any], list[Any]]:
    """Run two by turns, and return what each gave; every second pair starts with the other."""
    of_other: list[Any] = []
    of_here: list[Any] = []
    with click.progressbar(range(pairs), label="pairs", file=sys.stderr) as bar:
        for pair in bar:
            turns = [(here, of_here), (other, of_other)]
            for run, results in reversed(turns) if pair % 2 else turns:
                results.append(run())
    return of_other, of_here


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
