"""The page of the commands names what the commands themselves name."""

import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from smarttac_can.cli import main as smarttac

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "cli.md").read_text()


def commands(group: click.Group, path: str) -> Iterator[tuple[str, click.Command]]:
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from commands(command, f"{path} {name}")
        else:
            yield f"{path} {name}", command


@pytest.mark.parametrize(("path", "command"), list(commands(smarttac, "smarttac")))
def test_arguments_are_named_as_in_the_usage_line(path: str, command: click.Command) -> None:
    # Under the settings of the whole: a command keeps the names of its help from its first usage.
    whole = click.Context(smarttac, **smarttac.context_settings)
    usage = command.get_usage(click.Context(command, whole, info_name=path))
    _, wanted = usage.replace("\n", " ").split("[OPTIONS]")
    section = PAGE.split(f"\n## `{path}`\n")[1].split("\n## ")[0]
    named = [name.replace("\\|", "|") for name in re.findall(r"^\| `([^-].*?)`", section, re.M)]
    assert named == wanted.split()
