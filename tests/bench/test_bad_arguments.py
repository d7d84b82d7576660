"""What makes no sense is refused in one line that says so, and changes nothing."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from smarttac_can.bench import (
    BenchError,
    Placing,
    RefusedError,
    Stimulator,
    Texture,
    Trace,
    make_recording,
    read_csv,
    read_plan,
    sha256,
    stimulator_od,
    write_csv,
)

TRACE = Trace.from_rows("a", 0, [(k, *range(9)) for k in range(3)])
Act = Callable[[Any], object]


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


SENSELESS: list[tuple[Act, str]] = [
    # Another kind of unit, or none.
    (
        writes("Setpoint.Voltage", "80 N"),
        "'80 N' is not a number with a unit like mV$",
    ),
    (writes("Mode", "off"), "^Mode 'off' is not a number$"),
    (lambda bench: bench.get("Setpoint.Voltage", "N"), "^'N' is not a unit like mV$"),
    (lambda bench: bench.get("Setpoint.Voltage", 5), "^5 is not a unit like mV$"),
    (puts("voltage", "20"), "Voltage '20' is no number with a unit like"),
    (puts("cof", ("30 %", "1 N")), "cof '1 N' is no number or percent"),
    # Not finite, or no number.
    (puts("voltage", float("nan")), "nan is not a finite number"),
    (puts("voltage", None), "Voltage None is not a finite number"),
    (puts("texture_slot", 10**400), "^Texture.Slot 10+ is not a fin"),
    (puts("cof", None), "cof None is not a finite number"),
    (puts("cof", (1, 2, 3)), r"cof \(1, 2, 3\) is neither a"),
    # Choices.
    (puts("mode", 9), "mode 9 is none of off, open_loop"),
    (puts("mode", "fast"), "mode 'fast' is none of off, open_loop, amplitude"),
    (puts("law", None), "law None is none of measured, accumulate, nominal, predictive"),
    (puts("vibration_law", "lqr"), "^vibration law 'lqr' is none of pi, scheduled, pred"),
    # What would be rounded to nothing.
    (puts("voltage", "80 nV"), "^Setpoint.Voltage 80 nV would become 0: it goes in steps of 10 mV"),
    (writes("Setpoint.Voltage", 4), "^Setpoint.Voltage 4.0 mV would become 0: it goes in steps of"),
    (puts("cof", (0.3, 1e-6)), r"^Setpoint\.COF right 1e-06 is below 0\.05, its"),
    (writes("Limit.Voltage", -1), "^Limit.Voltage -1.0 mV is below 0 mV, its lowest value$"),
    # Runs and samples.
    *((runs(s), rf"^seconds {s} is outside 0\.001\.\.604800$") for s in (0.0004, 604_801.0)),
    (runs("1"), "seconds '1' is not a finite number"),
    (runs(0.1, experiment="Trial-1"), "^experiment 'Trial-1' is not made of a-z 0-9 . _$"),
    (runs(0.1, experiment=None), "^experiment None is not made of a-z 0-9 . _$"),
    (runs(0.1, experiment=101 * "x"), "^experiment of 101 characters is outside 1..100$"),
    (runs(0.1, subject=-1), "^subject -1 is below 0$"),
    (runs(0.1, subject=True), "^subject True is no integer$"),
    (samples(["Plate input.S1"], 0), r"count 0 is no integer of 1 or more"),
    (samples("Plate input.S1", 3), r"names 'Plate input\.S1' are no list of names of objects"),
    (samples([], 3), r"names \[\] are no list of names of objects"),
    # The finger.
    (strokes(1.5), r"^subject 1\.5 is no integer$"),
    (strokes(3, force="500"), "^force '500' is no number with a unit like N$"),
    (surrounds(seed=1.5), r"^seed 1\.5 is no integer$"),
    (
        surrounds(seed=9, drive_instant="1 V"),
        "^drive_instant '1 V' is no number with a unit like us$",
    ),
]
"""What a script gets a ValueError for."""
UNKNOWN: list[tuple[Act, str]] = [
    (lambda bench: bench.get("Setpoint.Amp"), r"no object 'Setpoint.Amp', perhaps Setpoint.Ampl"),
    (writes("Nonsense", 1), r"there is no object 'Nonsense'$"),
    (lambda bench: bench.get("Message"), r"^Message is not a number: it is the text in \.message$"),
]
REFUSED: list[tuple[Act, str]] = [
    (
        writes("Setpoint.Voltage", 200_010),
        "^cannot write .* to Setpoint.Voltage: abort 06090031: value written too high: 0 to 200000",
    ),
    (writes("Setpoint.Voltage", -10), "abort 06090032: value written too low"),
    (writes("Limit.Lowest frequency", 44_500), "abort 06090030: invalid value for parameter"),
    (writes("Statusword", 1), "abort 06010002: attempt to write a read only object"),
    (
        lambda bench: bench.finger.play_recording(),
        r"abort 08000022: .*started without a recording, --finger FILE$",
    ),
    (raw("Setpoint.Voltage", -1), "^cannot write -10 mV to .* too low: 0 to 200000 mV$"),
    (raw("Mode", 9), "^cannot write 9 to Mode: abort 06090031: value written too high: 0 to 6$"),
    (
        lambda bench: bench.get("Simulation.Start run"),
        "^cannot read Simulation.Start run: abort 06010001",
    ),
    (puts("cof", (0.3, 5)), r"Setpoint\.COF right"),
    (strokes(10), "060900"),
    (strokes(3, force=0.6, speed=1000), r"Finger\.Speed: abort 06090031.*: 5 to 300 mm/s$"),
    (surrounds(seed=9, temperature=1000), r"Simulation\.Ambient temperature: abort 06090031"),
    (
        lambda bench: bench.finger.put(Placing(500.0, 0.0, 0.0, 1000.0)),
        r"Weight\.Position: abort 06090031",
    ),
]
"""What the device refuses."""


def settings(bench: Stimulator) -> dict[str, float]:
    """What a refusal may not change, and the tick, which tells whether something has run."""
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
def test_what_is_refused_changes_nothing(
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
        (lambda: stimulator_od("32"), r"^node_id '32' is no integer of 1\.\.127$"),
        (
            lambda: Stimulator.connect(interface="virtual", node_id=None),
            r"^node_id None is no integer of 1\.\.127$",
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
def test_of_what_makes_one(act: Callable[[], object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        act()


@pytest.mark.parametrize("traces", ["run.csv", [TRACE, None], [TRACE.counts]])
def test_what_is_no_trace_replaces_no_file(traces: Any, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_csv(path, TRACE)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r" is no Trace: write_csv\(path, traces\)$"):
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
