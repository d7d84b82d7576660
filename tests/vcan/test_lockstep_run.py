"""A run in lockstep, every party a process: the same bits as without a bus."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest
from processes import CHANNEL, PLATE_ID, NodeProcess

from smarttac_can.bench import Mode, Stimulator, Trace
from smarttac_can.bench.traces import sha256, write_csv

CYCLES = 2000


def friction_run(bench: Stimulator) -> Trace:
    """Tare, then hold two levels of friction under a stroking finger."""
    bench.finger.lift()
    bench.start_run()
    bench.tare()
    bench.finger.surroundings(seed=7)
    bench.finger.stroke(subject=2, force=0.5, speed=50)
    bench.start_run()
    bench.cof = (0.5, 0.35)
    bench.mode = Mode.FRICTION
    return bench.run(CYCLES * 1e-3)


@pytest.mark.parametrize("plate_inside", [False, True], ids=["plate-node", "plate-inside"])
def test_same_bits_as_in_one_process(plate_inside: bool, tmp_path: Path) -> None:
    with ExitStack() as stack:
        if plate_inside:
            stack.enter_context(NodeProcess("node"))
        else:
            stack.enter_context(NodeProcess("node", "--plate-node", str(PLATE_ID)))
            stack.enter_context(NodeProcess("plate"))
        with Stimulator.connect(
            interface="socketcan",
            channel=CHANNEL,
            plate_node_id=None if plate_inside else PLATE_ID,
            lockstep=True,
        ) as bench:
            trace = friction_run(bench)
    with Stimulator.simulate("local") as bench:
        expected = friction_run(bench)
    assert len(set(trace.cof.tolist())) > CYCLES // 10
    write_csv(tmp_path / "expected.csv", [expected])
    write_csv(tmp_path / "trace.csv", [trace])
    assert sha256(tmp_path / "trace.csv") == sha256(tmp_path / "expected.csv")
