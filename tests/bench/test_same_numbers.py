"""One experiment gives the same trace to the bit, over whatever link and at whatever pace."""

import random
import time
from pathlib import Path
from typing import Any

import canopen
import numpy as np
import pytest
from nodes_on_a_bus import both, in_threads, processes, stimulator_with_plate

from smarttac_can.bench import Stimulator, Trace
from smarttac_can.bench.simulation import LinkName
from smarttac_can.bench.traces import sha256, write_csv
from smarttac_can.studies.paper.experiments import Conditions
from smarttac_can.studies.paper.reproduce import TRACES, reproduce

SECONDS = 0.5


def experiment(bench: Stimulator, seed: int = 1) -> list[Trace]:
    """A finger that strokes a plate under friction control, and the empty plate before it."""
    bench.finger.lift()
    bench.finger.surroundings(seed=seed, temperature=30.0, drive_instant=120.0)
    bench.start_run()
    bench.tare()
    bench.amplitude = 1.0
    bench.mode = "amplitude resonance"
    empty = bench.run(0.05, "empty")
    bench.finger.stroke(2, speed=200.0, force_variation=0.2, speed_variation=0.2)
    bench.finger.surroundings(seed=seed)
    bench.start_run()
    bench.tare()
    bench.amplitude = 1.0
    bench.cof = 0.25, 0.35
    bench.mode = "friction"
    return [empty, bench.run(SECONDS, "friction", 2)]


def digest(traces: list[Trace], folder: Path) -> str:
    write_csv(folder / "traces.csv", traces)
    return sha256(folder / "traces.csv")


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Hash of the experiment without any bus."""
    with Stimulator.simulate("local") as bench:
        traces = experiment(bench)
    assert (traces[1].cof > 0).sum() > 100, "the finger has touched"
    assert len(set(traces[1].cof_reference.tolist())) == 2, "and crossed the boundary"
    return digest(traces, tmp_path_factory.mktemp("reference"))


@pytest.mark.parametrize("inside", [True, False])
def test_virtual_bus_in_this_process(inside: bool, reference: str, tmp_path: Path) -> None:
    with Stimulator.simulate("bus", plate_inside=inside) as bench:
        assert digest(experiment(bench), tmp_path) == reference


@pytest.mark.parametrize("inside", [True, False])
def test_nodes_in_threads_at_any_pace(
    inside: bool,
    virtual: dict[str, Any],
    reference: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pauses = random.Random(1)
    send = canopen.Network.send_message

    def hesitate(self: canopen.Network, *arguments: Any, **named: Any) -> None:
        time.sleep(pauses.choice((0.0, 0.0, 0.0, 0.0, 0.002)))
        send(self, *arguments, **named)

    monkeypatch.setattr(canopen.Network, "send_message", hesitate)
    nodes = (stimulator_with_plate(),) if inside else both()
    plate = None if inside else 33
    with (
        in_threads(
            virtual,
            *nodes,
            pause_s=lambda: pauses.choice((0.0, 0.0, 0.0, 0.0, 0.0005, 0.002)),
        ),
        Stimulator.connect(**virtual, plate_node_id=plate, lockstep=True) as bench,
    ):
        assert digest(experiment(bench), tmp_path) == reference


def test_real_processes(multicast: dict[str, Any], reference: str, tmp_path: Path) -> None:
    commands = "plate --lockstep", "node --lockstep --plate-node 33"
    with (
        processes(multicast, *commands),
        Stimulator.connect(**multicast, plate_node_id=33, lockstep=True) as bench,
    ):
        assert digest(experiment(bench), tmp_path) == reference


class Nosy(Stimulator):
    """Reads and writes over SDO every 10 cycles of a run."""

    def run(self, seconds: float, experiment: str = "run", subject: int = 0) -> Trace:
        parts = []
        for k in range(round(seconds * 100)):
            parts.append(super().run(0.01, experiment, subject))
            self.read()
            self.get("Cycle.Cycles")
            self.finger.surroundings(seed=k)
        return Trace(experiment, subject, np.concatenate([part.counts for part in parts]))


def test_sdo_between_the_ticks(reference: str, tmp_path: Path) -> None:
    with Nosy.simulate("bus") as bench:
        assert digest(experiment(bench), tmp_path) == reference


def test_another_seed_gives_other_numbers(reference: str, tmp_path: Path) -> None:
    with Stimulator.simulate("local") as bench:
        assert digest(experiment(bench, seed=2), tmp_path) != reference


@pytest.mark.parametrize("dead_time", [0.0, 430.0])
def test_reproduction(dead_time: float, tmp_path: Path) -> None:
    hashes = []
    links: tuple[LinkName, ...] = ("local", "bus")
    for link in links:
        conditions = Conditions(seed=4, dead_time=dead_time)
        _, results = reproduce(frozenset({"fig5"}), conditions, link=link, folder=tmp_path / link)
        assert results["trace_sha256"] == sha256(tmp_path / link / TRACES)
        hashes.append(results["trace_sha256"])
    assert hashes[0] == hashes[1]
