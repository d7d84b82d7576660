"""Objects of a cycle; a value read on demand is as if published in that cycle."""

from contextlib import suppress
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from line import PREOP, START, STOP, both_nodes, plate_inside

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.instrument.nodes import stimulator_block
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.process_image import (
    CHANNELS,
    AnalogueInput,
    DriveOutput,
    Measured,
    ReadBack,
)
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.vocabulary.meanings import AUTO_ZERO, ZERO
from smarttac_can.vocabulary.signals import Contact, Drive, Measurement
from smarttac_can.vocabulary.states import Control, Mode, State

CHANNEL_SOURCES = (
    "Contact.Force x",
    "Contact.Force y",
    "Contact.Normal force",
    "Contact.COF",
    "Vibration.Amplitude",
    "Plate temperature",
)


NOTHING = Measured(Measurement(0j, (0.0,) * 6, 0.0, 0), (0,) * 9, 0, 0)


def quantities(measured: Measured, cascade: Cascade) -> dict[str, float]:
    """Values of a cycle, in SI units."""
    contact, drive = cascade.contact, cascade.drive
    return {
        "Vibration.W_d": measured.si.W.real,
        "Vibration.W_q": measured.si.W.imag,
        "Vibration.Amplitude": cascade.amplitude,
        "Vibration.Amplitude reference": cascade.W_ref,
        "Vibration.Frequency": drive.frequency,
        "Vibration.Voltage": drive.voltage,
        "Contact.Tangential force": (contact.Fx * contact.Fx + contact.Fy * contact.Fy) ** 0.5,
        "Contact.Normal force": contact.Fn,
        "Contact.COF": contact.mu,
        "Contact.COF uncertainty": contact.u_mu,
        "Contact.COF reference": cascade.mu_ref,
        "Contact.Friction error": cascade.E * 0.01,
        "Contact.Position": contact.position,
        "Contact.Speed": contact.speed,
        "Contact.Force x": contact.Fx,
        "Contact.Force y": contact.Fy,
        "Plate temperature": measured.si.temperature,
    }


QUANTITIES = tuple(quantities(NOTHING, Cascade()))


class EagerReadBack(ReadBack):
    """Beside values on demand, it has the integers of each cycle, made in that cycle."""

    def __init__(self, od: ObjectDictionary) -> None:
        self._objects = stimulator_od()
        super().__init__(od)

    def reset(self) -> None:
        super().reset()
        self._published = {name: self._objects[name].default for name in QUANTITIES}

    def show_off(self) -> None:
        super().show_off()
        self._published["Vibration.Voltage"] = 0

    def publish(self, measured: Measured, cascade: Cascade) -> None:
        super().publish(measured, cascade)
        for name, quantity in quantities(measured, cascade).items():
            self._published[name] = self._objects[name].quantise(quantity)

    @property
    def published(self) -> dict[str, int]:
        channels = {
            f"AI input PV.AI input PV {channel}": self._published[source]
            for channel, source in zip(CHANNELS, CHANNEL_SOURCES, strict=True)
        }
        return self._published | channels


class Loop:
    """A stimulator with the plate inside, and a finger on it, to be disturbed between cycles."""

    def __init__(self) -> None:
        with patch.object(stimulator_block, "ReadBack", EagerReadBack):
            self.block = StimulatorBlock(stimulator_od(), PlateBlock(plate_od()))

    def begin(self) -> None:
        """Drive, with a finger on the plate, from power-on."""
        self.block.od.reset()
        self.block.power_on()
        self.block.write("Finger.Motion", 1)
        self.block.start_run()
        self.cycle(70)
        for name, raw in (
            ("Setpoint.Amplitude", 1000),
            ("Controlword", Control.ARM),
            ("Controlword", Control.ARM | Control.RUN),
            ("Mode", Mode.FRICTION),
        ):
            self.block.write(name, raw)
        self.cycle(20)
        assert self.block.state is State.RUNNING
        assert self.block.cascade.drive.voltage > 0.0

    def cycle(self, count: int) -> None:
        for _ in range(count):
            self.block.tick()

    def check(self) -> None:
        published = self.block._read_back.published  # type: ignore[attr-defined]
        assert {name: self.block.od[name].read() for name in published} == published


@pytest.fixture(scope="module")
def loop() -> Loop:
    return Loop()


WRITES = st.one_of(
    st.tuples(st.just("Mode"), st.integers(0, 5)),
    st.tuples(st.just("Setpoint.Amplitude"), st.integers(0, 3000)),
    st.tuples(st.just("Setpoint.Voltage"), st.integers(0, 6000)),
    st.tuples(st.just("Setpoint.COF left"), st.integers(2000, 5000)),
    st.tuples(st.just("Limit.Voltage"), st.integers(0, 15_000)),
    st.tuples(st.just("Limit.Amplitude"), st.integers(0, 3000)),
    st.tuples(st.just("Limit.Lowest frequency"), st.integers(4_270_000, 4_400_000)),
    st.tuples(st.just("Limit.Normal force"), st.integers(100, 8000)),
    st.tuples(st.just("Controller.Amplitude pole"), st.integers(0, 950)),
    st.tuples(st.just("Friction law"), st.integers(0, 3)),
    st.tuples(st.just("Calibration.Fx from S1"), st.integers(5000, 15_000)),
    st.tuples(st.just("Gauge zero.Zero of S3"), st.integers(-500, 500)),
    st.tuples(st.just("Controlword"), st.sampled_from([0, 1, 3, 4, 0x80])),
    st.tuples(st.just(AUTO_ZERO[0]), st.just(ZERO)),
    st.tuples(st.just("Simulation.Start run"), st.just(1)),
    st.tuples(st.just("Fault.Kind"), st.integers(0, 7)),
)


@pytest.mark.sources
@given(acts=st.lists(st.one_of(st.integers(1, 5), WRITES), max_size=30))
@settings(max_examples=100, deadline=None)
def test_read_backs_are_those_of_the_last_cycle(
    loop: Loop, acts: list[int | tuple[str, int]]
) -> None:
    loop.begin()
    loop.check()
    for act in acts:
        if isinstance(act, int):
            loop.cycle(act)
        else:
            with suppress(Abort):
                loop.block.write(*act)
        loop.check()
    loop.block.disarm()
    loop.check()
    loop.cycle(1)
    loop.check()


@pytest.mark.parametrize("command", [PREOP, STOP])
def test_read_back_out_of_operational_is_not_live(command: int) -> None:
    line, _, stimulator = both_nodes()
    status = stimulator.od["Statusword"]
    line.nmt(START)
    assert status.value & 1 == 0
    line.sync(5)
    assert status.value & 1 == 1
    line.nmt(command, 32)
    assert status.value & 1 == 0
    line.sync(5)
    assert status.value & 1 == 0
    line.nmt(START, 32)
    assert status.value & 1 == 0
    line.sync(2)
    assert status.value & 1 == 1


def test_read_back_of_a_silent_plate_is_not_live() -> None:
    line, _, stimulator = both_nodes()
    line.nmt(START)
    line.sync(5)
    line.nmt(STOP, 33)
    line.sync(2)
    assert stimulator.od["Statusword"].value & 1 == 1
    line.sync()
    assert stimulator.od["Statusword"].value & 1 == 0


def test_a_plate_inside_goes_on_outside_operational() -> None:
    line, stimulator = plate_inside()
    line.nmt(START)
    line.advance(5)
    line.nmt(PREOP)
    cycles = stimulator.od["Cycle.Cycles"].value
    line.advance(5)
    assert stimulator.od["Cycle.Cycles"].value == cycles + 5
    assert stimulator.od["Statusword"].value & 1 == 1


LIVE, DRIVING, TOUCHING, LIMITED, SATURATED, FAULT = (1 << bit for bit in range(6))
TEXTURE = 6


class Shown:
    """A read-back without a loop, and its objects."""

    def __init__(self) -> None:
        self.od = stimulator_od()
        self.read_back = ReadBack(self.od)

    def publish(
        self,
        tick: int = 0,
        *,
        voltage: float = 0.0,
        touching: bool = False,
        limited: int = 0,
        saturation: int = 0,
    ) -> None:
        contact = Contact(0.3, -0.4, 1.0, 0.5, 0.01, 0.002, 0.1, touching)
        cascade: Any = SimpleNamespace(
            contact=contact,
            drive=Drive(voltage, 43390.0),
            amplitude=1e-6,
            W_ref=1.1e-6,
            mu_ref=0.4,
            E=25.0,
            mode=TEXTURE,
            limited=limited,
        )
        measurement = Measurement(0.6e-6 - 0.8e-6j, (0.0,) * 6, 21.0, saturation)
        self.read_back.publish(Measured(measurement, (0,) * 9, tick & 0xFF, 0), cascade)

    def read(self, *names: str) -> list[int]:
        return [self.od[name].read() for name in names]

    @property
    def status(self) -> int:
        return int(self.od["Statusword"].value)


PLAIN = ("Mode display", "Contact.Touching", "Contact.Tick", "Cycle.Cycles", "Statusword")


def test_cycle_values_have_the_units_of_their_objects() -> None:
    shown = Shown()
    shown.publish(voltage=20.0)
    for name, raw in (
        ("Vibration.W_d", 6000),
        ("Vibration.W_q", -8000),
        ("Vibration.Frequency", 4_339_000),
        ("Vibration.Voltage", 2000),
        ("Contact.Tangential force", 500),
        ("Contact.COF", 5000),
        ("Contact.Friction error", 2500),
        ("Plate temperature", 2100),
    ):
        assert shown.read(name) == [raw], name


def test_a_reset_shows_that_nothing_was_measured() -> None:
    shown = Shown()
    nothing = [0, 0, 0xFFFF, 0, 0]
    assert shown.read(*PLAIN) == nothing
    shown.publish(200, voltage=20.0, touching=True, limited=1, saturation=1)
    assert shown.read(*PLAIN) == [TEXTURE, 1, 200, 1, 0b11111]
    shown.read_back.reset()
    assert shown.read(*PLAIN) == nothing
    assert shown.read("Vibration.Voltage", "Contact.COF") == [0, 0]


@pytest.mark.parametrize(
    ("what", "bits"),
    [
        ({}, LIVE),
        ({"voltage": 0.01}, LIVE | DRIVING),
        ({"touching": True}, LIVE | TOUCHING),
        ({"limited": 1}, LIVE | LIMITED),
        ({"limited": 4}, LIVE | LIMITED),
        ({"saturation": 1}, LIVE | SATURATED),
        ({"saturation": 0x40}, LIVE | SATURATED),
    ],
)
def test_status_of_a_cycle_is_its_own_beside_the_state(what: dict[str, Any], bits: int) -> None:
    shown = Shown()
    shown.read_back.show_state(State.QUICK_STOP)
    shown.publish(voltage=20.0, touching=True, limited=1, saturation=1)
    assert shown.status == 4 << 8 | 0b11111
    shown.publish(**what)
    assert shown.status == 4 << 8 | bits
    channels = stimulator_od()
    AnalogueInput(channels).update(bool(bits & TOUCHING), what.get("saturation", 0))
    assert statuses(shown.od) == statuses(channels)


@pytest.mark.parametrize("state", State)
def test_the_state_stands_beside_the_bits_of_the_cycle(state: State) -> None:
    shown = Shown()
    shown.publish(voltage=20.0, touching=True, limited=1, saturation=1)
    for before in State:
        shown.read_back.show_state(before)
        shown.read_back.show_state(state)
        assert shown.status == state << 8 | 0b11111 | (FAULT if state is State.FAULT else 0)
    shown.read_back.reset()
    assert shown.status == state << 8 | (FAULT if state is State.FAULT else 0)


def test_off_is_no_mode_and_0_v_and_leaves_the_rest() -> None:
    shown = Shown()
    shown.publish(voltage=20.0, touching=True, limited=1, saturation=1)
    before = {name: shown.od[name].read() for name in QUANTITIES}
    shown.read_back.show_off()
    assert shown.read("Mode display") == [0]
    after = {name: shown.od[name].read() for name in QUANTITIES}
    assert after == before | {"Vibration.Voltage": 0}
    assert shown.status == LIVE | TOUCHING | LIMITED | SATURATED
    shown.read_back.mark_stale()
    assert shown.status == TOUCHING | LIMITED | SATURATED


def test_tick_of_8_bits_continues_as_16_bits_with_a_cycle_count() -> None:
    shown = Shown()
    # As many as may be lost: less than 256.
    for count, tick in enumerate(range(0, 70_000, 201), 1):
        shown.publish(tick)
        assert shown.read("Contact.Tick", "Cycle.Cycles") == [tick & 0xFFFF, count]
    shown.read_back.reset()
    shown.publish(0)
    assert shown.read("Contact.Tick", "Cycle.Cycles") == [0, 1]


def test_drive_object_has_the_answered_tick_and_is_0_v_when_off() -> None:
    od = stimulator_od()
    output = DriveOutput(od)
    entries = [od[f"Drive.{name}"] for name in ("Voltage", "Frequency", "Tick")]
    output.write(Drive(20.0, 43390.0), 7)
    assert [entry.value for entry in entries] == [2000, 4_339_000, 7]
    output.switch_off()
    assert [entry.value for entry in entries] == [0, 4_339_000, 7]


# The status of the analogue inputs: which channels a cycle leaves valid.


NOT_VALID, OVERLOAD = 1, 3


def statuses(od: ObjectDictionary) -> list[int]:
    return [od[f"AI status.AI status {channel}"].value for channel in CHANNELS]


@pytest.mark.parametrize(
    ("sensors", "over"),
    [
        (range(2), ("force x", "force y", "COF")),
        (range(2, 6), ("normal force", "COF")),
        (range(6, 7), ("amplitude",)),
        (range(7, 8), ()),
    ],
)
def test_sensor_at_its_end_is_an_overload_of_its_channels(
    sensors: range, over: tuple[str, ...]
) -> None:
    od = stimulator_od()
    inputs = AnalogueInput(od)
    for sensor in sensors:
        inputs.update(True, 1 << sensor)
        assert statuses(od) == [OVERLOAD * (channel in over) for channel in CHANNELS]
        inputs.update(True, 0)
        assert statuses(od) == [0] * 6


def test_cof_without_a_finger_is_invalid_despite_an_overload() -> None:
    od = stimulator_od()
    inputs = AnalogueInput(od)
    inputs.update(False, 0)
    assert statuses(od) == [0, 0, 0, NOT_VALID, 0, 0]
    inputs.update(False, 1 << 2)
    assert statuses(od) == [0, 0, OVERLOAD, OVERLOAD, 0, 0]
    inputs.update(True, 0)
    assert statuses(od) == [0] * 6


def test_after_a_reset_a_cycle_like_the_last_one_is_shown_again() -> None:
    od = stimulator_od()
    inputs = AnalogueInput(od)
    inputs.update(False, 0)
    od.reset()
    inputs.reset()
    inputs.update(False, 0)
    assert statuses(od) == [0, 0, 0, NOT_VALID, 0, 0]
