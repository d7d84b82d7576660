"""``tools/mutate`` tries the changes of a tiny package, of which its test notices some."""

import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

TOOL = Path(__file__).parents[2] / "tools" / "mutate"
SOURCE = '''\
"""A module with a limit and two clauses."""

from typing import Final

LIMIT: Final = 5


def over(value: int, armed: bool) -> bool:
    """Return whether there is a fault."""
    return armed and value > LIMIT


def unused() -> float:
    """Return what no test asks for."""
    return 1.5
'''
TEST = """\
import pytest

from made_up.small.limits import over

@pytest.mark.parametrize(("value", "fault"), [(7, True), (5, False)])
def test_over(value, fault):
    assert over(value, True) == fault
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a tree with a package, and its test in the mirror directory."""
    for name, text in (
        ("made_up/small/limits.py", SOURCE),
        ("tests/small/test_limits.py", TEST),
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True)
        path.write_text(text)
    (tmp_path / "docs" / "reference").mkdir(parents=True)
    return tmp_path


def mutate(tree: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run the tool in a tree."""
    return subprocess.run(
        [sys.executable, TOOL, "--package", "made_up/small", "--jobs", "1", *options],
        cwd=tree, capture_output=True, text=True, check=False,
    )  # fmt: skip


def rows(run: subprocess.CompletedProcess[str]) -> list[str]:
    """Sort the survivors that were printed, without their module."""
    printed = [line.split(" | ", 1)[1] for line in run.stdout.splitlines() if " | " in line]
    return sorted(line.strip().removesuffix(" |") for line in printed)


SURVIVORS = [
    "LIMIT: Final = 5 | 5 -> 6",
    "return 1.5 | 1.5 -> 0.75",
    "return 1.5 | 1.5 -> 3.0",
    "return armed and value > LIMIT | armed and value > LIMIT -> value > LIMIT",
]


def test_it_lists_what_no_test_notices(tree: Path) -> None:
    run = mutate(tree)
    assert rows(run) == SURVIVORS
    assert "made_up/small: 7 of 7 changes tried, 4 survive, 4 unexplained" in run.stdout
    assert run.returncode == 1
    assert (tree / "made_up/small/limits.py").read_text() == SOURCE


@pytest.mark.parametrize("each", [True, False], ids=["of a change", "of a line"])
def test_it_explains_survivors_and_writes_their_counts(tree: Path, each: bool) -> None:
    page = tree / "docs/reference/mutants.md"
    page.write_text("# Old\n\n| `other/package` | 1 | 1 | 0 | 0 | `stays` |\n")
    line = 'line = "return 1.5"' if each else 'lines = ["return 1.5"]'
    reason = f'module = "made_up/small/limits.py"\n{line}\nwhy = "nobody asks"\n'
    (tree / "tools").mkdir()
    by_change = (f'change = "1.5 -> {to}"\n' for to in ("0.75", "3.0"))
    entries = by_change if each else ("",)
    (tree / "tools/mutants.toml").write_text(
        "".join(f"[[equivalent]]\n{reason}{change}" for change in entries)
    )
    run = mutate(tree, "--write")
    assert "4 survive, 2 unexplained" in run.stdout
    assert "| return 1.5 | 1.5 -> 3.0 | nobody asks\n" in run.stdout
    assert "| LIMIT: Final = 5 | 5 -> 6 | \n" in run.stdout
    text = page.read_text()
    assert "| `made_up/small` | 7 | 7 | 4 | 2 | `tests/small` |\n" in text
    assert "| `other/package` | 1 | 1 | 0 | 0 | `stays` |\n" in text


def test_it_ends_with_the_minutes_and_says_of_how_many(tree: Path) -> None:
    run = mutate(tree, "--minutes", "0")
    assert "0 of 7 changes tried, 0 survive, 0 unexplained" in run.stdout
    assert run.returncode == 0


def test_tests_that_fail_as_they_are_say_nothing(tree: Path) -> None:
    (tree / "tests/small/test_limits.py").write_text(TEST.replace("(5, False)", "(6, False)"))
    run = mutate(tree)
    assert run.returncode == 1
    assert "tests/small: the tests do not pass as they are" in run.stderr


def test_a_change_that_hangs_is_noticed(tree: Path) -> None:
    (tree / "made_up/small/limits.py").write_text(
        "def over(value, armed):\n    while not armed:\n        pass\n    return value > LAST\n\n\n"
        "LAST = len('seven')\n"
    )
    tool = tree / "mutate.py"
    text = TOOL.read_text()
    assert "STARTING_S: Final = 30.0" in text
    tool.write_text(text.replace("STARTING_S: Final = 30.0", "STARTING_S: Final = 3.0"))
    shutil.copy(TOOL.parent / "mutants.py", tree)
    run = subprocess.run(
        [sys.executable, tool, "--package", "made_up/small"],
        cwd=tree, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "2 of 2 changes tried, 0 survive" in run.stdout


def test_a_statement_that_no_test_misses_is_listed_in_a_row_of_its_own(tree: Path) -> None:
    values = "| `made_up/small` | 7 | 7 | 4 | 2 | `tests/small` |\n"
    (tree / "docs/reference/mutants.md").write_text(values)
    (tree / "made_up/small/limits.py").write_text(
        "def over(value, armed):\n    log = []\n    last = 5\n    log.append(value)\n"
        "    return armed and value > last\n"
    )
    run = mutate(tree, "--statements", "--write")
    assert rows(run) == ["log.append(value) | log.append(value) -> pass"]
    text = (tree / "docs/reference/mutants.md").read_text()
    assert values in text
    assert "| `made_up/small, statements removed` | 3 | 3 | 1 | 1 | `tests/small` |\n" in text


@pytest.fixture
def mutants(load: Callable[[str], ModuleType]) -> ModuleType:
    return load("mutants.py")


@pytest.mark.parametrize(
    ("source", "changes"),
    [
        ("x = 5", ["5 -> 4", "5 -> 6"]),
        ("x = 200", ["200 -> 100", "200 -> 400"]),
        ("x = 0.8", ["0.8 -> 0.4", "0.8 -> 1.6"]),
        ("x = 0.0", ["0.0 -> 1.0"]),
        ("x = True", []),
        ("x = 'text'", []),
        ("x: Literal[3] = y", []),
        ("x = not y", ["not y -> y"]),
        ("x = a <= b", ["a <= b -> a < b"]),
        ("x = a is b", ["a is b -> a is not b"]),
        ("x = a < b == c", ["a < b == c -> a < b != c", "a < b == c -> a <= b == c"]),
        ("x = a or b", ["a or b -> a", "a or b -> b"]),
        (
            "x = a and b and c",
            ["a and b and c -> a and b", "a and b and c -> a and c", "a and b and c -> b and c"],
        ),
    ],
)
def test_changes(source: str, changes: list[str], mutants: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(source + "\n")
    assert sorted(mutant.change for mutant in mutants.mutants_of(path)) == changes


@pytest.mark.parametrize(
    ("body", "changes"),
    [
        ("x.act(1)", ["x.act(1) -> pass"]),
        ("x = y = 1", ["x = y = 1 -> pass"]),
        ("self.x += 1", ["self.x += 1 -> pass"]),
        ("x: int = 1", ["x: int = 1 -> pass"]),
        ("x: int", []),
        ("'text'", []),
        ("return x.act()", []),
        ("if x:\n        y()", ["y() -> pass"]),
        ("raise x", []),
    ],
)
def test_statements(body: str, changes: list[str], mutants: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(f"z = 1\n\n\ndef act(x):\n    {body}\n")
    found = mutants.mutants_of(path, statements=True)
    assert [mutant.change for mutant in found] == changes
    assert all(mutant.lines for mutant in found), "it is known which tests run it"


ROOT = TOOL.parents[1]
EXPLAINED = tomllib.loads((ROOT / "tools" / "mutants.toml").read_text())["equivalent"]
LOOP = [
    path
    for package in ("control", "nodes", "plant")
    for path in sorted((ROOT / "smarttac_can" / package).glob("*.py"))
]


@pytest.mark.parametrize("module", LOOP, ids=[f"{path.parent.name}/{path.stem}" for path in LOOP])
def test_the_page_has_tried_every_change_of_the_loop(module: Path, mutants: ModuleType) -> None:
    """Who adds a threshold to the loop runs the tool again, or the page tells of another module."""
    count = len(mutants.mutants_of(module))
    page = (ROOT / "docs" / "reference" / "mutants.md").read_text()
    _, _, row = page.partition(f"\n| `{module.relative_to(ROOT).as_posix()}` | ")
    if count:
        changes, tried, _, unexplained = map(int, row.split(" | ")[:4])
        assert (changes, tried, unexplained) == (count, count, 0)
    else:
        assert row == ""


@pytest.mark.parametrize("module", sorted({entry["module"] for entry in EXPLAINED}))
def test_what_is_explained_is_a_change_there_is(module: str, mutants: ModuleType) -> None:
    found = [
        mutant
        for statements in (False, True)
        for mutant in mutants.mutants_of(ROOT / module, statements=statements)
    ]
    lines, changes = {m.line for m in found}, {(m.line, m.change) for m in found}
    for entry in EXPLAINED:
        if entry["module"] == module:
            for line in entry.get("lines", [entry.get("line")]):
                assert line in lines
                assert "change" not in entry or (line, entry["change"]) in changes
