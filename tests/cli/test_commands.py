"""Every command by click's runner: help, results, files, and one line for an error."""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
import PIL.Image
import pytest
from commands import refusal, succeed
from commands_of import commands_of

import smarttac_can
from smarttac_can import __version__, build
from smarttac_can.cli import main

COMMANDS = sorted(main.list_commands(click.Context(main)))
FIRST_RUN = Path(__file__).parents[2] / "docs" / "tutorial" / "first-run.md"


@pytest.fixture(autouse=True)
def short_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few passes of a finger and short strokes: these tests are not about the numbers."""
    monkeypatch.setattr("smarttac_can.studies.paper.experiments.PASSES", 6)
    monkeypatch.setattr("smarttac_can.studies.paper.experiments._FIG2_S", 0.4)


def test_the_commands() -> None:
    assert {"demo", "reproduce", "report", "node", "plate"} <= set(COMMANDS)
    listed = succeed("--help")
    assert all(f"\n  {command} " in listed for command in COMMANDS)


@pytest.mark.parametrize("command", [(), *(path for path, _ in commands_of(main))], ids=" ".join)
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help_shows_an_example(command: tuple[str, ...], flag: str) -> None:
    text, example, shown = succeed(*command, flag).partition("Example")
    assert example
    assert "`" not in text
    assert " ".join(("smarttac", *command)) in shown


def test_version() -> None:
    assert succeed("--version").endswith(f"version {__version__} ({build()})\n")


@pytest.mark.parametrize(
    ("file", "named"),
    [
        ("skin.py", "sources"),
        ("skin.cpython-311-x86_64-linux-gnu.so", "compiled"),
        ("skin.cp312-win_amd64.pyd", "compiled"),
    ],
)
def test_the_build_is_named_by_the_file_of_the_loop(monkeypatch, tmp_path, file, named) -> None:
    (tmp_path / "science" / "plant").mkdir(parents=True)
    (tmp_path / "science" / "plant" / file).touch()
    monkeypatch.setattr(smarttac_can, "__file__", str(tmp_path / "__init__.py"))
    assert build() == named


def test_as_a_module() -> None:
    def module(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-W", "error", "-m", "smarttac_can", *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    done = module("reproduce", "fig5", "--json", "-")
    assert json.loads(done.stdout)["fig5"]["amplitude_only"]["response_time_ms"] > 4.0
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    wrong = module("reproduce", "fig9")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr.splitlines()[-1].startswith("Error: Invalid value")


def keys(tree: Any, at: str = "") -> set[str]:
    if isinstance(tree, dict):
        return {at} | {k for n, v in tree.items() for k in keys(v, f"{at}.{n}".strip("."))}
    if isinstance(tree, list) and tree and isinstance(tree[0], dict):
        return {at} | {k for v in tree for k in keys(v, f"{at}[i]")}
    return {at}


Demo = tuple[Path, subprocess.CompletedProcess[str]]
DEMO = """
import atexit, pathlib, re
def tell():
    status = pathlib.Path("/proc/self/status").read_text()
    pathlib.Path("size").write_text(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1])
atexit.register(tell)
from smarttac_can.studies.paper import experiments
from smarttac_can.cli import main
experiments.PASSES = 10
main(["demo"])
"""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """Folder in which a process has run ``demo``, and its output."""
    place = tmp_path_factory.mktemp("demo")
    command = [sys.executable, "-c", DEMO]
    done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    return place, done


@pytest.fixture(scope="module")
def everything(demo: Demo) -> Path:
    """Output folder of all experiments over a bus."""
    (folder,) = (path for path in demo[0].iterdir() if path.name != "size")
    return folder


def test_the_demo_takes_less_than_500_mb(demo: Demo) -> None:
    """By its own figure: the system counts its parent, too."""
    assert int((demo[0] / "size").read_text()) * 1024 < 500e6


def test_the_keys_of_the_results(everything: Path) -> None:
    results = json.loads((everything / "results.json").read_text())
    found = keys(results)
    loops = ("amplitude_only", "amplitude_and_frequency")
    metrics = ("rise_time_ms", "overshoot_percent", "static_error_percent")
    table = ("subjects[i]", "mean", "std")
    assert found >= {
        *(f"fig5.{loop}.response_time_ms" for loop in loops),
        *(f"fig5.{loop}.steady_amplitude_um" for loop in loops),
        *(f"fig5.{loop}.final_frequency_hz" for loop in loops),
        *(f"fig6.{loop}.voltage_v" for loop in loops),
        "fig6.voltage_difference_percent",
        *(f"table1.{row}.{metric}" for row in table for metric in metrics),
        *(f"table1.down.{row}.{metric}" for row in table for metric in metrics),
        *(f"table1.touches.{row}.{metric}" for row in table for metric in metrics),
        *(f"table1.down.touches.{row}.{metric}" for row in table for metric in metrics),
        *("trace_sha256", "seed", "law", "link", "dead_time_us", "version"),
        *("fig2.mean_ratio_percent", "fig3.step_um"),
    }
    assert len(results["table1"]["subjects"]) == 4
    assert (results["seed"], results["law"], results["link"]) == (1, "measured", "bus")
    assert results["unavailable"] == {}


def test_a_bus_leaves_its_log(everything: Path) -> None:
    first = (everything / "candump.log").read_text(encoding="ascii").partition("\n")[0]
    assert first.startswith("(0000000000.")
    assert " can0 721#00" in first, "the plate's boot-up"


@pytest.fixture
def bars(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[float]]:
    """Fractions that were shown by each progress bar of a command, by its label."""
    shown: dict[str, list[float]] = {}

    @contextmanager
    def bar(label: str) -> Iterator[Callable[[float], None]]:
        yield shown.setdefault(label, []).append

    monkeypatch.setattr("smarttac_can.cli.experiments.progress_bar", bar)
    return shown


def test_report_draws_the_folder_again(everything: Path, bars: dict[str, list[float]]) -> None:
    page = (everything / "index.html").read_text(encoding="utf-8")
    for figure in ("fig2", "fig3", "fig5", "fig6", "fig7"):
        assert (everything / f"{figure}.png").read_bytes().startswith(b"\x89PNG")
        assert figure in page.lower().replace(". ", "").replace("figure ", "fig")
    first = (everything / "fig5.png").read_bytes()
    (everything / "fig5.png").unlink()
    said = succeed("report", everything)
    assert said == f"pictures: {everything / 'index.html'}\n"
    assert bars == {"drawing": [0.2, 0.4, 0.6, 0.8, 1.0]}
    assert (everything / "index.html").read_text(encoding="utf-8") == page
    assert (everything / "fig5.png").read_bytes() == first


def test_reproduce_with_a_law_and_a_load() -> None:
    arguments = ("--vibration-law", "predictive", "--load", "0.5", "--dead-time", "540")
    results = json.loads(succeed("reproduce", "fig5", *arguments, "--json", "-"))
    assert (results["vibration_law"], results["load_n"]) == ("predictive", 0.5)
    text = succeed("reproduce", "fig5", *arguments)
    for name, loops in (
        ("amplitude loop alone", "amplitude_only"),
        ("both loops", "amplitude_and_frequency"),
    ):
        step = results["fig5"][loops]["step"]
        assert (
            f"1 to 1.5 um, {name}: settles in {step['settling_time_ms']:.2f} ms, "
            f"overshoot {step['overshoot_percent']:.1f} %"
        ) in text


def test_reproduce_animates_the_crossing(tmp_path: Path, bars: dict[str, list[float]]) -> None:
    file = tmp_path / "crossing.gif"
    succeed("reproduce", "table1", "--animate", file)
    assert list(bars) == ["running", "drawing"]
    assert len(bars["drawing"]) > 20
    assert bars["drawing"][-1] == 1.0
    with PIL.Image.open(file) as picture:
        assert picture.is_animated
        assert picture.n_frames > 20
        first = np.asarray(picture.convert("RGB"))
        picture.seek(10)
        assert (np.asarray(picture.convert("RGB")) != first).any()
    assert [made.name for made in tmp_path.iterdir()] == [file.name]
    named = tmp_path / "crossing.png"
    assert "has to end in .gif" in refusal("reproduce", "--animate", named, code=2)


def test_reproduce_shows_a_table_and_keeps_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = succeed("reproduce", "fig5", "fig6")
    assert "5 % response time, both loops" in text
    assert "inside" in text
    assert list(tmp_path.iterdir()) == []


def test_the_conditions_of_a_run_are_in_its_results() -> None:
    given = ("--law", "predictive", "--seed", "7", "--link", "local", "--dead-time", "250")
    results = json.loads(succeed("reproduce", "fig3", *given, "--json", "-"))
    names = ("law", "seed", "link", "dead_time_us")
    assert [results[name] for name in names] == ["predictive", 7, "local", 250]
    late = json.loads(succeed("reproduce", "fig3", "--dead-time", "auto", "--json", "-"))
    assert 300 < late["dead_time_us"] < 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("fig5", "--load", "0.04"), "0.04 N is neither 0 nor in 0.05..2"),
        (("fig5", "--load", "2.1"), "2.1 N is neither 0 nor in 0.05..2"),
        (("fig5", "--load", "nan"), "nan N is neither 0 nor in 0.05..2"),
        (("table1", "--load", "0.5"), "--load is for fig5 and fig6"),
        (("--dead-time", "1000"), "1000 us is outside 0..999"),
        (("--dead-time", "nan"), "nan us is outside 0..999"),
        (("--dead-time", "soon"), "'soon' is neither 'auto' nor a number of us"),
    ],
)
def test_reproduce_refuses(arguments: tuple[str, ...], message: str) -> None:
    assert message in refusal("reproduce", *arguments, code=2)


def test_report_refuses_folders_without_a_run(everything: Path, tmp_path: Path) -> None:
    assert "does not exist" in refusal("report", tmp_path / "missing", code=2)
    told = refusal("report", tmp_path)
    assert f"results.json: smarttac reproduce --output {tmp_path} makes it" in told
    (tmp_path / "results.json").write_text("{")
    assert str(tmp_path) in refusal("report", tmp_path)
    (tmp_path / "results.json").write_text((everything / "results.json").read_text())
    assert f"there is no {tmp_path / 'traces.csv'}: sm" in refusal("report", tmp_path)
    (tmp_path / "traces.csv").write_text("tick\n1\n")
    assert "line 1 is neither # format: SMARTTAC traces 2 nor experiment,subject" in refusal(
        "report", tmp_path
    )
    (tmp_path / "traces.csv").write_text((everything / "traces.csv").read_text())
    (tmp_path / "results.json").write_text("[]")
    assert str(tmp_path) in refusal("report", tmp_path)


def test_demo(demo: Demo, everything: Path) -> None:
    _, result = demo
    assert (result.returncode, result.stderr) == (0, ""), "progress is for a terminal"
    assert everything.name.startswith("smarttac-demo-")
    assert result.stdout.endswith(f"pictures: {everything.name}/index.html\n")
    assert {path.name for path in everything.iterdir()} >= {
        *("index.html", "results.json", "traces.csv", "candump.log"),
        *(f"fig{n}.png" for n in (2, 3, 5, 6, 7)),
    }
    shown = re.findall(r"^.*  inside$", FIRST_RUN.read_text("utf-8"), re.MULTILINE)
    assert len(shown) == 3
    assert set(shown) <= set(result.stdout.splitlines())
    assert "dead time 0 us" in result.stdout


def test_help_shows_the_commands_by_family() -> None:
    titles = [line.strip(":") for line in succeed("--help").splitlines() if line[:1].isalpha()]
    assert titles[1:] == ["Options", "Use", "Bench", "Commission", "Verify"]
