"""A plate that comes late passes over the ticks that are over, and answers the newest."""

from __future__ import annotations

import pytest
from driven import driven_within, write
from line import MEASUREMENT, START, drive
from test_front_end import Fake

from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import plate_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.vocabulary.signals import Measurement
from smarttac_can.vocabulary.states import Law, Mode, State, VibrationLaw

FIRST = 30


def driven(plate: PlateNode) -> PlateNode:
    plate.start()
    plate.receive(requests.nmt(START))
    for tick in range(FIRST):
        plate.advance(1000)
        plate.receive(requests.sync())
        plate.receive(drive(2000 if tick > 25 else 0, tick))
    assert plate.od["Stage.Voltage"].read() == 2000
    return plate


def paused(plate: PlateNode, ms: int) -> list[Frame]:
    """Measurements of a plate that stands still, and then finds all SYNCs of that time."""
    plate.advance(1000 * ms)
    frames = [frame for _ in range(ms - 1) for frame in plate.overtaken(requests.sync())]
    frames += plate.receive(requests.sync())
    return [frame for frame in frames if frame.can_id in MEASUREMENT]


def highest(rig: Rig, cycles: int) -> float:
    """Highest true amplitude in m within so many cycles."""
    amplitudes = []
    for _ in range(cycles):
        rig.cycle()
        amplitudes.append(abs(rig.plate.block.plate.W))
    return max(amplitudes)


def test_it_moves_by_all_ticks_and_measures_at_the_newest() -> None:
    plate, punctual = driven(PlateNode(plate_od())), driven(PlateNode(plate_od()))
    ticks = plate.od["Cycle.Ticks"].value
    for _ in range(14):
        newest = [
            frame for frame in punctual.receive(requests.sync()) if frame.can_id in MEASUREMENT
        ]
    assert paused(plate, 14) == newest, "as if it had been there all the time"
    assert plate.od["Cycle.Ticks"].value == ticks + 14


def test_its_deadline_begins_anew_with_the_drive_for_the_newest() -> None:
    plate = driven(PlateNode(plate_od()))
    assert len(paused(plate, 19)) == len(MEASUREMENT), "one measurement, so one drive is in time"
    plate.receive(drive(3000, FIRST + 18))
    plate.advance(19_999)
    assert plate.od["Stage.Voltage"].read() == 3000
    plate.advance(1)
    assert plate.od["Stage.Voltage"].read() == 0


def test_frames_other_than_sync_are_heard_as_ever() -> None:
    plate = driven(PlateNode(plate_od()))
    plate.receive(requests.sync())
    plate.overtaken(drive(0, FIRST))
    assert plate.od["Stage.Voltage"].read() == 0
    assert len(plate.receive(requests.sync())) == len(MEASUREMENT), "and the next SYNC, too"


def test_hardware_is_asked_for_no_more_than_it_has() -> None:
    fake = Fake()
    plate = driven(PlateNode(plate_od(), front_end=fake))
    new = iter([Measurement(0j, (0.0,) * 6, 20.0, 0)])
    fake.answer = lambda: next(new, None)
    assert len(paused(plate, 14)) == len(MEASUREMENT)
    assert plate.od["Stage.Voltage"].read() == 2000


@pytest.mark.sources
@pytest.mark.parametrize(
    ("mode", "laws"),
    [
        (Mode.AMPLITUDE, {"Controller.Vibration law": law} | {"Friction law": Law.MEASURED})
        for law in VibrationLaw
    ]
    + [
        (Mode.FRICTION, {"Friction law": law, "Controller.Vibration law": vibration})
        for law in Law
        for vibration in (VibrationLaw.PI, VibrationLaw.PREDICTIVE)
    ],
)
def test_the_loop_bears_a_gap_of_14_ticks_under_every_law(
    mode: Mode, laws: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = driven_within(20, mode)
    assert write(rig, "Controlword", 0) == 0
    for name, law in laws.items():
        assert write(rig, name, law) == 0
    rig.cycle(5)
    rig.drive(mode)
    rig.cycle(300)
    assert rig.state is State.RUNNING, rig.od["Message"].value
    before = highest(rig, 200)
    assert rig.plate_port is not None
    samples: list[Measurement] = []
    sample = rig.plate.block.backend.sample

    def counted() -> Measurement | None:
        measured = sample()
        assert measured is not None
        samples.append(measured)
        return measured

    monkeypatch.setattr(rig.plate.block.backend, "sample", counted)
    for _ in range(20):
        ticks = rig.plate.od["Cycle.Ticks"].value
        samples.clear()
        rig.bus.pause(rig.plate_port)
        rig.cycle(14)
        rig.bus.resume(rig.plate_port)
        after = highest(rig, 40)
        assert rig.state is State.RUNNING, rig.od["Message"].value
        assert rig.plate.od["Cycle.Ticks"].value == ticks + 54
        assert len(samples) == 41, "13 had no measurement"
        assert after < before + 0.7e-6
