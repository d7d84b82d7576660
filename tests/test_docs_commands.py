"""The page of the commands has the names of the commands themselves."""

import re
from pathlib import Path

import click
import pytest
from commands_of import commands_of

from smarttac_can.cli import main as smarttac

PAGE = (Path(__file__).parents[1] / "docs" / "reference" / "cli.md").read_text()
COMMANDS = [(" ".join(path), command) for path, command in commands_of(smarttac, "smarttac")]


@pytest.mark.parametrize(("path", "command"), COMMANDS)
def test_arguments_are_named_as_in_the_usage_line(path: str, command: click.Command) -> None:
    # Under the settings of the whole: a command keeps the names of its help from its first usage.
    whole = click.Context(smarttac, **smarttac.context_settings)
    usage = command.get_usage(click.Context(command, whole, info_name=path))
    _, wanted = usage.replace("\n", " ").split("[OPTIONS]")
    section = PAGE.split(f"\n## `{path}`\n")[1].split("\n## ")[0]
    named = [name.replace("\\|", "|") for name in re.findall(r"^\| `([^-].*?)`", section, re.M)]
    assert named == wanted.split()
