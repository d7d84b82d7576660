"""The laws of the vibration in the node: changed while running, and no alarm without a cause."""

import random
from collections.abc import Iterator

import pytest

from smarttac_can.bench import FaultError, Mode, State, Stimulator, VibrationLaw
from smarttac_can.vocabulary.faults import PICKUP, FaultKind

LAWS = list(VibrationLaw)


@pytest.fixture
def bench() -> Iterator[Stimulator]:
    with Stimulator.simulate("local") as bench:
        yield bench


def begin(bench: Stimulator, seed: int, dead_time: float, told: float) -> None:
    """Start a run with a finger of this seed, or without one, somewhere warm or cold."""
    draw = random.Random(seed)
    if seed % 4 == 0:
        bench.finger.lift()
    else:
        bench.finger.stroke(
            1 + seed % 5,
            force=draw.choice([0.1, 0.5, 1.0, 2.0]),
            speed=draw.uniform(20.0, 200.0),
            force_variation=0.5,
            speed_variation=0.5,
        )
    room = draw.uniform(10.0, 40.0)
    bench.finger.surroundings(seed=seed, temperature=room, drive_instant=dead_time)
    bench.set("Controller.Dead time", told)
    bench.start_run()
    bench.tare()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("seed", "dead_time", "told"), [(3, 702.0, 540.0), (4, 0.0, 0.0)])
def test_no_watchdog_trips_without_a_cause(
    bench: Stimulator, law: VibrationLaw, seed: int, dead_time: float, told: float
) -> None:
    """A fault ends a run with an error."""
    bench.vibration_law = law
    begin(bench, seed, dead_time, told)
    draw = random.Random(seed + 100)
    for mode in (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION, Mode.AMPLITUDE, Mode.FRICTION):
        for _ in range(6):
            bench.amplitude = draw.choice([0.0, 0.05, 0.1, 0.5, 1.0, 1.5, 2.0, 2.4])
            bench.cof = (draw.uniform(0.2, 0.6), draw.uniform(0.2, 0.6))
            bench.mode = mode
            bench.run(draw.choice([0.03, 0.1, 0.3]))
            assert bench.state is State.RUNNING


@pytest.mark.parametrize(
    ("law", "told", "instant"),
    [
        (VibrationLaw.PI, 0.0, 540.0),
        (VibrationLaw.SCHEDULED, 0.0, 540.0),
        (VibrationLaw.PREDICTIVE, 540.0, 800.0),
    ],
)
def test_a_dead_time_that_is_told_too_short_shows(
    bench: Stimulator, law: VibrationLaw, told: float, instant: float
) -> None:
    def overshoot(told: float) -> float:
        bench.vibration_law = law
        bench.finger.lift()
        bench.finger.surroundings(seed=3, drive_instant=instant)
        bench.set("Controller.Dead time", told)
        bench.start_run()
        bench.tare()
        bench.frequency, bench.amplitude = 43_390.0, 1.0
        bench.mode = Mode.AMPLITUDE_RESONANCE
        return float(bench.run(0.08).amplitude_um.max()) - 1.0

    assert overshoot(instant) < 0.03
    assert overshoot(told) > 0.06


def test_vibration_law_change_while_running_raises_no_fault(bench: Stimulator) -> None:
    begin(bench, 1, 540.0, 540.0)
    bench.amplitude = 1.0
    bench.mode = Mode.AMPLITUDE_RESONANCE
    bench.run(0.5)
    for law in (*LAWS, *reversed(LAWS)):
        bench.vibration_law = law
        assert bench.vibration_law is law
        trace = bench.run(0.1)
        # A finger slides: the rest is its effect.
        assert abs(trace.amplitude_um - 1.0).max() < 0.03
    assert bench.state is State.RUNNING


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("per_mille", [100, 300])
def test_a_pickup_that_reads_too_little_is_seen_whatever_the_law(
    bench: Stimulator, law: VibrationLaw, per_mille: int
) -> None:
    """The watch looks at the drive: a law that learns cannot talk it out of it."""
    bench.vibration_law = law
    begin(bench, 1, 540.0, 540.0)
    bench.amplitude = 1.0
    bench.mode = Mode.AMPLITUDE_RESONANCE
    bench.run(0.5)
    bench.set("Fault.Sensor", PICKUP)
    bench.set("Fault.Value", per_mille)
    bench.set("Fault.Kind", FaultKind.GAIN)
    with pytest.raises(FaultError):
        bench.run(0.1)
