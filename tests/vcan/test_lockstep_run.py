"""A run in lockstep, every party a process: the same bits as without a bus, and as candump saw."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from eds_decoder import EdsDecoder
from processes import CHANNEL, PLATE_ID, NodeProcess, candump, logged_frames

from smarttac_can.bench import Mode, Stimulator, Trace
from smarttac_can.bench.link import RECORDED
from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.bench.traces import sha256, write_csv
from smarttac_can.od.cia import SYNC_ID

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


def rows(trace: Trace) -> list[tuple[int, ...]]:
    """Integers of the wire, without the statusword, which is sent on a change."""
    return list(map(tuple, trace.counts[:, :-1].tolist()))


@dataclass
class Run:
    plate_inside: bool
    trace: Trace
    frames: list[tuple[int, bytes]]
    said: dict[str, list[str]]
    statuses: list[int]


@pytest.fixture(scope="module", params=[False, True], ids=["plate-node", "plate-inside"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    plate_inside = request.param
    log = tmp_path_factory.mktemp("log") / "candump.log"
    with ExitStack() as stack:
        stack.enter_context(candump(log))
        commands = {"node": () if plate_inside else ("--plate-node", str(PLATE_ID))}
        if not plate_inside:
            commands["plate"] = ()
        nodes = {
            name: stack.enter_context(NodeProcess(name, *options))
            for name, options in commands.items()
        }
        with Stimulator.connect(
            interface="socketcan",
            channel=CHANNEL,
            plate_node_id=None if plate_inside else PLATE_ID,
            lockstep=True,
        ) as bench:
            trace = friction_run(bench)
        statuses = [node.terminate() for node in nodes.values()]
    said = {name: node.said for name, node in nodes.items()}
    yield Run(plate_inside, trace, logged_frames(log), said, statuses)


def test_every_cycle_was_recorded_and_controlled(run: Run) -> None:
    assert len(run.trace) == CYCLES
    assert len(set(run.trace.voltage_v.tolist())) > CYCLES // 10
    assert len(set(run.trace.cof.tolist())) > CYCLES // 10


@pytest.mark.parametrize("link", ["bus", "local"])
def test_same_bits_as_in_one_process(run: Run, link: str, tmp_path: Path) -> None:
    inside = run.plate_inside or link == "local"
    with Stimulator.simulate(link, plate_inside=inside) as bench:  # type: ignore[arg-type]
        expected = friction_run(bench)
    write_csv(tmp_path / "expected.csv", [expected])
    write_csv(tmp_path / "trace.csv", [run.trace])
    assert sha256(tmp_path / "trace.csv") == sha256(tmp_path / "expected.csv")


def test_candump_log_decoded_by_the_eds_alone_is_the_trace(run: Run) -> None:
    stimulator = EdsDecoder("stimulator.eds", STIMULATOR_ID, "tpdo")
    cycles: list[dict[str, int]] = []
    for can_id, data in run.frames:
        if can_id == SYNC_ID:
            cycles.append({})
        elif cycles:
            for name, raw in stimulator.values(can_id, data).items():
                cycles[-1].setdefault(name, raw)
    names = RECORDED[:-1]
    decoded = [tuple(cycle.get(name) for name in names) for cycle in cycles[-CYCLES:]]
    assert decoded == rows(run.trace)


def test_measurements_and_drives_of_every_cycle_are_on_the_bus(run: Run) -> None:
    plate = EdsDecoder("plate.eds", PLATE_ID, "tpdo")
    drive = EdsDecoder("plate.eds", PLATE_ID, "rpdo")
    measured = [values for frame in run.frames if (values := plate.values(*frame))]
    driven = [values for frame in run.frames if (values := drive.values(*frame))]
    if run.plate_inside:
        assert not measured and not driven
        return
    voltages = [values["Drive.Voltage"] for values in driven]
    assert len(measured) >= 3 * CYCLES
    # Each drive is that of the trace's row; the last ones are 0 V: mode off, shutdown.
    start = len(voltages) - next(i for i, V in enumerate(reversed(voltages)) if V) - CYCLES
    assert voltages[start : start + CYCLES] == np.rint(run.trace.voltage_v * 100).tolist()
    assert voltages[-1] == 0


def test_sigterm_ends_every_process_at_0_v(run: Run) -> None:
    assert run.statuses == [0] * len(run.statuses)
    for said in run.said.values():
        assert said[-1].endswith(" stopped at 0 V")
