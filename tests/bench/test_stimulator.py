"""The bench's client: the same over every link, in a person's units."""

import re
from collections.abc import Callable
from math import isnan
from typing import Any

import numpy as np
import pytest

from smarttac_can.bench import (
    BenchError,
    FaultError,
    Law,
    Mode,
    NotReadyError,
    NotRunningError,
    RefusedError,
    Stimulator,
    Trace,
    VibrationLaw,
)
from smarttac_can.bench.simulation import LinkName, LocalLink, simulated_block
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.states import Control, State, Status
from smarttac_can.vocabulary.watchdogs import Watchdog

LINKS: tuple[LinkName, ...] = ("local", "bus")
GREEK_UM = "\N{GREEK SMALL LETTER MU}m"
SET_POINTS: list[tuple[str, Any, Any, str, float]] = [
    ("voltage", 12.34, 12.34, "Setpoint.Voltage", 12_340),
    ("voltage", "0.02 kV", 20.0, "Setpoint.Voltage", 20_000),
    ("voltage", "0 nV", 0.0, "Setpoint.Voltage", 0),
    ("frequency", 43_210.98, 43_210.98, "Setpoint.Frequency", 43_210.98),
    ("frequency", "43.5kHz", 43_500.0, "Setpoint.Frequency", 43_500),
    ("amplitude", 1.234, 1.234, "Setpoint.Amplitude", 1234),
    ("amplitude", f"0.5 {GREEK_UM}", 0.5, "Setpoint.Amplitude", 500),
    ("boundary", -3.21, -3.21, "Setpoint.Boundary", -3210),
    ("boundary", "0.01 m", 10.0, "Setpoint.Boundary", 10_000),
    # Rounding of a zero.
    ("boundary", float(np.arange(-38.0, 38.0, 0.01)[3800]), 0.0, "Setpoint.Boundary", 0),
    ("cof", 0.35, (0.35, 0.35), "Setpoint.COF right", 0.35),
    ("cof", (0.2, 0.5), (0.2, 0.5), "Setpoint.COF right", 0.5),
    ("cof", [0.3, 0.4], (0.3, 0.4), "Setpoint.COF left", 0.3),
    ("cof", np.array([0.25, 0.45]), (0.25, 0.45), "Setpoint.COF right", 0.45),
    ("cof", np.float64(0.5), (0.5, 0.5), "Setpoint.COF left", 0.5),
    ("cof", "0.3", (0.3, 0.3), "Setpoint.COF left", 0.3),
    ("cof", ("35 %", 0.4), (0.35, 0.4), "Setpoint.COF left", 0.35),
    ("law", Law.NOMINAL, Law.NOMINAL, "Friction law", 2),
    ("vibration_law", VibrationLaw.SCHEDULED, 1, "Controller.Vibration law", 1),
    ("mode", Mode.AMPLITUDE, Mode.AMPLITUDE, "Mode", 2),
    ("mode", "Open loop", Mode.OPEN_LOOP, "Mode", 1),
    ("mode", "amplitude+resonance", Mode.AMPLITUDE_RESONANCE, "Mode", 3),
    ("mode", "off", Mode.OFF, "Mode", 0),
]
"""Property, assigned value, value read, and value of its object."""


def test_set_points(bench: Stimulator) -> None:
    for name, given, read, entry, held in SET_POINTS:
        setattr(bench, name, given)
        assert getattr(bench, name) == read, (name, given)
        assert bench.get(entry) == held, (name, given)


def test_the_cof_of_both_sides_takes_two_writes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    transfers: list[tuple[str, str]] = []
    with Stimulator.simulate("bus") as bench:
        link = type(bench._link)
        for name in ("read", "write"):
            transfer = getattr(link, name)

            def told(self, entry, *raw, name=name, transfer=transfer):  # type: ignore[no-untyped-def]
                transfers.append((name, entry))
                return transfer(self, entry, *raw)

            monkeypatch.setattr(link, name, told)
        bench.cof = 0.36
        monkeypatch.undo()
    assert transfers == [("write", "Setpoint.COF left"), ("write", "Setpoint.COF right")]


@pytest.mark.parametrize("sides", [(0.2, 2.5), (0.01, 0.5), (0.01, 2.5)])
@pytest.mark.parametrize("bench", ["local", "bus"], indirect=True)
def test_cof_of_one_side_refused_changes_neither(
    bench: Stimulator, sides: tuple[float, float]
) -> None:
    bench.cof = (0.31, 0.41)
    with pytest.raises(RefusedError):
        bench.cof = sides
    assert bench.cof == (0.31, 0.41)


def test_set_takes_text_with_unit_or_displayed_number() -> None:
    micro = [f"0.5 {sign}" for sign in ("um", "\N{MICRO SIGN}m", GREEK_UM)]
    with Stimulator.simulate("local") as bench:
        for name, texts, displayed in (
            ("Setpoint.Voltage", ("80 V", "80000 mV", "0.08kV"), 80_000),
            ("Setpoint.Amplitude", (*micro, "500 nm", "5e-7 m"), 500),
            ("Setpoint.COF left", ("0.35", "35 %"), 0.35),
            ("Finger.Speed", ("60 mm/s", "0.06 m/s"), 60),
            ("Mode", ("2",), 2),
        ):
            before = bench.get(name)
            for value in (*texts, displayed):
                bench.set(name, value)
                assert bench.get(name) == displayed
                bench.set(name, before)


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_measured_float_is_written_as_the_nearest_count(bench: Stimulator) -> None:
    name = "Gauge null.Null of S1"
    assert [bench.nearest(name, mN) for mN in (0.04, -0.26, 3.14159)] == [0.0, -0.3, 3.1]
    bench.set(name, bench.nearest(name, 0.04))
    assert bench.get(name) == 0.0
    with pytest.raises(ValueError, match="nan is not a finite number"):
        bench.nearest(name, float("nan"))


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_state_mode_and_laws_print_their_names(bench: Stimulator) -> None:
    assert f"{bench.state} {bench.mode}" in ("READY OFF", "NOT_READY OFF")
    assert (str(bench.law), str(bench.mode)) == ("MEASURED", "OFF")
    assert (bench.law, bench.mode) == (0, 0)
    assert f"{bench.mode:>5} {bench.mode:d} {bench.law:02X}" == "  OFF 0 00"


@pytest.mark.parametrize("link", ["local", "bus"])
def test_a_trace_has_the_subject_of_the_finger_in_force(link: LinkName) -> None:
    with Stimulator.simulate(link, subject=4) as bench:
        assert bench.run(0.001).subject == 0, "it is lifted"
        bench.finger.stroke(3)
        assert bench.run(0.001).subject == 0, "it is in force from the next start on"
        bench.start_run()
        assert bench.run(0.001).subject == 3
        assert bench.run(0.001, subject=7).subject == 7
        bench.finger.lift()
        bench.start_run()
        assert bench.run(0.001).subject == 0
    with Stimulator.simulate(link, subject=4, finger=[(0, 0, 1), (1, 0, 1)]) as bench:
        assert bench.run(0.001).subject == 4


@pytest.mark.parametrize(
    ("cof", "says"),
    [(0.3, ""), (2.0, "2 was commanded, and this fi"), (0.05, "0.05 was commanded, and this fi")],
)
def test_a_trace_shows_that_its_cof_was_out_of_reach(cof: float, says: str) -> None:
    with Stimulator.simulate("local", subject=2) as bench:
        bench.finger.stroke(2)
        bench.start_run()
        bench.tare()
        bench.amplitude = 1.0
        bench.cof = cof
        bench.mode = "friction"
        trace = bench.run(0.5)
    assert says in trace.shortfall
    assert bool(trace.shortfall) == bool(says)
    if says:
        had = re.search(r"had (\d\.\d\d) to (\d\.\d\d): command that", trace.shortfall)
        assert had is not None
        low, high = map(float, had.groups())
        assert not low <= cof <= high
        assert high == pytest.approx(np.nanquantile(trace.cof, 0.95), abs=0.02)
    limited = np.count_nonzero(trace.status & Status.LIMITED)
    shown = f" {limited} limited; {trace.shortfall}>" if says else f" {limited} limited>"
    assert repr(trace).endswith(shown)


def test_repr_of_stimulator_and_trace() -> None:
    with Stimulator.simulate("local") as bench:
        trace = bench.run(0.05, experiment="trial.1", subject=2)
        assert repr(bench) == "<Stimulator over the local link>"
    assert (
        repr(trace) == "<Trace 'trial.1' of subject 2: 50 rows, ticks 0..49 ms, 0 lost, 0 limited>"
    )
    with Stimulator.simulate("bus") as bench:
        assert repr(bench) == "<Stimulator over the local bus>"


@pytest.mark.parametrize(
    ("presets", "error", "text"),
    [
        ({"Setpoint.Voltag": 1}, BenchError, "no object 'Setpoint.Voltag', perhaps Setpoint.Volt"),
        ({"Setpoint.Voltage": 100_000}, ValueError, "100000 is above 20000: give 0 to 20000$"),
        ({"Setpoint.Voltage": 0.5}, ValueError, r"0\.5 is no integer: give a whole"),
        ({"Limit.Lowest frequency": 4_450_000}, ValueError, "are refused at power-on: abort 0"),
        (
            {"Setpoint.Voltage": "800 V"},
            ValueError,
            "^preset Setpoint.Voltage 800 V is above 200 V: give 0 to 200 V$",
        ),
        ({"Setpoint.Voltage": "80 N"}, ValueError, "'80 N' is no number with a unit like mV$"),
        (
            {"Setpoint.Amplitude": "1 pm"},
            ValueError,
            "^preset Setpoint.Amplitude 1 pm would become 0",
        ),
        ({"Message": "hello"}, BenchError, "^Message is not a number"),
        ({1: 1}, BenchError, "^there is no object 1$"),
        ("Setpoint.Voltage", ValueError, "^presets 'Setpoint.Voltage' are no mapping of names to"),
    ],
)
def test_a_preset_that_is_none(presets: dict[str, Any], error: type[Exception], text: str) -> None:
    for link in LINKS:
        with pytest.raises(error, match=text):
            Stimulator.simulate(link, presets=presets)


@pytest.mark.parametrize("link", LINKS)
def test_a_preset_is_a_raw_value_or_a_text_with_a_unit(link: LinkName) -> None:
    presets: dict[str, int | str] = {"Setpoint.Amplitude": "800 nm", "Setpoint.Voltage": 1234}
    with Stimulator.simulate(link, presets=presets) as bench:
        assert (bench.amplitude, bench.voltage) == (0.8, 12.34)


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_dir_lists_public_attributes_only(bench: Stimulator) -> None:
    names = dir(bench)
    assert [name for name in names if name.startswith("_")] == []
    assert {"amplitude", "connect", "finger", "mode", "record", "run", "simulate"} <= set(names)


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_a_finger_shows_itself_with_units(bench: Stimulator) -> None:
    finger = bench.finger
    finger.stroke(2, force=0.5, speed=61.25, travel=12.34, force_variation=0.2)
    finger.surroundings(seed=7, temperature=23.0)
    assert repr(finger) == (
        "<SimulatedFinger: subject 2, 0.500 N +-20 %, 61.2 mm/s +-0 %, travel 12.3 mm; "
        "seed 7, 23.0 degC, drive instant 0 us>"
    )
    finger.lift()
    assert repr(finger).startswith("<SimulatedFinger: lifted; seed 7, ")
    bench.close()
    assert repr(finger).startswith("<SimulatedFinger: the stimulator over ")
    assert repr(finger).endswith(" is closed: connect anew>")


def test_a_bench_without_a_with_is_left_at_0_v() -> None:
    block = simulated_block({})
    bench = Stimulator(LocalLink(block), block.od)
    bench.voltage = 40.0
    bench.tare()
    bench.mode = "open_loop"
    assert bench.run(0.02).voltage_v[-1] == pytest.approx(40.0)
    bench.close()
    assert (block.state, block.od["Mode"].value) == (State.READY, Mode.OFF)
    bench.close()


@pytest.mark.parametrize("link", LINKS)
def test_a_bench_that_is_closed_refuses_whatever_is_asked(link: LinkName) -> None:
    with Stimulator.simulate(link) as bench:
        bench.run(0.2)
        bench.close()
        for ask in (bench.read, bench.arm, lambda: bench.run(0.1), lambda: bench.get("Mode")):
            with pytest.raises(BenchError, match=r"^the stimulator over the local .* is closed"):
                ask()
    assert repr(bench).startswith("<Stimulator over the local ")


def test_each_public_attribute_has_a_docstring() -> None:
    """The Python reference omits names with only the docstring of their type."""
    public = {name: value for name, value in vars(Stimulator).items() if not name.startswith("_")}
    assert {"cof", "law", "run", "texture", "voltage"} <= set(public)
    for name, value in public.items():
        if name not in Stimulator.__slots__:
            assert value.__doc__ and value.__doc__ != type(value).__doc__, name


def test_a_misspelt_property_is_an_error() -> None:
    with Stimulator.simulate("local") as bench, pytest.raises(AttributeError, match="amplitud"):
        bench.amplitud = 1.0  # type: ignore[attr-defined]


DISARM = r": it is armed or running, disarm\(\) first$"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("Limit.Voltage", "100 V"),
        ("Calibration.Fx from S1", 0.5),
        ("Model.Tau", "2 ms"),
        ("Gauge zero.Zero of S1", "1 N"),
    ],
)
def test_refusal_while_armed_names_the_next_step(
    bench: Stimulator, name: str, value: float | str
) -> None:
    bench.set("Limit.Voltage", "80 V")
    bench.arm()
    with pytest.raises(RefusedError, match=rf"to {name}: abort 08000022: .*{DISARM}"):
        bench.set(name, value)
    with pytest.raises(RefusedError, match=r"^Limit.Voltage 300 V is above 200 V"):
        bench.set("Limit.Voltage", "300 V")
    bench.disarm()
    bench.set(name, value)


@pytest.mark.parametrize("mode", ["off", "open_loop"])
def test_tare_while_armed_or_running_names_the_next_step(bench: Stimulator, mode: str) -> None:
    bench.arm()
    if mode != "off":
        bench.mode = mode
    with pytest.raises(RefusedError, match=f"^cannot tare{DISARM}") as refusal:
        bench.tare()
    assert refusal.value.code == 0x08000022
    bench.disarm()
    bench.tare()


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_tare_under_a_latched_force_fault_names_the_fault(bench: Stimulator) -> None:
    bench.set("Limit.Normal force", "1 N")
    bench.tare()
    bench.finger.stroke(2, force=1.5, speed=50.0)
    bench.start_run()
    bench.voltage = 20
    bench.mode = "open_loop"
    with pytest.raises(FaultError):
        bench.run(0.5)
    with pytest.raises(FaultError, match=r"^a fault is latched \(the normal force is above"):
        bench.tare()


@pytest.mark.parametrize("link", LINKS)
def test_injected_fault_out_of_range_is_refused_with_its_range(link: LinkName) -> None:
    with Stimulator.simulate(link, plate_inside=True) as bench:
        bench.set("Fault.Value", 20_001)
        ranges = r"a Fault\.Sensor of 1 to 10 and a Fault\.Value of -10000 to 10000$"
        with pytest.raises(RefusedError, match=rf": gain is for {ranges}"):
            bench.set("Fault.Kind", FaultKind.GAIN)
        with pytest.raises(RefusedError, match=r"^Fault\.Kind 13 is above 12: give 0 to 12 "):
            bench.set("Fault.Kind", 13)


@pytest.mark.parametrize("seconds", [0.001, 0.0499, 0.25])
def test_a_run_has_a_row_a_millisecond(bench: Stimulator, seconds: float) -> None:
    trace = bench.run(seconds, "some.label", 3)
    assert (trace.experiment, trace.subject, len(trace)) == ("some.label", 3, round(1e3 * seconds))
    assert trace.tick.tolist() == list(range(len(trace)))
    assert bench.run(0.01).tick[0] == len(trace), "the next run goes on"


@pytest.mark.parametrize("mode", ["open_loop", "amplitude", "amplitude_resonance", "friction"])
def test_run_drives_after_one_cycle_at_0_v(bench: Stimulator, mode: str) -> None:
    bench.run(0.07)
    bench.voltage, bench.amplitude = 20.0, 1.0
    bench.start_run()
    bench.mode = mode  # type: ignore[assignment]
    at_once = bench.run(0.1)
    assert (bench.state, bench.mode) == (State.RUNNING, Mode[mode.upper()])
    assert at_once.voltage_v[0] == 0
    assert (at_once.voltage_v[1:] > 0).all()
    bench.start_run()
    bench.run(0.001)
    bench.mode = mode  # type: ignore[assignment]
    later = bench.run(0.099)
    # In the first row the statusword is still that of before.
    assert at_once.counts[1:, :-1].tolist() == later.counts[:, :-1].tolist()


def test_a_run_that_begins_at_0_v_anyway_is_in_its_mode_at_once(bench: Stimulator) -> None:
    bench.run(0.07)
    bench.cof = 0.35
    bench.start_run()
    bench.mode = "friction"
    trace = bench.run(0.01)
    assert trace.cof_reference.tolist() == pytest.approx([0.35] * 10)
    assert trace.voltage_v[0] == 0


def test_a_reading_has_all_in_its_unit(bench: Stimulator) -> None:
    bench.finger.stroke(4, force=0.8)
    bench.finger.surroundings(seed=1, temperature=25.0)
    bench.start_run()
    bench.tare()
    bench.frequency = 43_320.0
    bench.amplitude = 0.8
    bench.mode = "amplitude resonance"
    trace = bench.run(0.5)
    reading = bench.read()
    assert reading.mode is Mode.AMPLITUDE_RESONANCE
    assert str(reading.status) == "7"
    assert repr(reading.status) == "<Status.LIVE|DRIVING|TOUCHING: 7>"
    assert f"; COF {reading.cof:.4f} at {reading.position:.2f} mm, " in repr(reading)
    assert reading.state is State.RUNNING
    assert reading.amplitude == pytest.approx(0.8, abs=0.05)
    assert reading.normal_force == pytest.approx(0.8, abs=0.1)
    assert reading.temperature == pytest.approx(25.0, abs=0.3)
    assert reading.frequency == pytest.approx(43_320.0, abs=60.0)
    assert 5.0 < reading.voltage < 100.0
    assert abs(reading.position) <= 10.5
    assert reading.cof == pytest.approx(reading.tangential_force / reading.normal_force, abs=0.01)
    # In lockstep the last row and the reading are of the same cycle.
    assert reading.amplitude == pytest.approx(trace.amplitude_um[-1])
    assert reading.cof == pytest.approx(trace.cof[-1])


def test_without_a_finger_there_is_no_cof(bench: Stimulator) -> None:
    bench.run(0.2)
    assert isnan(bench.read().cof)
    assert isnan(bench.read().position)  # the node publishes 0


@pytest.mark.parametrize("link", LINKS)
def test_a_sample_has_a_row_of_another_cycle_each_time(link: LinkName) -> None:
    with Stimulator.simulate(link) as bench:
        bench.run(0.05)
        samples = bench.sample(["Contact.Tick", "Plate input.S1"], 20)
        assert samples.shape == (20, 2)
        assert samples[:, 0].tolist() == list(range(50, 70))
        assert 2.0 < samples[:, 1].std() < 9.0  # mN
        assert bench.get("Cycle.Cycles") == 70


def test_surroundings_keep_values_not_given() -> None:
    with Stimulator.simulate("local", seed=7) as bench:
        names = ("Simulation.Seed", "Simulation.Ambient temperature", "Simulation.Drive instant")
        for given, expected in (
            ({"temperature": 30.0}, [7, 30, 0]),
            ({"seed": 9}, [9, 30, 0]),
            ({"drive_instant": 120.0}, [9, 30, 120]),
            ({"drive_instant": 0.0, "temperature": 0.0, "seed": 0}, [0, 0, 0]),
        ):
            bench.finger.surroundings(**given)
            assert [bench.get(name) for name in names] == expected


@pytest.mark.parametrize("inside", [True, False])
def test_the_age_of_a_reading_is_that_of_its_oldest_value(inside: bool) -> None:
    with Stimulator.simulate("bus", plate_inside=inside) as bench:
        with pytest.raises(NotRunningError, match="has not been published yet"):
            bench.read()
        bench.run(0.15)
        # The status goes out on change, and each 100 ms: the tare has changed it last.
        assert 0.07 < bench.read().age < 0.09
        bench.run(0.01)
        assert 0.08 < bench.read().age <= 0.1
    with Stimulator.simulate("local") as bench:
        bench.run(0.01)
        assert bench.read().age == 0.0


def scripted(bench: Stimulator, ticks: list[int]) -> None:
    """Have a run get rows of these ticks."""
    rows = [(tick, 0, 0, 0, 0, 0, 0, 0) for tick in ticks]
    bench._link.run = lambda _cycles, into, _interrupted=None: into.extend(rows)  # type: ignore[method-assign]


def test_ticks_go_on_rising_beyond_16_bits() -> None:
    with Stimulator.simulate("local") as bench:
        scripted(bench, [65_533, 65_535, 0, 1, 40_000, 65_535, 3])
        expected = [65_533, 65_535, 65_536, 65_537, 105_536, 131_071, 131_075]
        assert bench.run(0.007).tick.tolist() == expected


def test_a_run_of_which_most_is_lost() -> None:
    with Stimulator.simulate("local") as bench:
        scripted(bench, [0, 1, 2])
        assert bench.run(0.006).lost == 0
        with pytest.raises(NotRunningError, match=r"4 of 7 cycles were lost: is this machine"):
            bench.run(0.007)


def test_a_run_of_which_most_is_lost_names_the_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    with Stimulator.simulate("local") as bench:
        scripted(bench, [0, 1, 2])
        monkeypatch.setattr(Stimulator, "state", State.FAULT)
        with pytest.raises(FaultError) as caught:
            bench.run(0.007)
        assert len(caught.value.trace) == 3
        monkeypatch.undo()


def test_a_quick_stop_ends_a_run_and_changes_nothing_at_rest(bench: Stimulator) -> None:
    bench.quick_stop()
    bench.finger.lift()
    bench.start_run()
    bench.tare()
    assert bench.state is State.READY
    bench.quick_stop()
    assert bench.state is State.READY
    bench.voltage = 20
    bench.mode = "open_loop"
    bench.run(0.01)
    bench.quick_stop()
    assert bench.state is State.QUICK_STOP
    assert not bench.run(0.01).voltage_v[1:].any()
    bench.disarm()
    assert bench.state is State.READY


def test_identify(bench: Stimulator) -> None:
    bench.finger.surroundings(seed=2, temperature=30.0)
    bench.start_run()
    bench.tare()
    bench.frequency = 43_250.0
    steps: list[int] = []
    model = bench.identify(steps.append)
    assert model.f0 == pytest.approx(43_250.0, abs=2.0)
    assert model.tau == pytest.approx(0.944e-3, rel=0.02)
    assert model.gain == pytest.approx(50e-9, rel=0.02)
    assert bench.get("Model.Temperature", "degC") == pytest.approx(30.0, abs=0.2)
    assert bench.mode is Mode.OFF
    assert bench.message == ""
    assert steps == sorted(steps)
    assert steps[-1] == 100


def test_identify_says_that_a_finger_is_on_the_plate(bench: Stimulator) -> None:
    bench.run(0.07)
    bench.finger.stroke(1)
    bench.start_run()
    bench.run(0.4)
    with pytest.raises(BenchError, match=r"loaded with 0\.\d\d N\): lift the finger, tare"):
        bench.identify()
    assert bench.mode is Mode.OFF
    assert "loaded" in bench.message
    bench.run(0.01)
    assert bench.read().voltage == 0.0


def test_identify_says_that_somebody_stopped_it(bench: Stimulator) -> None:
    bench.run(0.07)
    with pytest.raises(BenchError, match=r"could not be identified \(it was stopped\)"):
        bench.identify(lambda _progress: bench.disarm())


def test_identify_says_that_a_fault_ended_it(bench: Stimulator) -> None:
    bench.run(0.07)
    stick(bench, delay=150)
    with pytest.raises(FaultError, match=r"^a fault is latched \(a sensor is stuck\): remove"):
        bench.identify()


@pytest.mark.parametrize("percent", [50, 100])
def test_identify_hides_no_fault_behind_its_model(percent: int) -> None:
    done: list[int] = []

    def trip(progress: int) -> None:
        done.append(progress)
        if progress >= percent:
            block.observe(Watchdog.HEARTBEAT, True)

    with Stimulator.simulate("local") as bench:
        bench.run(0.07)
        block = bench._link._block  # type: ignore[attr-defined]
        with pytest.raises(FaultError, match="the heartbeat of a supervised node is lost"):
            bench.identify(trip)
    assert [progress >= percent for progress in done].count(True) == 1, "at once"


def stick(bench: Stimulator, delay: int = 0) -> None:
    """Have S3 stuck, which trips a watchdog in 24 cycles while armed."""
    bench.set("Fault.Sensor", 3)
    bench.set("Fault.Delay in cycles", delay)
    bench.set("Fault.Kind", FaultKind.STUCK)


def drive(bench: Stimulator) -> None:
    """Drive at 20 V; time for a sensor to move again, and no fault that is known, go before."""
    bench.set("Fault.Kind", FaultKind.NONE)
    bench._link.run(100, [])
    bench.reset_fault()
    bench.voltage = 20.0
    bench.mode = "open_loop"


def test_a_run_says_that_it_ended_in_a_fault(bench: Stimulator) -> None:
    for _ in range(2):
        drive(bench)
        stick(bench, delay=50)
        with pytest.raises(
            FaultError, match=r"\(a sensor is stuck\): .*; \.trace holds the rec"
        ) as e:
            bench.run(0.1, "broken", 3)
        trace = e.value.trace
        assert trace is not None
        assert (trace.experiment, trace.subject, len(trace)) == ("broken", 3, 100)
        assert (trace.voltage_v[0], trace.voltage_v[-1]) == (20, 0)
        assert not bench.run(0.1).voltage_v.any(), "told once"


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_fault_seen_by_reading_the_state_is_not_raised_again(bench: Stimulator) -> None:
    drive(bench)
    stick(bench)
    bench._link.run(30, [])
    assert bench.state is State.FAULT
    bench.run(0.01)
    bench.run(0.01)


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_fault_that_refused_an_arm_is_not_raised_again(bench: Stimulator) -> None:
    drive(bench)
    stick(bench)
    bench._link.run(30, [])
    with pytest.raises(FaultError) as e:
        bench.mode = "amplitude"
    assert e.value.trace is None
    bench.run(0.01)


def reset_by_another(bench: Stimulator) -> None:
    for word in (0, Control.FAULT_RESET, 0):
        bench._link.write("Controlword", word)
    assert bench.state is State.READY


@pytest.mark.parametrize("reset", [Stimulator.reset_fault, reset_by_another])
def test_another_fault_has_to_be_told_again(
    bench: Stimulator, reset: Callable[[Stimulator], None]
) -> None:
    drive(bench)
    stick(bench)
    bench._link.run(30, [])
    assert bench.state is State.FAULT
    bench.set("Fault.Kind", FaultKind.NONE)
    bench.run(0.1)
    reset(bench)
    for word in (Control.ARM, Control.ARM | Control.RUN):
        bench._link.write("Controlword", word)
    stick(bench)
    with pytest.raises(FaultError):
        bench.run(0.1)


def test_tare(bench: Stimulator) -> None:
    bench.set("Tare at power-on", 0)
    bench.start_run()
    bench.run(0.01)
    offset = bench.get("Contact.Force x")
    assert abs(offset) > 30, "mN"
    bench.tare()
    bench.run(0.01)
    assert abs(bench.get("Contact.Force x")) < 30


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_a_finger_takes_texts_with_units(bench: Stimulator) -> None:
    bench.finger.stroke(2, force="600 mN", speed="0.1 m/s", travel="1e4 um", force_variation="20 %")
    bench.finger.surroundings(temperature="30 degC", drive_instant="0.1 ms")
    assert bench.get("Finger.Force", "N") == 0.6
    assert bench.get("Finger.Speed", "mm/s") == 100.0
    assert bench.get("Finger.Range", "mm") == 10.0
    assert bench.get("Finger.Force variation", "%") == 20.0
    assert bench.get("Simulation.Ambient temperature", "degC") == 30.0
    assert bench.get("Simulation.Drive instant", "us") == 100.0


@pytest.mark.parametrize("inside", [True, False])
def test_presets_of_the_simulation_are_the_same_on_a_bus(inside: bool) -> None:
    presets = {"Simulation.Seed": 5, "Simulation.Ambient temperature": 2600, "Finger.Motion": 1}
    traces = []
    for options in ({}, {"presets": presets}):
        with (
            Stimulator.simulate("local", **options) as local,
            Stimulator.simulate("bus", plate_inside=inside, **options) as bus,
        ):
            seeds = {bench.get("Simulation.Seed") for bench in (local, bus)}
            assert seeds == {5.0 if options else 1.0}
            one, other = local.run(0.2), bus.run(0.2)
            assert one.normal_force_n.tolist() == other.normal_force_n.tolist()
            traces.append(one)
    assert traces[0].normal_force_n.tolist() != traces[1].normal_force_n.tolist()


@pytest.mark.parametrize(
    ("before", "error"),
    [
        (("Controlword", 1), NotReadyError),
        (("Mode", 1), FaultError),
        (("Controlword", 3), FaultError),
    ],
)
def test_watchdog_before_running_is_the_reason_of_the_refusal(
    before: tuple[str, int], error: type[BenchError], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Stimulator.simulate("local") as bench:
        bench.run(0.1)
        link = bench._link
        write = link.write

        def trip_and_write(name: str, raw: int) -> None:
            if (name, raw) == before:
                link._block.observe(Watchdog.HEARTBEAT, True)  # type: ignore[attr-defined]
            write(name, raw)

        with monkeypatch.context() as patch:
            patch.setattr(link, "write", trip_and_write)
            with pytest.raises(error, match="the heartbeat of a supervised node is lost"):
                bench.mode = "open_loop"


@pytest.mark.parametrize(
    ("presets", "message"),
    [
        (
            {},
            r"not tared: S\d reads -?\d+ mN, more than 60 mN from its null of -?\d+ mN: lift what "
            "rests on the plate, and tare$",
        ),
        (
            {"Gauge null.Window": 1500} | {f"Gauge null.Null of S{n}": 0 for n in range(1, 7)},
            "the gauges contradict each other; a zero taken under a finger, as one at power-on or "
            r"reset may be, does this too: lift it, then tare\(\)$",
        ),
    ],
    ids=["nulls known", "never calibrated"],
)
def test_a_reset_under_a_finger_is_told_with_its_cure(
    presets: dict[str, int], message: str
) -> None:
    with Stimulator.simulate(presets=presets) as bench:
        bench.finger.stroke(2, speed=60.0)
        bench.start_run()
        bench.run(1.5)
        assert bench.read().normal_force > 0.4
        link: Any = bench._link
        link._network.send_message(0, bytes((0x81, 32)))
        link._network.send_message(0, bytes((0x01, 32)))
        for _ in range(300):
            link._network.send_message(0x80, b"")
        with pytest.raises(NotReadyError, match=message):
            bench.arm()
        bench.finger.lift()
        bench.start_run()
        bench.tare()
        bench.arm()
        assert bench.state is State.ARMED


@pytest.mark.parametrize("link", ["local", "bus"])
def test_the_finger_of_a_trace_is_played_again(link: Any) -> None:
    def played(finger: Any) -> Trace:
        with Stimulator.simulate(link, subject=2, finger=finger) as bench:
            bench.start_run()
            return bench.run(1.0)

    first = played([(0.3, -10, -0.004), (0.4, -10, 0.5), (0.8, 10, 0.5), (0.9, 10, 0)])
    again = played(first)
    touch = ~np.isnan(first.position_mm) & ~np.isnan(again.position_mm)
    assert np.count_nonzero(touch) > 500
    pressed = touch & (first.time_s > 0.4) & (first.time_s < 0.8)
    # What is measured lags by some 4 ms, at 50 mm/s.
    assert np.abs(first.position_mm - again.position_mm)[pressed].max() < 1.0
    assert np.abs(first.normal_force_n - again.normal_force_n)[touch].max() < 0.05
    with pytest.raises(ValueError, match=r"^finger: nothing touches in this trace"):
        played(Trace("air", 0, first.counts[:100]))
    with pytest.raises(ValueError, match=r"normal force -0\.02 N is below -0\.01 N: give -0\.01 t"):
        played([(0, 0, -0.02), (1, 0, 1)])


PRESS = [(0.3, -10, 0), (0.4, -10, 0.5), (0.8, 10, 0.5), (0.9, 10, 0)]


@pytest.mark.parametrize(("link", "inside"), [("local", False), ("bus", True), ("bus", False)])
def test_a_finger_of_ones_own_is_played(link: Any, inside: bool) -> None:
    with Stimulator.simulate(link, plate_inside=inside, finger=PRESS) as bench:
        bench.start_run()
        bench.tare()
        trace = bench.run(1.0)
    touched = ~np.isnan(trace.position_mm)
    first, last = trace.time_s[touched][[0, -1]]
    assert 0.3 < first < 0.4
    assert 0.8 < last < 0.92
    assert abs(trace.position_mm[touched][0] + 10) < 0.5
    assert abs(trace.position_mm[touched][-1] - 10) < 0.5
    assert abs(trace.normal_force_n[(trace.time_s > 0.5) & (trace.time_s < 0.7)] - 0.5).max() < 0.05


@pytest.mark.parametrize(
    ("finger", "text"),
    [
        (PRESS[:1], "1 samples of a trajectory are fewer than 2"),
        (PRESS[::-1], "is not after the one before"),
        ([(0, 39, 0), (1, 0, 0)], "sample 0 position 39 mm is above 38 mm: give -38 to 38 mm$"),
        ([(0, 0, 0), (1, 0, 11)], "sample 1 normal force 11 N is above 10 N: give -0.01 to 10 N$"),
        ([0.1, 0.2], "^finger sample 0 0.1 is no list$"),
        ([(0, 0), (1, 0)], "three numbers$"),
        ("ab", "^finger 'ab' is no list$"),
    ],
)
def test_a_finger_that_is_none_is_refused(finger: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Stimulator.simulate("local", finger=finger)
