"""Recordings that textures are made of."""

from pathlib import Path

import numpy as np
import pytest

from smarttac_can.bench import Stimulator, Texture


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
    path.write_text("x,mu\n1,0.01\n1,0.3\n2,0.3\n")
    texture = Texture.from_csv(path, position="x", cof="mu")
    assert texture.cof(1.0) == pytest.approx([0.155])


def test_means_of_what_lies_on_a_bound_are_played(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("x,mu\n" + "1,0.05\n" * 10 + "2,2\n")
    assert Texture.from_csv(path, position="x", cof="mu").cof([1, 2]) == pytest.approx([0.05, 2])


def test_samples_far_apart(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("x,mu\n-30,0.2\n30,0.5\n")
    texture = Texture.from_csv(path, position="x", cof="mu")
    assert texture.cof([-30, 0, 30]) == pytest.approx([0.2, 0.35, 0.5], abs=1e-4)


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
        ("", "there is no column 'x' among "),
        ("t,mu\n1,2\n", "there is no column 'x' among t, mu"),
        ("x,mu\n", "no row has all of x, mu"),
        ("x,mu\n1,0.3\n2,many\n", "line 3: column 'mu': 'many' is no finite number"),
        ("x,mu\n1,inf\n", "line 2: column 'mu': 'inf' is no finite number"),
        (
            "# of: 1,2\n# x,mu\nx,mu\n1,0.3\n2,many\n",
            "line 5: column 'mu': 'many' is no finite number",
        ),
        ("# mu: 0.3\n", "there is no column 'x' among "),
        ("x,mu\n# 1,0.3\n", "line 2: column 'x': '# 1' is no finite number"),
        ("x,mu\n100,0.3\n-100.1,0.3\n", "line 3: position -100.1 is outside ±100 mm"),
        ('x,mu\n1,0.3\n2,"a\nb"\n', "line 4: column 'mu': 'a\\nb' is no finite number"),
    ],
)
def test_what_is_no_recording_is_refused(text: str, reason: str, tmp_path: Path) -> None:
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
def test_a_recording_beyond_what_is_played_is_refused(
    columns: dict[str, str], reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "recording.csv"
    path.write_text("x,mu,Fx,Fz\n1,0.3,0.3,0.01\n2,0.01,3,1\n")
    with pytest.raises(ValueError) as refused:
        Texture.from_csv(path, **columns)
    assert str(refused.value) == (
        f"{path}: line 3: {reason}; leave out rows where the finger turns, rests or hardly touches"
    )


def test_a_recording_in_another_encoding_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "recording.csv"
    path.write_bytes("x,mu\n1,0.3\n2,0.3 µ\n".encode("latin-1"))
    with pytest.raises(ValueError, match=r"recording\.csv: line 3 is no UTF-8 text$"):
        Texture.from_csv(path, position="x", cof="mu")
