"""The self-test passes a sound plate, and each of its verdicts can be made to fail."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from smarttac_can.bench import BenchError, RunInterruptedError, State, Stimulator
from smarttac_can.bench.link import Row
from smarttac_can.bench.self_test import Check, ResonanceFit, selftest
from smarttac_can.vocabulary.faults import PICKUP, PICKUP_D, PICKUP_Q, FaultKind
from smarttac_can.vocabulary.states import Mode

ALL = {
    "timing.lost rows", "timing.missed ticks", "timing.foreign ticks",
    "timing.corrupt measurements", "timing.surplus measurements",
    *(f"{what}.S{gauge}" for what in ("null", "drift", "noise") for gauge in range(1, 7)),
    "noise.W_d", "noise.W_q", "null.W_d", "null.W_q",
    "sweep.residual", "sweep.resonance", "sweep.gain", "sweep.quality",
    "polarity.drive", "polarity.phase", "sweep.delay", "end.voltage", "end.amplitude",
}  # fmt: skip


@pytest.fixture
def bench() -> Iterator[Stimulator]:
    with Stimulator.simulate("local") as made:
        made.run(0.2)
        yield made


def failures(checks: list[Check]) -> set[str]:
    return {check.name for check in checks if not check.passed}


def broken(bench: Stimulator, kind: FaultKind, sensor: int = 1, value: int = 0) -> set[str]:
    bench.set("Fault.Sensor", sensor)
    bench.set("Fault.Value", value)
    bench.set("Fault.Kind", kind)
    bench.run(0.02)
    return failures(selftest(bench))


def after_each_run(bench: Stimulator, change: Callable[[int, list[Row]], None]) -> None:
    """Call ``change`` with the cycles and rows of each run."""
    run = bench._link.run

    def changed(cycles: int, rows: list[Row], *others: Any) -> None:
        run(cycles, rows, *others)
        change(cycles, rows)

    bench._link.run = changed


@pytest.mark.parametrize("link", ["local", "bus"])
def test_a_sound_plate_passes(link: str) -> None:
    with Stimulator.simulate("local" if link == "local" else "bus") as bench:
        bench.run(0.2)
        bench.voltage = 7.0
        told: list[Check] = []
        checks = selftest(bench, told.append)
        assert checks == told
        assert {check.name for check in checks} == ALL
        assert failures(checks) == set()
        assert (bench.voltage, bench.mode, bench.state) == (7.0, Mode.OFF, State.READY)


def test_ctrl_c_within_a_run_is_no_check_that_fails(
    bench: Stimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_bench: Stimulator, _names: object, _count: int) -> None:
        raise RunInterruptedError("interrupted after 0 of 28 samples")

    told: list[str] = []

    def tell(check: Check) -> None:
        told.append(check.name)
        if check.name == "null.W_q":  # the last one before the sweep
            monkeypatch.setattr(Stimulator, "sample", interrupted)

    with pytest.raises(RunInterruptedError):
        selftest(bench, tell)
    assert told[-1] == "null.W_q"
    assert (bench.mode, bench.get("Drive.Voltage")) == (Mode.OFF, 0.0)


def test_self_test_is_refused_while_another_bench_drives(bench: Stimulator) -> None:
    bench.voltage = 5.0
    bench.mode = "open_loop"
    with pytest.raises(BenchError, match=r"the stimulator is in use: .* disarm\(\) first"):
        selftest(bench)
    assert (bench.state, bench.mode, bench.voltage) == (State.RUNNING, Mode.OPEN_LOOP, 5.0)


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_sound_plate_passes_with_any_noise_and_warmth(bench: Stimulator, seed: int) -> None:
    bench.finger.surroundings(seed=seed, temperature=20.0 + 3.0 * seed)
    bench.start_run()
    bench.tare()
    assert failures(selftest(bench)) == set()


@pytest.mark.parametrize(
    ("kind", "sensor", "value", "expected"),
    [
        (FaultKind.OFFSET, 3, 50, {"drift.S3"}),
        (FaultKind.OFFSET, 3, 75, {"drift.S3", "null.S3"}),
        (FaultKind.OFFSET, 1, 800, {"drift.S1", "null.S1", "sweep"}),
        (FaultKind.NOISE, 5, 25, {"noise.S5"}),
        (FaultKind.NOISE, PICKUP_D, 12, {"noise.W_d"}),
        (FaultKind.OFFSET, PICKUP_Q, 8, {"null.W_q", "sweep.residual"}),
        (FaultKind.RESONANCE_SHIFT, 1, 100, {"sweep.resonance"}),
        (FaultKind.QUALITY, 1, 750, {"sweep.quality", "sweep.gain"}),
        (FaultKind.GAIN, PICKUP, 750, {"sweep.gain"}),
    ],
)
def test_self_test_fails_the_checks_of_each_broken_sensor(
    bench: Stimulator, kind: FaultKind, sensor: int, value: int, expected: set[str]
) -> None:
    assert broken(bench, kind, sensor, value) == expected


def test_a_stuck_gauge_bars_the_sweep_as_well(bench: Stimulator) -> None:
    assert broken(bench, FaultKind.STUCK, 2) == {"noise.S2", "sweep"}
    (sweep,) = (check for check in selftest(bench) if check.name == "sweep")
    assert sweep.text == "the stimulator is not ready: a sensor is stuck"


@pytest.mark.parametrize(
    ("sensor", "expected"),
    [(PICKUP_D, {"sweep"}), (PICKUP_Q, {"polarity.phase"}), (PICKUP, {"sweep"})],
)
def test_a_pickup_of_the_wrong_polarity_fails(
    bench: Stimulator, sensor: int, expected: set[str]
) -> None:
    """A watchdog ends the sweep where the d axis is turned: it sees no vibration."""
    assert broken(bench, FaultKind.GAIN, sensor, -1000) == expected


def test_a_drive_of_the_wrong_polarity_fails(bench: Stimulator) -> None:
    read = bench._link.read
    bench._link.read = lambda name: -read(name) if name.startswith("Vibration.W") else read(name)
    assert failures(selftest(bench)) == {"polarity.drive"}


def test_a_finger_on_the_plate_fails(bench: Stimulator) -> None:
    bench.finger.stroke(1, force=0.5, speed=5)
    bench.start_run()
    bench.run(0.5)
    bad = failures(selftest(bench))
    assert {"drift.S3", "drift.S5", "sweep.quality"} <= bad


@pytest.mark.parametrize(
    ("counter", "name"),
    [
        ("Missed deadlines", "timing.missed ticks"),
        ("Foreign ticks", "timing.foreign ticks"),
        ("Corrupt measurements", "timing.corrupt measurements"),
        ("Surplus measurements", "timing.surplus measurements"),
    ],
)
def test_self_test_fails_on_counts_of_the_node(bench: Stimulator, counter: str, name: str) -> None:
    def count(cycles: int, _rows: list[Row]) -> None:
        bench._link._block.od[f"Cycle.{counter}"].count(300 if cycles == 1000 else 0)

    after_each_run(bench, count)
    assert failures(selftest(bench)) == {name}


def test_rows_that_are_lost_fail(bench: Stimulator) -> None:
    def lose(cycles: int, rows: list[Row]) -> None:
        rows[:] = [row for row in rows if cycles < 1000 or row[0] % 10]

    after_each_run(bench, lose)
    assert failures(selftest(bench)) == {"timing.lost rows"}


@pytest.mark.parametrize(
    ("true", "dead_time", "bad"),
    [
        (540, 540, set()),
        (540, 460, set()),
        (540, 390, {"sweep.delay"}),
        (0, 150, {"sweep.delay"}),
    ],
)
def test_a_dead_time_that_is_not_the_one_written_fails(
    bench: Stimulator, true: int, dead_time: int, bad: set[str]
) -> None:
    bench.set("Simulation.Drive instant", true)
    bench.set("Controller.Dead time", dead_time)
    bench.start_run()
    checks = selftest(bench)
    assert failures(checks) == bad
    (delay,) = (check.value for check in checks if check.name == "sweep.delay")
    assert delay == pytest.approx(true, abs=15)


def test_a_delay_is_not_told_from_steps_with_gaps(bench: Stimulator) -> None:
    def lose(cycles: int, rows: list[Row]) -> None:
        rows[:] = [row for row in rows if cycles != 576 or row[0] % 20]

    after_each_run(bench, lose)
    checks = selftest(bench)
    assert failures(checks) == {"sweep.delay"}
    (delay,) = (check for check in checks if check.name == "sweep.delay")
    assert delay.text == "too many cycles were lost between the steps"


def test_a_plate_that_goes_on_vibrating_fails(bench: Stimulator) -> None:
    def vibrate(_cycles: int, rows: list[Row]) -> None:
        if bench.state is not State.RUNNING:
            rows[:] = [(*row[:3], 500, 100, *row[5:]) for row in rows]

    after_each_run(bench, vibrate)
    assert failures(selftest(bench)) == {"end.voltage", "end.amplitude"}


@pytest.mark.parametrize("error", [KeyboardInterrupt, BenchError("the bus is gone"), MemoryError])
def test_it_leaves_0_v_whatever_happens(
    bench: Stimulator, error: type[BaseException] | BaseException
) -> None:
    def end(check: Check) -> None:
        if check.name == "timing.missed ticks":
            bench.voltage = 10.0
            bench.mode = "open_loop"
            raise error

    bench.voltage = 3.0
    with pytest.raises(type(error) if isinstance(error, BaseException) else error):
        selftest(bench, end)
    assert bench.state is State.READY
    assert bench.get("Vibration.Voltage") == 0
    assert bench.voltage == 3.0


def test_self_test_fit_returns_the_parameters_of_its_formula() -> None:
    f = np.linspace(43200, 43500, 7)
    W = 40e-9 * 12.0 / (1 + 1j * 8e-4 * 2 * np.pi * (f - 43350.0))
    fit = ResonanceFit.from_sweep(f, W, 12.0)
    assert fit.gain == pytest.approx(40e-9)
    assert fit.tau == pytest.approx(8e-4)
    assert fit.f0 == pytest.approx(43350.0, abs=1e-6)
    assert fit.quality == pytest.approx(np.pi * 43350 * 8e-4)
    assert fit.residual < 1e-9
    turned = ResonanceFit.from_sweep(f, -W, 12.0)
    assert (turned.gain, turned.tau) == pytest.approx((-40e-9, 8e-4))
    assert ResonanceFit.from_sweep(f, np.conj(W), 12.0).tau == pytest.approx(-8e-4)
    crooked = W * (1 + 0.1 * (-1.0) ** np.arange(7))
    assert ResonanceFit.from_sweep(f, crooked, 12.0).residual > 0.05


@pytest.mark.parametrize(
    ("f", "W", "message"),
    [
        ([1.0, 2.0], [1j, 1j], "2 points of a sweep are fewer than 3"),
        ([1.0, 1.0, 2.0], [1j, 1j, 1j], "fewer than 3"),
        ([1.0, 2.0, 3.0], [1j, 0, 1j], "the plate does not vibrate"),
        ([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], "does not change with the frequency"),
    ],
)
def test_self_test_fit_refuses_short_and_silent_sweeps(
    f: list[float], W: list[complex], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        ResonanceFit.from_sweep(f, W, 1.0)
