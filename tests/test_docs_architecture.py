"""``docs/explanation/architecture.md`` shows the present code."""

import importlib
import inspect
import re
import textwrap
from pathlib import Path

import pytest

from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "explanation" / "architecture.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def table(title: str) -> list[list[str]]:
    """Rows of the table of a section, without its head."""
    lines = [line for line in section(title).splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


ROWS = table("To change this, go there")
ADDITIONS = table("What a change touches")


@pytest.mark.sources
def test_the_cycle_is_as_it_stands_in_the_file() -> None:
    shown = re.search(r"```py\n(.*?)```", section("The cycle"), re.DOTALL)
    assert shown is not None
    source = inspect.getsource(StimulatorBlock.cycle)
    body = source.split('"""')[2].strip("\n")
    assert shown[1] == textwrap.dedent(body) + "\n"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row[0]))
def test_each_row_of_changes_names_an_existing_file_and_symbol(row: list[str]) -> None:
    _, places, name = row
    files = re.findall(r"`([^`]+\.\w+)`", places)
    assert files
    assert all((ROOT / file).is_file() for file in files)
    if name:
        module = importlib.import_module(files[0].removesuffix(".py").replace("/", "."))
        assert hasattr(module, name.strip("`"))


@pytest.mark.parametrize("row", ADDITIONS, ids=lambda row: str(row[0]))
def test_an_addition_touches_at_most_three_files(row: list[str]) -> None:
    _, files = row
    assert 1 <= len(files.split(", ")) <= 3
    assert all((ROOT / path).exists() for path in re.findall(r"`([^`]+)`", files))
