"""CSV files as labs write them come out right, with pandas and without it, or are refused."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from smarttac_can.bench import BenchError, Texture, lab_csv
from smarttac_can.bench.lab_csv import read_table

X = np.linspace(-10, 10, 401)
MU = 0.35 + 0.05 * np.sin(2 * np.pi * X / 5)
ROWS = [(f"{x:.3f}", f"{mu:.4f}") for x, mu in zip(X, MU, strict=True)]


@pytest.fixture(params=["pandas", "plain"], autouse=True)
def reader(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Read each file by both readers."""
    monkeypatch.setattr(lab_csv, "_SMALL_BYTES", 0)
    monkeypatch.setattr(lab_csv, "_has_pandas", lambda: request.param == "pandas")
    return str(request.param)


def lines(separator: str = ",", decimal: str = ".") -> str:
    """Return the rows of position and COF."""
    return "".join(f"{separator.join(row)}\n".replace(".", decimal) for row in ROWS)


LOGGER = "".join(f"Parameter {n}:\t{n * 1.5}\tmm\n" for n in range(12))
FILES = {
    "plain": ("x,mu\n" + lines(), {}),
    "savetxt": ("# x,mu\n" + lines(), {}),
    "comments": ('# made by "us, 5" inch\n# x,mu\nx,mu\n' + lines(), {}),
    "semicolons": ("x;mu\n" + lines(";", ","), {}),
    "quoted commas": (
        "x,mu\n" + "".join('"{}","{}"\n'.format(*row).replace(".", ",") for row in ROWS),
        {},
    ),
    "tabs": ("x\tmu\n" + lines("\t"), {}),
    "spaces": ("  x     mu\n" + lines("   "), {}),
    "bars": ("x|mu\n" + lines("|"), {}),
    "other columns": (
        "date;x;note;mu\n"
        + "".join(f"2026-01-0{k % 9 + 1};{x};a,b;{mu}\n" for k, (x, mu) in enumerate(ROWS)),
        {},
    ),
    "unit row": ("x,mu\nmm,-\n" + lines(), {}),
    "unit row in brackets": ("x,mu\n(um),[%]\n" + "".join(
        f"{float(x) * 1e3:.0f},{float(mu) * 100:.2f}\n" for x, mu in ROWS), {}),
    "unit in the name": (
        "x [m],mu\n" + "".join(f"{float(x) / 1e3:.6f},{mu}\n" for x, mu in ROWS),
        {},
    ),
    "unit behind a slash": (
        "x / cm,mu\n" + "".join(f"{float(x) / 10:.6f},{mu}\n" for x, mu in ROWS),
        {},
    ),
    "unit option": (
        "x,mu\n" + "".join(f"{float(x) / 1e3:.6f},{mu}\n" for x, mu in ROWS),
        {"unit": "m"},
    ),
    "logger": (f"Tribometer 7\n{LOGGER}\nx\tmu\n[mm]\t[-]\n" + lines("\t"), {}),
    "blank lines": ("\n\nx,mu\n\n" + lines() + "\n\n\n", {}),
    "empty cells": ("x,mu\n1,NaN\n,0.3\n3,\n4,#N/A\n" + lines() + "5,-nan\n", {}),
    "spaced cells": ("x , mu\n" + lines(" , "), {}),
    "Windows lines": ("x,mu\r\n" + lines().replace("\n", "\r\n"), {}),
    "long column": ("x,mu,why\n" + "".join(f"{x},{mu},{'y' * 40}\n" for x, mu in ROWS), {}),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_csv_of_a_lab_is_read(name: str, tmp_path: Path) -> None:
    text, more = FILES[name]
    path = tmp_path / "lab.csv"
    path.write_bytes(text.encode())
    texture = Texture.from_csv(path, position="x", cof="mu", strict=True, **more)
    assert len(texture.table.values) == 401
    assert texture.cof(X) == pytest.approx(MU, abs=2e-4)


@pytest.mark.parametrize(
    ("encoding", "position", "cof"),
    [
        ("utf-8-sig", "x µ", "mu"),
        ("utf-16", "x", "Reibung µ"),
        ("utf-16-le", "x", "mu"),
        ("utf-16-be", "x", "mu"),
        ("cp1252", "Größe", "Reibwert µ"),
        ("cp1252", "Température", "ÄÖ"),
        ("cp932", "位置", "摩擦係数"),
        ("cp932", "x", "力"),
    ],
)
def test_encodings_are_found_by_the_names(
    encoding: str, position: str, cof: str, tmp_path: Path
) -> None:
    path = tmp_path / "lab.csv"
    path.write_bytes(f"{position},{cof}\n{lines()}".encode(encoding))
    texture = Texture.from_csv(path, position=position, cof=cof)
    assert texture.cof(X) == pytest.approx(MU, abs=2e-4)


def test_a_quote_that_is_never_closed_is_named(tmp_path: Path) -> None:
    path = tmp_path / "lab.csv"
    path.write_text(f'x,mu,why\n{lines().replace(chr(10), ",a" + chr(10))}11,0.3,"b\n{lines()}')
    with pytest.raises(ValueError, match=r"line 403: a cell in quotes has no end$"):
        Texture.from_csv(path, position="x", cof="mu")


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-16"])
def test_micrometres_are_read_in_each_encoding(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.csv"
    rows = "".join(f"{float(x) * 1e3:.1f},{mu}\n" for x, mu in ROWS)
    path.write_bytes(f"x,mu\nµm,-\n{rows}".encode(encoding))
    assert Texture.from_csv(path, position="x", cof="mu").cof(X) == pytest.approx(MU, abs=2e-4)


def test_forces_are_brought_to_one_unit(tmp_path: Path) -> None:
    path = tmp_path / "forces.csv"
    path.write_text(
        "x,Fx [mN],Fz [N]\n"
        + "".join(f"{x},{-800 * float(mu):.2f},0.8\n" for x, mu in ROWS)
        + "3,1,0.01\n"
    )
    texture = Texture.from_csv(path, position="x", lateral="Fx", normal="Fz")
    assert texture.cof(X) == pytest.approx(MU, abs=2e-4)
    path.write_text("x,Fx,Fz [N]\n" + "".join(f"{x},{mu},1\n" for x, mu in ROWS))
    with pytest.raises(ValueError, match=r"the units of Fx and Fz are not both known: name bo"):
        Texture.from_csv(path, position="x", lateral="Fx", normal="Fz")


@pytest.mark.parametrize("name", ["x_cm", "x/cm", "x in cm", "x, cm", "Weg cm", "x（cm）"])
def test_unit_at_the_end_of_a_name_is_taken(name: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.csv"
    rows = "".join(f"{float(x) / 10:.5f};{mu}\n" for x, mu in ROWS)
    path.write_text(f"{name};mu\n{rows}", "utf-8")
    assert Texture.from_csv(path, position=name, cof="mu").cof(X) == pytest.approx(MU, abs=2e-4)


def test_names_of_forces_are_no_units(tmp_path: Path) -> None:
    path = tmp_path / "forces.csv"
    path.write_text("x,F_T,F_N\n" + "".join(f"{x},{mu},1\n" for x, mu in ROWS))
    texture = Texture.from_csv(path, position="x", lateral="F_T", normal="F_N")
    assert texture.cof(X) == pytest.approx(MU, abs=2e-4)
    path.write_text("x,Fx [lbf],Fz [kp]\n" + "".join(f"{x},{mu},1\n" for x, mu in ROWS))
    with pytest.raises(ValueError, match=r"the units of Fx and Fz are not both known"):
        Texture.from_csv(path, position="x", lateral="Fx", normal="Fz")


def test_negative_compression_is_said_and_scaled(tmp_path: Path) -> None:
    path = tmp_path / "minus.csv"
    path.write_text("x,Fx,Fz\n" + "".join(f"{x},{mu},-1\n" for x, mu in ROWS))
    columns = {"position": "x", "lateral": "Fx", "normal": "Fz"}
    with pytest.raises(ValueError, match=r"no normal force is 0\.05 or more: 401 are negative; sc"):
        Texture.from_csv(path, **columns)
    texture = Texture.from_csv(path, **columns, scale={"Fz": -1})
    assert texture.cof(X) == pytest.approx(MU, abs=2e-4)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x,mu,x\n1,2,3\n", "line 1: column 'x' appears twice, as 1 and 3: rename one"),
        ("x [mm],mu,x [m]\n1,2,3\n", "line 1: column 'x' appears twice, as 1 and 3: rename one"),
        ("x,mu\n1,5,0,3\n2,5,0,4\n", "line 2 has 4 fields, and the header 2: with decimal commas"),
        ("x,mu\n1,0.3\n1,2,3\n", "line 3 has 3 fields, and the header 2: with decimal commas"),
        ("x;mu\n1,0;0,3\n1.000;0,3\n", "line 3: column 'x': '1.000' is no finite number with a d"),
        ("x,mu\n1,0.3\n2,OVERLOAD\n", "line 3: column 'mu': 'OVERLOAD' is no finite number"),
        ("x,mu\n1,0.3\n2,-inf\n", "line 3: column 'mu': '-inf' is no finite number"),
        ("x,mu\n1,0.3\n2,True\n", "line 3: column 'mu': 'True' is no finite number"),
        ("x,mu\ns,-\n1,0.3\n", "column 'x' is in s, which is no length"),
        ("x (N),mu\n1,0.3\n", "column 'x' is in N, which is no length"),
        (
            "x [in],mu\n1,0.3\n",
            "column 'x' has the unit 'in', which is no known length: give unit=",
        ),
        ("x,mu\nturns,-\n1,0.3\n", "column 'x' has the unit 'turns', which is no known length"),
        ("x;mu\n1.234;0,3\n2.345;0,3\n", "line 2: column 'x': '1.234' is no finite number with"),
        ("#\n" * 40_000 + "x,mu\n", "no line of the first 64 KiB has the columns x, mu"),
        ("t;y\n1;2\n", "line 1: there is no column 'x' among t, y"),
        ("logger\nv 2\n\nt;mu\n1;2\n", "line 4: there is no column 'x' among t, mu"),
        ("x,mu\n1,0.3\n2,\n3,0.3\n", "2 rows with numbers are fewer than the 10 of a texture ove"),
        ("x,mu\n", "no row has all of x, mu"),
        ("PK\3\4", "is a spreadsheet, not a text: save it as CSV, or pass what pandas.read_excel"),
        ("\0\1\0\0\5", "is no text: it contains bytes of value 0"),
    ],
)
def test_csv_that_is_not_clear_is_refused(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.csv"
    path.write_text(text)
    with pytest.raises(ValueError) as refused:
        Texture.from_csv(path, position="x", cof="mu")
    assert str(refused.value).startswith(f"{path}: {reason}")


def test_line_of_a_bad_cell_is_found_far_below(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    path.write_text("made by us\n\nx,mu\n" + lines() * 400 + "\n1,many\n" + lines())
    with pytest.raises(ValueError, match=r"line 160405: column 'mu': 'many' is no finite number$"):
        Texture.from_csv(path, position="x", cof="mu")


def test_units_and_scales_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "lab.csv"
    path.write_text("x,mu\n" + lines())
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"unit": "ms"}, r"^unit 'ms' is none of m, cm, mm"),
        ({"scale": {"y": 2}}, r"^scale of 'y' is for none of x, mu$"),
        ({"scale": {"x": 0}}, r"^scale of 'x' is 0$"),
        ({"scale": -1}, r"^scale -1 is no mapping of columns to factors$"),
        ({"usecols": [1]}, r"^option usecols= of pandas\.read_csv is not taken: the reader sets"),
    ]
    for more, reason in wrong:
        with pytest.raises(ValueError, match=reason):
            Texture.from_csv(path, position="x", cof="mu", **more)


def test_options_are_those_of_pandas(reader: str, tmp_path: Path) -> None:
    path = tmp_path / "lab.csv"
    path.write_text("a,b\n" + lines() + "end of data,\n")
    options: dict[str, Any] = {"names": ["x", "mu"], "skiprows": 1, "na_values": ["end of data"]}
    if reader == "plain":
        with pytest.raises(BenchError, match=r"^option names= needs pandas: pip install 'smarttac"):
            Texture.from_csv(path, position="x", cof="mu", **options)
        return
    texture = Texture.from_csv(path, position="x", cof="mu", **options)
    assert texture.cof(X) == pytest.approx(MU, abs=2e-4)
    path.write_text("x,mu\n" + lines() + "# the end,\n")
    assert Texture.from_csv(path, position="x", cof="mu", comment="#") == texture
    with pytest.raises(ValueError, match=r"row 402: column 'x': '# the end' is no finite number$"):
        Texture.from_csv(path, position="x", cof="mu", thousands="'")
    path.write_text("x,mu,mu\n" + lines())
    with pytest.raises(ValueError, match=r"column 'mu' appears twice: rename one$"):
        Texture.from_csv(path, position="x", cof="mu", header=0)


def test_data_frame_is_taken_with_its_units() -> None:
    frame = pd.DataFrame({"x": X / 1e3, "mu": MU})
    with pytest.raises(ValueError, match=r"^DataFrame: positions -0\.01\.\.0\.01 mm give a table"):
        Texture.from_csv(frame, position="x", cof="mu")
    frame.attrs["units"] = {"x": "m", "mu": "1"}
    assert Texture.from_csv(frame, position="x", cof="mu").cof(X) == pytest.approx(MU, abs=2e-4)
    frame.loc[7, "mu"] = 9.0
    with pytest.raises(ValueError, match=r"^DataFrame: row 7: COF 9 is outside 0\.05\.\.2"):
        Texture.from_csv(frame, position="x", cof="mu")
    nullable = pd.DataFrame({"x": X, "mu": pd.array(MU, dtype="Float64")})
    nullable.loc[3, "mu"] = pd.NA
    assert read_table(nullable, ["x", "mu"]).left_out == 1
    with pytest.raises(ValueError, match=r"^DataFrame: there is no column 'y' among x, mu$"):
        Texture.from_csv(frame, position="y", cof="mu")


def test_force_and_track_of_two_rates_are_joined(tmp_path: Path) -> None:
    t, t_x = np.arange(0, 2, 1 / 6000), np.arange(0, 2, 0.01)
    x = 10 * np.sin(np.pi * t)
    cof = 0.35 + 0.05 * np.sin(2 * np.pi * x / 5)
    force, track = tmp_path / "force.csv", tmp_path / "track.csv"
    rows = np.c_[t * 1e3, cof, np.ones_like(t)]
    np.savetxt(force, rows, header="t [ms],Fx,Fz", delimiter=",", fmt="%.5f")
    np.savetxt(
        track, np.c_[t_x, np.sin(np.pi * t_x) / 100], delimiter=";", header="t;x", fmt="%.7f"
    )
    texture = Texture.from_csv(
        force, time="t", position="x", lateral="Fx", normal="Fz", track=track, unit="m"
    )
    at = np.linspace(-9, 9, 50)
    assert texture.cof(at) == pytest.approx(0.35 + 0.05 * np.sin(2 * np.pi * at / 5), abs=3e-3)
    for missing in ({"time": ""}, {"position": ""}, {"track": None}):
        columns = {"time": "t", "position": "x", "track": track} | missing
        with pytest.raises(ValueError, match=r"^give one of position and time, or both and track"):
            Texture.from_csv(force, lateral="Fx", normal="Fz", **columns)


def test_readers_give_the_same_numbers(
    reader: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lab.csv"
    draw = np.random.default_rng(6)
    frame = pd.DataFrame({"x": draw.uniform(-30, 30, 5000), "mu": draw.uniform(0.3, 0.4, 5000)})
    frame.mask(draw.random((5000, 2)) < 0.1).to_csv(path)
    found = read_table(path, ["x", "mu"])
    monkeypatch.setattr(lab_csv, "_has_pandas", lambda: reader == "plain")
    other = read_table(path, ["x", "mu"])
    assert found.left_out == other.left_out > 500
    for one, two in zip(found.values, other.values, strict=True):
        assert one == pytest.approx(two, rel=1e-15)
    assert re.fullmatch(r"line \d+", found.place(1234))
    assert found.place(1234) == other.place(1234)
