"""What a user waits for, in processor time, each with its bound.

    tools/bench/measure waits [--repeats N] [--json]

Each is a process of its own, from its start to its end, with the package of this tree. Given are
the median processor time in s, user and system, of the process and of those that it starts, the
bound, and the real time, which is that of the machine on that day. The cache of compiled campaigns
is empty before the first campaign. The bounds are about three times of what a machine of 2
processors took on 2026-11-29, and 4 s for the second campaign. If one is exceeded, the exit code
is 1.

Example: tools/bench/measure waits --repeats 3
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, Final, NamedTuple

import click
import numpy as np
from harness import ROOT, parser_of, show

from smarttac_can.cli import FAMILIES

_FIXTURE: Final = """
def test_it(stimulator):
    assert stimulator.run(0.001).cof.size == 1
"""
_LINKS: Final = {"local link": "local", "two nodes": "bus"}


class Wait(NamedTuple):
    """A process that somebody waits for."""

    name: str
    arguments: Sequence[str]
    """Of Python."""
    bound_s: float
    """Most processor time in s."""


def waits() -> Iterator[Wait]:
    """Yield all of them."""
    yield _script("import smarttac_can.bench", "import smarttac_can.bench", 1.3)
    for name in sorted(name for family in FAMILIES.values() for name in family):
        yield _command(f"smarttac {name} --help", 2.0)
    yield _script("first sample", _run("bus", 0.001), 2.0)
    test = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "test_it.py")
    yield Wait("test with the fixture", test, 6.0)
    for name, link in _LINKS.items():
        yield _script(f"10 s simulated, {name}", _run(link, 10.0), 5.0)
        yield _script(f"10 s simulated, {name}, HDF5", _run(link, 10.0, "ten.h5"), 6.0)
    yield _command("smarttac demo", 50.0)
    yield _command("smarttac campaign --fingers 100", 95.0, "first campaign of 100 fingers")
    yield _command("smarttac campaign --fingers 100", 4.0, "second campaign of 100 fingers")


def _script(name: str, text: str, bound_s: float) -> Wait:
    return Wait(name, ("-c", text), bound_s)


def _command(line: str, bound_s: float, name: str = "") -> Wait:
    return Wait(name or line, ("-m", *line.replace("smarttac", "smarttac_can").split()), bound_s)


def _run(link: str, seconds: float, recording: str = "") -> str:
    block = f", bench.record({recording!r})" if recording else ""
    return (
        "from smarttac_can.bench import Stimulator\n"
        f"with Stimulator.simulate({link!r}) as bench{block}:\n"
        f"    bench.run({seconds})\n"
    )


def waited(wait: Wait, cache: Path) -> tuple[float, float]:
    """Run a process in a folder of its own; return its processor time and real time in s."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)}
    with TemporaryDirectory() as folder:
        Path(folder, "test_it.py").write_text(_FIXTURE, encoding="utf-8")
        before, begun = _used_s(), perf_counter()
        done = subprocess.run(
            [sys.executable, *wait.arguments],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        real, used = perf_counter() - begun, _used_s() - before
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip() or "it said nothing").splitlines()[-1]
        raise SystemExit(f"Error: {wait.name}: {said}")
    return used, real


def _used_s() -> float:
    """Return the processor time in s of all processes that were started and have ended."""
    usage = getrusage(RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def measured(every: Sequence[Wait], repeats: int) -> dict[str, Any]:
    """Run each so many times, and return its figures by name."""
    results = {}
    with (
        TemporaryDirectory() as cache,
        click.progressbar(every, label="waits", file=sys.stderr) as bar,
    ):
        for wait in bar:
            times = 1 if wait.name.startswith("first campaign") else repeats
            runs = [waited(wait, Path(cache)) for _ in range(times)]
            used, real = np.median(np.array(runs), axis=0).round(2).tolist()
            results[wait.name] = {"processor_s": used, "bound_s": wait.bound_s, "real_s": real}
    return results


def main() -> int:
    """Measure and print."""
    parser = parser_of(__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="runs of each (default 3)")
    arguments = parser.parse_args()
    if arguments.repeats < 1:
        parser.error(f"--repeats {arguments.repeats} is below 1")
    results = measured(list(waits()), arguments.repeats)
    show(results, as_json=arguments.json)
    late = [name for name, row in results.items() if row["processor_s"] > row["bound_s"]]
    for name in late:
        print(f"Error: {name} is above its bound", file=sys.stderr)
    return 1 if late else 0
