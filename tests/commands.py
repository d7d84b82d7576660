"""The commands ``smarttac`` and ``python -m smarttac_can.assurance`` in this process."""

from pathlib import Path

from click.testing import CliRunner, Result

from smarttac_can.cli import main
from smarttac_can.cli.evidence import main as evidence


def run(*arguments: str | Path) -> Result:
    """Return how it ends; one that ends in a traceback raises its text."""
    group = evidence if arguments and arguments[0] in evidence.commands else main
    result = CliRunner().invoke(group, [str(argument) for argument in arguments])
    assert isinstance(result.exception, SystemExit | None), result.exception
    return result


def succeed(*arguments: str | Path) -> str:
    """Return its stdout."""
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    return result.stdout


def refusal(*arguments: str | Path, code: int | None = 1) -> str:
    """Return its one line on stderr, without "Error: ".

    Wrong usage has the code 2, and the usage is shown before; a code of None takes both.
    """
    result = run(*arguments)
    assert result.exit_code in ((1, 2) if code is None else (code,)), result.output
    *usage, line = result.stderr.splitlines()
    assert not usage or (result.exit_code == 2 and usage[0].startswith("Usage: ")), result.stderr
    assert line.startswith("Error: ")
    return line.removeprefix("Error: ")
