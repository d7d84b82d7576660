"""Files named in the Dockerfile exist: there is no Docker where the tests run, so it is not built.

Its files are those that pyproject.toml builds the package of, its extras are extras, its entry
point is a command, and that takes the arguments.
"""

import json
import re
import tomllib
from pathlib import Path

import click

from smarttac_can.cli import main

ROOT = Path(__file__).parents[1]
LINES = [
    line.split(maxsplit=1)
    for line in (ROOT / "Dockerfile").read_text(encoding="ascii").splitlines()
    if line and not line.startswith("#")
]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def arguments(instruction: str) -> list[str]:
    return [rest for name, rest in LINES if name == instruction]


def test_dockerfile_copies_each_file_of_the_build() -> None:
    copied = {source for line in arguments("COPY") for source in line.split()[:-1]}
    assert [source for source in copied if not (ROOT / source).exists()] == []
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    project = PROJECT["project"]
    readme = PROJECT["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["fragments"]
    needed = {"pyproject.toml", *(part["path"] for part in readme), *project["license-files"]}
    assert copied == needed | set(wheel["packages"]) | set(wheel["force-include"])


def test_dockerfile_installs_existing_extras_on_supported_python() -> None:
    (run,) = arguments("RUN")
    extras = re.search(r'"\.\[(.+)\]"$', run)
    assert extras is not None
    assert set(extras[1].split(",")) <= set(PROJECT["project"]["optional-dependencies"])
    (image,) = arguments("FROM")
    version = re.fullmatch(r"python:3\.(\d+)-slim", image)
    assert version is not None
    assert PROJECT["project"]["requires-python"] == ">=3.11"
    assert int(version[1]) >= 11


def test_its_command_is_taken() -> None:
    (entry,), command = (json.loads(*arguments(name)) for name in ("ENTRYPOINT", "CMD"))
    assert entry in PROJECT["project"]["scripts"]
    name, *options = command
    command = main.get_command(click.Context(main), name)
    assert command is not None
    context = command.make_context(name, options)
    assert context.params["interface"] == "udp_multicast"
