"""The compiled loop on disk: who loads it, when its folder is another one, and what can fail."""

import os
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from io import BytesIO
from pathlib import Path

import pytest

import smarttac_can
from smarttac_can.science.population.compiled import compiled
from smarttac_can.science.population.fingers import lift
from smarttac_can.studies.campaign import kept_loop
from smarttac_can.studies.campaign.kept_loop import prepare

numba = pytest.importorskip("numba")


@cache
def small():
    """Give a function that compiles in a second, instead of the loop."""
    return compiled(lift), None


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Give the folder of all versions; the small function stands for the loop."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(kept_loop, "fastest", small)
    monkeypatch.setattr(kept_loop, "outcome_of", lambda *_: small()[0](0.25))
    small.cache_clear()
    yield tmp_path / "smarttac-can" / "numba"
    small.cache_clear()


def start():
    """Begin as a process does; return what is said, and how often numba loaded and compiled."""
    small.cache_clear()
    said = prepare()
    assert small()[0](0.25) == lift(0.25)
    stats = small()[0].stats
    return said, sum(stats.cache_hits.values()), sum(stats.cache_misses.values())


PROCESS = """
import sys
from smarttac_can.science.population.trial import fastest
from smarttac_can.studies.campaign.kept_loop import prepare
assert prepare() == ""
stats = fastest()[0].stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""


def test_second_process_loads_the_loop_and_compiles_nothing(compiled_once):
    run = subprocess.run(
        [sys.executable, "-c", PROCESS], capture_output=True, text=True, check=True
    )
    assert (run.stdout.split(), run.stderr) == (["1", "0"], "")


def test_first_start_compiles_and_second_one_loads(folders):
    assert start() == ("", 0, 1)
    assert start() == ("", 1, 0)
    assert len(list(folders.iterdir())) == 1


def test_progress_is_reported_while_compiling_only(folders):
    shares, loaded = [], []
    prepare(shares.append)
    assert shares == sorted(shares)
    assert 0.0 < shares[0] <= shares[-1] <= 1.0
    small.cache_clear()
    prepare(loaded.append)
    assert loaded == []


def test_prepare_runs_once_per_process(folders, monkeypatch):
    assert prepare() == ""
    monkeypatch.setattr(kept_loop, "outcome_of", lambda *_: pytest.fail("it ran again"))
    assert prepare() == ""


def test_loop_that_numba_must_not_compile_is_left_alone(monkeypatch):
    """As with NUMBA_DISABLE_JIT."""
    monkeypatch.setattr(kept_loop, "fastest", lambda: (lift, None))
    monkeypatch.setattr(kept_loop, "_folder", lambda: pytest.fail("nothing is kept"))
    assert prepare() == ""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Give a package with a source in each room, which stands for this one."""
    root = tmp_path / "package"
    for name in ("science/plant/a.py", "vocabulary/b.py", "canopen/od/c.py", "cli/d.py"):
        (root / name).parent.mkdir(parents=True)
        (root / name).write_text("x = 1\n")
    monkeypatch.setattr(smarttac_can, "__file__", str(root / "__init__.py"))
    return root


@pytest.mark.parametrize("name", ["science/plant/a.py", "vocabulary/b.py", "canopen/od/c.py"])
def test_folder_is_another_for_a_changed_source(package, name):
    before = kept_loop._folder()
    assert kept_loop._folder() == before
    (package / name).write_text("x = 2\n")
    assert kept_loop._folder() != before
    (package / name).write_text("x = 1\n")
    assert kept_loop._folder() == before
    (package / name).rename((package / name).with_name("renamed.py"))
    assert kept_loop._folder() != before


def test_folder_is_the_same_for_sources_the_loop_cannot_see(package):
    before = kept_loop._folder()
    (package / "cli" / "d.py").write_text("x = 2\n")
    assert kept_loop._folder() == before


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        ("sys", "version", "3.99"),
        ("numba", "__version__", "0.99"),
        ("llvmlite", "__version__", "0.99"),
        ("llvmlite.binding", "get_host_cpu_name", lambda: "another"),
    ],
)
def test_folder_is_another_for_a_version_or_processor(package, monkeypatch, module, name, value):
    before = kept_loop._folder()
    monkeypatch.setattr(f"{module}.{name}", value)
    assert kept_loop._folder() != before


def test_cache_is_in_xdg_cache_home_or_the_home(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert kept_loop._folder().parent == tmp_path / "xdg" / "smarttac-can" / "numba"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert kept_loop._folder().parent == tmp_path / ".cache" / "smarttac-can" / "numba"


def unwritable(*_, **__):
    raise PermissionError(13, "Permission denied")


def test_folder_that_cannot_be_made_is_one_line(folders):
    folders.parent.write_text("a file")
    for _ in range(2):
        said, hits, misses = start()
        assert (hits, misses) == (0, 1)
        assert said.startswith(f"the compiled loop was not kept in {folders}")
        assert said.endswith("compiles again: NUMBA_CACHE_DIR names another folder")
        assert "\n" not in said


def test_folder_that_cannot_be_written_is_one_line(folders, monkeypatch):
    monkeypatch.setattr(tempfile, "TemporaryFile", unwritable)
    said, hits, misses = start()
    assert said.startswith(f"the compiled loop was not kept in {folders}")
    assert (hits, misses) == (0, 1)
    assert not any(folders.iterdir())


def test_numba_never_keeps_the_loop_beside_its_source(folders, monkeypatch):
    """It would, if it can write there only; that cache does not see a change of another file."""
    beside = Path(sys.modules[lift.__module__].__file__).parent
    monkeypatch.setattr(
        tempfile,
        "TemporaryFile",
        lambda dir: BytesIO() if Path(dir).parent == beside else unwritable(),
    )
    said, hits, misses = start()
    assert "(numba cannot write there)" in said
    assert (hits, misses) == (0, 1)


def test_missing_home_is_one_line(folders, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)

    def nowhere():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", nowhere)
    said, hits, misses = start()
    assert said.startswith("the compiled loop was not kept (Could not determine home directory.)")
    assert (hits, misses) == (0, 1)


def test_full_disk_is_one_line_and_compiles_once(folders, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    said, hits, misses = start()
    assert "No space left on device" in said
    assert (hits, misses) == (0, 1)
    assert not any(folders.iterdir())


@pytest.mark.parametrize("content", [b"", b"nonsense\n", b"\x80\x05"])
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_damaged_cache_is_replaced(folders, ending, content):
    start()
    (file,) = folders.rglob(f"*.{ending}")
    file.write_bytes(content)
    said, hits, misses = start()
    assert said.startswith(f"the compiled loop was not kept in {folders}")
    assert (hits, misses) == (0, 1)
    assert start() == ("", 0, 1)
    assert start() == ("", 1, 0)


def test_loop_that_fails_raises_its_own_error(folders, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("in the loop")

    monkeypatch.setattr(kept_loop, "outcome_of", fail)
    with pytest.raises(ZeroDivisionError, match="in the loop"):
        prepare()


def test_folders_unused_for_longest_are_removed(folders):
    for age in range(6):
        (old := folders / f"version-{age}").mkdir(parents=True)
        (old / "loop.nbc").touch()
        os.utime(old, (1e9 - age, 1e9 - age))
    assert start() == ("", 0, 1)
    left = {path.name for path in folders.iterdir()}
    assert len(left) == kept_loop._KEPT
    assert {f"version-{age}" for age in range(3)} < left
    assert start() == ("", 1, 0)


SMALL = """
import sys
sys.path.append(sys.argv[1])
from smarttac_can.studies.campaign import kept_loop
from test_kept_loop import small, start
kept_loop.fastest = small
kept_loop.outcome_of = lambda *_: small()[0](0.25)
print("ready", flush=True)
sys.stdin.readline()
print(start())
"""


def test_two_processes_compile_at_once(folders):
    command = [sys.executable, "-c", SMALL, str(Path(__file__).parent)]
    # Elsewhere than in the tree, whose sources `python -c` would take before a compiled build.
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": folders}
    folders.mkdir(parents=True)
    both = [subprocess.Popen(command, **pipes) for _ in range(2)]
    for process in both:
        assert process.stdout.readline() == "ready\n"
    for process in both:
        process.stdin.write("\n")
        process.stdin.flush()
    said = {process.communicate()[0] for process in both}
    assert said <= {"('', 0, 1)\n", "('', 1, 0)\n"}
    assert "('', 0, 1)\n" in said
    assert start() == ("", 1, 0)


def test_folder_removed_while_compiling_is_made_again(folders, monkeypatch):
    run = kept_loop.outcome_of

    def removed(*arguments):
        shutil.rmtree(folders)
        return run(*arguments)

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(kept_loop, "outcome_of", removed)
        assert start() == ("", 0, 1)
    assert start() == ("", 1, 0)
