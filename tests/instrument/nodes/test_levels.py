"""How near a watch is to a fault rises to 1 as a fault comes near, and the watch trips then."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from driven import SETPOINT_DEADLINE_MS, driven, driven_within, write

from smarttac_can.assurance.trials.fault_cases import (
    MEASUREMENTS,
    calm,
    disturb,
    limit_amplitude,
    lose,
)
from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.faulty_bus import FrameFault
from smarttac_can.vocabulary.faults import PICKUP_D, FaultKind
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.watchdogs import COUNTED, Watchdog

LOSE_MEASUREMENTS = disturb(FrameFault.LOSS, *MEASUREMENTS)


def of(rig: Rig, watchdog: Watchdog) -> float:
    """Level of one watchdog of the stimulator."""
    return dict(zip(COUNTED, rig.stimulator.levels(), strict=True))[watchdog]


def until_it_trips(rig: Rig, watchdog: Watchdog) -> list[float]:
    """Levels of the cycles until the watchdog has latched, without that cycle."""
    levels = []
    for _ in range(1100):
        rig.cycle()
        if rig.state is not State.RUNNING:
            assert rig.od["Diagnosis.Latched"].value >> watchdog & 1
            return levels
        levels.append(of(rig, watchdog))
    raise AssertionError(f"{watchdog.name} does not trip: {levels[-5:]}")


def no_heartbeat(rig: Rig) -> None:
    while rig.cycles % 100:
        rig.cycle()
    rig.heartbeat = False


def no_sync(rig: Rig) -> None:
    rig.syncs = 0


def no_setpoints(rig: Rig) -> None:
    rig.each_cycle.clear()


def reads_more_at_rest(rig: Rig) -> None:
    """Have the pick-up read 150 nm at 0 V, above the limit, and below the bound at 0 V."""
    limit_amplitude(100)(rig)
    rig.inject(FaultKind.OFFSET, PICKUP_D, 150)


def broken(kind: FaultKind, sensor: int = 1, value: int = 0) -> Callable[[Rig], None]:
    return lambda rig: rig.inject(kind, sensor, value)


@pytest.mark.parametrize(
    ("watchdog", "act", "first", "last"),
    [
        # At first the plate is silent for a larger share of its time, as it is heard each 500 ms.
        (Watchdog.HEARTBEAT, no_heartbeat, 202 / 2000, 1.0),
        (Watchdog.MEASUREMENT, LOSE_MEASUREMENTS, 2 / 3, 1.0),
        (Watchdog.SETPOINT, no_setpoints, 2 / 5, 1.0),
        (Watchdog.SYNC_LOST, no_sync, 2 / 3, 1.0),
        (Watchdog.AMPLITUDE, reads_more_at_rest, 1 / 5, 4 / 5),
        (Watchdog.SATURATED, broken(FaultKind.SATURATED, 4), 1 / 2, 1 / 2),
        (Watchdog.STUCK, broken(FaultKind.STUCK, 1), None, 23 / 24),
        (Watchdog.GAUGES, broken(FaultKind.OFFSET, 3, 600), 1 / 5, 4 / 5),
        (Watchdog.PICKUP, broken(FaultKind.GAIN, PICKUP_D, 300), None, 19 / 20),
    ],
    ids=lambda value: value.name if isinstance(value, Watchdog) else "",
)
def test_level_rises_until_the_watch_trips(
    watchdog: Watchdog, act: Callable[[Rig], None], first: float | None, last: float
) -> None:
    assert SETPOINT_DEADLINE_MS == 5
    rig = driven()
    act(rig)
    levels = until_it_trips(rig, watchdog)
    assert levels == sorted(levels)
    assert first is None or levels[0] == pytest.approx(first)
    assert levels[-1] == pytest.approx(last)


def test_resonance_that_is_lost() -> None:
    rig = driven(Mode.AMPLITUDE_RESONANCE)
    rig.inject(FaultKind.RESONANCE_SHIFT, 1, -1500)
    assert until_it_trips(rig, Watchdog.RESONANCE)[-1] == 99 / 100


def test_force_that_comes_near_its_limit() -> None:
    rig = driven()
    before = of(rig, Watchdog.NORMAL_FORCE)
    rig.inject(FaultKind.SLAM, 1, 9000)
    levels = until_it_trips(rig, Watchdog.NORMAL_FORCE)
    assert 0.1 < before < 0.15 < levels[-1] < 1.0


@pytest.mark.parametrize(
    ("watchdog", "limit", "raw", "expected"),
    [
        # 40 V, and a plate at 20 degC.
        (Watchdog.VOLTAGE, "Limit.Voltage", 4100, 40.0 / 41.0),
        (Watchdog.TEMPERATURE, "Limit.Temperature", 2100, 20.0 / 21.0),
        (Watchdog.NORMAL_FORCE, "Limit.Normal force", 1000, None),
        (Watchdog.LATERAL_FORCE, "Limit.Lateral force", 1000, None),
    ],
)
def test_quantity_over_its_limit(
    watchdog: Watchdog, limit: str, raw: int, expected: float | None
) -> None:
    rig = driven()
    if expected is None:
        before = of(rig, watchdog)
        expected = before * rig.od[limit].value / raw
        assert before > 0.01
    assert write(rig, limit, raw) == 0
    rig.cycle()
    assert rig.state is State.RUNNING
    assert of(rig, watchdog) == pytest.approx(expected, rel=0.1)
    assert of(rig, watchdog) > 0.02


def test_syncs_too_many() -> None:
    rig = driven()
    rig.syncs = 2
    levels = until_it_trips(rig, Watchdog.SYNC_IRREGULAR)
    assert levels[:2] == pytest.approx([1 / 3, 2 / 3])


def test_measurements_that_cannot_be_used() -> None:
    rig = driven_within(20)
    disturb(FrameFault.CORRUPTION, MEASUREMENTS[0])(rig)
    levels = []
    for _ in range(2):
        rig.cycle()
        levels.append(of(rig, Watchdog.MEASUREMENT))
    calm(rig)
    rig.cycle()
    assert rig.state is State.RUNNING
    assert levels[:2] == pytest.approx([1 / 3, 2 / 3])
    assert of(rig, Watchdog.MEASUREMENT) == pytest.approx(1 / 20)


def test_ticks_without_a_cycle() -> None:
    rig = driven()
    before = of(rig, Watchdog.MISSED_TIME)
    for _ in range(20):
        lose(*MEASUREMENTS)(rig)
        rig.cycle(5)
    assert rig.state is State.RUNNING
    assert of(rig, Watchdog.MISSED_TIME) - before == pytest.approx(20 / 200), "20 % of a second"


def test_master_that_rests() -> None:
    rig = driven()
    rig.heartbeat = False
    pre_operational = bytes((127,))
    for _ in range(90):
        rig.master.send(Frame(0x701, pre_operational))
        rig.cycle(10)
    assert rig.state is State.RUNNING
    assert of(rig, Watchdog.HEARTBEAT) == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("mode", [Mode.OPEN_LOOP, Mode.FRICTION])
def test_sound_run_is_far_from_every_fault(mode: Mode) -> None:
    rig = driven(mode)
    for _ in range(200):
        rig.cycle()
        levels = dict(zip(COUNTED, rig.stimulator.levels(), strict=True))
        assert levels[Watchdog.MEASUREMENT] == levels[Watchdog.SYNC_LOST] == pytest.approx(1 / 3)
        assert levels[Watchdog.SETPOINT] == pytest.approx(1 / 5)
        assert max(levels[w] for w in COUNTED if w is not Watchdog.VOLTAGE) <= 0.5
