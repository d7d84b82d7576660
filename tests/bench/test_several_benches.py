"""Several benches on one stimulator in real time: none costs another one a row."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from nodes_on_a_bus import (
    BENCH_WATCH,
    GUARD_S,
    in_threads,
    stimulator_with_plate,
    until,
    watched,
)

from smarttac_can.bench import BenchError, NotRunningError, State, Stimulator, can_link, selftest
from smarttac_can.bench.calibration import mean_gauges
from smarttac_can.bench.remote_device import bench_id
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode


@pytest.fixture
def node(virtual: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> Iterator[StimulatorNode]:
    # How soon a thread of the other bench gets its turn is the machine's business.
    monkeypatch.setattr(can_link, "_ANSWERED_S", 4.0)
    made = stimulator_with_plate(lockstep=False)
    with in_threads(virtual, made, lockstep=False):
        yield made


def nobody_answers() -> None:
    """Wait for no answer to the question of the bench that ends next, the last one."""
    can_link._ANSWERED_S = 0.0  # type: ignore[misc]


def connect(virtual: dict[str, Any]) -> Stimulator:
    return Stimulator.connect(**virtual, timeout=GUARD_S)


def types(node: StimulatorNode) -> list[int]:
    return [node.od.entry(0x1800 + number, 2).value for number in range(4)]


def weigh(bench: Stimulator) -> None:
    for _ in range(3):
        mean_gauges(bench)


def run_often(bench: Stimulator) -> None:
    for _ in range(20):
        bench.run(0.001)


@pytest.mark.parametrize("act", [weigh, run_often])
def test_a_recording_loses_no_row_to_another_bench(
    virtual: dict[str, Any], node: StimulatorNode, act: Any, tmp_path: Path
) -> None:
    node.od["Finger.Motion"].value = 0
    with (
        connect(virtual) as reader,
        reader.record(tmp_path / "run.h5") as recording,
        connect(virtual) as other,
    ):
        until(lambda: recording.cycles > 100)
        with suppress(BenchError):  # on a machine that is busy
            act(other)
        before = recording.cycles
        until(lambda: recording.cycles > before + 100)
        assert types(node) == [255, 254, 254, 254]
        nobody_answers()
    assert recording.summary is not None
    assert (recording.summary.lost, recording.summary.gaps) == (0, 0)
    assert types(node) == [255] * 4


def test_a_recording_that_ends_costs_a_run_no_row(
    virtual: dict[str, Any], node: StimulatorNode, tmp_path: Path
) -> None:
    ended = threading.Event()
    with connect(virtual) as reader, connect(virtual) as other:

        def record() -> None:
            for number in range(3):
                with reader.record(tmp_path / f"{number}.h5") as recording:
                    until(lambda: recording.cycles > 100)
            ended.set()

        with ThreadPoolExecutor(1) as pool:
            traces = []
            recorded = pool.submit(record)
            while not ended.is_set():
                assert not recorded.done() or recorded.exception() is None
                with suppress(NotRunningError):  # on a machine that is busy
                    traces.append(other.run(0.5))
    assert [trace.lost for trace in traces] == [0] * len(traces)
    assert types(node) == [255] * 4


def test_last_bench_restores_the_transmission_types(
    virtual: dict[str, Any],
    node: StimulatorNode,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whether it began first or last, and whoever it was that asked."""
    with connect(virtual) as one, connect(virtual) as other:
        for first, last in ((one, other), (other, one)):
            outer, inner = first.record(tmp_path / "a.h5"), last.record(tmp_path / "b.h5")
            outer.__enter__()
            inner.__enter__()
            outer.__exit__(None, None, None)
            assert types(node) == [255, 254, 254, 254]
            with monkeypatch.context() as patch:
                patch.setattr(can_link, "_ANSWERED_S", 0.0)
                inner.__exit__(None, None, None)
            assert types(node) == [255] * 4
            for path in tmp_path.iterdir():
                path.unlink()


def test_bench_sets_types_anew_that_a_tool_put_back(
    virtual: dict[str, Any], node: StimulatorNode, tmp_path: Path
) -> None:
    with (
        connect(virtual) as reader,
        reader.record(tmp_path / "run.h5") as recording,
        connect(virtual) as tool,
    ):
        device = tool._link._stimulator  # type: ignore[attr-defined]
        for number in range(1, 4):
            device.write(device.od.entry(0x1800 + number, 2), 255)
        before = recording.cycles
        # By the event timers, 100 ms, this would take longer than the guard.
        until(lambda: recording.cycles > before + 1000)
        assert types(node) == [255, 254, 254, 254]
        nobody_answers()


def test_nobody_answers_for_a_bench_that_was_killed(
    virtual: dict[str, Any], node: StimulatorNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(can_link, "_ANSWERED_S", 0.0)
    for number in range(1, 4):
        node.od.entry(0x1800 + number, 2).value = 254
    with connect(virtual) as bench:
        bench.run(0.05)
        assert types(node) == [255] * 4


def test_a_bench_that_reads_leaves_run_and_watch_to_the_driver(
    virtual: dict[str, Any], node: StimulatorNode
) -> None:
    with connect(virtual) as bench:
        bench.run(0.3)
        bench.mode = "open_loop"
        with connect(virtual) as reader:
            assert watched(reader).count(BENCH_WATCH) == 1
        assert watched(bench).count(BENCH_WATCH) == 1
        assert bench.state is State.RUNNING, "the end of a bench that reads disarms nobody"
        bench.reset_fault()
        assert bench.state is State.RUNNING, "there is none to reset"


def test_a_second_driver_is_refused(virtual: dict[str, Any], node: StimulatorNode) -> None:
    refusal = "another bench script drives node 32: node 127, its heartbeat, is on the bus"
    with connect(virtual) as bench, connect(virtual) as second:
        bench.run(0.3)
        bench.mode = "open_loop"
        with pytest.raises(BenchError, match=refusal):
            second.mode = "friction"
        for act in (second.start_run, second.tare, second.reset_fault, lambda: selftest(second)):
            with pytest.raises(BenchError, match=refusal):
                act()
        assert bench.state is State.RUNNING
        bench.disarm()
        with pytest.raises(BenchError, match=refusal):
            second.arm()


def test_a_bench_that_leaves_is_not_missed(virtual: dict[str, Any], node: StimulatorNode) -> None:
    for _ in range(2):
        with connect(virtual) as bench:
            assert BENCH_WATCH not in watched(bench)
            assert bench.state is not State.FAULT
            bench.run(0.3)
            bench.mode = "open_loop"
            assert BENCH_WATCH in watched(bench)


def test_a_bench_that_cannot_disarm_leaves_its_heartbeat_missed(
    virtual: dict[str, Any], node: StimulatorNode, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise BenchError("refused")

    bench = connect(virtual)
    bench.run(0.3)
    bench.mode = "open_loop"
    monkeypatch.setattr(bench._link, "write", refused)
    with pytest.raises(BenchError, match="refused"):
        bench.close()
    until(lambda: node.block.state is State.FAULT)
    assert node.od["Message"].value == "the heartbeat of a supervised node is lost"


def test_arm_sets_up_a_heartbeat_watch_cleared_by_a_reset(
    virtual: dict[str, Any], node: StimulatorNode
) -> None:
    with connect(virtual) as bench:
        bench.run(0.3)
        bench.arm()
        bench.disarm()
        device = bench._link._stimulator  # type: ignore[attr-defined]
        device.write(device.od.entry(0x1016, 1), 0)
        bench.arm()
        assert watched(bench).count(BENCH_WATCH) == 1


def test_bench_heartbeat_id_differs_for_16_stimulators_in_a_row() -> None:
    assert bench_id(32) == 127
    for first in range(1, 112):
        ids = [bench_id(node_id) for node_id in range(first, first + 16)]
        assert sorted(ids) == list(range(112, 128))


def test_the_heartbeat_never_has_the_node_id_of_the_stimulator() -> None:
    assert all(bench_id(node_id) != node_id for node_id in range(1, 128))
