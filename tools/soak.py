"""Write docs/reference/soak.md from the report of a soak: smarttac soak --hours 24 --json FILE.

python tools/soak.py FILE
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from smarttac_can.od.object_reference import table
from smarttac_can.trials.soak import RSS_GROWTH_MIB, margin_rows

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "soak.md"


def page(report: dict[str, Any]) -> str:
    """Return the page."""
    hours = report["simulated_s"] / 3600.0
    driven = sum(report["driving_s"].values())
    sizes = report["rss_mib"]
    rows = [
        ("Seed", str(report["seed"])),
        ("Simulated time", f"{hours:.2f} h"),
        ("Speed", f"{report['speed']:.0f} times real time on one core"),
        ("Runs", f"{report['runs']}, {driven / 60.0:.0f} min of them with a voltage"),
        (
            "Faults while driving",
            f"{sum(report['faults'].values())} of {len(report['faults'])} kinds",
        ),
        ("Latched until reset", str(report["latched"])),
        ("Faults that must not end a run", str(sum(report["tolerated"].values()))),
        *(
            (f"Runs ended by set-points at random: {cause}", str(count))
            for cause, count in report["tripped"].items()
        ),
        ("Emergency messages", str(report["emergencies"])),
        ("Restarts of the master", str(report["master_restarts"])),
        ("Acts of the master at random", str(report["transfers"])),
        (
            "Size of the process",
            f"{sizes[0]} MiB after a minute, {max(sizes)} MiB at most" if sizes else "",
        ),
        ("Fingerprint", f"`{report['fingerprint']}`"),
        ("**Violated invariants**", f"**{report['violated']}**"),
    ]
    lines = [
        "# Soak",
        "",
        f"`smarttac soak --hours {hours:.3g} --seed {report['seed']}`; this page is made of its "
        "`--json` by `tools/soak.py`.",
        "",
        *table(("", "Result"), *rows),
        "## What is checked in every cycle",
        "",
        "- The power stage is between 0 V and the voltage limit, and so is what is asked of it.",
        "- The vibration is not above its limit for longer than its watchdog takes and the plate "
        "rings.",
        "- Outside of RUNNING the power stage is at 0 V, five cycles later at the latest.",
        "- Vibration, temperature and forces of the plate are finite.",
        "- Every object is inside its limits, four in each cycle in turn.",
        "",
        "After each fault: 0 V within the bound and a cycle, and it can be recovered from. A run "
        "without a fault does not end in one, but for set-points at random that ask for too much: "
        "then the vibration of the plate itself, not its reading, was above the limit, or beyond "
        "the range of the pick-up, in as many of the last cycles as its watch needs. The error "
        "histories hold the emergency messages that were on the bus. In each part of at most an "
        "hour, after two minutes, the process grows by less than "
        f"{RSS_GROWTH_MIB:g} MiB.",
        "",
        "Faults that need a prepared run, a broken controller or the plate inside are only in the "
        "[fault matrix](faults.md).",
        "",
        "## Margins",
        "",
        "How near each watch came to a fault, 1.00, in all cycles of running in which nothing was "
        "broken, none of what the bus must bear had begun, and nothing recovered; runs that "
        "set-points at random ended are left out. A watch that counts cycles stands at 0 until the "
        "first is faulty. The voltage reaches its limit because the controllers keep to it: only "
        "more is a fault. Times are those at the end of a tick, before the frame that ends them.",
        "",
        *table(*margin_rows(report["margins"])),
        "## Seconds with a voltage",
        "",
        *table(
            ("Mode", "s"),
            *((mode.replace("_", " "), f"{s:.0f}") for mode, s in report["driving_s"].items()),
        ),
        "Each run draws its laws, and draws them anew with its set-points, while it drives. A "
        "friction law acts in the modes friction and texture, a vibration law in these two and "
        "in those of the amplitude.",
        "",
        *table(
            ("Law", "s"),
            *((f"friction: {law}", f"{s:.0f}") for law, s in report["friction_law_s"].items()),
            *((f"vibration: {law}", f"{s:.0f}") for law, s in report["vibration_law_s"].items()),
        ),
        "## Faults",
        "",
        *table(("Fault", "Times"), *((name, str(n)) for name, n in report["faults"].items())),
        *(f"- {line}" for line in report["violations"]),
    ]
    return "\n".join(lines).rstrip() + "\n"


def main() -> int:
    """Write the page; return 1 if an invariant was violated."""
    if len(sys.argv) != 2:
        print(__doc__)
        return 2
    report = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    PAGE.write_text(page(report), encoding="utf-8")
    return 1 if report["violated"] else 0


if __name__ == "__main__":
    sys.exit(main())
