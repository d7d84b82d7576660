"""A front end behind the plate node: as good as the simulated plate, and never believed blindly."""

from __future__ import annotations

from asyncio import CancelledError
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from line import (
    EMCY_STIMULATOR,
    PREOP,
    START,
    Line,
    both_nodes,
    cycle,
    drive,
    emergencies,
    plate_alone,
    ready_plate,
    stage,
    tick_of,
)

from smarttac_can.bench.simulation import plate_od
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.science.plant.finger import Lifted
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.signals import Drive, Measurement
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import Watchdog

NOT_ENABLED, STAGE, STATE, LATE = 0x9010, 0x3311, 0x0800_0022, 0x8253
NAN = float("nan")
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Fake:
    """A front end that acts by a test; it keeps its commands."""

    def __init__(self) -> None:
        self.told: list[float] = []
        self.took_us = 0
        self.answer: Callable[[], Any] = lambda: Measurement(0j, STILL, 20.0, 0)
        self.read_back: Callable[[float], Any] = lambda told: told

    def put_out(self, drive: Drive) -> Any:
        self.told.append(drive.voltage)
        return self.read_back(drive.voltage)

    def sample(self) -> Any:
        return self.answer()

    def close(self) -> None:
        raise AssertionError("the node does not close what it did not open")


class Hardware:
    """The simulated plate as if it were hardware: its drive acts from now on."""

    took_us = 0

    def __init__(self) -> None:
        od = plate_od()
        assert od["Finger.Motion"].value == 0
        self.plate = Plate(
            PlateParameters(),
            SUBJECTS[0],
            Lifted(),
            seed=od["Simulation.Seed"].value,
        )
        self._before: Drive | None = None
        self._drive = Drive(0.0, 0.0)

    def put_out(self, drive: Drive) -> float:
        self._drive = drive
        return drive.voltage

    def sample(self) -> Measurement:
        if self._before is not None:
            self.plate.step(self._before, self._drive)
        self._before = self._drive
        return self.plate.sample()

    def close(self) -> None:
        pass


def driven() -> tuple[Line, PlateNode, Fake]:
    fake = Fake()
    line, plate = ready_plate(front_end=fake)
    assert cycle(line, plate, 20) == 20
    assert fake.told[-1] == 20
    assert not emergencies(line)
    return line, plate, fake


def regulating(front_end: Any) -> tuple[Line, PlateNode, StimulatorNode]:
    line, plate, stimulator = both_nodes(front_end=front_end)
    line.nmt(START)
    line.sync(200)
    line.write(stimulator, "Setpoint.Amplitude", 1000)
    line.run(stimulator, 2)
    line.sync(100)
    assert stage(plate) > 1000
    return line, plate, stimulator


def test_loop_with_front_end_equals_that_of_the_simulated_plate() -> None:
    frames = []
    for front_end in (None, Hardware()):
        line, _, stimulator = regulating(front_end)
        line.sync(200)
        assert stimulator.block.state is State.RUNNING
        frames.append(line.frames)
    assert len(frames[0]) > 2000
    assert frames[0] == frames[1]


def test_front_end_gets_0_v_first_and_last() -> None:
    fake = Fake()
    plate = PlateNode(plate_od(), front_end=fake)
    assert fake.told == [0.0]
    plate.start()
    assert set(fake.told) == {0.0}
    plate.shutdown()
    assert fake.told[-1] == 0.0


def test_a_stage_that_does_not_obey_the_last_0_v_is_told_again() -> None:
    """Nothing comes after a shutdown: the 0 V that SYNC would repeat has to go out now."""
    _, plate, fake = driven()
    count = len(fake.told)
    fake.read_back = lambda told: 20.0 if len(fake.told) == count + 1 else told
    assert plate.shutdown() == []
    assert fake.told[count:] == [0.0, 0.0]
    assert plate.block.backend.cause == NOT_ENABLED


def late(fake: Fake) -> None:
    fake.took_us = 501


def silent(fake: Fake) -> None:
    fake.answer = lambda: None


def repeats(fake: Fake) -> None:
    same = Measurement(0j, STILL, 20.0, 0)
    fake.answer = lambda: same


@pytest.mark.parametrize("what", [late, silent, repeats])
def test_front_end_silent_for_one_cycle_passes_for_two_is_0_v(
    what: Callable[[Fake], None],
) -> None:
    line, plate, fake = driven()
    sound = fake.answer
    what(fake)
    if what is repeats:
        cycle(line, plate, 20)  # the first of these is new
    before = len(line.frames)
    line.sync()
    assert [frame.can_id for frame in line.frames[before:]] == [0x80], "no measurement goes out"
    assert fake.told[-1] == 20
    fake.answer, fake.took_us = sound, 0
    assert cycle(line, plate, 20) == 20
    assert not emergencies(line)
    what(fake)
    if what is repeats:
        cycle(line, plate, 20)
    line.sync(2)
    assert fake.told[-1] == 0
    assert emergencies(line) == [NOT_ENABLED]
    assert plate.od["Error register"].value == 0x81


def test_every_second_cycle_without_a_measurement_is_missed_time() -> None:
    hardware = Hardware()
    line, _, stimulator = regulating(hardware)
    sample, asked = hardware.sample, 0

    def every_second() -> Any:
        nonlocal asked
        asked += 1
        return sample() if asked % 2 else None

    hardware.sample = every_second  # type: ignore[method-assign]
    while stimulator.block.state is State.RUNNING and asked < 2000:
        line.sync()
    assert stimulator.block.supervisor.latched == 1 << Watchdog.MISSED_TIME
    assert stimulator.block.state is State.FAULT


def test_a_call_of_half_a_tick_is_in_time() -> None:
    line, plate, fake = driven()
    fake.took_us = 500
    for _ in range(50):
        assert cycle(line, plate, 20) == 20
    assert not emergencies(line)


def test_a_stage_that_is_told_late_is_late_too() -> None:
    line, plate, fake = driven()

    def slow(told: float) -> float:
        fake.took_us = 800
        return told

    def quick() -> Measurement:
        fake.took_us = 0
        return Measurement(0j, STILL, 20.0, 0)

    fake.read_back, fake.answer = slow, quick
    cycle(line, plate, 20)
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    line.sync()
    assert "a call took 800 us" in plate.block.backend.trouble
    assert fake.told[-1] == 0
    assert emergencies(line) == [NOT_ENABLED]


def test_a_plate_exactly_at_its_limit_is_not_too_hot() -> None:
    line, plate, _ = driven()
    assert line.write(plate, "Limit.Temperature", 2000) == 0
    for volts in (21, 22):
        assert cycle(line, plate, volts) == volts
    assert line.write(plate, "Limit.Temperature", 1999) == 0
    assert cycle(line, plate, 20) == 0


def raises(error: BaseException) -> Callable[[], Any]:
    def answer() -> Any:
        raise error

    return answer


class Shy:
    def __repr__(self) -> str:
        raise RuntimeError("shy")


class ShyError(Shy, Exception):
    pass


class Torn(Measurement):
    def __iter__(self) -> Any:
        raise RuntimeError("torn")


GOOD = Measurement(0j, STILL, 20.0, 0)
WRONG: list[tuple[Any, str]] = [
    (7, "7, not a Measurement"),
    ((0j, STILL, 20.0, 0), "not a Measurement"),
    (GOOD._replace(W=complex(NAN, 0)), "W (nan+0j)"),
    (GOOD._replace(W="1 um"), "W '1 um'"),
    (GOOD._replace(W=4e-6 + 0j), "W_d 4e-06 is outside"),
    (GOOD._replace(W=-4e-6j), "W_q -4e-06 is outside"),
    (GOOD._replace(temperature=NAN), "Temperature nan"),
    (GOOD._replace(temperature=1e3), "Temperature 1000 is outside"),
    (GOOD._replace(temperature=None), "Temperature None"),
    (GOOD._replace(gauges=STILL[:5]), "not a tuple of 6"),
    (GOOD._replace(gauges=[0.0] * 6), "not a tuple of 6"),
    (GOOD._replace(gauges=(0.0, 0.0, 0.0, float("inf"), 0.0, 0.0)), "S4 inf"),
    (GOOD._replace(gauges=(0.0, 0.0, 0.0, 0.0, 0.0, 4.0)), "S6 4 is outside"),
    (GOOD._replace(gauges=(True, 0.0, 0.0, 0.0, 0.0, 0.0)), "S1 True"),
    (GOOD._replace(saturated=256), "saturated 256"),
    (GOOD._replace(saturated=-1), "saturated -1"),
    (GOOD._replace(saturated=1.0), "saturated 1.0"),
    (GOOD._replace(temperature=10**400), "Temperature 1000"),
    (GOOD._replace(W=-(10**5000)), "W a int that cannot be shown"),
    (GOOD._replace(gauges=(Fraction(10**400), *STILL[1:])), "S1 Fraction(1000"),
    (GOOD._replace(temperature=Fraction(1000)), "Temperature 1000 is outside"),
    (Shy(), "a Shy that cannot be shown, not a Measurement"),
    (Torn(0j, STILL, 20.0, 0), "what sample() returned failed: RuntimeError('torn')"),
]


@pytest.mark.parametrize(("measured", "words"), WRONG, ids=[words for _, words in WRONG])
def test_front_end_without_a_valid_measurement_is_0_v_at_once(measured: Any, words: str) -> None:
    line, plate, fake = driven()
    fake.answer = lambda: measured
    before = len(line.frames)
    line.sync()
    assert fake.told[-1] == 0
    assert emergencies(line) == [NOT_ENABLED]
    assert [frame.can_id for frame in line.frames[before:]] == [0x80, 0xA1]
    assert words in plate.block.backend.trouble


def test_an_exception_is_0_v_at_once_and_the_node_goes_on() -> None:
    line, plate, fake = driven()
    sound = fake.answer
    fake.answer = raises(OSError("cable out"))
    line.sync()
    assert fake.told[-1] == 0
    assert emergencies(line) == [NOT_ENABLED]
    assert plate.block.backend.trouble == "sample() failed: OSError('cable out')"
    for volts in (20, 0, 20):
        assert cycle(line, plate, volts) == 0, "not even 0 V frees it"
    assert set(fake.told[-4:]) == {0.0}
    fake.answer = sound
    for _ in range(19):
        cycle(line, plate, 0)
        assert plate.block.inhibited
    cycle(line, plate, 0)
    assert not plate.block.backend.trouble
    assert emergencies(line)[-1] == 0
    assert cycle(line, plate, 20) == 20


@pytest.mark.parametrize("error", [SystemExit(0), GeneratorExit(), ShyError(), CancelledError()])
def test_front_end_error_is_0_v_and_the_node_goes_on(error: BaseException) -> None:
    line, plate, fake = driven()
    sound = fake.answer
    fake.answer = raises(error)
    line.sync()
    assert fake.told[-1] == 0
    assert emergencies(line) == [NOT_ENABLED]
    fake.answer = sound
    for _ in range(20):
        cycle(line, plate, 0)
    fake.read_back = lambda told: raises(error)() if told else 0.0
    assert cycle(line, plate, 20) == 0
    assert fake.told[-1] == 0


def test_ctrl_c_is_not_the_front_ends() -> None:
    line, _, fake = driven()
    fake.answer = raises(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        line.sync()


def test_front_end_measurement_may_be_numpy_floats() -> None:
    line, plate, fake = driven()
    forces = tuple(np.float32([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    fake.answer = lambda: Measurement(
        np.complex128(1e-6 - 2e-6j), forces, np.float64(21.5), np.uint8(255)
    )
    assert cycle(line, plate, 20) == 20
    od = plate.od
    assert (od["Vibration.W_d"].value, od["Vibration.W_q"].value) == (10_000, -20_000)
    assert [od[f"Gauge.S{n}"].value for n in range(1, 7)] == [1000 * n for n in range(1, 7)]
    assert (od["Vibration.Temperature"].value, od["Vibration.Saturation"].value) == (2150, 255)


def test_before_it_was_heard_the_stage_takes_no_voltage() -> None:
    fake = Fake()
    fake.answer = lambda: None
    line, plate = ready_plate(front_end=fake)
    assert plate.block.inhibited, "after the first cycle, which could pass later"
    for volts in (0, 20, 20):
        assert cycle(line, plate, volts) == 0
    assert set(fake.told) == {0.0}
    assert emergencies(line) == [NOT_ENABLED], "once for the time that a voltage is asked for"
    trouble = plate.block.backend.trouble
    assert trouble == "sample() has nothing new", "the reason, as soon as there is one"


@pytest.mark.parametrize(("missing", "sound"), [(0, 1), (1, 1), (2, 20), (5, 20)])
def test_a_first_measurement_may_come_a_cycle_late(missing: int, sound: int) -> None:
    fake = Fake()
    line, plate = plate_alone(front_end=fake)
    line.nmt(START)
    good, fake.answer = fake.answer, lambda: None
    line.sync(missing)
    fake.answer = good
    line.sync(sound - 1)
    assert plate.block.backend.trouble
    line.sync()
    assert not plate.block.backend.trouble


NO_ANSWER = RuntimeError("no answer")


@pytest.mark.parametrize(
    ("answer", "trouble"),
    [
        *((answer, f"put_out() of 21 V returned {answer!r}, no number within 1 V") for answer in
          (22.01, 19.99, NAN, None, "20", True, 1 + 0j)),
        pytest.param(
            10**400,
            f"put_out() of 21 V returned {str(10**400)[:200]}, no number within 1 V",
            id="huge",
        ),
        (NO_ANSWER, f"put_out() of 21 V failed: {NO_ANSWER!r}"),
    ],
)  # fmt: skip
def test_a_stage_that_says_something_else_or_nothing_is_told_0_v(answer: Any, trouble: str) -> None:
    line, plate, fake = driven()
    says = raises(answer) if answer is NO_ANSWER else lambda: answer
    fake.read_back = lambda told: says() if told else 0.0
    assert cycle(line, plate, 21) == 0
    assert set(fake.told[fake.told.index(21) + 1 :]) == {0}
    assert emergencies(line) == [STAGE]
    assert plate.block.backend.trouble == trouble


@pytest.mark.parametrize("off", [1.0, -1.0])
def test_a_stage_may_be_off_by_1_v(off: float) -> None:
    line, plate, fake = driven()
    fake.read_back = lambda told: told + off
    for volts in (21, 22, 0, 0, 21):
        assert cycle(line, plate, volts) == max(0, volts + off)
    assert not emergencies(line)


@pytest.mark.parametrize("failure", ["reads back 20 V", "raises"])
def test_stage_that_disobeys_0_v_gets_it_again_at_each_sync(failure: str) -> None:
    line, plate, fake = driven()

    says = raises(OSError("no answer")) if failure == "raises" else lambda: 20.0
    fake.read_back = lambda _told: says()
    line.sync(4)
    assert emergencies(line)[-1] == STAGE
    assert stage(plate) >= 2000, "what is not known to be 0 V does not show as it"
    for nmt in (START, PREOP):
        line.nmt(nmt)
        count = len(fake.told)
        line.sync(5)
        assert fake.told[count:].count(0.0) == len(fake.told) - count >= 5
    fake.read_back = lambda told: told
    line.nmt(START)
    for _ in range(22):
        cycle(line, plate, 0)
    assert stage(plate) == 0
    assert cycle(line, plate, 20) == 20


def test_stimulator_ends_its_run_by_faults_of_the_front_end() -> None:
    hardware = Hardware()
    line, plate, stimulator = regulating(hardware)
    hardware.sample = raises(OSError("cable out"))  # type: ignore[method-assign]
    line.sync()
    assert stage(plate) == 0
    assert hardware._drive.voltage == 0
    assert stimulator.block.state is State.FAULT
    assert stimulator.od["Diagnosis.Latched"].value == 1 << Watchdog.NOT_ENABLED
    assert emergencies(line, EMCY_STIMULATOR) == [NOT_ENABLED]


def test_objects_of_the_simulation_are_refused_but_start_run() -> None:
    line, plate, fake = driven()
    for name, raw in (("Fault.Kind", 6), ("Finger.Force", 700), ("Simulation.Seed", 9)):
        present = plate.od[name].value
        assert line.write(plate, name, raw) == STATE
        assert line.write(plate, name, present) == 0
        assert plate.od[name].value == present
    assert line.write(plate, "Simulation.Start run", 1) == 0
    assert fake.told[-1] == 0
    assert tick_of(plate) == 255
    with pytest.raises(AttributeError, match="no plate is simulated"):
        _ = plate.block.plate


def test_the_first_session_is_drawn_elsewhere() -> None:
    line, plate = plate_alone(front_end=Fake(), session=77)
    for session in (77, 78):
        line.nmt(PREOP)
        line.nmt(START)
        line.sync()
        assert (plate.od["Gauge tick"].value - tick_of(plate)) & 0xFF == session
