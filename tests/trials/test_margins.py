"""Margins are those of sound cycles, and a trip has a cause that the plate itself shows."""

import pytest

from smarttac_can.trials.fault_acts import limit_amplitude
from smarttac_can.trials.margins import WHAT, Margins, largest, margin_rows
from smarttac_can.trials.rig import Rig
from smarttac_can.trials.soak import Soak
from smarttac_can.trials.trip_cause import TripCause
from smarttac_can.vocabulary.faults import PICKUP_D, FaultKind
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import Watchdog

AMPLITUDE, SATURATED = 1 << Watchdog.AMPLITUDE, 1 << Watchdog.SATURATED


def driving(mode: Mode = Mode.OPEN_LOOP, *, nm: int = 0) -> Rig:
    rig = Rig()
    rig.start()
    rig.write("Setpoint.Voltage", 4000)
    rig.start_run(touch=False)
    if nm:
        limit_amplitude(nm)(rig)
        rig.cycle(2)
    rig.drive(mode)
    rig.cycle(20)
    return rig


@pytest.fixture
def rig() -> Rig:
    return driving()


def test_four_bad_cycles_of_five_are_seen(rig: Rig) -> None:
    margins = Margins(rig)
    margins.look()
    margins.keep()
    assert margins.table()["gauges"] == {"open_loop": 0.0}
    rig.inject(FaultKind.OFFSET, 3, 600)
    for _ in range(4):
        rig.cycle()
        margins.look()
    rig.mend()
    rig.cycle(5)
    margins.look()
    assert rig.state is State.RUNNING
    margins.keep()
    assert margins.table()["gauges"] == {"open_loop": 0.8}
    rig.cycle()
    margins.look()
    margins.keep()
    assert margins.table()["gauges"] == {"open_loop": 0.8}, "the largest of all runs"


def test_what_is_dropped_is_not_kept(rig: Rig) -> None:
    margins = Margins(rig)
    margins.look()
    margins.keep()
    before = margins.table()
    rig.inject(FaultKind.OFFSET, 3, 600)
    rig.cycle(3)
    margins.look()
    margins.drop()
    margins.keep()
    assert margins.table() == before


def test_quantities_behind_a_count(rig: Rig) -> None:
    margins = Margins(rig)
    rig.write("Limit.Amplitude by drive", 5000)
    margins.look()
    margins.keep()
    table = margins.table()
    # 40 V make 2.01 um of the bare plate.
    assert table["true_amplitude"]["open_loop"] == pytest.approx(2.01 / 3.2, rel=0.02)
    assert table["bound_by_the_drive"]["open_loop"] == pytest.approx(2.01 / 5.0, rel=0.1)


def test_every_watchdog_has_a_row_and_events_have_no_number(rig: Rig) -> None:
    margins = Margins(rig)
    margins.look()
    margins.keep()
    head, *rows = margin_rows(margins.table())
    assert head == ("Watch", "Level", "open loop")
    assert [row[0] for row in rows[:27]] == [w.name.lower().replace("_", " ") for w in Watchdog]
    events = {row[0] for row in rows if row[2] == ""}
    assert events == {row[0] for row in rows if row[1] == "event"}
    assert events == {
        "nmt", "sync counter", "bus off", "transmit queue", "controller", "calibration", "plate",
        "stage", "not enabled",
    }  # fmt: skip
    assert set(margins.table()) == {name for name, what in WHAT.items() if what != "event"}


def test_largest_of_several() -> None:
    def table(**levels: float) -> dict[str, dict[str, float]]:
        return {name: dict(levels) for name, what in WHAT.items() if what != "event"}

    found = largest([table(friction=0.5, off=0.1), table(open_loop=0.3, off=0.2)])
    assert list(found["voltage"].items()) == [("off", 0.2), ("open_loop", 0.3), ("friction", 0.5)]
    assert set(found) == set(table())


def until_fault(rig: Rig, cause: TripCause) -> int:
    for _ in range(100):
        rig.cycle()
        cause.look()
        if rig.state is State.FAULT:
            return int(rig.od["Diagnosis.Latched"].value)
    raise AssertionError("no fault")


def test_vibration_of_the_plate_is_a_cause(rig: Rig) -> None:
    cause = TripCause(rig)
    rig.cycle(50)
    limit_amplitude(100)(rig)
    latched = until_fault(rig, cause)
    assert latched == AMPLITUDE
    assert cause.of(latched) == "vibration above its limit"
    assert cause.of(SATURATED) is None
    assert cause.of(AMPLITUDE | SATURATED) is None, "each needs its own"
    rig.cycle(200)
    assert cause.of(latched) is None, "long ago"


def test_reading_alone_is_no_cause() -> None:
    rig = driving(Mode.IDENTIFY, nm=1000)
    rig.cycle(420)
    cause = TripCause(rig)
    rig.inject(FaultKind.OFFSET, PICKUP_D, 500)
    latched = until_fault(rig, cause)
    assert latched == AMPLITUDE
    assert cause.of(latched) is None


def test_no_watchdog_but_those_of_too_much_vibration_has_a_cause(rig: Rig) -> None:
    cause = TripCause(rig)
    limit_amplitude(100)(rig)
    latched = until_fault(rig, cause)
    assert cause.of(latched | 1 << Watchdog.STUCK) is None
    assert cause.of(0) is None


def test_vibration_beyond_the_range_of_the_pickup_is_a_cause(rig: Rig) -> None:
    cause = TripCause(rig)
    plate = rig.plate_block.plate
    plate._state = plate._state._replace(motion=plate._state.motion._replace(W=3.3e-6 + 0j))
    cause.look()
    assert cause.of(SATURATED) is None, "one cycle is none"
    cause.look()
    assert cause.of(SATURATED) == "vibration beyond the range of its pick-up"


def test_trip_without_a_cause_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    def trips(soak: Soak) -> None:
        limit_amplitude(100)(soak._rig)
        soak._cycle(400)
        assert soak._tripped("set-points")
        limit_amplitude(3200)(soak._rig)
        soak._cycle(300)

    monkeypatch.setattr(Soak, "_touch", trips)
    for scene in ("_fault", "_mishap", "_restart_master"):
        monkeypatch.setattr(Soak, scene, trips)
    sound = Soak(3000, 1).run()
    assert sound.passed
    assert sound.tripped.keys() == {"vibration above its limit"}
    monkeypatch.setattr(TripCause, "look", lambda _: None)
    report = Soak(3000, 1).run()
    assert report.violated and not report.tripped
    assert "set-points in mode" in report.violations[0]
