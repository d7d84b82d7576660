"""The command ``campaign``: results, files, and exit codes."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import pytest
from commands import refusal, run, succeed

from smarttac_can.cli import shared
from smarttac_can.science.population import trial
from smarttac_can.studies.campaign import runner

pytestmark = pytest.mark.usefixtures("compiled_once")
# The package shows the command under the name of its module.
command = import_module("smarttac_can.cli.experiments")
FEW = ("campaign", "--fingers", "4", "--dead-time", "auto", "--workers", "2")


def test_json_has_the_agreed_keys() -> None:
    said = json.loads(succeed(*FEW, "--json", "-"))
    names = ("rise_time_ms", "overshoot_percent", "static_error_percent", "chatter")
    for name in (*names, *(f"measured_{name}" for name in names)):
        assert list(said["metrics"][name]) == ["p5", "p50", "p95"]
    assert said["fingers"] == 4
    assert 0.0 <= said["limit_cycle_share"] <= 1.0
    assert 0.0 <= said["even_edges_share"] <= 1.0
    assert said["finger_seconds_per_second"] > 0.0
    assert said["dead_time_us"] == 540.0


def test_the_predictive_laws_overshoot_less_than_the_papers() -> None:
    overshoot, rise = [], []
    for laws in (("measured", "pi"), ("predictive", "predictive")):
        options = ("--fingers", "40", "--law", laws[0], "--vibration-law", laws[1])
        said = json.loads(succeed(*FEW, *options, "--json", "-"))
        assert (said["law"], said["vibration_law"]) == laws
        overshoot.append(said["metrics"]["overshoot_percent"]["p50"])
        rise.append(said["metrics"]["rise_time_ms"]["p50"])
    assert overshoot[1] <= 4.0 < overshoot[0]
    assert rise[1] <= 3.0 < rise[0]


def test_the_same_fingers_under_two_laws_keep_a_file_each(tmp_path: Path) -> None:
    laws = ("--law", "measured", "--law", "predictive", "--plates", "varied")
    kept = ("--resume", tmp_path / "rows", "--json", "-")
    both = json.loads(succeed(*FEW, *laws, *kept))["campaigns"]
    assert [(r["law"], r["vibration_law"], r["plates"]) for r in both] == [
        ("measured", "pi", "varied"),
        ("predictive", "pi", "varied"),
    ]
    alone = [
        json.loads(succeed(*FEW, "--law", r["law"], "--plates", "varied", "--json", "-"))
        for r in both
    ]
    again = json.loads(succeed(*FEW, *laws, *kept))["campaigns"]
    for r, other, resumed in zip(both, alone, again, strict=True):
        assert r["rows_sha256"] == other["rows_sha256"] == resumed["rows_sha256"]
        assert resumed["finger_seconds_per_second"] is None
    assert {path.name for path in tmp_path.iterdir()} == {
        "rows.measured-pi",
        "rows.predictive-pi",
    }


def test_lines_and_a_folder(tmp_path: Path) -> None:
    first, *_, last = succeed(*FEW, "--output", tmp_path / "out").splitlines()
    assert first.startswith("4 fingers, seed 1, law measured, vibration law pi, dead time 540 us")
    assert last == f"picture: {tmp_path / 'out' / 'campaign.png'}"
    assert (tmp_path / "out" / "fingers.csv").read_text().count("\n") == 5


def test_it_goes_on_and_a_damaged_file_is_one_line(tmp_path: Path) -> None:
    rows = tmp_path / "rows"
    first, again = (json.loads(succeed(*FEW, "--resume", rows, "--json", "-")) for _ in range(2))
    assert again["rows_sha256"] == first["rows_sha256"]
    assert again["finger_seconds_per_second"] is None
    other = refusal(*FEW, "--resume", rows, "--seed", "2")
    assert f"{rows}: is of another campaign: seed 1, not 2" in other
    rows.write_text("nonsense\n")
    assert refusal(*FEW, "--resume", rows) == f"{rows}: line 1 is damaged"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (
            ("--fingers", "3", *("--law", "measured") * 3, *("--vibration-law", "pi") * 2),
            2,
            "--vibration-law is given 2 times, --law 3 times: give one of them once",
        ),
        (
            ("--fingers", "3", *("--law", "measured") * 2),
            2,
            "law measured with vibration law pi is given twice",
        ),
        (
            ("--fingers", "3", "--resume", "rows", "--json", "./rows", "--force"),
            2,
            "rows is a file of --resume itself: choose another",
        ),
        (
            ("--fingers", "3", "--resume", "made/fingers.csv", "--output", "made"),
            2,
            "made/fingers.csv is a file of --resume itself: choose another",
        ),
        (("--fingers", "3", "--dead-time", "1000"), 2, "1000 us is outside 0..999"),
        (("--fingers", "3", "--workers", "2", "--dask", "tcp://x"), 2, "no meaning with --dask"),
        (
            ("--fingers", "3", "--resume", "/nowhere/rows"),
            1,
            "/nowhere/rows: the folder /nowhere does not exist",
        ),
    ],
)
def test_campaign_reports_errors_in_one_line(
    arguments: tuple[str, ...], code: int, message: str
) -> None:
    assert message in refusal("campaign", *arguments, code=code)


def test_campaign_without_numba_gives_the_same_and_can_resume(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rows = tmp_path / "rows"
    some = ("campaign", "--resume", str(rows), "--json", "-", "--fingers")
    with monkeypatch.context() as without:
        for module in (shared, runner):
            without.setattr(module, "can_compile", lambda: False)
        without.setattr(trial, "fastest", trial.plain)
        result = run(*some, "1")
    assert "numba is not installed" in result.stderr
    assert "smarttac-can[campaign]" in result.stderr
    plain = json.loads(result.stdout)
    assert plain["compiled"] is False
    pytest.importorskip("numba")
    one, two = (json.loads(succeed("campaign", "--json", "-", "--fingers", n)) for n in "12")
    for name, values in plain["metrics"].items():
        assert values == pytest.approx(one["metrics"][name], rel=1e-6)
    result = run(*some, "2")
    assert result.exit_code == 0, result.stderr
    mixed = json.loads(result.stdout)
    assert mixed["compiled"] is None
    assert f"some of the fingers in {rows} were run without numba" in result.stderr
    for name, values in mixed["metrics"].items():
        assert values == pytest.approx(two["metrics"][name], rel=1e-6)
    again = json.loads(succeed(*some, "1"))
    assert again["rows_sha256"] == plain["rows_sha256"]
    assert again["compiled"] is False


def test_campaign_of_laws_says_once_that_numba_was_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mixed = runner.run_campaign(trial.Campaign(), 1)._replace(compiled=None)
    monkeypatch.setattr(command, "run_campaign", lambda *_, **__: mixed)
    result = run(*FEW, "--law", "measured", "--law", "predictive", "--json", "-")
    assert result.exit_code == 0, result.stderr
    assert result.stderr.count("were run without numba") == 1


def test_campaign_says_once_that_the_loop_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    result = run(*FEW, "--json", "-")
    assert result.stderr == ""
    made = runner.run_campaign(trial.Campaign(), 1)
    results = iter([made._replace(not_kept="the compiled loop was not kept"), made])
    monkeypatch.setattr(command, "run_campaign", lambda *_, **__: next(results))
    result = run(*FEW, "--law", "measured", "--law", "predictive", "--json", "-")
    assert result.exit_code == 0, result.stderr
    assert result.stderr == "the compiled loop was not kept\n"


def test_each_campaign_has_a_bar_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: dict[str, list[float]] = {}

    @contextmanager
    def progress_bar(label: str) -> Iterator[Callable[[float], None]]:
        yield shown.setdefault(label, []).append

    monkeypatch.setattr(command, "progress_bar", progress_bar)
    succeed(*FEW, "--json", "-")
    succeed(*FEW, "--law", "measured", "--law", "predictive", "--json", "-")
    assert list(shown) == ["campaign", "campaign 1 of 2", "campaign 2 of 2"]
    assert {shares[-1] for shares in shown.values()} == {1.0}
