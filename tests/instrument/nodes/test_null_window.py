"""A tare refuses a null outside its window: zeros of a finger that rests would hide it."""

from typing import Literal

import pytest

from smarttac_can.bench import NotReadyError, RefusedError, State, Stimulator
from smarttac_can.bench.simulation import od_and_plate, plate_od, stimulator_od
from smarttac_can.canopen.device.storage import Memory
from smarttac_can.canopen.master.requests import download
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.faults import FaultKind

_ANOTHER_NULL = {"Gauge null.Window": 10, "Gauge null.Null of S3": 0}
"""With it no tare of the simulated plate is taken."""


def zeros(bench: Stimulator) -> list[float]:
    return [bench.get(f"Gauge zero.Zero of S{gauge}") for gauge in range(1, 7)]


def run_until(bench: Stimulator, cycles: int) -> None:
    while (left := cycles - bench.get("Cycle.Cycles")) > 0:
        bench.run(left * 1e-3)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("gauge", range(1, 7))
def test_null_window_is_around_each_null_and_includes_its_end(gauge: int, sign: int) -> None:
    od = stimulator_od()
    od["Gauge null.Window"].value = 250
    nulls = [0.5, -0.25, 0.125, 0.0, 1.0, -1.0]
    for number, null in enumerate(nulls, 1):
        od[f"Gauge null.Null of S{number}"].value = round(null * 1e4)
    taring = StimulatorBlock(od, PlateBlock(plate_od()))._taring
    zeros = list(nulls)
    zeros[gauge - 1] += sign * 0.25
    taring.require_near_null(tuple(zeros))  # type: ignore[arg-type]
    zeros[gauge - 1] += sign * 0.001
    with pytest.raises(ValueError, match="not tared: ") as refused:
        taring.require_near_null(tuple(zeros))  # type: ignore[arg-type]
    null, read = (round(1000 * force) for force in (nulls[gauge - 1], zeros[gauge - 1]))
    assert str(refused.value) == (
        f"not tared: S{gauge} reads {read} mN, more than 250 mN from its null of {null} mN: "
        "lift what rests on the plate, and tare"
    )


@pytest.mark.parametrize(("window", "null", "allowed"), [(0, 0, 1500), (0, 1, 60), (77, 1, 77)])
def test_a_window_of_0_follows_from_the_nulls(window: int, null: int, allowed: int) -> None:
    od = stimulator_od()
    od["Gauge null.Window"].value = window
    od["Gauge null.Null of S6"].value = null
    taring = StimulatorBlock(od, PlateBlock(plate_od()))._taring
    inside = (allowed - 1) * 1e-3
    taring.require_near_null((inside, 0, 0, 0, 0, 0))
    with pytest.raises(ValueError, match=f"S1 reads .* more than {allowed} mN from its null"):
        taring.require_near_null((inside + 0.002, 0, 0, 0, 0, 0))


@pytest.mark.parametrize("link", ["local", "inside", "bus"])
def test_a_simulation_knows_its_nulls_from_the_first_start(link: str) -> None:
    """So that whoever tares under a finger by mistake learns it before the hardware does."""
    name: Literal["local", "bus"] = "local" if link == "local" else "bus"
    with Stimulator.simulate(name, plate_inside=link == "inside") as bench:
        bench.run(0.1)
        assert bench.state is State.READY
        # At the left turning point it has slid 1 mm at most when it is tared.
        bench.finger.stroke(1, force=0.5, speed=5)
        bench.start_run()
        bench.run(0.4)
        before = zeros(bench)
        with pytest.raises(RefusedError, match=r"not tared: S[35] reads .* than 60 mN from its"):
            bench.tare()
        assert zeros(bench) == before
        assert bench.message.endswith("lift what rests on the plate, and tare")
        bench.finger.lift()
        bench.start_run()
        bench.tare()
        assert bench.message == ""


def test_stored_null_window_wins_over_that_of_the_plate_inside() -> None:
    memory = Memory()
    first = StimulatorNode(*od_and_plate(), storage=memory)
    for node, window in ((first, 0), (StimulatorNode(*od_and_plate(), storage=memory), 77)):
        node.start()
        assert node.od["Gauge null.Window"].value == window
        node.block.write("Gauge null.Window", 77)
        node.receive(download(32, node.od.entry(0x1010, 1), int.from_bytes(b"save", "little")))


def test_default_null_window_is_that_of_the_data_sheet() -> None:
    """1.2 N and a drift over 60 K, 1.364 N; a gauge that reads 1.6 N more is broken."""
    od = stimulator_od()
    of_the_eds = {entry.name: entry.default for entry in od if entry.index == 0x2047}
    assert of_the_eds.pop("Gauge null.Highest sub-index supported") == 7
    assert list(of_the_eds.values()) == [0, 0, 0, 0, 0, 0, 0]
    with Stimulator.simulate("local", presets=of_the_eds) as bench:
        bench.tare()
        bench.set("Fault.Sensor", 4)
        bench.set("Fault.Value", 2800)
        bench.set("Fault.Kind", FaultKind.OFFSET)
        with pytest.raises(RefusedError, match="not tared: S4 reads"):
            bench.tare()


def test_a_tare_at_power_on_waits_until_the_finger_is_gone() -> None:
    with Stimulator.simulate("local", presets=_ANOTHER_NULL) as bench:
        bench.run(0.3)
        assert bench.state is State.NOT_READY
        with pytest.raises(NotReadyError, match=r"not ready: not tared: S\d reads"):
            bench.arm()
        bench.set("Gauge null.Window", 1500)
        bench.run(0.2)
        assert bench.state is State.READY
        assert bench.message == ""


def test_a_tare_at_power_on_is_tried_again_with_64_other_samples() -> None:
    with Stimulator.simulate("local", presets=_ANOTHER_NULL) as bench:
        run_until(bench, 100)
        assert bench.message.startswith("not tared: S")
        bench.set("Gauge null.Window", 1500)
        run_until(bench, 127)
        assert bench.state is State.NOT_READY
        run_until(bench, 130)
        assert bench.state is State.READY


def test_a_tare_at_power_on_is_made_once() -> None:
    with Stimulator.simulate("local") as bench:
        run_until(bench, 70)
        first = zeros(bench)
        assert all(first)
        run_until(bench, 300)
        assert zeros(bench) == first


def test_zeros_that_are_stored_are_no_tare_that_is_due() -> None:
    with Stimulator.simulate("local") as bench:
        run_until(bench, 70)
        stored = {
            f"Gauge zero.Zero of S{n}": round(10 * zero) for n, zero in enumerate(zeros(bench), 1)
        }
    stored["Gauge zero.Zero of S1"] += 30
    with Stimulator.simulate("local", presets=stored) as bench:
        run_until(bench, 70)
        assert [round(10 * zero) for zero in zeros(bench)] == list(stored.values())
        assert bench.state is State.READY
