"""``tools/house`` counts a small tree that was made up."""

import runpy
from pathlib import Path

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


def test_trees_side_by_side(
    tree: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["house", str(tree), str(tree / "inner")])
    runpy.run_path(str(TOOL), run_name="__main__")
    assert [line.split() for line in capsys.readouterr().out.splitlines()] == [
        ["code", "lines", "28", "22"],
        ["inner", "22", "78.6%", "0", "0.0%"],
        [".", "6", "21.4%", "22", "100.0%"],
        ["largest", "package"],
        ["inner", "22", "-"],
        [".", "-", "22"],
        ["largest", "module"],
        ["inner/large.py", "22", "-"],
        ["large.py", "-", "22"],
        ["classes", "with", "more", "than", "12", "attributes"],
        ["inner.large.Large", "13", "-"],
        ["large.Large", "-", "13"],
    ]
