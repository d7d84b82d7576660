"""A wrong argument is refused in one line that says so, and changes nothing."""

import copy
import pickle
from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smarttac_can.bench import (
    BenchError,
    Placing,
    RefusedError,
    State,
    Stimulator,
    Texture,
    Trace,
    UnknownChannelError,
    VibrationLaw,
    make_recording,
    read_csv,
    read_plan,
    read_recording,
    sha256,
    stimulator_od,
    write_csv,
)

TRACE = Trace.from_rows("a", 0, [(k, *range(9)) for k in range(3)])
Act = Callable[[Any], object]


def simulated(**options: Any) -> Stimulator:
    return Stimulator.simulate("local", **options)


def puts(name: str, value: Any) -> Act:
    return lambda bench: setattr(bench, name, value)


def writes(name: str, value: Any) -> Act:
    return lambda bench: bench.set(name, value)


def raw(name: str, value: int) -> Act:
    return lambda bench: bench._link.write(name, value)


def runs(*arguments: Any, **labels: Any) -> Act:
    return lambda bench: bench.run(*arguments, **labels)


def samples(names: Any, count: Any) -> Act:
    return lambda bench: bench.sample(names, count)


def strokes(*arguments: Any, **options: Any) -> Act:
    return lambda bench: bench.finger.stroke(*arguments, **options)


def surrounds(**options: Any) -> Act:
    return lambda bench: bench.finger.surroundings(**options)


BY_ZERO = ("voltage", "amplitude", "boundary")
"""Set-points that may be 0."""
SENSELESS: list[tuple[Act, str]] = [
    # Another kind of unit, or none.
    (
        writes("Setpoint.Voltage", "80 N"),
        "^Setpoint.Voltage '80 N' is no number with a unit like mV$",
    ),
    (writes("Mode", "off"), "^Mode 'off' is no number or percentage$"),
    (lambda bench: bench.get("Setpoint.Voltage", "N"), "^Setpoint.Voltage has no unit 'N': give"),
    (lambda bench: bench.get("Setpoint.Voltage", 5), "^Setpoint.Voltage has no unit 5: give"),
    (puts("voltage", "20"), "^voltage '20' is no number with a unit like V$"),
    (puts("cof", ("30 %", "1 N")), "^cof right '1 N' is no number or percent"),
    # Not finite, or no number.
    (puts("voltage", float("nan")), "nan is not a finite number"),
    (puts("voltage", None), "^voltage None is not a finite number"),
    (puts("voltage", 10**400), "^voltage 10+... is not a finite number$"),
    (puts("voltage", 10**5000), "^voltage of type int is not a finite number$"),
    (puts("cof", None), "cof None is not a finite number"),
    (puts("cof", (1, 2, 3)), r"cof \(1, 2, 3\) is neither a"),
    (puts("cof", np.array([0.3])), r"cof array\(\[0.3\]\) is neither a"),
    (puts("cof", {0.3, 0.4}), r"^cof \{0\.\d, 0\.\d\} is no list$"),
    (puts("cof", np.ma.masked), "^cof masked is not a finite number$"),
    (puts("cof", np.ma.array([0.3, 0.4], mask=[0, 1])), "^cof right masked is not a finite"),
    (puts("amplitude", 1j), "^amplitude 1j is not a finite number$"),
    # A boolean is no number, and a number with a point no integer.
    (puts("cof", True), "^cof True is not a finite number$"),
    (puts("cof", (0.3, np.True_)), "^cof right np.True_ is not a finite number$"),
    (puts("voltage", False), "^voltage False is not a finite number$"),
    (writes("Setpoint.Voltage", True), "^Setpoint.Voltage True is not a finite number$"),
    (puts("mode", True), "^mode True is none of off, open_loop"),
    (puts("mode", 1.0), "^mode 1.0 is none of off, open_loop"),
    (puts("mode", State.RUNNING), "^mode <State.RUNNING: 3> is none of off, open_loop"),
    (puts("texture_slot", 1.0), "^texture_slot 1.0 is no integer: give a whole number$"),
    # Choices.
    (puts("mode", 9), "mode 9 is none of off, open_loop"),
    (puts("mode", "fast"), "mode 'fast' is none of off, open_loop, amplitude"),
    (puts("law", None), "law None is none of measured, accumulate, nominal, predictive"),
    (puts("vibration_law", "lqr"), "^vibration law 'lqr' is none of pi, scheduled, pred"),
    # Values that would be rounded to nothing.
    (puts("voltage", "80 nV"), "^voltage 80 nV would become 0: it goes in steps of 10 mV"),
    *((puts(name, 1e-9), f"^{name} 1e-09 .* would become 0") for name in BY_ZERO),
    (writes("Setpoint.Voltage", 4), "^Setpoint.Voltage 4 mV would become 0: it goes in steps of"),
    (puts("cof", (0.3, 1e-6)), r"^cof right 1e-06 is below 0\.05, its"),
    (puts("cof", "0.0001 %"), "^cof 0.0001 % is below 5 %, its lowest value$"),
    (writes("Limit.Voltage", -1), "^Limit.Voltage -1 mV is below 0 mV, its lowest value$"),
    # Runs and samples.
    (runs(4e-4), r"^seconds 0\.0004 s is below 0\.001 s: give 0\.001 to 604800 s$"),
    (runs("0 ms"), "^seconds 0 ms is below 1 ms: give 1 to 604800000 ms$"),
    (runs(604_801), r"^seconds 604801 s is above 604800 s: give 0\.001 to 604800 s$"),
    (runs("1"), "^seconds '1' is no number with a unit like s$"),
    (runs(0.1, meanwhile=3), "^meanwhile 3 is no function$"),
    (lambda bench: bench.identify(3), "^progress 3 is no function$"),
    (runs(0.1, experiment="Trial-1"), "^experiment 'Trial-1' is not made of a-z 0-9 . _$"),
    (runs(0.1, experiment=None), "^experiment None is not made of a-z 0-9 . _$"),
    (runs(0.1, experiment=101 * "x"), "^experiment of 101 characters is outside 1..100$"),
    (runs(0.1, subject=-1), "^subject -1 is below 0: give 0 to 2147483647$"),
    (runs(0.1, subject=True), "^subject True is no integer: give a whole number$"),
    (samples(["Plate input.S1"], 0), "^count 0 is below 1: give 1 to 1000000$"),
    (samples("Plate input.S1", 3), r"^names 'Plate input\.S1' is no list$"),
    (samples([], 3), r"^names \[\] has no name of an object$"),
    (lambda bench: bench.set_all([1]), r"^values \[1\] are no mapping of names to values$"),
    (lambda bench: bench.nearest("Mode", "2 V"), "^Mode '2 V' is no number or percentage$"),
    # The finger.
    (strokes(1.5), r"^subject 1\.5 is no integer: give a whole number$"),
    (strokes(3, force="500"), "^force '500' is no number with a unit like N$"),
    (surrounds(seed=1.5), r"^seed 1\.5 is no integer: give a whole number$"),
    (lambda bench: bench.finger.put(Placing("200", 0, 0, 0)), "^mass_g '200' is not a finite"),
    (lambda bench: bench.finger.put(Placing(200, 0, 0, 0), "9.8"), "^gravity '9.8' is not a f"),
    (
        surrounds(seed=9, drive_instant="1 V"),
        "^drive_instant '1 V' is no number with a unit like us$",
    ),
]
"""Calls for which a script gets a ValueError."""
UNKNOWN: list[tuple[Act, str]] = [
    (lambda bench: bench.get("Setpoint.Amp"), r"no object 'Setpoint.Amp', perhaps Setpoint.Ampl"),
    (writes("Nonsense", 1), r"there is no object 'Nonsense'$"),
    (lambda bench: bench.get("Message"), r"^Message is not a number: it is the text in \.message$"),
]
REFUSED: list[tuple[Act, str]] = [
    (
        writes("Setpoint.Voltage", 200_010),
        "^Setpoint.Voltage 200010 mV is above 200000 mV: give 0 to 200000 mV "
        r"\(abort 06090031: value written too high\)$",
    ),
    (writes("Setpoint.Voltage", -10), "abort 06090032: value written too low"),
    (writes("Limit.Lowest frequency", 44_500), "abort 06090030: invalid value for parameter"),
    (
        lambda bench: bench.set_all({"Fault.Sensor": 10, "Fault.Value": 0, "Fault.Kind": 1}),
        "^cannot write 1 to Fault.Kind: .*: stuck is for a Fault.Sensor of 1 to 9 and a",
    ),
    (writes("Statusword", 1), "abort 06010002: attempt to write a read only object"),
    (
        lambda bench: bench.finger.play_recording(),
        r"abort 08000022: .*started without a recording: give simulate finger=, or the node",
    ),
    (raw("Setpoint.Voltage", -1), "^Setpoint.Voltage -10 mV is below 0 mV: give 0 to 200000 mV"),
    (raw("Mode", 9), r"^Mode 9 is above 6: give 0 to 6 \(abort 06090031: value written too high"),
    # In the unit and the words of the caller.
    (puts("voltage", 250), r"^voltage 250 V is above 200 V: give 0 to 200 V \(Setpoint.Voltage: a"),
    (puts("voltage", "0.25 kV"), "^voltage 0.25 kV is above 0.2 kV: give 0 to 0.2 kV "),
    (puts("boundary", "10 cm"), "^boundary 10 cm is above 3.8 cm: give -3.8 to 3.8 cm "),
    (puts("amplitude", "20 um"), "^amplitude 20 um is above 3 um: give 0 to 3 um "),
    (puts("frequency", "1 MHz"), "^frequency 1 MHz is above 0.045 MHz: give 0.042 to 0.045 MHz "),
    (puts("cof", 5), "^cof 5 is above 2: give 0.05 to 2 "),
    (puts("cof", "500 %"), "^cof 500 % is above 200 %: give 5 to 200 % "),
    (writes("Limit.Lowest frequency", "44.5 kHz"), "^cannot write 44.5 kHz to Limit.Lowest freq"),
    (strokes(42), r"^subject 42 is above 9: give 1 to 9 \(Simulation.Subject: abort"),
    (surrounds(seed=-1), "^seed -1 is below 0: give 0 to 4294967295 "),
    (puts("texture_slot", 5), r"^texture_slot 5 is above 4: give 1 to 4 \(Texture.Slot: abort"),
    (strokes(3, travel=200), r"^travel 200 mm is above 50 mm: give 1 to 50 mm \(Finger.Range: a"),
    (strokes(3, force_variation=2), "^force_variation 2 is above 0.5: give 0 to 0.5 "),
    (surrounds(drive_instant="2 ms"), "^drive_instant 2 ms is above 0.999 ms: give 0 to 0.999 ms"),
    (
        lambda bench: bench.finger.put(Placing(900, 0, 0, 0)),
        "^normal force 8.826 N is above 8 N: give 0 to 8 N ",
    ),
    (
        lambda bench: bench.get("Simulation.Start run"),
        "^cannot read Simulation.Start run: abort 06010001",
    ),
    (puts("cof", (0.3, 5)), r"^cof right 5 is above 2: .*Setpoint\.COF right"),
    (strokes(3, force=0.6, speed=1000), r"^speed 1000 mm/s is above 300 mm/s: .*Finger\.Speed: a"),
    (surrounds(seed=9, temperature=1000), r"Simulation\.Ambient temperature: abort 06090031"),
    (
        lambda bench: bench.finger.put(Placing(500.0, 0.0, 0.0, 1000.0)),
        r"Weight\.Position: abort 06090031",
    ),
]
"""Values that the device refuses."""


def settings(bench: Stimulator) -> dict[str, float]:
    """Values that a refusal may not change, and the tick, which tells whether something has run."""
    groups = ("Setpoint", "Limit", "Finger", "Simulation", "Weight")
    names = [
        entry.name
        for entry in stimulator_od()
        if entry.name.partition(".")[0] in groups and "." in entry.name and entry.access == "rw"
    ]
    others = ("Contact.Tick", "Mode", "Friction law", "Statusword", "Texture.Slot")
    return {name: bench.get(name) for name in (*names, *others)}


@pytest.fixture(scope="module", params=["local", "bus"])
def refusing(request: pytest.FixtureRequest) -> Iterator[tuple[Stimulator, dict[str, float]]]:
    with Stimulator.simulate(request.param) as bench:
        bench.run(0.1)
        bench.voltage, bench.amplitude, bench.boundary, bench.cof = 20.0, 1.0, 3.0, (0.25, 0.45)
        bench.finger.lift()
        before = settings(bench)
        assert {"Simulation.Seed", "Finger.Motion", "Weight.Position"} <= set(before)
        yield bench, before


@pytest.mark.parametrize(
    ("act", "error", "message"),
    [
        *((act, ValueError, message) for act, message in SENSELESS),
        *((act, BenchError, message) for act, message in UNKNOWN),
        *((act, RefusedError, message) for act, message in REFUSED),
    ],
)
def test_refused_argument_changes_no_object(
    refusing: tuple[Stimulator, dict[str, float]],
    act: Act,
    error: type[Exception],
    message: str,
) -> None:
    bench, before = refusing
    with pytest.raises(error, match=message):
        act(bench)
    assert settings(bench) == before


@pytest.mark.parametrize(
    ("act", "text"),
    [
        (lambda: simulated(finger=[(0, 0)]), r"^finger sample 0 \(0, 0\) is no \(t_s, x_mm, Fn_N"),
        (
            lambda: simulated(finger=[(0, 100, 1), (1, 0, 1)]),
            "^finger sample 0 position 100 mm is above 38 mm: give -38 to 38 mm$",
        ),
        (lambda: simulated(finger=[("a", 1, 1)] * 2), "^finger sample 0 time 'a' is not a finite"),
        (lambda: simulated(finger=[(0, 0, 1)]), "^finger: 1 samples of a trajectory are fewer"),
        (lambda: simulated(finger=5), "^finger 5 is no list$"),
        (lambda: simulated(subject=42), "^subject 42 is above 9: give 1 to 9$"),
        (lambda: simulated(subject="1"), "^subject '1' is no integer: give a whole number$"),
        (lambda: simulated(seed=True), "^seed True is no integer: give a whole number$"),
        (
            lambda: simulated(presets={"Limit.Voltage": "300 V"}),
            "^preset Limit.Voltage 300 V is above 200 V: give 0 to 200 V$",
        ),
        (lambda: Stimulator.connect(interface="virtual", timeout="1"), "^timeout '1' is no number"),
        (lambda: Trace.from_rows("a", 1, 5), "^rows 5 is no list$"),
        (lambda: Trace.from_rows("a", 1, [1, 2]), "^the rows of a are no table of integers$"),
        (lambda: stimulator_od("32"), r"^node_id '32' is no integer of 1\.\.127$"),
        (
            lambda: Stimulator.connect(interface="virtual", node_id=None),
            "^node_id None is no integer: give a whole number$",
        ),
        (lambda: Stimulator.connect(interface=1), "^interface 1 is no name$"),
        (lambda: Stimulator.simulate("vcan"), "^link 'vcan' is none of local, bus$"),
        (lambda: Texture.profile(None), "^shape None is neither a name nor points"),
        (
            lambda: Texture.profile("ramp", 0.2, 0.4, repeats="no"),
            "^repeats 'no' is neither True nor False$",
        ),
        (lambda: Stimulator.connect(interface="virtual", lockstep=0), "^lockstep 0 is neither"),
        (lambda: Stimulator.simulate("local", plate_inside="no"), "^plate_inside 'no' is neither"),
        (
            lambda: Stimulator.simulate("local", log=print),
            r"^there is no bus whose frames could go to log: simulate\('bus'\)$",
        ),
        (
            lambda: Stimulator.simulate("bus", log="x.log"),
            "^log 'x.log' is no function of a time stamp and a frame$",
        ),
    ],
)
def test_refused_argument_names_value_and_bound(act: Callable[[], object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        act()


@pytest.mark.parametrize(
    ("name", "value", "held"),
    [
        ("cof", np.array(0.35), (0.35, 0.35)),
        ("cof", np.ma.array(0.35), (0.35, 0.35)),
        ("cof", Decimal("0.35"), (0.35, 0.35)),
        ("cof", np.array([0.3, 0.4]), (0.3, 0.4)),
        ("amplitude", np.array(1.0), 1.0),
        ("voltage", np.int64(20), 20.0),
        ("boundary", "2 cm", 20.0),
        ("texture_slot", np.int64(2), 2),
        ("vibration_law", np.array("scheduled"), VibrationLaw.SCHEDULED),
    ],
)
def test_numbers_of_numpy_are_taken_as_set_points(name: str, value: Any, held: Any) -> None:
    with simulated() as bench:
        setattr(bench, name, value)
        assert getattr(bench, name) == held
        assert bench.nearest("Setpoint.Voltage", "80.003 V") == 80_000.0


@pytest.mark.parametrize("copied", [pickle.dumps, copy.copy, copy.deepcopy])
def test_bench_and_its_parts_cannot_be_copied_or_pickled(copied: Act, tmp_path: Path) -> None:
    with simulated() as bench:
        for one in (bench, bench.finger, bench.events(), bench.record(tmp_path / "a.h5")):
            with pytest.raises(TypeError, match=r"cannot be copied or pickled: it belongs to this"):
                copied(one)
        assert bench.run(0.01).lost == 0


def test_an_unknown_channel_is_refused_with_those_that_there_are(tmp_path: Path) -> None:
    with simulated() as bench, bench.record(tmp_path / "a.h5"):
        bench.run(0.01)
    data = read_recording(tmp_path / "a.h5")
    assert ("cof" in data, "mu" in data) == (True, False)
    with pytest.raises(UnknownChannelError, match=r"^there is no channel 'Cof', perhaps cof: it h"):
        data["Cof"]
    with pytest.raises(KeyError, match=r"^there is no channel 3: it has .*, voltage_v, "):
        data[3]  # type: ignore[index]


def test_no_trace_replaces_no_file(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    with pytest.raises(
        ValueError, match=r"^there is no trace to write: write_csv\(path, traces\)$"
    ):
        write_csv(path, [])
    assert not path.exists()


@pytest.mark.parametrize("traces", ["run.csv", [TRACE, None], [TRACE.counts]])
def test_writing_no_trace_replaces_no_file(traces: Any, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_csv(path, TRACE)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r" is no (Trace: write_csv\(path, traces\)|list)$"):
        write_csv(path, traces)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "read",
    [
        read_csv,
        sha256,
        read_plan,
        lambda path: Texture.from_png(path, 0, 0.2, 0.3),
        lambda path: Texture.from_csv(path, time="t", cof="mu"),
        lambda path: make_recording(path, path.with_name("run.h5")),
    ],
)
def test_a_file_that_is_not_there(read: Callable[[Path], object], tmp_path: Path) -> None:
    for path, why in (
        (tmp_path / "none", "there is no such file"),
        (tmp_path / "no" / "none", f"the folder {tmp_path / 'no'} does not exist"),
    ):
        with pytest.raises(FileNotFoundError) as error:
            read(path)
        assert str(error.value) == f"{path}: {why}"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "write",
    [
        TRACE.to_csv,
        lambda path: write_csv(path, [TRACE]),
        lambda path: Texture.grating(2.0, 0.2, 0.3).save_figure(path.with_suffix(".png")),
    ],
)
def test_a_folder_that_is_not_there(write: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "no" / "x.csv"
    with pytest.raises(FileNotFoundError, match=r"[\\/]x\.(csv|png): the folder .*no does not ex"):
        write(path)


@pytest.mark.parametrize("name", BY_ZERO)
def test_rounding_error_of_a_loop_is_0(name: str) -> None:
    error = np.arange(-38, 38, 0.1)[380]
    assert error != 0
    with Stimulator.simulate() as bench:
        setattr(bench, name, abs(error))
        assert getattr(bench, name) == 0
