"""``tools/house`` counts a small tree that was made up."""

import json
import runpy
import subprocess
from pathlib import Path
from typing import Any

import pytest

TOOL = Path(__file__).parents[2] / "tools" / "house"

SMALL = '''\
"""A module of six code lines."""

# a comment
LIMIT = 3  # and one behind code
"""What an attribute says is no code."""


def double(value: int) -> int:
    """Return twice the value."""
    text = """one

three"""
    return value * len(text)
'''
ATTRIBUTES = "\n".join(f"        self.a{n} = {n}" for n in range(11))
LARGE = f"""\
from typing import ClassVar


class Large:
    kind: ClassVar[str] = "large"
    size: int

    def __init__(self):
{ATTRIBUTES}
        self.level = 0

    @property
    def level(self):
        return self.size

    def set(self, level):
        self.last, self.a0 = level, level

    def many(self, a, b, /, c, *rest, d, e, **others):
        return a

    def few(self, a, b, c, d, e, f):
        return a
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a tree with a package, and a module beside it."""
    tree = tmp_path / "tree"
    (tree / "inner").mkdir(parents=True)
    (tree / "small.py").write_text(SMALL)
    (tree / "inner" / "large.py").write_text(LARGE)
    (tree / "inner" / "notes.txt").write_text("no Python")
    return tree


def printed(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> str:
    """Return what the tool prints."""
    monkeypatch.setattr("sys.argv", ["house", *arguments])
    runpy.run_path(str(TOOL), run_name="__main__")
    return capsys.readouterr().out


def test_a_tree(
    tree: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    counts: dict[str, Any] = json.loads(printed([str(tree), "--json"], monkeypatch, capsys))
    assert counts == {
        "tree": {
            "code_lines": 6 + 26,
            "packages": {
                "inner": {"code_lines": 26, "share": 0.8125},
                ".": {"code_lines": 6, "share": 0.1875},
            },
            "largest_package": {"inner": 26},
            "largest_module": {"inner/large.py": 26},
            "classes": {"inner.large.Large": 13},
            "functions": {"inner.large.Large.many": 7},
        }
    }


def test_against_a_commit(
    tree: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    git = ["git", "-C", str(tree.parent), "-c", "user.name=A", "-c", "user.email=a@example.org"]
    for command in (["init", "-q"], ["add", "tree"], ["commit", "-qm", "Begin"]):
        subprocess.run([*git, *command], check=True)
    (tree / "inner" / "large.py").write_text("X = 1\n")
    lines = printed([str(tree), "--against", "HEAD"], monkeypatch, capsys).splitlines()
    assert lines[0].split() == ["HEAD", "tree"]
    assert lines[1].split() == ["code", "lines", "32", "7"]
    assert ["inner", "26", "81.2%", "1", "14.3%"] in [line.split() for line in lines]
    assert ["inner.large.Large", "13", "-"] in [line.split() for line in lines]


def test_no_such_commit(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    subprocess.run(["git", "-C", str(tree), "init", "-q"], check=True)
    monkeypatch.setattr("sys.argv", ["house", str(tree), "--against", "nowhere"])
    with pytest.raises(SystemExit, match=r"^nowhere: fatal: not a valid object name"):
        runpy.run_path(str(TOOL), run_name="__main__")
