"""The cost of a cycle of the loop, against real time or against another tree.

    tools/bench/measure cycle [--against TREE] [--pairs N] [--ticks N] [--json]

The loop regulates friction under a sliding finger, with the default mappings and all watchdogs, on
the local link and over the bus with two nodes. On the local link it runs in a row, and once a
millisecond as in real time, where a cycle finds the caches cold. Each run is a process of its own.
Given are the median processor time of a recorded cycle in us, and how many times real time that is.
The median COF has to be within 5 % of its reference; if not, the exit code is 1.

With `--against`, this tree and the other one run by turns; every second pair starts with the other
tree. TREE is a working tree, such as `git worktree add` makes of a commit, or a folder with the
compiled package. Given are both costs, their ratio (this tree / other tree), and its 95 % bootstrap
interval. The exit code is 1 as well if the trees do not record the same: the SHA-256 of their
traces is compared, too.

Example: tools/bench/measure cycle --against ../before --pairs 7
"""

from __future__ import annotations

import argparse
import json
from functools import partial
from hashlib import sha256
from pathlib import Path
from time import perf_counter, process_time, sleep
from typing import Any

import numpy as np
from harness import ROOT, add_against, by_turns, compared, parser_of, results_in, show, tree_of

import smarttac_can.bench
from smarttac_can.bench import Mode, State, Stimulator

LINKS = {
    "local link": "local",
    "local link, once a millisecond": "paced",
    "two nodes over the bus in the process": "bus",
}
COF = 0.35
COF_BOUND = 0.05
"""Deviation of the median COF from the reference at most, as a share of it."""
SETTLING_S = 0.7
"""Touch-down included; the finger turns for the first time after 1.5 s of sliding."""


def recorded(link: Any, ticks: int) -> dict[str, Any]:
    """Record friction; return us of a cycle, and the SHA-256 of the trace."""
    file = Path(smarttac_can.bench.__file__).resolve()
    if not file.is_relative_to(Path.cwd()):
        raise SystemExit(f"the package comes from {file}")
    plate_inside = link != "bus"
    with Stimulator.simulate("local" if plate_inside else link, plate_inside=plate_inside) as bench:
        bench.finger.stroke(2, speed=20.0, travel=30.0)
        bench.start_run()
        bench.tare()
        bench.amplitude, bench.cof = 1.0, COF
        bench.mode = Mode.FRICTION
        bench.run(SETTLING_S)
        begun = perf_counter()

        def pace(cycles: int) -> None:
            if link == "paced":
                sleep(max(0.0, begun + 1e-3 * cycles - perf_counter()))

        start = process_time()
        trace = bench.run(ticks * 1e-3, meanwhile=pace)
        us = (process_time() - start) * 1e6 / ticks
        require_friction(bench, float(np.median(trace.cof)))
    # Arrays and not a file: its format may be another in the other tree.
    columns = np.stack((trace.cof, trace.amplitude_um, trace.voltage_v, trace.frequency_hz))
    return {"us": us, "sha256": sha256(np.round(columns, 4).tobytes()).hexdigest()}


def require_friction(bench: Stimulator, cof: float) -> None:
    """Raise SystemExit unless friction is regulated under a finger, to a median COF."""
    state, mode = bench.state, Mode(int(bench.get("Mode display")))
    touching = bench.get("Contact.Touching") > 0
    near = abs(cof - COF) <= COF_BOUND * COF
    if state is not State.RUNNING or mode is not Mode.FRICTION or not touching or not near:
        raise SystemExit(
            f"state {state.name}, mode {mode.name}, {'a' if touching else 'no'} finger, "
            f"COF {cof:.3f}: friction is not regulated to {COF} within {COF_BOUND:.0%}"
        )


def measured(link: str, trees: list[Path], ticks: int, pairs: int) -> dict[str, Any]:
    """Run this tree, and another one if there is one, by turns; return their costs.

    Raises
    ------
    SystemExit
        If one does not regulate, or the trees record different traces.
    """
    options = ("--one", link, "--ticks", str(ticks))
    runs = by_turns([partial(results_in, tree, __file__, *options) for tree in trees], pairs)
    hashes = {run["sha256"] for of_tree in runs for run in of_tree}
    if len(hashes) != 1:
        raise SystemExit(f"{link}: the trees record different traces: {', '.join(sorted(hashes))}")
    here, *others = ([run["us"] for run in of_tree] for of_tree in runs)
    us = round(float(np.median(here)), 2)
    found = compared(others[0], here, np.median) if others else {"here": us}
    return found | {"real_time": round(1e3 / us, 1), "trace_sha256": hashes.pop()}


def main() -> None:
    """Measure and print."""
    parser = parser_of(__doc__)
    parser.add_argument("--ticks", type=int, default=2000, help="cycles a run (default 2000)")
    add_against(parser, 7)
    parser.add_argument("--one", choices=LINKS.values(), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if min(arguments.ticks, arguments.pairs) < 1:
        parser.error("--ticks and --pairs have to be 1 or more")
    if arguments.one:
        print(json.dumps(recorded(arguments.one, arguments.ticks)))
        return
    trees = [ROOT]
    if arguments.against is not None:
        trees.append(tree_of(parser, arguments, "smarttac_can"))
    results = {
        name: measured(link, trees, arguments.ticks, arguments.pairs)
        for name, link in LINKS.items()
    }
    show(results, as_json=arguments.json)


if __name__ == "__main__":  # with --one, in another tree
    main()
