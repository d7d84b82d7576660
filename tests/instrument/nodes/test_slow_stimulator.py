"""A stimulator that has half a processor: measurements wait, and their drives come late."""

from __future__ import annotations

import random
from itertools import cycle

import pytest
from line import MEASUREMENT, START

from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od import cia
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.faults import PICKUP, FaultKind
from smarttac_can.vocabulary.meanings import AUTO_ZERO, START_RUN, ZERO
from smarttac_can.vocabulary.states import Law, Mode, State, VibrationLaw

ALL = 99
DOES_NOT_FOLLOW = "the vibration does not follow from the voltage"
DRIVES_LATE = "the plate went to 0 V by itself: its drives were late"
END_OF_RANGE = "a sensor is at the end of its range"
ABOVE_LIMIT = "the vibration is above its limit"
TRIP = 3.2e-6
SEEN = [1, 0, 2, 1, 1, 0, 1, 1, 1, 1, 1, 1, 1, 0, 1, 0, 2, 0, 1, 0, 2, 1, 1, 1, 1, 2, 2]
"""Answers between two SYNCs on a machine that was slow for 0.3 s, from a log."""


class SlowLoop:
    """Both nodes at a deadline of 20 ms; measurements wait until the stimulator gets to them."""

    def __init__(self, mode: Mode, *, produce_sync: bool = True, **laws: int) -> None:
        self.node = StimulatorNode(
            stimulator_od(),
            plate_node_id=PLATE_ID,
            produce_sync=produce_sync,
            presets={"Drive unwatched": 1},
        )
        self.plate = PlateNode(plate_od())
        self._produce_sync = produce_sync
        self._waiting: list[list[Frame]] = []
        self.highest = 0.0
        self._to_plate(self.node.start())
        self._to_node(self.plate.start())
        self._to_plate(self.node.receive(requests.nmt(START)))
        self._to_node(self.plate.receive(requests.nmt(START)))
        self.periods(5)
        for name, raw in (("Simulation.Subject", 2), ("Finger.Force", 500), ("Finger.Motion", 1)):
            self.plate.block.write(name, raw)
        self.plate.block.write(START_RUN, 1)
        self.node.on_write(self.node.od[START_RUN], 1)
        self.periods(70)
        self.write(AUTO_ZERO[0], ZERO)
        self.periods(10)
        for name, raw in laws.items():
            self.write(name, raw)
        for name, raw in (("Mode", mode), ("Controlword", 1), ("Controlword", 3)):
            self.write(name, raw)
        self.periods(300)
        assert self.running

    @property
    def running(self) -> bool:
        return self.node.block.state is State.RUNNING

    @property
    def message(self) -> str:
        return str(self.node.od["Message"].value)

    def write(self, name: str, raw: int) -> None:
        self.node.block.write(name, raw)

    def periods(self, count: int) -> None:
        for _ in range(count):
            self.period()

    def period(self, answered: int = ALL) -> None:
        """Let 1 ms pass, then a SYNC; before the next one so many measurements are answered."""
        self._to_node(self.plate.advance(1000))
        frames = self.node.advance(1000)
        if not self._produce_sync:
            frames = [requests.sync(), *frames]
        for frame in frames:
            if frame.can_id != cia.SYNC_ID:
                self._to_plate([frame])
                continue
            if not self._produce_sync:
                self.node.receive(frame)
            sent = self.plate.receive(frame)
            self._to_node([frame for frame in sent if frame.can_id not in MEASUREMENT])
            self._waiting.append([frame for frame in sent if frame.can_id in MEASUREMENT])
        self.highest = max(self.highest, abs(self.plate.block.plate.W))
        now, self._waiting = self._waiting[:answered], self._waiting[answered:]
        for measurement in now:
            self._to_node(measurement)

    def _to_plate(self, frames: list[Frame]) -> None:
        for frame in frames:
            self._to_node(self.plate.receive(frame))

    def _to_node(self, frames: list[Frame]) -> None:
        for frame in frames:
            self._to_plate(self.node.receive(frame))


def slow_for_a_while(loop: SlowLoop, answers: list[int]) -> None:
    """Let it be slow, and recover; up to six times, until that ends the run."""
    for _ in range(6):
        for answered in answers:
            loop.period(answered)
        loop.periods(20)
        if not loop.running:
            return


@pytest.mark.parametrize(
    ("friction", "vibration", "produce_sync"),
    # Each law once; the producer of SYNC has nothing to do with them.
    [
        (law, vibration, n % 2 == 0)
        for n, (law, vibration) in enumerate(zip(Law, cycle(VibrationLaw)))
    ],
)
def test_late_drives_raise_no_fault_of_the_pickup(
    friction: Law, vibration: VibrationLaw, produce_sync: bool
) -> None:
    laws = {"Friction law": friction, "Controller.Vibration law": vibration}
    generator = random.Random(1)
    gaps = [[0] * length for length in (6, 12, 18)]
    any_answers = [generator.choice((0, 1, 1, 2)) for _ in range(60)]
    for answers in (SEEN, *gaps, any_answers):
        loop = SlowLoop(Mode.FRICTION, produce_sync=produce_sync, **laws)
        slow_for_a_while(loop, answers)
        if not loop.running and loop.message != DRIVES_LATE:
            # The plate did vibrate so much: 150 V were not taken back in time.
            cause, _, late = loop.message.partition("; ")
            assert cause in (END_OF_RANGE, ABOVE_LIMIT)
            assert loop.highest > TRIP
            assert late.endswith("of the last 20 drives late"), loop.message


def test_slow_stimulator_ends_its_run_by_the_plate_deadline() -> None:
    loop = SlowLoop(Mode.FRICTION)
    slow_for_a_while(loop, SEEN)
    assert loop.message == DRIVES_LATE


def test_late_drives_overshoot_and_end_no_run() -> None:
    """Four of ten drives are late: a reading above its limit makes 0 V, and the run goes on."""
    loop = SlowLoop(
        Mode.FRICTION,
        **{"Friction law": Law.MEASURED, "Controller.Vibration law": VibrationLaw.SCHEDULED},
    )
    generator = random.Random(1)
    for _ in range(300):
        loop.period(ALL if generator.random() < 0.6 else 0)
    assert loop.running, loop.message
    assert loop.highest > TRIP


@pytest.mark.parametrize("period", [2, 3])
def test_dead_pickup_is_found_with_each_nth_drive_late(period: int) -> None:
    loop = SlowLoop(Mode.AMPLITUDE)
    loop.write("Setpoint.Amplitude", 1000)
    loop.periods(50)
    for name, raw in (("Sensor", PICKUP), ("Value", 0), ("Kind", FaultKind.GAIN)):
        loop.plate.block.write(f"Fault.{name}", raw)
    for count in range(60):
        loop.period(ALL if count % period else 0)
    cause, _, late = loop.message.partition("; ")
    assert cause == DOES_NOT_FOLLOW
    assert late.endswith("of the last 20 drives late"), "who reads it knows of both"
