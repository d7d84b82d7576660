"""Textures as a person makes them, also of recordings, and as a stimulator plays them."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from smarttac_can.bench import BenchError, Mode, RefusedError, Stimulator, Texture, track
from smarttac_can.bench.textures import FINEST_MM_N, FOLLOWED_HZ
from smarttac_can.vocabulary.textures import Axis, TextureTable

SINE = Texture.grating(2.0, 0.3, 0.4, shape="sine")
SQUARE = Texture.grating(2.0, 0.3, 0.4)
GRATING = Texture.grating(period_mm=2, low=0.25, high=0.4)
LONGEST = Texture(TextureTable(Axis.POSITION, False, 0, 18_555, tuple(range(2000, 6096))))


def test_texture_is_kept_by_slot_and_played(bench: Stimulator) -> None:
    assert bench.texture is None
    bench.texture = LONGEST
    bench.texture_slot = 3
    assert bench.texture is None
    bench.texture = Texture.grating(2, 0.3, 0.4)
    assert bench.texture == Texture.grating(2, 0.3, 0.4)
    bench.texture_slot = 1
    assert bench.texture == LONGEST
    bench.texture_slot = 3
    bench.finger.stroke(2, force=1.0, speed=60.0, travel=30.0)
    bench.start_run()
    bench.amplitude = 1.0
    bench.mode = "texture"
    trace = bench.run(1.2)
    assert bench.mode is Mode.TEXTURE
    late = trace.cof_reference[600:]
    assert (late.min(), late.max()) == pytest.approx((0.3, 0.4))
    bench.disarm()
    bench.texture = None
    assert bench.texture is None


def test_unplayable_texture_is_refused_in_one_line(bench: Stimulator) -> None:
    bench.run(0.07)
    with pytest.raises(
        RefusedError, match=r"^cannot play: texture slot 1 is empty: a script sets bench"
    ):
        bench.mode = "texture"
    bench.texture = GRATING
    with pytest.raises(
        ValueError, match=r"^COF 2\.0001 of value 0 is outside 0\.05\.\.2$"
    ) as refused:
        bench.texture = Texture(TextureTable(Axis.POSITION, False, 0, 1, (20_001,)))
    assert refused.value.__cause__ is None
    assert bench.texture == GRATING
    bench.mode = "texture"
    with pytest.raises(RefusedError, match=r"Slot: texture slot 2 is empty$"):
        bench.texture_slot = 2
    with pytest.raises(RefusedError, match=r"Table 1: texture is played: its slot cannot be em"):
        bench.texture = None
    with pytest.raises(RefusedError, match=r"^texture_slot 5 is above 4: give 1 to 4 "):
        bench.texture_slot = 5
    with pytest.raises(ValueError, match=r"^texture_slot 2\.0 is no integer: give a whole number$"):
        bench.texture_slot = 2.0  # type: ignore[assignment]
    with pytest.raises(ValueError, match=r"^texture 'wood\.png' is no Texture$"):
        bench.texture = "wood.png"  # type: ignore[assignment]
    assert bench.texture == GRATING


def test_texture_frequency_is_at_half_of_its_power() -> None:
    for texture in (SINE, SQUARE, GRATING):
        assert texture.frequency(60.0) == pytest.approx(30.0)
        assert texture.frequency(120.0) == pytest.approx(60.0)
    assert Texture.profile("sine", 0.3, 0.4, 0.05, repeats=True).frequency(60.0) == pytest.approx(
        20.0
    )
    assert Texture.profile([(0, 0.3), (1, 0.3)]).frequency(60.0) == 0.0
    noise = np.random.default_rng(1).integers(2000, 6000, 4000).tolist()
    white = Texture(TextureTable(Axis.POSITION, False, 0, 20_000, tuple(noise)))
    # Up to 25 periods per mm alike, 1500 Hz at 60 mm/s.
    assert white.frequency(60.0) == pytest.approx(750.0, rel=0.1)


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_a_texture_that_is_too_fast_to_be_followed_is_warned_of(bench: Stimulator) -> None:
    fine = Texture.grating(0.4, 0.3, 0.4)
    with pytest.warns(UserWarning, match=r"^half of the texture is above 125 Hz at 50 mm/s, and"):
        bench.texture = fine
    assert bench.texture == fine
    bench.finger.stroke(2, speed="0.04 m/s", force=1.3)
    bench.texture = fine
    bench.finger.stroke(2, speed=300.0)
    with pytest.warns(UserWarning, match=r"above 150 Hz at 300 mm/s, .* up to 100 Hz: make it c"):
        bench.texture = SINE
    with pytest.warns(UserWarning, match=r"above 200 Hz, and the COF follows up to 100 Hz"):
        bench.texture = Texture.profile([(0, 0.3), (0.0025, 0.4), (0.005, 0.3)], repeats=True)


def test_a_texture_finer_than_the_position_is_warned_of(bench: Stimulator) -> None:
    fine = Texture.grating(0.8, 0.3, 0.4, shape="sine")
    bench.texture = fine
    bench.finger.stroke(2, force=0.5, speed=40.0)
    with pytest.warns(
        UserWarning,
        match=r"^half of the texture has periods below 0\.8 mm, and under 0\.5 N the position is "
        r"good for 1 mm: make it coarser, or press more$",
    ):
        bench.texture = fine
    bench.finger.stroke(2, force=0.7, speed=40.0)
    bench.texture = fine


def test_warning_bounds_are_inside_what_the_page_of_bandwidth_shows() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "bandwidth.md").read_text("utf-8")
    rows = [
        line.split("|")[3:-1]
        for line in page.splitlines()
        if line.startswith("| texture") and " to " in line and line.count("|") == 6
    ]
    medians = [float(cell.strip(" >").split(" (")[0]) for row in rows for cell in row]
    assert len(medians) == 12
    assert min(medians) > FOLLOWED_HZ == 100.0
    cells = re.findall(r"([\d.]+) Hz: [\d.]+, ([\d.-]+) \(", page)
    assert len(cells) == 48
    periods = 12 * [4.0, 2.0, 1.0, 0.5]
    forces = 2 * (12 * [1.0] + 12 * [0.5])
    inside = [
        float(gain)
        for (hertz, gain), period, force in zip(cells, periods, forces, strict=True)
        if float(hertz) <= FOLLOWED_HZ and period * force >= FINEST_MM_N
    ]
    assert len(inside) > 20
    assert min(inside) > 0.7


@pytest.mark.parametrize("shape", ["square", "sine"])
@pytest.mark.parametrize("period", [0.1, 1.0, 2.0, 7.3, 76.0])
def test_a_grating_repeats_over_the_plate(shape: str, period: float) -> None:
    texture = Texture.grating(period, 0.25, 0.4, shape=shape)
    places = np.linspace(-38.0, 38.0 - period, 311)
    phase = places / period % 1.0
    away = np.minimum(abs(phase - 0.5), np.minimum(phase, 1.0 - phase)) > 0.02
    wanted = (
        np.where(phase < 0.5, 0.4, 0.25)
        if shape == "square"
        else 0.325 + 0.075 * np.sin(2.0 * np.pi * phase)
    )
    assert texture.cof(places)[away] == pytest.approx(wanted[away], abs=3e-3)


def test_the_duty_is_the_share_of_the_ridge() -> None:
    texture = Texture.grating(2.0, 0.2, 0.3, duty=0.25)
    assert texture.cof(np.linspace(0, 20, 20_000)).mean() == pytest.approx(0.225, abs=5e-4)


@pytest.mark.parametrize(
    ("shape", "wanted"),
    [
        ("step", [0.3, 0.3, 0.3, 0.4, 0.4, 0.4]),
        ("ramp", [0.3, 0.325, 0.345, 0.355, 0.375, 0.4]),
        ("trapezoid", [0.3, 0.375, 0.4, 0.4, 0.375, 0.4 - 0.1]),
        ("sine", [0.3, 0.35, 0.3976, 0.3976, 0.35, 0.3]),
    ],
)
def test_profiles(shape: str, wanted: list[float]) -> None:
    profile = Texture.profile(shape, 0.3, 0.4, seconds=2.0)
    assert profile.is_over_time
    places = np.array([0.0, 0.5, 0.9, 1.1, 1.5, 2.5])
    assert profile.cof(places) == pytest.approx(wanted, abs=2e-3)


def test_a_profile_of_points_holds_its_last_cof_or_repeats() -> None:
    points = [(0.0, 0.3), (1.0, 0.3), (1.0, 0.5), (3.0, 0.4)]
    once, again = Texture.profile(points), Texture.profile(points, repeats=True)
    assert once.cof([0.9, 1.01, 2.0, 9.0]) == pytest.approx([0.3, 0.4995, 0.45, 0.4], abs=1e-3)
    assert again.cof([0.9, 3.9, 4.5]) == pytest.approx([0.3, 0.3, 0.475], abs=1e-3)


def test_a_row_of_a_grey_picture(tmp_path: Path) -> None:
    pixels = np.zeros((3, 200))
    pixels[1] = np.linspace(0.0, 1.0, 200)
    path = tmp_path / "ramp.png"
    Image.fromarray(np.uint8(255 * pixels)).save(path)
    texture = Texture.from_picture(path, row=1, low=0.2, high=0.6, width_mm=40.0)
    assert texture.cof([-30, 0, 30]) == pytest.approx([0.2, 0.4, 0.6], abs=3e-3)
    assert texture.cof([-19.9, -10, 10]) == pytest.approx([0.2, 0.3, 0.5], abs=3e-3)
    assert Texture.from_picture(path, row=0, low=0.2, high=0.6).cof(0.0) == pytest.approx([0.2])


def test_it_is_shown_in_one_line() -> None:
    assert repr(Texture.grating(2, 0.2, 0.4)) == (
        "<Texture over position: 500 values, COF 0.2 to 0.4>"
    )
    assert repr(Texture.profile("ramp", 0.2, 0.4)) == (
        "<Texture over time, 0 to 1 s: 1001 values, COF 0.2 to 0.4>"
    )


@pytest.mark.parametrize("end", [".png", ".svg"])
@pytest.mark.parametrize(
    "texture",
    [
        GRATING,
        Texture.profile("step", 0.2, 0.4),
        Texture.profile([(0.0, 0.2), (0.5, 0.4), (1.0, 0.4)], repeats=True),
    ],
)
def test_a_picture_before_it_is_played(texture: Texture, end: str, tmp_path: Path) -> None:
    path = tmp_path / f"texture{end}"
    texture.save_figure(path)
    assert path.stat().st_size > 5000
    (axes,) = texture.figure().axes
    (line,) = axes.lines
    assert line.get_ydata().max() == pytest.approx(0.4)
    # The whole width of the line is inside the frame.
    (left, right), (_, top) = axes.get_xlim(), axes.get_ylim()
    first, last = texture.extent
    assert left <= first - 0.01 * (last - first)
    assert right >= last + 0.01 * (last - first)
    assert top >= 1.05 * 0.4


def test_a_picture_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    with pytest.raises(OSError, match=rf"^{tmp_path / 'a.png'}: No space left on device$"):
        GRATING.save_figure(tmp_path / "a.png")


@pytest.mark.parametrize(
    "use",
    [
        lambda path: GRATING.figure(),
        GRATING.save_figure,
    ],
)
def test_pictures_without_matplotlib(
    use: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.bench.traces.find_spec", lambda name: None)
    with pytest.raises(BenchError, match=r"^the pictures need matplotlib: pip install 'smarttac"):
        use(tmp_path / "wood.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: Texture.grating(0.05, 0.2, 0.3), "period_mm 0.05 is outside 0.1..76"),
        (lambda: Texture.grating(2, 0.4, 0.3), "low 0.4 is above high 0.3"),
        (lambda: Texture.grating(2, 0.0499, 0.3), "low 0.0499 is outside 0.05..2"),
        (lambda: Texture.grating(2, 0.3, 2.001), "high 2.001 is outside 0.05..2"),
        (lambda: Texture.profile("ramp", 0.01, 0.3), "low 0.01 is outside 0.05..2"),
        (lambda: Texture.from_picture("x", 0, 0.01, 0.3), "low 0.01 is outside 0.05..2"),
        (lambda: Texture.profile([(0, 0.3), (1, 0.049)]), "sample 1: COF 0.049 is outside 0.05..2"),
        (lambda: Texture.grating(2, 0.2, 0.3, duty=1), "duty 1 is outside 0.01..0.99"),
        (lambda: Texture.grating(2, 0.2, 0.3, shape="saw"), "shape 'saw' is none of square, sine"),
        (lambda: Texture.grating(2, 0.2, 0.3, 0.3, "sine"), "duty 0.3 of a sine is not 0.5"),
        (
            lambda: Texture.profile("x", 0.2, 0.3),
            "shape 'x' is none of step, ramp, trapezoid, sine",
        ),
        (lambda: Texture.profile("step"), "shape 'step' needs low and high"),
        (
            lambda: Texture.profile([(0, 0.3), (1, 0.4, 5)]),  # type: ignore[list-item]
            "point (1, 0.4, 5) of a profile is no (time in s, COF)",
        ),
        (
            lambda: Texture.profile([(0, 0.3)]),
            "a profile goes through 2 points (time in s, COF) or m",
        ),
        (
            lambda: Texture.profile([(1, 0.2), (0, 0.2)]),
            "the times of a profile are below 0, or fall",
        ),
        (
            lambda: Texture.profile([(0, 0.2)], low=0.3),
            "points have their own COF: low and high be",
        ),
        (lambda: Texture.from_csv("x"), "give one of position and time, the column that it goes"),
        (lambda: Texture.from_csv("x", time="t"), "give cof, or both lateral and normal, the co"),
    ],
)
def test_texture_refuses_values_out_of_range(make, reason: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError) as refused:
        make()
    assert str(refused.value).startswith(reason)


@pytest.mark.parametrize("bench", ["bus"], indirect=True)
def test_texture_bounds_equal_those_of_the_stimulator(bench: Stimulator) -> None:
    widest = Texture.profile([(0, 0.05), (1, 2.0)])
    bench.texture = widest
    assert bench.texture == widest


def test_a_recording_with_reversals_and_irregular_positions(tmp_path: Path) -> None:
    draw = np.random.default_rng(1)
    x = 10.0 * np.sin(np.cumsum(draw.uniform(0.001, 0.02, 20_000)))
    lateral = -np.sign(np.gradient(x)) * (0.3 + 0.005 * x) * 0.8
    rows = [f"{a:.4f};{b:.5f};0.8".replace(";", ",") for a, b in zip(x, lateral, strict=True)]
    path = tmp_path / "recording.csv"
    path.write_text("\n".join([" where , Fx,press", *rows, "3.0,,0.8", "4.0,9.0,0.001"]) + "\n")
    texture = Texture.from_csv(path, position="where", lateral="Fx", normal="press")
    places = np.linspace(-9.0, 9.0, 50)
    assert texture.cof(places) == pytest.approx(0.3 + 0.005 * places, abs=1e-3)


def test_a_recording_without_a_press_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "air.csv"
    path.write_text("x,Fx,Fz\n1,0.01,0.05\n2,0.02,0.0\n")
    with pytest.raises(ValueError, match=r"air\.csv: no normal force is 0\.1 or more$"):
        Texture.from_csv(path, position="x", lateral="Fx", normal="Fz", least_force=0.1)


def test_a_recording_over_time(tmp_path: Path) -> None:
    path = tmp_path / "profile.csv"
    path.write_text("t,mu\n5.0,0.3\n6.0,0.4\n5.5,0.35\n")
    texture = Texture.from_csv(path, time="t", cof="mu")
    assert texture.cof([0.0, 0.25, 1.0]) == pytest.approx([0.3, 0.325, 0.4], abs=1e-3)


def test_a_recording_of_one_s_own(tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    with Stimulator.simulate("local") as bench:
        bench.finger.stroke(2, force=1.0, speed=60.0, travel=30.0)
        bench.start_run()
        trace = bench.run(1.2)
    trace.to_csv(path)
    with pytest.raises(ValueError, match=r"own\.csv: line \d+: COF 0\.0") as told:
        Texture.from_csv(path, position="position_mm", cof="cof")
    lines = path.read_text().splitlines(keepends=True)
    begin = next(at for at, line in enumerate(lines) if not line.startswith("#"))
    header = lines[begin].strip().split(",")
    cof, position, force = (header.index(name) for name in ("cof", "position_mm", "normal_force_n"))
    named = lines[int(str(told.value).split("line ")[1].split(":")[0]) - 1].split(",")
    said = float(str(told.value).split("COF ")[1].split()[0])
    assert float(named[cof]) == pytest.approx(said, rel=0.01)

    head, rows = lines[: begin + 1], [line.split(",") for line in lines[begin + 1 :]]
    touches = [row for row in rows if row[position]]
    assert [row[position] == "" for row in rows] == [row[cof] == "" for row in rows]
    slides = [
        row for row in touches if abs(float(row[position])) < 13.0 and float(row[force]) > 0.5
    ]
    path.write_text("".join([*head, *map(",".join, slides)]))
    texture = Texture.from_csv(path, position="position_mm", cof="cof")
    assert texture.cof(np.linspace(-12.0, 12.0, 40)) == pytest.approx(0.42, abs=0.03)


def test_a_mean_counts_not_a_sample(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = "".join(f"{x / 20},0.3\n" for x in range(20, 60))
    path.write_text(f"x,mu\n1,0.01\n{rows}")
    with pytest.warns(UserWarning, match=r"% of the swing of the COF .* is averaged away"):
        texture = Texture.from_csv(path, position="x", cof="mu")
    assert texture.cof(1.0) == pytest.approx([0.155])


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ("1,0.3", "a profile goes through 2 points (time in s, COF) or more, not 1"),
        ("1,0.3\n40002,0.3", "length of the profile in s 40001 is outside 0..40000"),
    ],
)
def test_times_that_no_table_holds_are_refused_by_file(
    rows: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "run.csv"
    path.write_text(f"t,mu\n{rows}\n")
    with pytest.raises(ValueError) as refused:
        Texture.from_csv(path, time="t", cof="mu")
    assert str(refused.value) == f"{path}: {reason}"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "the file is empty"),
        ("\n\n", "the file is empty"),
        ("t,mu\n1,2\n", "line 1: there is no column 'x' among t, mu"),
        ("x,mu\n", "no row has all of x, mu"),
        ("x,mu\n1,0.3\n2,many\n", "line 3: column 'mu': 'many' is no finite number"),
        ("x,mu\n1,inf\n", "line 2: column 'mu': 'inf' is no finite number"),
        (
            "# of: 1,2\n# x,mu\nx,mu\n1,0.3\n2,many\n",
            "line 5: column 'mu': 'many' is no finite number",
        ),
        ("# mu: 0.3\n", "no line of the first 64 KiB has the columns x, mu"),
        ("x,mu\n# 1,0.3\n", "line 2: column 'x': '# 1' is no finite number"),
        ("x,mu\n100,0.3\n-100.1,0.3\n", "line 3: position -100.1 mm is outside ±100 mm"),
        ('x,mu\n1,0.3\n2,"a\nb"\n', "line 4: column 'mu': 'a\\nb' is no finite number"),
    ],
)
def test_texture_refuses_files_without_a_recording(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "recording.csv"
    path.write_text(text)
    with pytest.raises(ValueError) as refused:
        Texture.from_csv(path, position="x", cof="mu")
    assert str(refused.value) == f"{path}: {reason}"


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"position": "x", "cof": "mu"}, "COF 0.01 is outside 0.05..2"),
        ({"time": "x", "cof": "mu"}, "COF 0.01 is outside 0.05..2"),
        ({"position": "x", "lateral": "Fx", "normal": "Fz"}, "COF 3 is outside 0.05..2"),
    ],
)
def test_texture_refuses_recordings_beyond_its_range(
    columns: dict[str, str], reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "recording.csv"
    path.write_text("x,mu,Fx,Fz\n1,0.3,0.3,1\n1.5,0.3,0.3,0.01\n2,0.01,3,1\n")
    with pytest.raises(ValueError) as refused:
        Texture.from_csv(path, **columns)
    assert str(refused.value) == (
        f"{path}: line 4: {reason}; leave out rows where the finger turns, rests or hardly touches"
    )


@pytest.mark.parametrize("scale", [100.0, -1.0])
def test_texture_asks_for_percent_or_sign_if_most_rows_miss(scale: float, tmp_path: Path) -> None:
    path = tmp_path / "recording.csv"
    rows = [f"{0.1 * n:g},{scale * 0.4:g}" for n in range(9)]
    path.write_text("\n".join(["x,mu", *rows, "0.9,0.4"]) + "\n")
    with pytest.raises(ValueError) as refused:
        Texture.from_csv(path, position="x", cof="mu")
    assert str(refused.value) == (
        f"{path}: line 2: COF {scale * 0.4:g} is outside 0.05..2; "
        "90% of the rows are outside: is the COF in percent, or has a force the wrong sign?"
    )


def strokes(passes: int = 4) -> np.ndarray:
    there = np.arange(-12.0, 12.0, 0.06)
    return np.concatenate([there if n % 2 == 0 else there[::-1] for n in range(passes)])


@pytest.mark.parametrize("texture", [SINE, SQUARE])
def test_tracking_of_an_exact_follower_has_correlation_1(texture: Texture) -> None:
    x = strokes()
    found = track(texture, x, texture.cof(x))
    assert (found.passes, found.rms) == (4, 0.0)
    assert min(found.correlations) > 0.999
    assert found.mean_correlation > 0.98
    assert found.harmonics[0].per_mm == pytest.approx(0.5)
    assert found.harmonics[0].gain == pytest.approx(1.0, abs=0.01)
    assert found.harmonics[0].error < 0.003


def test_a_constant_correlates_with_nothing() -> None:
    x = strokes()
    found = track(SINE, x, np.full_like(x, 0.35))
    assert np.isnan(found.correlations).all()
    assert found.harmonics[0].gain == pytest.approx(0.0, abs=0.01)


def test_half_of_the_amplitude_a_quarter_of_a_period_late() -> None:
    x = strokes(1)
    half = track(SINE, x, 0.35 + 0.5 * (SINE.cof(x) - 0.35))
    assert min(half.correlations) == pytest.approx(1.0, abs=1e-6)
    assert half.rms == pytest.approx(0.025 / np.sqrt(2), rel=0.01)
    assert half.harmonics[0].gain == pytest.approx(0.5, abs=0.01)
    assert half.harmonics[0].error == pytest.approx(0.025, rel=0.02)
    late = track(SINE, x, SINE.cof(x - 0.5))
    assert min(late.correlations) == pytest.approx(0.0, abs=0.02)
    assert late.harmonics[0].gain == pytest.approx(0.0, abs=0.02)


def test_a_delay_does_not_cancel_between_two_directions() -> None:
    x = strokes()
    ways = np.sign(np.gradient(x))
    found = track(SINE, x, SINE.cof(x - 0.25 * ways))
    assert found.mean_correlation == pytest.approx(np.cos(np.pi / 4), abs=0.03)


def test_a_square_has_its_odd_frequencies() -> None:
    x = strokes()
    frequencies = [h.per_mm for h in track(SQUARE, x, SQUARE.cof(x)).harmonics[:4]]
    assert frequencies == pytest.approx([0.5, 1.5, 2.5, 3.5])


def test_noise_of_a_pass_is_gone_from_the_mean() -> None:
    x = strokes(40)
    noisy = SINE.cof(x) + np.random.default_rng(1).normal(0.0, 0.03, len(x))
    found = track(SINE, x, noisy)
    assert max(found.correlations) < 0.85
    assert found.mean_correlation > 0.98


@pytest.mark.parametrize(
    ("x", "mu", "shapes"),
    [
        (np.zeros(10), np.zeros(9), r"\(10,\), \(9,\)"),
        (np.zeros((2, 9)), np.zeros((2, 9)), r"\(2, 9\)"),
    ],
)
def test_rows_of_unequal_length_are_refused(x: np.ndarray, mu: np.ndarray, shapes: str) -> None:
    with pytest.raises(ValueError, match=f"no two rows of equal length: {shapes}"):
        track(SINE, x, mu)


def test_tracking_leaves_out_unmeasured_samples() -> None:
    x = strokes()
    cof = SINE.cof(x)
    cof[::3] = np.nan
    with pytest.raises(ValueError, match=r"^no pass goes from -8 to 8 mm$"):
        track(SINE, x[:100], cof[:100])


def test_time_has_no_place() -> None:
    with pytest.raises(ValueError, match=r"^a texture over time has no place to compare$"):
        track(Texture.profile("step", 0.2, 0.3), [0.0], [0.2])
