"""No command replaces results without ``--force``, and no old ones stay beside new ones."""

from importlib import import_module
from pathlib import Path

import pytest
from commands import refusal, run, succeed
from commands_of import commands_of

from smarttac_can.cli import main
from smarttac_can.cli.evidence import main as evidence
from smarttac_can.cli.shared import result_folder

EDS = Path(__file__).parents[2] / "eds" / "plate.eds"
CHANNEL = ("--interface", "virtual", "--channel", "results")
OTHER_FILE = "choose another file, or replace it with --force"
OTHER_FOLDER = "choose another folder, or replace older results in it with --force"


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smarttac_can.studies.paper.experiments.PASSES", 4)


FILES: dict[str, tuple[str | Path, ...]] = {
    "reproduce --json": ("reproduce", "fig3", "--json"),
    "reproduce --animate": ("reproduce", "fig3", "--animate"),
    "campaign --json": ("campaign", "--fingers", "1000000", "--json"),
    "fit-finger --json": ("fit-finger", __file__, "--json"),
    "faults --json": ("faults", "--json"),
    "soak --json": ("soak", "--hours", "1000", "--json"),
    "sensors --json": ("sensors", "--jobs", "1", "--random", "1000000", "--json"),
    "attack --json": ("attack", "--actions", "1000000", "--json"),
    "scan --json": ("scan", *CHANNEL, "--timeout", "0.01", "--json"),
    "conform --json": ("conform", *CHANNEL, "--eds", "plate", "--node-id", "5", "--json"),
    "conform --report": ("conform", *CHANNEL, "--eds", "plate", "--node-id", "5", "--report"),
    "jitter --json": ("jitter", *CHANNEL, "--json"),
    "replay --json": ("replay", __file__, "--json"),
    "record --json": ("record", "new.h5", *CHANNEL, "--json"),
    "selftest --json": ("selftest", *CHANNEL, "--json"),
    "sdo read --json": ("sdo", "read", "5", "1018sub1", "--eds", "plate", *CHANNEL, "--json"),
    "status --json": ("status", *CHANNEL, "--json"),
    "calibrate --certificate": ("calibrate", __file__, *CHANNEL, "--certificate"),
    "eds check --json": ("eds", "check", "plate", "--json"),
    "eds load --json": ("eds", "load", EDS, *CHANNEL, "--json"),
    "eds save --json": ("eds", "save", "new.dcf", "--node-id", "5", *CHANNEL, "--json"),
    "eds diff --json": ("eds", "diff", EDS, EDS, "--node-id", "5", "--json"),
    "eds show --output": ("eds", "show", "plate", "--output"),
    "eds doc --output": ("eds", "doc", "plate", "--output"),
    "eds dbc --output": ("eds", "dbc", "plate", "--output"),
    "eds dcf --output": (
        *("eds", "dcf", "plate", "--node-id", "5", "--bitrate", "500000"),
        "--output",
    ),
}


@pytest.mark.parametrize("arguments", FILES.values(), ids=FILES)
def test_a_file_with_results_is_kept(arguments: tuple[str | Path, ...], tmp_path: Path) -> None:
    file = tmp_path / "kept"
    file.write_text("of last week")
    assert refusal(*arguments, file) == f"{file} exists: {OTHER_FILE}"
    assert content(tmp_path) == {"kept": b"of last week"}


@pytest.mark.parametrize(
    "name", sorted(FILES.keys() - {"reproduce --animate", "calibrate --certificate"})
)
def test_results_refuse_a_missing_folder_before_the_run(name: str, tmp_path: Path) -> None:
    """``--animate`` creates its folder, and ``calibrate`` reads its plan first."""
    file = tmp_path / "missing" / "result"
    assert refusal(*FILES[name], file) == f"{file}: the folder {file.parent} does not exist"
    assert content(tmp_path) == {}


def test_each_command_with_results_has_force_and_a_case_here() -> None:
    commands = [command for group in (main, evidence) for _, command in commands_of(group)]
    options = {
        f"{command.name} {parameter.opts[0]}"
        for command in commands
        for parameter in command.params
        if parameter.opts[0]
        in ("--json", "--output", "--report", "--log", "--certificate", "--animate")
    }
    with_force = {
        command.name
        for command in commands
        if any(parameter.opts[0] == "--force" for parameter in command.params)
    }
    assert {name.partition(" ")[0] for name in options} <= with_force
    cases = {name.removeprefix("eds ").removeprefix("sdo ") for name in FILES} | set(FOLDERS)
    assert options == cases


FOLDERS = {
    "reproduce --output": ("reproduce", "fig5"),
    "demo --output": ("demo",),
    "campaign --output": ("campaign", "--fingers", "1000000"),
    "jitter --output": ("jitter", *CHANNEL),
}


@pytest.mark.parametrize("arguments", FOLDERS.values(), ids=FOLDERS)
def test_a_folder_with_results_is_kept(arguments: tuple[str, ...], tmp_path: Path) -> None:
    for name in ("traces.csv", "results.json", "fig7.png", "fig7.svg", "index.html"):
        (tmp_path / name).write_text(name)
    before = content(tmp_path)
    listed = "fig7.png, fig7.svg, index.html, 2 more"
    assert refusal(*arguments, "--output", tmp_path) == (
        f"the folder {tmp_path} is not empty ({listed}): {OTHER_FOLDER}"
    )
    assert content(tmp_path) == before


@pytest.mark.parametrize("arguments", FOLDERS.values(), ids=FOLDERS)
def test_a_folder_below_a_file_is_refused_before_the_run(
    arguments: tuple[str, ...], tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.touch()
    line = refusal(*arguments, "--output", file / "below")
    assert line == f"{file / 'below'}: {file} is a file, not a folder"
    assert content(tmp_path) == {"file": b""}


def test_a_folder_is_no_file_and_a_file_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert "is a file" in refusal("reproduce", "fig3", "--output", tmp_path / "file", code=2)
    assert "is a directory" in refusal("reproduce", "fig3", "--json", tmp_path, code=2)


@pytest.mark.parametrize("path", ["-", "/dev/null"])
def test_stdout_and_devices_hold_nothing(path: str) -> None:
    succeed("reproduce", "fig3", "--json", path)


def test_results_take_an_empty_or_hidden_file_as_free(tmp_path: Path) -> None:
    file, folder = tmp_path / "made.json", tmp_path / "run"
    file.touch()
    folder.mkdir()
    (folder / ".gitkeep").touch()
    succeed("reproduce", "fig3", "--json", file, "--output", folder)
    assert file.read_text() == (folder / "results.json").read_text()
    assert set(content(folder)) == {".gitkeep", "results.json"}


def test_force_removes_results_of_the_last_run_and_nothing_else(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    folder = tmp_path / "run"
    succeed("reproduce", "fig5", "--link", "bus", "--output", folder)
    succeed("report", folder)
    assert {"candump.log", "fig5.png", "index.html"} <= set(content(folder))
    (folder / "notes.txt").write_text("mine")
    refusal("reproduce", "fig3", "--output", folder)
    succeed("reproduce", "fig3", "--output", folder, "--force")
    assert set(content(folder)) == {"results.json", "notes.txt"}


def test_force_at_a_file(tmp_path: Path) -> None:
    file = tmp_path / "plate.eds"
    file.write_text("old")
    succeed("eds", "show", "plate", "--force", "--output", file)
    assert run("eds", "show", "plate").stdout_bytes == file.read_bytes()
    assert set(content(tmp_path)) == {"plate.eds"}


def fail(folder: Path) -> None:
    with result_folder(folder, ("results.json",)) as made:
        (made / "results.json").write_text("half")
        raise OSError


def test_a_run_that_fails_leaves_the_older_results(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text("whole")
    with pytest.raises(OSError):
        fail(tmp_path)
    assert content(tmp_path) == {"results.json": b"whole"}


def test_a_full_disk_is_named(tmp_path: Path) -> None:
    def write(folder: Path) -> None:
        with result_folder(folder, ()):
            raise OSError(28, "No space left on device")

    with pytest.raises(OSError) as told:
        write(tmp_path)
    assert told.value.filename == str(tmp_path)


def test_results_error_names_the_path_as_given(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError) as told, result_folder(tmp_path / "file" / "below", ()):
        pass
    assert told.value.filename == str(tmp_path / "file" / "below")


INTERRUPTED = {
    "reproduce": ("smarttac_can.cli.experiments.run_reproduction", FOLDERS["reproduce --output"]),
    "demo": ("smarttac_can.cli.experiments.run_reproduction", FOLDERS["demo --output"]),
    "campaign": ("smarttac_can.cli.experiments.run_campaign", FOLDERS["campaign --output"]),
}


@pytest.mark.parametrize(("work", "arguments"), INTERRUPTED.values(), ids=INTERRUPTED)
@pytest.mark.parametrize("there", [False, True])
def test_an_interrupted_run_leaves_no_folder_that_was_not_there(
    work: str,
    arguments: tuple[str, ...],
    there: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    module, _, name = work.rpartition(".")
    monkeypatch.setattr(import_module(module), name, interrupt)
    folder = tmp_path / "new"
    if there:
        folder.mkdir()
    result = run(*arguments, "--output", folder)
    assert (result.exit_code, result.stderr) == (1, "\nAborted!\n")
    assert list(tmp_path.iterdir()) == ([folder] if there else [])
